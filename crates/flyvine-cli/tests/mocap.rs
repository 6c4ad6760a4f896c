//! `flyvine mocap` against a server on loopback.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use assert_cmd::Command;
use flyvine_link::mocap::{BodyPose, MocapServer};
use predicates::prelude::*;

const BODIES: &str = "axes = \"y_up\"\n[quadrotor]\nname = \"drone\"\n[end_effector]\nname = \"tip\"\n";

fn flyvine() -> Command {
    Command::cargo_bin("flyvine").unwrap()
}

/// Runs `work` while `drone` and `tip` are published at 100 Hz; the drone's pose is NaN now and then.
fn while_publishing(work: impl FnOnce(SocketAddr)) {
    let server = MocapServer::vrpn((Ipv4Addr::LOCALHOST, 0).into()).unwrap();
    let address = server.address();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut frame = 0;
            while !over.load(Ordering::Relaxed) {
                frame += 1;
                let now_s = SystemTime::now()
                    .duration_since(UNIX_EPOCH)
                    .unwrap()
                    .as_secs_f64();
                let x = if frame % 20 == 0 {
                    f64::NAN
                } else {
                    (now_s % 1000.0).sin()
                };
                let body = |name: &str, x, height_m| BodyPose {
                    name: name.into(),
                    position: [x, height_m, -1.0],
                    attitude: [1.0, 0.0, 0.0, 0.0],
                    tracked: true,
                };
                server
                    .publish(now_s, &[body("drone", x, 1.5), body("tip", 0.0, 0.8)])
                    .unwrap();
                thread::sleep(Duration::from_millis(10));
            }
        });
        work(address);
        over.store(true, Ordering::Relaxed);
    });
}

#[test]
fn bodies_are_listed_with_what_is_wrong_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (bodies, record) = (folder.path().join("bodies.toml"), folder.path().join("out.csv"));
    std::fs::write(&bodies, BODIES).unwrap();
    while_publishing(|address| {
        let output = flyvine()
            .args([
                "mocap",
                "--json",
                "--duration",
                "2",
                "--vrpn",
                &address.to_string(),
            ])
            .arg("--bodies")
            .arg(&bodies)
            .arg("--record")
            .arg(&record)
            .assert()
            .success()
            .get_output()
            .stdout
            .clone();
        let status: serde_json::Value = serde_json::from_slice(&output).unwrap();
        assert_eq!(status["connected"], true);
        let [drone, tip] = [&status["bodies"][0], &status["bodies"][1]];
        assert_eq!(
            (&drone["name"], &drone["role"]),
            (&"drone".into(), &"quadrotor".into())
        );
        assert!(drone["faults"]["not_finite"].as_u64() > Some(0), "{status}");
        assert_eq!(tip["faults"]["not_finite"], 0);
        assert_eq!(
            tip["position_m"],
            serde_json::json!([0.0, 1.0, 0.8]),
            "y up became z up"
        );
    });
    let table = std::fs::read_to_string(&record).unwrap();
    let mut lines = table.lines();
    assert_eq!(
        lines.next(),
        Some("server_s,arrived_s,body,x,y,z,qw,qx,qy,qz,tracked")
    );
    assert!(lines.count() > 20, "{table}");
    assert!(table.contains(",\"tip\",0,0.8,-1,1,0,0,0,true\n"));
}

#[test]
fn a_body_that_does_not_come_makes_the_result_untrusted() {
    let folder = tempfile::tempdir().unwrap();
    let bodies = folder.path().join("bodies.toml");
    std::fs::write(&bodies, BODIES.replace("drone", "dorne")).unwrap();
    while_publishing(|address| {
        flyvine()
            .args([
                "mocap",
                "--duration",
                "1.5",
                "--vrpn",
                &format!("tcp://{address}"),
            ])
            .arg("--bodies")
            .arg(&bodies)
            .assert()
            .code(3)
            .stdout(predicate::str::contains("dorne"))
            .stderr(predicate::str::contains("nothing came of dorne"));
    });
}

#[test]
fn bad_usage_is_named() {
    let mocap = |arguments: &[&str]| flyvine().arg("mocap").args(arguments).assert();
    mocap(&[]).code(2);
    mocap(&["--vrpn", "a", "--natnet", "b"]).code(2);
    mocap(&["--vrpn", "Drone1@host"])
        .code(2)
        .stderr(predicate::str::contains("Drone1@host"));
    mocap(&["--vrpn", "127.0.0.1", "--duration", "-1"]).code(2);
    mocap(&["--vrpn", "127.0.0.1:1", "--bodies", "/nowhere.toml"])
        .code(2)
        .stderr(predicate::str::contains("/nowhere.toml"));
    // Nobody listens there.
    mocap(&["--natnet", "127.0.0.1:1", "--duration", "0.2"])
        .code(3)
        .stderr(predicate::str::contains("no motion capture"));
}
