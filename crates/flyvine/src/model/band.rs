//! How far the end effector may be from a prediction: bands of confidence by split-conformal prediction.
//!
//! Models fitted on part of the flights predict the others. Wild motions are predicted worse than calm ones, so the
//! distance d at horizon h is compared with a spread that grows with how far the predicted arm leans at most, and with how
//! many models the prediction is made of ([`super::Bank::models_at`]), for between the bank's configurations none was fitted,
//! and often none was judged,
//!
//! ```text
//! σ(θ, n) = (1 + g θ) n,   radius(θ, n) = q σ(θ, n)
//! ```
//!
//! at every horizon with g and q of its own; q is the quotient d / σ that all but a share α of the held-out windows keep
//! within ("locally weighted" conformal prediction: Lei et al. 2018, "Distribution-free predictive inference for
//! regression", Sec. 5.2): with n windows the ⌈(n + 1)(1 − α)⌉-th smallest. Of several g the one is taken whose bands are
//! narrowest, by the mean logarithm of their radii. The guarantee is for flights like the held-out ones, all windows
//! together; what leans farther than any of them is an extrapolation. That n enters as it is was found on the reference
//! vehicle: of flights between its four corners, which alone had judged the bands, 50 to 100 % of the windows were inside
//! without it, 85 to 100 % with √n, 93 to 100 % with n.

use super::error::{ModelError, require_finite};
use super::rollout::WindowError;
use serde::{Deserialize, Deserializer, Serialize};

/// Share of the windows that a band is to contain.
pub const BAND_CONFIDENCE: f64 = 0.95;
/// Fewer windows than this say nothing about a 95 % quantile.
const FEWEST_WINDOWS: usize = 40;
/// Growths of the spread with the arm's angle that are tried, 1/rad.
const GROWTHS: [f64; 8] = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// Radius of the band of confidence about a predicted end effector, by time since the prediction began and by how far
/// the predicted arm leans.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PredictionBand {
    /// Share of predictions that it contains.
    pub confidence: f64,
    /// Horizons, s, ascending.
    pub horizons_s: Vec<f64>,
    /// Radius at every horizon while the arm hangs straight down, at a model's own configuration, m.
    pub radii_m: Vec<f64>,
    /// By how much of that the radius at every horizon grows per radian that the arm leans, 1/rad; if there is one number,
    /// it is that of all horizons, as in banks of earlier versions.
    #[serde(default, deserialize_with = "one_or_many")]
    pub growth_per_rad: Vec<f64>,
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
        let (growth_per_rad, radii_m): (Vec<f64>, Vec<f64>) =
            windows.iter().map_while(|here| narrowest(here)).unzip();
        let count = radii_m.len();
        (count > 0).then(|| PredictionBand {
            confidence: BAND_CONFIDENCE,
            horizons_s: horizons[..count]
                .iter()
                .map(|&steps| steps as f64 * crate::DT)
                .collect(),
            radii_m,
            growth_per_rad,
            windows: windows[..count].iter().map(Vec::len).collect(),
            flights,
        })
    }

    /// The radius `t_s` after the prediction began, m, where the predicted arm has leant `arm_angle` (rad) at most and the
    /// prediction is made of so many `models`: linear between the horizons, and kept before the first and after the last.
    pub fn radius_m(&self, t_s: f64, arm_angle: f64, models: f64) -> f64 {
        let times = &self.horizons_s;
        let radius = |horizon: usize| self.radii_m[horizon] * spread(self.growth(horizon), arm_angle, models);
        match times.iter().position(|&horizon| horizon >= t_s) {
            Some(0) => radius(0),
            None => radius(times.len() - 1),
            Some(after) => {
                let share = (t_s - times[after - 1]) / (times[after] - times[after - 1]);
                radius(after - 1) + share * (radius(after) - radius(after - 1))
            }
        }
    }

    /// Growth of the radius at the horizon of this number, 1/rad.
    pub(crate) fn growth(&self, horizon: usize) -> f64 {
        let growths = &self.growth_per_rad;
        growths.get(horizon).or(growths.last()).copied().unwrap_or(0.0)
    }

    /// Refuses what a damaged file may hold.
    pub(crate) fn validate(&self) -> Result<(), ModelError> {
        require_finite("radii of the band", &self.radii_m)?;
        require_finite("horizons of the band", &self.horizons_s)?;
        let growths = &self.growth_per_rad;
        if let Some(growth) = growths
            .iter()
            .find(|growth| !(**growth >= 0.0 && growth.is_finite()))
        {
            return Err(ModelError::Unsupported {
                what: "growth of the band, 1/rad",
                found: growth.to_string(),
                expected: "a number of at least 0".into(),
            });
        }
        let count = self.horizons_s.len();
        if count == 0 || self.radii_m.len() != count || self.windows.len() != count {
            return Err(ModelError::Shape {
                what: "radii of the band".into(),
                found: self.radii_m.len(),
                expected: count.max(1),
            });
        }
        if growths.len() > 1 && growths.len() != count {
            return Err(ModelError::Shape {
                what: "growths of the band".into(),
                found: growths.len(),
                expected: count,
            });
        }
        Ok(())
    }
}

/// A list, or a number for a list of one.
fn one_or_many<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum OneOrMany {
        One(f64),
        Many(Vec<f64>),
    }
    Ok(match OneOrMany::deserialize(deserializer)? {
        OneOrMany::One(growth) => vec![growth],
        OneOrMany::Many(growths) => growths,
    })
}

/// The growth whose bands about `windows` are narrowest, and its radius of an arm that hangs straight down; `None` if there
/// is no finite one.
fn narrowest(windows: &[WindowError]) -> Option<(f64, f64)> {
    let mean_logarithm = |&(growth, radius): &(f64, f64)| {
        let logarithms = windows
            .iter()
            .map(|window| (radius * spread(growth, window.arm_angle, window.models)).ln());
        logarithms.sum::<f64>() / windows.len() as f64
    };
    GROWTHS
        .into_iter()
        .filter_map(|growth| Some((growth, conformal_quantile(windows, growth)?)))
        .min_by(|a, b| mean_logarithm(a).total_cmp(&mean_logarithm(b)))
}

/// σ.
fn spread(growth: f64, arm_angle: f64, models: f64) -> f64 {
    (1.0 + growth * arm_angle) * models
}

/// q; `None` if it is not finite, or there are too few windows.
fn conformal_quantile(windows: &[WindowError], growth: f64) -> Option<f64> {
    let mut quotients: Vec<f64> = windows
        .iter()
        .map(|window| window.last_m / spread(growth, window.arm_angle, window.models))
        .collect();
    quotients.sort_by(f64::total_cmp);
    let rank = ((quotients.len() + 1) as f64 * BAND_CONFIDENCE).ceil() as usize;
    let radius = *quotients.get(rank.max(1) - 1)?;
    (radius.is_finite() && windows.len() >= FEWEST_WINDOWS).then_some(radius)
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
                arm_angle: 0.0,
                models: 1.0,
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
        assert!((band.radius_m(0.5, 0.0, 1.0) - 0.095).abs() < 1e-12);
        assert!((band.radius_m(0.75, 0.3, 1.0) - 0.1425).abs() < 1e-12);
        assert_eq!(
            (band.radius_m(0.0, 0.0, 1.0), band.radius_m(9.0, 0.0, 1.0)),
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
    #[test]
    fn a_band_that_shrinks_as_the_arm_leans_is_refused() {
        let band = |growth_per_rad: f64| PredictionBand {
            confidence: BAND_CONFIDENCE,
            horizons_s: vec![0.5],
            radii_m: vec![0.01],
            growth_per_rad: vec![growth_per_rad],
            windows: vec![100],
            flights: Vec::new(),
        };
        assert!(band(0.0).validate().is_ok());
        for growth in [-5.0, f64::NAN, f64::INFINITY] {
            let error = band(growth).validate().unwrap_err().to_string();
            assert!(error.contains(&growth.to_string()), "{error}");
        }
        let uneven = PredictionBand {
            growth_per_rad: vec![1.0; 3],
            ..band(0.0)
        };
        assert!(uneven.validate().unwrap_err().to_string().contains("growths"));
    }

    #[test]
    fn one_growth_serves_all_horizons_as_in_earlier_banks() {
        let text = r#"{"confidence": 0.95, "horizons_s": [0.5, 1.0], "radii_m": [0.01, 0.02], "growth_per_rad": 2.0,
                       "windows": [99, 99], "flights": []}"#;
        let band: PredictionBand = serde_json::from_str(text).unwrap();
        band.validate().unwrap();
        assert_eq!(
            (band.radius_m(0.5, 0.5, 1.0), band.radius_m(1.0, 0.5, 1.0)),
            (0.02, 0.04)
        );
        let each = PredictionBand {
            growth_per_rad: vec![2.0, 4.0],
            ..band
        };
        assert_eq!(each.radius_m(1.0, 0.5, 1.0), 0.06);
    }

    #[test]
    fn the_band_is_wider_between_models() {
        let corner = windows((1..=99).map(|i| 0.001 * f64::from(i)));
        let between = |own: &WindowError| WindowError {
            last_m: 2.0 * own.last_m,
            models: 2.0,
            ..*own
        };
        // Windows between two models, twice as far off, say the same of the band as those at the models' own configurations.
        let all = [corner.clone(), corner.iter().map(between).collect()].concat();
        let radius = |windows| {
            PredictionBand::of_windows(&[10], &[windows], Vec::new())
                .unwrap()
                .radius_m(0.5, 0.0, 1.0)
        };
        assert!((radius(all) - radius(corner.clone())).abs() < 1.5e-3);
        let band = PredictionBand::of_windows(&[10], &[corner], Vec::new()).unwrap();
        assert_eq!(band.radius_m(0.5, 0.2, 4.0), 4.0 * band.radius_m(0.5, 0.2, 1.0));
    }

    #[test]
    fn the_band_is_wider_where_the_arm_leans() {
        // Distances grow with the angle: 1 cm of an arm that hangs, 9 cm at 1 rad, up to a fifth more or less.
        let held_out: Vec<WindowError> = (0..400)
            .map(|i| {
                let arm_angle = if i % 10 == 0 {
                    1.0
                } else {
                    0.001 * f64::from(i % 10)
                };
                let last_m = 0.01 * (1.0 + 8.0 * arm_angle) * (1.0 + 0.2 * f64::from(i).sin());
                WindowError {
                    start: 0,
                    mean_m: last_m,
                    last_m,
                    arm_angle,
                    models: 1.0,
                    diverged: false,
                }
            })
            .collect();
        let band = PredictionBand::of_windows(&[10], std::slice::from_ref(&held_out), Vec::new()).unwrap();
        assert_eq!(band.growth_per_rad, [8.0]);
        for leaning in [false, true] {
            let kind: Vec<&WindowError> = held_out
                .iter()
                .filter(|window| (window.arm_angle > 0.5) == leaning)
                .collect();
            let inside =
                (kind.iter()).filter(|window| window.last_m <= band.radius_m(0.5, window.arm_angle, 1.0));
            let share = inside.count() as f64 / kind.len() as f64;
            assert!((0.9..0.99).contains(&share), "{share}");
        }
    }
}
