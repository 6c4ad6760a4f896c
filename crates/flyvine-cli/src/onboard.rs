//! `flyvine onboard`: the companion computer's daemon.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Args, ValueEnum};
use flyvine_link::arm::{DEFAULT_BAUD, LegacyOptions, Terminator};
use flyvine_link::onboard::{ArmPort, ArmProtocol, FcuPort, OnboardError, Traffic, run as bridge};
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::console::{print, print_json, say, table};
use crate::outcome::{Blame, CommandResult, Failure, Outcome};

/// Bridge a serial arm and a serial autopilot to the network; runs on the companion computer.
///
/// The base station reaches the arm at the arm's address (`udp:HOST:PORT`; one datagram carries whole frames) and the
/// autopilot at the other (MAVLink packets, unchanged both ways). Everything stays on loopback unless other addresses
/// are given:
///
///   flyvine onboard --arm /dev/ttyACM0 --fcu /dev/ttyS1
///   flyvine onboard --arm /dev/ttyACM0 --arm-listen 192.168.1.20:14700 --fcu /dev/ttyS1 --fcu-peer 192.168.1.10:14540
///   flyvine onboard --arm /dev/ttyACM0 --arm-protocol legacy --legacy-growth 350 --legacy-terminator both
///
/// Nobody is asked for a password: whoever reaches the addresses commands the vehicle. Ctrl-C and SIGTERM stop the arm
/// and end the daemon; exit code 3 if the arm did not acknowledge its stop.
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct OnboardArguments {
    /// The arm's serial port.
    #[arg(long, value_name = "PATH", required_unless_present = "fcu")]
    arm: Option<PathBuf>,
    /// Its baud rate.
    #[arg(long, value_name = "BAUD", default_value_t = DEFAULT_BAUD)]
    arm_baud: u32,
    /// What it speaks: frames with checksum and acknowledgement, or the prototype's `g<number>` and `p<number>`.
    #[arg(long, value_enum, default_value_t = Protocol::Framed)]
    arm_protocol: Protocol,
    /// Where the arm's datagrams are received.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:14700")]
    arm_listen: SocketAddr,
    #[command(flatten)]
    legacy: LegacyArguments,
    /// The autopilot's serial port.
    #[arg(long, value_name = "PATH")]
    fcu: Option<PathBuf>,
    /// Its baud rate.
    #[arg(long, value_name = "BAUD", default_value_t = 921_600)]
    fcu_baud: u32,
    /// Where the autopilot's datagrams are received, and sent from.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:14580")]
    fcu_listen: SocketAddr,
    /// Where the autopilot's packets go until somebody else sends a datagram.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:14540")]
    fcu_peer: SocketAddr,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct LegacyArguments {
    /// Legacy arm: the number after `g` for a growth rate of 1 m/s. Unpublished: try it on a bench.
    #[arg(long, value_name = "NUMBER", default_value_t = LegacyOptions::default().growth_per_m_s)]
    legacy_growth: f64,
    /// Legacy arm: the number after `p` for 1 kPa.
    #[arg(long, value_name = "NUMBER", default_value_t = LegacyOptions::default().pressure_per_kpa)]
    legacy_pressure: f64,
    /// Legacy arm: greatest number after `g`, either way.
    #[arg(long, value_name = "NUMBER", default_value_t = LegacyOptions::default().greatest_growth)]
    legacy_greatest_growth: f64,
    /// Legacy arm: greatest number after `p`.
    #[arg(long, value_name = "NUMBER", default_value_t = LegacyOptions::default().greatest_pressure)]
    legacy_greatest_pressure: f64,
    /// Legacy arm: digits after the decimal point.
    #[arg(long, value_name = "DIGITS", default_value_t = LegacyOptions::default().decimals)]
    legacy_decimals: usize,
    /// Legacy arm: what ends a command.
    #[arg(long, value_enum, default_value_t = LineEnd::Lf)]
    legacy_terminator: LineEnd,
}

#[derive(Clone, Copy, ValueEnum)]
enum Protocol {
    Framed,
    Legacy,
}

#[derive(Clone, Copy, ValueEnum)]
enum LineEnd {
    None,
    Lf,
    Cr,
    Both,
}

/// Runs `flyvine onboard`.
pub fn run(arguments: &OnboardArguments) -> CommandResult {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).or_internal()?;
    }
    let arm = arguments.arm.clone().map(|path| ArmPort {
        path,
        baud: arguments.arm_baud,
        protocol: match arguments.arm_protocol {
            Protocol::Framed => ArmProtocol::Framed,
            Protocol::Legacy => ArmProtocol::Legacy(arguments.legacy.options()),
        },
        listen: arguments.arm_listen,
    });
    let fcu = arguments.fcu.clone().map(|path| FcuPort {
        path,
        baud: arguments.fcu_baud,
        listen: arguments.fcu_listen,
        peer: arguments.fcu_peer,
    });
    let result = bridge(arm.as_ref(), fcu.as_ref(), &stop, &mut |event| {
        say(&event.to_string())
    });
    let summary = result.map_err(|error| match error {
        OnboardError::Wait(_) => Failure::Internal(error.into()),
        _ => Failure::Input(error.into()),
    })?;
    if arguments.json {
        print_json(&serde_json::json!({
            "arm": summary.arm.map(traffic_json),
            "arm_stopped": summary.arm_stopped,
            "fcu": summary.fcu.map(traffic_json),
        }))?;
    } else {
        let rows = [("arm", summary.arm), ("autopilot", summary.fcu)];
        let rows = rows
            .into_iter()
            .filter_map(|(name, traffic)| Some(traffic_row(name, traffic?)));
        let header = ["", "from serial", "to serial", "rejected", "dropped"];
        print(&table(&header, rows))?;
    }
    Ok(match summary.arm_stopped {
        Some(false) => Outcome::Untrusted,
        Some(true) | None => Outcome::Done,
    })
}

impl LegacyArguments {
    fn options(&self) -> LegacyOptions {
        LegacyOptions {
            terminator: match self.legacy_terminator {
                LineEnd::None => Terminator::None,
                LineEnd::Lf => Terminator::LineFeed,
                LineEnd::Cr => Terminator::CarriageReturn,
                LineEnd::Both => Terminator::Both,
            },
            growth_per_m_s: self.legacy_growth,
            greatest_growth: self.legacy_greatest_growth,
            pressure_per_kpa: self.legacy_pressure,
            greatest_pressure: self.legacy_greatest_pressure,
            decimals: self.legacy_decimals,
            ..LegacyOptions::default()
        }
    }
}

fn traffic_row(name: &str, traffic: Traffic) -> Vec<String> {
    let counts = [
        traffic.from_serial,
        traffic.to_serial,
        traffic.rejected,
        traffic.dropped,
    ];
    std::iter::once(name.to_owned())
        .chain(counts.map(|count| count.to_string()))
        .collect()
}

fn traffic_json(traffic: Traffic) -> serde_json::Value {
    serde_json::json!({
        "from_serial": traffic.from_serial,
        "to_serial": traffic.to_serial,
        "rejected": traffic.rejected,
        "dropped": traffic.dropped,
    })
}
