//! The grid of configurations that a bank's models were fitted at: one or two lengths, one or two pressures.

use super::super::error::{ModelError, require_finite};
use crate::flight::Configuration;

/// Lengths closer than this are the same, m.
pub const LENGTH_TOLERANCE_M: f64 = 1e-3;
/// Pressures closer than this are the same, kPa.
pub const PRESSURE_TOLERANCE_KPA: f64 = 5e-3;

/// Whether two configurations are the same within the tolerances.
pub(crate) fn same(a: &Configuration, b: &Configuration) -> bool {
    (a.length_m - b.length_m).abs() <= LENGTH_TOLERANCE_M
        && (a.pressure_kpa - b.pressure_kpa).abs() <= PRESSURE_TOLERANCE_KPA
}

/// The flown lengths and pressures.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Ascending, one or two.
    lengths_m: Vec<f64>,
    /// Ascending, one or two.
    pressures_kpa: Vec<f64>,
}

impl Grid {
    /// The grid that `configurations` lie on.
    ///
    /// # Errors
    /// More than two lengths or pressures, none, or one that is not a number.
    pub fn new(configurations: &[Configuration]) -> Result<Self, ModelError> {
        let values = |of: fn(&Configuration) -> f64| configurations.iter().map(of);
        Ok(Grid {
            lengths_m: axis(values(|own| own.length_m), LENGTH_TOLERANCE_M)?,
            pressures_kpa: axis(values(|own| own.pressure_kpa), PRESSURE_TOLERANCE_KPA)?,
        })
    }

    /// Its points, pressure-major: index = pressure index · lengths + length index.
    pub fn points(&self) -> impl Iterator<Item = Configuration> {
        self.pressures_kpa.iter().flat_map(|&pressure_kpa| {
            self.lengths_m.iter().map(move |&length_m| Configuration {
                length_m,
                pressure_kpa,
            })
        })
    }

    /// Shortest and longest, m.
    pub fn length_range_m(&self) -> [f64; 2] {
        ends(&self.lengths_m)
    }

    /// Lowest and highest, kPa.
    pub fn pressure_range_kpa(&self) -> [f64; 2] {
        ends(&self.pressures_kpa)
    }

    /// Whether `configuration` lies in the flown range (within the tolerances).
    pub fn covers(&self, configuration: Configuration) -> bool {
        let inside = |[low, high]: [f64; 2], value: f64, tolerance: f64| {
            (low - tolerance..=high + tolerance).contains(&value)
        };
        inside(self.length_range_m(), configuration.length_m, LENGTH_TOLERANCE_M)
            && inside(
                self.pressure_range_kpa(),
                configuration.pressure_kpa,
                PRESSURE_TOLERANCE_KPA,
            )
    }

    /// Weights of the points in the bilinear interpolation at `configuration`, which sum to one.
    pub fn weights(&self, configuration: Configuration) -> Vec<f64> {
        let along_length = axis_weights(&self.lengths_m, configuration.length_m);
        let along_pressure = axis_weights(&self.pressures_kpa, configuration.pressure_kpa);
        along_pressure
            .iter()
            .flat_map(|by_pressure| along_length.iter().map(move |by_length| by_pressure * by_length))
            .collect()
    }

    /// Of how many points the interpolation at `configuration` is made ([`super::Bank::models_at`]).
    pub fn points_mixed(&self, configuration: Configuration) -> f64 {
        let [shortest, longest] = self.length_range_m();
        let [lowest, highest] = self.pressure_range_kpa();
        let within = Configuration {
            length_m: configuration.length_m.clamp(shortest, longest),
            pressure_kpa: configuration.pressure_kpa.clamp(lowest, highest),
        };
        let weights = self.weights(within);
        weights.iter().map(|weight| weight * weight).sum::<f64>().recip()
    }
}

/// The distinct values of `values`, ascending: one or two of them.
fn axis(values: impl Iterator<Item = f64>, tolerance: f64) -> Result<Vec<f64>, ModelError> {
    let mut sorted: Vec<f64> = values.collect();
    require_finite("configurations of the bank's models", &sorted)?;
    sorted.sort_by(f64::total_cmp);
    sorted.dedup_by(|later, earlier| *later - *earlier <= tolerance);
    if !(1..=2).contains(&sorted.len()) {
        return Err(ModelError::Unsupported {
            what: "distinct lengths (or pressures) among the bank's models",
            found: format!("{sorted:?}"),
            expected: "one or two".into(),
        });
    }
    Ok(sorted)
}

/// Linear interpolation weights of `value` between the ends of `axis`.
fn axis_weights(axis: &[f64], value: f64) -> Vec<f64> {
    match *axis {
        [low, high] => {
            let fraction = (value - low) / (high - low);
            vec![1.0 - fraction, fraction]
        }
        _ => vec![1.0],
    }
}

fn ends(axis: &[f64]) -> [f64; 2] {
    [axis[0], axis[axis.len() - 1]]
}
