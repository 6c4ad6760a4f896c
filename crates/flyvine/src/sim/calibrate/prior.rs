//! What is believed of a vehicle before its flights are seen: every parameter is near the start vehicle's, and the tube
//! is the same material at either length.
//!
//! Shared parameters (gains, masses, delays) are identified by any configuration's flights, a corner's beam only by its own.
//! With a corner left out its beam follows, through the ties, from the other length's and, less surely, from the other
//! pressure's; and the start vehicle, which must not have seen the flights left out, holds what is left.

use super::Problem;
use nalgebra::DVector;

/// A belief that two parameters have a given ratio.
#[derive(Debug, Clone, PartialEq)]
pub struct Tie {
    /// Path of the first parameter.
    pub first: String,
    /// Path of the second.
    pub second: String,
    /// The first over the second.
    pub ratio: f64,
    /// Standard deviation of the ratio's logarithm.
    pub spread: f64,
}

/// Ties between the beams of the four corners. Bending stiffness, damping and wrinkling belong to the tube's section; slack
/// and stretch add up along its length.
pub fn beam_ties() -> Vec<Tie> {
    let [short, long] = crate::sim::parameters::CORNER_LENGTHS_M;
    let mut ties = vec![];
    for (property, ratio) in [
        ("stiffness_n_m2", 1.0),
        ("damping_n_m2_s", 1.0),
        ("collapse_moment_n_m", 1.0),
        ("slack_m_n", short / long),
        ("stretch_m_n", short / long),
    ] {
        let path = |corner: &str| format!("arm.corners.{corner}.{property}");
        for (first, second, ratio, spread) in [
            ("empty_short", "empty_long", ratio, 0.4),
            ("inflated_short", "inflated_long", ratio, 0.4),
            ("empty_short", "inflated_short", 1.0, 1.0),
            ("empty_long", "inflated_long", 1.0, 1.0),
        ] {
            ties.push(Tie {
                first: path(first),
                second: path(second),
                ratio,
                spread,
            });
        }
    }
    ties
}

impl Problem<'_> {
    /// `√w (ln θ − ln θ₀)/σ` of every free parameter (without logarithms where zero is allowed), and
    /// `√w (ln θ_i − ln θ_j − ln ratio)/σ` of every tie between two of them. Empty where the weight is zero.
    pub(super) fn prior_residuals(&self, x: &DVector<f64>) -> Vec<f64> {
        if self.options.prior_weight == 0.0 {
            return vec![];
        }
        let weight = self.options.prior_weight.sqrt();
        let mut residuals = vec![];
        for (parameter, x) in self.free.iter().zip(x.iter()) {
            let start = (parameter.get)(self.start).max(parameter.low);
            let value = parameter.unscaled(*x);
            let distance = if parameter.low > 0.0 {
                (value / start).ln()
            } else {
                value - start
            };
            residuals.push(weight * distance / parameter.spread);
        }
        for (first, second, tie) in &self.ties {
            let value = |j: &usize| self.free[*j].unscaled(x[*j]).ln();
            residuals.push(weight * (value(first) - value(second) - tie.ratio.ln()) / tie.spread);
        }
        residuals
    }

    /// Number of [`Self::prior_residuals`].
    pub(super) fn prior_rows(&self) -> usize {
        if self.options.prior_weight == 0.0 {
            0
        } else {
            self.free.len() + self.ties.len()
        }
    }
}
