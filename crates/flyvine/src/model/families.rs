//! Which family of models to plan with: the one that predicts held-out flights better.
//!
//! Every corner's flights are split: models of each family are fitted on the larger part and predict the rest (and
//! the flights at interior or changing configurations) over whole rollouts. The better family is then fitted on
//! everything, and again without every other part of the flights in turn, so that each flight is held out once: what
//! these models missed becomes the bank's band of confidence.

use super::band::PredictionBand;
use super::bank::Bank;
use super::check;
use super::error::ModelError;
use super::findings::STRAY_SHARE;
use super::fit::{FitReport, fit_bank};
use super::groups::{Groups, group, refuse_duplicates};
use super::options::FitOptions;
use super::physical::{FitProgress, PhysicalFitOptions};
use super::physical_bank::{PhysicalFitReport, fit_physical_bank, refit_physical_bank};
use super::rollout::WindowError;
use super::selection::{self, HeldOutError, mean_m, pool};
use crate::flight::{Configuration, Flight};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// With this many flights at every corner, whole flights are held out, each third one; with fewer, the last
/// third of every flight.
const WHOLE_FLIGHTS: usize = 3;

/// A family of models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// Polynomial in lagged states and commands (the paper's).
    Lag,
    /// Reduced-order physics.
    Physical,
}

impl std::fmt::Display for Family {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Family::Lag => "lag",
            Family::Physical => "physical",
        })
    }
}

/// Options of [`fit_families`].
#[derive(Debug, Clone, PartialEq)]
pub struct FamilyOptions {
    /// Families to try; the best of them is kept.
    pub families: Vec<Family>,
    /// Options of the lag family.
    pub lag: FitOptions,
    /// Options of the physical family.
    pub physical: PhysicalFitOptions,
}

/// How one family did on flights that it was not fitted on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FamilyTrial {
    /// Which.
    pub family: Family,
    /// On the corners' held-out flights; `None` if no window fits them, or the fit failed.
    pub corners: Option<HeldOutError>,
    /// On interior and deploying flights, through the interpolation; `None` without such windows.
    pub interior: Option<HeldOutError>,
    /// Why there is no model of this family.
    pub failure: Option<String>,
}

/// What was tried and chosen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FamiliesReport {
    /// One per family, in the order of the options.
    pub trials: Vec<FamilyTrial>,
    /// Names of the flights that judged; with few flights, the last third of each.
    pub held_out: Vec<String>,
    /// Families whose fit on all flights does not follow these very flights: more than a stray rollout diverges.
    /// The one that was kept is among them only if no other could be fitted.
    pub diverging: Vec<Family>,
    /// The fit that was kept.
    pub chosen: Chosen,
}

/// The fit that was kept, on all flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "family", rename_all = "snake_case")]
#[allow(clippy::large_enum_variant)] // one per fit
pub enum Chosen {
    /// The lag family.
    Lag(FitReport),
    /// The physical family.
    Physical(PhysicalFitReport),
}

/// Where [`fit_families`] is.
#[derive(Debug, Clone, Copy)]
pub enum FamilyProgress<'a> {
    /// A family is about to be fitted without the held-out flights.
    Trying(Family),
    /// A fit of the physical family, and the configuration that it is at (`None`: all of them).
    Physical(Option<Configuration>, FitProgress),
    /// A family was tried.
    Tried(&'a FamilyTrial),
    /// A family was chosen and is about to be fitted on everything.
    Chosen(Family),
    /// The chosen family is about to be fitted without another third of the flights, for its band of confidence.
    Band(Family),
}

impl Chosen {
    /// The family.
    pub fn family(&self) -> Family {
        match self {
            Chosen::Lag(_) => Family::Lag,
            Chosen::Physical(_) => Family::Physical,
        }
    }
}

impl FamilyTrial {
    /// What is minimized, m: the mean of both errors.
    pub fn score_m(&self) -> Option<f64> {
        mean_m(self.corners, self.interior)
    }
}

/// Tries the families on held-out flights, fits the best on everything, and measures its band of confidence. A family
/// whose rollouts diverge on the very flights that it was fitted on gives way to the next.
///
/// # Errors
/// No family; what the only family that was asked for, or every one of them, has to say against the flights
/// ([`fit_bank`], [`fit_physical_bank`]).
pub fn fit_families(
    flights: &[Flight],
    options: &FamilyOptions,
    progress: &mut dyn FnMut(FamilyProgress),
) -> Result<(Bank, FamiliesReport), ModelError> {
    options.lag.validate()?;
    refuse_duplicates(flights)?;
    let groups = group(flights)?;
    let mut folds = folds(flights, &groups).into_iter();
    let (kept, held_out) = folds.next().expect("a fold");
    let interior: Vec<Flight> = groups
        .interior
        .iter()
        .map(|&index| flights[index].clone())
        .collect();
    let mut candidates = Vec::new();
    let mut trials = Vec::new();
    for &family in &options.families {
        progress(FamilyProgress::Trying(family));
        let mut trial = FamilyTrial {
            family,
            corners: None,
            interior: None,
            failure: None,
        };
        let mut candidate = Candidate {
            family,
            start: None,
            windows: Vec::new(),
            score_m: f64::INFINITY,
        };
        match fit_one(family, &kept, None, options, progress)
            .and_then(|(bank, _)| Ok((judge(&bank, &held_out, &interior)?, bank)))
        {
            Ok((judged, bank)) => {
                (trial.corners, trial.interior) = (judged.corners, judged.interior);
                candidate.score_m = trial.score_m().unwrap_or(f64::INFINITY);
                (candidate.start, candidate.windows) = (Some(bank), judged.windows);
            }
            Err(error) => {
                trial.failure = Some(error.to_string());
            }
        }
        candidates.push(candidate);
        progress(FamilyProgress::Tried(&trial));
        trials.push(trial);
    }
    // The best in its trial first; those that could not be tried, for want of flights, last.
    candidates
        .sort_by(|a, b| (a.score_m.total_cmp(&b.score_m)).then(a.start.is_none().cmp(&b.start.is_none())));
    let mut refused = None; // what all flights lack says more than what the kept ones did
    let (mut fitted, mut diverging) = (None, Vec::new());
    for candidate in candidates {
        progress(FamilyProgress::Chosen(candidate.family));
        match fit_one(
            candidate.family,
            flights,
            candidate.start.as_ref(),
            options,
            progress,
        ) {
            Ok((bank, chosen)) => {
                let followed = judge(&bank, flights, &[])?.corners;
                let follows = followed.is_none_or(|error| error.diverged_share <= STRAY_SHARE);
                if follows || fitted.is_none() {
                    fitted = Some((bank, chosen, candidate.windows));
                }
                if follows {
                    break;
                }
                diverging.push(candidate.family);
            }
            Err(error) => {
                refused.get_or_insert(error);
            }
        }
    }
    if let Some((bank, chosen, windows)) = fitted {
        let judges: Vec<String> = names(held_out.iter().chain(&interior));
        let trial = (windows, judges.clone());
        let band = band(&bank, chosen.family(), trial, folds, options, progress)?;
        let bank = bank.with_band(band)?;
        let report = FamiliesReport {
            trials,
            held_out: judges,
            diverging,
            chosen,
        };
        return Ok((bank, report));
    }
    Err(refused.unwrap_or(ModelError::Unsupported {
        what: "families to try",
        found: "none".into(),
        expected: "lag, physical, or both".into(),
    }))
}

/// The band of the windows that the trial left and of those of models fitted again, beginning with `bank`, without the
/// flights that each of the `others` holds out. `judges` are the names of the trial's flights.
fn band(
    bank: &Bank,
    family: Family,
    (mut windows, mut judges): (Vec<Vec<WindowError>>, Vec<String>),
    others: impl Iterator<Item = (Vec<Flight>, Vec<Flight>)>,
    options: &FamilyOptions,
    progress: &mut dyn FnMut(FamilyProgress),
) -> Result<Option<PredictionBand>, ModelError> {
    if windows.is_empty() {
        return Ok(None); // too few flights for the trial
    }
    for (kept, held_out) in others {
        progress(FamilyProgress::Band(family));
        // What is left may be too little to fit: then these flights do not judge.
        if let Ok((without, _)) = fit_one(family, &kept, Some(bank), options, progress) {
            extend(&mut windows, judge(&without, &held_out, &[])?.windows);
            judges.extend(names(&held_out));
        }
    }
    Ok(PredictionBand::of_windows(&check::HORIZONS, &windows, judges))
}

fn names<'a>(flights: impl IntoIterator<Item = &'a Flight>) -> Vec<String> {
    flights.into_iter().map(|flight| flight.name.clone()).collect()
}

/// A family, and what its trial left.
struct Candidate {
    family: Family,
    /// Its models of the kept flights.
    start: Option<Bank>,
    /// Its windows on the held-out and interior flights, per horizon; none if there was no trial.
    windows: Vec<Vec<WindowError>>,
    /// Infinite where there was nothing to judge by.
    score_m: f64,
}

/// Fits one family; the physical one begins with `start` where there is one.
fn fit_one(
    family: Family,
    flights: &[Flight],
    start: Option<&Bank>,
    options: &FamilyOptions,
    progress: &mut dyn FnMut(FamilyProgress),
) -> Result<(Bank, Chosen), ModelError> {
    let mut simulating = |configuration, at| progress(FamilyProgress::Physical(configuration, at));
    Ok(match (family, start) {
        (Family::Lag, _) => {
            let (bank, report) = fit_bank(flights, &options.lag)?;
            (bank, Chosen::Lag(report))
        }
        (Family::Physical, None) => {
            let (bank, report) = fit_physical_bank(flights, &options.physical, &mut simulating)?;
            (bank, Chosen::Physical(report))
        }
        (Family::Physical, Some(start)) => {
            let (bank, report) = refit_physical_bank(start, flights, &options.physical, &mut simulating)?;
            (bank, Chosen::Physical(report))
        }
    })
}

/// What a bank's predictions of held-out flights were like.
struct Judged {
    corners: Option<HeldOutError>,
    interior: Option<HeldOutError>,
    /// Of all flights, per horizon.
    windows: Vec<Vec<WindowError>>,
}

fn judge(bank: &Bank, held_out: &[Flight], interior: &[Flight]) -> Result<Judged, ModelError> {
    let windows = |flights: &[Flight]| check::windows(bank, flights.par_iter(), &check::HORIZONS);
    let (held_out_windows, interior_windows) = (windows(held_out)?, windows(interior)?);
    let mut all = vec![Vec::new(); check::HORIZONS.len()];
    for own in held_out_windows.iter().chain(&interior_windows) {
        extend(&mut all, own.clone());
    }
    Ok(Judged {
        corners: pool(&at_selection_horizons(held_out_windows)),
        interior: pool(&at_selection_horizons(interior_windows)),
        windows: all,
    })
}

/// Adds windows per horizon.
fn extend(all: &mut [Vec<WindowError>], more: Vec<Vec<WindowError>>) {
    for (all, more) in all.iter_mut().zip(more) {
        all.extend(more);
    }
}

/// Of windows at [`check::HORIZONS`], those at [`selection::HORIZONS`], which are among them.
fn at_selection_horizons(flights: Vec<Vec<Vec<WindowError>>>) -> Vec<Vec<Vec<WindowError>>> {
    let chosen = |windows: Vec<Vec<WindowError>>| {
        check::HORIZONS
            .iter()
            .zip(windows)
            .filter(|(horizon, _)| selection::HORIZONS.contains(horizon))
            .map(|(_, windows)| windows)
            .collect()
    };
    flights.into_iter().map(chosen).collect()
}

/// The corners' flights, without and with only what is held out: every third flight of a corner, the third, the second and
/// the first of each three in turn; or once the last third of every flight, where flights are few. Interior flights are in
/// neither.
fn folds(flights: &[Flight], groups: &Groups) -> Vec<(Vec<Flight>, Vec<Flight>)> {
    let whole = groups
        .corners
        .iter()
        .all(|(_, members)| members.len() >= WHOLE_FLIGHTS);
    let members = || {
        groups
            .corners
            .iter()
            .flat_map(|(_, members)| members.iter().enumerate())
    };
    if !whole {
        let cut = members().map(|(_, &index)| {
            let (mut first, mut last) = (flights[index].clone(), flights[index].clone());
            last.samples = first.samples.split_off(first.samples.len() * 2 / 3);
            (first, last)
        });
        return vec![cut.unzip()];
    }
    let fold = |remainder: usize| {
        let of = |held_out: bool| {
            members()
                .filter(|(place, _)| (place % WHOLE_FLIGHTS == remainder) == held_out)
                .map(|(_, &index)| flights[index].clone())
                .collect()
        };
        (of(false), of(true))
    };
    (0..WHOLE_FLIGHTS).rev().map(fold).collect()
}

#[cfg(test)]
mod tests {
    use super::super::physical::Parameters;
    use super::super::physical::synthetic::{random_commands, simulate_flight};
    use super::*;

    fn flights(count: u64, rows: usize) -> Vec<Flight> {
        (1..=count)
            .map(|seed| {
                let commands = random_commands(rows, seed);
                let name = format!("flight {seed}");
                simulate_flight(&name, &Parameters::defaults(), 0.8, &commands, 3e-4, seed).0
            })
            .collect()
    }

    fn options(families: &[Family]) -> FamilyOptions {
        FamilyOptions {
            families: families.to_vec(),
            lag: FitOptions::default(),
            physical: PhysicalFitOptions {
                max_iterations: 2,
                ..PhysicalFitOptions::default()
            },
        }
    }

    #[test]
    fn the_better_family_is_chosen_and_its_band_holds_on_other_flights() {
        let flights = flights(4, 450);
        let both = options(&[Family::Lag, Family::Physical]);
        let (bank, report) = fit_families(&flights[..3], &both, &mut |_| {}).unwrap();
        assert!(
            matches!(report.chosen, Chosen::Physical(_)),
            "{:?}",
            report.trials
        );
        assert_eq!(report.held_out, ["flight 3"]);
        let scores: Vec<f64> = report
            .trials
            .iter()
            .map(|trial| trial.score_m().unwrap())
            .collect();
        assert!(scores[1] < scores[0]);
        let checked = check(&bank, &flights[3..]).unwrap();
        let within = checked.pooled[0].error.within_band.unwrap();
        assert!(within > 0.8, "{within} at 0.5 s");
    }

    #[test]
    fn few_flights_are_cut_and_the_only_family_speaks_for_itself() {
        let flights = flights(1, 200);
        let (_, report) = fit_families(&flights, &options(&[Family::Physical]), &mut |_| {}).unwrap();
        assert!(report.trials[0].corners.is_some());
        // Too short for the paper's structure: auto takes physics, the lag family alone says why not.
        let both = options(&[Family::Lag, Family::Physical]);
        let (_, report) = fit_families(&flights, &both, &mut |_| {}).unwrap();
        assert!(report.trials[0].failure.as_ref().unwrap().contains("usable rows"));
        assert!(matches!(report.chosen, Chosen::Physical(_)));
        let error = fit_families(&flights, &options(&[Family::Lag]), &mut |_| {}).unwrap_err();
        assert!(matches!(error, ModelError::TooFewRows { .. }));
    }
}
