//! The check of derivatives that tests of [`Dynamics`] share.

use super::Dynamics;
use crate::kernel;

/// Asserts that the Jacobian of `dynamics` at `point` = (z, u), and its curvature along `adjoint`, agree with central
/// differences of the step and of the Jacobian.
pub(crate) fn assert_derivatives(dynamics: &dyn Dynamics, point: &[f64], adjoint: &[f64]) {
    let (n, m, fresh) = (dynamics.state_len(), dynamics.command_len(), dynamics.fresh_len());
    assert_eq!((point.len(), adjoint.len()), (n + m, fresh));
    let evaluate = |point: &[f64]| {
        let (mut next, mut jacobian) = (vec![0.0; fresh], vec![0.0; fresh * (n + m)]);
        dynamics.step(0, &point[..n], &point[n..], &mut next);
        dynamics.jacobian(0, &point[..n], &point[n..], &mut jacobian);
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
        let ((plus, jacobian_plus), (minus, jacobian_minus)) = (moved(1e-4), moved(-1e-4));
        for row in 0..fresh {
            let difference = (plus[row] - minus[row]) / 2e-4;
            assert!((difference - jacobian[row * (n + m) + column]).abs() < 1e-9);
        }
        for other in 0..n + m {
            let along = |jacobian: &[f64]| -> f64 {
                (0..fresh)
                    .map(|row| adjoint[row] * jacobian[row * (n + m) + other])
                    .sum()
            };
            let difference = (along(&jacobian_plus) - along(&jacobian_minus)) / 2e-4;
            assert!((difference - curvature[column * stride + other]).abs() < 1e-9);
        }
    }
}
