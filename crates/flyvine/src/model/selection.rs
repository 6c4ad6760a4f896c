//! Choosing structure and ridge by what matters to a plan: rollout error on data that was held out.

use super::bank::{Bank, BankModel, BankProvenance, Model, ModelDiagnostics};
use super::corner::{Corner, CornerSolver};
use super::error::ModelError;
use super::lag::{CommandInputs, LagModel};
use super::rollout::{WindowError, standing_still_errors, window_errors};
use super::track::Track;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Horizons that a candidate is judged at, in steps: a swing's (2.5 s) and a lemniscate's (10 s).
const HORIZONS: [usize; 2] = [50, 200];
/// A window's error counts up to this, m: it has diverged, how far does not matter.
const ERROR_CAP_M: f64 = 1.0;
/// A candidate must be better by this factor to be preferred to a simpler one.
const WORTHWHILE: f64 = 0.98;

/// One choice that was tried, and how its held-out rollouts did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Candidate {
    /// Inputs of the model.
    pub inputs: CommandInputs,
    /// Ridge strength of the linear rows.
    pub linear_ridge: f64,
    /// Ridge strength of the quadratic height row; `None` if that row was linear.
    pub height_ridge: Option<f64>,
    /// Held-out end-effector rollout error at the corners; `None` if no window fits the flights.
    pub corners: Option<HeldOutError>,
    /// The same on interior and deploying flights, through the interpolation; `None` without such windows.
    pub interior: Option<HeldOutError>,
}

/// Rollout errors pooled over held-out windows of 2.5 s and 10 s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOutError {
    /// Mean over the horizons of the mean window error, each window counted up to 1 m, m.
    pub mean_m: f64,
    /// Windows, all horizons together.
    pub windows: usize,
    /// Share of windows that diverged.
    pub diverged_share: f64,
}

impl Candidate {
    /// What is minimized, m: the mean of both errors; 0 if neither could be measured.
    pub fn score_m(&self) -> f64 {
        let errors: Vec<f64> = [self.corners, self.interior]
            .iter()
            .flatten()
            .map(|error| error.mean_m)
            .collect();
        errors.iter().sum::<f64>() / errors.len().max(1) as f64
    }
}

/// Index of the candidate with the least score; a later one must be worth it.
pub(crate) fn best(candidates: &[Candidate]) -> usize {
    let mut best = 0;
    for (index, candidate) in candidates.iter().enumerate().skip(1) {
        if candidate.score_m() < WORTHWHILE * candidates[best].score_m() {
            best = index;
        }
    }
    best
}

/// Factored recordings of all corners, ready to try candidates on.
pub(crate) struct CrossValidation<'a> {
    pub corners: &'a [Corner],
    pub tracks: &'a [Track<'a>],
    /// Interior and deploying flights (indices into `tracks`).
    pub interior: &'a [usize],
    pub inputs: CommandInputs,
    /// Per corner: the solver on everything.
    pub full: Vec<CornerSolver>,
    /// Corner, blocks held out, solver on the others.
    folds: Vec<(usize, Vec<usize>, CornerSolver)>,
}

impl<'a> CrossValidation<'a> {
    /// Decomposes every fold of every corner.
    pub fn new(
        corners: &'a [Corner],
        tracks: &'a [Track<'a>],
        interior: &'a [usize],
        inputs: CommandInputs,
    ) -> Result<Self, ModelError> {
        let full = corners
            .par_iter()
            .map(|corner| corner.solver(&[]))
            .collect::<Result<_, _>>()?;
        let held_out: Vec<(usize, Vec<usize>)> = corners
            .iter()
            .enumerate()
            .flat_map(|(index, corner)| corner.folds().into_iter().map(move |fold| (index, fold)))
            .collect();
        let folds = held_out
            .into_par_iter()
            .map(|(corner, fold)| corners[corner].solver(&fold).map(|solver| (corner, fold, solver)))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            corners,
            tracks,
            interior,
            inputs,
            full,
            folds,
        })
    }

    /// Tries one choice of ridges.
    pub fn try_candidate(
        &self,
        linear_ridge: f64,
        height_ridge: Option<f64>,
    ) -> Result<Candidate, ModelError> {
        let held_out: Vec<Vec<Vec<WindowError>>> = self
            .folds
            .par_iter()
            .map(|(corner, fold, solver)| {
                let model = solver.model(linear_ridge, height_ridge)?;
                Ok(self.fold_errors(*corner, fold, &model))
            })
            .collect::<Result<_, ModelError>>()?;
        let interior = if self.interior.is_empty() {
            None
        } else {
            let models = self
                .full
                .iter()
                .map(|solver| solver.model(linear_ridge, height_ridge));
            let bank = self.bank(models.collect::<Result<_, _>>()?)?;
            let errors = self
                .interior
                .par_iter()
                .map(|&index| {
                    let track = &self.tracks[index];
                    let model = bank.scheduled(&track.configurations())?;
                    Ok(window_errors(&model, track, 0..track.rows(), &HORIZONS))
                })
                .collect::<Result<Vec<_>, ModelError>>()?;
            pool(&errors)
        };
        Ok(Candidate {
            inputs: self.inputs,
            linear_ridge,
            height_ridge,
            corners: pool(&held_out),
            interior,
        })
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

    fn fold_errors(&self, corner: usize, fold: &[usize], model: &LagModel) -> Vec<Vec<WindowError>> {
        let mut errors = vec![Vec::new(); HORIZONS.len()];
        for &index in fold {
            let block = &self.corners[corner].blocks[index];
            let windows = window_errors(model, &self.tracks[block.track], block.rows.clone(), &HORIZONS);
            for (list, more) in errors.iter_mut().zip(windows) {
                list.extend(more);
            }
        }
        errors
    }

    fn bank(&self, models: Vec<LagModel>) -> Result<Bank, ModelError> {
        let models = self.corners.iter().zip(models).map(|(corner, model)| BankModel {
            configuration: corner.configuration,
            model: Model::Lag(model),
            diagnostics: ModelDiagnostics::default(),
        });
        Bank::new(models.collect(), BankProvenance::default())
    }
}

/// Pools windows of several flights (outer index), per horizon (inner index).
fn pool(flights: &[Vec<Vec<WindowError>>]) -> Option<HeldOutError> {
    let (mut means, mut windows, mut diverged) = (Vec::new(), 0, 0);
    for horizon in 0..HORIZONS.len() {
        let here: Vec<&WindowError> = flights.iter().flat_map(|flight| &flight[horizon]).collect();
        if here.is_empty() {
            continue;
        }
        let capped: f64 = here.iter().map(|window| window.mean_m.min(ERROR_CAP_M)).sum();
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
