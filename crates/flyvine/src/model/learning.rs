//! Learning by flying: a physical model, refitted to recordings and to flights of the task that it plans.
//!
//! One flight says much about what it did and little about anything else, and a model fitted to it alone plans the
//! next one worse. So every refit sees all recordings, the task's flights weighted, within a trust region about the
//! parameters so far; and how much a flight may weigh is decided on recordings that are held out: of several weights
//! the greatest one whose trial predicts them no worse than without the flight.
//!
//! What the model still misses, however it is fitted, comes again in the next flight of the task: by how much the end
//! effector was off the model's own motion is known knot by knot, and the next plan makes up for it. A flight's noise is
//! in there, too, and another motion is missed otherwise: so the best flight is kept, and after one that was worse the
//! next correction goes half as far from the best flight's own as the one before did.

use super::bank::{Bank, BankModel, ModelDiagnostics};
use super::check::predict;
use super::error::ModelError;
use super::families::Family;
use super::physical::{PhysicalFitOptions, offset};
use super::physical_bank::refit_physical_bank;
use super::rollout::advance;
use super::selection::{HORIZONS, HeldOutError, pool};
use super::track::constant_configuration;
use crate::flight::{Configuration, Flight};
use crate::trajopt::Dynamics;
use serde::Serialize;

/// Weights that are tried for the task's flights, the greatest first.
const WEIGHTS: [f64; 4] = [30.0, 10.0, 3.0, 1.0];
/// Held-out recordings predicted worse than before by more than this factor: that weight is too great.
const NO_WORSE: f64 = 1.05;
/// Each third recording is held out from the trials.
const HELD_OUT: usize = 3;
/// Radius of the trust region of one refit, in standard deviations of the priors.
const TRUST_RADIUS: f64 = 0.5;
/// No knot's correction changes by more than this at once, m: farther away the next motion is another one.
const LARGEST_STEP_M: f64 = 0.15;

/// What was known before, and what was flown since.
#[derive(Debug, Clone)]
pub struct Learner {
    bank: Bank,
    recordings: Vec<Flight>,
    flown: Vec<Flight>,
    /// Weight of the flights that were flown, as last accepted.
    weight: f64,
    /// What the next plan makes up for (rows × 3), m.
    model_error_m: Vec<[f64; 3]>,
    best: Option<Best>,
}

/// The best flight so far.
#[derive(Debug, Clone)]
struct Best {
    /// Its place among the flights of the task.
    number: usize,
    miss_m: f64,
    /// What its plan made up for, m; empty: nothing.
    planned_with: Vec<[f64; 3]>,
    /// Which part of the way to what was then seen the next correction goes.
    share: f64,
}

/// One weight that was tried.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WeightTrial {
    /// The weight of the task's flights.
    pub weight: f64,
    /// Error on held-out recordings; `None` if no window fits them.
    pub held_out: Option<HeldOutError>,
}

/// What one flight taught.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lesson {
    /// Held-out error of a trial without the new flight; `None` without recordings to hold out.
    pub before: Option<HeldOutError>,
    /// The weights that were tried, in order; the last one was accepted, unless none was.
    pub trials: Vec<WeightTrial>,
    /// The weight that was accepted; `None`: the model stays as it was.
    pub accepted: Option<f64>,
}

impl Learner {
    /// Begins with `bank`'s model at `configuration` and, of `recordings`, those that were flown there.
    ///
    /// # Errors
    /// The bank is of the lag family, or does not cover the configuration.
    pub fn new(bank: &Bank, configuration: Configuration, recordings: &[Flight]) -> Result<Self, ModelError> {
        if bank.family() != Family::Physical {
            return Err(ModelError::Unsupported {
                what: "bank to learn with",
                found: "the lag family".into(),
                expected: "the physical family (`fit --family physical`)".into(),
            });
        }
        let model = BankModel {
            configuration,
            model: bank.at(configuration)?,
            diagnostics: ModelDiagnostics::default(),
        };
        let here = |flight: &&Flight| {
            constant_configuration(flight).is_some_and(|found| super::bank::same(&found, &configuration))
        };
        Ok(Learner {
            bank: Bank::new(vec![model], bank.provenance().clone())?
                .with_band(bank.band().cloned())?
                .with_noise(bank.noise().copied())?
                .with_support(bank.support().copied())?,
            recordings: recordings.iter().filter(here).cloned().collect(),
            flown: Vec::new(),
            weight: 0.0,
            model_error_m: Vec::new(),
            best: None,
        })
    }

    /// The model to plan with.
    pub fn bank(&self) -> &Bank {
        &self.bank
    }

    /// By how much the end effector is expected to be off the model, row by row, m; empty before the first flight. For
    /// [`crate::task::make_corrected_plan`].
    pub fn model_error_m(&self) -> &[[f64; 3]] {
        &self.model_error_m
    }

    /// Number of recordings that are fitted beside the task's flights.
    pub fn recordings(&self) -> usize {
        self.recordings.len()
    }

    /// Takes in a flight of the task, planned on [`Self::bank`] with [`Self::model_error_m`], that missed what the task asks
    /// for by `miss_m` (m; whatever measures that, for the flights are compared by it alone).
    ///
    /// # Errors
    /// The flight cannot be simulated, or was flown at another configuration ([`super::fit_physical_bank`]).
    pub fn learn(&mut self, flight: Flight, miss_m: f64) -> Result<Lesson, ModelError> {
        let (held_out, kept): (Vec<_>, Vec<_>) = self
            .recordings
            .iter()
            .cloned()
            .enumerate()
            .partition(|(place, _)| place % HELD_OUT == HELD_OUT - 1);
        let held_out: Vec<Flight> = held_out.into_iter().map(|(_, flight)| flight).collect();
        let kept: Vec<Flight> = kept.into_iter().map(|(_, flight)| flight).collect();
        let mut flown = self.flown.clone();
        let without = if held_out.is_empty() {
            None
        } else {
            error(&refit(&self.bank, &kept, &flown, self.weight)?, &held_out)?
        };
        flown.push(flight);
        let mut lesson = Lesson {
            before: without,
            trials: Vec::new(),
            accepted: None,
        };
        for weight in WEIGHTS {
            let trial = match without {
                None => None,
                Some(_) => error(&refit(&self.bank, &kept, &flown, weight)?, &held_out)?,
            };
            lesson.trials.push(WeightTrial {
                weight,
                held_out: trial,
            });
            let no_worse = match (without, trial) {
                (Some(before), Some(after)) => after.mean_m <= NO_WORSE * before.mean_m,
                (before, _) => before.is_none(),
            };
            if no_worse {
                lesson.accepted = Some(weight);
                break;
            }
        }
        if let Some(weight) = lesson.accepted {
            self.bank = refit(&self.bank, &self.recordings, &flown, weight)?;
            self.weight = weight;
        }
        self.flown = flown;
        self.correct(miss_m)?;
        Ok(lesson)
    }

    /// Chooses the next correction, after a flight that missed by `miss_m`.
    fn correct(&mut self, miss_m: f64) -> Result<(), ModelError> {
        let best = match self.best.take() {
            Some(best) if miss_m.is_nan() || miss_m >= best.miss_m => Best {
                share: best.share / 2.0,
                ..best
            },
            _ => Best {
                number: self.flown.len() - 1,
                miss_m,
                planned_with: std::mem::take(&mut self.model_error_m),
                share: 1.0,
            },
        };
        let mut next = simulation_error(&self.bank, &self.flown[best.number])?;
        for (row, seen) in next.iter_mut().enumerate() {
            let before = best.planned_with.get(row).copied().unwrap_or_default();
            let step = [0, 1, 2].map(|axis| best.share * (seen[axis] - before[axis]));
            let length = step.iter().map(|s| s * s).sum::<f64>().sqrt();
            let kept = (LARGEST_STEP_M / length).min(1.0);
            *seen = std::array::from_fn(|axis| before[axis] + kept * step[axis]);
        }
        self.model_error_m = next;
        self.best = Some(best);
        Ok(())
    }
}

/// The model fitted to recordings and, weighted, the task's flights, near where it was.
fn refit(bank: &Bank, recordings: &[Flight], flown: &[Flight], weight: f64) -> Result<Bank, ModelError> {
    let options = PhysicalFitOptions {
        weights: flown.iter().map(|flight| (flight.name.clone(), weight)).collect(),
        trust_radius: Some(TRUST_RADIUS),
        ..PhysicalFitOptions::default()
    };
    let flights: Vec<Flight> = recordings.iter().chain(flown).cloned().collect();
    refit_physical_bank(bank, &flights, &options, &mut |_, _| {})?
        .0
        .with_band(bank.band().cloned())?
        .with_noise(bank.noise().copied())
}

/// By how much the end effector was off the simulation of `flight`, from rest, in every row, m. Where it was not seen, as
/// far as in the row before.
fn simulation_error(bank: &Bank, flight: &Flight) -> Result<Vec<[f64; 3]>, ModelError> {
    let Some(first) = flight.samples.first() else {
        return Ok(Vec::new());
    };
    let model = bank.at(first.configuration)?;
    let mut state = model.rest_state(first.configuration);
    let mut fresh = vec![0.0; model.fresh_len()];
    let mut error = [0.0; 3];
    let mut errors = Vec::with_capacity(flight.samples.len());
    for (row, sample) in flight.samples.iter().enumerate() {
        if let Some(tip) = sample.end_effector {
            error = std::array::from_fn(|axis| tip[axis] - state[offset::TIP + axis]);
        }
        errors.push(error);
        model.step(row, &state, &sample.command, &mut fresh);
        advance(&mut state, &fresh);
    }
    Ok(errors)
}

fn error(bank: &Bank, flights: &[Flight]) -> Result<Option<HeldOutError>, ModelError> {
    let windows = flights
        .iter()
        .map(|flight| Ok(predict(bank, flight)?.windows(&HORIZONS)))
        .collect::<Result<Vec<_>, ModelError>>()?;
    Ok(pool(&windows))
}

#[cfg(test)]
mod tests {
    use super::super::bank::BankProvenance;
    use super::super::family::Model;
    use super::super::physical::synthetic::{random_commands, simulate_flight};
    use super::super::physical::{ArmLength, Parameters, PhysicalModel};
    use super::*;
    use crate::model::check;

    const HERE: Configuration = Configuration {
        length_m: 0.8,
        pressure_kpa: 0.0,
    };

    fn flight(vehicle: &Parameters<f64>, seed: u64, rows: usize) -> Flight {
        let (commands, name) = (random_commands(rows, seed), format!("flight {seed}"));
        simulate_flight(&name, vehicle, 0.8, &commands, 3e-4, seed).0
    }

    fn bank() -> Bank {
        let model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.8)).unwrap();
        let model = BankModel {
            configuration: HERE,
            model: Model::Physical(Box::new(model)),
            diagnostics: ModelDiagnostics::default(),
        };
        Bank::new(vec![model], BankProvenance::default()).unwrap()
    }

    /// Median error at 2.5 s, m.
    fn error_on(bank: &Bank, flight: &Flight) -> f64 {
        check(bank, std::slice::from_ref(flight)).unwrap().flights[0].rollout[2]
            .median_m
            .unwrap()
    }

    #[test]
    fn flights_of_a_vehicle_that_is_not_as_it_was_are_learnt_from() {
        let vehicle = Parameters {
            velocity_gain_xy: 2.2,
            tip_mass: 0.25,
            ..Parameters::defaults()
        };
        let mut learner = Learner::new(&bank(), HERE, &[]).unwrap();
        let unseen = flight(&vehicle, 9, 200);
        let before = error_on(learner.bank(), &unseen);
        let lesson = learner.learn(flight(&vehicle, 1, 80), 0.05).unwrap();
        assert!(lesson.accepted.is_some() && lesson.before.is_none());
        let after = error_on(learner.bank(), &unseen);
        assert!(after < 0.5 * before, "{before} m, then {after} m");

        // What is left is known knot by knot: a marker that slipped is seen in every row.
        let mut slipped = flight(&vehicle, 1, 80);
        slipped.name = "slipped".into();
        for sample in &mut slipped.samples[40..] {
            sample.end_effector = sample.end_effector.map(|[x, y, z]| [x, y, z + 0.1]);
        }
        let error = simulation_error(learner.bank(), &slipped).unwrap();
        let own = learner.model_error_m();
        assert_eq!((own.len(), error[39]), (80, own[39]));
        assert!(own.iter().flatten().all(|error| error.abs() < 0.02), "{own:?}");
        assert!((error[60][2] - own[60][2] - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_flight_that_contradicts_the_held_out_recordings_is_not_followed() {
        let vehicle = Parameters::defaults();
        let recordings: Vec<Flight> = (1..=3).map(|seed| flight(&vehicle, seed, 260)).collect();
        let mut learner = Learner::new(&bank(), HERE, &recordings).unwrap();
        // As if the tip marker had slipped by 15 cm, and the vehicle were another.
        let other = Parameters {
            position_gain_xy: 2.5,
            velocity_gain_xy: 4.0,
            ..vehicle
        };
        let mut wrong = flight(&other, 8, 80);
        for sample in &mut wrong.samples {
            sample.end_effector = sample.end_effector.map(|[x, y, z]| [x, y, z + 0.15]);
        }
        let lesson = learner.learn(wrong, 0.1).unwrap();
        assert_eq!(lesson.accepted, None, "{lesson:?}");
        assert_eq!(
            *learner.bank(),
            Learner::new(&bank(), HERE, &recordings).unwrap().bank
        );
    }
    #[test]
    fn after_a_worse_flight_the_correction_goes_back_half_way() {
        let mut learner = Learner::new(&bank(), HERE, &[]).unwrap();
        // The height that is made up for in the middle, after a flight whose marker had slipped by that much.
        let mut corrected = |slipped: f64, miss_m: f64| {
            let mut flight = flight(&Parameters::defaults(), 5, 80);
            for sample in &mut flight.samples {
                sample.end_effector = sample.end_effector.map(|[x, y, z]| [x, y, z + slipped]);
            }
            learner.flown.push(flight);
            learner.correct(miss_m).unwrap();
            learner.model_error_m()[50][2]
        };
        let first = corrected(0.4, 0.3);
        assert!(first > 0.9 * LARGEST_STEP_M && first <= LARGEST_STEP_M, "{first}");
        let second = corrected(0.23, 0.02);
        assert!((second - 0.23).abs() < 0.02, "{second}");
        // Worse than the second: half-way between what that one was planned with and what it showed. And again.
        for (share, miss_m) in [(0.5, 0.2), (0.25, f64::NAN)] {
            let height = corrected(0.1, miss_m);
            assert!(
                (height - first - share * (second - first)).abs() < 1e-9,
                "{height}"
            );
        }
    }
}
