//! What refinement moves: the linear coefficients of all rows, and offsets.

use super::super::features::{Coordinates, PLACE_LEN};
use super::super::lag::{LagModel, STATE_LEN};
use super::super::options::Positions;

/// Directions in which a model's coefficients may move: nine rows of linear coefficients, then offsets.
pub(super) struct Parameters {
    /// `None`: the regressors of the linear coefficients are w; otherwise r, the coordinates v without the place.
    relative: Option<Coordinates>,
    /// Length p of w.
    p: usize,
    /// Rows whose offset moves.
    offset_rows: Vec<usize>,
}

impl Parameters {
    /// Those of `model`: the offsets of its quadratic rows, or of every row where positions are relative.
    pub fn of(model: &LagModel, positions: Positions) -> Self {
        let (relative, offset_rows) = match positions {
            Positions::Absolute => (None, model.quadratic().iter().map(|terms| terms.row).collect()),
            Positions::Relative => (
                Some(Coordinates::new(model.lags(), model.inputs())),
                (0..STATE_LEN).collect(),
            ),
        };
        Self {
            relative,
            p: model.regressor_len(),
            offset_rows,
        }
    }

    /// Number of regressors of a row's linear coefficients.
    pub fn regressors(&self) -> usize {
        match self.relative {
            None => self.p,
            Some(_) => self.p - PLACE_LEN,
        }
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        STATE_LEN * self.regressors() + self.offset_rows.len()
    }

    /// Writes the regressors of a row's linear coefficients for a `w`.
    pub fn write_regressors(&self, w: &[f64], regressors: &mut [f64]) {
        match &self.relative {
            None => regressors.copy_from_slice(w),
            Some(coordinates) => {
                let mut v = vec![0.0; w.len()];
                coordinates.apply(w, &mut v);
                regressors.copy_from_slice(&v[PLACE_LEN..]);
            }
        }
    }

    /// Adds `∂f/∂θ` to `sensitivities` (9 × parameters, row-major), given the regressors.
    pub fn add_direct(&self, regressors: &[f64], sensitivities: &mut [f64]) {
        let (q, len) = (self.regressors(), self.len());
        for row in 0..STATE_LEN {
            let own = &mut sensitivities[row * len + row * q..][..q];
            for (entry, value) in own.iter_mut().zip(regressors) {
                *entry += value;
            }
        }
        for (index, &row) in self.offset_rows.iter().enumerate() {
            sensitivities[row * len + STATE_LEN * q + index] += 1.0;
        }
    }

    /// `model` with its coefficients moved; `None` if one is not finite.
    pub fn moved(&self, model: &LagModel, moves: &[f64]) -> Option<LagModel> {
        let (by_row, offsets) = moves.split_at(STATE_LEN * self.regressors());
        let on_w = by_row
            .chunks_exact(self.regressors())
            .flat_map(|row| match &self.relative {
                None => row.to_vec(),
                Some(coordinates) => coordinates.linear_on_w(row),
            });
        let linear = model.linear().iter().zip(on_w).map(|(l, by)| l + by).collect();
        let mut offset = model.offset().to_vec();
        for (&row, by) in self.offset_rows.iter().zip(offsets) {
            offset[row] += by;
        }
        LagModel::new(model.lags(), model.inputs(), offset, linear, &model.quadratic()).ok()
    }
}
