//! Recordings as every command reads them: parsed, cleaned, and nothing about it silent.

use std::path::{Path, PathBuf};

use flyvine::flight::{Flight, HygieneOptions, HygieneReport, clean, read_flight};
use flyvine::model::{Bank, Extrapolation};

pub use flyvine::run::configuration_label;

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
    say_findings(path, &report);
    Ok((flight, report))
}

/// Says what hygiene found in a flight.
pub fn say_findings(path: &Path, report: &HygieneReport) {
    if !report.findings.is_empty() {
        say(&format!("{}:\n{report}", path.display()));
    }
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
