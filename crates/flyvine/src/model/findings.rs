//! What the user should know about a fit of the lag family.

use super::bank::{Bank, BankModel};
use super::error::display;
use super::selection::{Candidate, HeldOutError};
use crate::flight::Configuration;
use serde::Serialize;

/// A spectral radius at rest above this is unstable: a predicted height that keeps its value has exactly 1, and
/// noise moves it a little either way.
pub(crate) const UNSTABLE: f64 = 1.005;
/// Share of diverged windows that is not yet a pattern.
pub(crate) const STRAY_SHARE: f64 = 0.02;

/// Something about a fit that the user should know.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "finding")]
pub enum Finding {
    /// Plain least squares in the paper's form does not predict these flights.
    PlainLeastSquaresUnusable {
        /// Its held-out rollout error.
        error: HeldOutError,
        /// The error of predicting that nothing moves.
        standing_still: HeldOutError,
    },
    /// Even the chosen model predicts held-out flights worse than that nothing moves, or diverges on them.
    NotToBeTrusted {
        /// Its held-out rollout error.
        error: HeldOutError,
    },
    /// Linearized at rest the chosen model is unstable.
    Unstable {
        /// Where.
        configuration: Configuration,
        /// Spectral radius of the Jacobian at rest.
        spectral_radius: f64,
    },
    /// No stretch of valid rows is long enough for a held-out 2.5-s rollout: nothing was chosen by rollout error.
    TooShortToCrossCheck,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::PlainLeastSquaresUnusable {
                error,
                standing_still,
            } => write!(
                f,
                "plain least squares in the paper's form does not predict held-out flights: {error}; \
                 predicting that nothing moves: {standing_still}"
            ),
            Self::NotToBeTrusted { error } => {
                write!(
                    f,
                    "the chosen model does not predict held-out flights either: {error}"
                )
            }
            Self::Unstable {
                configuration,
                spectral_radius,
            } => write!(
                f,
                "the model at {} is unstable at rest: spectral radius {spectral_radius:.4}",
                display(configuration)
            ),
            Self::TooShortToCrossCheck => write!(
                f,
                "no flight has 2.5 s of unbroken rows to roll out on: structure and ridge could not be judged"
            ),
        }
    }
}

/// What the scan and the chosen bank give cause to say.
pub(crate) fn findings(
    bank: &Bank,
    plain: &Candidate,
    chosen: &Candidate,
    standing_still: Option<HeldOutError>,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    match (&plain.corners, &chosen.corners, standing_still) {
        (Some(plain), Some(chosen), Some(standing_still)) => {
            if unusable(plain, &standing_still) {
                findings.push(Finding::PlainLeastSquaresUnusable {
                    error: *plain,
                    standing_still,
                });
            }
            if unusable(chosen, &standing_still) {
                findings.push(Finding::NotToBeTrusted { error: *chosen });
            }
        }
        _ => findings.push(Finding::TooShortToCrossCheck),
    }
    for BankModel {
        configuration,
        diagnostics,
        ..
    } in bank.models()
    {
        let spectral_radius = diagnostics.spectral_radius;
        if spectral_radius > UNSTABLE {
            findings.push(Finding::Unstable {
                configuration: *configuration,
                spectral_radius,
            });
        }
    }
    findings
}

/// Worse than predicting that nothing moves, or diverging on more than a stray window.
fn unusable(error: &HeldOutError, standing_still: &HeldOutError) -> bool {
    error.mean_m > standing_still.mean_m || error.diverged_share > STRAY_SHARE
}
