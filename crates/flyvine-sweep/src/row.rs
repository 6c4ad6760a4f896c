//! One flight of a sweep, and what became of it.

use flyvine::control::{End, FlightOutcome};
use flyvine::flight::{HygieneOptions, clean};
use flyvine::report::Score;
use flyvine::run::score_flight;
use flyvine::task::Plan;
use serde::{Deserialize, Serialize};

use crate::Success;

/// How the flight of a row ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RowStatus {
    /// All knots were flown.
    Completed,
    /// Cut short by the supervisor or the vehicle.
    Aborted,
    /// Nothing was flown: the drawn vehicle is none, or the plan cannot be flown on it.
    Refused,
}

impl RowStatus {
    /// Its name, as in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Aborted => "aborted",
            Self::Refused => "refused",
        }
    }
}

/// What became of one flight: nothing in it depends on the clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RowResult {
    /// How it ended.
    pub status: RowStatus,
    /// Why it did not end well; empty if it did.
    pub cause: String,
    /// Vehicle time when it ended, s.
    pub flown_s: f64,
    /// Its score against the plan, as `flyvine score`; `None` where nothing could be scored.
    pub score: Option<Score>,
}

impl RowResult {
    /// Nothing was flown.
    pub(crate) fn refused(cause: String) -> Self {
        Self {
            status: RowStatus::Refused,
            cause,
            flown_s: 0.0,
            score: None,
        }
    }

    /// What became of a flight of `plan`.
    pub(crate) fn of(plan: &Plan, outcome: FlightOutcome) -> Self {
        let (status, cause, flown_s) = match &outcome.end {
            End::Completed => {
                let end_s = outcome.flight.samples.last().map_or(0.0, |sample| sample.t_s);
                (RowStatus::Completed, String::new(), end_s)
            }
            End::Aborted { t_s, cause } => (RowStatus::Aborted, cause.to_string(), *t_s),
        };
        let mut flight = outcome.flight;
        // Behind an abort the position is held for a while.
        flight.samples.truncate(plan.knots());
        clean(&mut flight, &HygieneOptions::default());
        Self {
            status,
            cause,
            flown_s,
            score: score_flight(plan, &flight).ok(),
        }
    }

    /// What its flight is judged by, m: a swing's miss of the target, otherwise the mean end-effector error against the
    /// reference; infinite for a flight that was not flown to the end.
    pub fn error_m(&self) -> f64 {
        match (&self.score, self.status) {
            (Some(score), RowStatus::Completed) => {
                score.target_miss_m.unwrap_or(score.ee_vs_reference.mean_m)
            }
            _ => f64::INFINITY,
        }
    }

    /// Whether it is a success.
    pub fn succeeded(&self, success: &Success) -> bool {
        let score = self.score.as_ref();
        let mean_m = score.map_or(f64::INFINITY, |score| score.ee_vs_reference.mean_m);
        let miss_m = score
            .and_then(|score| score.target_miss_m)
            .unwrap_or(f64::INFINITY);
        let within = |value: f64, greatest: Option<f64>| greatest.is_none_or(|greatest| value <= greatest);
        self.status == RowStatus::Completed
            && within(mean_m, success.mean_error_m)
            && within(miss_m, success.target_miss_m)
    }
}
