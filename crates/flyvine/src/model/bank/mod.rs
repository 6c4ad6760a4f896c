//! The models of the configurations that were flown, and the bilinear interpolation between them
//! (Jitosho et al., Sec. III-B).

mod file;
mod grid;
mod provenance;
#[cfg(test)]
mod tests;

use super::band::PredictionBand;
use super::error::ModelError;
use super::family::Model;
use super::lag::CommandInputs;
use super::noise::NoiseLevels;
use super::physical::PhysicalModel;
use super::schedule::ScheduledModel;
use super::support::Support;
use crate::flight::Configuration;
use crate::link::Feedforward;
pub use file::BANK_SCHEMA_VERSION;
pub(crate) use file::write_json;
use grid::Grid;
pub(crate) use grid::same;
pub use grid::{LENGTH_TOLERANCE_M, PRESSURE_TOLERANCE_KPA};
pub use provenance::{BankProvenance, Between, InputFile, ModelDiagnostics};
use serde::{Deserialize, Serialize};

/// Whether a configuration outside the flown range may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Extrapolation {
    /// It is an error.
    #[default]
    Refuse,
    /// The bilinear form is continued linearly.
    Allow,
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

/// The models of the flown configurations: one, two along one axis, or four corners.
#[derive(Debug, Clone, PartialEq)]
pub struct Bank {
    grid: Grid,
    /// In the order of the grid's points.
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
        let configurations: Vec<_> = models.iter().map(|own| own.configuration).collect();
        let grid = Grid::new(&configurations)?;
        let mut ordered = Vec::with_capacity(models.len());
        for point in grid.points() {
            let mut here = models.iter().filter(|own| same(&own.configuration, &point));
            let model = here.next().ok_or(ModelError::MissingCorner { missing: point })?;
            if here.next().is_some() {
                return Err(ModelError::DuplicateConfiguration { configuration: point });
            }
            ordered.push(model.clone());
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
            grid,
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
        self.grid.length_range_m()
    }

    /// Smallest and largest pressure, kPa.
    pub fn pressure_range_kpa(&self) -> [f64; 2] {
        self.grid.pressure_range_kpa()
    }

    /// Whether `configuration` lies in the flown range (within the tolerances).
    pub fn covers(&self, configuration: Configuration) -> bool {
        self.grid.covers(configuration)
    }

    /// Of how many models the one at `configuration` is made, `1 / Σ w²` with the weights w of the interpolation: 1 at a
    /// model's own configuration and beyond the outermost ones, 2 midway between two, 4 midway between four.
    pub fn models_at(&self, configuration: Configuration) -> f64 {
        self.grid.points_mixed(configuration)
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
        let weights = self.grid.weights(configuration);
        let parts: Vec<_> = weights
            .into_iter()
            .zip(self.models.iter().map(|own| &own.model))
            .collect();
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
