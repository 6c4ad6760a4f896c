//! A partial fit as a JSON file, read back strictly.

use super::super::bank::write_json;
use super::super::error::ModelError;
use super::{PARTIAL_FIT_SCHEMA_VERSION, PartialFit, SCHEMA};
use std::path::Path;

impl PartialFit {
    /// Reads a partial fit.
    ///
    /// # Errors
    /// The file cannot be read, was cut off, is not a partial fit, has another schema version, or holds sums that
    /// its options do not make.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let format = |message: String| ModelError::Format {
            path: path.to_path_buf(),
            message,
        };
        let contents = std::fs::read(path).map_err(ModelError::file(path))?;
        let part: Self = serde_json::from_slice(&contents)
            .map_err(|error| format(format!("expected a partial fit, whole: {error}")))?;
        if (part.schema.as_str(), part.schema_version) != (SCHEMA, PARTIAL_FIT_SCHEMA_VERSION) {
            return Err(format(format!(
                "found {} version {}, expected {SCHEMA} version {PARTIAL_FIT_SCHEMA_VERSION}",
                part.schema, part.schema_version
            )));
        }
        part.options
            .validate()
            .map_err(|error| format(error.to_string()))?;
        let range = part.start <= part.end && part.end <= part.flights;
        let sums = part.cells.iter().all(|cell| {
            cell.sums.is_within(part.start..part.end)
                && cell
                    .sums
                    .parts()
                    .all(|sums| sums.fits(part.shape(), part.reduction))
        });
        if !range || !sums {
            return Err(format("holds other sums than its options make".into()));
        }
        Ok(part)
    }

    /// Writes the partial fit, whole or not at all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ModelError> {
        write_json(path, self)
    }
}
