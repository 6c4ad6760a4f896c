//! Linear stability of a model about a point.

use crate::trajopt::Dynamics;
use faer::Mat;

/// Spectral radius of the transition matrix `∂z⁺/∂z` of `dynamics` at `(state, command)`, knot 0: the fresh rows'
/// Jacobian above the shift. `None` if the eigenvalue iteration does not converge.
pub fn spectral_radius(dynamics: &impl Dynamics, state: &[f64], command: &[f64]) -> Option<f64> {
    let (n, m, fresh) = (dynamics.state_len(), dynamics.command_len(), dynamics.fresh_len());
    let mut jacobian = vec![0.0; fresh * (n + m)];
    dynamics.jacobian(0, state, command, &mut jacobian);
    let transition = Mat::from_fn(n, n, |row, column| {
        if row < fresh {
            jacobian[row * (n + m) + column]
        } else {
            f64::from(u8::from(row - fresh == column))
        }
    });
    let eigenvalues = transition.eigenvalues().ok()?;
    Some(
        eigenvalues
            .iter()
            .map(|value| value.re.hypot(value.im))
            .fold(0.0, f64::max),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::lag::{CommandInputs, LagModel};

    #[test]
    fn radius_of_a_known_recursion() {
        // x⁺ = 1.5 x − 0.56 x_{k−1} in every signal: roots 0.8 and 0.7.
        let mut linear = vec![0.0; 9 * 21];
        for row in 0..9 {
            linear[row * 21 + row] = 1.5;
            linear[row * 21 + 9 + row] = -0.56;
        }
        let model = LagModel::new(2, CommandInputs::Position, vec![0.0; 9], linear, &[]).unwrap();
        let radius = spectral_radius(&model, &[0.0; 18], &[0.0; 3]).unwrap();
        assert!((radius - 0.8).abs() < 1e-6, "{radius}");
    }
}
