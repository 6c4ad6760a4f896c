//! One step of model-predictive control: rollout, adjoint, quadratic program.

use super::active_set::{ActiveSet, Budget, QpReport, QuadraticProgram, Rows};
use super::condensed::{Condensed, Stage, TrackingWeights};
use crate::kernel;
use crate::trajopt::Dynamics;
use nalgebra::DMatrix;

/// `lower ≤ z[index] ≤ upper` at every stage, softly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftBound {
    /// Entry of the state.
    pub index: usize,
    /// Lower bound, −∞ for none.
    pub lower: f64,
    /// Upper bound, +∞ for none.
    pub upper: f64,
}

/// What the commands and states of a horizon must keep.
#[derive(Debug, Clone, PartialEq)]
pub struct HorizonLimits {
    /// Lower command bound (m).
    pub command_lower: Vec<f64>,
    /// Upper command bound (m).
    pub command_upper: Vec<f64>,
    /// Largest change from one command to the next (m), if limited.
    pub command_change: Option<Vec<f64>>,
    /// Soft bounds on states.
    pub states: Vec<SoftBound>,
    /// Cost of a violated soft bound per its square.
    pub penalty: f64,
}

impl HorizonLimits {
    /// Bounds on a command along an axis no further than `deviation` from its reference; a reference outside the bounds
    /// does not empty them.
    fn command_range(&self, axis: usize, reference: f64, deviation: f64) -> [f64; 2] {
        let (lower, upper) = (self.command_lower[axis], self.command_upper[axis]);
        let reference = reference.max(lower).min(upper);
        [lower.max(reference - deviation), upper.min(reference + deviation)]
    }
}

/// The part of the plan that a horizon of N stages from one knot on sees. Arrays are flat and stage-major.
#[derive(Clone, Copy)]
pub struct Window<'a> {
    /// The model; stage j is its knot `knot + j`.
    pub dynamics: &'a dyn Dynamics,
    /// Knot of the first command.
    pub knot: usize,
    /// Its condensed cost.
    pub condensed: &'a Condensed,
    /// Which of its scales of the weights on commands is meant.
    pub scale: usize,
    /// Jacobians along the plan (N × [`Stage::jacobian_len`]).
    pub jacobians: &'a [f64],
    /// z̄ at stages 1 … N (N × n).
    pub state_reference: &'a [f64],
    /// ū at stages 0 … N − 1 (N × m).
    pub command_reference: &'a [f64],
    /// ū one stage earlier (m).
    pub reference_before: &'a [f64],
    /// P (n × n), around the last z̄.
    pub terminal: Option<&'a DMatrix<f64>>,
}

/// Where a horizon starts from.
#[derive(Debug, Clone, Copy)]
pub struct Start<'a> {
    /// z_0 (n).
    pub state: &'a [f64],
    /// The command that is held now (m).
    pub held_command: &'a [f64],
    /// What the world adds to the fresh entries at every step …
    pub disturbance: &'a [f64],
    /// … and what it adds at the first one, of which a share `decay` is left at each further one.
    pub gust: &'a [f64],
    /// See there.
    pub decay: f64,
    /// Fraction φ of a knot by which commands arrive late, −½ to ½: the model sees `(1 − φ) u_j + φ u_{j−1}`.
    pub delay: f64,
    /// Greatest distance of a command from its reference along each axis, infinite for none.
    pub command_deviation: f64,
}

/// Receding-horizon commands, with all memory they need.
#[derive(Debug, Clone)]
pub struct Horizon {
    stage: Stage,
    weights: TrackingWeights,
    limits: HorizonLimits,
    active_set: ActiveSet,
    /// Stages of the last solve; 0 if there was none.
    stages: usize,
    /// u (N × m): the last solution.
    commands: Vec<f64>,
    /// z_0 … z_N under it as rolled out before its last correction ((N + 1) × n).
    states: Vec<f64>,
    /// The command that the model sees (m).
    effective: Vec<f64>,
    /// ∂J/∂v, padded.
    gradient: Vec<f64>,
    /// ∂J/∂z, padded like a row of a Jacobian, and the same one stage earlier.
    adjoint: Vec<f64>,
    adjoint_before: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl Horizon {
    /// Room for horizons of up to `stages` stages.
    pub fn new(stage: Stage, stages: usize, weights: TrackingWeights, limits: HorizonLimits) -> Self {
        let variables = stages * stage.command;
        let hard = variables * if limits.command_change.is_some() { 2 } else { 1 };
        let soft = stages * limits.states.len();
        Self {
            stage,
            weights,
            active_set: ActiveSet::new(variables, hard + soft, soft),
            limits,
            stages: 0,
            commands: Vec::with_capacity(variables),
            states: vec![0.0; (stages + 1) * stage.state],
            effective: vec![0.0; stage.command],
            gradient: Vec::with_capacity(kernel::padded(variables)),
            adjoint: vec![0.0; stage.stride()],
            adjoint_before: vec![0.0; stage.stride()],
            lower: Vec::with_capacity(hard + soft),
            upper: Vec::with_capacity(hard + soft),
        }
    }

    /// The commands of the last solve (N × m), best first.
    pub fn commands(&self) -> &[f64] {
        &self.commands
    }

    /// Forgets the last solution.
    pub fn forget(&mut self) {
        self.stages = 0;
        self.active_set.forget();
    }

    /// Takes `commands` (N × m) for the last solution, already shifted, so that the next solve begins with them.
    #[cfg(test)]
    pub(super) fn start_from(&mut self, commands: &[f64]) {
        let m = self.stage.command;
        self.commands.clear();
        self.commands.extend_from_slice(&commands[..m]);
        self.commands.extend_from_slice(commands);
        self.stages = self.commands.len() / m;
    }

    /// Solves one horizon from `start`, beginning with the last solution shifted by one stage. Allocates nothing.
    pub fn solve(&mut self, window: &Window<'_>, start: &Start<'_>, budget: Budget) -> QpReport {
        self.shift(window);
        self.roll_out(window, start);
        self.differentiate(window, start);
        self.write_bounds(window, start);
        let condensed = window.condensed;
        let hessian = &condensed.hessians[window.scale];
        let program = QuadraticProgram {
            hessian: &hessian.matrix,
            inverse: &hessian.inverse,
            gradient: &self.gradient,
            rows: Rows {
                variables: self.commands.len(),
                changes_of: self.limits.command_change.as_ref().map(|_| self.stage.command),
                soft: &condensed.soft,
                compliance: 0.5 / self.limits.penalty,
            },
            lower: &self.lower,
            upper: &self.upper,
        };
        let report = self.active_set.solve(&program, budget);
        for (command, change) in self.commands.iter_mut().zip(self.active_set.solution()) {
            *command += change;
        }
        self.keep_limits(window, start);
        report
    }

    /// The last solution and its active set one stage on; past its end the last deviation from the reference stays.
    fn shift(&mut self, window: &Window<'_>) {
        let (m, old, new) = (self.stage.command, self.stages, window.condensed.stages);
        self.stages = new;
        if old == 0 {
            self.commands.clear();
            self.commands.extend_from_slice(window.command_reference);
            return;
        }
        self.commands.copy_within(m.min(old * m).., 0);
        let kept = (old - 1).min(new);
        self.commands.truncate(kept * m);
        for j in kept..new {
            for axis in 0..m {
                let deviation = match j.checked_sub(1) {
                    Some(before) => {
                        self.commands[before * m + axis] - window.command_reference[before * m + axis]
                    }
                    None => 0.0,
                };
                self.commands
                    .push(window.command_reference[j * m + axis] + deviation);
            }
        }
        let hard_blocks = if self.limits.command_change.is_some() {
            2
        } else {
            1
        };
        let soft_per_stage = self.limits.states.len();
        self.active_set.rename(|row| {
            let (block, row) = (row / (old * m), row);
            if block < hard_blocks {
                let row = (row - block * old * m).checked_sub(m)?;
                (row < new * m).then_some(block * new * m + row)
            } else {
                let row = (row - hard_blocks * old * m).checked_sub(soft_per_stage)?;
                (row < new * soft_per_stage).then_some(hard_blocks * new * m + row)
            }
        });
    }

    /// z_1 … z_N under the commands.
    fn roll_out(&mut self, window: &Window<'_>, start: &Start<'_>) {
        let Stage {
            state: n,
            command: m,
            fresh,
        } = self.stage;
        self.states[..n].copy_from_slice(start.state);
        let mut gust_left = 1.0;
        for j in 0..self.stages {
            let newer = &self.commands[j * m..][..m];
            let older = match j.checked_sub(1) {
                Some(earlier) => &self.commands[earlier * m..][..m],
                None => start.held_command,
            };
            for ((effective, newer), older) in self.effective.iter_mut().zip(newer).zip(older) {
                *effective = (1.0 - start.delay) * newer + start.delay * older;
            }
            let (before, after) = self.states[j * n..(j + 2) * n].split_at_mut(n);
            window
                .dynamics
                .step(window.knot + j, before, &self.effective, &mut after[..fresh]);
            for ((entry, disturbance), gust) in after.iter_mut().zip(start.disturbance).zip(start.gust) {
                *entry += disturbance + gust_left * gust;
            }
            gust_left *= start.decay;
            after[fresh..].copy_from_slice(&before[..n - fresh]);
        }
    }

    /// ∂J/∂v by the adjoint recursion λ_j = A_jᵀ λ_{j+1} + 2 Q (z_j − z̄_j).
    fn differentiate(&mut self, window: &Window<'_>, start: &Start<'_>) {
        let Stage {
            state: n,
            command: m,
            fresh,
        } = self.stage;
        let stages = self.stages;
        let scale = window.condensed.hessians[window.scale].command_scale;
        self.gradient.clear();
        self.gradient.resize(kernel::padded(stages * m), 0.0);
        self.adjoint.fill(0.0);
        let last = &self.states[stages * n..][..n];
        let last_reference = &window.state_reference[(stages - 1) * n..][..n];
        if let Some(terminal) = window.terminal {
            for (entry, column) in self.adjoint[..n].iter_mut().zip(terminal.column_iter()) {
                let error = last
                    .iter()
                    .zip(last_reference)
                    .map(|(z, reference)| z - reference);
                *entry = 2.0 * column.iter().zip(error).map(|(p, e)| p * e).sum::<f64>();
            }
        }
        for j in (0..stages).rev() {
            let state = &self.states[(j + 1) * n..][..n];
            let reference = &window.state_reference[j * n..][..n];
            for i in 0..n {
                self.adjoint[i] += 2.0 * self.weights.state[i] * (state[i] - reference[i]);
            }
            let jacobian = &window.jacobians[j * self.stage.jacobian_len()..][..self.stage.jacobian_len()];
            self.adjoint_before.fill(0.0);
            self.adjoint_before[..n - fresh].copy_from_slice(&self.adjoint[fresh..n]);
            kernel::add_transpose_vector(jacobian, &self.adjoint[..fresh], &mut self.adjoint_before);
            for axis in 0..m {
                let deviation = self.commands[j * m + axis] - window.command_reference[j * m + axis];
                let slope = self.adjoint_before[n + axis];
                self.gradient[j * m + axis] +=
                    (1.0 - start.delay) * slope + 2.0 * scale * self.weights.command[axis] * deviation;
                if j > 0 {
                    self.gradient[(j - 1) * m + axis] += start.delay * slope;
                }
                self.adjoint_before[n + axis] = 0.0;
            }
            std::mem::swap(&mut self.adjoint, &mut self.adjoint_before);
        }
        for axis in 0..m {
            let mut before = start.held_command[axis] - window.reference_before[axis];
            for j in 0..stages {
                let deviation = self.commands[j * m + axis] - window.command_reference[j * m + axis];
                let slope = 2.0 * scale * self.weights.command_change[axis] * (deviation - before);
                self.gradient[j * m + axis] += slope;
                if j > 0 {
                    self.gradient[(j - 1) * m + axis] -= slope;
                }
                before = deviation;
            }
        }
    }

    /// Bounds on v, on its changes, and on what it does to bounded states.
    fn write_bounds(&mut self, window: &Window<'_>, start: &Start<'_>) {
        let (n, m) = (self.stage.state, self.stage.command);
        let HorizonLimits {
            command_change,
            states,
            ..
        } = &self.limits;
        self.lower.clear();
        self.upper.clear();
        for (i, command) in self.commands.iter().enumerate() {
            let reference = window.command_reference[i];
            let [lower, upper] = self
                .limits
                .command_range(i % m, reference, start.command_deviation);
            self.lower.push(lower - command);
            self.upper.push(upper - command);
        }
        if let Some(limit) = command_change {
            for i in 0..self.commands.len() {
                let before = match i.checked_sub(m) {
                    Some(before) => self.commands[before],
                    None => start.held_command[i],
                };
                let (change, limit) = (self.commands[i] - before, limit[i % m]);
                let (mut lower, mut upper) = (-limit - change, limit - change);
                if i < m {
                    // A held command far outside the bounds must not contradict them.
                    lower = lower.min(self.upper[i]);
                    upper = upper.max(self.lower[i]);
                }
                self.lower.push(lower);
                self.upper.push(upper);
            }
        }
        for state in self.states[n..].chunks_exact(n).take(self.stages) {
            for bound in states {
                self.lower.push(bound.lower - state[bound.index]);
                self.upper.push(bound.upper - state[bound.index]);
            }
        }
    }

    /// Rounding, or a spent budget, must not leave a command outside its hard limits.
    fn keep_limits(&mut self, window: &Window<'_>, start: &Start<'_>) {
        let m = self.stage.command;
        for i in 0..self.commands.len() {
            let mut command = self.commands[i];
            if let Some(limit) = &self.limits.command_change {
                let before = match i.checked_sub(m) {
                    Some(before) => self.commands[before],
                    None => start.held_command[i],
                };
                command = command.max(before - limit[i % m]).min(before + limit[i % m]);
            }
            let reference = window.command_reference[i];
            let [lower, upper] = self
                .limits
                .command_range(i % m, reference, start.command_deviation);
            self.commands[i] = command.max(lower).min(upper);
        }
    }
}
