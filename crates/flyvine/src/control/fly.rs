//! One flight of a trajectory on a vehicle in lockstep.

use std::ops::ControlFlow;
use std::time::Instant;

use super::supervisor::{Event, EventKind, Limits, Mode, Reason, Start, State, Supervisor, SupervisorError};
use super::{Controller, Proposal, Tick, Trajectory};
use crate::DT;
use crate::flight::{ControlStep, Flight, Sample};
use crate::link::{Vehicle, VehicleError};

/// What became of a flight. The recording is there whatever the end.
#[derive(Debug)]
pub struct FlightOutcome {
    /// Row k: the poses that the vehicle reported at t_k and the command issued then. N rows for a completed
    /// flight of N knots; up to the fault for an aborted one, and then the rows in which the position was
    /// held.
    pub flight: Flight,
    /// How it ended.
    pub end: End,
    /// What the controller reported of its steps, in order.
    pub steps: Vec<ControlStep>,
    /// What the supervisor had to say, in order.
    pub events: Vec<Event>,
    /// Error of the vehicle while the position was held after an abort.
    pub hold_error: Option<VehicleError>,
}

/// How a flight ended.
#[derive(Debug)]
pub enum End {
    /// All knots were flown.
    Completed,
    /// The flight was cut short.
    Aborted {
        /// When, s.
        t_s: f64,
        /// Why.
        cause: AbortCause,
    },
}

/// Who ended a flight, and why.
#[derive(Debug, thiserror::Error)]
pub enum AbortCause {
    /// The supervisor.
    #[error(transparent)]
    Supervisor(#[from] Reason),
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
}

/// One row of a flight under way, as [`fly_watched`] tells it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlownRow<'a> {
    /// Row, from 0.
    pub row: usize,
    /// Knots of the plan.
    pub knots: usize,
    /// What the recording keeps of it: poses as the vehicle reported them, and the command that goes out.
    pub sample: &'a Sample,
    /// Where the flight stands.
    pub state: State,
    /// Why it was ended, if it was.
    pub reason: Option<Reason>,
    /// What the supervisor had to say since the last row.
    pub events: &'a [Event],
    /// What the controller reported of its step.
    pub step: Option<&'a ControlStep>,
}

/// Flies `trajectory` on `vehicle`: N knots make N rows, the last repeating the final command.
///
/// Every command passes a [`Supervisor`] with these `limits`. After an abort the position is held for
/// [`Limits::hold_s`]; then the flight ends, since a vehicle in lockstep has no autopilot modes to fall back
/// on. `progress` is called with the knot and the number of knots before each command and may stop the
/// flight. An `Err` means that nothing was flown: the limits are bad, or the plan starts outside the room.
pub fn fly(
    trajectory: &Trajectory,
    controller: &mut dyn Controller,
    limits: Limits,
    vehicle: &mut dyn Vehicle,
    seed: u64,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<FlightOutcome, SupervisorError> {
    fly_watched(
        trajectory,
        controller,
        limits,
        vehicle,
        seed,
        progress,
        &mut |_| (),
    )
}

/// [`fly()`], with `watch` told of every row right before its command goes out. It runs in the flight loop and must not
/// block.
pub fn fly_watched(
    trajectory: &Trajectory,
    controller: &mut dyn Controller,
    limits: Limits,
    vehicle: &mut dyn Vehicle,
    seed: u64,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
    watch: &mut dyn FnMut(&FlownRow),
) -> Result<FlightOutcome, SupervisorError> {
    let (quadrotor, end_effector) = trajectory.start();
    let mut supervisor = Supervisor::new(
        limits,
        Start {
            t_s: 0.0,
            quadrotor,
            end_effector,
        },
    )?;
    let mut samples = Vec::with_capacity(trajectory.knots());
    let mut steps: Vec<ControlStep> = Vec::with_capacity(trajectory.knots());
    let mut events = Vec::new();
    let mut vehicle_error = None;
    let last_knot = trajectory.knots() - 1;

    let mut configuration = trajectory.configuration(0);
    let mut answer = vehicle.reset(configuration, seed);
    for row in 0.. {
        let observation = match answer {
            Ok(observation) => observation,
            Err(error) => {
                vehicle_error = Some(error);
                break;
            }
        };
        let t_s = row as f64 * DT;
        if supervisor.reason().is_none() {
            configuration = trajectory.configuration(row);
            if progress(row, trajectory.knots()).is_break() {
                supervisor.abort(Reason::Operator);
            }
        }
        let held_command = supervisor.setpoint();
        let credible = supervisor.observe(t_s, &observation, configuration);
        if row == 0 {
            controller.prepare(&credible);
        }
        let proposal = if supervisor.reason().is_none() && row < last_knot {
            let started = Instant::now();
            let proposal = controller.propose(&Tick {
                knot: row,
                observation: credible,
                held_command,
            });
            let step_ms = 1e3 * started.elapsed().as_secs_f64();
            steps.extend(
                controller
                    .report()
                    .map(|report| ControlStep { row, step_ms, report }),
            );
            proposal
        } else {
            Proposal::Command(held_command)
        };
        let order = supervisor.decide(t_s, proposal);
        let (Some(command), Mode::Offboard) = (order.setpoint, order.mode) else {
            break;
        };
        samples.push(Sample {
            t_s,
            configuration,
            command,
            command_velocity: None,
            quadrotor: observation.quadrotor,
            end_effector: observation.end_effector,
        });
        let told = events.len();
        events.extend(supervisor.take_events());
        watch(&FlownRow {
            row,
            knots: trajectory.knots(),
            sample: &samples[row],
            state: supervisor.state(),
            reason: supervisor.reason(),
            events: &events[told..],
            step: steps.last().filter(|step| step.row == row),
        });
        if row == last_knot && supervisor.reason().is_none() {
            break;
        }
        answer = vehicle.step(command, configuration);
    }

    events.extend(supervisor.take_events());
    let aborted = events.iter().find_map(|event| match event.kind {
        EventKind::Aborted(reason) => Some((event.t_s, reason)),
        _ => None,
    });
    let (end, hold_error) = match (aborted, vehicle_error) {
        (Some((t_s, reason)), error) => (
            End::Aborted {
                t_s,
                cause: reason.into(),
            },
            error,
        ),
        (None, Some(error)) => {
            let t_s = samples.last().map_or(0.0, |sample| sample.t_s);
            (
                End::Aborted {
                    t_s,
                    cause: error.into(),
                },
                None,
            )
        }
        (None, None) => (End::Completed, None),
    };
    let flight = Flight {
        name: "flight".into(),
        samples,
    };
    Ok(FlightOutcome {
        flight,
        end,
        steps,
        events,
        hold_error,
    })
}

#[cfg(test)]
mod tests;
