//! The recordings of one configuration as triangular factors, and the models that solve them.

use super::error::ModelError;
use super::features::{quadratic_len, quadratic_terms};
use super::lag::{CommandInputs, HEIGHT_ROW, LagModel, QuadraticTerms, STATE_LEN};
use super::least_squares::{RidgeSolver, TriangularFactor};
use super::options::Structure;
use super::track::Track;
use crate::flight::Configuration;
use faer::Mat;
use rayon::prelude::*;
use std::ops::Range;

/// Fewer flights than this at one configuration are cut into segments for cross-validation.
const WHOLE_FLIGHTS: usize = 3;
/// Number of segments that fewer flights are cut into.
const SEGMENTS: usize = 6;
/// Most folds of a cross-validation.
const MAX_FOLDS: usize = 6;

/// Rows of one flight that are held out together.
pub(crate) struct Block {
    /// Index of the track.
    pub track: usize,
    /// Rows k of its transitions k → k + 1.
    pub rows: Range<usize>,
    /// `[w | x_{k+1} − x_k]`.
    linear: TriangularFactor,
    /// `[1, w, w wᵀ | height increment]`, for the paper's structure.
    height: Option<TriangularFactor>,
}

/// The recordings at one configuration.
pub(crate) struct Corner {
    pub configuration: Configuration,
    pub blocks: Vec<Block>,
    lags: usize,
    inputs: CommandInputs,
}

/// Decomposed least-squares problems of one choice of blocks.
pub(crate) struct CornerSolver {
    pub rows: usize,
    lags: usize,
    inputs: CommandInputs,
    linear_factor: TriangularFactor,
    height_factor: Option<TriangularFactor>,
    linear: RidgeSolver,
    height: Option<RidgeSolver>,
}

impl Corner {
    /// Factors the rows of `members` (indices into `tracks`).
    pub fn new(
        configuration: Configuration,
        members: &[usize],
        tracks: &[Track],
        (structure, lags, inputs): (Structure, usize, CommandInputs),
    ) -> Result<Self, ModelError> {
        let pieces = if members.len() >= WHOLE_FLIGHTS {
            1
        } else {
            SEGMENTS / members.len()
        };
        let cuts: Vec<(usize, Range<usize>)> = members
            .iter()
            .flat_map(|&track| {
                let rows = tracks[track].rows();
                (0..pieces).map(move |piece| (track, rows * piece / pieces..rows * (piece + 1) / pieces))
            })
            .collect();
        let blocks: Vec<Block> = cuts
            .into_par_iter()
            .map(|(track, rows)| Block::new(track, rows, &tracks[track], structure, lags))
            .collect();
        let rows = blocks.iter().map(|block| block.linear.rows).sum();
        let p = lags * STATE_LEN + inputs.len();
        let coefficients = match structure {
            Structure::Paper => quadratic_len(p),
            Structure::Linear => p,
        };
        if rows < coefficients {
            return Err(ModelError::TooFewRows {
                configuration,
                flights: members.len(),
                rows,
                coefficients,
            });
        }
        Ok(Self {
            configuration,
            blocks,
            lags,
            inputs,
        })
    }

    /// Blocks per fold of the cross-validation: every block is held out once.
    pub fn folds(&self) -> Vec<Vec<usize>> {
        let count = self.blocks.len().min(MAX_FOLDS);
        (0..count)
            .map(|fold| (fold..self.blocks.len()).step_by(count).collect())
            .collect()
    }

    /// Decomposes the problem of all blocks but `held_out`.
    pub fn solver(&self, held_out: &[usize]) -> Result<CornerSolver, ModelError> {
        let kept = || {
            self.blocks
                .iter()
                .enumerate()
                .filter(|(index, _)| !held_out.contains(index))
        };
        let failed = |what| ModelError::Factorization {
            what,
            configuration: self.configuration,
        };
        let linear_factor = TriangularFactor::merge(kept().map(|(_, block)| &block.linear));
        let linear = RidgeSolver::new(&linear_factor, false)
            .ok_or_else(|| failed("singular value decomposition of the linear rows"))?;
        let height_factor = self.blocks[0]
            .height
            .is_some()
            .then(|| TriangularFactor::merge(kept().filter_map(|(_, block)| block.height.as_ref())));
        let height = match &height_factor {
            None => None,
            Some(factor) => Some(
                RidgeSolver::new(factor, true)
                    .ok_or_else(|| failed("singular value decomposition of the height row"))?,
            ),
        };
        Ok(CornerSolver {
            rows: linear_factor.rows,
            lags: self.lags,
            inputs: self.inputs,
            linear_factor,
            height_factor,
            linear,
            height,
        })
    }
}

impl Block {
    fn new(track: usize, rows: Range<usize>, source: &Track, structure: Structure, lags: usize) -> Self {
        let transitions: Vec<usize> = rows.clone().filter(|&k| source.unbroken(k, lags, 1)).collect();
        let p = lags * STATE_LEN + source.command(0).len();
        let mut w = vec![0.0; p];
        let mut linear = Mat::zeros(transitions.len(), p + STATE_LEN);
        let terms = match structure {
            Structure::Paper => quadratic_len(p),
            Structure::Linear => 0,
        };
        let mut quadratic = vec![0.0; terms];
        let mut height = Mat::zeros(transitions.len(), terms + 1);
        for (row, &k) in transitions.iter().enumerate() {
            source.lagged_state(k, &mut w[..lags * STATE_LEN]);
            w[lags * STATE_LEN..].copy_from_slice(source.command(k));
            let (now, next) = (source.state(k), source.state(k + 1));
            for (column, &value) in w.iter().enumerate() {
                linear[(row, column)] = value;
            }
            for signal in 0..STATE_LEN {
                linear[(row, p + signal)] = next[signal] - now[signal];
            }
            if terms > 0 {
                quadratic_terms(&w, &mut quadratic);
                for (column, &value) in quadratic.iter().enumerate() {
                    height[(row, column)] = value;
                }
                height[(row, terms)] = next[HEIGHT_ROW] - now[HEIGHT_ROW];
            }
        }
        Self {
            track,
            rows,
            linear: TriangularFactor::of_rows(linear, p),
            height: (terms > 0).then(|| TriangularFactor::of_rows(height, terms)),
        }
    }
}

impl CornerSolver {
    /// The model with the given ridge strengths; `height_ridge = None` leaves the height row linear.
    pub fn model(&self, linear_ridge: f64, height_ridge: Option<f64>) -> Result<LagModel, ModelError> {
        let increments = self.linear.solve(linear_ridge);
        let p = increments.nrows();
        let mut offset = vec![0.0; STATE_LEN];
        let mut linear = vec![0.0; STATE_LEN * p];
        for row in 0..STATE_LEN {
            for column in 0..p {
                linear[row * p + column] = increments[(column, row)];
            }
        }
        let mut quadratic = Vec::new();
        if let (Some(ridge), Some(solver)) = (height_ridge, &self.height) {
            let theta = solver.solve(ridge);
            let theta = theta.col_as_slice(0);
            offset[HEIGHT_ROW] = theta[0];
            linear[HEIGHT_ROW * p..].copy_from_slice(&theta[1..=p]);
            quadratic.push(QuadraticTerms {
                row: HEIGHT_ROW,
                upper_triangle: theta[1 + p..].to_vec(),
            });
        }
        // Fitted were increments: add the newest state.
        for row in 0..STATE_LEN {
            linear[row * p + row] += 1.0;
        }
        LagModel::new(self.lags, self.inputs, offset, linear, &quadratic)
    }

    /// Root-mean-square residual per signal over the rows that were fitted.
    pub fn residual_rms(&self, linear_ridge: f64, height_ridge: Option<f64>) -> Vec<f64> {
        let mut rms = self.linear_factor.residual_rms(&self.linear.solve(linear_ridge));
        if let (Some(ridge), Some(solver), Some(factor)) = (height_ridge, &self.height, &self.height_factor) {
            rms[HEIGHT_ROW] = factor.residual_rms(&solver.solve(ridge))[0];
        }
        rms
    }

    /// Coefficients of the largest row.
    pub fn coefficients(&self) -> usize {
        self.height_factor
            .as_ref()
            .unwrap_or(&self.linear_factor)
            .regressors()
    }

    /// Condition numbers of the equilibrated regressors: height row (if quadratic), linear rows.
    pub fn condition_numbers(&self) -> (Option<f64>, f64) {
        (
            self.height.as_ref().map(RidgeSolver::condition_number),
            self.linear.condition_number(),
        )
    }
}
