//! Why a model cannot be built, read or evaluated.

use super::noise::NoiseLevelError;
use crate::flight::Configuration;
use std::io;
use std::path::{Path, PathBuf};

/// Why a model or bank cannot be built, read or evaluated.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The physical family cannot use its input.
    #[error(transparent)]
    Physical(#[from] super::physical::PhysicalError),
    /// A noise level that is out of its range.
    #[error(transparent)]
    Noise(#[from] NoiseLevelError),
    /// A limit of the supported region that is negative, or not a number.
    #[error("supported region, {name}: found {found}, expected a number of at least 0")]
    Support {
        /// Which.
        name: &'static str,
        /// Its value.
        found: f64,
    },
    /// An array has the wrong length.
    #[error("{what}: found {found} values, expected {expected}")]
    Shape {
        /// Which array.
        what: String,
        /// Length found.
        found: usize,
        /// Length expected.
        expected: usize,
    },
    /// A coefficient or setting is NaN or infinite.
    #[error("{what}: value {index} is not a finite number")]
    NotFinite {
        /// Which array.
        what: String,
        /// Position in it, from 0.
        index: usize,
    },
    /// A setting is outside what is supported.
    #[error("{what}: found {found}, expected {expected}")]
    Unsupported {
        /// Which setting.
        what: &'static str,
        /// Value found.
        found: String,
        /// Values accepted.
        expected: String,
    },
    /// A configuration lies outside the ones that were flown.
    #[error(
        "configuration {}: outside the bank, which covers length {:.3} to {:.3} m and pressure {:.3} to {:.3} kPa \
         (extrapolation must be asked for)",
        display(configuration), length_m[0], length_m[1], pressure_kpa[0], pressure_kpa[1]
    )]
    OutsideBank {
        /// Configuration asked for.
        configuration: Configuration,
        /// Smallest and largest length in the bank, m.
        length_m: [f64; 2],
        /// Smallest and largest pressure in the bank, kPa.
        pressure_kpa: [f64; 2],
    },
    /// The models do not sit on the corners of a grid.
    #[error(
        "no model at configuration {}: a bank needs one model, two along one axis, or all four corners \
         of its (pressure, length) range",
        display(missing)
    )]
    MissingCorner {
        /// The corner that has no model.
        missing: Configuration,
    },
    /// Two models claim the same configuration.
    #[error("two models at the same configuration {}", display(configuration))]
    DuplicateConfiguration {
        /// The configuration.
        configuration: Configuration,
    },
    /// The models of a bank differ in lags, inputs or quadratic rows, so their coefficients cannot be mixed.
    #[error("model {index} of the bank has another structure than model 0: {what}")]
    MixedStructure {
        /// Position of the model that differs.
        index: usize,
        /// What differs.
        what: String,
    },
    /// No flight with a constant configuration was given.
    #[error(
        "no flight with a constant configuration among {flights} flights: nothing to fit a corner model on"
    )]
    NoCornerFlights {
        /// Number of flights given.
        flights: usize,
    },
    /// Fewer usable rows than coefficients.
    #[error(
        "configuration {}: {rows} usable rows in {flights} flights for {coefficients} coefficients of the \
         height row; fly more, or fit the linear structure",
        display(configuration)
    )]
    TooFewRows {
        /// Configuration of the model.
        configuration: Configuration,
        /// Flights at that configuration.
        flights: usize,
        /// Rows whose lags and successor are all valid.
        rows: usize,
        /// Coefficients to determine.
        coefficients: usize,
    },
    /// A regression has no degree of freedom left.
    #[error("{observations} observations for {coefficients} coefficients, expected more observations")]
    TooFewObservations {
        /// Observations given.
        observations: usize,
        /// Coefficients to determine.
        coefficients: usize,
    },
    /// A regressor is a combination of others.
    #[error("regressor {name} depends on those before it: its coefficient is not determined")]
    DependentRegressor {
        /// Name of the regressor.
        name: String,
    },
    /// Two flights are the same recording.
    #[error("flights {first} and {second} hold the same samples: one recording was given twice")]
    DuplicateFlight {
        /// Name of the first.
        first: String,
        /// Name of the second.
        second: String,
    },
    /// The commanded velocity was asked for as an input, but a flight has none.
    #[error("flight {flight}: no commanded velocity in row {row}, but the model takes it as an input")]
    NoCommandVelocity {
        /// Name of the flight.
        flight: String,
        /// First row without it.
        row: usize,
    },
    /// A value of a flight is NaN or infinite.
    #[error("flight {flight}: {field} in row {row} is not a finite number")]
    FlightValue {
        /// Name of the flight.
        flight: String,
        /// Row, from 0.
        row: usize,
        /// Column, as the CSV format names it.
        field: &'static str,
    },
    /// Sums over rows do not determine a fit to the digits that are wanted.
    #[error(
        "configuration {}: the columns are too nearly dependent for sums of their products (the residual may exceed \
         the least one by {excess:.0e} of itself); an orthogonal reduction has the digits",
        display(configuration)
    )]
    IllConditioned {
        /// Configuration of the model.
        configuration: Configuration,
        /// Share by which the residual may exceed the least one; infinite if the sums determine nothing.
        excess: f64,
    },
    /// Parts of a fit do not belong together.
    #[error("parts of a fit: {what}")]
    Parts {
        /// What does not fit.
        what: String,
    },
    /// A flight has no rows.
    #[error("flight {flight}: no rows")]
    EmptyFlight {
        /// Name of the flight.
        flight: String,
    },
    /// Something is wrong with one flight.
    #[error("flight {flight}: {source}")]
    Flight {
        /// Name of the flight.
        flight: String,
        /// What is wrong.
        source: Box<ModelError>,
    },
    /// A matrix factorization did not converge.
    #[error("{what} of configuration {} did not converge", display(configuration))]
    Factorization {
        /// Which factorization.
        what: &'static str,
        /// Configuration of the model.
        configuration: Configuration,
    },
    /// The file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is not a bank.
    #[error("{}: {message}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What was found and expected, with line and column where known.
        message: String,
    },
}

/// A configuration in words.
pub(crate) fn display(configuration: &Configuration) -> String {
    format!(
        "(length {:.3} m, pressure {:.3} kPa)",
        configuration.length_m, configuration.pressure_kpa
    )
}

impl ModelError {
    /// What a failure to read or write the file at `path` is.
    pub(crate) fn file(path: &Path) -> impl Fn(io::Error) -> Self {
        move |source| Self::File {
            path: path.to_path_buf(),
            source,
        }
    }
}

/// Refuses NaN and infinities in `values`.
pub(crate) fn require_finite(what: &str, values: &[f64]) -> Result<(), ModelError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(ModelError::NotFinite {
            what: what.to_owned(),
            index,
        }),
    }
}

/// Refuses `values` of another length than `expected`.
pub(crate) fn require_len(what: &str, values: &[f64], expected: usize) -> Result<(), ModelError> {
    if values.len() == expected {
        return Ok(());
    }
    Err(ModelError::Shape {
        what: what.to_owned(),
        found: values.len(),
        expected,
    })
}
