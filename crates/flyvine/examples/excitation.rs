//! Is a designed training flight better than hand-made ones of the same duration? On the built-in vehicle with its
//! noise, the model of one calm flight is fitted again with one flight more, and predicts a flight that no fit saw:
//!
//! ```text
//! cargo run --release -p flyvine --example excitation -- [SEEDS]
//! ```
//!
//! Every seed stands for other noise, other hand-made swings, another design, and another flight to predict.

#![allow(clippy::print_stdout)] // a program

#[path = "../tests/common/mod.rs"]
mod common;

use common::recorded;
use flyvine::DT;
use flyvine::flight::{Configuration, Flight};
use flyvine::model::physical::{PhysicalFitOptions, Room, design_flight};
use flyvine::model::{Bank, Model, WindowKind, check, fit_physical_bank, refit_physical_bank};
use flyvine::sim::VehicleParameters;
use flyvine::task::{test_flight, training_flights};

/// Duration of every training flight, s.
const DURATION_S: f64 = 40.0;
/// Continuations that the design tries per block, as `flyvine excite` does.
const CANDIDATES: usize = 40;
/// The short arm, without pressure.
const CONFIGURATION: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seeds: u64 = std::env::args().nth(1).map_or(Ok(3), |seeds| seeds.parse())?;
    println!(
        "seed | flight | rollout error in cm, median and 95th percentile: 2.5 s | 10 s | 2.5 s in swings"
    );
    for seed in 1..=seeds {
        let (mut calm, mut hand_made) = (Vec::new(), Vec::new());
        for training in training_flights(seed) {
            let group = if training.name == "pretzel" {
                &mut calm
            } else {
                &mut hand_made
            };
            group.push(fly(training.name, &training.commands, seed));
        }
        let judge = [fly("judge", &test_flight(seed + 100).commands, seed + 100)];
        let options = PhysicalFitOptions::default();
        let (bank, _) = fit_physical_bank(&calm, &options, &mut |_, _| {})?;
        print_errors(seed, "none", &bank, &judge)?;
        let Model::Physical(model) = &bank.models()[0].model else {
            return Err("expected a physical model".into());
        };
        let commands = design_flight(model, DURATION_S, Room::default(), CANDIDATES, seed)?;
        let designed = fly("designed", &commands, seed);
        for more in [designed].into_iter().chain(hand_made) {
            let name = more.name.clone();
            let flights = [calm.clone(), vec![more]].concat();
            let (bank, _) = refit_physical_bank(&bank, &flights, &options, &mut |_, _| {})?;
            print_errors(seed, &name, &bank, &judge)?;
        }
    }
    Ok(())
}

/// Flies the commands of the first [`DURATION_S`].
fn fly(name: &str, commands: &[[f64; 3]], seed: u64) -> Flight {
    let rows = commands.len().min((DURATION_S / DT) as usize);
    recorded(
        name,
        &commands[..rows],
        VehicleParameters::default(),
        CONFIGURATION,
        seed,
    )
}

fn print_errors(
    seed: u64,
    name: &str,
    bank: &Bank,
    judge: &[Flight],
) -> Result<(), Box<dyn std::error::Error>> {
    let report = check(bank, judge)?;
    let error = |kind: WindowKind, horizon_s: f64| {
        let pooled = report
            .pooled
            .iter()
            .find(|pooled| pooled.kind == kind && pooled.error.horizon_s == horizon_s);
        let cm = |metres: Option<f64>| metres.map_or("–".to_owned(), |m| format!("{:.2}", 100.0 * m));
        pooled.map_or(String::new(), |pooled| {
            format!("{} {}", cm(pooled.error.median_m), cm(pooled.error.p95_m))
        })
    };
    println!(
        "{seed} | {name} | {} | {} | {}",
        error(WindowKind::All, 2.5),
        error(WindowKind::All, 10.0),
        error(WindowKind::Swings, 2.5)
    );
    Ok(())
}
