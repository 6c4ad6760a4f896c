//! Fits the physical family to recorded flights, prints its rollout errors, and checks its standard errors by a
//! bootstrap over flights:
//!
//! ```text
//! cargo run --release -p flyvine --example physical_family -- FOLDER [train|author]
//! ```
//!
//! FOLDER holds flights named `{ES,IS,EL,IL}_train*`, `*_author*`, `*_test*`, `mid_*` and `growing_*`. The second
//! argument says which of them are fitted (default train); the others are predicted.

#![allow(clippy::print_stdout)] // a program

use flyvine::flight::{Flight, HygieneOptions, clean, read_flight};
use flyvine::model::physical::{PARAMETERS, PhysicalFitOptions, fit_physical};
use flyvine::model::{
    Bank, BankModel, BankProvenance, Model, ModelDiagnostics, bootstrap, check, fit_physical_bank,
};
use std::path::Path;
use std::time::Instant;

/// Draws of the bootstrap.
const BOOTSTRAP: usize = 8;

const CORNERS: [&str; 4] = ["ES", "IS", "EL", "IL"];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("expected a folder with flights")?;
    let fitted = arguments.next().unwrap_or("train".into());
    let flights = read_folder(Path::new(&folder))?;
    let named = |prefix: &str| -> Vec<Flight> {
        flights
            .iter()
            .filter(|flight| flight.name.starts_with(prefix))
            .cloned()
            .collect()
    };
    let options = PhysicalFitOptions::default();

    println!("Every corner on its own:");
    for corner in CORNERS {
        let start = Instant::now();
        let model = fit_physical(&named(&format!("{corner}_{fitted}")), &options, &mut |_| {})?;
        let seconds = start.elapsed().as_secs_f64();
        let fit = model.fit.as_ref().ok_or("a fit has a summary")?;
        println!(
            "{corner}: {} rows, {} iterations, objective {:.1}, {seconds:.1} s",
            fit.rows, fit.iterations, fit.objective
        );
        let bank = Bank::new(
            vec![BankModel {
                configuration: fit.configuration,
                model: Model::Physical(Box::new(model)),
                diagnostics: ModelDiagnostics::default(),
            }],
            BankProvenance::default(),
        )?;
        print_errors(&bank, &named(&format!("{corner}_test")))?;
    }

    println!("\nBank, its corners drawn towards one vehicle:");
    let members: Vec<Flight> = CORNERS
        .iter()
        .flat_map(|corner| named(&format!("{corner}_{fitted}")))
        .collect();
    let start = Instant::now();
    let (bank, _) = fit_physical_bank(&members, &options, &mut |_, _| {})?;
    println!("fitted in {:.1} s", start.elapsed().as_secs_f64());
    for prefix in ["ES_test", "IS_test", "EL_test", "IL_test", "mid_", "growing_"] {
        print_errors(&bank, &named(prefix))?;
    }
    println!(
        "\nStandard errors of the coordinates: posterior, and {BOOTSTRAP} bootstrap draws of whole flights:"
    );
    let draws = bootstrap(&bank, &members, BOOTSTRAP, 1, &mut |_| {})?;
    for (i, info) in PARAMETERS.iter().enumerate() {
        print!("{:26}", info.name);
        for (number, member) in bank.models().iter().enumerate() {
            let Model::Physical(model) = &member.model else {
                continue;
            };
            let spread = deviation(
                draws
                    .iter()
                    .filter_map(|draw| match &draw.models()[number].model {
                        Model::Physical(model) => Some(model.parameters.coordinates()[i]),
                        Model::Lag(_) => None,
                    }),
            );
            let value = model.parameters.to_array()[i];
            print!(" {value:9.4} ±{:.3} ±{spread:.3}", model.standard_deviations()[i]);
        }
        println!("  {}", info.unit);
    }
    Ok(())
}

/// Standard deviation of a sample.
fn deviation(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}

/// Median, 95th percentile and worst end-effector rollout error, cm, at 2.5 and 10 s.
fn print_errors(bank: &Bank, flights: &[Flight]) -> Result<(), Box<dyn std::error::Error>> {
    for flight in check(bank, flights)?.flights {
        print!("  {:34}", flight.path);
        for rollout in flight
            .rollout
            .iter()
            .filter(|r| [2.5, 10.0].contains(&r.horizon_s))
        {
            let cm = |value: Option<f64>| value.map_or("-".into(), |value| format!("{:.2}", 100.0 * value));
            print!(
                "  {:>4} s: median {} p95 {} worst {} diverged {:.3}",
                rollout.horizon_s,
                cm(rollout.median_m),
                cm(rollout.p95_m),
                cm(rollout.worst_m),
                rollout.diverged_share
            );
        }
        println!();
    }
    Ok(())
}

/// All CSV flights of a folder by name, after hygiene.
fn read_folder(folder: &Path) -> Result<Vec<Flight>, Box<dyn std::error::Error>> {
    let mut flights = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "csv") {
            let mut flight = read_flight(&path)?;
            clean(&mut flight, &HygieneOptions::default());
            flight.name = path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            flights.push(flight);
        }
    }
    flights.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(flights)
}
