//! What of a plan a receding horizon needs, computed before take-off: Jacobians, condensed costs, costs to go.

use super::condensed::{Condensed, CondensedError, Stage, TrackingWeights};
use super::horizon::Window;
use super::regulator::regulate;
use crate::control::Trajectory;
use crate::model::ScheduledModel;
use crate::trajopt::Dynamics;
use nalgebra::DMatrix;

/// A plan, linearized along itself. Arrays are flat and knot-major; N is the plan's number of knots.
#[derive(Debug, Clone)]
pub struct LinearizedPlan {
    stage: Stage,
    /// z̄ (N × n).
    state_reference: Vec<f64>,
    /// ū, and before it the command at the start (N × m).
    commands: Vec<f64>,
    /// Jacobians ((N − 1) × [`Stage::jacobian_len`]).
    jacobians: Vec<f64>,
    /// The horizons from each knot on (N − 1).
    condensed: Vec<Condensed>,
    /// Cost to go from each knot on (N), without what the knot itself costs.
    cost_to_go: Vec<DMatrix<f64>>,
}

impl LinearizedPlan {
    /// Linearizes `trajectory`, planned on `model`, for horizons of up to `stages` stages; those near its end are
    /// shorter. `end_effector` (N) is where the tip shall be, m; `command_scales` are those of the weights on commands
    /// that a window can have; `bounded` lists the softly bounded entries of the state.
    ///
    /// # Errors
    /// A Hessian of a horizon is not positive definite.
    pub fn new(
        trajectory: &Trajectory,
        model: &ScheduledModel,
        end_effector: &[[f64; 3]],
        weights: &TrackingWeights,
        command_scales: &[f64],
        stages: usize,
        bounded: &[usize],
    ) -> Result<Self, CondensedError> {
        let stage = Stage::of(model);
        let (knots, steps) = (trajectory.knots(), trajectory.knots() - 1);
        let jacobians = jacobians_along(trajectory, model);
        let mut state_reference = Vec::with_capacity(knots * stage.state);
        for (knot, tip) in end_effector.iter().enumerate() {
            state_reference.extend_from_slice(trajectory.state(knot));
            let row = knot * stage.state;
            state_reference[row + 6..row + 9].copy_from_slice(tip);
        }
        let cost_to_go = regulate(&stage, &jacobians, weights).cost_to_go;
        let len = stage.jacobian_len();
        let condensed = (0..steps)
            .map(|knot| {
                let end = (knot + stages).min(steps);
                Condensed::new(
                    &stage,
                    &jacobians[knot * len..end * len],
                    weights,
                    command_scales,
                    Some(&cost_to_go[end]),
                    bounded,
                )
                .map_err(|CondensedError::NotPositiveDefinite { stages, .. }| {
                    CondensedError::NotPositiveDefinite { knot, stages }
                })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            stage,
            state_reference,
            commands: std::iter::once(trajectory.start().0)
                .chain((0..steps).map(|knot| trajectory.command(knot)))
                .flatten()
                .collect(),
            jacobians,
            condensed,
            cost_to_go,
        })
    }

    /// Sizes of the model.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The plan's command at `knot`, before the plan's last.
    pub fn command(&self, knot: usize) -> &[f64] {
        let m = self.stage.command;
        &self.commands[(knot + 1) * m..][..m]
    }

    /// The horizon from `knot` on, to be predicted by `dynamics`, with the weights on commands at number `scale` of the
    /// scales; none at the plan's end.
    pub fn window<'w>(&'w self, knot: usize, dynamics: &'w dyn Dynamics, scale: usize) -> Option<Window<'w>> {
        let condensed = self.condensed.get(knot)?;
        let (n, m, stages) = (self.stage.state, self.stage.command, condensed.stages);
        let len = self.stage.jacobian_len();
        Some(Window {
            dynamics,
            knot,
            condensed,
            scale,
            jacobians: &self.jacobians[knot * len..][..stages * len],
            state_reference: &self.state_reference[(knot + 1) * n..][..stages * n],
            command_reference: &self.commands[(knot + 1) * m..][..stages * m],
            reference_before: &self.commands[knot * m..][..m],
            terminal: Some(&self.cost_to_go[knot + stages]),
        })
    }
}

/// The Jacobians of `model` along `trajectory`, padded, one after the other.
pub fn jacobians_along(trajectory: &Trajectory, model: &dyn Dynamics) -> Vec<f64> {
    let stage = Stage::of(model);
    let steps = trajectory.knots() - 1;
    let mut padded = Vec::with_capacity(steps * stage.jacobian_len());
    let mut jacobian = vec![0.0; stage.fresh * (stage.state + stage.command)];
    for knot in 0..steps {
        model.jacobian(
            knot,
            trajectory.state(knot),
            &trajectory.command(knot),
            &mut jacobian,
        );
        for row in jacobian.chunks_exact(stage.state + stage.command) {
            padded.extend_from_slice(row);
            padded.resize(padded.len().next_multiple_of(stage.stride()), 0.0);
        }
    }
    padded
}
