//! The companion daemon between pseudo-terminals and datagrams.

use std::io::{Read, Write};
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use flyvine_link::arm::{
    Arm, FramedArm, LegacyOptions, Pty, Request, Setpoint, SoftwareArm, UdpLine, connect, open_serial,
};
use flyvine_link::onboard::{ArmPort, ArmProtocol, FcuPort, OnboardEvent, OnboardSummary, run};
use vine_arm::plant::PlantParameters;
use vine_arm::{Limits, State};

const ANY: &str = "127.0.0.1:0";
const GROWING: Setpoint = Setpoint {
    growth_rate_m_s: 0.02,
    pressure_kpa: 0.4,
};

fn arm_port(path: &Path, protocol: ArmProtocol) -> ArmPort {
    ArmPort {
        path: path.to_owned(),
        baud: 115_200,
        protocol,
        listen: ANY.parse().unwrap(),
    }
}

/// Runs the daemon while `test` has the address that it listens on; gives what both returned.
fn with_daemon<T>(
    arm: Option<ArmPort>,
    fcu: Option<FcuPort>,
    test: impl FnOnce(SocketAddr) -> T,
) -> (T, OnboardSummary, Vec<OnboardEvent>) {
    let stop = AtomicBool::new(false);
    let (sender, events) = mpsc::channel();
    std::thread::scope(|scope| {
        let stop = &stop;
        let daemon = scope.spawn(move || {
            run(arm.as_ref(), fcu.as_ref(), stop, &mut |event| {
                sender.send(event).unwrap()
            })
            .unwrap()
        });
        let Ok(OnboardEvent::Bridging { listen, .. }) = events.recv() else {
            panic!("no bridge")
        };
        let result = test(listen);
        stop.store(true, Ordering::Relaxed);
        let summary = daemon.join().unwrap();
        (result, summary, events.try_iter().collect())
    })
}

/// Sends `setpoint` at 20 Hz for `seconds`.
fn drive(arm: &mut dyn Arm, clock: Instant, seconds: f64, setpoint: Setpoint) {
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < seconds {
        let now_s = clock.elapsed().as_secs_f64();
        arm.poll(now_s).unwrap();
        arm.send(now_s, setpoint).unwrap();
        sleep(Duration::from_millis(50));
    }
    arm.poll(clock.elapsed().as_secs_f64()).unwrap();
}

fn software_arm() -> SoftwareArm {
    SoftwareArm::start(Limits::default(), PlantParameters::default(), 0.7).unwrap()
}

#[test]
fn a_base_station_drives_an_arm_through_the_daemon_which_stops_it_in_the_end() {
    let arm = software_arm();
    let port = arm_port(arm.path(), ArmProtocol::Framed);
    let ((), summary, events) = with_daemon(Some(port), None, |listen| {
        let clock = Instant::now();
        let mut remote = FramedArm::new(UdpLine::connect(listen).unwrap(), 0.0);
        drive(&mut remote, clock, 1.0, GROWING);
        let status = remote.status(clock.elapsed().as_secs_f64());
        let telemetry = status.telemetry.unwrap();
        assert_eq!(telemetry.state, State::Active);
        assert!(telemetry.length_m.unwrap() > 0.705, "{telemetry:?}");
        assert!(status.acknowledged >= 10 && status.rejected == 0, "{status:?}");

        // Datagrams that are no frames are not carried.
        let stranger = UdpSocket::bind(ANY).unwrap();
        stranger.send_to(b"g7", listen).unwrap();
        stranger.send_to(&[0, 3, 1, 1, 0], listen).unwrap();
        drive(&mut remote, clock, 0.2, GROWING);
    });
    assert_eq!(summary.arm_stopped, Some(true));
    assert_eq!(summary.arm.unwrap().rejected, 1);
    assert!(events.contains(&OnboardEvent::ArmStopped(true)));
    // The arm itself agrees.
    let clock = Instant::now();
    let mut direct = connect(&format!("serial:{}", arm.path().display()), 0.0).unwrap();
    drive(&mut *direct, clock, 0.3, GROWING);
    let status = direct.status(clock.elapsed().as_secs_f64());
    assert_eq!(status.telemetry.unwrap().state, State::Stopped);
    assert_eq!(status.refusal, Some(vine_arm::Refusal::Stopped));
    direct
        .ask(clock.elapsed().as_secs_f64(), Request::Resume)
        .unwrap();
    drive(&mut *direct, clock, 0.3, GROWING);
    let status = direct.status(clock.elapsed().as_secs_f64());
    assert_eq!(status.telemetry.unwrap().state, State::Active);
}

#[test]
fn an_old_arm_looks_like_a_new_one_and_is_stopped_when_the_host_falls_silent() {
    let mut pty = Pty::open().unwrap();
    let port = arm_port(&pty.path, ArmProtocol::Legacy(LegacyOptions::default()));
    let written = |pty: &mut Pty| {
        let mut text = vec![0; 1 << 16];
        let count = pty.file.read(&mut text).unwrap_or(0);
        text.truncate(count);
        String::from_utf8(text).unwrap()
    };
    let ((), summary, _) = with_daemon(Some(port), None, |listen| {
        let clock = Instant::now();
        let mut remote = FramedArm::new(UdpLine::connect(listen).unwrap(), 0.0);
        remote.ask(0.0, Request::SetLength(0.8)).unwrap();
        drive(&mut remote, clock, 0.5, GROWING);
        assert!(written(&mut pty).ends_with("g2.000\np0.400\n"));
        let status = remote.status(clock.elapsed().as_secs_f64());
        assert_eq!(status.telemetry.unwrap().state, State::Active);
        assert!(status.telemetry.unwrap().length_m.unwrap() > 0.8);
        sleep(Duration::from_millis(400));
        assert!(written(&mut pty).ends_with("g0.000\np0.000\n"));
        drive(&mut remote, clock, 0.2, GROWING);
    });
    assert_eq!(summary.arm_stopped, Some(true));
    assert!(written(&mut pty).ends_with("g0.000\np0.000\n"));
}

#[test]
fn mavlink_packets_pass_whole_both_ways() {
    let mut pty = Pty::open().unwrap();
    let ground = UdpSocket::bind(ANY).unwrap();
    ground.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let port = FcuPort {
        path: pty.path.clone(),
        baud: 921_600,
        listen: ANY.parse().unwrap(),
        peer: ground.local_addr().unwrap(),
    };
    // A v2 packet with zeros, the pty's control characters and its own magic in it, and a v1 packet.
    let v2: Vec<u8> = [0xFD, 9, 0, 0, 7, 1, 1]
        .into_iter()
        .chain([0x11, 0x13, 0x0D, 0xFD, 0, 3, 4, 0x7F, 0x1A, 0xFE, 0, 0, 5, 6])
        .collect();
    let v1 = vec![0xFE, 1, 0, 1, 1, 0, 42, 8, 9];
    assert_eq!((v2.len(), v1.len()), (21, 9));
    let ((), summary, _) = with_daemon(None, Some(port), |listen| {
        let stream = [&[0x55][..], &v2, &v1].concat();
        for part in stream.chunks(5) {
            pty.file.write_all(part).unwrap();
            sleep(Duration::from_millis(10));
        }
        let mut datagram = [0; 300];
        for packet in [&v2, &v1] {
            let (length, from) = ground.recv_from(&mut datagram).unwrap();
            assert_eq!((&datagram[..length], from), (&packet[..], listen));
        }
        // Two packets in one datagram, and one cut short.
        ground.send_to(&[&v1[..], &v2].concat(), listen).unwrap();
        ground.send_to(&v2[..10], listen).unwrap();
        let expected = [&v1[..], &v2].concat();
        let mut received = Vec::new();
        let until = Instant::now() + Duration::from_secs(5);
        while received.len() < expected.len() && Instant::now() < until {
            sleep(Duration::from_millis(10));
            let mut bytes = [0; 300];
            let count = pty.file.read(&mut bytes).unwrap_or(0);
            received.extend_from_slice(&bytes[..count]);
        }
        assert_eq!(received, expected);
    });
    let fcu = summary.fcu.unwrap();
    assert_eq!(
        (fcu.from_serial, fcu.to_serial, fcu.rejected, fcu.dropped),
        (2, 2, 2, 0)
    );
}

#[test]
fn a_serial_port_that_is_not_there_is_named() {
    let port = arm_port(Path::new("/dev/no-such-port"), ArmProtocol::Framed);
    let error = run(Some(&port), None, &AtomicBool::new(false), &mut |_| {}).unwrap_err();
    assert!(error.to_string().contains("/dev/no-such-port"), "{error}");
    assert!(run(None, None, &AtomicBool::new(false), &mut |_| {}).is_err());
    assert!(
        open_serial(Path::new("/dev/null"), 115_200).is_err(),
        "not a terminal"
    );
}
