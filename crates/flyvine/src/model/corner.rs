//! The recordings of one configuration as triangular factors, and the models that solve them.

use super::error::ModelError;
use super::features::{Coordinates, quadratic_len, quadratic_terms};
use super::lag::{CommandInputs, HEIGHT_ROW, LagModel, QuadraticTerms, STATE_LEN};
use super::least_squares::{Gram, Penalty, TriangularFactor};
use super::options::Structure;
use super::refine::Stretch;
use super::track::Track;
use crate::flight::Configuration;
use faer::Mat;
use rayon::prelude::*;
use std::ops::Range;

/// With this many flights at one configuration, whole flights are held out in cross-validation.
const WHOLE_FLIGHTS: usize = 3;
/// Most pieces that the flights of one configuration are cut into, if there are fewer.
const MAX_PIECES: usize = 6;
/// Rows of a piece: a 10-s rollout and some room.
const PIECE_ROWS: usize = 300;

/// Shape of a fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub structure: Structure,
    pub lags: usize,
    pub inputs: CommandInputs,
}

/// Strengths of the ridges; `height = None` leaves the height row linear.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ridges {
    pub linear: f64,
    pub height: Option<f64>,
}

impl Ridges {
    /// What holds back the rows that are linear in `p` regressors.
    pub fn linear_penalty(self, p: usize) -> Penalty {
        Penalty {
            intercept: false,
            strengths: vec![self.linear; p],
        }
    }

    /// What holds back the quadratic height row: its products by the height ridge.
    pub fn height_penalty(self, p: usize) -> Option<Penalty> {
        let mut strengths = vec![self.height?; quadratic_len(p) - 1];
        strengths[..p].fill(self.linear);
        Some(Penalty {
            intercept: true,
            strengths,
        })
    }
}

/// The quadratic height row, in w.
pub(crate) struct HeightRow {
    pub offset: f64,
    pub linear: Vec<f64>,
    pub upper_triangle: Vec<f64>,
}

/// Rows of one flight that are held out together.
pub(crate) struct Block {
    /// Index of the track.
    pub track: usize,
    /// Rows k of its transitions k → k + 1.
    pub rows: Range<usize>,
    factors: Factors<TriangularFactor>,
    grams: Factors<Gram>,
}

/// The two regressions of a corner.
pub(crate) struct Factors<F> {
    /// `[w | x_{k+1} − x_k]`, all nine signals.
    pub linear: F,
    /// `[1, w, v vᵀ | height increment]`, for the paper's structure.
    pub height: Option<F>,
}

/// The recordings at one configuration.
pub(crate) struct Corner {
    pub configuration: Configuration,
    pub blocks: Vec<Block>,
    shape: Shape,
    /// Everything merged.
    factors: Factors<TriangularFactor>,
    grams: Factors<Gram>,
}

impl Corner {
    /// Factors the rows of `members` (indices into `tracks`).
    pub fn new(
        configuration: Configuration,
        members: &[usize],
        tracks: &[Track],
        shape: Shape,
    ) -> Result<Self, ModelError> {
        let cuts: Vec<(usize, Range<usize>)> = members
            .iter()
            .flat_map(|&track| {
                let rows = tracks[track].rows();
                let pieces = pieces(rows, members.len());
                (0..pieces).map(move |piece| (track, rows * piece / pieces..rows * (piece + 1) / pieces))
            })
            .collect();
        let blocks: Vec<Block> = cuts
            .into_par_iter()
            .map(|(track, rows)| Block::new(track, rows, &tracks[track], shape))
            .collect();
        let factors = Factors {
            linear: TriangularFactor::merge(blocks.iter().map(|block| &block.factors.linear)),
            height: (shape.structure == Structure::Paper).then(|| {
                TriangularFactor::merge(blocks.iter().filter_map(|block| block.factors.height.as_ref()))
            }),
        };
        let corner = Self {
            configuration,
            grams: factors.grams(),
            factors,
            blocks,
            shape,
        };
        let (rows, coefficients) = (corner.rows(), corner.coefficients());
        if rows < coefficients {
            return Err(ModelError::TooFewRows {
                configuration,
                flights: members.len(),
                rows,
                coefficients,
            });
        }
        Ok(corner)
    }

    /// The flights fitted.
    pub fn members<'a, 'b>(&self, tracks: &'b [Track<'a>]) -> Vec<&'b Track<'a>> {
        let mut indices: Vec<usize> = self.blocks.iter().map(|block| block.track).collect();
        indices.dedup();
        indices.into_iter().map(|index| &tracks[index]).collect()
    }

    /// Whether there are flights enough to hold whole ones out.
    pub fn holds_out_whole_flights(&self) -> bool {
        let mut tracks: Vec<usize> = self.blocks.iter().map(|block| block.track).collect();
        tracks.dedup();
        tracks.len() >= WHOLE_FLIGHTS
    }

    /// Rows fitted.
    pub fn rows(&self) -> usize {
        self.factors.linear.rows
    }

    /// Coefficients of the largest row.
    pub fn coefficients(&self) -> usize {
        self.factors
            .height
            .as_ref()
            .unwrap_or(&self.factors.linear)
            .regressors()
    }

    /// The model fitted on everything, by QR.
    pub fn model(&self, ridges: Ridges) -> Result<LagModel, ModelError> {
        self.shape.model(&self.factors, ridges, &TriangularFactor::solve)
    }

    /// The model fitted on everything, for trials.
    pub fn model_on_trial(&self, ridges: Ridges) -> Result<LagModel, ModelError> {
        self.shape.model(&self.grams, ridges, &Gram::solve)
    }

    /// The model fitted on all blocks but those held out, for trials.
    pub fn model_without(&self, held_out: &[usize], ridges: Ridges) -> Result<LagModel, ModelError> {
        let mut grams = Factors {
            linear: self.grams.linear.clone(),
            height: self.grams.height.clone(),
        };
        for &block in held_out {
            let left_out = &self.blocks[block].grams;
            grams.linear = grams.linear.without(&left_out.linear);
            grams.height = grams
                .height
                .zip(left_out.height.as_ref())
                .map(|(all, out)| all.without(out));
        }
        self.shape.model(&grams, ridges, &Gram::solve)
    }

    /// Rows of the blocks that `keep` says, to roll out on.
    pub fn stretches<'a, 'b>(&self, tracks: &'b [Track<'a>], keep: impl Fn(usize) -> bool) -> Vec<Stretch<'b>>
    where
        'a: 'b,
    {
        let kept = self.blocks.iter().enumerate().filter(|(index, _)| keep(*index));
        kept.map(|(_, block)| (&tracks[block.track], block.rows.clone()))
            .collect()
    }

    /// Condition numbers of the equilibrated regressors: of the height row, if it is quadratic, and of the
    /// linear rows.
    pub fn condition_numbers(&self) -> Result<(Option<f64>, f64), ModelError> {
        let failed = ModelError::Factorization {
            what: "singular values",
            configuration: self.configuration,
        };
        let height = self
            .factors
            .height
            .as_ref()
            .map(|factor| factor.condition_number(true));
        match (height, self.factors.linear.condition_number(false)) {
            (Some(None), _) | (_, None) => Err(failed),
            (height, Some(linear)) => Ok((height.flatten(), linear)),
        }
    }
}

/// Number of pieces that one of `flights` flights is cut into; at least two things must be there to hold one out.
fn pieces(rows: usize, flights: usize) -> usize {
    if flights >= WHOLE_FLIGHTS {
        return 1;
    }
    (rows / PIECE_ROWS).clamp(if flights == 1 { 2 } else { 1 }, MAX_PIECES / flights)
}

impl Factors<TriangularFactor> {
    fn grams(&self) -> Factors<Gram> {
        Factors {
            linear: self.linear.gram(),
            height: self.height.as_ref().map(TriangularFactor::gram),
        }
    }
}

impl Block {
    fn new(track: usize, rows: Range<usize>, source: &Track, shape: Shape) -> Self {
        let Shape { lags, inputs, .. } = shape;
        let transitions: Vec<usize> = rows.clone().filter(|&k| source.unbroken(k, lags, 1)).collect();
        let coordinates = Coordinates::new(lags, inputs);
        let mut v = vec![0.0; shape.regressors()];
        let factors = shape.factors(source, &transitions, |w, terms| {
            coordinates.apply(w, &mut v);
            quadratic_terms(w, &v, terms);
        });
        Self {
            track,
            rows,
            grams: factors.grams(),
            factors,
        }
    }
}

impl Shape {
    /// Number p of the regressors w.
    pub fn regressors(self) -> usize {
        self.lags * STATE_LEN + self.inputs.len()
    }

    /// Factors the rows of `transitions` k → k + 1; `height_terms` writes the terms of the quadratic height row for a w.
    pub fn factors(
        self,
        source: &Track,
        transitions: &[usize],
        mut height_terms: impl FnMut(&[f64], &mut [f64]),
    ) -> Factors<TriangularFactor> {
        let p = self.regressors();
        let quadratic = self.structure == Structure::Paper;
        let (mut w, mut terms) = (vec![0.0; p], vec![0.0; quadratic_len(p)]);
        let mut linear = Mat::zeros(transitions.len(), p + STATE_LEN);
        let mut height = Mat::zeros(if quadratic { transitions.len() } else { 0 }, terms.len() + 1);
        for (row, &k) in transitions.iter().enumerate() {
            source.regressors(k, self.lags, &mut w);
            let increments = source.increments(k);
            for (column, &value) in w.iter().chain(&increments).enumerate() {
                linear[(row, column)] = value;
            }
            if quadratic {
                height_terms(&w, &mut terms);
                for (column, &value) in terms.iter().chain([&increments[HEIGHT_ROW]]).enumerate() {
                    height[(row, column)] = value;
                }
            }
        }
        Factors {
            linear: TriangularFactor::of_rows(linear, p),
            height: quadratic.then(|| TriangularFactor::of_rows(height, terms.len())),
        }
    }

    /// Solves both regressions and puts the model together, back in the coordinates w.
    fn model<F>(
        self,
        factors: &Factors<F>,
        ridges: Ridges,
        solve: &dyn Fn(&F, &Penalty) -> Mat<f64>,
    ) -> Result<LagModel, ModelError> {
        let Self { lags, inputs, .. } = self;
        let p = self.regressors();
        let theta = solve(&factors.linear, &ridges.linear_penalty(p));
        let penalty = ridges.height_penalty(p);
        let height = penalty.zip(factors.height.as_ref()).map(|(penalty, factor)| {
            let theta = solve(factor, &penalty);
            let theta = theta.col_as_slice(0);
            HeightRow {
                offset: theta[0],
                linear: theta[1..=p].to_vec(),
                upper_triangle: Coordinates::new(lags, inputs).quadratic_on_w(&theta[1 + p..]),
            }
        });
        self.assemble(&theta, height)
    }

    /// Puts a model together from what predicts increments: `linear` (p × 9), and the height row if it is quadratic.
    pub fn assemble(self, linear: &Mat<f64>, height: Option<HeightRow>) -> Result<LagModel, ModelError> {
        let mut offset = vec![0.0; STATE_LEN];
        let mut rows: Vec<Vec<f64>> = (0..STATE_LEN)
            .map(|row| linear.col_as_slice(row).to_vec())
            .collect();
        let mut quadratic = Vec::new();
        if let Some(height) = height {
            offset[HEIGHT_ROW] = height.offset;
            rows[HEIGHT_ROW] = height.linear;
            quadratic.push(QuadraticTerms {
                row: HEIGHT_ROW,
                upper_triangle: height.upper_triangle,
            });
        }
        // Increments were fitted: add the newest state.
        for (signal, row) in rows.iter_mut().enumerate() {
            row[signal] += 1.0;
        }
        LagModel::new(self.lags, self.inputs, offset, rows.concat(), &quadratic)
    }
}
