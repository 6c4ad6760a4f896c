//! A lag model in a file.

use super::super::error::{ModelError, require_len};
use super::{CommandInputs, LagModel, QuadraticTerms, STATE_LEN, require_lags};
use serde::{Deserialize, Serialize};

/// A model as it stands in a file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LagModelFile {
    lags: usize,
    inputs: CommandInputs,
    offset: Vec<f64>,
    /// 9 rows of p.
    linear: Vec<Vec<f64>>,
    quadratic: Vec<QuadraticTerms>,
}

impl From<LagModel> for LagModelFile {
    fn from(model: LagModel) -> Self {
        Self {
            lags: model.lags,
            inputs: model.inputs,
            linear: model
                .linear()
                .chunks(model.regressor_len())
                .map(<[f64]>::to_vec)
                .collect(),
            quadratic: model.quadratic(),
            offset: model.offset,
        }
    }
}

impl TryFrom<LagModelFile> for LagModel {
    type Error = ModelError;

    fn try_from(file: LagModelFile) -> Result<Self, ModelError> {
        require_lags(file.lags)?;
        let p = file.lags * STATE_LEN + file.inputs.len();
        for (row, values) in file.linear.iter().enumerate() {
            require_len(&format!("linear coefficients of row {row}"), values, p)?;
        }
        Self::new(
            file.lags,
            file.inputs,
            file.offset,
            file.linear.concat(),
            &file.quadratic,
        )
    }
}
