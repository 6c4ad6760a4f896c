//! A ground station that nobody here wrote flies the simulated PX4: MAVSDK, from pip.
//!
//! `FLYVINE_MAVSDK_PYTHON` names a Python that has it (`python3` otherwise). Without it the test prints that it skips, unless
//! `FLYVINE_REQUIRE_PEERS=1`.

#![allow(clippy::print_stdout)] // what was measured or skipped

use std::net::UdpSocket;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use flyvine::flight::Configuration;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine_link::autopilot::UdpWire;
use flyvine_link::rehearsal::{Ends, Rig, Script, serve};

fn python() -> Option<String> {
    let python = std::env::var("FLYVINE_MAVSDK_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let found = Command::new(&python).args(["-c", "import mavsdk"]).output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    assert!(
        std::env::var("FLYVINE_REQUIRE_PEERS").as_deref() != Ok("1"),
        "`{python}` has no mavsdk; FLYVINE_REQUIRE_PEERS=1 wants it (pip install mavsdk)"
    );
    println!("skipped: `{python}` has no mavsdk (pip install mavsdk)");
    None
}

#[test]
fn mavsdk_arms_flies_offboard_and_lands() {
    let Some(python) = python() else { return };
    let address = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let configuration = Configuration {
        length_m: 0.7,
        pressure_kpa: 0.0,
    };
    let mut rig = Rig::new(vehicle, configuration, 1, None, Script::default()).unwrap();
    let stop = AtomicBool::new(false);
    let output = std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut ends = Ends {
                autopilot: Box::new(UdpWire::call(address).unwrap()),
                mocap: None,
                arm: None,
                board: None,
            };
            serve(&mut rig, &mut ends, &stop, &mut |_, _| ()).unwrap();
        });
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/mavsdk_flight.py");
        let output = Command::new(python)
            .args([script, &address.port().to_string()])
            .output();
        stop.store(true, Ordering::Relaxed);
        output.unwrap()
    });
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    assert!(
        output.status.success(),
        "{said}\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    for expected in [
        "\"com_obl_rc_act\": 4",
        "\"com_of_loss_t\": 0.5",
        "\"reached\": \"place\"",
        "\"active\": true",
        "\"reached\": \"hold\"",
        "\"reached\": \"landed\"",
        "\"done\": true",
    ] {
        assert!(said.contains(expected), "{expected} in\n{said}");
    }
    // PX4's own refusals reach the client.
    for refusal in [
        "arm_without_vision",
        "offboard_without_setpoint",
        "hold_without_origin",
    ] {
        assert!(
            !said.contains(&format!("\"{refusal}\": null")),
            "{refusal} in\n{said}"
        );
    }
    assert!(!rig.px4.is_armed() && rig.stands());
}
