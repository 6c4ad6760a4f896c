//! Vehicle parameters by their path in the vehicle's TOML.

use flyvine::sim::VehicleParameters;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// How a parameter is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Spread {
    /// Evenly between two values.
    Uniform([f64; 2]),
    /// Evenly within ± this share of the vehicle's own value.
    Relative(f64),
    /// From a normal distribution: mean, standard deviation.
    Normal([f64; 2]),
}

impl Spread {
    /// Why it is no distribution, if it is none.
    pub(crate) fn fault(&self, own: f64) -> Option<&'static str> {
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        match *self {
            Self::Uniform([low, high]) if !(finite(&[low, high]) && low <= high) => {
                Some("`uniform = [low, high]`, finite and ascending")
            }
            Self::Relative(share) if !(finite(&[share]) && (0.0..1.0).contains(&share)) => {
                Some("`relative = share`, from 0 to less than 1")
            }
            Self::Relative(_) if own == 0.0 => {
                Some("`uniform` or `normal`: the vehicle's own value is zero, and so is every share of it")
            }
            Self::Normal([mean, deviation]) if !(finite(&[mean, deviation]) && deviation >= 0.0) => {
                Some("`normal = [mean, deviation]`, finite, the deviation not negative")
            }
            _ => None,
        }
    }

    /// The draw of `seed` for the parameter at `path`, whose own value is `own`. It depends on nothing else, so that a
    /// seed meets the same vehicle in every cell of a grid, and under every control law.
    pub(crate) fn draw(&self, path: &str, own: f64, seed: u64) -> f64 {
        let hash = Sha256::digest(path.as_bytes());
        let stream = u64::from_le_bytes(std::array::from_fn(|byte| hash[byte]));
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        match *self {
            Self::Uniform([low, high]) => low + (high - low) * random.random::<f64>(),
            Self::Relative(share) => own * (1.0 + share * (2.0 * random.random::<f64>() - 1.0)),
            Self::Normal([mean, deviation]) => {
                let normal: f64 = StandardNormal.sample(&mut random);
                mean + deviation * normal
            }
        }
    }
}

/// A vehicle whose numbers are reached by their paths.
#[derive(Debug, Clone)]
pub(crate) struct ParameterTree(Value);

impl ParameterTree {
    pub fn new(vehicle: &VehicleParameters) -> Result<Self, serde_json::Error> {
        serde_json::to_value(vehicle).map(Self)
    }

    /// The number at `path`; a parameter that is switched off counts as zero. `None` if there is no such number.
    pub fn get(&self, path: &str) -> Option<f64> {
        match self.0.pointer(&pointer(path))? {
            Value::Null => Some(0.0),
            value => value.as_f64(),
        }
    }

    /// Puts `number` at `path`, which must be there.
    pub fn set(&mut self, path: &str, number: f64) {
        if let Some(place) = self.0.pointer_mut(&pointer(path)) {
            // Counts stay whole numbers; what is none is refused by the vehicle itself.
            *place = if place.is_u64() && number.fract() == 0.0 && number >= 0.0 {
                Value::from(number as u64)
            } else {
                Value::from(number)
            };
        }
    }

    /// The vehicle, or why it is none.
    pub fn vehicle(self) -> Result<VehicleParameters, String> {
        let vehicle: VehicleParameters = serde_json::from_value(self.0).map_err(|error| error.to_string())?;
        vehicle.validate().map_err(|error| error.to_string())?;
        Ok(vehicle)
    }
}

/// `wind.mean_m_s.0` → `/wind/mean_m_s/0`.
fn pointer(path: &str) -> String {
    format!("/{}", path.replace('.', "/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_reached_by_the_paths_of_the_toml() {
        let mut tree = ParameterTree::new(&VehicleParameters::default()).unwrap();
        assert_eq!(tree.get("quadrotor.total_mass_kg"), Some(1.7));
        assert_eq!(tree.get("contact.floor_m"), Some(0.0));
        for nothing in ["wind", "wind.mean_m_s", "wind.mean_m_s.3", "gravity"] {
            assert_eq!(tree.get(nothing), None, "{nothing}");
        }
        tree.set("wind.mean_m_s.1", 2.5);
        tree.set("mocap.dropout_frames", 4.0);
        let vehicle = tree.vehicle().unwrap();
        assert_eq!(vehicle.wind.mean_m_s, [0.0, 2.5, 0.0]);
        assert_eq!(vehicle.mocap.dropout_frames, 4);
    }

    #[test]
    fn a_value_out_of_range_is_refused_by_name() {
        let mut tree = ParameterTree::new(&VehicleParameters::default()).unwrap();
        tree.set("wind.gust_m_s", -1.0);
        assert!(tree.vehicle().unwrap_err().contains("wind.gust_m_s = -1"));
    }

    #[test]
    fn draws_depend_on_seed_and_path_and_have_their_moments() {
        let spread = Spread::Normal([2.0, 0.5]);
        assert_eq!(spread.draw("a", 0.0, 7), spread.draw("a", 0.0, 7));
        assert_ne!(spread.draw("a", 0.0, 7), spread.draw("b", 0.0, 7));
        let draws: Vec<f64> = (0..4000).map(|seed| spread.draw("a", 0.0, seed)).collect();
        let mean = draws.iter().sum::<f64>() / 4000.0;
        let variance = draws.iter().map(|draw| (draw - mean).powi(2)).sum::<f64>() / 3999.0;
        assert!((mean - 2.0).abs() < 4.0 * 0.5 / 4000.0_f64.sqrt(), "{mean}");
        assert!((variance.sqrt() - 0.5).abs() < 0.03, "{variance}");
        let around: Vec<f64> = (0..400)
            .map(|seed| Spread::Relative(0.1).draw("a", 3.0, seed))
            .collect();
        assert!(around.iter().all(|value| (2.7..=3.3).contains(value)));
    }

    #[test]
    fn what_is_no_distribution_is_named() {
        assert!(Spread::Uniform([1.0, 0.0]).fault(1.0).is_some());
        assert!(Spread::Relative(0.1).fault(0.0).unwrap().contains("zero"));
        assert!(Spread::Normal([0.0, f64::NAN]).fault(1.0).is_some());
        assert!(Spread::Relative(0.1).fault(1.0).is_none());
    }
}
