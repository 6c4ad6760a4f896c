//! The bank as a JSON file: schema version, units, provenance, models; read back strictly.

use super::super::band::PredictionBand;
use super::super::error::ModelError;
use super::super::noise::NoiseLevels;
use super::super::support::Support;
use super::{Bank, BankModel, BankProvenance, InputFile};
use crate::file::{sha256_hex, write_whole};
use crate::flight::SIGNALS;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::path::Path;

/// What the file says it is.
const SCHEMA: &str = "flyvine-bank";
/// Version of the bank format that this library writes and reads.
pub const BANK_SCHEMA_VERSION: u64 = 2;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BankFile {
    schema: String,
    schema_version: u64,
    units: Units,
    provenance: BankProvenance,
    models: Vec<BankModel>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    band: Option<PredictionBand>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    noise: Option<NoiseLevels>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    support: Option<Support>,
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
        state: SIGNALS.map(String::from).to_vec(),
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
            band: self.band().cloned(),
            noise: self.noise().copied(),
            support: self.support().copied(),
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
        let file: BankFile = serde_json::from_value(value).map_err(|error| {
            let of_another_version = ["missing field", "unknown field"];
            let message = error.to_string();
            let advice = if of_another_version.iter().any(|what| message.contains(what)) {
                "; if another version of the program wrote this bank, fit its flights again (`flyvine fit`)"
            } else {
                ""
            };
            D::Error::custom(message + advice)
        })?;
        if file.units != units() {
            return Err(D::Error::custom(format!(
                "bank units: expected metres, kPa, {} s and the state {}",
                crate::DT,
                SIGNALS.join(", ")
            )));
        }
        Self::new(file.models, file.provenance)
            .and_then(|bank| bank.with_band(file.band))
            .and_then(|bank| bank.with_noise(file.noise))
            .and_then(|bank| bank.with_support(file.support))
            .map_err(D::Error::custom)
    }
}

impl Bank {
    /// Reads a bank file.
    ///
    /// # Errors
    /// The file cannot be read, is not JSON, is not a bank, has another schema version, an unknown or missing
    /// field, a value that is not a finite number, or an array of the wrong length; the message says which.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let contents = std::fs::read(path).map_err(ModelError::file(path))?;
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
        write_json(path, self)
    }
}

/// Writes `value` as JSON, whole or not at all.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), ModelError> {
    let contents = serde_json::to_vec(value).map_err(|error| ModelError::file(path)(error.into()))?;
    write_whole(path, &contents).map_err(ModelError::file(path))
}

impl InputFile {
    /// Hashes the file at `path`.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of(path: &Path) -> Result<Self, ModelError> {
        let contents = std::fs::read(path).map_err(ModelError::file(path))?;
        Ok(Self {
            path: path.display().to_string(),
            sha256: sha256_hex(&contents),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::family::Model;
    use super::super::super::lag::tests::random_model;
    use super::super::super::lag::{CommandInputs, HEIGHT_ROW};
    use super::super::ModelDiagnostics;
    use super::*;
    use crate::flight::Configuration;

    fn bank() -> Bank {
        let model = BankModel {
            configuration: Configuration {
                length_m: 0.7,
                pressure_kpa: 0.0,
            },
            model: Model::Lag(random_model(3, CommandInputs::Position, &[HEIGHT_ROW], 1)),
            diagnostics: ModelDiagnostics {
                rows: 7,
                condition_number: f64::INFINITY, // columns that depend on each other
                ..ModelDiagnostics::default()
            },
        };
        let inputs = vec![InputFile {
            path: "a.csv".into(),
            sha256: sha256_hex(b"a"),
        }];
        Bank::new(vec![model], BankProvenance::default())
            .unwrap()
            .with_inputs(inputs)
            .with_noise(Some(NoiseLevels::LAG))
            .unwrap()
    }

    /// The message for the bank's JSON with `from` replaced by `to`.
    fn message(from: &str, to: &str) -> String {
        let text = serde_json::to_string(&bank()).unwrap();
        assert!(text.contains(from), "{from} is not in the file");
        serde_json::from_str::<Bank>(&text.replacen(from, to, 1))
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn a_file_gives_back_the_bank() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bank.json");
        bank().write(&path).unwrap();
        assert_eq!(Bank::read(&path).unwrap(), bank());
    }

    #[test]
    fn other_versions_and_schemas_are_named() {
        let newer = message("\"schema_version\":2", "\"schema_version\":3");
        assert!(newer.contains("schema_version: found 3, expected 2"), "{newer}");
        let other = message("flyvine-bank", "flyvine-plan");
        assert!(
            other.contains("found schema \"flyvine-plan\", expected a bank"),
            "{other}"
        );
    }

    #[test]
    fn what_does_not_belong_is_refused() {
        assert!(message("\"rows\":7", "\"rows\":7,\"colour\":1").contains("unknown field `colour`"));
        let older = message("\"rows\":7,", "");
        assert!(
            older.contains("missing field `rows`") && older.contains("`flyvine fit`"),
            "{older}"
        );
        assert!(message("\"kPa\"", "\"psi\"").contains("units"));
        assert!(
            message("\"lags\":3,\"inputs\"", "\"lags\":2,\"inputs\"")
                .contains("row 0: found 30 values, expected 21")
        );
        assert!(message("\"family\":\"lag\"", "\"family\":\"oracle\"").contains("unknown variant `oracle`"));
        assert!(message("\"offset\":[", "\"offset\":[null,").contains("null"));
        let noise = message("\"gust_s\":1.0", "\"gust_s\":-1.0");
        assert!(noise.contains("noise level gust_s: found -1"), "{noise}");
        let huge = message("\"offset\":[", "\"offset\":[1e999,");
        assert!(huge.contains("number out of range"), "{huge}");
    }

    #[test]
    fn errors_name_the_file() {
        let missing = Bank::read(Path::new("no/such/bank.json"))
            .unwrap_err()
            .to_string();
        assert!(missing.starts_with("no/such/bank.json: "), "{missing}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cut.json");
        let text = serde_json::to_string(&bank()).unwrap();
        std::fs::write(&path, &text[..text.len() / 2]).unwrap();
        let cut = Bank::read(&path).unwrap_err().to_string();
        assert!(cut.contains("cut.json") && cut.contains("EOF"), "{cut}");
    }
}
