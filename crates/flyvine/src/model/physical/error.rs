//! What can be wrong with the physical model's input.

use crate::flight::Configuration;

/// Input that the physical model cannot use.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhysicalError {
    /// A flight holds NaN or an infinity.
    #[error("flight {flight}: row {row} holds a number that is not finite")]
    NotFinite {
        /// Name of the flight.
        flight: String,
        /// Row, from 0.
        row: usize,
    },
    /// A flight has no evenly timed stretch of rows that begins with both poses and is long enough.
    #[error(
        "flight {flight}: {rows} rows without an evenly timed stretch of {needed} rows that begins with both poses"
    )]
    TooShort {
        /// Name of the flight.
        flight: String,
        /// Rows that it has.
        rows: usize,
        /// Rows needed.
        needed: usize,
    },
    /// A row without both poses, where they are needed.
    #[error("flight {flight}: row {row} lacks a pose that is needed there")]
    NoPose {
        /// Name of the flight.
        flight: String,
        /// Row, from 0.
        row: usize,
    },
    /// A flight's weight is not one.
    #[error("flight {flight}: weight {found}, expected a finite number ≥ 0")]
    Weight {
        /// Name of the flight.
        flight: String,
        /// Weight found.
        found: f64,
    },
    /// Nothing to fit.
    #[error("no flight to fit the physical model to")]
    NoFlights,
    /// The flights of one fit were flown at different configurations.
    #[error(
        "flight {flight}: configuration ({} m, {} kPa), expected ({} m, {} kPa) as in the other flights of this fit",
        found.length_m, found.pressure_kpa, expected.length_m, expected.pressure_kpa
    )]
    MixedConfigurations {
        /// Name of the flight.
        flight: String,
        /// Its configuration at the first row that differs.
        found: Configuration,
        /// Configuration of the first flight.
        expected: Configuration,
    },
    /// A parameter is outside its bounds, or not a number.
    #[error("parameter {name}: found {found}, expected {lower} to {upper} {unit}")]
    OutOfBounds {
        /// Name of the parameter.
        name: &'static str,
        /// Value found.
        found: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
        /// Unit.
        unit: &'static str,
    },
    /// The arm's length leaves no room below its base, or is not a number.
    #[error(
        "arm of {length_m} m, growing by {rate_m_s} m/s: expected a finite length of at least {shortest_m} m"
    )]
    ArmTooShort {
        /// Length found.
        length_m: f64,
        /// Growth found.
        rate_m_s: f64,
        /// Shortest length that can be used.
        shortest_m: f64,
    },
    /// Arrays that belong together have different lengths, or are empty.
    #[error("{what}: found {found}, expected {expected}")]
    Shape {
        /// Which array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length it should have.
        expected: usize,
    },
    /// A coefficient of the correction is not a number.
    #[error("the correction: found {found}, expected finite coefficients")]
    CorrectionNotFinite {
        /// Value found.
        found: f64,
    },
    /// A model without a usable covariance, where one is needed.
    #[error("the model has no positive definite covariance of its parameters, as a fitted one has")]
    NoCovariance,
    /// A hovering vehicle does not fit the room.
    #[error("a hover with an arm of {length_m} m is not inside the room")]
    NoRoom {
        /// Length of the arm.
        length_m: f64,
    },
    /// No start of the fit gave a simulation that stayed finite.
    #[error("the physical model's simulation diverged from every start of the fit")]
    Diverged,
}
