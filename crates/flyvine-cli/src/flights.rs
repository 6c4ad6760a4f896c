//! Recordings as every command reads them: parsed, cleaned, and nothing about it silent.

use std::path::{Path, PathBuf};

use flyvine::flight::{Configuration, Corner, Flight, HygieneOptions, HygieneReport, clean, read_flight};
use flyvine::model::{Bank, Extrapolation};

use crate::console::say;
use crate::outcome::{Blame, Failure};

/// Reads and cleans flights; what hygiene finds goes to stderr.
pub fn load_flights(paths: &[PathBuf]) -> Result<Vec<Flight>, Failure> {
    paths
        .iter()
        .map(|path| load_flight(path).map(|(flight, _)| flight))
        .collect()
}

/// Reads and cleans one flight.
pub fn load_flight(path: &Path) -> Result<(Flight, HygieneReport), Failure> {
    let mut flight = read_flight(path).or_input()?;
    let report = clean(&mut flight, &HygieneOptions::default());
    if !report.findings.is_empty() {
        say(&format!("{}:\n{report}", path.display()));
    }
    Ok((flight, report))
}

/// Reads a bank; outside the configurations that were flown it answers only if `extrapolate` says so.
pub fn read_bank(path: &Path, extrapolate: bool) -> Result<Bank, Failure> {
    let extrapolation = if extrapolate {
        Extrapolation::Allow
    } else {
        Extrapolation::Refuse
    };
    Ok(Bank::read(path).or_input()?.with_extrapolation(extrapolation))
}

/// `ES`, `IS`, `EL`, `IL` at the paper's corners, otherwise length and pressure; an arrow where it changes.
pub fn configuration_label(first: Configuration, last: Option<Configuration>) -> String {
    let one = |configuration: Configuration| match Corner::from_configuration(configuration) {
        Some(corner) => corner.label().to_owned(),
        None => format!(
            "{:.3} m {:.2} kPa",
            configuration.length_m, configuration.pressure_kpa
        ),
    };
    last.map_or_else(|| one(first), |last| format!("{} → {}", one(first), one(last)))
}
