//! What tests of [`Dynamics`] share: a check of derivatives, and a small model to try things on.

use super::{Dynamics, Equality, Problem};
use crate::kernel;

/// Asserts that the Jacobian of `dynamics` at `point` = (z, u), and its curvature along `adjoint`, agree with central
/// differences of the step and of the Jacobian.
pub(crate) fn assert_derivatives(dynamics: &dyn Dynamics, point: &[f64], adjoint: &[f64]) {
    assert_derivatives_within(dynamics, point, adjoint, 1e-9);
}

/// The same for a Jacobian that is itself made of differences, whose own differences are this far off.
pub(crate) fn assert_derivatives_within(
    dynamics: &dyn Dynamics,
    point: &[f64],
    adjoint: &[f64],
    curvature_tolerance: f64,
) {
    let (n, m, fresh) = (dynamics.state_len(), dynamics.command_len(), dynamics.fresh_len());
    assert_eq!((point.len(), adjoint.len()), (n + m, fresh));
    let evaluate = |point: &[f64]| {
        let (mut next, mut jacobian) = (vec![0.0; fresh], vec![0.0; fresh * (n + m)]);
        dynamics.linearize(0, &point[..n], &point[n..], &mut next, &mut jacobian);
        let mut stepped = vec![0.0; fresh];
        dynamics.step(0, &point[..n], &point[n..], &mut stepped);
        assert_eq!(stepped, next);
        (next, jacobian)
    };
    let (_, jacobian) = evaluate(point);
    let stride = kernel::padded(n + m);
    let mut curvature = vec![0.0; (n + m) * stride];
    dynamics.add_curvature(0, &point[..n], &point[n..], adjoint, stride, &mut curvature);
    for column in 0..n + m {
        let moved = |by: f64| {
            let mut moved = point.to_vec();
            moved[column] += by;
            evaluate(&moved)
        };
        let ((plus, jacobian_plus), (minus, jacobian_minus)) = (moved(1e-5), moved(-1e-5));
        for row in 0..fresh {
            let difference = (plus[row] - minus[row]) / 2e-5;
            assert!((difference - jacobian[row * (n + m) + column]).abs() < 1e-9);
        }
        for other in 0..n + m {
            let along = |jacobian: &[f64]| -> f64 {
                (0..fresh)
                    .map(|row| adjoint[row] * jacobian[row * (n + m) + other])
                    .sum()
            };
            let difference = (along(&jacobian_plus) - along(&jacobian_minus)) / 2e-5;
            assert!((difference - curvature[column * stride + other]).abs() < curvature_tolerance);
        }
    }
}

/// `x⁺ = 0.5 x_{k−1} + 0.1 x² + u + 0.2 x u` with two lags.
pub(crate) struct Toy;

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
        fresh[0] = 0.5 * z[1] + 0.1 * z[0] * z[0] + u[0] + 0.2 * z[0] * u[0];
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        self.step(knot, z, u, fresh);
        jacobian.copy_from_slice(&[0.2 * z[0] + 0.2 * u[0], 0.5, 1.0 + 0.2 * z[0]]);
    }

    fn add_curvature(
        &self,
        _knot: usize,
        _z: &[f64],
        _u: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        hessian[0] += 0.2 * adjoint[0];
        hessian[2] += 0.2 * adjoint[0];
        hessian[2 * stride] += 0.2 * adjoint[0];
    }
}

/// A [`Problem`] on [`Toy`]: near 0.5, and at 0.9 at one knot.
pub(crate) fn toy_problem() -> Problem {
    let knots = 8;
    Problem {
        knots,
        start: vec![0.1, 0.1],
        state_reference: vec![0.5; 2 * knots],
        command_reference: vec![0.0; knots - 1],
        state_weight: vec![1.0, 0.5],
        command_weight: vec![0.1],
        command_lower: vec![-2.0],
        command_upper: vec![2.0],
        state_bounds: vec![],
        equalities: vec![Equality {
            knot: 5,
            index: 0,
            value: 0.9,
            price: f64::INFINITY,
        }],
        command_guess: vec![0.0; knots - 1],
    }
}
