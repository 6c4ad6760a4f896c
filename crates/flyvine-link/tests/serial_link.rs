//! The base station on serial lines: autopilot and arm on pseudo-terminals, motion capture over VRPN, in real time.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};

use flyvine::control::Trajectory;
use flyvine::flight::Configuration;
use flyvine::link::Vehicle;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine_link::arm::{Pty, connect};
use flyvine_link::autopilot::{
    AutopilotVehicle, Clock, Flags, LinkOptions, MocapPoses, MonotonicClock, Station, Wire, WiredArm, open,
};
use flyvine_link::mocap::{HygieneLimits, MocapServer, MocapSource};
use flyvine_link::rehearsal::{Ends, Rig, Script, rig_bodies, serve, wired_limits};
use vine_arm::State;

const SHORT: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};

/// The far end of a serial line.
struct PtyWire(Pty);

impl Wire for PtyWire {
    fn send(&mut self, frame: &[u8]) {
        let _ = self.0.file.write(frame);
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) {
        let mut part = [0; 2048];
        while let Ok(count @ 1..) = self.0.file.read(&mut part) {
            bytes.extend_from_slice(&part[..count]);
        }
    }
}

fn hover(knots: usize) -> Trajectory {
    let rest = vec![0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8];
    Trajectory::new(
        vec![[0.0, 0.0, 1.5]; knots - 1],
        vec![rest; knots],
        Vec::new(),
        vec![SHORT; knots],
        [f64::NEG_INFINITY; 3],
        [f64::INFINITY; 3],
    )
    .unwrap()
}

#[test]
fn autopilot_and_arm_on_serial_lines_are_ready_and_take_set_points() {
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let mut rig = Rig::new(vehicle, SHORT, 1, None, Script::default()).unwrap();
    let (autopilot, arm) = (Pty::open().unwrap(), Pty::open().unwrap());
    let mocap = MocapServer::vrpn(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).unwrap();
    let clock = MonotonicClock::start();
    let server = format!("vrpn:{}", mocap.address()).parse().unwrap();
    let source = MocapSource::start(&server, Some(rig_bodies()), HygieneLimits::default(), None).unwrap();
    let station = Station {
        clock: Box::new(clock),
        wire: open(&format!("serial:{}:57600", autopilot.path.display())).unwrap(),
        poses: Box::new(MocapPoses::new(source, clock)),
        arm: Box::new(WiredArm::new(
            connect(&format!("serial:{}", arm.path.display()), clock.now_s()).unwrap(),
        )),
    };
    let stop = AtomicBool::new(false);
    let (checklist, heard) = std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut ends = Ends {
                autopilot: Box::new(PtyWire(autopilot)),
                mocap: Some(mocap),
                arm: Some(arm),
                board: None,
            };
            serve(&mut rig, &mut ends, &stop, &mut |_, _| ()).unwrap();
        });
        let options = LinkOptions::default();
        let mut base = AutopilotVehicle::new(options, station, Flags::default(), hover(40), wired_limits());
        let checklist = base.prepare().unwrap().clone();
        base.reset(SHORT, 0).unwrap();
        let heard = std::rc::Rc::new(std::cell::Cell::new(None));
        let hears = std::rc::Rc::clone(&heard);
        base.listen(Box::new(move |heard| hears.set(Some(*heard))));
        for _ in 0..20 {
            base.step([0.0, 0.0, 1.5].into(), SHORT).unwrap();
        }
        stop.store(true, Ordering::Relaxed);
        (checklist, heard.get().unwrap())
    });
    assert!(checklist.is_ready(), "{checklist}");
    let received = rig.px4.take_received();
    assert!(
        (15..=20).contains(&received.len()),
        "{} set-points",
        received.len()
    );
    assert!(!rig.px4.is_armed());
    let arm = heard.arm.unwrap();
    assert_eq!(
        (arm.state, arm.fault()),
        (Some(State::Active), None),
        "it follows set-points"
    );
    assert!((arm.length_m.unwrap() - 0.7).abs() < 1e-3, "{arm:?}");
    assert!(heard.poses.quadrotor.is_some() && heard.now_s - arm.heard_s < 0.3);
}
