//! A small correction on top of the physical family, kept only if it predicts held-out flights better.

use super::bank::{Bank, BankModel};
use super::check;
use super::error::ModelError;
use super::family::Model;
use super::groups::Groups;
use super::physical::{CorrectionEquations, PhysicalFitOptions};
use super::selection::{HORIZONS, HeldOutError, WORTHWHILE, mean_m, pool};
use crate::flight::Flight;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How much a term of the correction may add to a velocity in one knot, m/s: what is tried.
const DEVIATIONS_M_S: [f64; 4] = [1e-4, 3e-4, 1e-3, 3e-3];

/// Rollout errors on flights that were held out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOutErrors {
    /// On the corners' flights.
    pub corners: HeldOutError,
    /// On flights that are never fitted: at interior configurations, or with one that changes.
    pub interior: Option<HeldOutError>,
}

impl HeldOutErrors {
    /// What is minimized, m: the mean of both.
    pub fn mean_m(&self) -> f64 {
        mean_m(Some(self.corners), self.interior).unwrap_or(self.corners.mean_m)
    }
}

/// What the best correction did on held-out flights.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorrectionTrial {
    /// Physics alone.
    pub plain: HeldOutErrors,
    /// Every flight with the correction that its corner's other flights gave.
    pub corrected: HeldOutErrors,
    /// How much a term was allowed to add to a velocity in one knot, m/s.
    pub deviation_m_s: f64,
}

impl CorrectionTrial {
    /// Whether corrected models predict so much better that they are worth it.
    pub fn worthwhile(&self) -> bool {
        self.corrected.mean_m() < WORTHWHILE * self.plain.mean_m()
    }
}

/// Corrects the physical models of `bank`, which were fitted to the corners' flights, if that predicts held-out flights
/// better. No trial where no flight can be held out.
///
/// # Errors
/// As [`super::check()`].
pub(super) fn correct(
    bank: Bank,
    flights: &[Flight],
    groups: &Groups,
    options: &PhysicalFitOptions,
) -> Result<(Bank, Option<CorrectionTrial>), ModelError> {
    let candidates = Candidates::new(&bank, flights, groups, options)?;
    let Some(plain) = candidates.errors(None)? else {
        return Ok((bank, None));
    };
    let mut best: Option<CorrectionTrial> = None;
    for deviation_m_s in DEVIATIONS_M_S {
        let Some(corrected) = candidates.errors(Some(deviation_m_s))? else {
            continue;
        };
        if best.is_none_or(|best| corrected.mean_m() < best.corrected.mean_m()) {
            best = Some(CorrectionTrial {
                plain,
                corrected,
                deviation_m_s,
            });
        }
    }
    let corrected = best
        .filter(CorrectionTrial::worthwhile)
        .map(|trial| candidates.bank(None, Some(trial.deviation_m_s)));
    Ok((corrected.unwrap_or(bank), best))
}

/// A bank, and the equations of the corrections that each of its flights asks for.
struct Candidates<'a> {
    plain: &'a Bank,
    flights: &'a [Flight],
    groups: &'a Groups,
    /// Per corner and flight.
    equations: Vec<Vec<CorrectionEquations>>,
}

impl<'a> Candidates<'a> {
    fn new(
        plain: &'a Bank,
        flights: &'a [Flight],
        groups: &'a Groups,
        options: &PhysicalFitOptions,
    ) -> Result<Self, ModelError> {
        let corner = |((_, members), model): (&(_, Vec<usize>), &BankModel)| {
            let Model::Physical(model) = &model.model else {
                unreachable!("a bank of the physical family");
            };
            members
                .par_iter()
                .map(|&member| CorrectionEquations::new(model, &flights[member], options))
                .collect()
        };
        // Corners and models are both in the order of pressures, then lengths.
        let corners = groups.corners.iter().zip(plain.models());
        Ok(Self {
            equations: corners.map(corner).collect::<Result<_, _>>()?,
            plain,
            flights,
            groups,
        })
    }

    /// The bank with corrections that may be as large as `deviation_m_s`, or without any; of every corner, the flight
    /// number `held_out` does not count.
    fn bank(&self, held_out: Option<usize>, deviation_m_s: Option<f64>) -> Bank {
        self.plain.map_physical(|corner, model| {
            let counted: Vec<&CorrectionEquations> = self.equations[corner]
                .iter()
                .enumerate()
                .filter(|(number, _)| Some(*number) != held_out)
                .map(|(_, equations)| equations)
                .collect();
            model.correction =
                deviation_m_s.and_then(|deviation| CorrectionEquations::solve(&counted, deviation));
        })
    }

    /// `None` if no flight can be held out.
    fn errors(&self, deviation_m_s: Option<f64>) -> Result<Option<HeldOutErrors>, ModelError> {
        let windows = |bank: &Bank, members: &[usize]| {
            check::windows(
                bank,
                members.par_iter().map(|&member| &self.flights[member]),
                &HORIZONS,
            )
        };
        let corners = &self.groups.corners;
        let folds = corners
            .iter()
            .map(|(_, members)| members.len())
            .max()
            .unwrap_or(0);
        let mut held_out_windows = Vec::new();
        for fold in 0..folds {
            let others = |members: &&Vec<usize>| members.len() > 1;
            let held_out = corners.iter().map(|(_, members)| members).filter(others);
            let members: Vec<usize> = held_out
                .filter_map(|members| members.get(fold).copied())
                .collect();
            held_out_windows.extend(windows(&self.bank(Some(fold), deviation_m_s), &members)?);
        }
        let interior = windows(&self.bank(None, deviation_m_s), &self.groups.interior)?;
        Ok(pool(&held_out_windows).map(|corners| HeldOutErrors {
            corners,
            interior: pool(&interior),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::super::physical::synthetic::{random_commands, simulate_model};
    use super::super::physical::{ArmLength, Correction, Parameters, PhysicalModel};
    use super::super::physical_bank::{fit_physical_bank, refit_physical_bank};
    use super::*;

    /// A vehicle whose tip a force pushes sideways, across its swing, if it is `swirled`: physics has no such thing.
    fn vehicle(swirled: bool) -> PhysicalModel {
        let model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.8)).unwrap();
        PhysicalModel {
            correction: swirled.then(|| Correction::across_swing(0.03)),
            ..model
        }
    }

    fn fitted(swirled: bool) -> (Bank, CorrectionTrial, Vec<Flight>) {
        let flight = |seed: u64| {
            let commands = random_commands(240, seed);
            simulate_model(
                &format!("flight {seed}"),
                &vehicle(swirled),
                &commands,
                3e-4,
                seed,
            )
            .0
        };
        let flights: Vec<Flight> = (1..5).map(flight).collect();
        let options = PhysicalFitOptions {
            max_iterations: 4,
            correction: true,
            ..PhysicalFitOptions::default()
        };
        let (bank, report) = fit_physical_bank(&flights, &options, &mut |_, _| {}).unwrap();
        let trial = report.correction.expect("flights that can be held out");
        (bank, trial, flights)
    }

    #[test]
    fn a_force_that_physics_lacks_is_corrected() {
        let (bank, trial, flights) = fitted(true);
        assert!(bank.is_corrected());
        assert!(trial.corrected.mean_m() < 0.5 * trial.plain.mean_m(), "{trial:?}");
        let plain = bank.map_physical(|_, model| model.correction = None);
        let commands = random_commands(240, 9);
        let flight = [simulate_model("another", &vehicle(true), &commands, 3e-4, 9).0];
        let error_m = |bank: &Bank| {
            check(bank, &flight).unwrap().flights[0].rollout[2]
                .median_m
                .unwrap()
        };
        assert!(error_m(&bank) < 0.5 * error_m(&plain));

        let text = serde_json::to_string(&bank).unwrap();
        assert!(
            serde_json::from_str::<Bank>(&text).unwrap() == bank,
            "a file keeps it"
        );
        let options = PhysicalFitOptions {
            max_iterations: 1,
            ..PhysicalFitOptions::default()
        };
        let (again, _) = refit_physical_bank(&bank, &flights, &options, &mut |_, _| {}).unwrap();
        assert!(again.is_corrected(), "a refit tries it again");
    }

    #[test]
    fn physics_that_explains_the_flights_is_left_alone() {
        let (bank, trial, _) = fitted(false);
        assert!(!trial.worthwhile(), "{trial:?}");
        assert!(!bank.is_corrected());
    }
}
