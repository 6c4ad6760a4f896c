//! Flights simulated with the physical model itself, for tests.

use super::arm::ArmLength;
use super::model::PhysicalModel;
use super::parameters::Parameters;
use super::state::STATE_LEN;
use crate::DT;
use crate::flight::{Configuration, Flight, Pose, Sample};
use crate::trajopt::Dynamics;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal, Uniform};

/// Random set points, each held for half a second to a second.
pub fn random_commands(rows: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let uniform = |low: f64, high: f64| Uniform::new(low, high).unwrap();
    let (horizontal, height, hold) = (uniform(-0.8, 0.8), uniform(1.3, 1.7), uniform(10.0, 20.0));
    let mut commands = vec![[0.0, 0.0, 1.5]; 5];
    while commands.len() < rows {
        let target = [
            horizontal.sample(&mut random),
            horizontal.sample(&mut random),
            height.sample(&mut random),
        ];
        commands.extend(std::iter::repeat_n(target, hold.sample(&mut random) as usize));
    }
    commands.truncate(rows);
    commands
}

/// The flight from rest under `commands`, with normal noise of `noise` (m, and attitude), and the true states.
pub fn simulate_flight(
    name: &str,
    parameters: &Parameters<f64>,
    length_m: f64,
    commands: &[[f64; 3]],
    noise: f64,
    seed: u64,
) -> (Flight, Vec<[f64; STATE_LEN]>) {
    let model = PhysicalModel::new(*parameters, ArmLength::constant(length_m)).unwrap();
    simulate_model(name, &model, commands, noise, seed)
}

/// The same of a model with all that belongs to it.
pub fn simulate_model(
    name: &str,
    model: &PhysicalModel,
    commands: &[[f64; 3]],
    noise: f64,
    seed: u64,
) -> (Flight, Vec<[f64; STATE_LEN]>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, noise).unwrap();
    let mut state: [f64; STATE_LEN] = model.rest_state([0.0, 0.0, 1.5]).try_into().unwrap();
    let (mut samples, mut states) = (Vec::new(), Vec::new());
    for (row, &command) in commands.iter().enumerate() {
        states.push(state);
        let [px, py, pz, qx, qy, qz, tx, ty, tz] =
            std::array::from_fn(|output| state[output] + normal.sample(&mut random));
        let w = (1.0 - qx * qx - qy * qy - qz * qz).sqrt();
        samples.push(Sample {
            t_s: row as f64 * DT,
            configuration: Configuration {
                length_m: model.arm.length_m,
                pressure_kpa: 0.0,
            },
            command,
            command_velocity: None,
            quadrotor: Some(Pose {
                position: [px, py, pz],
                attitude: [w, qx, qy, qz],
            }),
            end_effector: Some([tx, ty, tz]),
        });
        let mut next = [0.0; STATE_LEN];
        model.step(row, &state, &command, &mut next);
        state = next;
    }
    let name = name.to_owned();
    (Flight { name, samples }, states)
}
