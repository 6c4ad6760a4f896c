//! Everything but the flight: the stream of a plan to a vehicle that stays disarmed.

use std::ops::ControlFlow;

use flyvine::control::Proposal;
use flyvine::control::Trajectory;
use flyvine::control::supervisor::{Event, Limits, Reason, Start, State, Supervisor, SupervisorError};
use flyvine::link::{Mode, Vehicle, VehicleError};

use super::vehicle::AutopilotVehicle;

/// What a dry run showed.
#[derive(Debug)]
pub struct DryRun {
    /// What the supervisor had to say.
    pub events: Vec<Event>,
    /// Why it would have ended the flight, if it would.
    pub reason: Option<Reason>,
    /// Set-points sent.
    pub setpoints: usize,
}

/// Why there was no dry run.
#[derive(Debug, thiserror::Error)]
pub enum DryRunError {
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// The limits, or where the vehicle stands.
    #[error(transparent)]
    Supervisor(#[from] SupervisorError),
}

/// Streams the commands of `trajectory` in real time to a vehicle that stands by, through a supervisor that stays in
/// [`State::Standing`]: nothing is armed, no mode is asked for. `progress` is called before each tick and may stop it.
pub fn dry_run(
    vehicle: &mut AutopilotVehicle,
    trajectory: &Trajectory,
    limits: Limits,
    progress: &mut dyn FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<DryRun, DryRunError> {
    let mut observation = vehicle.reset(trajectory.configuration(0), 0)?;
    let (quadrotor, end_effector) = trajectory.start();
    let start = Start {
        t_s: observation.t_s,
        quadrotor: observation.quadrotor.map_or(quadrotor, |pose| pose.position),
        end_effector: observation.end_effector.unwrap_or(end_effector),
    };
    let mut supervisor = Supervisor::standing(limits, start)?.with_feedforward(trajectory.feedforward());
    let mut setpoints = 0;
    // The arm stays as it is: it is a vehicle on the ground.
    let configuration = trajectory.configuration(0);
    for knot in 0..trajectory.knots() - 1 {
        if progress(knot, trajectory.knots()).is_break() {
            supervisor.abort(Reason::Operator);
        }
        if let Some(health) = vehicle.health() {
            supervisor.hear(&health);
            supervisor.observe(health.now_s, &observation, configuration);
        }
        let order = supervisor.decide(observation.t_s, Proposal::Command(trajectory.command(knot)));
        let (Some(setpoint), State::Standing) = (order.setpoint, supervisor.state()) else {
            break;
        };
        vehicle.set_mode(Mode::Standby);
        observation = vehicle.step(setpoint, configuration)?;
        setpoints += 1;
    }
    Ok(DryRun {
        events: supervisor.take_events(),
        reason: supervisor.reason(),
        setpoints,
    })
}
