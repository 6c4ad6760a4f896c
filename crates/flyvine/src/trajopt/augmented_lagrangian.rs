//! State constraints as an augmented Lagrangian.
//!
//! Every constraint is an interval `l ≤ c ≤ h` on one entry `c = z_k[i]`; an equality has `l = h`. With multiplier
//! y and penalty ρ it adds (Bertsekas, *Constrained Optimization and Lagrange Multiplier Methods*, Sec. 3.1)
//!
//! ```text
//! ψ(c) = (ŷ² − y²) / 2ρ,   ŷ = ρ (s − Π(s)),   s = c + y/ρ,   Π the projection onto [l, h]
//! ```
//!
//! to the cost, so `ψ' = ŷ`, which is also the updated multiplier, and `ψ'' = ρ` where s is outside, else 0.

use super::problem::{Equality, Problem, StateBound};
use super::solution::{ConstraintMultiplier, ConstraintSource};

/// One interval at one knot.
#[derive(Debug, Clone)]
pub(super) struct StateConstraint {
    pub source: ConstraintSource,
    pub knot: usize,
    pub index: usize,
    lower: f64,
    upper: f64,
    /// y; positive pushes the entry down.
    multiplier: f64,
    /// ρ.
    penalty: f64,
}

impl StateConstraint {
    /// ŷ for the entry's value.
    fn shifted_multiplier(&self, value: f64) -> f64 {
        let shifted = value + self.multiplier / self.penalty;
        self.penalty * (shifted - shifted.clamp(self.lower, self.upper))
    }

    fn violation(&self, value: f64) -> f64 {
        (value - self.upper).max(self.lower - value).max(0.0)
    }

    /// `ψ`.
    pub fn cost(&self, value: f64) -> f64 {
        let updated = self.shifted_multiplier(value);
        (updated * updated - self.multiplier * self.multiplier) / (2.0 * self.penalty)
    }

    /// `(ψ', ψ'')`.
    pub fn derivatives(&self, value: f64) -> (f64, f64) {
        let updated = self.shifted_multiplier(value);
        (updated, if updated == 0.0 { 0.0 } else { self.penalty })
    }
}

/// All state constraints of a problem, by ascending knot.
#[derive(Debug, Clone)]
pub(super) struct AugmentedLagrangian {
    constraints: Vec<StateConstraint>,
    /// `constraints[first[k]..first[k + 1]]` act at knot k.
    first: Vec<usize>,
}

impl AugmentedLagrangian {
    /// Constraints at knot 0 are left out: the start is fixed, and validated.
    pub fn new(problem: &Problem) -> Self {
        let constraint = |source, knot, index, lower, upper| StateConstraint {
            source,
            knot,
            index,
            lower,
            upper,
            multiplier: 0.0,
            penalty: 1.0,
        };
        let mut constraints = Vec::new();
        for (i, bound) in problem.state_bounds.iter().enumerate() {
            let StateBound {
                first_knot,
                last_knot,
                index,
                lower,
                upper,
            } = *bound;
            for knot in first_knot.max(1)..=last_knot {
                constraints.push(constraint(
                    ConstraintSource::StateBound(i),
                    knot,
                    index,
                    lower,
                    upper,
                ));
            }
        }
        for (i, equality) in problem.equalities.iter().enumerate() {
            let Equality { knot, index, value } = *equality;
            if knot > 0 {
                constraints.push(constraint(
                    ConstraintSource::Equality(i),
                    knot,
                    index,
                    value,
                    value,
                ));
            }
        }
        constraints.sort_by_key(|constraint| constraint.knot);
        let first = (0..=problem.knots)
            .map(|knot| constraints.partition_point(|constraint| constraint.knot < knot))
            .collect();
        Self { constraints, first }
    }

    /// The constraints at one knot.
    pub fn at(&self, knot: usize) -> &[StateConstraint] {
        &self.constraints[self.first[knot]..self.first[knot + 1]]
    }

    /// All multipliers to zero, all penalties to `penalty`.
    pub fn reset(&mut self, penalty: f64) {
        for constraint in &mut self.constraints {
            constraint.multiplier = 0.0;
            constraint.penalty = penalty;
        }
    }

    /// `y ← ŷ`, with `value(knot, index)` the state entries.
    pub fn update_multipliers(&mut self, value: impl Fn(usize, usize) -> f64) {
        for constraint in &mut self.constraints {
            constraint.multiplier = constraint.shifted_multiplier(value(constraint.knot, constraint.index));
        }
    }

    /// `ρ ← min(growth · ρ, max)`; false if every penalty was at its maximum already.
    pub fn grow_penalties(&mut self, growth: f64, max: f64) -> bool {
        let mut grown = false;
        for constraint in &mut self.constraints {
            grown |= constraint.penalty < max;
            constraint.penalty = (growth * constraint.penalty).min(max);
        }
        grown
    }

    /// The largest ρ, 0 without constraints.
    pub fn max_penalty(&self) -> f64 {
        self.constraints
            .iter()
            .map(|constraint| constraint.penalty)
            .fold(0.0, f64::max)
    }

    /// The largest violation.
    pub fn max_violation(&self, value: impl Fn(usize, usize) -> f64) -> f64 {
        self.constraints
            .iter()
            .map(|constraint| constraint.violation(value(constraint.knot, constraint.index)))
            .fold(0.0, f64::max)
    }

    /// The largest of violation and complementarity: the distance between y/ρ and ŷ/ρ, which is zero exactly where
    /// every constraint holds and only active ones have multipliers.
    pub fn max_residual(&self, value: impl Fn(usize, usize) -> f64) -> f64 {
        self.constraints
            .iter()
            .map(|constraint| {
                let updated = constraint.shifted_multiplier(value(constraint.knot, constraint.index));
                ((updated - constraint.multiplier) / constraint.penalty).abs()
            })
            .fold(0.0, f64::max)
    }

    /// Multipliers and violations for the solution.
    pub fn report(&self, value: impl Fn(usize, usize) -> f64, multipliers: &mut Vec<ConstraintMultiplier>) {
        multipliers.clear();
        multipliers.extend(self.constraints.iter().map(|constraint| ConstraintMultiplier {
            source: constraint.source,
            knot: constraint.knot,
            index: constraint.index,
            multiplier: constraint.multiplier,
            violation: constraint.violation(value(constraint.knot, constraint.index)),
        }));
    }
}
