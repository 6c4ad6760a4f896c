//! Linear models published as a matrix: `[A_0 A_1 … | B]`, one CSV row per signal.

use super::error::ModelError;
use super::lag::{CommandInputs, LagModel, STATE_LEN, require_lags};
use std::path::Path;

impl LagModel {
    /// Reads a linear model from a CSV file with a header: nine rows in the order of the state, each a label
    /// and then the coefficients of `x_k, x_{k−1}, …` and of the commanded position. The number of columns says
    /// how many lags there are. The first author's identified models have this form (9 × 48, five lags).
    ///
    /// # Errors
    /// The file cannot be read, is not rectangular, has not nine rows of `1 + 9 · lags + 3` cells, or holds
    /// something that is not a finite number.
    pub fn read_matrix(path: &Path) -> Result<Self, ModelError> {
        let format = |message: String| ModelError::Format {
            path: path.to_path_buf(),
            message,
        };
        let file = std::fs::File::open(path).map_err(ModelError::file(path))?;
        let mut linear = Vec::new();
        let mut rows = 0;
        for record in csv::Reader::from_reader(file).records() {
            let record = record.map_err(|error| format(error.to_string()))?;
            for (column, cell) in record.iter().enumerate().skip(1) {
                let value = cell.trim().parse::<f64>().ok().filter(|value| value.is_finite());
                linear.push(value.ok_or_else(|| {
                    format(format!(
                        "row {}, column {}: found {cell:?}, expected a finite number",
                        rows + 1,
                        column + 1
                    ))
                })?);
            }
            rows += 1;
        }
        let inputs = CommandInputs::Position;
        let width = linear.len() / rows.max(1);
        let lags = width.saturating_sub(inputs.len()) / STATE_LEN;
        if rows != STATE_LEN || width != lags * STATE_LEN + inputs.len() || require_lags(lags).is_err() {
            return Err(format(format!(
                "found {rows} rows of {width} coefficients, expected {STATE_LEN} rows of 9 per lag and 3 for the command"
            )));
        }
        Self::new(lags, inputs, vec![0.0; STATE_LEN], linear, &[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<LagModel, ModelError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("matrix.csv");
        std::fs::write(&path, text).unwrap();
        LagModel::read_matrix(&path)
    }

    fn table(rows: usize, columns: usize, last: &str) -> String {
        let header = vec!["c"; columns + 1].join(",");
        let row = |index: usize| {
            let cells: Vec<String> = (0..columns)
                .map(|column| format!("{}", index * 100 + column))
                .collect();
            format!("r,{}", cells.join(","))
        };
        let text = [vec![header], (0..rows).map(row).collect()].concat().join("\n");
        let cut = text.rfind(',').unwrap();
        format!("{},{last}\n", &text[..cut])
    }

    #[test]
    fn rows_and_columns_keep_their_places() {
        let model = read(&table(9, 21, "7.5")).unwrap();
        assert_eq!(model.lags(), 2);
        assert_eq!(model.linear()[3 * 21 + 4], 304.0);
        assert_eq!(model.linear()[9 * 21 - 1], 7.5);
    }

    #[test]
    fn what_is_no_model_is_named() {
        let message = |text: &str| read(text).unwrap_err().to_string();
        assert!(message(&table(8, 21, "1")).contains("found 8 rows of 21 coefficients, expected 9 rows"));
        assert!(message(&table(9, 22, "1")).contains("found 9 rows of 22"));
        assert!(message(&table(9, 21, "NaN")).contains("row 9, column 22: found \"NaN\""));
        assert!(message("a,b\n").contains("found 0 rows"));
    }
}
