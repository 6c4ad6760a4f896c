//! What a task demands of the whole motion beyond bounds on signals: distance from obstacles, tubes and planes to stay
//! in, and the region that the bank's flights support. Each is a bound on an output of the motion.

mod demand;
mod norm;
mod obstacle;

pub use demand::{Contact, SupportDemand, Tube};
pub use obstacle::{Obstacle, Shape};

pub(super) use demand::validate;

use norm::{Excess, Norm};
use obstacle::Clearance;

use super::Task;
use crate::DT;
use crate::flight::{Configuration, SIGNALS};
use crate::model::Support;
use crate::trajopt::{Dynamics, Output, Problem, StateBound, WithOutputs};
use std::sync::Arc;

/// Entries of `w = (x⁺, x, u)`: where x⁺ and x have the measured signals.
const NOW: usize = 0;
const BEFORE: usize = SIGNALS.len();
const COMMAND: usize = 2 * SIGNALS.len();
/// Where quadrotor, attitude and end effector begin in x.
pub(super) const QUADROTOR: usize = 0;
const ATTITUDE: usize = 3;
const END_EFFECTOR: usize = 6;

/// Outputs of the motion, and bounds on them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Constraints {
    /// The outputs.
    outputs: Vec<Arc<dyn Output>>,
    /// Their names.
    names: Vec<String>,
    /// What the square of each costs.
    weights: Vec<f64>,
    /// Bounds, whose index is the output's.
    bounds: Vec<StateBound>,
}

impl Constraints {
    /// The task's; `support` is what the bank's flights support, if it is known.
    pub(super) fn new(task: &Task, configurations: &[Configuration], support: Option<&Support>) -> Self {
        let mut constraints = Self::default();
        let last_knot = task.knots() - 1;
        for obstacle in &task.obstacles {
            constraints.push_bounded(
                format!("distance from {}", obstacle.name),
                Clearance::new(obstacle),
                StateBound {
                    lower: 0.0,
                    ..always(last_knot)
                },
            );
        }
        for tube in &task.tubes {
            let bound = StateBound {
                upper: tube.radius_m,
                ..between(tube.from_s, tube.until_s, last_knot)
            };
            constraints.push_bounded("distance from the tube's axis".into(), from_line(tube), bound);
        }
        for contact in &task.contacts {
            let bound = StateBound {
                upper: contact.tolerance_m,
                ..between(contact.from_s, contact.until_s, last_knot)
            };
            constraints.push_bounded(
                "distance from the plane of contact".into(),
                from_plane(contact),
                bound,
            );
        }
        if let (Some(demand), Some(support)) = (&task.support, support) {
            let shortest = configurations
                .iter()
                .map(|at| at.length_m)
                .fold(f64::INFINITY, f64::min);
            for (name, quantity) in supported(support, shortest) {
                let beyond = Excess::new(quantity, demand.share);
                constraints.push(
                    format!("{name} beyond what flights support"),
                    beyond,
                    demand.weight,
                );
            }
        }
        constraints
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.outputs.is_empty()
    }

    /// `dynamics`, joined by the outputs.
    pub fn watch<D: Dynamics>(&self, dynamics: D) -> WithOutputs<'_, D> {
        WithOutputs::new(dynamics, &self.outputs, SIGNALS.len())
    }

    /// `problem` on [`Self::watch`]'s dynamics, with what the outputs cost and their bounds.
    pub fn pose<D: Dynamics>(&self, watched: &WithOutputs<'_, D>, problem: &Problem) -> Problem {
        watched.pose(problem, &self.weights, &self.bounds)
    }

    /// Names of the entries of the joined state, from those of the model's.
    pub(super) fn names<D: Dynamics>(&self, watched: &WithOutputs<'_, D>, own: &[String]) -> Vec<String> {
        watched.names(own, &self.names)
    }

    /// The first hard lower bound (an obstacle's) that a motion which stays at the state `start` violates: the output's
    /// name and value. No command can mend that.
    pub(super) fn violated_at(&self, start: &[f64]) -> Option<(&str, f64)> {
        let x = &start[..SIGNALS.len()];
        let w = [x, x, &x[..3]].concat();
        self.bounds
            .iter()
            .map(|bound| (bound, self.outputs[bound.index].value(&w)))
            .find(|(bound, value)| *value < bound.lower)
            .map(|(bound, value)| (self.names[bound.index].as_str(), value))
    }

    /// What is left of them from `knot` on.
    pub fn rest_from(&self, knot: usize) -> Self {
        let mut rest = self.clone();
        StateBound::keep_from(&mut rest.bounds, knot);
        rest
    }

    fn push(&mut self, name: String, output: impl Output + 'static, weight: f64) {
        self.outputs.push(Arc::new(output));
        self.names.push(name);
        self.weights.push(weight);
    }

    fn push_bounded(&mut self, name: String, output: impl Output + 'static, bound: StateBound) {
        self.bounds.push(StateBound {
            index: self.outputs.len(),
            ..bound
        });
        self.push(name, output, 0.0);
    }
}

/// No bound yet, on every knot after the first.
fn always(last_knot: usize) -> StateBound {
    StateBound {
        first_knot: 1,
        last_knot,
        index: 0,
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
        price: f64::INFINITY,
    }
}

/// The same from one time to another, s.
fn between(from_s: f64, until_s: f64, last_knot: usize) -> StateBound {
    let knot = |t_s: f64| ((t_s / DT).round() as usize).clamp(1, last_knot);
    StateBound {
        first_knot: knot(from_s),
        last_knot: knot(until_s),
        ..always(last_knot)
    }
}

/// Distance of the end effector from a line: |P (e − p)| with P the projection across the line, m.
fn from_line(tube: &Tube) -> Norm {
    let along = unit(tube.direction);
    let rows = (0..3).map(|i| {
        let across = |j: usize| f64::from(u8::from(i == j)) - along[i] * along[j];
        let terms = (0..3).map(|j| (NOW + END_EFFECTOR + j, across(j))).collect();
        let offset = -(0..3).map(|j| across(j) * tube.point_m[j]).sum::<f64>();
        (offset, terms)
    });
    Norm::new(rows.collect())
}

/// Distance of the end effector from a plane: |n · (e − p)|, m.
fn from_plane(contact: &Contact) -> Norm {
    let normal = unit(contact.normal);
    let terms = (0..3).map(|j| (NOW + END_EFFECTOR + j, normal[j])).collect();
    let offset = -(0..3).map(|j| normal[j] * contact.point_m[j]).sum::<f64>();
    Norm::new(vec![(offset, terms)])
}

/// Every quantity of the supported region over its limit, so that 1 is the region's edge. Left out is what the flights
/// never did.
fn supported(support: &Support, length_m: f64) -> Vec<(&'static str, Norm)> {
    let difference = |plus: usize, minus: usize, axes: usize, limit: f64| {
        let row = |axis: usize| {
            (
                0.0,
                vec![(plus + axis, 1.0 / limit), (minus + axis, -1.0 / limit)],
            )
        };
        Norm::new((0..axes).map(row).collect())
    };
    // |(q_x, q_y)| is the sine of half the tilt.
    let half_tilt = (0.5 * support.tilt).sin();
    let row = |axis: usize| (0.0, vec![(NOW + ATTITUDE + axis, 1.0 / half_tilt)]);
    let tilt = Norm::new((0..2).map(row).collect());
    let reach = length_m * support.arm_angle.sin();
    let per_knot = |speed_m_s: f64| speed_m_s * DT;
    [
        ("tilt", support.tilt, tilt),
        (
            "speed",
            support.speed_m_s,
            difference(
                NOW + QUADROTOR,
                BEFORE + QUADROTOR,
                3,
                per_knot(support.speed_m_s),
            ),
        ),
        (
            "reach of the arm",
            support.arm_angle,
            difference(NOW + END_EFFECTOR, NOW + QUADROTOR, 2, reach),
        ),
        (
            "speed of the end effector",
            support.tip_speed_m_s,
            difference(
                NOW + END_EFFECTOR,
                BEFORE + END_EFFECTOR,
                3,
                per_knot(support.tip_speed_m_s),
            ),
        ),
        (
            "distance of the command",
            support.command_lead_m,
            difference(COMMAND, BEFORE + QUADROTOR, 3, support.command_lead_m),
        ),
    ]
    .into_iter()
    .filter(|(_, limit, _)| *limit > 0.0)
    .map(|(name, _, output)| (name, output))
    .collect()
}

/// The direction of a vector that is not zero.
fn unit(vector: [f64; 3]) -> [f64; 3] {
    let length = vector.iter().map(|entry| entry * entry).sum::<f64>().sqrt();
    vector.map(|entry| entry / length)
}

#[cfg(test)]
mod testing {
    use crate::trajopt::Output;

    /// Asserts that slope and curvature of `output` at `w` are those of central differences.
    pub(super) fn assert_output_derivatives(output: &dyn Output, w: &[f64]) {
        let len = w.len();
        let evaluate = |w: &[f64]| {
            let (mut gradient, mut hessian) = (vec![0.0; len], vec![0.0; len * len]);
            let value = output.derivatives(w, &mut gradient, &mut hessian);
            assert_eq!(value, output.value(w));
            (gradient, hessian)
        };
        let (gradient, hessian) = evaluate(w);
        for i in 0..len {
            let moved = |by: f64| {
                let mut moved = w.to_vec();
                moved[i] += by;
                moved
            };
            let (plus, minus) = (moved(1e-6), moved(-1e-6));
            let slope = (output.value(&plus) - output.value(&minus)) / 2e-6;
            assert!(
                (slope - gradient[i]).abs() < 1e-6,
                "∂y/∂w[{i}]: {} or {slope}",
                gradient[i]
            );
            let (plus, minus) = (evaluate(&plus).0, evaluate(&minus).0);
            for j in 0..len {
                let curvature = (plus[j] - minus[j]) / 2e-6;
                let found = hessian[i * len + j];
                assert!(
                    (curvature - found).abs() < 1e-4 * (1.0 + found.abs()),
                    "[{i}][{j}]: {found} or {curvature}"
                );
            }
        }
    }
}
