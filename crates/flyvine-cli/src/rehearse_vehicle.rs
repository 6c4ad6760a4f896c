//! The vehicle's end of a rehearsal, a process of its own: physics, autopilot, motion capture and arm over loopback.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use clap::Args;
use flyvine::flight::Configuration;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine_link::rehearsal::{Addresses, FaultKind, Rig, RigEvent, Script, serve};

use crate::console::print_json;
use crate::outcome::{Blame, CommandResult, Failure, Outcome};

/// Serve the simulated vehicle on loopback: a PX4 that calls --autopilot, motion capture, the arm. `flyvine rehearse` starts
/// it; by itself it is a vehicle for any ground station.
#[derive(Args)]
pub struct RehearseVehicleArguments {
    /// The MAVLink port of the base station, which is called.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:14540")]
    autopilot: SocketAddr,
    /// Where poses are sent.
    #[arg(long, value_name = "HOST:PORT")]
    poses: Option<SocketAddr>,
    /// Where the arm listens.
    #[arg(long, value_name = "HOST:PORT")]
    arm: Option<SocketAddr>,
    /// Length of the arm, m.
    #[arg(long, default_value_t = 0.7)]
    length_m: f64,
    /// Pressure in it, kPa.
    #[arg(long, default_value_t = 0.0)]
    pressure_kpa: f64,
    /// Seed of its noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// What goes wrong, and when.
    #[arg(long, value_name = "SCRIPT.toml")]
    fault: Option<PathBuf>,
}

/// Reads a script of faults.
pub fn read_script(path: &std::path::Path) -> Result<Script, Failure> {
    let text = std::fs::read_to_string(path)
        .with_context(|| path.display().to_string())
        .or_input()?;
    Script::parse(&text)
        .with_context(|| path.display().to_string())
        .or_input()
}

/// Runs the vehicle's end until SIGTERM.
pub fn run(arguments: &RehearseVehicleArguments) -> CommandResult {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).or_internal()?;
    }
    let script = arguments
        .fault
        .as_deref()
        .map(read_script)
        .transpose()?
        .unwrap_or_default();
    let configuration = Configuration {
        length_m: arguments.length_m,
        pressure_kpa: arguments.pressure_kpa,
    };
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).or_internal()?;
    let mut rig = Rig::new(vehicle, configuration, arguments.seed, None, script).or_input()?;
    let addresses = Addresses {
        autopilot: arguments.autopilot,
        poses: arguments.poses,
        arm: arguments.arm,
    };
    serve(&mut rig, &addresses, &stop, &mut |t_s, event| {
        let line = match event {
            RigEvent::Phase(phase) => serde_json::json!({ "t_s": t_s, "phase": phase }),
            RigEvent::Fault(fault) => serde_json::json!({ "t_s": t_s, "fault": fault }),
        };
        // Whoever started it may be gone; the vehicle flies on.
        let _ = print_json(&line);
        if event == RigEvent::Fault(FaultKind::VehicleKilled) {
            let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
        }
    })
    .or_internal()?;
    Ok(Outcome::Done)
}
