//! Noise levels from flights: those under which the filter foresees the recorded poses best.
//!
//! At each configuration of a bank, maximized is the likelihood of the innovations ν with variances s that the filter
//! itself expects,
//!
//! ```text
//! ln L = −½ Σ (ν² / s + ln s)
//! ```
//!
//! by trying each level a factor up and down while that helps. What is looked for is how well the models predict and
//! motion capture measures. How strong the world's pushes are, calm flights do not say, and recorded commands arrive
//! when the model says: those levels stay as they are typical of the family.
//!
//! Of the configurations the greatest level counts, and none is less than what is typical: a filter that trusts its
//! model too much is slow to find out better, and under feedback has been seen to shake the vehicle out of the room; one
//! that trusts it too little is only a little noisier.

use super::innovations::GATE;
use super::{Estimator, EstimatorError};
use crate::flight::{Configuration, Flight, Sample};
use crate::link::Observation;
use crate::model::{Bank, ModelError, NoiseLevels, ScheduledModel, same};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rows at a flight's start that do not count: the filter is still finding the state.
const SETTLING_ROWS: usize = 40;
/// Factors tried, one after the other, each until no level gains by it.
const FACTORS: [f64; 2] = [4.0, 2.0];
/// A level moves only for at least so much log-likelihood per row: less says nothing.
const LEAST_GAIN_PER_ROW: f64 = 1e-3;
/// Rows that are looked at of a configuration, from the beginning of each of its flights.
const ROWS: usize = 1200;
/// Rows that are looked at of a flight at least.
const ROWS_OF_FLIGHT: usize = 200;

/// What the flights of one configuration say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConfigurationNoise {
    /// The configuration.
    pub configuration: Configuration,
    /// Its levels.
    pub levels: NoiseLevels,
    /// Mean log-likelihood per row with typical levels …
    pub before: f64,
    /// … and with these.
    pub after: f64,
    /// Mean ν² / s per entry: 1 if the filter knows how well it foresees.
    pub consistency: f64,
    /// Rows that counted.
    pub rows: usize,
}

/// What a fit of noise levels found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NoiseReport {
    /// The levels for the whole bank.
    pub levels: NoiseLevels,
    /// Those of its configurations.
    pub configurations: Vec<ConfigurationNoise>,
}

/// Flights from which no noise levels can be found.
#[derive(Debug, thiserror::Error)]
pub enum NoiseError {
    /// The bank's models cannot be scheduled.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The bank's models cannot be estimated.
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    /// No flight at the bank's configurations has enough rows.
    #[error("found no flight of more than {expected} rows at the bank's configurations")]
    TooShort {
        /// Rows that a flight must have more of.
        expected: usize,
    },
}

/// A level that is looked for.
struct Level {
    of: fn(&mut NoiseLevels) -> &mut f64,
    /// Largest factor up from what is typical.
    reach: f64,
}

const LEVELS: [Level; 5] = [
    Level {
        of: |noise| &mut noise.process.quadrotor_m,
        reach: 100.0,
    },
    Level {
        of: |noise| &mut noise.process.attitude,
        reach: 100.0,
    },
    Level {
        of: |noise| &mut noise.process.end_effector_m,
        reach: 100.0,
    },
    // Motion capture is known to within so much.
    Level {
        of: |noise| &mut noise.measured.quadrotor_m,
        reach: 2.0,
    },
    Level {
        of: |noise| &mut noise.measured.end_effector_m,
        reach: 2.0,
    },
];

struct Recorded<'a> {
    model: &'a ScheduledModel,
    rows: &'a [Sample],
}

#[derive(Clone, Copy, Default)]
struct Likelihood {
    log: f64,
    squares: f64,
    entries: f64,
    rows: usize,
}

/// Finds the noise levels of `bank`'s models from the `flights` at their configurations. `progress` hears the
/// configuration after each improvement.
///
/// # Errors
/// Models that cannot be estimated; no flight, or only short ones, at the bank's configurations.
pub fn identify_noise(
    bank: &Bank,
    flights: &[Flight],
    progress: &mut dyn FnMut(Configuration),
) -> Result<NoiseReport, NoiseError> {
    let mut configurations = Vec::new();
    for model in bank.models() {
        let here: Vec<&Flight> = flights
            .iter()
            .filter(|flight| {
                let stays = |row: &Sample| same(&row.configuration, &model.configuration);
                flight.samples.len() > 2 * SETTLING_ROWS && flight.samples.iter().all(stays)
            })
            .collect();
        if !here.is_empty() {
            let model = bank
                .scheduled(&[model.configuration])?
                .with_feedforward(bank.feedforward());
            configurations.push(identify(&model, &here, progress)?);
        }
    }
    let Some(first) = configurations.first() else {
        return Err(NoiseError::TooShort {
            expected: 2 * SETTLING_ROWS,
        });
    };
    let mut levels = first.levels;
    for Level { of, .. } in LEVELS {
        for other in &configurations {
            let level = *of(&mut other.levels.clone());
            *of(&mut levels) = of(&mut levels).max(level);
        }
    }
    Ok(NoiseReport {
        levels,
        configurations,
    })
}

fn identify(
    model: &ScheduledModel,
    flights: &[&Flight],
    progress: &mut dyn FnMut(Configuration),
) -> Result<ConfigurationNoise, NoiseError> {
    let configuration = flights[0].samples[0].configuration;
    let rows = (ROWS / flights.len()).max(ROWS_OF_FLIGHT);
    let recorded: Vec<Recorded> = flights
        .iter()
        .map(|flight| Recorded {
            model,
            rows: &flight.samples[..rows.min(flight.samples.len())],
        })
        .collect();
    let typical = *model.noise();
    let first = total(&recorded, &typical)?;
    let least_gain = LEAST_GAIN_PER_ROW * first.rows as f64;
    let (mut levels, mut best) = (typical, first);
    for factor in FACTORS {
        let mut gained = true;
        while gained {
            gained = false;
            for Level { of, reach } in LEVELS {
                let origin = *of(&mut typical.clone());
                for change in [factor, 1.0 / factor] {
                    loop {
                        let mut tried = levels;
                        *of(&mut tried) *= change;
                        if !(origin..=origin * reach).contains(of(&mut tried)) {
                            break;
                        }
                        let likelihood = total(&recorded, &tried)?;
                        let wins = likelihood.log > best.log + least_gain;
                        if !wins {
                            break;
                        }
                        (levels, best, gained) = (tried, likelihood, true);
                        progress(configuration);
                    }
                }
            }
        }
    }
    Ok(ConfigurationNoise {
        configuration,
        levels,
        before: first.log / first.rows as f64,
        after: best.log / best.rows as f64,
        consistency: best.squares / best.entries,
        rows: best.rows,
    })
}

fn total(recorded: &[Recorded], noise: &NoiseLevels) -> Result<Likelihood, EstimatorError> {
    let each: Vec<Likelihood> = recorded
        .par_iter()
        .map(|recorded| recorded.likelihood(noise))
        .collect::<Result<_, _>>()?;
    // Joined in order: the same bits whatever the number of threads.
    Ok(each.iter().fold(Likelihood::default(), |sum, one| Likelihood {
        log: sum.log + one.log,
        squares: sum.squares + one.squares,
        entries: sum.entries + one.entries,
        rows: sum.rows + one.rows,
    }))
}

impl Recorded<'_> {
    fn likelihood(&self, noise: &NoiseLevels) -> Result<Likelihood, EstimatorError> {
        let rows = self.rows;
        let first = rows.iter().find_map(|row| row.quadrotor);
        let position = first.map_or(rows[0].command, |pose| pose.position);
        let start = self.model.rest_state_at(rows[0].configuration, position);
        let mut estimator = Estimator::new(self.model, noise, &start, rows[0].command)?;
        let seen = |row: &Sample| Observation {
            t_s: row.t_s,
            quadrotor: row.quadrotor,
            end_effector: row.end_effector,
        };
        estimator.correct(&seen(&rows[0]));
        let mut sum = Likelihood::default();
        for knot in 1..rows.len() {
            estimator.predict(knot - 1, rows[knot - 1].command);
            estimator.correct(&seen(&rows[knot]));
            if knot < SETTLING_ROWS {
                continue;
            }
            let surprise = estimator.surprise();
            sum.log -= 0.5 * (surprise.squares + surprise.log_variances);
            // Entries refused are as surprising as the gate allows.
            sum.log -= 0.5 * GATE.powi(2) * f64::from(surprise.refused);
            sum.squares += surprise.squares;
            sum.entries += f64::from(surprise.entries);
            sum.rows += usize::from(surprise.entries > 0);
        }
        Ok(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Pose;
    use crate::model::{BankModel, BankProvenance, CommandInputs, LagModel, Model, ModelDiagnostics};
    use crate::trajopt::Dynamics;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const CONFIGURATION: Configuration = Configuration {
        length_m: 0.7,
        pressure_kpa: 0.0,
    };

    /// The quadrotor follows the command, the tip the quadrotor.
    fn bank() -> Bank {
        let (mut linear, mut offset) = (vec![0.0; 9 * 12], vec![0.0; 9]);
        for axis in 0..3 {
            linear[axis * 12 + axis] = 0.8;
            linear[axis * 12 + 9 + axis] = 0.2;
            linear[(3 + axis) * 12 + 3 + axis] = 0.5;
            linear[(6 + axis) * 12 + axis] = 0.3;
            linear[(6 + axis) * 12 + 6 + axis] = 0.7;
        }
        offset[8] = -0.3 * CONFIGURATION.length_m;
        let model = LagModel::new(1, CommandInputs::Position, offset, linear, &[]).unwrap();
        let model = BankModel {
            configuration: CONFIGURATION,
            model: Model::Lag(model),
            diagnostics: ModelDiagnostics::default(),
        };
        Bank::new(vec![model], BankProvenance::default()).unwrap()
    }

    /// The bank's own motion, with process noise of these levels on quadrotor and tip and 1 mm on what is measured.
    fn flight(bank: &Bank, process: [f64; 2], seed: u64) -> Flight {
        let model = bank.at(CONFIGURATION).unwrap();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = |level: f64| -> f64 {
            let sample: f64 = StandardNormal.sample(&mut random);
            level * sample
        };
        let mut x = model.rest_state(CONFIGURATION);
        let mut fresh = vec![0.0; 9];
        let samples = (0..600).map(|row| {
            let phase = 0.1 * row as f64;
            let command = [phase.sin(), (0.7 * phase).cos() - 1.0, 1.5];
            let mut seen: [f64; 9] = std::array::from_fn(|i| x[i]);
            for value in &mut seen {
                *value += normal(1e-3);
            }
            let vector = [seen[3], seen[4], seen[5]];
            let scalar = (1.0 - vector.iter().map(|v| v * v).sum::<f64>()).sqrt();
            model.step(0, &x, &command, &mut fresh);
            x.copy_from_slice(&fresh);
            for (i, entry) in x.iter_mut().enumerate() {
                *entry += normal([process[0], 4e-3, process[1]][i / 3]);
            }
            Sample {
                t_s: row as f64 * crate::DT,
                configuration: CONFIGURATION,
                command,
                command_velocity: None,
                quadrotor: Some(Pose {
                    position: [seen[0], seen[1], seen[2]],
                    attitude: [scalar, vector[0], vector[1], vector[2]],
                }),
                end_effector: Some([seen[6], seen[7], seen[8]]),
            }
        });
        Flight {
            name: "made".into(),
            samples: samples.collect(),
        }
    }

    #[test]
    fn the_levels_that_made_the_flights_are_found() {
        let bank = bank();
        for process in [[3e-3, 1e-2], [1e-2, 3e-3]] {
            let flights = [flight(&bank, process, 1), flight(&bank, process, 2)];
            let report = identify_noise(&bank, &flights, &mut |_| ()).unwrap();
            let found = report.levels.process;
            for (found, made) in [found.quadrotor_m, found.end_effector_m].into_iter().zip(process) {
                // As near as the factors go, and a little for the disturbances, which explain a part.
                assert!((0.4..2.0).contains(&(found / made)), "{found} for {made}");
            }
            let here = &report.configurations[0];
            assert!(here.after > here.before);
            assert!((0.8..1.2).contains(&here.consistency), "{}", here.consistency);
        }
    }

    #[test]
    fn without_a_flight_at_a_configuration_of_the_bank_nothing_is_found() {
        let bank = bank();
        let mut short = flight(&bank, [1e-3; 2], 1);
        short.samples.truncate(30);
        let mut elsewhere = flight(&bank, [1e-3; 2], 1);
        elsewhere.samples[7].configuration.length_m = 0.8;
        for flights in [vec![], vec![short], vec![elsewhere]] {
            let error = identify_noise(&bank, &flights, &mut |_| ()).unwrap_err();
            assert!(matches!(error, NoiseError::TooShort { .. }), "{error}");
        }
    }
}
