//! An optimal-control problem: data only, no algorithm.

/// `lower ≤ z_k[index] ≤ upper` for `first_knot ≤ k ≤ last_knot`.
#[derive(Debug, Clone, PartialEq)]
pub struct StateBound {
    /// First knot (from 0) at which the bound holds.
    pub first_knot: usize,
    /// Last knot at which it holds, inclusive.
    pub last_knot: usize,
    /// Entry of the state.
    pub index: usize,
    /// Lower bound, −∞ for none.
    pub lower: f64,
    /// Upper bound, +∞ for none.
    pub upper: f64,
    /// What a unit of violation costs at each knot; +∞ if the bound must hold.
    pub price: f64,
}

impl StateBound {
    /// Of `bounds`, keeps what is left when `knot` becomes the first; a start that is as it is is not bounded.
    pub fn keep_from(bounds: &mut Vec<Self>, knot: usize) {
        bounds.retain(|bound| bound.last_knot > knot);
        for bound in bounds {
            bound.first_knot = bound.first_knot.saturating_sub(knot).max(1);
            bound.last_knot -= knot;
        }
    }
}

/// `z_k[index] = value` at one knot.
#[derive(Debug, Clone, PartialEq)]
pub struct Equality {
    /// Knot, from 0.
    pub knot: usize,
    /// Entry of the state.
    pub index: usize,
    /// Value it must take.
    pub value: f64,
    /// What a unit of distance from the value costs; +∞ if the equality must hold.
    pub price: f64,
}

/// Cost, constraints and initial guess for N knots of a state of length n and a command of length m.
/// Arrays over knots are flat and knot-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem {
    /// Number of knots N; there are N − 1 commands.
    pub knots: usize,
    /// Fixed state at knot 0 (n).
    pub start: Vec<f64>,
    /// Reference states z̄ (N × n).
    pub state_reference: Vec<f64>,
    /// Reference commands ū ((N−1) × m).
    pub command_reference: Vec<f64>,
    /// Diagonal of Q (n), no factor ½ in the cost.
    pub state_weight: Vec<f64>,
    /// Diagonal of R (m).
    pub command_weight: Vec<f64>,
    /// Lower command bound (m), the same at every knot.
    pub command_lower: Vec<f64>,
    /// Upper command bound (m).
    pub command_upper: Vec<f64>,
    /// Bounds on states.
    pub state_bounds: Vec<StateBound>,
    /// Equalities at knots.
    pub equalities: Vec<Equality>,
    /// Initial commands ((N−1) × m).
    pub command_guess: Vec<f64>,
}

impl Problem {
    /// Length n of the state.
    pub fn state_len(&self) -> usize {
        self.start.len()
    }

    /// Length m of the command.
    pub fn command_len(&self) -> usize {
        self.command_weight.len()
    }
}
