//! A controller of your own: the plan's command, and a share of the tip's error on top.
//!
//! ```text
//! cargo run --release -p flyvine --example own_controller -- plan.json
//! ```

#![allow(clippy::print_stdout)] // a program

use std::ops::ControlFlow;
use std::path::Path;

use flyvine::control::supervisor::Limits;
use flyvine::control::{Controller, OpenLoop, Proposal, Tick, Trajectory, fly};
use flyvine::report::score;
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use flyvine::task::{Plan, read_plan};

/// Commands the plan's position, moved against the tip's error: u = u* + K (predicted tip − tip).
struct TipFeedback<'a> {
    trajectory: &'a Trajectory,
    predicted_tip: Vec<[f64; 3]>,
    gain: f64,
}

impl Controller for TipFeedback<'_> {
    fn propose(&mut self, tick: &Tick) -> Proposal {
        let planned = self.trajectory.command(tick.knot);
        // A tip that motion capture missed, or that the supervisor does not believe, corrects nothing.
        let Some(tip) = tick.observation.end_effector else {
            return Proposal::Command(planned);
        };
        let predicted = self.predicted_tip[tick.knot];
        let corrected = std::array::from_fn(|i| planned[i] + self.gain * (predicted[i] - tip[i]));
        Proposal::Command(self.trajectory.clip(corrected))
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("expected a plan")?;
    let plan = read_plan(Path::new(&path))?;
    let trajectory = Trajectory::of_plan(&plan)?;
    let mut feedback = TipFeedback {
        trajectory: &trajectory,
        predicted_tip: plan.predicted_end_effector(),
        gain: 0.15,
    };
    let open_cm = fly_and_score(&plan, &trajectory, &mut OpenLoop::new(&trajectory))?;
    let closed_cm = fly_and_score(&plan, &trajectory, &mut feedback)?;
    println!("mean error to the reference: open loop {open_cm:.2} cm, with feedback {closed_cm:.2} cm");
    Ok(())
}

/// One flight on the simulated vehicle; the mean error of its tip, cm.
fn fly_and_score(
    plan: &Plan,
    trajectory: &Trajectory,
    controller: &mut dyn Controller,
) -> Result<f64, Box<dyn std::error::Error>> {
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default())?;
    let outcome = fly(
        trajectory,
        controller,
        Limits::default(),
        &mut vehicle,
        1,
        &mut |_, _| ControlFlow::Continue(()),
    )?;
    let score = score(
        &outcome.flight,
        &plan.reference,
        &plan.predicted_end_effector(),
        None,
    )?;
    Ok(100.0 * score.ee_vs_reference.mean_m)
}
