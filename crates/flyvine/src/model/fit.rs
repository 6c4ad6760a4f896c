//! From flights to a bank.

use super::bank::{Bank, BankModel, BankProvenance, ModelDiagnostics};
use super::corner::Corner;
use super::error::ModelError;
use super::family::Model;
use super::findings::{Finding, UNSTABLE, findings};
use super::groups::{Groups, group, refuse_duplicates};
use super::lag::{CommandInputs, LagModel};
use super::one_step::one_step_rmse;
use super::options::{FitOptions, Positions, Refinement, Ridge, Structure, VelocityInput};
use super::refine::refine;
use super::selection::{Candidate, CrossValidation, HeldOutError, RefinementTrial, safest};
use super::shape::{Ridges, Shape};
use super::support::Support;
use super::track::Track;
use crate::flight::{Configuration, Flight};
use rayon::prelude::*;
use serde::Serialize;

/// Ridge strengths tried on the linear rows.
const LINEAR_RIDGES: [f64; 6] = [0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2];
/// Ridge strengths tried on the quadratic height row.
const HEIGHT_RIDGES: [f64; 8] = [0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0];

/// What a fit tried, chose and noticed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FitReport {
    /// What was chosen.
    pub chosen: Candidate,
    /// Everything that was tried, in order; the first is the paper's plain least squares.
    pub candidates: Vec<Candidate>,
    /// What multi-step refinement was worth; `None` if that was not tried.
    pub refinement: Option<RefinementTrial>,
    /// The error of predicting that nothing moves, on the corners' held-out windows.
    pub standing_still: Option<HeldOutError>,
    /// Names of the flights used for cross-checking only (interior or deploying).
    pub cross_checked: Vec<String>,
    /// What the user should know.
    pub findings: Vec<Finding>,
}

/// Fits one model per corner of the flown (pressure, length) range and joins them in a bank.
///
/// Flights are grouped by configuration; the extreme ones are the corners. Flights at interior configurations
/// and flights whose configuration changes are not fitted: they judge the interpolation when ridge strengths
/// are chosen. The result does not depend on the number of threads.
///
/// # Errors
/// No flight with a constant configuration, a corner without flights or with too few rows for the structure,
/// the same recording given twice, options out of range, or a velocity input that a flight does not have.
pub fn fit_bank(flights: &[Flight], options: &FitOptions) -> Result<(Bank, FitReport), ModelError> {
    options.validate()?;
    refuse_duplicates(flights)?;
    let groups = group(flights)?;
    let mut candidates = Vec::new();
    let mut best: Option<Scan> = None;
    let mut refused = None; // what the plainest shape lacks says most
    for shape in shapes(flights, options) {
        match Scan::new(flights, &groups, shape, options) {
            Ok(scan) => {
                candidates.extend_from_slice(&scan.candidates);
                if best
                    .as_ref()
                    .is_none_or(|best| scan.chosen.is_worth_more_than(&best.chosen))
                {
                    best = Some(scan);
                }
            }
            Err(error) => {
                refused.get_or_insert(error);
            }
        }
    }
    let Some(scan) = best else {
        return Err(refused.expect("there is a shape to try"));
    };
    let fitted = scan.fit(&groups, options)?;
    let report = FitReport {
        findings: findings(
            &fitted.bank,
            &candidates[0],
            &fitted.chosen,
            fitted.standing_still,
        ),
        chosen: fitted.chosen,
        candidates,
        standing_still: fitted.standing_still,
        refinement: fitted.refinement,
        cross_checked: groups
            .interior
            .iter()
            .map(|&index| flights[index].name.clone())
            .collect(),
    };
    let bank = fitted.bank.with_support(Some(Support::of(flights)))?;
    Ok((bank, report))
}

/// The shapes to try, the plainest first.
fn shapes(flights: &[Flight], options: &FitOptions) -> Vec<Shape> {
    let has_velocity = |flight: &Flight| {
        let mut samples = flight.samples.iter();
        samples.all(|sample| sample.command_velocity.is_some())
    };
    let inputs: &[CommandInputs] = match options.command_velocity {
        VelocityInput::On => &[CommandInputs::PositionAndVelocity],
        VelocityInput::Auto if flights.iter().all(has_velocity) => {
            &[CommandInputs::Position, CommandInputs::PositionAndVelocity]
        }
        VelocityInput::Off | VelocityInput::Auto => &[CommandInputs::Position],
    };
    let positions = match options.positions {
        Some(positions) => vec![positions],
        None => vec![Positions::Absolute, Positions::Relative],
    };
    let shape = |(&inputs, &positions): (&CommandInputs, &Positions)| Shape {
        structure: options.structure,
        lags: options.lags,
        inputs,
        positions,
    };
    (inputs.iter())
        .flat_map(|inputs| positions.iter().map(move |positions| (inputs, positions)))
        .map(shape)
        .collect()
}

/// One shape's ridge strengths, tried.
struct Scan<'a> {
    shape: Shape,
    tracks: Vec<Track<'a>>,
    corners: Vec<Corner>,
    candidates: Vec<Candidate>,
    chosen: Candidate,
}

/// What was fitted on everything.
struct Fitted {
    bank: Bank,
    chosen: Candidate,
    refinement: Option<RefinementTrial>,
    standing_still: Option<HeldOutError>,
}

impl<'a> Scan<'a> {
    /// Scans the ridge strengths of one shape.
    fn new(
        flights: &'a [Flight],
        groups: &Groups,
        shape: Shape,
        options: &FitOptions,
    ) -> Result<Self, ModelError> {
        let tracks = flights
            .iter()
            .map(|flight| Track::new(flight, shape.inputs))
            .collect::<Result<Vec<_>, _>>()?;
        let corner = |(configuration, members): &(Configuration, Vec<usize>)| {
            Corner::new(*configuration, members, &tracks, shape)
        };
        let corners = groups.corners.iter().map(corner).collect::<Result<Vec<_>, _>>()?;
        let validation = CrossValidation {
            corners: &corners,
            tracks: &tracks,
            interior: &groups.interior,
            shape,
        };
        let candidates = scan(&validation, options)?;
        Ok(Self {
            chosen: candidates[safest(&candidates)].clone(),
            shape,
            tracks,
            corners,
            candidates,
        })
    }

    /// Fits what was chosen on everything, refined where that is asked for or helps.
    fn fit(self, groups: &Groups, options: &FitOptions) -> Result<Fitted, ModelError> {
        let Self {
            shape,
            tracks,
            corners,
            mut chosen,
            ..
        } = self;
        let validation = CrossValidation {
            corners: &corners,
            tracks: &tracks,
            interior: &groups.interior,
            shape,
        };
        let ridges = Ridges {
            linear: chosen.linear_ridge,
            height: chosen.height_ridge,
        };
        let mut models = corners
            .par_iter()
            .map(|corner| corner.model(ridges))
            .collect::<Result<Vec<LagModel>, _>>()?;
        let mut refinement = None;
        let try_it = match options.refinement {
            Refinement::Off => false,
            Refinement::On => true,
            // Segments of the flights that were fitted say too little about other flights.
            Refinement::Auto => corners.iter().all(Corner::holds_out_whole_flights),
        };
        if try_it && let Some(refined) = refined(&validation, &models) {
            if options.refinement == Refinement::Auto {
                refinement = validation.try_refinement(ridges, &models, &refined)?;
            }
            chosen.refined = refinement.is_none_or(|trial| trial.worthwhile());
            if chosen.refined {
                models = refined;
            }
        }
        Ok(Fitted {
            bank: assemble(&validation, models, &chosen, options)?,
            standing_still: validation.standing_still(),
            chosen,
            refinement,
        })
    }
}

/// The corners' models refined; `None` if a corner has no window for it, or would become unstable.
fn refined(validation: &CrossValidation, models: &[LagModel]) -> Option<Vec<LagModel>> {
    let refined = |(corner, model): (&Corner, &LagModel)| {
        let refined = refine(
            model,
            validation.shape.positions,
            &corner.stretches(validation.tracks, |_| true),
        )?;
        let radius = Model::Lag(refined.clone())
            .spectral_radius(corner.configuration)
            .ok()?;
        (radius <= UNSTABLE).then_some(refined)
    };
    validation.corners.par_iter().zip(models).map(refined).collect()
}

/// Tries ridge strengths one axis after the other: first the linear rows, with the height row as plain as the
/// structure allows, then the height row.
fn scan(validation: &CrossValidation, options: &FitOptions) -> Result<Vec<Candidate>, ModelError> {
    let strengths = |ridge: Ridge, automatic: &[f64]| match ridge {
        Ridge::Auto => automatic.to_vec(),
        Ridge::Value(value) => vec![value],
    };
    let linear = strengths(options.linear_ridge, &LINEAR_RIDGES);
    let height = strengths(options.height_ridge, &HEIGHT_RIDGES);
    let attempt = |linear: f64, height: Option<f64>| validation.try_candidate(Ridges { linear, height });
    let rows_only = || {
        linear
            .iter()
            .map(|&ridge| attempt(ridge, None))
            .collect::<Result<Vec<_>, _>>()
    };
    if options.structure == Structure::Linear {
        return rows_only();
    }
    let mut candidates = vec![attempt(linear[0], Some(height[0]))?];
    let linear_ridge = if linear.len() == 1 {
        linear[0]
    } else {
        rows_only().map(|tried| tried[safest(&tried)].linear_ridge)?
    };
    for &ridge in &height {
        if linear_ridge != linear[0] || ridge != height[0] {
            candidates.push(attempt(linear_ridge, Some(ridge))?);
        }
    }
    Ok(candidates)
}

/// Puts the models of the corners into a bank, with what is to be said about them.
fn assemble(
    validation: &CrossValidation,
    models: Vec<LagModel>,
    chosen: &Candidate,
    options: &FitOptions,
) -> Result<Bank, ModelError> {
    let entry = |(corner, model): (&Corner, LagModel)| {
        let (configuration, model) = (corner.configuration, Model::Lag(model));
        let members = corner.members(validation.tracks);
        let (height_condition, linear_condition_number) = corner.condition_numbers()?;
        let diagnostics = ModelDiagnostics {
            flights: members.iter().map(|track| track.flight.name.clone()).collect(),
            rows: corner.rows(),
            coefficients: corner.coefficients(),
            condition_number: height_condition.unwrap_or(linear_condition_number),
            linear_condition_number,
            spectral_radius: model.spectral_radius(configuration)?,
            residual_rms: one_step_rmse(&model, &members),
        };
        Ok(BankModel {
            configuration,
            model,
            diagnostics,
        })
    };
    let models = validation
        .corners
        .par_iter()
        .zip(models)
        .map(entry)
        .collect::<Result<_, ModelError>>()?;
    let provenance = BankProvenance {
        tool: concat!("flyvine ", env!("CARGO_PKG_VERSION")).into(),
        inputs: Vec::new(),
        options: options.clone(),
        chosen: Some(chosen.clone()),
        between: None,
    };
    Bank::new(models, provenance)
}

#[cfg(test)]
pub(crate) mod tests;
