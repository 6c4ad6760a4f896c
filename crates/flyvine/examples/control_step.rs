//! How long a tick of model-predictive control takes, everything included (filter, delay, rollout, quadratic program),
//! over laps of a plan on its own model with noise and gusts:
//!
//! ```text
//! cargo run --release -p flyvine --example control_step -- plan.json [STEPS]
//! ```

#![allow(clippy::print_stdout)] // a program

use flyvine::DT;
use flyvine::control::mpc::{ModelPredictive, MpcOptions};
use flyvine::control::supervisor::Limits;
use flyvine::control::{Controller, Proposal, Tick, Trajectory};
use flyvine::flight::Pose;
use flyvine::link::Observation;
use flyvine::task::read_plan;
use flyvine::trajopt::Dynamics;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::time::Instant;

/// Standard deviation of what is measured, m.
const NOISE_M: f64 = 3e-4;
/// What the air adds to the fresh entries of a step, at most: of a position in m, of a velocity in m/s.
const GUST: f64 = 2e-3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let plan = arguments.next().ok_or("expected a plan")?;
    let steps: usize = arguments.next().map_or(Ok(100_000), |steps| steps.parse())?;
    let plan = read_plan(plan.as_ref())?;
    let trajectory = Trajectory::of_plan(&plan)?;
    let model = plan.model()?;
    let ready = ModelPredictive::new(
        &trajectory,
        &model,
        &plan.reference,
        &Limits::default().room,
        &MpcOptions::default(),
    )?;
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let noise = Normal::new(0.0, NOISE_M)?;
    let mut times_us = Vec::with_capacity(steps);
    while times_us.len() < steps {
        let mut controller = ready.clone();
        let mut z = trajectory.state(0).to_vec();
        let mut fresh = vec![0.0; model.fresh_len()];
        let mut held_command = trajectory.start().0;
        let mut push = 0.0;
        for knot in 0..trajectory.knots() - 1 {
            let mut seen: [f64; 9] = std::array::from_fn(|i| z[i]);
            seen.iter_mut()
                .for_each(|value| *value += noise.sample(&mut random));
            let observation = Observation {
                t_s: knot as f64 * DT,
                quadrotor: Some(Pose {
                    position: [seen[0], seen[1], seen[2]],
                    attitude: [1.0, seen[3], seen[4], seen[5]],
                }),
                end_effector: Some([seen[6], seen[7], seen[8]]),
            };
            if knot == 0 {
                controller.prepare(&observation);
            }
            let started = Instant::now();
            let proposal = controller.propose(&Tick {
                knot,
                observation,
                held_command,
            });
            times_us.push(1e6 * started.elapsed().as_secs_f64());
            let Proposal::Command(command) = proposal else {
                return Err(format!("knot {knot}: {proposal:?}").into());
            };
            held_command = command;
            model.step(knot, &z, &command, &mut fresh);
            push = 0.95 * push + GUST * noise.sample(&mut random) / NOISE_M;
            fresh[0] += push * DT;
            fresh[6] += push * DT;
            let (n, fresh_len) = (z.len(), fresh.len());
            z.copy_within(..n - fresh_len, fresh_len);
            z[..fresh_len].copy_from_slice(&fresh);
        }
    }
    times_us.sort_by(f64::total_cmp);
    let at = |share: f64| times_us[((times_us.len() - 1) as f64 * share) as usize];
    println!(
        "{} ticks: median {:.0} µs, p99 {:.0} µs, p99.9 {:.0} µs, slowest {:.0} µs",
        times_us.len(),
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0)
    );
    Ok(())
}
