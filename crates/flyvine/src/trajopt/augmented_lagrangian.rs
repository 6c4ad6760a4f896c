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
//!
//! A soft constraint with price w has a slack e of its own that costs `w |e|`: an exact penalty. Minimizing over e leaves
//! ŷ clipped to ±w; where it is, `ψ'' = 0` and the slack adds `w |e|`, `|e| = (|ŷ| − w) / ρ` with ŷ before clipping.

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
    /// w, infinite if the constraint is hard.
    price: f64,
}

impl StateConstraint {
    /// ŷ for the entry's value, not clipped.
    fn unclipped(&self, value: f64) -> f64 {
        let shifted = value + self.multiplier / self.penalty;
        self.penalty * (shifted - shifted.clamp(self.lower, self.upper))
    }

    /// ŷ for the entry's value.
    fn shifted_multiplier(&self, value: f64) -> f64 {
        self.unclipped(value).clamp(-self.price, self.price)
    }

    fn is_hard(&self) -> bool {
        self.price == f64::INFINITY
    }

    fn violation(&self, value: f64) -> f64 {
        (value - self.upper).max(self.lower - value).max(0.0)
    }

    /// `ψ`.
    pub fn cost(&self, value: f64) -> f64 {
        let unclipped = self.unclipped(value);
        let updated = unclipped.clamp(-self.price, self.price);
        let quadratic = (updated * updated - self.multiplier * self.multiplier) / (2.0 * self.penalty);
        let slack = (unclipped - updated).abs() / self.penalty;
        if slack > 0.0 {
            quadratic + self.price * slack
        } else {
            quadratic
        }
    }

    /// `(ψ', ψ'')`.
    pub fn derivatives(&self, value: f64) -> (f64, f64) {
        let updated = self.shifted_multiplier(value);
        let curved = updated != 0.0 && updated.abs() < self.price;
        (updated, if curved { self.penalty } else { 0.0 })
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
        let constraint = |source, knot, index, lower, upper, price| StateConstraint {
            source,
            knot,
            index,
            lower,
            upper,
            multiplier: 0.0,
            penalty: 1.0,
            price,
        };
        let mut constraints = Vec::new();
        for (i, bound) in problem.state_bounds.iter().enumerate() {
            let StateBound {
                first_knot,
                last_knot,
                index,
                lower,
                upper,
                price,
            } = *bound;
            for knot in first_knot.max(1)..=last_knot {
                constraints.push(constraint(
                    ConstraintSource::StateBound(i),
                    knot,
                    index,
                    lower,
                    upper,
                    price,
                ));
            }
        }
        for (i, equality) in problem.equalities.iter().enumerate() {
            let Equality {
                knot,
                index,
                value,
                price,
            } = *equality;
            if knot > 0 {
                constraints.push(constraint(
                    ConstraintSource::Equality(i),
                    knot,
                    index,
                    value,
                    value,
                    price,
                ));
            }
        }
        constraints.sort_by_key(|constraint| constraint.knot);
        let first = (0..=problem.knots)
            .map(|knot| constraints.partition_point(|constraint| constraint.knot < knot))
            .collect();
        Self { constraints, first }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.constraints.is_empty()
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

    /// `Σ |ŷ|`: how much the cost changes at most where every constrained entry changes by one.
    pub fn total_multiplier(&self, value: impl Fn(usize, usize) -> f64) -> f64 {
        self.constraints
            .iter()
            .map(|constraint| {
                constraint
                    .shifted_multiplier(value(constraint.knot, constraint.index))
                    .abs()
            })
            .sum()
    }

    /// The largest violation of a hard constraint.
    pub fn max_violation(&self, value: impl Fn(usize, usize) -> f64) -> f64 {
        self.constraints
            .iter()
            .filter(|constraint| constraint.is_hard())
            .map(|constraint| constraint.violation(value(constraint.knot, constraint.index)))
            .fold(0.0, f64::max)
    }

    /// What the violations of soft constraints cost.
    pub fn soft_cost(&self, value: impl Fn(usize, usize) -> f64) -> f64 {
        self.constraints
            .iter()
            .filter(|constraint| !constraint.is_hard())
            .map(|constraint| {
                constraint.price * constraint.violation(value(constraint.knot, constraint.index))
            })
            .sum()
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
            hard: constraint.is_hard(),
            multiplier: constraint.multiplier,
            violation: constraint.violation(value(constraint.knot, constraint.index)),
        }));
    }
}
