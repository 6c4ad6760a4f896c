//! What simulating costs. Two measurements, each printed as one JSON object per line; `bench/vehicle.py` runs the first
//! beside MuJoCo, interleaved.
//!
//! ```text
//! cargo run --release -p flyvine --example vehicle_speed -- arm arm.json 0.0025 5
//! cargo run --release -p flyvine --example vehicle_speed -- vehicle
//! ```
//!
//! `arm FILE STEP DURATION` swings the clamped arm of FILE (the format of `data/passive/passive_params.json`, one
//! configuration with its start) and prints process-CPU seconds and the tip every 10 ms. `vehicle` flies the default
//! vehicle with its autopilot at several steps, in every corner, and prints how much faster than real time it is and how
//! far its tip is from its own converged solution.

#![allow(clippy::print_stdout)] // an example is a program

#[path = "../tests/common/passive_arm.rs"]
mod passive_arm;

use flyvine::flight::Corner;
use flyvine::link::Vehicle;
use flyvine::sim::chain::Load;
use flyvine::sim::integrator::LinearlyImplicit;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use nalgebra::Vector3;
use passive_arm::{PassiveArm, bent};
use rustix::time::{ClockId, clock_gettime};
use serde::Deserialize;
use std::error::Error;

/// Process-CPU time, s.
fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["arm", path, step, duration] => arm(path, step.parse()?, duration.parse()?),
        ["vehicle"] => vehicle(),
        _ => Err("expected: arm FILE STEP DURATION, or: vehicle".into()),
    }
}

/// A clamped arm with its start.
#[derive(Deserialize)]
struct Case {
    gravity: f64,
    #[serde(flatten)]
    arm: PassiveArm,
    /// Quaternions of the joints, scalar first, one after another.
    start: Vec<f64>,
}

fn arm(path: &str, step: f64, duration: f64) -> Result<(), Box<dyn Error>> {
    let case: Case = serde_json::from_str(&std::fs::read_to_string(path)?)?;
    let links = case.start.len() / 4;
    let chain = case.arm.chain(links, case.gravity);
    let mut state = bent(&case.start);
    let per_sample = (0.01 / step).round() as usize;
    let samples = (duration / 0.01).round() as usize;
    let mut integrator = LinearlyImplicit::new(links);
    let mut tips: Vec<[f64; 3]> = Vec::with_capacity(samples + 1);
    tips.push(chain.end_effector(&state).into());
    let before = cpu_s();
    for _ in 0..samples {
        for _ in 0..per_sample {
            integrator.step(&chain, &mut state, &[Load::default(); 2], step);
        }
        tips.push(chain.end_effector(&state).into());
    }
    let spent = cpu_s() - before;
    println!("{}", serde_json::json!({ "cpu_s": spent, "tips": tips }));
    Ok(())
}

/// Rounds of which the fastest counts.
const ROUNDS: usize = 5;
/// Flights of this many commands: 5 s.
const ROWS: usize = 100;

/// Tip positions at every command, on a flight that swings the arm hard.
fn fly(parameters: &VehicleParameters, corner: Corner) -> Result<Vec<Vector3<f64>>, Box<dyn Error>> {
    let mut vehicle = SimulatedVehicle::new(parameters.clone())?;
    vehicle.reset(corner.configuration(), 1)?;
    let mut tips = Vec::with_capacity(ROWS);
    for k in 0..ROWS {
        let x = if k % 50 < 15 { 1.0 } else { 0.0 };
        vehicle.step([x, 0.3 * x, 1.5].into(), corner.configuration())?;
        tips.push(vehicle.positions().1);
    }
    Ok(tips)
}

fn vehicle() -> Result<(), Box<dyn Error>> {
    for corner in Corner::ALL {
        let with_step = |max_step_s| {
            let mut parameters = VehicleParameters::default();
            parameters.simulation.max_step_s = max_step_s;
            parameters
        };
        let converged = fly(&with_step(2.5e-3 / 32.0), corner)?;
        for max_step_s in [2.5e-3, 1.25e-3, 0.625e-3] {
            let parameters = with_step(max_step_s);
            let mut fastest = f64::INFINITY;
            let mut tips = vec![];
            for _ in 0..ROUNDS {
                let before = cpu_s();
                tips = fly(&parameters, corner)?;
                fastest = fastest.min(cpu_s() - before);
            }
            let squares = tips.iter().zip(&converged).map(|(a, b)| (a - b).norm_squared());
            let rms_m = (squares.sum::<f64>() / tips.len() as f64).sqrt();
            println!(
                "{}",
                serde_json::json!({
                    "configuration": corner.label(),
                    "max_step_s": max_step_s,
                    "times_real_time": (ROWS as f64 * flyvine::DT / fastest).round(),
                    "tip_rms_mm": 1e3 * rms_m,
                })
            );
        }
    }
    Ok(())
}
