//! The vehicle's end of a rehearsal, a process of its own: physics, autopilot, motion capture and arm.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use clap::{Args, ValueEnum};
use flyvine::flight::Configuration;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine_link::arm::{EmulatedBoard, Pty};
use flyvine_link::autopilot::UdpWire;
use flyvine_link::mocap::MocapServer;
use flyvine_link::rehearsal::{Ends, FaultKind, Rig, RigEvent, Script, rig_bodies, serve};
use serde::{Deserialize, Serialize};

use crate::console::print_json;
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// The vehicle's end of the wires of a rehearsal.
#[derive(Args, Clone)]
pub struct RigArguments {
    /// What motion capture speaks.
    #[arg(long, value_enum, default_value_t = MocapProtocol::Vrpn)]
    mocap_protocol: MocapProtocol,
    /// Run the arm's firmware on qemu's micro:bit, from this image (firmware/README.md), in the software arm's place. Its arm
    /// begins at 0.7 m, empty.
    #[arg(long, value_name = "IMAGE")]
    arm_firmware: Option<PathBuf>,
    /// Seed of the vehicle's noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

impl RigArguments {
    /// Refuses a script that could not be followed.
    pub fn check(&self, script: &Script) -> Result<(), Failure> {
        for fault in &script.fault {
            match fault.kind {
                FaultKind::SolverLate => {
                    return bad_input(
                        "solver-late: only under a virtual clock (the campaign of CONTRIBUTING.md); here, base-stalls"
                            .to_owned(),
                    );
                }
                FaultKind::ArmFault if self.arm_firmware.is_some() => {
                    return bad_input(
                        "arm-fault: only of the software arm, without --arm-firmware".to_owned(),
                    );
                }
                _ => (),
            }
        }
        Ok(())
    }

    /// As arguments of another process.
    pub fn pass_on(&self, command: &mut Command) {
        let protocol = self.mocap_protocol.to_possible_value().expect("none is hidden");
        command.args(["--mocap-protocol", protocol.get_name()]);
        command.args(["--seed", &self.seed.to_string()]);
        if let Some(image) = &self.arm_firmware {
            command.arg("--arm-firmware").arg(image);
        }
    }
}

/// The protocols that motion capture may speak.
#[derive(Clone, Copy, ValueEnum)]
enum MocapProtocol {
    /// VRPN.
    Vrpn,
    /// NatNet 3.1, unicast.
    Natnet,
}

/// Serve the simulated vehicle on loopback: a PX4 that calls --autopilot, a motion-capture server, and the arm on a
/// pseudo-terminal. `flyvine rehearse` starts it; by itself it is a vehicle for any ground station. The first line on stdout
/// says where motion capture and the arm are.
#[derive(Args)]
pub struct RehearseVehicleArguments {
    /// The MAVLink port of the base station, which is called.
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:14540")]
    autopilot: SocketAddr,
    /// Length of the arm, m.
    #[arg(long, default_value_t = 0.7)]
    length_m: f64,
    /// Pressure in it, kPa.
    #[arg(long, default_value_t = 0.0)]
    pressure_kpa: f64,
    #[command(flatten)]
    rig: RigArguments,
    /// What goes wrong, and when.
    #[arg(long, value_name = "SCRIPT.toml")]
    fault: Option<PathBuf>,
}

/// Where the vehicle's ends of the wires are, as `flyvine fly` takes them; the first line on stdout.
#[derive(Serialize, Deserialize)]
pub struct Served {
    /// `--mocap`.
    pub mocap: String,
    /// `--arm`.
    pub arm: String,
}

/// Reads a script of faults.
pub fn read_script(path: &Path) -> Result<Script, Failure> {
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
    arguments.rig.check(&script)?;
    let configuration = Configuration {
        length_m: arguments.length_m,
        pressure_kpa: arguments.pressure_kpa,
    };
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).or_internal()?;
    let mut rig = Rig::new(vehicle, configuration, arguments.rig.seed, None, script).or_input()?;
    let mut emulator = arguments.rig.arm_firmware.as_deref().map(board).transpose()?;
    if emulator.is_some() {
        rig.use_board();
    }
    let (mocap, mocap_address) = mocap_server(arguments.rig.mocap_protocol)?;
    let arm = Pty::open()
        .context("no pseudo-terminal for the arm")
        .or_internal()?;
    print_json(&Served {
        mocap: mocap_address,
        arm: format!("serial:{}", arm.path.display()),
    })?;
    let wire = UdpWire::call(arguments.autopilot)
        .with_context(|| format!("--autopilot {}", arguments.autopilot))
        .or_input()?;
    let line = emulator.as_ref().map(|board| board.line.try_clone());
    let board = line.transpose().or_internal()?;
    let mut ends = Ends {
        autopilot: Box::new(wire),
        mocap: Some(mocap),
        arm: Some(arm),
        board,
    };
    serve(&mut rig, &mut ends, &stop, &mut |t_s, event| {
        let line = match event {
            RigEvent::Phase { phase, loop_phase_s } => {
                serde_json::json!({ "t_s": t_s, "phase": phase, "loop_phase_s": loop_phase_s })
            }
            RigEvent::Fault(fault) => serde_json::json!({ "t_s": t_s, "fault": fault }),
        };
        // Whoever started it may be gone; the vehicle flies on.
        let _ = print_json(&line);
        if event == RigEvent::Fault(FaultKind::VehicleKilled) {
            // All of the vehicle's end falls silent.
            drop(emulator.take());
            let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
        }
    })
    .or_internal()?;
    Ok(Outcome::Done)
}

/// A server on a free port of loopback, and its address.
fn mocap_server(protocol: MocapProtocol) -> Result<(MocapServer, String), Failure> {
    let loopback = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    match protocol {
        MocapProtocol::Vrpn => {
            let server = MocapServer::vrpn(loopback).or_internal()?;
            let address = format!("vrpn:{}", server.address());
            Ok((server, address))
        }
        MocapProtocol::Natnet => {
            let names: Vec<String> = rig_bodies().names().into();
            // The port that clients are sent to must be free on their machine: this one.
            let data = UdpSocket::bind(loopback).or_internal()?;
            let port = data.local_addr().or_internal()?.port();
            drop(data);
            let server = MocapServer::natnet(loopback, port, &names).or_internal()?;
            let address = format!("natnet:{}", server.address());
            Ok((server, address))
        }
    }
}

/// The arm's firmware from `image`, on an emulated board.
fn board(image: &Path) -> Result<EmulatedBoard, Failure> {
    if !image.is_file() {
        return bad_input(format!("--arm-firmware {}: no such file", image.display()));
    }
    EmulatedBoard::start(image)
        .context("cannot start qemu-system-arm")
        .or_input()
}
