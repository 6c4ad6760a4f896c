//! How far the end effector may be from a prediction: bands of confidence by split-conformal prediction.
//!
//! Models fitted on part of the flights predict the others. Over those held-out windows, the distance at horizon h
//! that all but a share α of them keep within is the radius of the band at h (Lei et al. 2018, "Distribution-free
//! predictive inference for regression"): with n windows the ⌈(n + 1)(1 − α)⌉-th smallest distance. The guarantee
//! is for flights like the held-out ones; wilder flights leave the band more often.

use super::error::{ModelError, require_finite};
use super::rollout::WindowError;
use serde::{Deserialize, Serialize};

/// Share of the windows that a band is to contain.
pub const BAND_CONFIDENCE: f64 = 0.95;
/// Fewer windows than this say nothing about a 95 % quantile.
const FEWEST_WINDOWS: usize = 40;

/// Radius of the band of confidence about a predicted end effector, by time since the prediction began.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PredictionBand {
    /// Share of predictions that it contains.
    pub confidence: f64,
    /// Horizons, s, ascending.
    pub horizons_s: Vec<f64>,
    /// Radius at every horizon, m.
    pub radii_m: Vec<f64>,
    /// Windows that the radius at every horizon was taken from.
    pub windows: Vec<usize>,
    /// Names of the held-out flights.
    pub flights: Vec<String>,
}

impl PredictionBand {
    /// The band of `windows`, a list per horizon of `horizons` (steps); horizons with too few windows, or on
    /// which predictions diverge too often for a finite radius, are left out. `None` if none is left.
    pub(crate) fn of_windows(
        horizons: &[usize],
        windows: &[Vec<WindowError>],
        flights: Vec<String>,
    ) -> Option<Self> {
        let mut band = PredictionBand {
            confidence: BAND_CONFIDENCE,
            horizons_s: Vec::new(),
            radii_m: Vec::new(),
            windows: Vec::new(),
            flights,
        };
        for (&steps, here) in horizons.iter().zip(windows) {
            let mut distances: Vec<f64> = here.iter().map(|window| window.last_m).collect();
            distances.sort_by(f64::total_cmp);
            let rank = ((distances.len() + 1) as f64 * BAND_CONFIDENCE).ceil() as usize;
            match distances.get(rank.max(1) - 1) {
                Some(&radius) if radius.is_finite() && distances.len() >= FEWEST_WINDOWS => {
                    band.horizons_s.push(steps as f64 * crate::DT);
                    band.radii_m.push(radius);
                    band.windows.push(distances.len());
                }
                _ => break,
            }
        }
        (!band.radii_m.is_empty()).then_some(band)
    }

    /// The radius `t_s` after the prediction began, m: linear between the horizons, and kept before the first and
    /// after the last.
    pub fn radius_m(&self, t_s: f64) -> f64 {
        let (times, radii) = (&self.horizons_s, &self.radii_m);
        let last = times.len() - 1;
        match times.iter().position(|&horizon| horizon >= t_s) {
            Some(0) => radii[0],
            None => radii[last],
            Some(after) => {
                let share = (t_s - times[after - 1]) / (times[after] - times[after - 1]);
                radii[after - 1] + share * (radii[after] - radii[after - 1])
            }
        }
    }

    /// Refuses what a damaged file may hold.
    pub(crate) fn validate(&self) -> Result<(), ModelError> {
        require_finite("radii of the band", &self.radii_m)?;
        require_finite("horizons of the band", &self.horizons_s)?;
        let count = self.horizons_s.len();
        if count == 0 || self.radii_m.len() != count || self.windows.len() != count {
            return Err(ModelError::Shape {
                what: "radii of the band".into(),
                found: self.radii_m.len(),
                expected: count.max(1),
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(distances: impl Iterator<Item = f64>) -> Vec<WindowError> {
        distances
            .map(|last_m| WindowError {
                start: 0,
                mean_m: last_m,
                last_m,
                diverged: false,
            })
            .collect()
    }

    #[test]
    fn the_radius_is_the_conformal_order_statistic() {
        let first = windows((1..=99).map(|i| 0.001 * f64::from(i)));
        let second = windows((1..=99).map(|i| 0.002 * f64::from(i)));
        let band = PredictionBand::of_windows(&[10, 20], &[first, second], Vec::new()).unwrap();
        // ⌈100 · 0.95⌉ = 95th of 99.
        assert!((band.radius_m(0.5) - 0.095).abs() < 1e-12);
        assert!((band.radius_m(0.75) - 0.1425).abs() < 1e-12);
        assert_eq!(
            (band.radius_m(0.0), band.radius_m(9.0)),
            (band.radii_m[0], band.radii_m[1])
        );
        band.validate().unwrap();
    }

    #[test]
    fn horizons_that_run_away_or_are_seldom_seen_have_no_radius() {
        let good = windows((0..99).map(|i| 0.001 * f64::from(i)));
        let wild = windows((0..99).map(|i| if i < 80 { 0.1 } else { f64::INFINITY }));
        let band = PredictionBand::of_windows(&[10, 20], &[good.clone(), wild.clone()], Vec::new()).unwrap();
        assert_eq!(band.horizons_s, [0.5]);
        assert!(PredictionBand::of_windows(&[10], &[wild], Vec::new()).is_none());
        assert!(PredictionBand::of_windows(&[10], &[good[..30].to_vec()], Vec::new()).is_none());
    }
}
