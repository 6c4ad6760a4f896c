//! The shape of a lag model's fit: what its rows are functions of, the columns of its two regressions, and the way back
//! from their solutions to a model in w.

use super::error::ModelError;
use super::features::{Coordinates, PLACE_LEN, quadratic_len};
use super::lag::{CommandInputs, HEIGHT_ROW, LagModel, QuadraticTerms, STATE_LEN};
use super::least_squares::{Gram, Penalty, TriangularFactor};
use super::options::{Positions, Structure};
use super::track::Track;
use faer::Mat;

/// Shape of a fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub structure: Structure,
    pub lags: usize,
    pub inputs: CommandInputs,
    pub positions: Positions,
}

/// Strengths of the ridges; `height = None` leaves the height row linear.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ridges {
    pub linear: f64,
    pub height: Option<f64>,
}

impl Ridges {
    /// What holds back the linear rows.
    pub fn linear_penalty(self, shape: Shape) -> Penalty {
        Penalty {
            intercept: shape.linear_rows_have_offsets(),
            strengths: vec![self.linear; shape.variables()],
        }
    }

    /// What holds back the quadratic height row: its products by the height ridge.
    pub fn height_penalty(self, shape: Shape) -> Option<Penalty> {
        let mut strengths = vec![self.height?; shape.height_terms() - 1];
        strengths[..shape.variables()].fill(self.linear);
        Some(Penalty {
            intercept: true,
            strengths,
        })
    }
}

/// A row of a model, in w.
pub(crate) struct Row {
    pub offset: f64,
    pub linear: Vec<f64>,
    /// Of the quadratic height row only.
    pub upper_triangle: Option<Vec<f64>>,
}

/// The two regressions of a corner.
pub(crate) struct Factors<F> {
    /// `[w | x_{k+1} − x_k]`, all nine signals; `[1, r | …]` where positions are relative.
    pub linear: F,
    /// `[1, w, v vᵀ | height increment]`, for the paper's structure; `[1, r, r rᵀ | …]` where positions are relative.
    pub height: Option<F>,
}

impl Factors<TriangularFactor> {
    /// The same rows as Gram matrices.
    pub fn grams(&self) -> Factors<Gram> {
        Factors {
            linear: self.linear.gram(),
            height: self.height.as_ref().map(TriangularFactor::gram),
        }
    }
}

impl Shape {
    /// Number p of the regressors w.
    pub fn regressors(self) -> usize {
        self.lags * STATE_LEN + self.inputs.len()
    }

    /// Number of variables that rows are functions of: w, or r, the coordinates v without the place in the room.
    pub fn variables(self) -> usize {
        match self.positions {
            Positions::Absolute => self.regressors(),
            Positions::Relative => self.regressors() - PLACE_LEN,
        }
    }

    /// Whether linear rows have an offset: where the height above the floor is not known, the tip's rest below the
    /// quadrotor cannot stand for one.
    pub fn linear_rows_have_offsets(self) -> bool {
        self.positions == Positions::Relative
    }

    /// Number of coefficients of a linear row.
    pub fn linear_terms(self) -> usize {
        self.variables() + usize::from(self.linear_rows_have_offsets())
    }

    /// Number of coefficients of a quadratic height row.
    pub fn height_terms(self) -> usize {
        quadratic_len(self.variables())
    }

    /// Number of coefficients of the largest row.
    pub fn coefficients(self) -> usize {
        match self.structure {
            Structure::Paper => self.height_terms(),
            Structure::Linear => self.linear_terms(),
        }
    }

    /// Factors the rows of `transitions` k → k + 1; `write_terms` writes the terms of the linear rows and of the
    /// quadratic height row (empty, if that is linear) for a w.
    pub fn factors(
        self,
        source: &Track,
        transitions: &[usize],
        mut write_terms: impl FnMut(&[f64], &mut [f64], &mut [f64]),
    ) -> Factors<TriangularFactor> {
        let quadratic = self.structure == Structure::Paper;
        let mut w = vec![0.0; self.regressors()];
        let mut linear_terms = vec![0.0; self.linear_terms()];
        let mut height_terms = vec![0.0; if quadratic { self.height_terms() } else { 0 }];
        let mut linear = Mat::zeros(transitions.len(), linear_terms.len() + STATE_LEN);
        let mut height = Mat::zeros(
            if quadratic { transitions.len() } else { 0 },
            height_terms.len() + 1,
        );
        for (row, &k) in transitions.iter().enumerate() {
            source.regressors(k, self.lags, &mut w);
            write_terms(&w, &mut linear_terms, &mut height_terms);
            let increments = source.increments(k);
            for (column, &value) in linear_terms.iter().chain(&increments).enumerate() {
                linear[(row, column)] = value;
            }
            if quadratic {
                for (column, &value) in height_terms.iter().chain([&increments[HEIGHT_ROW]]).enumerate() {
                    height[(row, column)] = value;
                }
            }
        }
        Factors {
            linear: TriangularFactor::of_rows(linear, linear_terms.len()),
            height: quadratic.then(|| TriangularFactor::of_rows(height, height_terms.len())),
        }
    }

    /// Solves both regressions and puts the model together, back in the coordinates w.
    pub fn model<F>(
        self,
        factors: &Factors<F>,
        ridges: Ridges,
        solve: &dyn Fn(&F, &Penalty) -> Mat<f64>,
    ) -> Result<LagModel, ModelError> {
        let theta = solve(&factors.linear, &ridges.linear_penalty(self));
        let penalty = ridges.height_penalty(self);
        let height = penalty
            .zip(factors.height.as_ref())
            .map(|(penalty, factor)| self.height_row(solve(factor, &penalty).col_as_slice(0)));
        self.assemble(self.linear_rows(&theta), height)
    }

    /// The linear rows with these coefficients (terms × 9), in w.
    pub fn linear_rows(self, theta: &Mat<f64>) -> Vec<Row> {
        let coordinates = Coordinates::new(self.lags, self.inputs);
        let row = |signal: usize| {
            let theta = theta.col_as_slice(signal);
            let (offset, linear) = match self.positions {
                Positions::Absolute => (0.0, theta.to_vec()),
                Positions::Relative => (theta[0], coordinates.linear_on_w(&theta[1..])),
            };
            Row {
                offset,
                linear,
                upper_triangle: None,
            }
        };
        (0..STATE_LEN).map(row).collect()
    }

    /// The quadratic height row with these coefficients, in w.
    fn height_row(self, theta: &[f64]) -> Row {
        let (linear, products) = theta[1..].split_at(self.variables());
        let coordinates = Coordinates::new(self.lags, self.inputs);
        let (linear, products) = match self.positions {
            Positions::Absolute => (linear.to_vec(), products.to_vec()),
            Positions::Relative => {
                // The place comes first in v, and so its products in the triangle.
                let p = self.regressors();
                let of_place = p * (p + 1) / 2 - products.len();
                (
                    coordinates.linear_on_w(linear),
                    [vec![0.0; of_place], products.to_vec()].concat(),
                )
            }
        };
        Row {
            offset: theta[0],
            linear,
            upper_triangle: Some(coordinates.quadratic_on_w(&products)),
        }
    }

    /// Puts a model together from the nine `rows` that predict increments; `height` takes the place of the last, if it is
    /// quadratic.
    pub fn assemble(self, mut rows: Vec<Row>, height: Option<Row>) -> Result<LagModel, ModelError> {
        if let Some(height) = height {
            rows[HEIGHT_ROW] = height;
        }
        let mut quadratic = Vec::new();
        for (signal, row) in rows.iter_mut().enumerate() {
            // Increments were fitted: add the newest state.
            row.linear[signal] += 1.0;
            if let Some(upper_triangle) = row.upper_triangle.take() {
                quadratic.push(QuadraticTerms {
                    row: signal,
                    upper_triangle,
                });
            }
        }
        let offset = rows.iter().map(|row| row.offset).collect();
        let linear = rows.into_iter().flat_map(|row| row.linear).collect();
        LagModel::new(self.lags, self.inputs, offset, linear, &quadratic)
    }
}
