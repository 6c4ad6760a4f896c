//! Choosing structure and ridge by what matters to a plan: rollout error on data that was held out.

use super::bank::{Bank, BankModel, BankProvenance, ModelDiagnostics};
use super::corner::Corner;
use super::error::ModelError;
use super::family::Model;
use super::lag::{CommandInputs, LagModel};
use super::options::Positions;
use super::refine::refine;
use super::rollout::{WindowError, standing_still_errors, window_errors};
use super::shape::{Ridges, Shape};
use super::track::Track;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Horizons that a candidate is judged at, in steps: a swing's (2.5 s) and a lemniscate's (10 s).
pub(crate) const HORIZONS: [usize; 2] = [50, 200];
/// A window that has diverged counts as this error, m: how far and how late does not matter.
const DIVERGED_COUNTS_M: f64 = 1.0;
/// Scores within this factor of each other are nearly equal.
const NEARLY: f64 = 1.05;
/// A candidate must be better by this factor to be preferred to a simpler one.
pub(crate) const WORTHWHILE: f64 = 0.98;

/// One choice that was tried, and how its held-out rollouts did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Candidate {
    /// Inputs of the model.
    pub inputs: CommandInputs,
    /// Positions in the room, or relative ones.
    #[serde(default)]
    pub positions: Positions,
    /// Ridge strength of the linear rows.
    pub linear_ridge: f64,
    /// Ridge strength of the quadratic height row; `None` if that row was linear.
    pub height_ridge: Option<f64>,
    /// Whether the models were refined on multi-step simulation error.
    pub refined: bool,
    /// Held-out end-effector rollout error of one-step least squares at the corners; `None` if no window fits the flights.
    pub corners: Option<HeldOutError>,
    /// The same on interior and deploying flights, through the interpolation; `None` without such windows.
    pub interior: Option<HeldOutError>,
}

/// Rollout errors pooled over held-out windows of 2.5 s and 10 s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOutError {
    /// Mean over the horizons of the mean window error, m; a window that diverged counts 1 m.
    pub mean_m: f64,
    /// Windows, all horizons together.
    pub windows: usize,
    /// Share of windows that diverged.
    pub diverged_share: f64,
}

/// The mean of the errors at corners and between them, m; of one, if only that was measured.
pub(crate) fn mean_m(corners: Option<HeldOutError>, interior: Option<HeldOutError>) -> Option<f64> {
    let errors: Vec<f64> = [corners, interior]
        .iter()
        .flatten()
        .map(|error| error.mean_m)
        .collect();
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
}

impl std::fmt::Display for HeldOutError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "mean rollout error {:.1} cm, {:.1} % of {} windows diverged",
            100.0 * self.mean_m,
            100.0 * self.diverged_share,
            self.windows
        )
    }
}

impl Candidate {
    /// What is minimized, m: the mean of both errors; 0 if neither could be measured.
    pub fn score_m(&self) -> f64 {
        mean_m(self.corners, self.interior).unwrap_or(0.0)
    }

    /// Whether this is better than a simpler candidate by so much that it is to be preferred.
    pub(crate) fn is_worth_more_than(&self, simpler: &Self) -> bool {
        self.score_m() < WORTHWHILE * simpler.score_m()
    }
}

/// Index of the strongest ridge among candidates of ascending strength whose score is near the least: what is
/// held back more extrapolates more safely.
pub(crate) fn safest(candidates: &[Candidate]) -> usize {
    let least = candidates
        .iter()
        .map(Candidate::score_m)
        .fold(f64::INFINITY, f64::min);
    candidates
        .iter()
        .rposition(|candidate| candidate.score_m() <= NEARLY * least)
        .unwrap_or(0)
}

/// Held-out rollout errors with and without multi-step refinement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefinementTrial {
    /// One-step least squares, on the third of the corners' data that was held out.
    pub plain_corners: HeldOutError,
    /// Refined, on the same.
    pub refined_corners: HeldOutError,
    /// One-step least squares, on interior and deploying flights; `None` without such windows.
    pub plain_interior: Option<HeldOutError>,
    /// Refined, on the same.
    pub refined_interior: Option<HeldOutError>,
}

impl RefinementTrial {
    /// Whether refined models predict better.
    pub fn worthwhile(&self) -> bool {
        let score = |corners: HeldOutError, interior: Option<HeldOutError>| {
            corners.mean_m + interior.map_or(0.0, |error| error.mean_m)
        };
        score(self.refined_corners, self.refined_interior)
            < WORTHWHILE * score(self.plain_corners, self.plain_interior)
    }
}

/// The recordings of all corners, ready to try candidates on.
pub(crate) struct CrossValidation<'a> {
    pub corners: &'a [Corner],
    pub tracks: &'a [Track<'a>],
    /// Interior and deploying flights (indices into `tracks`).
    pub interior: &'a [usize],
    pub shape: Shape,
}

impl CrossValidation<'_> {
    /// Tries one choice of ridges: every block is predicted by the model of its corner's other blocks, every
    /// interior flight by the bank of everything.
    pub fn try_candidate(&self, ridges: Ridges) -> Result<Candidate, ModelError> {
        let blocks: Vec<(&Corner, usize)> = self
            .corners
            .iter()
            .flat_map(|corner| (0..corner.blocks.len()).map(move |block| (corner, block)))
            .collect();
        let held_out = blocks
            .par_iter()
            .map(|(corner, index)| {
                let (model, block) = (corner.model_without(&[*index], ridges)?, &corner.blocks[*index]);
                Ok(window_errors(
                    &model,
                    &self.tracks[block.track],
                    block.rows.clone(),
                    &HORIZONS,
                ))
            })
            .collect::<Result<Vec<_>, ModelError>>()?;
        let interior = if self.interior.is_empty() {
            None
        } else {
            pool(&self.interior_errors(ridges)?)
        };
        Ok(Candidate {
            inputs: self.shape.inputs,
            positions: self.shape.positions,
            linear_ridge: ridges.linear,
            height_ridge: ridges.height,
            refined: false,
            corners: pool(&held_out),
            interior,
        })
    }

    fn interior_errors(&self, ridges: Ridges) -> Result<Vec<Vec<Vec<WindowError>>>, ModelError> {
        let models = self
            .corners
            .par_iter()
            .map(|corner| corner.model_on_trial(ridges));
        self.interior_errors_of(&models.collect::<Result<Vec<_>, _>>()?)
    }

    /// Errors on the interior flights of the bank of `models`, one per corner.
    fn interior_errors_of(&self, models: &[LagModel]) -> Result<Vec<Vec<Vec<WindowError>>>, ModelError> {
        let models = self.corners.iter().zip(models).map(|(corner, model)| BankModel {
            configuration: corner.configuration,
            model: Model::Lag(model.clone()),
            diagnostics: ModelDiagnostics::default(),
        });
        let bank = Bank::new(models.collect(), BankProvenance::default())?;
        let errors = |&index: &usize| {
            let track = &self.tracks[index];
            let named = |source| ModelError::Flight {
                flight: track.flight.name.clone(),
                source: Box::new(source),
            };
            let model = bank.scheduled(&track.configurations()).map_err(named)?;
            Ok(window_errors(&model, track, 0..track.rows(), &HORIZONS))
        };
        self.interior.par_iter().map(errors).collect()
    }

    /// Refines models of two thirds of the blocks and predicts the last third with and without; `plain` and
    /// `refined` are the models of everything, and predict the interior flights. `None` if no window fits.
    pub fn try_refinement(
        &self,
        ridges: Ridges,
        plain: &[LagModel],
        refined: &[LagModel],
    ) -> Result<Option<RefinementTrial>, ModelError> {
        let pairs = self
            .corners
            .par_iter()
            .map(|corner| {
                let blocks = corner.blocks.len();
                let held_out: Vec<usize> = (0..blocks)
                    .filter(|block| block % 3 == 2.min(blocks - 1))
                    .collect();
                let plain = corner.model_without(&held_out, ridges)?;
                let kept = corner.stretches(self.tracks, |block| !held_out.contains(&block));
                let refined = refine(&plain, self.shape.positions, &kept);
                let test = corner.stretches(self.tracks, |block| held_out.contains(&block));
                let errors = |model: &LagModel| -> Vec<Vec<Vec<WindowError>>> {
                    test.iter()
                        .map(|(track, rows)| window_errors(model, track, rows.clone(), &HORIZONS))
                        .collect()
                };
                Ok(refined.map(|refined| (errors(&plain), errors(&refined))))
            })
            .collect::<Result<Vec<_>, ModelError>>()?;
        let (plain_errors, refined_errors): (Vec<_>, Vec<_>) = pairs.into_iter().flatten().unzip();
        let (Some(plain_corners), Some(refined_corners)) =
            (pool(&plain_errors.concat()), pool(&refined_errors.concat()))
        else {
            return Ok(None);
        };
        let interior = |models: &[LagModel]| -> Result<Option<HeldOutError>, ModelError> {
            if self.interior.is_empty() {
                Ok(None)
            } else {
                Ok(pool(&self.interior_errors_of(models)?))
            }
        };
        Ok(Some(RefinementTrial {
            plain_corners,
            refined_corners,
            plain_interior: interior(plain)?,
            refined_interior: interior(refined)?,
        }))
    }

    /// The error of predicting that nothing moves, on the same windows.
    pub fn standing_still(&self) -> Option<HeldOutError> {
        let errors: Vec<_> = self
            .corners
            .iter()
            .flat_map(|corner| &corner.blocks)
            .map(|block| standing_still_errors(&self.tracks[block.track], block.rows.clone(), &HORIZONS))
            .collect();
        pool(&errors)
    }
}

/// Pools windows of several flights (outer index), per horizon (inner index).
pub(crate) fn pool(flights: &[Vec<Vec<WindowError>>]) -> Option<HeldOutError> {
    let (mut means, mut windows, mut diverged) = (Vec::new(), 0, 0);
    for horizon in 0..HORIZONS.len() {
        let here: Vec<&WindowError> = flights.iter().flat_map(|flight| &flight[horizon]).collect();
        if here.is_empty() {
            continue;
        }
        let counted = |window: &&WindowError| {
            if window.diverged {
                DIVERGED_COUNTS_M
            } else {
                window.mean_m
            }
        };
        let capped: f64 = here.iter().map(counted).sum();
        means.push(capped / here.len() as f64);
        windows += here.len();
        diverged += here.iter().filter(|window| window.diverged).count();
    }
    let mean_m = means.iter().sum::<f64>() / means.len() as f64;
    (windows > 0).then(|| HeldOutError {
        mean_m,
        windows,
        diverged_share: diverged as f64 / windows as f64,
    })
}
