//! The models of the configurations that were flown, and the bilinear interpolation between them
//! (Jitosho et al., Sec. III-B).

use super::error::ModelError;
use super::lag::{LagModel, STATE_LEN};
use super::options::FitOptions;
use super::selection::Candidate;
use super::stability::spectral_radius;
use crate::flight::Configuration;
use crate::trajopt::Dynamics;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Lengths closer than this are the same, m.
pub const LENGTH_TOLERANCE_M: f64 = 1e-3;
/// Pressures closer than this are the same, kPa.
pub const PRESSURE_TOLERANCE_KPA: f64 = 5e-3;

/// Height at which every flight starts and its state rests, m.
const HOVER_HEIGHT_M: f64 = 1.5;

/// Whether a configuration outside the flown range may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Extrapolation {
    /// It is an error.
    #[default]
    Refuse,
    /// The bilinear form is continued linearly.
    Allow,
}

/// One predictor, of whichever family.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "family", rename_all = "snake_case")]
pub enum Model {
    /// Polynomial in lagged states and commands.
    Lag(LagModel),
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
    /// Condition number of that row's equilibrated regressors (1 is best).
    pub condition_number: f64,
    /// The same for the linear rows.
    pub linear_condition_number: f64,
    /// Spectral radius of the Jacobian at rest.
    pub spectral_radius: f64,
    /// Root-mean-square residual of the fit per signal, m (positions) or 1 (attitude).
    pub residual_rms: BTreeMap<String, f64>,
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
        for (index, other) in ordered.iter().enumerate().skip(1) {
            let (Model::Lag(first), Model::Lag(model)) = (&ordered[0].model, &other.model);
            if let Some(what) = first.structure_difference(model) {
                return Err(ModelError::MixedStructure { index, what });
            }
        }
        Ok(Self {
            lengths_m,
            pressures_kpa,
            models: ordered,
            extrapolation: Extrapolation::Refuse,
            provenance,
        })
    }

    /// The same bank with another policy for configurations outside its range; a file does not keep it.
    pub fn with_extrapolation(mut self, extrapolation: Extrapolation) -> Self {
        self.extrapolation = extrapolation;
        self
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
                let Model::Lag(model) = &self.models[i * along_length.len() + j].model;
                parts.push((by_pressure * by_length, model));
            }
        }
        // At a corner the corner's own coefficients, to the last bit.
        parts.retain(|(weight, _)| *weight != 0.0);
        Ok(Model::Lag(LagModel::combination(&parts)))
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
        let mut models: Vec<Model> = Vec::new();
        let mut model_of_knot = Vec::with_capacity(configurations.len());
        for (knot, &configuration) in configurations.iter().enumerate() {
            if knot == 0 || configuration != configurations[knot - 1] {
                models.push(self.at(configuration)?);
            }
            model_of_knot.push(models.len() - 1);
        }
        Ok(ScheduledModel {
            models,
            model_of_knot,
        })
    }
}

/// A bank along a schedule of configurations: time-varying dynamics with precomputed coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduledModel {
    /// One model per change of configuration.
    models: Vec<Model>,
    /// Index into `models` per knot.
    model_of_knot: Vec<usize>,
}

impl ScheduledModel {
    /// The model at `knot`.
    pub fn at_knot(&self, knot: usize) -> &Model {
        let last = self.model_of_knot.len() - 1;
        &self.models[self.model_of_knot[knot.min(last)]]
    }
}

impl Model {
    /// Number of past states that its state z holds.
    pub fn lags(&self) -> usize {
        let Self::Lag(model) = self;
        model.lags()
    }

    /// The state z at rest: copies of hovering at (0, 0, 1.5) with the arm hanging straight.
    pub fn rest_state(&self, configuration: Configuration) -> Vec<f64> {
        rest_state(configuration, self.lags())
    }

    /// Spectral radius of the transition matrix linearized at rest; above 1 predictions run away.
    ///
    /// # Errors
    /// The eigenvalue iteration did not converge.
    pub fn spectral_radius(&self, configuration: Configuration) -> Result<f64, ModelError> {
        let mut command = vec![0.0; self.command_len()];
        command[2] = HOVER_HEIGHT_M;
        spectral_radius(self, &self.rest_state(configuration), &command).ok_or(ModelError::Factorization {
            what: "eigenvalues at rest",
            configuration,
        })
    }
}

/// `lags` copies of x at rest: hovering at (0, 0, 1.5), level, the arm hanging straight down.
pub fn rest_state(configuration: Configuration, lags: usize) -> Vec<f64> {
    let tip = HOVER_HEIGHT_M - configuration.length_m;
    let rest: [f64; STATE_LEN] = [0.0, 0.0, HOVER_HEIGHT_M, 0.0, 0.0, 0.0, 0.0, 0.0, tip];
    rest.repeat(lags)
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

impl Dynamics for Model {
    fn state_len(&self) -> usize {
        let Self::Lag(model) = self;
        model.state_len()
    }

    fn command_len(&self) -> usize {
        let Self::Lag(model) = self;
        model.command_len()
    }

    fn fresh_len(&self) -> usize {
        let Self::Lag(model) = self;
        model.fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        let Self::Lag(model) = self;
        model.step(knot, state, command, fresh);
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        let Self::Lag(model) = self;
        model.jacobian(knot, state, command, jacobian);
    }

    fn add_curvature(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        adjoint: &[f64],
        scale: f64,
        hessian: &mut [f64],
    ) {
        let Self::Lag(model) = self;
        model.add_curvature(knot, z, u, adjoint, scale, hessian);
    }
}

impl Dynamics for ScheduledModel {
    fn state_len(&self) -> usize {
        self.models[0].state_len()
    }

    fn command_len(&self) -> usize {
        self.models[0].command_len()
    }

    fn fresh_len(&self) -> usize {
        self.models[0].fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        self.at_knot(knot).step(knot, state, command, fresh);
    }

    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        self.at_knot(knot).jacobian(knot, state, command, jacobian);
    }

    fn add_curvature(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        adjoint: &[f64],
        scale: f64,
        hessian: &mut [f64],
    ) {
        self.at_knot(knot)
            .add_curvature(knot, z, u, adjoint, scale, hessian);
    }
}
