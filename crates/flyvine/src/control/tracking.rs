//! Feedback on the plan's time-varying gains.

use super::trajectory::POSE_STATE_LEN;
use super::{Controller, Proposal, Tick, Trajectory};
use crate::flight::Pose;
use crate::trajopt::Dynamics;

/// u_k = clip(u*_k + K_k (z_k − z*_k)), with the gains K_k that the planner's backward pass left.
///
/// z_k is made of the poses at t_k, t_{k−1}, …; where one is missing, the model's one-step prediction from
/// the previous z and the command that was really held takes its place.
pub struct Tracking<'a> {
    trajectory: &'a Trajectory,
    model: &'a dyn Dynamics,
    /// z_k, newest first (n).
    state: Vec<f64>,
}

/// A trajectory or model that cannot be tracked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrackingError {
    /// The trajectory has no gains.
    #[error("the trajectory has no feedback gains; expected one for each of its {commands} commands")]
    NoGains {
        /// Number of commands.
        commands: usize,
    },
    /// The model does not belong to the trajectory, or its state is not made of lagged poses.
    #[error(
        "the model's state has {found} entries, {fresh} of them new at each step; expected {expected} \
         (the trajectory's), a multiple of 9, and 9 new ones"
    )]
    State {
        /// State length of the model.
        found: usize,
        /// Fresh entries of the model.
        fresh: usize,
        /// State length of the trajectory.
        expected: usize,
    },
    /// The model's command is not a position.
    #[error("the model's command has {found} entries; expected 3")]
    Command {
        /// Command length of the model.
        found: usize,
    },
}

impl<'a> Tracking<'a> {
    /// Tracks `trajectory` with its gains; `model` is the one that it was planned on.
    pub fn new(trajectory: &'a Trajectory, model: &'a dyn Dynamics) -> Result<Self, TrackingError> {
        if trajectory.gain(0).is_none() {
            return Err(TrackingError::NoGains {
                commands: trajectory.knots() - 1,
            });
        }
        let (found, fresh, expected) = (model.state_len(), model.fresh_len(), trajectory.state_len());
        if found != expected || fresh != POSE_STATE_LEN || found % POSE_STATE_LEN != 0 {
            return Err(TrackingError::State {
                found,
                fresh,
                expected,
            });
        }
        if model.command_len() != 3 {
            return Err(TrackingError::Command {
                found: model.command_len(),
            });
        }
        Ok(Self {
            trajectory,
            model,
            state: trajectory.state(0).to_vec(),
        })
    }

    /// Moves z on to t_k: prediction first, then whatever was seen.
    fn update(&mut self, tick: &Tick) {
        let mut newest = [0.0; POSE_STATE_LEN];
        if tick.knot == 0 {
            // The plan starts from rest: its lags are the history.
            newest.copy_from_slice(&self.trajectory.state(0)[..POSE_STATE_LEN]);
            self.state.copy_from_slice(self.trajectory.state(0));
        } else {
            self.model
                .step(tick.knot - 1, &self.state, &tick.held_command, &mut newest);
            let kept = self.state.len() - POSE_STATE_LEN;
            self.state.copy_within(..kept, POSE_STATE_LEN);
        }
        if let Some(Pose { position, attitude }) = tick.observation.quadrotor {
            newest[..3].copy_from_slice(&position);
            newest[3..6].copy_from_slice(&attitude[1..]);
        }
        if let Some(position) = tick.observation.end_effector {
            newest[6..].copy_from_slice(&position);
        }
        self.state[..POSE_STATE_LEN].copy_from_slice(&newest);
    }
}

impl Controller for Tracking<'_> {
    fn propose(&mut self, tick: &Tick) -> Proposal {
        self.update(tick);
        let Some(gain) = self.trajectory.gain(tick.knot) else {
            return Proposal::Failed;
        };
        let planned = self.trajectory.state(tick.knot);
        let n = planned.len();
        let mut command = self.trajectory.command(tick.knot);
        for axis in 0..3 {
            for i in 0..n {
                command[axis] += gain[axis * n + i] * (self.state[i] - planned[i]);
            }
        }
        Proposal::Command(self.trajectory.clip(command))
    }
}
