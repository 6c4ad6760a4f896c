//! Flights with faults over the link's own codecs, under a virtual clock: every fault in every phase.
//!
//! The fast version runs with one seed. All of it (20 seeds, 1920 flights), with a table:
//! `cargo test --release --workspace --test campaign -- --ignored --nocapture`

#![allow(clippy::print_stdout)] // what was measured or skipped

use std::collections::BTreeMap;
use std::path::Path;

use flyvine::DT;
use flyvine::control::supervisor::Reason;
use flyvine::control::{End, Trajectory};
use flyvine::flight::{Configuration, Flight, Problem, Sample, read_flight};
use flyvine::link::Feedforward;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine_link::rehearsal::{
    FaultKind, Phase, RehearsedFlight, Script, Verdict, one_fault, rehearse, wired_limits,
};

const SHORT: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};

/// A trajectory of bare commands that starts at (0, 0, 1.5).
fn trajectory(
    knots: usize,
    command: impl Fn(f64) -> [f64; 3],
    configuration: impl Fn(f64) -> Configuration,
) -> Trajectory {
    let configurations: Vec<Configuration> = (0..knots).map(|k| configuration(k as f64 * DT)).collect();
    let rest = vec![
        0.0,
        0.0,
        1.5,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.5 - configurations[0].length_m,
    ];
    let unbounded = f64::INFINITY;
    Trajectory::new(
        (0..knots - 1).map(|k| command(k as f64 * DT)).collect(),
        vec![rest; knots],
        Vec::new(),
        configurations,
        [-unbounded; 3],
        [unbounded; 3],
    )
    .unwrap()
}

/// The slow lemniscate, cut short.
fn tracking() -> Trajectory {
    let command = |t: f64| {
        let phase = 0.2 * std::f64::consts::PI * if t < 2.0 { t * t / 4.0 } else { t - 1.0 };
        [0.9 * phase.sin(), phase.cos() * phase.sin(), 1.5]
    };
    trajectory(100, command, |_| SHORT)
}

/// The back-and-forth of a swing.
fn swing() -> Trajectory {
    let command = |t: f64| {
        let x = match (t / DT).round() as usize {
            k @ ..8 => -0.1 * k as f64,
            8..14 => -0.8,
            k @ 14..22 => -0.8 + 0.2 * (k - 14) as f64,
            22..30 => 0.8,
            k => (0.8 - 0.08 * (k - 30) as f64).max(0.0),
        };
        [x, 0.0, 1.5]
    };
    trajectory(50, command, |_| SHORT)
}

/// The beginning of a deployment: the arm grows by 5 cm and fills.
fn deploy() -> Trajectory {
    let grown = |t: f64| Configuration {
        length_m: 0.7 + 0.015 * t,
        pressure_kpa: 0.02 * t,
    };
    let command = |t: f64| [0.3 * (0.6 * t).sin(), 0.0, 1.5 + 0.015 * t];
    trajectory(70, command, grown)
}

/// Where the faults come: trajectory, phase, and how long after the phase has begun, s.
fn places() -> Vec<(&'static str, Trajectory, Phase, f64)> {
    vec![
        ("pre-arm", tracking(), Phase::PreArm, 0.5),
        ("take-off", tracking(), Phase::TakeOff, 1.0),
        ("tracking", tracking(), Phase::Flight, 2.0),
        ("swing", swing(), Phase::Flight, 0.9),
        ("deploy", deploy(), Phase::Flight, 1.5),
        ("land", tracking(), Phase::Land, 0.4),
    ]
}

fn fly(vehicle: &SimulatedVehicle, trajectory: &Trajectory, seed: u64, script: Script) -> Verdict {
    fly_recorded(vehicle, trajectory, seed, script, None)
}

fn fly_recorded(
    vehicle: &SimulatedVehicle,
    trajectory: &Trajectory,
    seed: u64,
    script: Script,
    recording: Option<&Path>,
) -> Verdict {
    rehearse(&RehearsedFlight {
        trajectory,
        vehicle,
        seed,
        script,
        limits: wired_limits(),
        recording,
    })
    .unwrap()
}

/// How far a body moves between the frame that the flight loop had and the row's own time, m.
const FRAME_M: f64 = 0.05;

/// Whether the file has the flight's rows; poses that are none are left out of it, and ticks that catch up in no time. Its poses
/// are those of the rows' own times.
fn is_intact(recording: &Path, flight: &Flight) -> bool {
    let possible = |sample: &Sample| {
        let is_finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
        Sample {
            quadrotor: sample.quadrotor.filter(|pose| is_finite(&pose.position)),
            end_effector: sample.end_effector.filter(|tip| is_finite(tip)),
            ..*sample
        }
    };
    let mut expected: Vec<Sample> = flight.samples.iter().map(possible).collect();
    expected.dedup_by_key(|sample| sample.t_s);
    match read_flight(recording) {
        Ok(found) => {
            let pairs = found.samples.iter().zip(&expected);
            found.samples.len() == expected.len()
                && pairs.into_iter().all(|(found, flown)| is_row(found, flown))
        }
        Err(error) => expected.is_empty() && matches!(*error.problem, Problem::NoRows),
    }
}

fn is_row(found: &Sample, flown: &Sample) -> bool {
    let near = |found: Option<[f64; 3]>, flown: Option<[f64; 3]>| match (found, flown) {
        (Some(found), Some(flown)) => (0..3).all(|i| (found[i] - flown[i]).abs() <= FRAME_M),
        (found, flown) => found.is_none() && flown.is_none(),
    };
    let position = |sample: &Sample| sample.quadrotor.map(|pose| pose.position);
    (found.t_s, found.configuration, found.command) == (flown.t_s, flown.configuration, flown.command)
        && found.command_velocity == flown.command_velocity
        && near(position(found), position(flown))
        && near(found.end_effector, flown.end_effector)
}

/// What a fault must lead to.
#[derive(Clone, Copy, PartialEq)]
enum Expected {
    /// The flight goes on.
    Completed,
    /// An abort within the time that the fault allows.
    Abort,
    /// An abort at some time, or none: it is not this fault's to be noticed here, or there is nobody left to notice.
    Either,
}

fn expected(kind: FaultKind, name: &str) -> Expected {
    let is_controlled = matches!(name, "tracking" | "swing" | "deploy");
    match kind {
        FaultKind::LinkReorder => Expected::Completed,
        // Nobody asks a controller in landing; on the ground and on the way up, it is late once it is asked.
        FaultKind::SolverLate if name == "land" => Expected::Completed,
        FaultKind::SolverLate if !is_controlled => Expected::Either,
        // A mode that nobody follows yet is nobody's to lose.
        FaultKind::PilotTakesOver if name == "pre-arm" => Expected::Completed,
        // A pose that repeats while neither the command nor the other body moves is a vehicle at rest.
        FaultKind::MocapFrozen if matches!(name, "pre-arm" | "land") => Expected::Either,
        FaultKind::BaseKilled => Expected::Either,
        _ => Expected::Abort,
    }
}

/// What must hold whatever goes wrong, and what this fault must lead to.
fn judge(name: &str, kind: FaultKind, verdict: &Verdict, recording: &Path) -> Result<(), String> {
    let fail = |what: &str| {
        let events: Vec<String> = verdict.outcome.events.iter().map(ToString::to_string).collect();
        let fault_s = verdict.fault_s.unwrap_or(f64::NAN);
        Err(format!(
            "{kind:?} in {name} at {fault_s:.3} s: {what}\n  {}",
            events.join("\n  ")
        ))
    };
    if verdict.fault_s.is_none() {
        return fail("the fault never came");
    }
    if verdict.outside > 0 {
        return fail("set-points outside the room");
    }
    // Before the first set-point moves, a pose that repeats is a vehicle at rest: its age runs from that move.
    let is_at_rest = kind == FaultKind::MocapFrozen && name == "pre-arm";
    if verdict.stale > 0 && !is_at_rest {
        return fail("set-points moved on stale poses");
    }
    // The pilot has it.
    if !verdict.down && kind != FaultKind::PilotTakesOver {
        return fail("the vehicle is not on the ground with its motors off");
    }
    if !is_intact(recording, &verdict.outcome.flight) {
        return fail("the recording is not intact");
    }
    match (expected(kind, name), &verdict.outcome.end) {
        (Expected::Completed, End::Completed) | (Expected::Either, _) => Ok(()),
        (Expected::Completed, End::Aborted { .. }) => fail("aborted for no reason"),
        (Expected::Abort, _) => match verdict.abort_after_s.zip(kind.abort_limit_s()) {
            // Rounding of multiples of 5 ms aside.
            Some((after_s, limit_s)) if after_s <= limit_s + DT + 1e-9 => Ok(()),
            Some((after_s, _)) => fail(&format!("aborted after {after_s:.3} s")),
            None => fail("no abort"),
        },
    }
}

/// One fault in one place, over all seeds.
#[derive(Default)]
struct Cell {
    flights: usize,
    aborted: usize,
    latest_s: f64,
}

/// In how many flights of how many there was an abort, and the latest after the fault, ms.
fn describe(cell: &Cell) -> String {
    match cell.aborted {
        0 => "flown".to_owned(),
        aborted => format!("{aborted}/{} {:.0}", cell.flights, 1e3 * cell.latest_s),
    }
}

fn columns(cells: &[impl std::fmt::Display]) -> String {
    cells
        .iter()
        .map(|cell| format!(" {:>11}", cell.to_string()))
        .collect()
}

fn campaign(seeds: std::ops::RangeInclusive<u64>) {
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("flight.mcap");
    let (mut flights, mut setpoints, mut broken) = (0, 0, Vec::new());
    let mut table: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (name, trajectory, phase, after_s) in places() {
        for kind in FaultKind::ALL {
            let mut cell = Cell::default();
            for seed in seeds.clone() {
                // Faults come at any time within a tick.
                let script = one_fault(kind, phase, after_s + 0.011 * (seed % 7) as f64);
                let verdict = fly_recorded(&vehicle, &trajectory, seed, script, Some(&recording));
                broken.extend(judge(name, kind, &verdict, &recording).err());
                cell.flights += 1;
                setpoints += verdict.setpoints;
                if let Some(after_s) = verdict.abort_after_s {
                    cell.aborted += 1;
                    cell.latest_s = cell.latest_s.max(after_s);
                }
            }
            flights += cell.flights;
            table
                .entry(format!("{kind:?}"))
                .or_default()
                .push(describe(&cell));
        }
    }
    let names: Vec<&str> = places().iter().map(|place| place.0).collect();
    println!("aborts of flights, and the latest after the fault, ms");
    println!("{:<16}{}", "", columns(&names));
    for (kind, cells) in table {
        println!("{kind:<16}{}", columns(&cells));
    }
    println!(
        "{flights} flights, {setpoints} set-points, {} broke a rule",
        broken.len()
    );
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn without_faults_the_flight_is_flown_and_landed() {
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    for (name, trajectory) in [("tracking", tracking()), ("swing", swing()), ("deploy", deploy())] {
        let verdict = fly(&vehicle, &trajectory, 1, Script::default());
        assert!(
            matches!(verdict.outcome.end, End::Completed),
            "{name}: {:?}",
            verdict.outcome.end
        );
        assert!(verdict.down && verdict.outside == 0);
        assert_eq!(verdict.outcome.flight.samples.len(), trajectory.knots());
        let ticks = verdict.ticks.unwrap();
        assert!(
            ticks.missed == 0 && ticks.jitter_max_ms < 1e-6,
            "{name}: {ticks:?}"
        );
    }
}

#[test]
fn the_same_seed_flies_the_same_flight() {
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let flight = |seed| {
        let script = one_fault(FaultKind::LinkReorder, Phase::PreArm, 0.0);
        fly(&vehicle, &swing(), seed, script).outcome.flight
    };
    assert_eq!(flight(3), flight(3));
    assert_ne!(flight(3), flight(4));
}

#[test]
fn a_missing_parameter_keeps_the_vehicle_on_the_ground() {
    // Without a pose there is no position either: nothing is armed, and the reason says why.
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let verdict = fly(
        &vehicle,
        &swing(),
        1,
        one_fault(FaultKind::MocapStale, Phase::Idle, 0.0),
    );
    let End::Aborted { cause, .. } = &verdict.outcome.end else {
        panic!("{:?}", verdict.outcome.end)
    };
    let text = cause.to_string();
    assert!(
        text.contains("MISSING  mocap: quadrotor: found no pose") && text.contains("older than 400 ms"),
        "{text}"
    );
    assert!(verdict.down && verdict.setpoints == 0);
}

#[test]
fn a_pilot_is_not_fought() {
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let verdict = fly(
        &vehicle,
        &tracking(),
        1,
        one_fault(FaultKind::PilotTakesOver, Phase::Flight, 1.0),
    );
    assert_eq!(
        verdict.reason(),
        Some(Reason::Fault(flyvine::link::Fault::TakenOver))
    );
}

#[test]
fn every_fault_in_every_phase_ends_well() {
    campaign(1..=1);
}

#[test]
#[ignore = "1920 flights: minutes"]
fn every_fault_in_every_phase_ends_well_with_twenty_seeds() {
    campaign(1..=20);
}

/// Set-points with velocities arrive, are followed, and are in the recording; the vehicle is behind them far less.
#[test]
fn velocities_go_over_the_wires() {
    let vehicle = SimulatedVehicle::new(VehicleParameters::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let behind_m = |feedforward: Feedforward| {
        let trajectory = tracking().with_feedforward(feedforward);
        let recording = folder.path().join(format!("{feedforward:?}.mcap"));
        let verdict = fly_recorded(&vehicle, &trajectory, 1, Script::default(), Some(&recording));
        let flight = &verdict.outcome.flight;
        assert!(matches!(verdict.outcome.end, End::Completed) && verdict.down);
        assert!(is_intact(&recording, flight));
        let sends = |sample: &Sample| sample.command_velocity.is_some();
        assert!(
            flight
                .samples
                .iter()
                .all(|row| sends(row) != feedforward.is_none())
        );
        let squares = flight.samples.iter().filter_map(|row| {
            let at = row.quadrotor?.position;
            Some(
                (0..2)
                    .map(|axis| (row.command[axis] - at[axis]).powi(2))
                    .sum::<f64>(),
            )
        });
        (squares.sum::<f64>() / flight.samples.len() as f64).sqrt()
    };
    let (with, without) = (behind_m(Feedforward::Velocity), behind_m(Feedforward::None));
    assert!(
        with < 0.7 * without,
        "{with:.3} m behind with velocities, {without:.3} m without"
    );
}
