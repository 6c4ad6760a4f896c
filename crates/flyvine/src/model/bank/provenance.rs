//! Where a bank's models came from, and how well their fits were determined.

use super::super::options::FitOptions;
use super::super::selection::Candidate;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;

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
