//! From flights to a bank.

use super::bank::{
    Bank, BankModel, BankProvenance, LENGTH_TOLERANCE_M, ModelDiagnostics, PRESSURE_TOLERANCE_KPA, same,
};
use super::corner::{Corner, Ridges, Shape};
use super::error::{ModelError, display};
use super::family::Model;
use super::lag::{CommandInputs, LagModel};
use super::one_step::one_step_rmse;
use super::options::{FitOptions, Refinement, Ridge, Structure, VelocityInput};
use super::refine::refine;
use super::selection::{Candidate, CrossValidation, HeldOutError, RefinementTrial, best, safest};
use super::support::Support;
use super::track::{Track, constant_configuration};
use crate::flight::{Configuration, Flight};
use rayon::prelude::*;
use serde::Serialize;

/// Ridge strengths tried on the linear rows.
const LINEAR_RIDGES: [f64; 6] = [0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2];
/// Ridge strengths tried on the quadratic height row.
const HEIGHT_RIDGES: [f64; 8] = [0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0];

/// A spectral radius at rest above this is unstable: a predicted height that keeps its value has exactly 1, and
/// noise moves it a little either way.
const UNSTABLE: f64 = 1.005;
/// Share of diverged windows that is not yet a pattern.
pub(crate) const STRAY_SHARE: f64 = 0.02;

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

/// Something about a fit that the user should know.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "finding")]
pub enum Finding {
    /// Plain least squares in the paper's form does not predict these flights.
    PlainLeastSquaresUnusable {
        /// Its held-out rollout error.
        error: HeldOutError,
        /// The error of predicting that nothing moves.
        standing_still: HeldOutError,
    },
    /// Even the chosen model predicts held-out flights worse than that nothing moves, or diverges on them.
    NotToBeTrusted {
        /// Its held-out rollout error.
        error: HeldOutError,
    },
    /// Linearized at rest the chosen model is unstable.
    Unstable {
        /// Where.
        configuration: Configuration,
        /// Spectral radius of the Jacobian at rest.
        spectral_radius: f64,
    },
    /// No stretch of valid rows is long enough for a held-out 2.5-s rollout: nothing was chosen by rollout error.
    TooShortToCrossCheck,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::PlainLeastSquaresUnusable {
                error,
                standing_still,
            } => write!(
                f,
                "plain least squares in the paper's form does not predict held-out flights: {error}; \
                 predicting that nothing moves: {standing_still}"
            ),
            Self::NotToBeTrusted { error } => {
                write!(
                    f,
                    "the chosen model does not predict held-out flights either: {error}"
                )
            }
            Self::Unstable {
                configuration,
                spectral_radius,
            } => write!(
                f,
                "the model at {} is unstable at rest: spectral radius {spectral_radius:.4}",
                display(configuration)
            ),
            Self::TooShortToCrossCheck => write!(
                f,
                "no flight has 2.5 s of unbroken rows to roll out on: structure and ridge could not be judged"
            ),
        }
    }
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
    let has_velocity = |flight: &Flight| {
        flight
            .samples
            .iter()
            .all(|sample| sample.command_velocity.is_some())
    };
    let inputs: &[CommandInputs] = match options.command_velocity {
        VelocityInput::Off => &[CommandInputs::Position],
        VelocityInput::On => &[CommandInputs::PositionAndVelocity],
        VelocityInput::Auto if flights.iter().all(has_velocity) => {
            &[CommandInputs::Position, CommandInputs::PositionAndVelocity]
        }
        VelocityInput::Auto => &[CommandInputs::Position],
    };
    let groups = group(flights)?;
    let attempts = inputs
        .iter()
        .map(|&inputs| attempt(flights, &groups, inputs, options))
        .collect::<Result<Vec<Attempt>, _>>()?;
    let candidates: Vec<Candidate> = attempts
        .iter()
        .flat_map(|attempt| attempt.candidates.clone())
        .collect();
    let chosen: Vec<Candidate> = attempts.iter().map(|attempt| attempt.chosen.clone()).collect();
    let attempt = attempts
        .into_iter()
        .nth(best(&chosen))
        .expect("an index into the attempts");
    let report = FitReport {
        findings: findings(&attempt, &candidates[0]),
        chosen: attempt.chosen.clone(),
        candidates,
        standing_still: attempt.standing_still,
        refinement: attempt.refinement,
        cross_checked: groups
            .interior
            .iter()
            .map(|&index| flights[index].name.clone())
            .collect(),
    };
    let bank = attempt.bank.with_support(Some(Support::of(flights)))?;
    Ok((bank, report))
}

/// The outcome of one choice of inputs.
struct Attempt {
    candidates: Vec<Candidate>,
    chosen: Candidate,
    refinement: Option<RefinementTrial>,
    standing_still: Option<HeldOutError>,
    bank: Bank,
}

/// Scans the ridge strengths for one choice of inputs and fits the best on everything.
fn attempt(
    flights: &[Flight],
    groups: &Groups,
    inputs: CommandInputs,
    options: &FitOptions,
) -> Result<Attempt, ModelError> {
    let tracks = flights
        .iter()
        .map(|flight| Track::new(flight, inputs))
        .collect::<Result<Vec<_>, _>>()?;
    let shape = Shape {
        structure: options.structure,
        lags: options.lags,
        inputs,
    };
    let corner = |(configuration, members): &(Configuration, Vec<usize>)| {
        Corner::new(*configuration, members, &tracks, shape)
    };
    let corners = groups.corners.iter().map(corner).collect::<Result<Vec<_>, _>>()?;
    let validation = CrossValidation {
        corners: &corners,
        tracks: &tracks,
        interior: &groups.interior,
        inputs,
    };
    let candidates = scan(&validation, options)?;
    let mut chosen = candidates[safest(&candidates)].clone();
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
    let bank = assemble(&validation, models, &chosen, options)?;
    Ok(Attempt {
        chosen,
        standing_still: validation.standing_still(),
        bank,
        candidates,
        refinement,
    })
}

/// The corners' models refined; `None` if a corner has no window for it, or would become unstable.
fn refined(validation: &CrossValidation, models: &[LagModel]) -> Option<Vec<LagModel>> {
    let refined = |(corner, model): (&Corner, &LagModel)| {
        let refined = refine(model, &corner.stretches(validation.tracks, |_| true))?;
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
    };
    Bank::new(models, provenance)
}

/// What the scan and the chosen bank give cause to say.
fn findings(attempt: &Attempt, plain: &Candidate) -> Vec<Finding> {
    let mut findings = Vec::new();
    match (&plain.corners, &attempt.chosen.corners, attempt.standing_still) {
        (Some(plain), Some(chosen), Some(standing_still)) => {
            if unusable(plain, &standing_still) {
                findings.push(Finding::PlainLeastSquaresUnusable {
                    error: *plain,
                    standing_still,
                });
            }
            if unusable(chosen, &standing_still) {
                findings.push(Finding::NotToBeTrusted { error: *chosen });
            }
        }
        _ => findings.push(Finding::TooShortToCrossCheck),
    }
    for BankModel {
        configuration,
        diagnostics,
        ..
    } in attempt.bank.models()
    {
        let spectral_radius = diagnostics.spectral_radius;
        if spectral_radius > UNSTABLE {
            findings.push(Finding::Unstable {
                configuration: *configuration,
                spectral_radius,
            });
        }
    }
    findings
}

/// Worse than predicting that nothing moves, or diverging on more than a stray window.
fn unusable(error: &HeldOutError, standing_still: &HeldOutError) -> bool {
    error.mean_m > standing_still.mean_m || error.diverged_share > STRAY_SHARE
}

/// Flights by their place in the bank, as indices.
pub(crate) struct Groups {
    pub corners: Vec<(Configuration, Vec<usize>)>,
    /// Inside the range, or changing their configuration.
    pub interior: Vec<usize>,
}

/// Finds the corners: the extreme lengths and pressures among the flights of constant configuration.
pub(crate) fn group(flights: &[Flight]) -> Result<Groups, ModelError> {
    let constant: Vec<(usize, Configuration)> = flights
        .iter()
        .enumerate()
        .filter_map(|(index, flight)| {
            constant_configuration(flight).map(|configuration| (index, configuration))
        })
        .collect();
    if constant.is_empty() {
        return Err(ModelError::NoCornerFlights {
            flights: flights.len(),
        });
    }
    let extremes = |value: fn(&Configuration) -> f64, tolerance: f64| {
        let values = || constant.iter().map(|(_, configuration)| value(configuration));
        let (low, high) = (
            values().fold(f64::INFINITY, f64::min),
            values().fold(f64::NEG_INFINITY, f64::max),
        );
        if high - low <= tolerance {
            vec![low]
        } else {
            vec![low, high]
        }
    };
    let mut corners = Vec::new();
    for &pressure_kpa in &extremes(|c| c.pressure_kpa, PRESSURE_TOLERANCE_KPA) {
        for &length_m in &extremes(|c| c.length_m, LENGTH_TOLERANCE_M) {
            let corner = Configuration {
                length_m,
                pressure_kpa,
            };
            let members: Vec<usize> = constant
                .iter()
                .filter(|(_, c)| same(c, &corner))
                .map(|(index, _)| *index)
                .collect();
            if members.is_empty() {
                return Err(ModelError::MissingCorner { missing: corner });
            }
            corners.push((corner, members));
        }
    }
    let fitted: Vec<usize> = corners.iter().flat_map(|(_, members)| members.clone()).collect();
    let interior = (0..flights.len())
        .filter(|index| !fitted.contains(index))
        .collect();
    Ok(Groups { corners, interior })
}

/// Refuses one recording given twice.
pub(crate) fn refuse_duplicates(flights: &[Flight]) -> Result<(), ModelError> {
    for (index, second) in flights.iter().enumerate() {
        if let Some(first) = flights[..index]
            .iter()
            .find(|first| first.samples == second.samples)
        {
            return Err(ModelError::DuplicateFlight {
                first: first.name.clone(),
                second: second.name.clone(),
            });
        }
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::lag::{HEIGHT_ROW, QuadraticTerms, STATE_LEN};
    use super::super::rollout::advance;
    use super::*;
    use crate::flight::{Pose, Sample};
    use crate::trajopt::Dynamics;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    pub(crate) const ES: Configuration = Configuration {
        length_m: 0.7,
        pressure_kpa: 0.0,
    };
    pub(crate) const EL: Configuration = Configuration {
        length_m: 1.0,
        pressure_kpa: 0.0,
    };

    /// A stable system of the paper's structure: every signal is damped and driven by the command and its
    /// neighbour; the height row has an offset and a few products.
    pub(crate) fn system() -> LagModel {
        let p = 30;
        let mut linear = vec![0.0; STATE_LEN * p];
        for row in 0..STATE_LEN {
            linear[row * p + row] = 0.9;
            linear[row * p + 9 + row] = -0.25;
            linear[row * p + 18 + (row + 1) % 9] = 0.05;
            linear[row * p + 27 + row % 3] = 0.1;
        }
        let mut upper_triangle = vec![0.0; 465];
        for (index, a) in upper_triangle.iter_mut().enumerate() {
            *a = if index % 7 == 0 {
                0.01 * (index as f64).sin()
            } else {
                0.0
            };
        }
        let mut offset = vec![0.0; STATE_LEN];
        offset[HEIGHT_ROW] = 0.2;
        let quadratic = [QuadraticTerms {
            row: HEIGHT_ROW,
            upper_triangle,
        }];
        LagModel::new(3, CommandInputs::Position, offset, linear, &quadratic).unwrap()
    }

    fn sample(row: usize, configuration: Configuration, command: [f64; 3], x: &[f64]) -> Sample {
        Sample {
            t_s: row as f64 * crate::DT,
            configuration,
            command,
            command_velocity: None,
            quadrotor: Some(Pose {
                position: [x[0], x[1], x[2]],
                attitude: [1.0, x[3], x[4], x[5]],
            }),
            end_effector: Some([x[6], x[7], x[8]]),
        }
    }

    /// Random steps of the command through [`system`], with `noise` on what is measured.
    pub(crate) fn flight(
        name: &str,
        configuration: Configuration,
        rows: usize,
        seed: u64,
        noise: f64,
    ) -> Flight {
        let model = system();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut state = vec![0.0; 27];
        let mut samples = Vec::with_capacity(rows);
        for row in 0..rows {
            let command = std::array::from_fn(|_| random.random_range(-1.0..1.0));
            let mut measured = |value: f64| value + noise * random.random_range(-1.0..1.0);
            let x: [f64; STATE_LEN] = std::array::from_fn(|signal| measured(state[signal]));
            samples.push(sample(row, configuration, command, &x));
            let mut fresh = [0.0; STATE_LEN];
            model.step(row, &state, &command, &mut fresh);
            advance(&mut state, &fresh);
        }
        Flight {
            name: name.into(),
            samples,
        }
    }

    /// Every five rows: three random states, what [`system`] makes of them, and a wild row whose tip hygiene
    /// has rejected.
    fn scattered(transitions: usize, seed: u64) -> Flight {
        let model = system();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut samples = Vec::new();
        for _ in 0..transitions {
            let z: Vec<f64> = (0..27).map(|_| random.random_range(-1.0..1.0)).collect();
            let command = std::array::from_fn(|_| random.random_range(-1.0..1.0));
            let mut next = [0.0; STATE_LEN];
            model.step(0, &z, &command, &mut next);
            for x in [&z[18..], &z[9..18], &z[..9], &next, &[1e3; 9]] {
                let row = samples.len();
                samples.push(sample(row, ES, command, x));
            }
            samples.last_mut().unwrap().end_effector = None;
        }
        Flight {
            name: "scattered".into(),
            samples,
        }
    }

    fn plain() -> FitOptions {
        FitOptions {
            height_ridge: Ridge::Value(0.0),
            linear_ridge: Ridge::Value(0.0),
            refinement: Refinement::Off,
            ..FitOptions::default()
        }
    }

    #[test]
    fn plain_least_squares_recovers_the_system_from_valid_rows_only() {
        let (bank, report) = fit_bank(&[scattered(700, 1)], &plain()).unwrap();
        let Model::Lag(fitted) = &bank.models()[0].model else {
            panic!("a lag model");
        };
        let system = system();
        let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(far(&fitted.linear(), &system.linear()) < 1e-10);
        assert!(far(fitted.offset(), system.offset()) < 1e-10);
        let (terms, expected) = (&fitted.quadratic()[0], &system.quadratic()[0]);
        assert!(far(&terms.upper_triangle, &expected.upper_triangle) < 1e-10);
        assert_eq!(report.findings, [Finding::TooShortToCrossCheck]);
        let diagnostics = &bank.models()[0].diagnostics;
        assert_eq!((diagnostics.rows, diagnostics.coefficients), (700, 496));
    }

    #[test]
    fn the_same_bits_whatever_the_number_of_threads() {
        let mut flights: Vec<Flight> = (0..3).map(|seed| flight("f", ES, 320, seed, 1e-3)).collect();
        flights.extend((3..6).map(|seed| flight("g", EL, 320, seed, 1e-3)));
        let fit = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| fit_bank(&flights, &FitOptions::default()).unwrap())
        };
        assert_eq!(fit(1), fit(3));
    }

    #[test]
    fn what_cannot_be_fitted_is_said() {
        let fail =
            |flights: &[Flight], options: &FitOptions| fit_bank(flights, options).unwrap_err().to_string();
        let short = [flight("f", ES, 300, 1, 0.0)];
        let message = fail(&short, &plain());
        assert!(
            message.contains("297 usable rows in 1 flights for 496 coefficients"),
            "{message}"
        );
        assert!(fail(&[], &plain()).contains("0 flights"));
        let twice = [flight("a", ES, 300, 1, 0.0), flight("b", ES, 300, 1, 0.0)];
        assert!(fail(&twice, &plain()).contains("flights a and b hold the same samples"));
        let mut deploying = flight("d", ES, 300, 1, 0.0);
        deploying.samples[299].configuration = EL;
        assert!(fail(&[deploying], &plain()).contains("no flight with a constant configuration"));
        let velocity = FitOptions {
            command_velocity: VelocityInput::On,
            ..plain()
        };
        assert!(fail(&short, &velocity).contains("flight f: no commanded velocity in row 0"));
        let negative = FitOptions {
            height_ridge: Ridge::Value(-1.0),
            ..plain()
        };
        assert!(fail(&short, &negative).contains("height_ridge: found -1"));
        let empty = Flight {
            name: "empty".into(),
            samples: Vec::new(),
        };
        assert!(fail(&[short[0].clone(), empty], &plain()).contains("flight empty: no rows"));
        let diagonal = Configuration {
            length_m: 1.0,
            pressure_kpa: 0.4,
        };
        let apart = [flight("f", ES, 300, 1, 0.0), flight("g", diagonal, 300, 2, 0.0)];
        assert!(fail(&apart, &plain()).contains("no model at configuration"));
    }

    #[test]
    fn options_refuse_unknown_keys() {
        assert!(toml::from_str::<FitOptions>("lagz = 4").is_err());
        let options: FitOptions = toml::from_str("lags = 4\nheight_ridge = { value = 0.1 }").unwrap();
        assert_eq!((options.lags, options.height_ridge), (4, Ridge::Value(0.1)));
    }
}
