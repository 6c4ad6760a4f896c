//! Our motion-capture servers, read by clients that others wrote, and our VRPN client before the VRPN project's own server.
//!
//! They need a Python with the package `motioncapture`: the one that FLYVINE_PEERS_PYTHON names, or `python3`. Where it
//! has none, the tests print that they skip; with FLYVINE_REQUIRE_PEERS=1 they fail.

#![expect(clippy::print_stderr, reason = "tests say that they skip")]

mod common;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use common::{ANY_PORT, MovingBodies, free_udp_port, wait_until};
use flyvine_link::mocap::{Bodies, Frame, HygieneLimits, Incoming, MocapServer, MocapSource, Sink};

/// The Python that has `motioncapture`; `None` if the test shall skip.
fn python() -> Option<String> {
    let python = std::env::var("FLYVINE_PEERS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_package = Command::new(&python)
        .args(["-c", "import motioncapture"])
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if has_package {
        return Some(python);
    }
    assert!(
        std::env::var("FLYVINE_REQUIRE_PEERS").as_deref() != Ok("1"),
        "`{python}` has no package `motioncapture`, and FLYVINE_REQUIRE_PEERS=1 wants it"
    );
    eprintln!("skipped: `{python}` has no package `motioncapture` (pip install motioncapture numpy)");
    None
}

fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/peers")
        .join(name)
}

/// What `motioncapture` sees of the server: both bodies, where they are.
fn check(kind: &str, options: &[String], bodies: &MovingBodies) {
    let Some(python) = python() else { return };
    let mut child = Command::new(python)
        .arg(script("motioncapture_reads.py"))
        .arg(kind)
        .args(options)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    // Its NatNet client blocks for ever on a lost answer.
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if began.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!(
                "motioncapture saw nothing of {:?} in 60 s",
                bodies.server.address()
            );
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    // The library prints on its own before.
    let printed = String::from_utf8_lossy(&output.stdout);
    let last_line = printed.lines().last().unwrap_or_default();
    let seen: serde_json::Value = serde_json::from_str(last_line).unwrap_or_else(|_| panic!("{output:?}"));
    for (name, height_m) in [("drone", 1.5), ("tip", 0.8)] {
        let number = |key: &str, i: usize| seen[name][key][i].as_f64().unwrap_or(f64::NAN);
        let radius = number("position", 0).hypot(number("position", 1));
        assert!((radius - 1.0).abs() < 1e-5, "{seen}");
        assert!((number("position", 2) - height_m).abs() < 1e-5, "{seen}");
        for (i, expected) in [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()].into_iter().enumerate() {
            assert!((number("rotation", i) - expected).abs() < 1e-5, "{seen}");
        }
    }
}

#[test]
fn motioncapture_reads_our_vrpn_server() {
    let bodies = MovingBodies::publish_on(MocapServer::vrpn(ANY_PORT).unwrap());
    let address = bodies.server.address();
    for hostname in [format!("{address}"), format!("tcp://{address}")] {
        check("vrpn", &[format!("hostname={hostname}")], &bodies);
    }
}

#[test]
fn motioncapture_reads_our_natnet_server() {
    let names = ["drone".to_owned(), "tip".to_owned()];
    let server = MocapServer::natnet(ANY_PORT, free_udp_port(), &names).unwrap();
    let bodies = MovingBodies::publish_on(server);
    let address = bodies.server.address();
    let options = [
        format!("hostname={}", address.ip()),
        format!("port_command={}", address.port()),
    ];
    check("optitrack", &options, &bodies);
}

/// `motioncapture` carries the VRPN library, server and all: what it sends, we read, at the times that it says.
#[test]
fn our_client_reads_the_vrpn_projects_server() {
    let Some(python) = python() else { return };
    let port = free_udp_port();
    let mut server = Command::new(python)
        .arg(script("vrpn_serves.py"))
        .arg(port.to_string())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(server.stdout.take().unwrap()).lines();
    assert_eq!(said.next().unwrap().unwrap(), "ready");
    for address in [
        format!("vrpn:127.0.0.1:{port}"),
        format!("vrpn:tcp://127.0.0.1:{port}"),
    ] {
        let frames: Arc<Mutex<Vec<Frame>>> = Arc::default();
        let heard = Arc::clone(&frames);
        let tap: Sink = Arc::new(move |incoming| {
            if let Incoming::Frame(frame, _) = incoming {
                heard.lock().unwrap().push(frame);
            }
        });
        let bodies = Some(Bodies::named("drone", "tip"));
        let source = MocapSource::start(
            &address.parse().unwrap(),
            bodies,
            HygieneLimits::default(),
            Some(tap),
        )
        .unwrap();
        wait_until("poses of the VRPN project's server", || {
            frames.lock().unwrap().len() > 100
        });
        let latest = source.latest(Instant::now());
        assert!(
            latest.quadrotor.is_some() && latest.end_effector.is_some(),
            "{address}"
        );
        let server_name = source.status(Instant::now()).server;
        assert!(server_name.contains("VRPN 07."), "{server_name}");
        drop(source);
        for frame in frames.lock().unwrap().iter() {
            let [body] = &frame.bodies[..] else {
                panic!("{address}: {frame:?}");
            };
            let angle = frame.captured_s % 1000.0;
            let height_m = if body.name == "drone" { 1.5 } else { 0.8 };
            let expected = [angle.cos(), angle.sin(), height_m];
            // Stamps are whole microseconds.
            let near = (0..3).all(|i| (body.position[i] - expected[i]).abs() < 3e-6);
            assert!(near, "{address}: {frame:?}");
            let half = 0.5_f64.sqrt();
            let turned = [half, 0.0, 0.0, half];
            assert!(
                (0..4).all(|i| (body.attitude[i] - turned[i]).abs() < 1e-12),
                "{address}: {frame:?}"
            );
        }
    }
    drop(server.stdin.take());
    server.wait().unwrap();
}
