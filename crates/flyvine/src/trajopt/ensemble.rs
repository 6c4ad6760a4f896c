//! Several models as one: they share the command, and each predicts its own motion.
//!
//! A plan for the ensemble minimizes the mean of its members' costs, and every member keeps the state bounds. No
//! command takes all members to a target at once, so equalities become soft: what is minimized is the members' mean
//! distance from them, `Σ_members price / M · |z[i] − value|` for every equality.

use super::{Dynamics, Equality, Problem, StateBound};
use crate::kernel;

/// M models with one command. In companion form like its members: the state is `(x¹_k, …, x^M_k, x¹_{k−1}, …)`.
#[derive(Debug, Clone)]
pub struct Ensemble<D> {
    members: Vec<D>,
    layout: Layout,
}

/// Where a member's state is in the ensemble's.
#[derive(Debug, Clone, Copy)]
struct Layout {
    members: usize,
    /// Lengths n, m and fresh of one member.
    state: usize,
    command: usize,
    fresh: usize,
}

impl Layout {
    /// Entry of the ensemble's state for entry i of a member's.
    fn index(self, member: usize, i: usize) -> usize {
        (i / self.fresh * self.members + member) * self.fresh + i % self.fresh
    }

    fn gather(self, member: usize, state: &[f64]) -> Vec<f64> {
        (0..self.state).map(|i| state[self.index(member, i)]).collect()
    }
}

/// Why models make no ensemble, or their problems no common one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EnsembleError {
    /// Nothing to plan on.
    #[error("ensemble: found no members, expected at least one")]
    Empty,
    /// Members differ in a length.
    #[error("ensemble member {member}: found {what} {found}, expected {expected} as in the first")]
    Different {
        /// The member, from 0.
        member: usize,
        /// Which length.
        what: &'static str,
        /// Its value.
        found: usize,
        /// That of the first member.
        expected: usize,
    },
    /// A state that is not a whole number of lags.
    #[error(
        "ensemble: found states of {state}, expected whole multiples of the {fresh} entries computed per step"
    )]
    PartialLag {
        /// Length of the state.
        state: usize,
        /// Entries computed per step.
        fresh: usize,
    },
}

impl<D: Dynamics> Ensemble<D> {
    /// # Errors
    /// No members, or members of different size.
    pub fn new(members: Vec<D>) -> Result<Self, EnsembleError> {
        let first = members.first().ok_or(EnsembleError::Empty)?;
        let layout = Layout {
            members: members.len(),
            state: first.state_len(),
            command: first.command_len(),
            fresh: first.fresh_len(),
        };
        for (member, dynamics) in members.iter().enumerate() {
            for (what, found, expected) in [
                ("state length", dynamics.state_len(), layout.state),
                ("command length", dynamics.command_len(), layout.command),
                ("entries computed per step", dynamics.fresh_len(), layout.fresh),
            ] {
                require_equal(member, what, found, expected)?;
            }
        }
        if !layout.state.is_multiple_of(layout.fresh) {
            return Err(EnsembleError::PartialLag {
                state: layout.state,
                fresh: layout.fresh,
            });
        }
        Ok(Self { members, layout })
    }

    /// The models.
    pub fn members(&self) -> &[D] {
        &self.members
    }

    /// One problem per member, alike but for start and references, as one problem of the ensemble: mean cost, state
    /// bounds for every member, and equalities soft, at `price / M` each.
    ///
    /// # Errors
    /// Another number of problems than members, or problems of different length.
    pub fn pose(&self, problems: &[Problem], price: f64) -> Result<Problem, EnsembleError> {
        let Layout { members, state, .. } = self.layout;
        require_equal(problems.len(), "number of problems", problems.len(), members)?;
        let first = &problems[0];
        let share = 1.0 / members as f64;
        let mut problem = Problem {
            start: vec![0.0; members * state],
            state_reference: vec![0.0; first.knots * members * state],
            state_weight: vec![0.0; members * state],
            state_bounds: Vec::new(),
            equalities: Vec::new(),
            ..first.clone()
        };
        for (member, own) in problems.iter().enumerate() {
            require_equal(member, "knots", own.knots, first.knots)?;
            require_equal(member, "start length", own.start.len(), state)?;
            let index = |i| self.layout.index(member, i);
            for i in 0..state {
                problem.start[index(i)] = own.start[i];
                problem.state_weight[index(i)] = share * own.state_weight[i];
                for knot in 0..first.knots {
                    problem.state_reference[knot * members * state + index(i)] =
                        own.state_reference[knot * state + i];
                }
            }
            problem
                .state_bounds
                .extend(own.state_bounds.iter().map(|bound| StateBound {
                    index: index(bound.index),
                    ..bound.clone()
                }));
            problem
                .equalities
                .extend(own.equalities.iter().map(|equality| Equality {
                    index: index(equality.index),
                    price: share * price,
                    ..equality.clone()
                }));
        }
        Ok(problem)
    }

    /// Whose entry the ensemble's entry is: the member, and the entry of its state.
    pub fn locate(&self, index: usize) -> (usize, usize) {
        let Layout { members, fresh, .. } = self.layout;
        let block = index / fresh;
        (block % members, block / members * fresh + index % fresh)
    }

    /// One member's states (N × n) out of the ensemble's.
    pub fn member_states(&self, member: usize, states: &[f64]) -> Vec<f64> {
        states
            .chunks_exact(self.state_len())
            .flat_map(|state| self.layout.gather(member, state))
            .collect()
    }
}

fn require_equal(
    member: usize,
    what: &'static str,
    found: usize,
    expected: usize,
) -> Result<(), EnsembleError> {
    if found == expected {
        return Ok(());
    }
    Err(EnsembleError::Different {
        member,
        what,
        found,
        expected,
    })
}

impl<D: Dynamics> Dynamics for Ensemble<D> {
    fn state_len(&self) -> usize {
        self.layout.members * self.layout.state
    }

    fn command_len(&self) -> usize {
        self.layout.command
    }

    fn fresh_len(&self) -> usize {
        self.layout.members * self.layout.fresh
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let own = fresh.chunks_exact_mut(self.layout.fresh);
        for (member, (dynamics, fresh)) in self.members.iter().zip(own).enumerate() {
            dynamics.step(knot, &self.layout.gather(member, state), command, fresh);
        }
    }

    fn linearize(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let Layout {
            state: n,
            command: m,
            fresh: own_fresh,
            ..
        } = self.layout;
        let width = self.state_len() + m;
        jacobian.fill(0.0);
        let mut own = vec![0.0; own_fresh * (n + m)];
        for (member, dynamics) in self.members.iter().enumerate() {
            let own_state = self.layout.gather(member, state);
            let own_rows = member * own_fresh..(member + 1) * own_fresh;
            dynamics.linearize(knot, &own_state, command, &mut fresh[own_rows.clone()], &mut own);
            for (row, own) in own_rows.zip(own.chunks_exact(n + m)) {
                let row = &mut jacobian[row * width..][..width];
                for (i, &entry) in own[..n].iter().enumerate() {
                    row[self.layout.index(member, i)] = entry;
                }
                row[width - m..].copy_from_slice(&own[n..]);
            }
        }
    }

    fn add_curvature(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        let Layout {
            state: n,
            command: m,
            fresh,
            ..
        } = self.layout;
        let own_stride = kernel::padded(n + m);
        let mut own = vec![0.0; (n + m) * own_stride];
        for (member, dynamics) in self.members.iter().enumerate() {
            own.fill(0.0);
            let own_state = self.layout.gather(member, state);
            let own_adjoint = &adjoint[member * fresh..(member + 1) * fresh];
            dynamics.add_curvature(knot, &own_state, command, own_adjoint, own_stride, &mut own);
            let index = |i: usize| match i.checked_sub(n) {
                None => self.layout.index(member, i),
                Some(input) => self.state_len() + input,
            };
            for (i, row) in own.chunks_exact(own_stride).enumerate() {
                for (j, entry) in row[..n + m].iter().enumerate() {
                    hessian[index(i) * stride + index(j)] += entry;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajopt::derivatives::assert_derivatives;
    use crate::trajopt::{Options, Solver, Status};

    /// `x⁺ = gain · x_{k−1} + 0.1 x² + u` with two lags: a member differs in its gain.
    struct Toy {
        gain: f64,
    }

    impl Dynamics for Toy {
        fn state_len(&self) -> usize {
            2
        }

        fn command_len(&self) -> usize {
            1
        }

        fn fresh_len(&self) -> usize {
            1
        }

        fn step(&self, _knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64]) {
            fresh[0] = self.gain * z[1] + 0.1 * z[0] * z[0] + u[0];
        }

        fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
            self.step(knot, z, u, fresh);
            jacobian.copy_from_slice(&[0.2 * z[0], self.gain, 1.0]);
        }

        fn add_curvature(
            &self,
            _knot: usize,
            _z: &[f64],
            _u: &[f64],
            adjoint: &[f64],
            _stride: usize,
            hessian: &mut [f64],
        ) {
            hessian[0] += 0.2 * adjoint[0];
        }
    }

    fn problem() -> Problem {
        Problem {
            knots: 6,
            start: vec![0.1, 0.1],
            state_reference: vec![0.5; 12],
            command_reference: vec![0.0; 5],
            state_weight: vec![1.0, 0.5],
            command_weight: vec![1.0],
            command_lower: vec![-2.0],
            command_upper: vec![2.0],
            state_bounds: vec![StateBound {
                first_knot: 1,
                last_knot: 5,
                index: 0,
                lower: f64::NEG_INFINITY,
                upper: 0.8,
                price: f64::INFINITY,
            }],
            equalities: vec![Equality {
                knot: 4,
                index: 0,
                value: 0.75,
                price: f64::INFINITY,
            }],
            command_guess: vec![0.0; 5],
        }
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let ensemble = Ensemble::new(vec![Toy { gain: 0.4 }, Toy { gain: 0.6 }, Toy { gain: 0.8 }]).unwrap();
        let point: Vec<f64> = (0..7).map(|i| 0.3 - 0.1 * i as f64).collect();
        assert_derivatives(&ensemble, &point, &[1.0, -2.0, 0.5]);
    }

    /// Twins plan like one: with a price above the equality's multiplier, the soft equality holds exactly.
    #[test]
    fn twins_plan_like_one() {
        let (problem, toy) = (problem(), Toy { gain: 0.5 });
        let mut alone = Solver::new(&problem, &toy, Options::default()).unwrap();
        let alone = alone.solve();
        assert_eq!(alone.status, Status::Converged);
        let ensemble = Ensemble::new(vec![Toy { gain: 0.5 }, Toy { gain: 0.5 }]).unwrap();
        let together = ensemble.pose(&[problem.clone(), problem.clone()], 1e3).unwrap();
        let mut solver = Solver::new(&together, &ensemble, Options::default()).unwrap();
        let solution = solver.solve();
        assert_eq!(solution.status, Status::Converged);
        assert!((solution.cost - alone.cost).abs() < 1e-6);
        assert!(solution.soft_cost < 1e-4);
        for member in 0..2 {
            let states = ensemble.member_states(member, &solution.states);
            for (found, expected) in states.iter().zip(&alone.states) {
                assert!((found - expected).abs() < 1e-5);
            }
        }
        for index in 0..4 {
            let (member, entry) = ensemble.locate(index);
            assert_eq!(ensemble.layout.index(member, entry), index);
        }
    }

    #[test]
    fn what_makes_no_ensemble_is_refused() {
        assert_eq!(Ensemble::<Toy>::new(vec![]).err(), Some(EnsembleError::Empty));
        let ensemble = Ensemble::new(vec![Toy { gain: 0.5 }]).unwrap();
        assert!(ensemble.pose(&[], 1.0).is_err());
    }
}
