//! A vehicle's TOML: the simulated vehicle's parameters, and a table `[supervisor]` with the limits within which it is
//! flown.

use std::path::{Path, PathBuf};

use crate::control::supervisor::Limits;
use crate::sim::{ParameterError, VehicleParameters};

/// Why a vehicle's file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum VehicleFileError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error("{file}: {message}")]
    Syntax {
        /// The file.
        file: String,
        /// The parser's message with line and key.
        message: String,
    },
    /// A parameter outside its range.
    #[error("{file}: {source}")]
    Parameter {
        /// The file.
        file: String,
        /// Which, and its range.
        source: ParameterError,
    },
}

/// Reads a vehicle's file.
///
/// # Errors
/// A file that cannot be read, or as [`parse_vehicle_file`].
pub fn read_vehicle_file(path: &Path) -> Result<(VehicleParameters, Limits), VehicleFileError> {
    let text = std::fs::read_to_string(path).map_err(|source| VehicleFileError::File {
        path: path.to_owned(),
        source,
    })?;
    parse_vehicle_file(&text, &path.display().to_string())
}

/// Reads the text of a vehicle's file; `file` names it in errors.
///
/// # Errors
/// Wrong TOML, unknown keys, values outside their ranges.
pub fn parse_vehicle_file(text: &str, file: &str) -> Result<(VehicleParameters, Limits), VehicleFileError> {
    let syntax = |message: String| VehicleFileError::Syntax {
        file: file.to_owned(),
        message,
    };
    let mut table: toml::Table = text
        .parse()
        .map_err(|error: toml::de::Error| syntax(error.to_string()))?;
    let limits = match table.remove("supervisor") {
        Some(limits) => limits
            .try_into()
            .map_err(|error: toml::de::Error| syntax(format!("supervisor: {error}")))?,
        None => Limits::default(),
    };
    let rest = toml::to_string(&table).map_err(|error| syntax(error.to_string()))?;
    let parameters = VehicleParameters::from_toml(&rest).map_err(|source| VehicleFileError::Parameter {
        file: file.to_owned(),
        source,
    })?;
    Ok((parameters, limits))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_and_limits_share_a_file() {
        let text = "[wind]\nmean_m_s = [1.0, 0.0, 0.0]\n[supervisor.room]\nx_m = [-1.0, 1.0]\n";
        let (parameters, limits) = parse_vehicle_file(text, "v.toml").unwrap();
        assert_eq!(parameters.wind.mean_m_s, [1.0, 0.0, 0.0]);
        assert_eq!(limits.room.x_m, [-1.0, 1.0]);
    }

    #[test]
    fn errors_name_file_and_key() {
        let message = |text| parse_vehicle_file(text, "v.toml").unwrap_err().to_string();
        let unknown = message("[wind]\nmean = 1.0\n");
        assert!(
            unknown.contains("v.toml") && unknown.contains("mean"),
            "{unknown}"
        );
        let limits = message("[supervisor]\nroof_m = 1.0\n");
        assert!(
            limits.contains("supervisor") && limits.contains("roof_m"),
            "{limits}"
        );
        let range = message("[wind]\ngust_m_s = -1.0\n");
        assert!(range.contains("wind.gust_m_s = -1"), "{range}");
    }
}
