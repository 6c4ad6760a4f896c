//! A flight against its plan.

use crate::flight::Flight;
use crate::report::{Score, ScoreError, SwingTarget, score};
use crate::task::{Motion, Plan};

/// Scores a flight of a plan.
///
/// # Errors
/// It is not a flight of this plan.
pub fn score_flight(plan: &Plan, flight: &Flight) -> Result<Score, ScoreError> {
    score(
        flight,
        &plan.reference,
        &plan.predicted_end_effector(),
        swing_target(plan),
    )
}

/// Where a swing's end effector must be, and when.
pub fn swing_target(plan: &Plan) -> Option<SwingTarget> {
    match plan.task.motion() {
        Motion::Swing(swing) => Some(SwingTarget {
            knot: swing.target_knot(),
            position: swing.target_m,
        }),
        _ => None,
    }
}
