//! The next training flight: commands whose simulation says most about what is not yet known.
//!
//! To first order, a flight with output sensitivities S adds `F = Σ_rows Sᵀ W S` to the inverse posterior covariance
//! P⁻¹ of the parameters, and its information gain is `½ ln det(I + P F)`, in nats (D-optimality; Goodwin & Payne
//! 1977, Ch. 6). The flight is built block by block: of several random continuations that stay in the room, and from
//! which a return to its middle does too, the one that gains most.

use super::error::PhysicalError;
use super::fit::PhysicalFitOptions;
use super::model::PhysicalModel;
use super::parameters::{PARAMETER_COUNT, Parameters};
use super::scalar::Dual;
use super::state::{OUTPUT_LEN, State};
use super::step::step;
use super::vector::Vector;
use crate::model::support::{arm_angle, tilt};
use crate::{DT, HOVER_HEIGHT_M};
use nalgebra::{SMatrix, SVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

type Matrix = SMatrix<f64, PARAMETER_COUNT, PARAMETER_COUNT>;
type Sensitive = State<Dual>;

/// Rows of a block, and of the return to the middle that must be possible after it.
const BLOCK_ROWS: usize = 60;
const RETURN_ROWS: usize = 60;
/// Rows of hover at the start, and of return at the end.
const HOVER_ROWS: usize = 20;
/// The tip stays this far below the quadrotor, m: out of the rotors.
const BELOW_M: f64 = 0.2;

/// Where a designed flight may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Room {
    /// Largest |x| and |y| of quadrotor and tip, m.
    pub horizontal_m: f64,
    /// Lowest and highest quadrotor, m.
    pub height_m: [f64; 2],
    /// Lowest tip, m.
    pub tip_height_m: f64,
    /// Largest tilt of the quadrotor, rad.
    pub tilt: f64,
    /// Largest angle of the arm from below the quadrotor, rad.
    pub arm_angle: f64,
}

impl Default for Room {
    /// 0.4 m inside the room in which flights are supervised, for the model is not perfect yet, and no livelier than swings:
    /// what is most informative by a model of calm flights is far beyond where that model holds, and then no model of the
    /// family follows it.
    fn default() -> Self {
        Room {
            horizontal_m: 1.8,
            height_m: [1.2, 2.0],
            tip_height_m: 0.25,
            tilt: 0.45,
            arm_angle: 0.7,
        }
    }
}

/// Designs a flight of `duration_s` at the model's arm, with `candidates` continuations per block.
/// Deterministic for a seed, whatever the number of threads.
///
/// # Errors
/// A model without covariance; no room for a hover; a duration that is too short.
pub fn design_flight(
    model: &PhysicalModel,
    duration_s: f64,
    room: Room,
    candidates: usize,
    seed: u64,
) -> Result<Vec<[f64; 3]>, PhysicalError> {
    let rows = (duration_s / DT).round() as usize;
    let shortest = 2 * HOVER_ROWS + BLOCK_ROWS + RETURN_ROWS;
    if !duration_s.is_finite() || rows < shortest {
        return Err(PhysicalError::Shape {
            what: "rows of the flight to design",
            found: rows,
            expected: shortest,
        });
    }
    let middle = [0.0, 0.0, HOVER_HEIGHT_M];
    let start = Sensitive::rest(&model.parameters.variables(), model.arm.length_m, middle);
    if !inside(&start, room) {
        return Err(PhysicalError::NoRoom {
            length_m: model.arm.length_m,
        });
    }
    let mut known = inverse_covariance(model)?;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut commands = vec![middle; HOVER_ROWS];
    let mut state = fly(model, start, &commands, room)
        .ok_or(PhysicalError::Diverged)?
        .0;
    while commands.len() + BLOCK_ROWS + RETURN_ROWS <= rows {
        let blocks: Vec<Vec<[f64; 3]>> = (0..candidates).map(|_| block(&mut random, room)).collect();
        let tried: Vec<Option<(f64, Sensitive, Matrix)>> = blocks
            .par_iter()
            .map(|block| {
                let (after, gained) = fly(model, state, block, room)?;
                returns(&model.parameters, model, &after, room).then_some(())?;
                Some((log_determinant(known + gained)?, after, gained))
            })
            .collect();
        let best = (0..candidates).filter(|&i| tried[i].is_some()).max_by(|&a, &b| {
            let gain = |i: usize| tried[i].as_ref().map_or(f64::NEG_INFINITY, |tried| tried.0);
            gain(a).total_cmp(&gain(b))
        });
        // Where nothing else stays in the room, home.
        let chosen = best.map_or_else(|| vec![middle; BLOCK_ROWS], |i| blocks[i].clone());
        let (after, gained) = match best.and_then(|i| tried[i].as_ref()) {
            Some((_, after, gained)) => (*after, *gained),
            None => fly(model, state, &chosen, room).ok_or(PhysicalError::Diverged)?,
        };
        (state, known) = (after, known + gained);
        commands.extend(chosen);
    }
    commands.resize(rows, middle);
    Ok(commands)
}

/// Information gain of flying `commands` from hover, nats.
///
/// # Errors
/// A model without covariance, or a simulation that does not stay finite.
pub fn information_gain(model: &PhysicalModel, commands: &[[f64; 3]]) -> Result<f64, PhysicalError> {
    let first = *commands.first().ok_or(PhysicalError::NoFlights)?;
    let known = inverse_covariance(model)?;
    let start = Sensitive::rest(&model.parameters.variables(), model.arm.length_m, first);
    let anywhere = Room {
        horizontal_m: f64::INFINITY,
        height_m: [f64::NEG_INFINITY, f64::INFINITY],
        tip_height_m: f64::NEG_INFINITY,
        tilt: PI,
        arm_angle: PI,
    };
    let (_, gained) = fly(model, start, commands, anywhere).ok_or(PhysicalError::Diverged)?;
    let logarithms = (log_determinant(known + gained), log_determinant(known));
    match logarithms {
        (Some(after), Some(before)) => Ok(0.5 * (after - before)),
        _ => Err(PhysicalError::Diverged),
    }
}

fn inverse_covariance(model: &PhysicalModel) -> Result<Matrix, PhysicalError> {
    if model.covariance.len() != PARAMETER_COUNT {
        return Err(PhysicalError::NoCovariance);
    }
    let covariance = Matrix::from_fn(|i, j| model.covariance[i][j]);
    Ok(covariance
        .cholesky()
        .ok_or(PhysicalError::NoCovariance)?
        .inverse())
}

fn log_determinant(matrix: Matrix) -> Option<f64> {
    let factor = matrix.cholesky()?;
    Some(2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>())
}

/// The state after `commands` and the information on the way; `None` if it leaves the room.
fn fly(
    model: &PhysicalModel,
    start: Sensitive,
    commands: &[[f64; 3]],
    room: Room,
) -> Option<(Sensitive, Matrix)> {
    let options = model
        .fit
        .as_ref()
        .map_or_else(PhysicalFitOptions::default, |fit| fit.options.clone());
    let weights: [f64; OUTPUT_LEN] = std::array::from_fn(|entry| {
        let sigma = if (3..6).contains(&entry) {
            options.attitude_sigma
        } else {
            options.position_sigma_m
        };
        1.0 / (sigma * sigma * options.correlated_rows)
    });
    let parameters = model.parameters.variables();
    let (mut state, mut gained) = (start, Matrix::zeros());
    for command in commands {
        state = step(&parameters, model.arm, &state, &Vector::constant(*command));
        if !inside(&state, room) {
            return None;
        }
        for (output, weight) in state.outputs().iter().zip(weights) {
            let slopes = SVector::from_fn(|i, _| output.gradient[i]);
            gained.ger(weight, &slopes, &slopes, 1.0);
        }
    }
    Some((state, gained))
}

/// Whether a return to the middle stays in the room.
fn returns(parameters: &Parameters<f64>, model: &PhysicalModel, from: &Sensitive, room: Room) -> bool {
    let mut flat = [Dual::from(0.0); super::state::STATE_LEN];
    from.write_flat(&mut flat);
    let mut state = State::from_flat(&flat.map(|entry| entry.value));
    let home = Vector([0.0, 0.0, HOVER_HEIGHT_M]);
    (0..RETURN_ROWS).all(|_| {
        state = step(parameters, model.arm, &state, &home);
        inside(&state, room)
    })
}

fn inside<S: super::scalar::Scalar>(state: &State<S>, room: Room) -> bool {
    let outputs = state.outputs().map(|output| output.value());
    let [x, y, z, _, _, _, tip_x, tip_y, tip_z] = outputs;
    outputs.iter().all(|value| value.is_finite())
        && [x, y, tip_x, tip_y]
            .iter()
            .all(|value| value.abs() <= room.horizontal_m)
        && (room.height_m[0]..=room.height_m[1]).contains(&z)
        && tip_z >= room.tip_height_m
        && tip_z <= z - BELOW_M
        && tilt(&outputs) <= room.tilt
        && arm_angle(&outputs) <= room.arm_angle
}

/// Commands of one block: set points held for a while, or sines, of random size and speed.
fn block(random: &mut ChaCha8Rng, room: Room) -> Vec<[f64; 3]> {
    let (low, high) = (room.height_m[0], room.height_m[1]);
    let reach = random.random_range(0.2..1.5 * room.horizontal_m);
    let mut uniform = |from: f64, to: f64| random.random_range(from..to);
    if uniform(0.0, 1.0) < 0.5 {
        let hold = uniform(4.0, 30.0) as usize;
        let mut commands = Vec::new();
        while commands.len() < BLOCK_ROWS {
            let target = [uniform(-reach, reach), uniform(-reach, reach), uniform(low, high)];
            commands.extend(std::iter::repeat_n(target, hold));
        }
        commands.truncate(BLOCK_ROWS);
        return commands;
    }
    let waves: [[f64; 3]; 3] = [
        [uniform(-reach, reach), uniform(0.1, 1.2), uniform(0.0, TAU)],
        [uniform(-reach, reach), uniform(0.1, 1.2), uniform(0.0, TAU)],
        [
            uniform(0.0, 0.5 * (high - low)),
            uniform(0.1, 1.0),
            uniform(0.0, TAU),
        ],
    ];
    (0..BLOCK_ROWS)
        .map(|row| {
            let wave = |[amplitude, frequency, phase]: [f64; 3]| {
                amplitude * (TAU * frequency * row as f64 * DT + phase).sin()
            };
            [
                wave(waves[0]),
                wave(waves[1]),
                0.5 * (low + high) + wave(waves[2]),
            ]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::arm::ArmLength;
    use super::super::parameters::PARAMETERS;
    use super::super::synthetic::random_commands;
    use super::*;

    fn model() -> PhysicalModel {
        let mut model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.8)).unwrap();
        let variance = |i: usize| PARAMETERS[i].prior_sigma.powi(2);
        model.covariance = (0..PARAMETER_COUNT)
            .map(|i| {
                (0..PARAMETER_COUNT)
                    .map(|j| if i == j { variance(i) } else { 0.0 })
                    .collect()
            })
            .collect();
        model
    }

    #[test]
    fn a_designed_flight_says_more_than_random_ones_and_stays_in_the_room() {
        let (model, room) = (model(), Room::default());
        let designed = design_flight(&model, 20.0, room, 8, 1).unwrap();
        assert_eq!(designed.len(), 400);
        let gain = |commands: &[[f64; 3]]| information_gain(&model, commands).unwrap();
        for seed in 1..=3 {
            let random = gain(&random_commands(400, seed));
            assert!(
                gain(&designed) > random + 3.0,
                "{} against {random} nats",
                gain(&designed)
            );
        }
        let mut state = State::rest(&model.parameters, 0.8, designed[0]);
        for command in &designed {
            state = step(&model.parameters, model.arm, &state, &Vector(*command));
            assert!(inside(&state, room), "{:?}", state.outputs());
        }
        assert_eq!(designed, design_flight(&model, 20.0, room, 8, 1).unwrap());
    }

    #[test]
    fn a_flight_needs_time_room_and_something_to_learn() {
        let model = model();
        assert!(matches!(
            design_flight(&model, 1.0, Room::default(), 4, 1),
            Err(PhysicalError::Shape { .. })
        ));
        let low = Room {
            tip_height_m: 1.0,
            ..Room::default()
        };
        assert!(matches!(
            design_flight(&model, 20.0, low, 4, 1),
            Err(PhysicalError::NoRoom { .. })
        ));
        let mut unfitted = model;
        unfitted.covariance.clear();
        assert_eq!(
            information_gain(&unfitted, &[[0.0, 0.0, 1.5]]),
            Err(PhysicalError::NoCovariance)
        );
    }
}
