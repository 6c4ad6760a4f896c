//! The models of the configurations that were flown, and the bilinear interpolation between them
//! (Jitosho et al., Sec. III-B).

use super::band::PredictionBand;
use super::error::ModelError;
use super::family::Model;
use super::lag::CommandInputs;
use super::noise::NoiseLevels;
use super::options::FitOptions;
use super::physical::PhysicalModel;
use super::schedule::ScheduledModel;
use super::selection::Candidate;
use super::support::Support;
use crate::flight::Configuration;
use crate::link::Feedforward;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;

/// Lengths closer than this are the same, m.
pub const LENGTH_TOLERANCE_M: f64 = 1e-3;
/// Pressures closer than this are the same, kPa.
pub const PRESSURE_TOLERANCE_KPA: f64 = 5e-3;

/// Whether a configuration outside the flown range may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Extrapolation {
    /// It is an error.
    #[default]
    Refuse,
    /// The bilinear form is continued linearly.
    Allow,
}

/// How well one model's fit was determined.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelDiagnostics {
    /// Names of the flights it was fitted on.
    pub flights: Vec<String>,
    /// Rows fitted.
    pub rows: usize,
    /// Coefficients of the largest row.
    pub coefficients: usize,
    /// Condition number of that row's equilibrated regressors (1 is best); infinite, `null` in a file, if they depend on each
    /// other, so that only a ridge told them apart.
    #[serde(deserialize_with = "null_is_infinite")]
    pub condition_number: f64,
    /// The same for the linear rows.
    #[serde(deserialize_with = "null_is_infinite")]
    pub linear_condition_number: f64,
    /// Spectral radius of the Jacobian at rest.
    pub spectral_radius: f64,
    /// Root-mean-square residual of the fit per signal, m (positions) or 1 (attitude).
    pub residual_rms: BTreeMap<String, f64>,
}

/// JSON knows no infinity.
fn null_is_infinite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

/// A model and where in the bank it sits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BankModel {
    /// Configuration that it was fitted at.
    pub configuration: Configuration,
    /// The predictor.
    pub model: Model,
    /// How well its fit was determined.
    pub diagnostics: ModelDiagnostics,
}

/// Where a bank came from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BankProvenance {
    /// Program and version that fitted it.
    pub tool: String,
    /// Recordings it was fitted on.
    pub inputs: Vec<InputFile>,
    /// Options of the fit.
    pub options: FitOptions,
    /// What the fit chose under these options; `None` if the models were not fitted here.
    pub chosen: Option<Candidate>,
    /// Where between two fitted banks this one lies; `None` if it was fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub between: Option<Between>,
}

/// Where a bank lies between two that were fitted, along a variable that is neither length nor pressure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Between {
    /// Name of the variable, with its unit, as in `payload_kg`.
    pub variable: String,
    /// The values that the two were fitted at, ascending.
    pub fitted_at: [f64; 2],
    /// Its own value.
    pub at: f64,
}

/// A file and its hash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputFile {
    /// Path as it was given.
    pub path: String,
    /// SHA-256 of its contents, hexadecimal.
    pub sha256: String,
}

/// The models of the flown configurations: one, two along one axis, or four corners.
#[derive(Debug, Clone, PartialEq)]
pub struct Bank {
    /// Ascending, one or two.
    lengths_m: Vec<f64>,
    /// Ascending, one or two.
    pressures_kpa: Vec<f64>,
    /// Pressure-major: index = pressure index · lengths + length index.
    models: Vec<BankModel>,
    extrapolation: Extrapolation,
    provenance: BankProvenance,
    band: Option<PredictionBand>,
    noise: Option<NoiseLevels>,
    support: Option<Support>,
}

impl Bank {
    /// Puts `models`, in any order, on their grid.
    ///
    /// # Errors
    /// A corner without a model, two models at one configuration, or models whose coefficients cannot be mixed.
    pub fn new(models: Vec<BankModel>, provenance: BankProvenance) -> Result<Self, ModelError> {
        let lengths_m = axis(
            models.iter().map(|m| m.configuration.length_m),
            LENGTH_TOLERANCE_M,
        )?;
        let pressures_kpa = axis(
            models.iter().map(|m| m.configuration.pressure_kpa),
            PRESSURE_TOLERANCE_KPA,
        )?;
        let mut ordered = Vec::with_capacity(models.len());
        for &pressure_kpa in &pressures_kpa {
            for &length_m in &lengths_m {
                let corner = Configuration {
                    length_m,
                    pressure_kpa,
                };
                let mut here = models.iter().filter(|m| same(&m.configuration, &corner));
                let model = here.next().ok_or(ModelError::MissingCorner { missing: corner })?;
                if here.next().is_some() {
                    return Err(ModelError::DuplicateConfiguration {
                        configuration: corner,
                    });
                }
                ordered.push(model.clone());
            }
        }
        for model in &ordered {
            if let Model::Physical(physical) = &model.model {
                physical.validate()?;
            }
        }
        for (index, other) in ordered.iter().enumerate().skip(1) {
            if let Some(what) = ordered[0].model.structure_difference(&other.model) {
                return Err(ModelError::MixedStructure { index, what });
            }
        }
        Ok(Self {
            lengths_m,
            pressures_kpa,
            models: ordered,
            extrapolation: Extrapolation::Refuse,
            provenance,
            band: None,
            noise: None,
            support: None,
        })
    }

    /// The same bank with a band of confidence about its predictions.
    ///
    /// # Errors
    /// A radius or horizon that is not finite, or no horizon.
    pub fn with_band(mut self, band: Option<PredictionBand>) -> Result<Self, ModelError> {
        if let Some(band) = &band {
            band.validate()?;
        }
        self.band = band;
        Ok(self)
    }

    /// How far the end effector may be from a prediction; `None` if no flight was held out to measure it.
    pub fn band(&self) -> Option<&PredictionBand> {
        self.band.as_ref()
    }

    /// The same bank with noise levels for estimators on its models.
    ///
    /// # Errors
    /// A level that is out of its range.
    pub fn with_noise(mut self, noise: Option<NoiseLevels>) -> Result<Self, ModelError> {
        if let Some(levels) = &noise {
            levels.validate()?;
        }
        self.noise = noise;
        Ok(self)
    }

    /// Noise levels for estimators on the bank's models; `None` if they were not identified.
    pub fn noise(&self) -> Option<&NoiseLevels> {
        self.noise.as_ref()
    }

    /// The same bank with the region that its flights support.
    ///
    /// # Errors
    /// A limit that is not a number of at least zero.
    pub fn with_support(mut self, support: Option<Support>) -> Result<Self, ModelError> {
        if let Some((name, found)) = support.as_ref().and_then(Support::invalid) {
            return Err(ModelError::Support { name, found });
        }
        self.support = support;
        Ok(self)
    }

    /// The region that the bank's flights support; `None` if it was not recorded.
    pub fn support(&self) -> Option<&Support> {
        self.support.as_ref()
    }

    /// The same bank with another policy for configurations outside its range; a file does not keep it.
    pub fn with_extrapolation(mut self, extrapolation: Extrapolation) -> Self {
        self.extrapolation = extrapolation;
        self
    }

    /// The same bank for flights that are sent positions only, as those of most plans are: without the feed-forward of physical models
    /// that were fitted to flights which were sent velocities, too.
    pub fn sent_positions_only(&self) -> Self {
        self.map_physical(|_, model| {
            model.parameters.velocity_feedforward = 0.0;
            model.parameters.acceleration_feedforward = 0.0;
        })
    }

    /// The same bank with its physical models changed, each of which `change` is given with its number.
    pub(crate) fn map_physical(&self, change: impl Fn(usize, &mut PhysicalModel)) -> Self {
        let mut bank = self.clone();
        for (number, model) in bank.models.iter_mut().enumerate() {
            if let Model::Physical(physical) = &mut model.model {
                change(number, physical);
            }
        }
        bank
    }

    /// Whether something corrects physics in any of the models ([`super::physical::Correction`]).
    pub fn is_corrected(&self) -> bool {
        let corrected =
            |own: &BankModel| matches!(&own.model, Model::Physical(model) if model.correction.is_some());
        self.models.iter().any(corrected)
    }

    /// What the bank's flights were sent beside positions.
    pub fn feedforward(&self) -> Feedforward {
        let knows_velocities = |model: &BankModel| match &model.model {
            Model::Lag(lag) => lag.inputs() == CommandInputs::PositionAndVelocity,
            Model::Physical(physical) => physical.parameters.velocity_feedforward != 0.0,
        };
        match self.models.iter().all(knows_velocities) {
            true => Feedforward::Velocity,
            false => Feedforward::None,
        }
    }

    /// The same bank with the recordings that it was fitted on.
    pub fn with_inputs(mut self, inputs: Vec<InputFile>) -> Self {
        self.provenance.inputs = inputs;
        self
    }

    /// The models, pressure-major.
    pub fn models(&self) -> &[BankModel] {
        &self.models
    }

    /// Where the bank came from.
    pub fn provenance(&self) -> &BankProvenance {
        &self.provenance
    }

    /// Smallest and largest length, m.
    pub fn length_range_m(&self) -> [f64; 2] {
        ends(&self.lengths_m)
    }

    /// Smallest and largest pressure, kPa.
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

    /// Of how many models the one at `configuration` is made, `1 / Σ w²` with the weights w of the interpolation: 1 at a
    /// model's own configuration and beyond the outermost ones, 2 midway between two, 4 midway between four.
    pub fn models_at(&self, configuration: Configuration) -> f64 {
        let along = |axis: &[f64], value: f64| {
            let [low, high] = ends(axis);
            let weights = axis_weights(axis, value.clamp(low, high));
            weights.iter().map(|weight| weight * weight).sum::<f64>().recip()
        };
        along(&self.lengths_m, configuration.length_m)
            * along(&self.pressures_kpa, configuration.pressure_kpa)
    }

    /// The model at `configuration`, its coefficients interpolated bilinearly.
    ///
    /// # Errors
    /// Outside the flown range, unless extrapolation is allowed ([`Self::with_extrapolation`]). An axis along
    /// which only one value was flown cannot be extrapolated; there the flown value is used.
    pub fn at(&self, configuration: Configuration) -> Result<Model, ModelError> {
        let finite = configuration.length_m.is_finite() && configuration.pressure_kpa.is_finite();
        if !finite || (self.extrapolation == Extrapolation::Refuse && !self.covers(configuration)) {
            return Err(ModelError::OutsideBank {
                configuration,
                length_m: self.length_range_m(),
                pressure_kpa: self.pressure_range_kpa(),
            });
        }
        let along_length = axis_weights(&self.lengths_m, configuration.length_m);
        let along_pressure = axis_weights(&self.pressures_kpa, configuration.pressure_kpa);
        let mut parts = Vec::with_capacity(self.models.len());
        for (i, by_pressure) in along_pressure.iter().enumerate() {
            for (j, by_length) in along_length.iter().enumerate() {
                let model = &self.models[i * along_length.len() + j].model;
                parts.push((by_pressure * by_length, model));
            }
        }
        Ok(Model::between(&parts, configuration))
    }

    /// The time-varying model whose knot k has configuration `configurations[k]`; knots past the end keep the
    /// last one.
    ///
    /// # Errors
    /// No configuration at all, or as [`Self::at`].
    pub fn scheduled(&self, configurations: &[Configuration]) -> Result<ScheduledModel, ModelError> {
        if configurations.is_empty() {
            return Err(ModelError::Shape {
                what: "schedule of configurations".into(),
                found: 0,
                expected: 1,
            });
        }
        let growth = |knot: usize| {
            let next = configurations.get(knot + 1).unwrap_or(&configurations[knot]);
            (next.length_m - configurations[knot].length_m) / crate::DT
        };
        let mut schedule = ScheduledModel::with_noise(self.noise);
        for (knot, &configuration) in configurations.iter().enumerate() {
            let changed =
                |before: usize| configuration != configurations[before] || growth(knot) != growth(before);
            if knot.checked_sub(1).is_none_or(changed) {
                schedule.push(self.at(configuration)?.growing(growth(knot)));
            } else {
                schedule.repeat();
            }
        }
        Ok(schedule)
    }
}

/// Whether two configurations are the same within the tolerances.
pub(crate) fn same(a: &Configuration, b: &Configuration) -> bool {
    (a.length_m - b.length_m).abs() <= LENGTH_TOLERANCE_M
        && (a.pressure_kpa - b.pressure_kpa).abs() <= PRESSURE_TOLERANCE_KPA
}

/// The distinct values of `values`, ascending: one or two of them.
fn axis(values: impl Iterator<Item = f64>, tolerance: f64) -> Result<Vec<f64>, ModelError> {
    let mut sorted: Vec<f64> = values.collect();
    super::error::require_finite("configurations of the bank's models", &sorted)?;
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

#[cfg(test)]
mod tests {
    use super::super::lag::tests::random_model;
    use super::super::lag::{CommandInputs, HEIGHT_ROW, STATE_LEN};
    use super::*;
    use crate::trajopt::Dynamics;

    const fn configuration(length_m: f64, pressure_kpa: f64) -> Configuration {
        Configuration {
            length_m,
            pressure_kpa,
        }
    }

    const CORNERS: [Configuration; 4] = [
        configuration(1.0, 0.4),
        configuration(0.7, 0.0),
        configuration(1.0, 0.0),
        configuration(0.7, 0.4),
    ];

    fn model(configuration: Configuration, seed: u64) -> BankModel {
        BankModel {
            configuration,
            model: Model::Lag(random_model(3, CommandInputs::Position, &[HEIGHT_ROW], seed)),
            diagnostics: ModelDiagnostics::default(),
        }
    }

    fn four_corners() -> Vec<BankModel> {
        CORNERS
            .iter()
            .zip(1..)
            .map(|(&corner, seed)| model(corner, seed))
            .collect()
    }

    fn bank(models: Vec<BankModel>) -> Result<Bank, ModelError> {
        Bank::new(models, BankProvenance::default())
    }

    fn predict(model: &Model) -> [f64; STATE_LEN] {
        let state: Vec<f64> = (0..27).map(|i| (i as f64).sin()).collect();
        let mut fresh = [0.0; STATE_LEN];
        model.step(0, &state, &[0.1, -0.2, 1.5], &mut fresh);
        fresh
    }

    #[test]
    fn interpolated_coefficients_interpolate_predictions() {
        let models = four_corners();
        let corner = |index: usize| predict(&models[index].model);
        let (il, es, el, is) = (corner(0), corner(1), corner(2), corner(3));
        let between = predict(
            &bank(models.clone())
                .unwrap()
                .at(configuration(0.775, 0.3))
                .unwrap(),
        );
        for row in 0..STATE_LEN {
            let short = 0.25 * es[row] + 0.75 * is[row];
            let long = 0.25 * el[row] + 0.75 * il[row];
            assert!((between[row] - (0.75 * short + 0.25 * long)).abs() < 1e-13);
        }
    }

    #[test]
    fn a_corner_is_its_own_model_to_the_last_bit() {
        let models = four_corners();
        let bank = bank(models.clone()).unwrap();
        for model in &models {
            assert_eq!(bank.at(model.configuration).unwrap(), model.model);
        }
    }

    #[test]
    fn outside_the_flown_range_is_an_error_unless_allowed() {
        let bank = bank(four_corners()).unwrap();
        for outside in [
            configuration(1.1, 0.2),
            configuration(0.8, -0.1),
            configuration(f64::NAN, 0.0),
        ] {
            let message = bank.at(outside).unwrap_err().to_string();
            assert!(
                message.contains("length 0.700 to 1.000 m and pressure 0.000 to 0.400 kPa"),
                "{message}"
            );
        }
        let allowing = bank.with_extrapolation(Extrapolation::Allow);
        assert!(allowing.at(configuration(1.1, 0.2)).is_ok());
        assert!(allowing.at(configuration(f64::INFINITY, 0.2)).is_err());
    }

    #[test]
    fn models_at_counts_what_is_mixed() {
        let bank = bank(four_corners())
            .unwrap()
            .with_extrapolation(Extrapolation::Allow);
        for (at, models) in [
            (CORNERS[1], 1.0),
            (configuration(0.85, 0.0), 2.0),
            (configuration(0.85, 0.2), 4.0),
            (configuration(1.2, 0.0), 1.0),
        ] {
            assert!((bank.models_at(at) - models).abs() < 1e-12, "{at:?}");
        }
    }

    #[test]
    fn one_model_serves_its_own_configuration_only() {
        let bank = bank(vec![model(CORNERS[1], 1)]).unwrap();
        assert!(bank.at(CORNERS[1]).is_ok());
        assert!(bank.at(CORNERS[2]).is_err());
    }

    #[test]
    fn two_models_interpolate_along_their_axis() {
        let bank = bank(vec![model(CORNERS[1], 1), model(CORNERS[2], 2)]).unwrap();
        assert!(bank.at(configuration(0.85, 0.0)).is_ok());
        assert!(bank.at(configuration(0.85, 0.1)).is_err());
    }

    #[test]
    fn what_is_no_grid_is_refused() {
        let corners = four_corners();
        let missing = bank(corners[..3].to_vec()).unwrap_err().to_string();
        assert!(
            missing.contains("no model at configuration (length 0.700 m, pressure 0.400 kPa)"),
            "{missing}"
        );
        let twice = bank(vec![corners[0].clone(), corners[0].clone()]).unwrap_err();
        assert!(matches!(twice, ModelError::DuplicateConfiguration { .. }));
        let three = bank(vec![
            model(configuration(0.8, 0.0), 1),
            corners[1].clone(),
            corners[2].clone(),
        ]);
        assert!(three.unwrap_err().to_string().contains("expected one or two"));
        assert!(bank(Vec::new()).is_err());
    }

    #[test]
    fn models_of_different_structure_are_not_mixed() {
        let linear = BankModel {
            model: Model::Lag(random_model(3, CommandInputs::Position, &[], 1)),
            ..model(CORNERS[2], 1)
        };
        let message = bank(vec![model(CORNERS[1], 1), linear]).unwrap_err().to_string();
        assert!(message.contains("quadratic rows [], not [8]"), "{message}");
    }

    #[test]
    fn a_schedule_follows_its_configurations() {
        let bank = bank(four_corners()).unwrap();
        let schedule = [CORNERS[1], CORNERS[1], configuration(0.85, 0.2), CORNERS[0]];
        let scheduled = bank.scheduled(&schedule).unwrap();
        for (knot, &configuration) in schedule.iter().enumerate() {
            assert_eq!(scheduled.at_knot(knot), &bank.at(configuration).unwrap());
        }
        assert_eq!(scheduled.at_knot(99), &bank.at(CORNERS[0]).unwrap());
        assert!(bank.scheduled(&[]).is_err());
    }
}
