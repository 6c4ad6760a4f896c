//! Numbers that cannot be: why a vehicle's parameters are refused.

/// Why vehicle parameters cannot be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ParameterError {
    /// Not a number, or infinite.
    #[error("{name} = {found}: must be a finite number")]
    NotFinite {
        /// Path of the parameter, as in the TOML file.
        name: String,
        /// What was found.
        found: f64,
    },
    /// Outside its range.
    #[error("{name} = {found}: must lie between {low} and {high} {unit}")]
    OutOfRange {
        /// Path of the parameter, as in the TOML file.
        name: String,
        /// What was found.
        found: f64,
        /// Smallest allowed value.
        low: f64,
        /// Greatest allowed value.
        high: f64,
        /// Unit of the three.
        unit: &'static str,
    },
    /// Parameters that contradict each other.
    #[error("{what}")]
    Contradiction {
        /// The contradiction, with the values.
        what: String,
    },
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error("vehicle TOML: {message}")]
    Syntax {
        /// The parser's message with line and key.
        message: String,
    },
}

/// Checks one number after another; the first fault wins.
pub(in crate::sim) struct Checker {
    prefix: &'static str,
}

impl Checker {
    pub(in crate::sim) fn new(prefix: &'static str) -> Checker {
        Checker { prefix }
    }

    pub(in crate::sim) fn range(
        &self,
        name: &str,
        found: f64,
        low: f64,
        high: f64,
        unit: &'static str,
    ) -> Result<(), ParameterError> {
        let name = format!("{}.{name}", self.prefix);
        if !found.is_finite() {
            return Err(ParameterError::NotFinite { name, found });
        }
        if !(low..=high).contains(&found) {
            return Err(ParameterError::OutOfRange {
                name,
                found,
                low,
                high,
                unit,
            });
        }
        Ok(())
    }
}
