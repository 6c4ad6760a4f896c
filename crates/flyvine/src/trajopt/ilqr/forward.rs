//! The forward pass: a closed-loop rollout along the step, shortened until the merit decreases enough.

use super::super::augmented_lagrangian::AugmentedLagrangian;
use super::super::{Dynamics, Problem};
use super::Trajectory;
use super::backward::Policy;
use super::rollout::{self, Costs};

/// Share of the predicted decrease that must be reached (Armijo).
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// Shortest step tried: 2⁻¹⁰.
const MAX_HALVINGS: i32 = 10;

/// What a forward pass follows.
pub struct ForwardPass<'a, D: Dynamics + ?Sized> {
    pub problem: &'a Problem,
    pub dynamics: &'a D,
    pub constraints: &'a AugmentedLagrangian,
    pub policy: &'a Policy,
    /// The trajectory that the policy belongs to.
    pub old: &'a Trajectory,
}

/// A step that was taken.
#[derive(Debug, Clone, Copy)]
pub struct Accepted {
    pub costs: Costs,
    pub step_length: f64,
    /// Whether the merit decreased by more than its noise.
    pub decreased: bool,
}

impl<D: Dynamics + ?Sized> ForwardPass<'_, D> {
    /// Rolls `u = clamp(u_old + α d + K (z − z_old))` out from the first state of `new` and returns what it
    /// costs, `None` if it leaves the finite numbers.
    pub fn closed_loop(&self, step_length: f64, linearize: bool, new: &mut Trajectory) -> Option<Costs> {
        let (problem, old, shape) = (self.problem, self.old, self.old.shape);
        let mut cost = rollout::state_cost(problem, 0, new.state(0));
        let mut multiplier_terms = 0.0;
        for knot in 0..shape.steps() {
            new.feed_back(knot, self.policy.gain(knot), old);
            let commands = new.command_mut(knot).iter_mut().zip(old.command(knot));
            for (j, (command, old)) in commands.enumerate() {
                *command += old + step_length * self.policy.step(knot)[j];
                *command = command.clamp(problem.command_lower[j], problem.command_upper[j]);
            }
            new.advance(self.dynamics, knot, linearize);
            let state = new.state(knot + 1);
            cost += rollout::command_cost(problem, knot, new.command(knot))
                + rollout::state_cost(problem, knot + 1, state);
            multiplier_terms += rollout::constraint_cost(self.constraints, knot + 1, state);
            if !(cost + multiplier_terms).is_finite() {
                return None;
            }
        }
        let merit = cost + multiplier_terms;
        Some(Costs { cost, merit })
    }

    /// Halves the step until the merit decreases enough, or changes by no more than `noise`; `new` then holds the
    /// trajectory, linearized if the step is a full one. `None` if no length serves.
    pub fn line_search(&self, old_merit: f64, noise: f64, new: &mut Trajectory) -> Option<Accepted> {
        new.state_mut(0).copy_from_slice(self.old.state(0));
        for halvings in 0..=MAX_HALVINGS {
            let step_length = 0.5_f64.powi(halvings);
            let Some(costs) = self.closed_loop(step_length, halvings == 0, new) else {
                continue;
            };
            let predicted = step_length * (self.policy.slope + step_length * self.policy.quadratic);
            if costs.merit - old_merit <= SUFFICIENT_DECREASE * predicted + noise {
                return Some(Accepted {
                    costs,
                    step_length,
                    decreased: costs.merit < old_merit - noise,
                });
            }
        }
        None
    }
}
