//! `flyvine mocap`: what a motion-capture server sends, and how well.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use flyvine_link::mocap::{
    Address, Bodies, BodyStatus, HygieneLimits, Incoming, MocapSource, MocapStatus, Sink,
};

use crate::console::{print, print_json, say, table};
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// Look at a motion-capture server: which bodies it sends, how often, how late, and what is wrong with them.
///
/// Exit code 3 if no server answers, or a body of the TOML file does not come.
///
///   flyvine mocap --vrpn 192.168.1.10
///   flyvine mocap --natnet motive --bodies bodies.toml --duration 30 --record wand.csv
///
/// The body file says which body is the quadrotor and which the end effector; see examples/mocap/bodies.toml.
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct MocapArguments {
    /// VRPN server: HOST, HOST:PORT, or tcp://HOST:PORT where UDP does not get through.
    #[arg(
        long,
        value_name = "HOST",
        required_unless_present = "natnet",
        conflicts_with = "natnet"
    )]
    vrpn: Option<String>,
    /// NatNet server (OptiTrack Motive): HOST or HOST:PORT.
    #[arg(long, value_name = "HOST")]
    natnet: Option<String>,
    /// Which body is which, axes and marker frames.
    #[arg(long, value_name = "BODIES.toml")]
    bodies: Option<PathBuf>,
    /// How long to watch, s.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    duration: f64,
    /// Write every pose as it comes: server time, arrival, body, pose in the server's axes.
    #[arg(long, value_name = "OUT.csv")]
    record: Option<PathBuf>,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine mocap`.
pub fn run(arguments: &MocapArguments) -> CommandResult {
    let address = match (&arguments.vrpn, &arguments.natnet) {
        (Some(host), _) => host.parse().map(Address::Vrpn),
        (None, host) => host.as_deref().unwrap_or_default().parse().map(Address::NatNet),
    }
    .or_input()?;
    if !(0.1..=86_400.0).contains(&arguments.duration) {
        let found = arguments.duration;
        return bad_input(format!("--duration: found {found}, expected 0.1 … 86400 s"));
    }
    let bodies = arguments
        .bodies
        .as_deref()
        .map(Bodies::read)
        .transpose()
        .or_input()?;
    let recorder = arguments.record.as_deref().map(Recorder::create).transpose()?;
    let tap = recorder.clone().map(|recorder| -> Sink {
        Arc::new(move |incoming| recorder.lock().expect("no thread panics with it").take(&incoming))
    });

    let source = MocapSource::start(&address, bodies, HygieneLimits::default(), tap).or_input()?;
    watch(&source, Duration::from_secs_f64(arguments.duration));
    let status = source.status(Instant::now());
    drop(source);
    if let (Some(recorder), Some(path)) = (recorder, &arguments.record) {
        let rows = recorder
            .lock()
            .expect("no thread panics with it")
            .finish()
            .or_internal()?;
        say(&format!("wrote {rows} poses to {}", path.display()));
    }
    if arguments.json {
        print_json(&status)?;
    } else {
        print(&report(&status))?;
    }
    Ok(outcome(&status))
}

/// Waits, and says once a second how it goes.
fn watch(source: &MocapSource, duration: Duration) {
    let end = Instant::now() + duration;
    let mut server = String::new();
    loop {
        let now = Instant::now();
        let status = source.status(now);
        if status.server != server {
            server.clone_from(&status.server);
            say(&format!(
                "{}: {server}",
                if status.connected { "connected" } else { "waiting" }
            ));
        }
        let left = end.saturating_duration_since(now);
        if left.is_zero() {
            return;
        }
        thread::sleep(left.min(Duration::from_secs(1)));
    }
}

/// Whether the result is to be trusted; stderr says why not.
fn outcome(status: &MocapStatus) -> Outcome {
    let missing: Vec<&str> = status
        .bodies
        .iter()
        .filter(|body| body.received == 0)
        .map(|body| &*body.name)
        .collect();
    if !status.connected {
        say(&format!("no motion capture: {}", status.server));
        Outcome::Untrusted
    } else if status.bodies.is_empty() {
        say("the server sends no bodies: are any defined, and does it stream?");
        Outcome::Untrusted
    } else if !missing.is_empty() {
        say(&format!("nothing came of {}", missing.join(" and ")));
        Outcome::Untrusted
    } else {
        Outcome::Done
    }
}

fn report(status: &MocapStatus) -> String {
    let mut text = status.server.clone();
    if let Some(clock) = status.clock {
        text += &format!(
            "\nserver's clock: drift {:+.1} ppm over {:.0} s, set {} times",
            clock.drift_ppm, clock.window_s, clock.steps
        );
    }
    let header = [
        "body",
        "role",
        "poses",
        "Hz",
        "late: median ms",
        "p99 ms",
        "gap ms",
        "age ms",
        "position m",
        "found",
    ];
    let rows = status.bodies.iter().map(row);
    format!("{text}\n{}", table(&header, rows))
}

fn row(body: &BodyStatus) -> Vec<String> {
    let milliseconds =
        |seconds: Option<f64>| seconds.map_or("–".to_owned(), |seconds| format!("{:.1}", 1e3 * seconds));
    vec![
        body.name.clone(),
        body.role.unwrap_or("–").to_owned(),
        body.received.to_string(),
        body.rate_hz.map_or("–".to_owned(), |rate| format!("{rate:.1}")),
        milliseconds(body.delay_median_s),
        milliseconds(body.delay_p99_s),
        milliseconds(Some(body.longest_gap_s)),
        milliseconds(body.age_s),
        body.position_m
            .map_or("–".to_owned(), |[x, y, z]| format!("{x:.3} {y:.3} {z:.3}")),
        body.faults.to_string(),
    ]
}

/// Writes poses to a CSV file as they come.
struct Recorder {
    file: BufWriter<File>,
    begun: Instant,
    rows: u64,
    failed: Option<std::io::Error>,
}

impl Recorder {
    fn create(path: &Path) -> Result<Arc<Mutex<Self>>, Failure> {
        let mut file = BufWriter::new(File::create(path).or_internal()?);
        writeln!(file, "server_s,arrived_s,body,x,y,z,qw,qx,qy,qz,tracked").or_internal()?;
        Ok(Arc::new(Mutex::new(Recorder {
            file,
            begun: Instant::now(),
            rows: 0,
            failed: None,
        })))
    }

    /// Errors are kept for [`Recorder::finish`].
    fn take(&mut self, incoming: &Incoming) {
        let Incoming::Frame(frame, arrived) = incoming else {
            return;
        };
        let arrived_s = arrived.saturating_duration_since(self.begun).as_secs_f64();
        for body in &frame.bodies {
            let [x, y, z] = body.position;
            let [qw, qx, qy, qz] = body.attitude;
            // A name is the server's: quoted, it cannot break the row.
            let name = body.name.replace('"', "\"\"");
            let written = writeln!(
                self.file,
                "{:.6},{arrived_s:.6},\"{name}\",{x},{y},{z},{qw},{qx},{qy},{qz},{}",
                frame.captured_s, body.tracked
            );
            match written {
                Ok(()) => self.rows += 1,
                Err(error) => {
                    self.failed.get_or_insert(error);
                }
            }
        }
    }

    fn finish(&mut self) -> std::io::Result<u64> {
        match self.failed.take() {
            Some(error) => Err(error),
            None => self.file.flush().map(|()| self.rows),
        }
    }
}
