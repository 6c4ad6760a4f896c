//! One flight of a trajectory, in lockstep or in real time.

mod take_off;

use std::ops::ControlFlow;
use std::time::Instant;

use super::supervisor::{Event, EventKind, Limits, Mode, Reason, Start, State, Supervisor, SupervisorError};
use super::{Controller, Proposal, Tick, Trajectory};
use crate::DT;
use crate::flight::{ControlStep, Flight, Sample};
use crate::link::{Health, Observation, Vehicle, VehicleError};
use take_off::TakeOff;

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
/// Every command passes a [`Supervisor`] with these `limits`. A vehicle that stands on the ground is first brought to the
/// start, and one in real time lands after the last knot. After an abort the position is held for [`Limits::hold_s`];
/// then a vehicle in lockstep ends the flight, since it has no autopilot modes to fall back on, and one in real time goes
/// down the rest of the abort ladder. `progress` is called with the knot and the number of knots before each command and
/// may stop the flight. An `Err` means that nothing was flown: the limits are bad, or the plan starts outside the room.
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
    )?
    .with_feedforward(trajectory.feedforward());
    let mut samples = Vec::with_capacity(trajectory.knots());
    let mut steps: Vec<ControlStep> = Vec::with_capacity(trajectory.knots());
    let mut events = Vec::new();
    let mut vehicle_error = None;
    let last_knot = trajectory.knots() - 1;

    let mut configuration = trajectory.configuration(0);
    let mut answer = vehicle.reset(configuration, seed);
    let mut take_off = None;
    if let (Ok(observation), Some(health)) = (&answer, vehicle.health()) {
        supervisor = supervise_from(limits, trajectory, observation, &health)?;
        take_off = health.standing.then(|| TakeOff::new(trajectory, health.now_s));
    }
    let mut row = 0;
    let mut origin_s = vehicle.health().map_or(0.0, |health| health.now_s);
    loop {
        let observation = match answer {
            Ok(observation) => observation,
            Err(error) => {
                vehicle_error = Some(error);
                break;
            }
        };
        let health = vehicle.health();
        let now_s = health.map_or(row as f64 * DT, |health| health.now_s);
        if supervisor.reason().is_none() {
            configuration = trajectory.configuration(row.min(last_knot));
            if supervisor.state() != State::Landing && progress(row, trajectory.knots()).is_break() {
                supervisor.abort(Reason::Operator);
            }
        }
        if let Some(health) = &health {
            supervisor.hear(health);
        }
        let held_command = supervisor.setpoint().position;
        let credible = supervisor.observe(now_s, &observation, configuration);
        if let (Some(climb), Some(health)) = (&mut take_off, &health) {
            climb.watch(&mut supervisor, health, &credible);
            if supervisor.state() == State::Flying {
                take_off = None;
                origin_s = now_s;
            }
        }
        let proposal = match &take_off {
            Some(climb) => Proposal::Command(climb.setpoint(held_command)),
            None if supervisor.reason().is_none() && row < last_knot => {
                let observation = Observation {
                    t_s: health.map_or(credible.t_s, |_| now_s - origin_s),
                    ..credible
                };
                if row == 0 {
                    controller.prepare(&observation);
                }
                let started = Instant::now();
                let proposal = controller.propose(&Tick {
                    knot: row,
                    observation,
                    held_command,
                });
                let step_ms = 1e3 * started.elapsed().as_secs_f64();
                steps.extend(
                    controller
                        .report()
                        .map(|report| ControlStep { row, step_ms, report }),
                );
                proposal
            }
            None => Proposal::Command(held_command),
        };
        let order = supervisor.decide(now_s, proposal);
        let Some(setpoint) = order.setpoint else {
            break;
        };
        let sample = Sample {
            t_s: now_s - origin_s,
            configuration,
            command: setpoint.position,
            command_velocity: setpoint.velocity,
            quadrotor: observation.quadrotor,
            end_effector: observation.end_effector,
        };
        let told = events.len();
        events.extend(supervisor.take_events());
        watch(&FlownRow {
            row,
            knots: trajectory.knots(),
            sample: &sample,
            state: supervisor.state(),
            reason: supervisor.reason(),
            events: &events[told..],
            step: steps.last().filter(|step| step.row == row),
        });
        if order.mode == Mode::Offboard && take_off.is_none() {
            samples.push(sample);
        }
        let is_flown = row == last_knot && supervisor.reason().is_none();
        if health.is_none() && (is_flown || order.mode != Mode::Offboard) {
            break;
        }
        if is_flown {
            supervisor.land();
        }
        if health.is_some() {
            vehicle.set_mode(order.mode);
        }
        answer = vehicle.step(setpoint, configuration);
        if take_off.is_none() {
            row += 1;
        }
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

/// Supervises a vehicle in real time from its own clock and from where it is.
fn supervise_from(
    limits: Limits,
    trajectory: &Trajectory,
    observation: &Observation,
    health: &Health,
) -> Result<Supervisor, SupervisorError> {
    let (quadrotor, end_effector) = trajectory.start();
    let start = Start {
        t_s: health.now_s,
        quadrotor: observation.quadrotor.map_or(quadrotor, |pose| pose.position),
        end_effector: observation.end_effector.unwrap_or(end_effector),
    };
    let supervisor = if health.standing {
        Supervisor::standing(limits, start)
    } else {
        Supervisor::new(limits, start)
    };
    Ok(supervisor?.with_feedforward(trajectory.feedforward()))
}

#[cfg(test)]
mod tests;
