//! Flights with faults under a virtual clock, judged from the vehicle's end of the wires.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;

use flyvine::DT;
use flyvine::control::supervisor::{EventKind, Limits, Reason, Room};
use flyvine::control::{AbortCause, End, FlightOutcome, OpenLoop, Trajectory, fly_watched};
use flyvine::link::VehicleError;
use flyvine::sim::SimulatedVehicle;

use super::fault::{FaultKind, Phase, Script, ScriptedFault};
use super::px4::ReceivedSetpoint;
use super::rig::Rig;
use super::virtual_station::{LateController, SharedRig, virtual_station};
use crate::autopilot::{AutopilotVehicle, Flags, LinkOptions, MonotonicClock, TickReport};
use crate::recording::{FlightLog, FlightRecorder, PlannedPaths, RecordingError};

/// A set-point that moves by less than this from the one before it is a hold, m.
const HOLD_M: f64 = 1e-6;
/// A pose older than this, s, may not move the set-point any more: the hard limit and the tick in which it is noticed.
const STALE_S: f64 = 0.4 + DT;
/// Set-points are sent with the precision of a float, m.
const PRECISION_M: f64 = 1e-6;
/// How long after the base station has gone the vehicle's end is watched, s.
const AFTERMATH_S: f64 = 12.0;

/// What one flight is made of.
pub struct RehearsedFlight<'a> {
    /// What is flown, open loop.
    pub trajectory: &'a Trajectory,
    /// The vehicle that is flown.
    pub vehicle: &'a SimulatedVehicle,
    /// Seed of its noise.
    pub seed: u64,
    /// What goes wrong.
    pub script: Script,
    /// Within which limits.
    pub limits: Limits,
    /// Where to put it down (MCAP); nowhere if left out.
    pub recording: Option<&'a Path>,
}

/// What became of it.
pub struct Verdict {
    /// The flight as the base station saw it.
    pub outcome: FlightOutcome,
    /// How the ticks were kept.
    pub ticks: Option<TickReport>,
    /// Set-points that were sent.
    pub setpoints: usize,
    /// Those outside the room.
    pub outside: usize,
    /// Those that still moved when the pose was older than the hard limit.
    pub stale: usize,
    /// From the fault to the abort, s; `None` without either.
    pub abort_after_s: Option<f64>,
    /// When the fault came, s.
    pub fault_s: Option<f64>,
    /// Whether the motors are off at the end, with the vehicle on the ground.
    pub down: bool,
}

impl Verdict {
    /// The supervisor's reason, if it ended the flight.
    pub fn reason(&self) -> Option<Reason> {
        match self.outcome.end {
            End::Aborted {
                cause: AbortCause::Supervisor(reason),
                ..
            } => Some(reason),
            _ => None,
        }
    }
}

/// The default limits with the silence of autopilot and arm watched, as a flight over wires wants them.
pub fn wired_limits() -> Limits {
    Limits {
        autopilot_silence_s: Some(0.3),
        arm_silence_s: Some(0.3),
        ..Limits::default()
    }
}

/// A script of one fault that stays.
pub fn one_fault(kind: FaultKind, phase: Phase, after_s: f64) -> Script {
    Script {
        fault: vec![ScriptedFault {
            kind,
            phase,
            after_s,
            duration_s: None,
        }],
    }
}

/// Flies it.
pub fn rehearse(flight: &RehearsedFlight) -> Result<Verdict, VehicleError> {
    let trajectory = flight.trajectory;
    let rig = Rig::new(
        flight.vehicle.clone(),
        trajectory.configuration(0),
        flight.seed,
        None,
        flight.script.clone(),
    )?;
    let rig: SharedRig = Rc::new(RefCell::new(rig));
    let flags = Flags::default();
    let mut vehicle = AutopilotVehicle::new(
        LinkOptions::default(),
        virtual_station(&rig, &flags),
        flags,
        trajectory.clone(),
        flight.limits,
    );
    let mut open_loop = OpenLoop::new(trajectory);
    let mut controller = LateController::new(&mut open_loop, &rig);
    let log = flight
        .recording
        .map(|path| start_log(path, &mut vehicle))
        .transpose();
    let log = log.map_err(|error| refused(&error))?;
    let outcome = fly_watched(
        trajectory,
        &mut controller,
        flight.limits,
        &mut vehicle,
        flight.seed,
        &mut |_, _| ControlFlow::Continue(()),
        &mut |flown| log.iter().for_each(|log| log.borrow_mut().row(flown)),
    )
    .map_err(|error| refused(&error))?;
    if let Some(log) = log {
        log.borrow_mut().finish().map_err(|error| refused(&error))?;
    }
    let ticks = vehicle.tick_report();
    let end_s = rig.borrow().now_s();
    // What the vehicle does when nobody is there any more.
    rig.borrow_mut().advance_to(end_s + AFTERMATH_S)?;
    let mut rig = rig.borrow_mut();
    let fault_s = rig.faults().first_begun_s();
    let received = rig.px4.take_received();
    let stale_from_s = match flight.script.fault.first().map(|fault| fault.kind) {
        Some(FaultKind::MocapStale | FaultKind::MocapFrozen | FaultKind::VehicleKilled) => fault_s,
        _ => None,
    };
    let aborted_s = outcome.events.iter().find_map(|event| match event.kind {
        EventKind::Aborted(_) => Some(event.t_s),
        _ => None,
    });
    Ok(Verdict {
        ticks,
        setpoints: received.len(),
        outside: received
            .iter()
            .filter(|setpoint| !nearly_in(&flight.limits.room, setpoint.position))
            .count(),
        stale: stale_from_s.map_or(0, |from_s| moving_after(&received, from_s + STALE_S)),
        abort_after_s: fault_s
            .zip(aborted_s)
            .map(|(fault_s, aborted_s)| aborted_s - fault_s),
        fault_s,
        down: !rig.px4.is_armed() && rig.stands(),
        outcome,
    })
}

/// Puts down a flight under a virtual clock, which is much too fast for a disk to be called slow.
fn start_log(path: &Path, vehicle: &mut AutopilotVehicle) -> Result<Rc<RefCell<FlightLog>>, RecordingError> {
    let recorder = FlightRecorder::create(path, 0, &PlannedPaths::default(), Arc::default())?;
    let log = Rc::new(RefCell::new(FlightLog::new(recorder, MonotonicClock::start())));
    let hears = Rc::clone(&log);
    vehicle.listen(Box::new(move |heard| hears.borrow_mut().hear(heard)));
    Ok(log)
}

fn refused(error: &dyn std::error::Error) -> VehicleError {
    VehicleError::Refused {
        what: error.to_string(),
    }
}

/// Whether a set-point that travelled as floats is in the room.
fn nearly_in(room: &Room, position: [f64; 3]) -> bool {
    let nearest = room.clip(position);
    (0..3).all(|axis| (position[axis] - nearest[axis]).abs() <= PRECISION_M)
}

/// Set-points after `time_s` that are followed and not where the one before them was.
fn moving_after(received: &[ReceivedSetpoint], time_s: f64) -> usize {
    let moves = |pair: &&[ReceivedSetpoint]| {
        let [before, after] = [pair[0].position, pair[1].position];
        (0..3).any(|axis| (after[axis] - before[axis]).abs() > HOLD_M)
    };
    received
        .windows(2)
        .filter(|pair| pair[0].t_s > time_s && pair[1].followed)
        .filter(moves)
        .count()
}
