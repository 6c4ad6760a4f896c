//! Training flights: commands that show a model what the paper's tasks will ask of it.
//!
//! The paper flew hand-made commands "that varied in speed and had position commands that were distributed
//! across the primary working space" (Sec. III-A). Fast swings are where data and models fail first, so one
//! flight is a dozen swings as violent as the swing task's own.

use std::f64::consts::TAU;

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::path;
use crate::{DT, HOVER_HEIGHT_M};

/// Commands of one training flight.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingFlight {
    /// What it flies.
    pub name: &'static str,
    /// Commanded quadrotor position every [`DT`] seconds, m.
    pub commands: Vec<[f64; 3]>,
}

impl TrainingFlight {
    /// The same flight for a vehicle that is sent the velocities of its commands, too: averaged twice over 0.85 s, to either
    /// side. A velocity loop that is fed a step's velocity asks for more than any vehicle can do, and what comes of it teaches
    /// nothing; smoothed so, swings accelerate by up to 4 m/s², as the vehicle does after their steps alone.
    pub fn smoothed(mut self) -> Self {
        for _ in 0..2 {
            self.commands = averaged(&self.commands);
        }
        self
    }
}

/// The mean of the commands up to [`AVERAGED_KNOTS`] to either side; those before the first are like it, those behind the last
/// too.
fn averaged(commands: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let last = commands.len() as isize - 1;
    let mean = |knot: isize, axis: usize| {
        let window = knot - AVERAGED_KNOTS..=knot + AVERAGED_KNOTS;
        let sum: f64 = window.map(|k| commands[k.clamp(0, last) as usize][axis]).sum();
        sum / (2 * AVERAGED_KNOTS + 1) as f64
    };
    (0..=last)
        .map(|knot| std::array::from_fn(|axis| mean(knot, axis)))
        .collect()
}

/// Half the width of the averages in [`TrainingFlight::smoothed`].
const AVERAGED_KNOTS: isize = 8;

/// The training flights for one configuration: deterministic for a seed, inside |x|, |y| ≤ 1.5 m and
/// 1.2 m ≤ z ≤ 1.85 m.
pub fn training_flights(seed: u64) -> Vec<TrainingFlight> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    vec![
        TrainingFlight {
            name: "lemniscate_12s_to_4s",
            commands: shrinking_lemniscate(1.0, 12.0, 4.0),
        },
        // The arm swings wide of a fast quadrotor, so that fast plans command about half the amplitude.
        TrainingFlight {
            name: "small_lemniscate_7s_to_4s",
            commands: shrinking_lemniscate(0.6, 7.0, 4.0),
        },
        TrainingFlight {
            name: "swings",
            commands: swings(&mut random),
        },
        TrainingFlight {
            name: "pretzel",
            commands: pretzel(),
        },
        TrainingFlight {
            name: "rising_rose",
            commands: rising_rose(),
        },
    ]
}

/// A flight to judge models with: swings and steps that no training flight contains.
pub fn test_flight(seed: u64) -> TrainingFlight {
    // Training takes the stream 0 of a seed; the test flight another one of the same seed.
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(1);
    let mut commands = swings(&mut random);
    commands.extend(random_steps(&mut random));
    TrainingFlight {
        name: "test_mixed",
        commands,
    }
}

/// `f(t)` every DT over `duration_s`.
fn sample(duration_s: f64, f: impl Fn(f64) -> [f64; 3]) -> Vec<[f64; 3]> {
    (0..(duration_s / DT).round() as usize)
        .map(|k| f(k as f64 * DT))
        .collect()
}

/// Grows from 0 to 1 over the first two seconds, so that a flight starts at rest.
fn fade_in(t_s: f64) -> f64 {
    (t_s / 2.0).min(1.0)
}

/// A lemniscate of the given x amplitude (m) whose period shrinks linearly over 60 s.
fn shrinking_lemniscate(amplitude: f64, from_s: f64, to_s: f64) -> Vec<[f64; 3]> {
    const DURATION_S: f64 = 60.0;
    let period = |t: f64| from_s + (to_s - from_s) * t / DURATION_S;
    let mut phase = 0.0_f64;
    (0..(DURATION_S / DT) as usize)
        .map(|k| {
            let (sine, cosine) = phase.sin_cos();
            phase += TAU * DT / period(k as f64 * DT);
            [amplitude * sine, amplitude * cosine * sine, HOVER_HEIGHT_M]
        })
        .collect()
}

/// Twelve back-and-forth trapezoids of x, y or both, from gentle to as violent as the swing task, each
/// followed by rest.
fn swings(random: &mut impl Rng) -> Vec<[f64; 3]> {
    let mut commands = vec![[0.0, 0.0, HOVER_HEIGHT_M]; 20];
    for swing in 0..12 {
        let back = -(0.4 + 0.7 * random.random::<f64>());
        let forth = 0.5 + 0.7 * random.random::<f64>();
        let (ramp_s, hold_s) = (
            0.15 + 0.45 * random.random::<f64>(),
            0.2 + 0.3 * random.random::<f64>(),
        );
        let height = 0.1 * (2.0 * random.random::<f64>() - 1.0);
        let angle: f64 = match swing % 4 {
            3 => TAU / 4.0,                            // along y
            2 => 0.4 * (random.random::<f64>() - 0.5), // nearly along x
            _ => 0.0,
        };
        let times = [0.0, ramp_s, hold_s, 2.0 * ramp_s, hold_s, 2.0 * ramp_s];
        let values = [0.0, back, back, forth, forth, 0.0];
        let mut t = 0.0;
        let profile: Vec<[f64; 2]> = times
            .iter()
            .zip(values)
            .map(|(dt, value)| {
                t += dt;
                [t, value]
            })
            .collect();
        commands.extend(sample(t + 1.6, |t_s| {
            let x = path::linear(&profile, t_s);
            let z = HOVER_HEIGHT_M + height * (x.abs() / 1.5).min(1.0);
            [x * angle.cos(), x * angle.sin(), z]
        }));
    }
    commands
}

/// A three-lobed path that fills the working space at varying speed.
fn pretzel() -> Vec<[f64; 3]> {
    sample(50.0, |t| {
        let phi = 0.6 * t + 1.5 * (0.15 * t).sin();
        let amplitude = fade_in(t);
        [
            1.3 * amplitude * (phi).sin() * (0.4 * phi).cos(),
            1.2 * amplitude * (1.5 * phi).sin(),
            HOVER_HEIGHT_M + 0.08 * amplitude * (0.7 * phi).sin(),
        ]
    })
}

/// Steps to random places every 0.6 to 2 s.
fn random_steps(random: &mut impl Rng) -> Vec<[f64; 3]> {
    let mut commands = vec![[0.0, 0.0, HOVER_HEIGHT_M]; 20];
    while commands.len() < (45.0 / DT) as usize {
        let mut uniform = |half: f64| half * (2.0 * random.random::<f64>() - 1.0);
        let place = [uniform(0.6), uniform(0.6), HOVER_HEIGHT_M + uniform(0.15)];
        let hold = 12 + (14.0 * (1.0 + uniform(1.0))) as usize;
        commands.extend(std::iter::repeat_n(place, hold));
    }
    commands
}

/// A rose whose height climbs and falls, as a deployment's does.
fn rising_rose() -> Vec<[f64; 3]> {
    sample(50.0, |t| {
        let phi = 0.9 * t;
        let radius = 1.1 * fade_in(t) * (0.6 * phi).cos();
        [
            radius * phi.cos() - 1.1 * fade_in(t) * (1.0 - fade_in(t)),
            radius * phi.sin(),
            HOVER_HEIGHT_M + 0.17 * (1.0 - (TAU * t / 25.0).cos()),
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn training_stays_in_its_box_and_repeats_for_a_seed() {
        let flights = training_flights(3);
        assert_eq!(flights, training_flights(3));
        assert_ne!(flights, training_flights(4));
        assert!(
            flights
                .iter()
                .all(|flight| flight.commands != test_flight(3).commands)
        );
        for flight in flights.into_iter().chain([test_flight(3)]) {
            let smooth = flight.clone().smoothed();
            assert_eq!(
                (smooth.commands.len(), smooth.name),
                (flight.commands.len(), flight.name)
            );
            let second = smooth.commands.windows(3).flat_map(|u| {
                [0, 1, 2].map(|axis| (u[2][axis] - 2.0 * u[1][axis] + u[0][axis]).abs() / DT.powi(2))
            });
            let largest = second.fold(0.0, f64::max);
            assert!(largest < 4.5, "{}: {largest} m/s²", flight.name);
            assert!(
                (30.0..120.0).contains(&(flight.commands.len() as f64 * DT)),
                "{}",
                flight.name
            );
            for [x, y, z] in flight.commands {
                assert!(
                    x.abs() <= 1.5 && y.abs() <= 1.5 && (1.2..=1.85).contains(&z),
                    "{}: {x} {y} {z}",
                    flight.name
                );
            }
        }
    }
}
