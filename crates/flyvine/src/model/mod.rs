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
//! - [`check`]: one-step and rollout errors of a bank on flights → [`CheckReport`].

mod bank;
mod bank_file;
mod check;
mod corner;
mod error;
mod features;
mod fit;
mod lag;
mod least_squares;
mod options;
pub mod physical;
mod rollout;
mod selection;
mod stability;
#[cfg(test)]
mod test_data;
mod track;

pub use bank::{
    Bank, BankModel, BankProvenance, Extrapolation, InputFile, LENGTH_TOLERANCE_M, Model, ModelDiagnostics,
    PRESSURE_TOLERANCE_KPA, ScheduledModel, rest_state,
};
pub use bank_file::BANK_SCHEMA_VERSION;
pub use check::{CheckReport, FlightCheck, ModelCheck, check};
pub use error::ModelError;
pub use fit::{Finding, FitReport, fit_bank};
pub use lag::{CommandInputs, HEIGHT_ROW, LagModel, MAX_LAGS, QuadraticTerms, STATE_LEN};
pub use options::{FitOptions, Ridge, Structure, VelocityInput};
pub use rollout::RolloutError;
pub use selection::{Candidate, HeldOutError};
pub use stability::spectral_radius;

/// Names of the nine entries of x, in order.
pub const SIGNALS: [&str; STATE_LEN] = [
    "qr_x", "qr_y", "qr_z", "qr_qx", "qr_qy", "qr_qz", "ee_x", "ee_y", "ee_z",
];
