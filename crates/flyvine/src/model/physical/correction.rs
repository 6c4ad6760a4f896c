//! What physics leaves over: a small linear correction of the velocities that a knot ends with.
//!
//! ```text
//! v⁺ ← v⁺ + C_v φ,   v_tip⁺ ← v_tip⁺ + C_tip φ
//! ```
//!
//! with φ the state's distance from rest, the same anywhere in the room: rest stays at rest, and forces that the
//! reduced order lacks may still act.

use super::error::PhysicalError;
use super::state::{STATE_LEN, offset};
use crate::GRAVITY;
use serde::{Deserialize, Serialize};

/// Entries of the state that are corrected.
pub const CORRECTED: [usize; 6] = [
    offset::VELOCITY,
    offset::VELOCITY + 1,
    offset::VELOCITY + 2,
    offset::TIP_VELOCITY,
    offset::TIP_VELOCITY + 1,
    offset::TIP_VELOCITY + 2,
];

/// Features, as differences of entries of `w = (z, u)`: first entry, the entry that is subtracted, how many.
const DIFFERENCES: [(usize, Option<usize>, usize); 9] = [
    (STATE_LEN, Some(offset::POSITION), 3), // u − p
    (offset::COMMANDS, Some(offset::POSITION), 3),
    (offset::TIP, Some(offset::POSITION), 3),
    (offset::TIP_VELOCITY, Some(offset::VELOCITY), 3),
    (offset::VELOCITY, None, 3),
    (offset::ATTITUDE, None, 3),
    (offset::BODY_RATE, None, 3),
    (offset::INTEGRATOR, None, 3),
    (offset::THRUST, None, 1),
];

/// Number of features φ.
pub const FEATURES: usize = 25;

/// The coefficients C.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Correction {
    /// One row of [`FEATURES`] per corrected entry: velocity x, y, z, then tip velocity x, y, z.
    coefficients: Vec<Vec<f64>>,
}

impl Correction {
    /// From `CORRECTED.len()` rows of [`FEATURES`], row-major.
    pub(super) fn new(coefficients: &[f64]) -> Self {
        Correction {
            coefficients: coefficients.chunks(FEATURES).map(<[f64]>::to_vec).collect(),
        }
    }

    /// The weighted sum of corrections, none counting as zero; `None` if there is none at all.
    pub(super) fn mean(parts: &[(f64, Option<&Self>)]) -> Option<Self> {
        let mut sum = vec![0.0; CORRECTED.len() * FEATURES];
        let mut any = false;
        for (weight, correction) in parts {
            for (entry, own) in sum
                .iter_mut()
                .zip(correction.iter().flat_map(|c| c.coefficients.iter().flatten()))
            {
                *entry += weight * own;
                any = true;
            }
        }
        any.then(|| Self::new(&sum))
    }

    /// Refuses what a damaged file may hold.
    ///
    /// # Errors
    /// Rows of other lengths, or numbers that are not finite.
    pub(super) fn validate(&self) -> Result<(), PhysicalError> {
        let sizes = self.coefficients.iter().map(|row| (row.len(), FEATURES));
        for (found, expected) in std::iter::once((self.coefficients.len(), CORRECTED.len())).chain(sizes) {
            if found != expected {
                return Err(PhysicalError::Shape {
                    what: "rows or columns of the correction",
                    found,
                    expected,
                });
            }
        }
        match self
            .coefficients
            .iter()
            .flatten()
            .find(|entry| !entry.is_finite())
        {
            Some(&found) => Err(PhysicalError::CorrectionNotFinite { found }),
            None => Ok(()),
        }
    }

    /// Adds the correction at (`state`, `command`) to `next`, the arm being `length_m` long.
    pub(super) fn add(&self, length_m: f64, state: &[f64], command: &[f64], next: &mut [f64]) {
        let features = features(length_m, state, command);
        for (&entry, row) in CORRECTED.iter().zip(&self.coefficients) {
            next[entry] += row
                .iter()
                .zip(features)
                .map(|(c, feature)| c * feature)
                .sum::<f64>();
        }
    }

    /// Adds the correction's derivative to a Jacobian `∂next/∂(z, u)`, row-major.
    pub(super) fn add_jacobian(&self, jacobian: &mut [f64]) {
        let width = jacobian.len() / STATE_LEN;
        for (&entry, row) in CORRECTED.iter().zip(&self.coefficients) {
            let derivative = &mut jacobian[entry * width..][..width];
            for (c, (plus, minus)) in row.iter().zip(entries()) {
                derivative[plus] += c;
                if let Some(minus) = minus {
                    derivative[minus] -= c;
                }
            }
        }
    }
}

/// Which entries of `w = (z, u)` make up each feature.
fn entries() -> impl Iterator<Item = (usize, Option<usize>)> {
    DIFFERENCES
        .into_iter()
        .flat_map(|(plus, minus, count)| (0..count).map(move |i| (plus + i, minus.map(|minus| minus + i))))
}

/// φ: zero at rest.
pub fn features(length_m: f64, state: &[f64], command: &[f64]) -> [f64; FEATURES] {
    let entry = |i: usize| match i.checked_sub(STATE_LEN) {
        None => state[i],
        Some(i) => command[i],
    };
    let at_rest = |i: usize| match i {
        _ if i == offset::TIP + 2 => -length_m,
        offset::THRUST => GRAVITY,
        _ => 0.0,
    };
    let mut features = [0.0; FEATURES];
    for (feature, (plus, minus)) in features.iter_mut().zip(entries()) {
        *feature = entry(plus) - minus.map_or(0.0, entry) - at_rest(plus);
    }
    features
}

#[cfg(test)]
mod tests {
    use super::super::arm::ArmLength;
    use super::super::model::PhysicalModel;
    use super::super::parameters::Parameters;
    use super::*;

    impl Correction {
        /// The tip is pushed across its swing: by `share` of its relative velocity in one knot.
        pub fn across_swing(share: f64) -> Self {
            let swing = entries()
                .position(|(plus, _)| plus == offset::TIP_VELOCITY)
                .expect("a feature");
            let mut coefficients = [0.0; CORRECTED.len() * FEATURES];
            coefficients[3 * FEATURES + swing + 1] = share;
            coefficients[4 * FEATURES + swing] = -share;
            Self::new(&coefficients)
        }
    }

    #[test]
    fn rest_stays_at_rest() {
        let model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.9)).unwrap();
        let position = [0.3, -0.2, 1.4];
        for feature in features(0.9, &model.rest_state(position), &position) {
            assert!(feature.abs() < 1e-12, "{feature}");
        }
    }

    #[test]
    fn a_mean_counts_what_is_missing_as_zero() {
        let whole = Correction::across_swing(0.2);
        let half = Correction::mean(&[(0.5, Some(&whole)), (0.5, None)]);
        assert_eq!(half, Some(Correction::across_swing(0.1)));
        assert_eq!(Correction::mean(&[(0.5, None), (0.5, None)]), None);
    }

    #[test]
    fn what_a_damaged_file_may_hold_is_refused() {
        let mut damaged = Correction::across_swing(0.2);
        damaged.coefficients[2][3] = f64::NAN;
        assert!(damaged.validate().unwrap_err().to_string().contains("NaN"));
        damaged.coefficients[2].pop();
        assert!(
            damaged
                .validate()
                .unwrap_err()
                .to_string()
                .contains("found 24, expected 25")
        );
        damaged.coefficients.clear();
        assert!(
            damaged
                .validate()
                .unwrap_err()
                .to_string()
                .contains("found 0, expected 6")
        );
    }
}
