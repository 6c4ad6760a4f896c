//! `flyvine fly` in a lab in which neither end of its wires is ours: MAVSDK's server side is the autopilot, the VRPN project's
//! server is motion capture (`flyvine-link/tests/peers/lab.py`). In real time, so in a binary of its own.
//!
//! `FLYVINE_MAVSDK_PYTHON` names a Python that has mavsdk and motioncapture (`python3` otherwise). Without them the test prints
//! that it skips, unless `FLYVINE_REQUIRE_PEERS=1`.

#![allow(clippy::print_stdout)] // what was skipped

mod common;

use std::net::UdpSocket;
use std::path::Path;
use std::process::{Command, Stdio};

use common::{bodies_file, demo_run};
use flyvine::flight::{Sample, read_flight};

#[test]
fn a_lab_of_others_programs_is_flown() {
    let python = std::env::var("FLYVINE_MAVSDK_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_packages = Command::new(&python)
        .args(["-c", "import mavsdk, motioncapture"])
        .output()
        .is_ok_and(|output| output.status.success());
    if !has_packages {
        let required = std::env::var("FLYVINE_REQUIRE_PEERS").as_deref() == Ok("1");
        assert!(
            !required,
            "`{python}` lacks mavsdk or motioncapture, and FLYVINE_REQUIRE_PEERS=1 wants them"
        );
        println!("skipped: `{python}` lacks mavsdk or motioncapture");
        return;
    }
    let scratch = tempfile::tempdir().unwrap();
    // Both at once, so that they differ.
    let free = [0, 1].map(|_| UdpSocket::bind("127.0.0.1:0").unwrap());
    let [autopilot, mocap] = free.map(|socket| socket.local_addr().unwrap());
    let complaints = scratch.path().join("lab.txt");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../flyvine-link/tests/peers/lab.py");
    let mut lab = Command::new(&python);
    lab.arg(script)
        .args([
            autopilot.port().to_string(),
            mocap.port().to_string(),
            "0.7".into(),
        ])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::from(std::fs::File::create(&complaints).unwrap()));
    let mut lab = lab.spawn().unwrap();
    let bodies = bodies_file(scratch.path());
    let recording = scratch.path().join("flight.mcap");
    let mut base = Command::new(assert_cmd::cargo::cargo_bin("flyvine"));
    base.arg("fly")
        .arg(demo_run().join("experiments/swing_ES/plan.json"));
    base.args(["--vehicle", &format!("mavlink:udpin:{autopilot}")]);
    base.args(["--mocap", &format!("vrpn:{mocap}")]);
    base.arg("--bodies").arg(bodies).arg("--out").arg(&recording);
    let flown = base.output().unwrap();
    drop(lab.stdin.take());
    let said = std::io::read_to_string(lab.stdout.take().unwrap()).unwrap();
    let complaints = std::fs::read_to_string(complaints).unwrap();
    lab.wait().unwrap();
    assert!(flown.status.success(), "{flown:?}\n{said}\n{complaints}");
    // What the autopilot went through, in this order.
    let mut rest = said.as_str();
    for step in [
        r#""mode": "OFFBOARD""#,
        r#""armed": true"#,
        r#""mode": "LAND""#,
        r#""armed": false"#,
        r#""landed": true"#,
    ] {
        let found = rest.find(step).unwrap_or_else(|| panic!("{step} in\n{said}"));
        rest = &rest[found..];
    }
    // The whole plan was flown, and the drone went where it was commanded, but for its lag.
    let flight = read_flight(&recording).unwrap();
    let east = |of: &dyn Fn(&Sample) -> f64| {
        let range = flight
            .samples
            .iter()
            .map(of)
            .fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
        range.1 - range.0
    };
    let (commanded, went) = (
        east(&|sample| sample.command[0]),
        east(&|sample| sample.quadrotor.unwrap().position[0]),
    );
    assert!(
        flight.samples.len() > 45 && went > 0.3 * commanded && went < 1.1 * commanded,
        "{went} m of {commanded} m"
    );
}
