//! Problems that also choose parameters of the dynamics, as the length of an arm while it grows.
//!
//! The state is joined by the parameters θ in every lag, so that the companion form stays, and the command by their
//! change v from one knot to the next:
//!
//! ```text
//! (x, θ)⁺ = (f(z, u; θ, v), θ + v)
//! ```
//!
//! A range of θ is then a bound on a state, and its fastest change a bound on a command.

use super::joined::Joined;
use super::{Dynamics, Equality, Problem, StateBound};
use crate::kernel;

/// Half width of the differences that give derivatives along parameters.
const STEP: f64 = 1e-5;

/// Dynamics for every value of some parameters.
pub trait Parametric: Sync {
    /// The dynamics at one value.
    type Model: Dynamics;

    /// Those at the parameters θ while they change by v per knot; smooth in both, also a little outside the range in
    /// which they are meant.
    fn at(&self, parameters: &[f64], changes: &[f64]) -> Self::Model;

    /// Whether the models give their curvature; else it is estimated, along the parameters, too.
    fn gives_curvature(&self) -> bool;
}

/// One parameter, and what may be done with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Steered {
    /// Its value at knot 0.
    pub start: f64,
    /// Its range at every later knot.
    pub range: [f64; 2],
    /// Its least and greatest change per knot.
    pub change: [f64; 2],
    /// What the square of a change costs.
    pub weight: f64,
    /// Its value at the last knot; free if none.
    pub end: Option<f64>,
}

/// A model together with its parameters.
#[derive(Debug, Clone)]
pub struct WithParameters<P> {
    family: P,
    joined: Joined,
    /// Number of parameters.
    parameters: usize,
}

/// State, command and parameters of one knot, taken apart.
struct Parts {
    state: Vec<f64>,
    /// θ, then v.
    parameters: Vec<f64>,
}

impl Parts {
    /// θ + v.
    fn write_next(&self, next: &mut [f64]) {
        let (values, changes) = self.parameters.split_at(next.len());
        for ((next, value), change) in next.iter_mut().zip(values).zip(changes) {
            *next = value + change;
        }
    }
}

impl<P: Parametric> WithParameters<P> {
    /// Joins the parameters of `family` to its state; `start` is any value of them.
    pub fn new(family: P, start: &[f64]) -> Self {
        let model = family.at(start, &vec![0.0; start.len()]);
        Self {
            joined: Joined::new(&model, start.len()),
            family,
            parameters: start.len(),
        }
    }

    /// A name for every entry of the state, from those of the model's own and of the parameters.
    pub fn names(&self, own: &[String], parameters: &[String]) -> Vec<String> {
        self.joined.names(own, parameters)
    }

    /// The model's own states (N × n) out of the joined ones.
    pub fn own_states(&self, joined: &[f64]) -> Vec<f64> {
        self.joined.own_states(joined)
    }

    /// The parameters at each knot (N × q) out of the joined states.
    pub fn parameters(&self, joined: &[f64]) -> Vec<Vec<f64>> {
        joined
            .chunks_exact(self.state_len())
            .map(|state| state[self.joined.fresh..][..self.parameters].to_vec())
            .collect()
    }

    /// `problem`, whose command is the model's own, with parameters to be steered; the guess leaves them as they start.
    pub fn pose(&self, problem: &Problem, steered: &[Steered]) -> Problem {
        let start: Vec<f64> = steered.iter().map(|parameter| parameter.start).collect();
        let widened = |commands: &[f64]| {
            let rows = commands.chunks_exact(self.joined.command);
            rows.flat_map(|row| row.iter().copied().chain(steered.iter().map(|_| 0.0)))
                .collect()
        };
        let joined_to = |own: &[f64], more: &dyn Fn(&Steered) -> f64| {
            own.iter().copied().chain(steered.iter().map(more)).collect()
        };
        let mut posed = Problem {
            command_reference: widened(&problem.command_reference),
            command_guess: widened(&problem.command_guess),
            command_weight: joined_to(&problem.command_weight, &|parameter| parameter.weight),
            command_lower: joined_to(&problem.command_lower, &|parameter| parameter.change[0]),
            command_upper: joined_to(&problem.command_upper, &|parameter| parameter.change[1]),
            ..self.joined.pose(problem, &start)
        };
        for (index, parameter) in (self.joined.fresh..).zip(steered) {
            posed.state_bounds.push(StateBound {
                first_knot: 1,
                last_knot: problem.knots - 1,
                index,
                lower: parameter.range[0],
                upper: parameter.range[1],
                price: f64::INFINITY,
            });
            posed.equalities.extend(parameter.end.map(|value| Equality {
                knot: problem.knots - 1,
                index,
                value,
                price: f64::INFINITY,
            }));
        }
        posed
    }

    fn take_apart(&self, state: &[f64], command: &[f64]) -> Parts {
        let parameters = &state[self.joined.fresh..][..self.parameters];
        Parts {
            state: self.joined.gather(state),
            parameters: [parameters, &command[self.joined.command..]].concat(),
        }
    }

    fn model(&self, parameters: &[f64]) -> P::Model {
        let (values, changes) = parameters.split_at(self.parameters);
        self.family.at(values, changes)
    }

    /// The models on both sides of `parameters` along each of them.
    fn neighbours(&self, parameters: &[f64]) -> impl Iterator<Item = [P::Model; 2]> {
        (0..parameters.len()).map(move |along| {
            [STEP, -STEP].map(|by| {
                let mut moved = parameters.to_vec();
                moved[along] += by;
                self.model(&moved)
            })
        })
    }

    /// Entry of the joined (z, u) for entry i of (θ, v).
    fn parameter_variable(&self, i: usize) -> usize {
        match i.checked_sub(self.parameters) {
            None => self.joined.fresh + i,
            Some(change) => self.state_len() + self.joined.command + change,
        }
    }
}

impl<P: Parametric> Dynamics for WithParameters<P> {
    fn state_len(&self) -> usize {
        self.joined.state_len()
    }

    fn command_len(&self) -> usize {
        self.joined.command + self.parameters
    }

    fn fresh_len(&self) -> usize {
        self.joined.block()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let parts = self.take_apart(state, command);
        let (own, next) = fresh.split_at_mut(self.joined.fresh);
        let own_command = &command[..self.joined.command];
        self.model(&parts.parameters)
            .step(knot, &parts.state, own_command, own);
        parts.write_next(next);
    }

    fn linearize(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let parts = self.take_apart(state, command);
        let own_command = &command[..self.joined.command];
        let width = self.state_len() + self.command_len();
        let (next, values) = fresh.split_at_mut(self.joined.fresh);
        parts.write_next(values);
        let fresh = self.joined.fresh;
        let mut own = vec![0.0; fresh * (self.joined.state + self.joined.command)];
        self.model(&parts.parameters)
            .linearize(knot, &parts.state, own_command, next, &mut own);
        jacobian.fill(0.0);
        self.joined.spread_jacobian(&own, width, jacobian);
        for (i, sides) in self.neighbours(&parts.parameters).enumerate() {
            let [plus, minus] = sides.map(|model| {
                let mut next = vec![0.0; fresh];
                model.step(knot, &parts.state, own_command, &mut next);
                next
            });
            for (row, (plus, minus)) in plus.iter().zip(minus).enumerate() {
                jacobian[row * width + self.parameter_variable(i)] = (plus - minus) / (2.0 * STEP);
            }
        }
        for i in 0..self.parameters {
            let row = &mut jacobian[(fresh + i) * width..][..width];
            row[self.parameter_variable(i)] = 1.0;
            row[self.parameter_variable(self.parameters + i)] = 1.0;
        }
    }

    /// The model's own, and across parameters the differences of its `λᵀ∂f`; what is second order in the parameters
    /// alone is left out.
    fn add_curvature(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        if !self.family.gives_curvature() {
            return;
        }
        let parts = self.take_apart(state, command);
        let own_command = &command[..self.joined.command];
        let adjoint = &adjoint[..self.joined.fresh];
        let own_len = self.joined.state + self.joined.command;
        let own_stride = kernel::padded(own_len);
        let mut own = vec![0.0; own_len * own_stride];
        self.model(&parts.parameters).add_curvature(
            knot,
            &parts.state,
            own_command,
            adjoint,
            own_stride,
            &mut own,
        );
        self.joined.add_hessian(&own, own_stride, stride, hessian);
        for (i, sides) in self.neighbours(&parts.parameters).enumerate() {
            let [plus, minus] = sides.map(|model| {
                let mut jacobian = vec![0.0; self.joined.fresh * own_len];
                model.jacobian(knot, &parts.state, own_command, &mut jacobian);
                let mut slope = vec![0.0; own_len];
                for (row, weight) in jacobian.chunks_exact(own_len).zip(adjoint) {
                    for (total, entry) in slope.iter_mut().zip(row) {
                        *total += weight * entry;
                    }
                }
                slope
            });
            let parameter = self.parameter_variable(i);
            for (j, (plus, minus)) in plus.iter().zip(minus).enumerate() {
                let (variable, second) = (self.joined.variable(j), (plus - minus) / (2.0 * STEP));
                hessian[parameter * stride + variable] += second;
                hessian[variable * stride + parameter] += second;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajopt::derivatives::{Toy, assert_derivatives_within, toy_problem};
    use crate::trajopt::{Options, Solver, Status};

    /// [`Toy`], whose next state is stretched: `x⁺ = (1 + θ + 0.5 v) f(z, u)`.
    struct Stretched;

    struct StretchedToy {
        factor: f64,
    }

    impl Parametric for Stretched {
        type Model = StretchedToy;

        fn at(&self, parameters: &[f64], changes: &[f64]) -> StretchedToy {
            StretchedToy {
                factor: 1.0 + parameters[0] + 0.5 * changes[0],
            }
        }

        fn gives_curvature(&self) -> bool {
            true
        }
    }

    impl Dynamics for StretchedToy {
        fn state_len(&self) -> usize {
            Toy.state_len()
        }

        fn command_len(&self) -> usize {
            Toy.command_len()
        }

        fn fresh_len(&self) -> usize {
            Toy.fresh_len()
        }

        fn step(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64]) {
            Toy.step(knot, z, u, fresh);
            fresh[0] *= self.factor;
        }

        fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
            Toy.linearize(knot, z, u, fresh, jacobian);
            fresh[0] *= self.factor;
            jacobian.iter_mut().for_each(|entry| *entry *= self.factor);
        }

        fn add_curvature(
            &self,
            knot: usize,
            z: &[f64],
            u: &[f64],
            adjoint: &[f64],
            stride: usize,
            hessian: &mut [f64],
        ) {
            Toy.add_curvature(knot, z, u, &[self.factor * adjoint[0]], stride, hessian);
        }
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let model = WithParameters::new(Stretched, &[0.2]);
        let point = [0.3, 0.2, -0.2, 0.1, 0.4, 0.05];
        assert_derivatives_within(&model, &point, &[1.5, -2.0], 1e-5);
    }

    #[test]
    fn parameters_are_chosen_within_their_range_and_rate() {
        let model = WithParameters::new(Stretched, &[0.0]);
        let solve = |range: [f64; 2], end: Option<f64>| {
            let steered = Steered {
                start: 0.0,
                range,
                change: [-0.1, 0.1],
                weight: 1e-3,
                end,
            };
            let problem = model.pose(&toy_problem(), &[steered]);
            let mut solver = Solver::new(&problem, &model, Options::default()).unwrap();
            let solution = solver.solve().clone();
            assert_eq!(solution.status, Status::Converged);
            let parameters: Vec<f64> = model.parameters(&solution.states).concat();
            (solution.cost, parameters)
        };
        let (fixed_cost, fixed) = solve([0.0, 0.0], None);
        assert!(fixed.iter().all(|parameter| parameter.abs() < 1e-6));
        let (cost, free) = solve([-0.3, 0.3], None);
        assert!(cost < fixed_cost - 1e-3, "{cost} of {fixed_cost}");
        assert!(free.iter().all(|parameter| parameter.abs() <= 0.3 + 1e-6));
        assert!(
            free.windows(2)
                .all(|pair| (pair[1] - pair[0]).abs() <= 0.1 + 1e-9)
        );
        let (_, ended) = solve([-0.3, 0.3], Some(0.25));
        assert!((ended.last().unwrap() - 0.25).abs() < 1e-6);
    }
}
