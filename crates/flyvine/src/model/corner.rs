//! The recordings of one configuration as triangular factors, and the models that solve them.

use super::error::ModelError;
use super::features::{Coordinates, PLACE_LEN, quadratic_terms};
use super::lag::LagModel;
use super::least_squares::{Gram, TriangularFactor};
use super::options::{Positions, Structure};
use super::refine::Stretch;
use super::shape::{Factors, Ridges, Shape};
use super::track::Track;
use crate::flight::Configuration;
use rayon::prelude::*;
use std::ops::Range;

/// With this many flights at one configuration, whole flights are held out in cross-validation.
const WHOLE_FLIGHTS: usize = 3;
/// Most pieces that the flights of one configuration are cut into, if there are fewer.
const MAX_PIECES: usize = 6;
/// Rows of a piece: a 10-s rollout and some room.
const PIECE_ROWS: usize = 300;

/// Rows of one flight that are held out together.
pub(crate) struct Block {
    /// Index of the track.
    pub track: usize,
    /// Rows k of its transitions k → k + 1.
    pub rows: Range<usize>,
    factors: Factors<TriangularFactor>,
    grams: Factors<Gram>,
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
        self.shape.coefficients()
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
        let with_offset = self.shape.linear_rows_have_offsets();
        match (height, self.factors.linear.condition_number(with_offset)) {
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

impl Block {
    fn new(track: usize, rows: Range<usize>, source: &Track, shape: Shape) -> Self {
        let Shape { lags, inputs, .. } = shape;
        let transitions: Vec<usize> = rows.clone().filter(|&k| source.unbroken(k, lags, 1)).collect();
        let coordinates = Coordinates::new(lags, inputs);
        let mut v = vec![0.0; shape.regressors()];
        let factors = shape.factors(source, &transitions, |w, linear, height| {
            coordinates.apply(w, &mut v);
            match shape.positions {
                Positions::Absolute => {
                    linear.copy_from_slice(w);
                    if !height.is_empty() {
                        quadratic_terms(w, &v, height);
                    }
                }
                Positions::Relative => {
                    let r = &v[PLACE_LEN..];
                    linear[0] = 1.0;
                    linear[1..].copy_from_slice(r);
                    if !height.is_empty() {
                        quadratic_terms(r, r, height);
                    }
                }
            }
        });
        Self {
            track,
            rows,
            grams: factors.grams(),
            factors,
        }
    }
}
