//! Ranges that tell metres from millimetres: values outside are refused with a guess at the mistake.

use super::error::Problem;

/// A coordinate in a motion-capture room, m.
pub(super) fn position(value: f64) -> Result<(), Problem> {
    within(
        value,
        -100.0,
        100.0,
        "m",
        "−100 … 100",
        "is this in millimetres or centimetres?",
    )
}

/// A commanded velocity, m/s.
pub(super) fn velocity(value: f64) -> Result<(), Problem> {
    within(
        value,
        -100.0,
        100.0,
        "m/s",
        "−100 … 100",
        "is this in mm/s or cm/s?",
    )
}

/// The arm's length, m.
pub(super) fn length(value: f64) -> Result<(), Problem> {
    if value.is_finite() && value <= 0.0 {
        return Err(Problem::NotPositive { found: value });
    }
    within(
        value,
        0.0,
        10.0,
        "m",
        "0 … 10",
        "is this in millimetres or centimetres?",
    )
}

/// The arm's gauge pressure, kPa.
pub(super) fn pressure(value: f64) -> Result<(), Problem> {
    const QUESTION: &str = "is this in pascals, or absolute instead of gauge?";
    within(value, -101.325, 100.0, "kPa", "−101.3 … 100", QUESTION)
}

fn within(
    found: f64,
    low: f64,
    high: f64,
    unit: &'static str,
    expected: &'static str,
    question: &'static str,
) -> Result<(), Problem> {
    if !found.is_finite() {
        Err(Problem::NotFinite { found })
    } else if (low..=high).contains(&found) {
        Ok(())
    } else {
        Err(Problem::WrongUnit {
            found,
            unit,
            expected,
            question,
        })
    }
}
