//! Identified models: from flights to predictors, and the bank that interpolates between them.
//!
//! ```text
//! x_{k+1} = f(z_k, u_k),   z_k = (x_k, x_{k−1}, x_{k−2})
//! ```
//!
//! - [`fit_bank`]: flights → [`Bank`] and [`FitReport`]; [`FitOptions`] say what may be chosen.
//! - [`Bank`]: [`Bank::read`], [`Bank::write`], [`Bank::at`] (a [`Model`] at one configuration),
//!   [`Bank::scheduled`] (a [`ScheduledModel`] along a schedule of configurations). It is serializable, so a
//!   plan can carry it.
//! - [`LagModel`], [`Model`] and [`ScheduledModel`] are [`crate::trajopt::Dynamics`]; [`rest_state`] is where
//!   plans start; [`Model::spectral_radius`] says whether predictions run away.
//! - [`streaming`]: the same least squares on more flights than memory holds, in parts that join bit for bit.
//! - [`statistics`]: what the regression of each row says about itself.
//! - [`LagModel::read_matrix`]: linear models published as a matrix.
//! - [`fit_physical_bank`]: the same with the physical family ([`physical`]). [`fit_families`]: whichever family
//!   predicts held-out flights better, with a band of confidence about its predictions.
//! - [`bootstrap`]: an ensemble of models that the flights allow. [`Learner`]: a model refitted to flights of a task.
//! - [`bank_between`]: banks that were fitted along a third variable (a payload) → the bank at a value in between.
//! - [`check`]: one-step and rollout errors of a bank on flights → [`CheckReport`].

mod band;
mod bank;
mod check;
mod commanded_velocity;
mod corner;
mod corrections;
mod ensemble;
mod error;
mod families;
mod family;
mod features;
mod findings;
mod fit;
mod groups;
mod lag;
mod learning;
mod least_squares;
mod matrix_file;
mod mix;
mod noise;
mod one_step;
mod options;
pub mod physical;
mod physical_bank;
mod prediction;
mod refine;
mod rollout;
mod schedule;
mod selection;
mod shape;
mod stability;
pub mod statistics;
pub mod streaming;
mod support;
mod track;

pub use band::{BAND_CONFIDENCE, PredictionBand};
pub(crate) use bank::same;
pub use bank::{
    BANK_SCHEMA_VERSION, Bank, BankModel, BankProvenance, Between, Extrapolation, InputFile,
    LENGTH_TOLERANCE_M, ModelDiagnostics, PRESSURE_TOLERANCE_KPA,
};
pub use check::{CheckReport, FlightCheck, ModelCheck, PooledError, WindowKind, check};
pub use corrections::{CorrectionTrial, HeldOutErrors};
pub use ensemble::bootstrap;
pub use error::ModelError;
pub use families::{
    Chosen, FamiliesReport, Family, FamilyOptions, FamilyProgress, FamilyTrial, fit_families,
};
pub use family::{Model, rest_state};
pub use findings::Finding;
pub use fit::{FitReport, fit_bank};
pub use lag::{CommandInputs, HEIGHT_ROW, LagModel, MAX_LAGS, QuadraticTerms, STATE_LEN};
pub use learning::{Learner, Lesson, WeightTrial};
pub use mix::bank_between;
pub use noise::{BodyNoise, NoiseLevelError, NoiseLevels, SurroundingsNoise};
pub use options::{FitOptions, Positions, Refinement, Ridge, Structure, VelocityInput};
pub use physical_bank::{CornerFit, PhysicalFitReport, fit_physical_bank, refit_physical_bank};
pub use rollout::RolloutError;
pub use schedule::ScheduledModel;
pub use selection::{Candidate, HeldOutError, RefinementTrial};
pub use stability::spectral_radius;
pub use support::Support;
