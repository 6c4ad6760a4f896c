//! The bank as a JSON file: schema version, units, provenance, models; read back strictly.

use super::bank::{Bank, BankModel, BankProvenance, InputFile};
use super::error::ModelError;
use crate::file::{sha256_hex, write_whole};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::path::Path;

/// What the file says it is.
const SCHEMA: &str = "flyvine-bank";
/// Version of the bank format that this library writes and reads.
pub const BANK_SCHEMA_VERSION: u64 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BankFile {
    schema: String,
    schema_version: u64,
    units: Units,
    provenance: BankProvenance,
    models: Vec<BankModel>,
}

/// Units of every number in the file, and the order of the state.
#[derive(Serialize, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
struct Units {
    length: String,
    pressure: String,
    sample_time_s: f64,
    state: Vec<String>,
}

fn units() -> Units {
    Units {
        length: "m".into(),
        pressure: "kPa".into(),
        sample_time_s: crate::DT,
        state: super::SIGNALS.map(String::from).to_vec(),
    }
}

impl Serialize for Bank {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let file = BankFile {
            schema: SCHEMA.into(),
            schema_version: BANK_SCHEMA_VERSION,
            units: units(),
            provenance: self.provenance().clone(),
            models: self.models().to_vec(),
        };
        file.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Bank {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        use serde::de::Error;
        // The version decides how the rest is read, so it is looked at before any other field is required.
        let value = serde_json::Value::deserialize(deserializer)?;
        let schema = value.get("schema").and_then(serde_json::Value::as_str);
        if schema != Some(SCHEMA) {
            let found = schema.map_or("no schema".into(), |found| format!("schema {found:?}"));
            return Err(D::Error::custom(format!(
                "found {found}, expected a bank (schema {SCHEMA:?})"
            )));
        }
        match value.get("schema_version").and_then(serde_json::Value::as_u64) {
            Some(BANK_SCHEMA_VERSION) => {}
            found => {
                let found = found.map_or("none".into(), |version| version.to_string());
                return Err(D::Error::custom(format!(
                    "bank schema_version: found {found}, expected {BANK_SCHEMA_VERSION}; fit the flights again \
                     with this version, or read the bank with the version that wrote it"
                )));
            }
        }
        let file: BankFile = serde_json::from_value(value).map_err(D::Error::custom)?;
        if file.units != units() {
            return Err(D::Error::custom(format!(
                "bank units: expected metres, kPa, {} s and the state {}",
                crate::DT,
                super::SIGNALS.join(", ")
            )));
        }
        Self::new(file.models, file.provenance).map_err(D::Error::custom)
    }
}

impl Bank {
    /// Reads a bank file.
    ///
    /// # Errors
    /// The file cannot be read, is not JSON, is not a bank, has another schema version, an unknown or missing
    /// field, a value that is not a finite number, or an array of the wrong length; the message says which.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let contents = std::fs::read(path).map_err(|source| ModelError::File {
            path: path.to_path_buf(),
            source,
        })?;
        serde_json::from_slice(&contents).map_err(|error| ModelError::Format {
            path: path.to_path_buf(),
            message: error.to_string(),
        })
    }

    /// Writes the bank, whole or not at all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), ModelError> {
        let file_error = |source| ModelError::File {
            path: path.to_path_buf(),
            source,
        };
        let contents = serde_json::to_vec(self).map_err(|error| file_error(error.into()))?;
        write_whole(path, &contents).map_err(file_error)
    }
}

impl InputFile {
    /// Hashes the file at `path`.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of(path: &Path) -> Result<Self, ModelError> {
        let contents = std::fs::read(path).map_err(|source| ModelError::File {
            path: path.to_path_buf(),
            source,
        })?;
        Ok(Self {
            path: path.display().to_string(),
            sha256: sha256_hex(&contents),
        })
    }
}
