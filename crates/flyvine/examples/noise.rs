//! scratch
#![allow(clippy::print_stdout)]
use flyvine::control::estimator::identify_noise;
use flyvine::flight::{HygieneOptions, clean, read_flight};
use flyvine::model::Bank;
use std::path::Path;
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let bank = Bank::read(Path::new(&arguments[0]))?;
    let mut flights = Vec::new();
    for path in &arguments[2..] {
        let mut flight = read_flight(Path::new(path))?;
        clean(&mut flight, &HygieneOptions::default());
        flights.push(flight);
    }
    let started = std::time::Instant::now();
    let report = identify_noise(&bank, &flights, &mut |at| eprintln!("{at:?}"))?;
    println!(
        "{}\n{:?}",
        serde_json::to_string_pretty(&report)?,
        started.elapsed()
    );
    Ok(())
}
