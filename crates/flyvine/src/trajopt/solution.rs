//! What a solve returns.

/// How a solve ended. Everything but [`Status::Converged`] comes with the best answer so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Violation and stationarity are both within tolerance.
    Converged,
    /// The iteration budget ran out.
    IterationLimit,
    /// The time budget ran out.
    TimeLimit,
    /// No further decrease is possible in floating point, though the tolerances are not met.
    Stalled,
    /// The penalty reached its limit and constraints are still violated: probably no feasible point nearby.
    ProbablyInfeasible,
    /// The rollout of the initial guess left the finite numbers, so there is nothing to improve.
    GuessDiverges {
        /// First knot that is not finite.
        knot: usize,
    },
}

impl Status {
    /// One word for tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::IterationLimit => "iteration limit",
            Self::TimeLimit => "time limit",
            Self::Stalled => "stalled",
            Self::ProbablyInfeasible => "probably infeasible",
            Self::GuessDiverges { .. } => "guess diverges",
        }
    }
}

/// Which of the problem's lists a constraint comes from, and its position there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ConstraintSource {
    /// `Problem::state_bounds[i]`.
    StateBound(usize),
    /// `Problem::equalities[i]`.
    Equality(usize),
}

/// The multiplier of one state constraint at one knot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstraintMultiplier {
    /// Where the constraint comes from.
    pub source: ConstraintSource,
    /// Knot.
    pub knot: usize,
    /// Entry of the state.
    pub index: usize,
    /// Whether it must hold, or only costs something.
    pub hard: bool,
    /// `∂J/∂(bound)` with the sign reversed: positive when the upper bound is active, negative for the lower.
    pub multiplier: f64,
    /// Distance outside the bounds, ≥ 0.
    pub violation: f64,
}

/// A constraint that a solution violates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Violation {
    /// The constraint.
    pub source: ConstraintSource,
    /// Entry of the state that it is on.
    pub index: usize,
    /// First knot at which it is violated.
    pub first_knot: usize,
    /// Last knot at which it is violated.
    pub last_knot: usize,
    /// Knot at which it is violated most.
    pub worst_knot: usize,
    /// How much it is violated there: relaxed by as much, it would hold at all knots.
    pub violation: f64,
}

/// A locally optimal trajectory, its feedback gains, its multipliers, and how good it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// How the solve ended.
    pub status: Status,
    /// Cost J of the problem, without multiplier terms.
    pub cost: f64,
    /// What violations of soft constraints add to J: Σ price · violation.
    pub soft_cost: f64,
    /// Largest violation over the hard state constraints; commands never leave their bounds.
    pub max_violation: f64,
    /// Largest projected `|∂L/∂u|`, divided by `1 + |J|`.
    pub stationarity: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Riccati factorizations among them.
    pub factorizations: usize,
    /// States (N × n), the rollout of `commands`.
    pub states: Vec<f64>,
    /// Commands ((N−1) × m).
    pub commands: Vec<f64>,
    /// Feedback gains ((N−1) × m × n, row-major): `u = u_k + K_k (z − z_k)` is optimal to first order.
    pub gains: Vec<f64>,
    /// Multipliers of the command bounds ((N−1) × m): positive at the upper bound, negative at the lower.
    pub command_multipliers: Vec<f64>,
    /// Multipliers of the state constraints, by ascending knot.
    pub multipliers: Vec<ConstraintMultiplier>,
}

impl Solution {
    /// The most violated knot of one constraint of the problem; `None` if the problem has no such constraint.
    pub fn worst(&self, source: ConstraintSource) -> Option<&ConstraintMultiplier> {
        self.multipliers
            .iter()
            .filter(|constraint| constraint.source == source)
            .max_by(|a, b| a.violation.total_cmp(&b.violation))
    }

    /// For every violated hard constraint of the problem, the most violated first: where, by how much, and hence what would
    /// make the problem solvable. Relaxing every named constraint by its violation is enough, because `states` would
    /// then satisfy all of them.
    pub fn diagnosis(&self, tolerance: f64) -> Vec<Violation> {
        let mut violations: Vec<Violation> = Vec::new();
        let violated =
            |constraint: &&ConstraintMultiplier| constraint.hard && constraint.violation > tolerance;
        for constraint in self.multipliers.iter().filter(violated) {
            let ConstraintMultiplier {
                source,
                knot,
                index,
                violation,
                ..
            } = *constraint;
            match violations.iter_mut().find(|known| known.source == source) {
                Some(known) => {
                    known.last_knot = knot;
                    if violation > known.violation {
                        (known.worst_knot, known.violation) = (knot, violation);
                    }
                }
                None => violations.push(Violation {
                    source,
                    index,
                    first_knot: knot,
                    last_knot: knot,
                    worst_knot: knot,
                    violation,
                }),
            }
        }
        violations.sort_by(|a, b| b.violation.total_cmp(&a.violation));
        violations
    }
}

impl Solution {
    /// Room for a solution.
    pub(super) fn empty(knots: usize, state: usize, command: usize) -> Self {
        let steps = knots - 1;
        Self {
            status: Status::IterationLimit,
            cost: f64::INFINITY,
            soft_cost: f64::INFINITY,
            max_violation: f64::INFINITY,
            stationarity: f64::INFINITY,
            iterations: 0,
            factorizations: 0,
            states: vec![0.0; knots * state],
            commands: vec![0.0; steps * command],
            gains: vec![0.0; steps * command * state],
            command_multipliers: vec![0.0; steps * command],
            multipliers: Vec::new(),
        }
    }
}
