//! `flyvine check`: how far a bank may be trusted.

use std::path::PathBuf;

use clap::Args;
use flyvine::model::{CheckReport, PredictionBand, WindowKind, check};

use crate::console::{centimetres, print, print_json, say, table};
use crate::flights::{configuration_label, load_flights, read_bank};
use crate::outcome::{Blame, CommandResult, Outcome};

/// Judge a bank on flights: one-step errors, and the end-effector error of whole rollouts.
///
/// A plan depends on what the model predicts 200 to 400 steps ahead, so the rollout's error is what counts: mean 3-D
/// end-effector distance over windows of 0.5, 1, 2.5, 5 and 10 s, with the worst window and the swings apart. A bank
/// that knows its band of confidence is asked how many predictions ended within it. Exit code 3 if any rollout
/// diverges, or nearly all leave the band.
///
///   flyvine check bank.json held-out.csv
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct CheckArguments {
    /// The bank.
    #[arg(value_name = "BANK.json")]
    bank: PathBuf,
    /// Recordings, best ones that the bank was not fitted on.
    #[arg(required = true, value_name = "FLIGHT")]
    flights: Vec<PathBuf>,
    /// Also judge flights outside the configurations of the bank.
    #[arg(long)]
    extrapolate: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Fewer windows than this share within a band of 95 %: the band is not about flights like these.
const HARDLY_ANY: f64 = 0.1;

/// Runs `flyvine check`.
pub fn run(arguments: &CheckArguments) -> CommandResult {
    let bank = read_bank(&arguments.bank, arguments.extrapolate)?;
    let flights = load_flights(&arguments.flights)?;
    let report = check(&bank, &flights).or_input()?;
    if arguments.json {
        print_json(&report)?;
    } else {
        print(&one_step_table(&report))?;
        print(&check_table(&report))?;
        print(&pooled_table(&report))?;
        if let Some(band) = &report.band {
            print(&format!("band of confidence: {}", band_line(band)))?;
        }
        print(&model_table(&report))?;
    }
    let diverged = report
        .flights
        .iter()
        .flat_map(|flight| &flight.rollout)
        .any(|rollout| rollout.diverged_share > 0.0);
    let extrapolated = flights
        .iter()
        .flat_map(|flight| &flight.samples)
        .any(|row| !bank.covers(row.configuration));
    let unsupported = is_unsupported(&report);
    for (found, what) in [
        (diverged, "rollouts diverge"),
        (extrapolated, "the bank was extrapolated"),
        (
            unsupported,
            "nearly all rollouts leave the band of confidence: the flights that the models were fitted on do not support \
             these (other motions, or another vehicle)",
        ),
    ] {
        if found {
            say(&format!("warning: {what}: do not trust plans made here"));
        }
    }
    Ok(if diverged || extrapolated || unsupported {
        Outcome::Untrusted
    } else {
        Outcome::Done
    })
}

/// Whether nearly all windows leave the band of confidence at a horizon that it was measured at.
fn is_unsupported(report: &CheckReport) -> bool {
    let Some(band) = &report.band else {
        return false;
    };
    report.pooled.iter().any(|pooled| {
        pooled.kind == WindowKind::All
            && band.horizons_s.contains(&pooled.error.horizon_s)
            && pooled.error.within_band.is_some_and(|share| share < HARDLY_ANY)
    })
}

/// Rollout errors, a row per flight.
pub fn check_table(report: &CheckReport) -> String {
    let mut header = vec![
        "rollout error, cm: median | p95".to_owned(),
        "configuration".to_owned(),
    ];
    if let Some(flight) = report.flights.first() {
        header.extend(
            flight
                .rollout
                .iter()
                .map(|rollout| format!("{} s", rollout.horizon_s)),
        );
    }
    header.push("worst".to_owned());
    header.push("diverged".to_owned());
    let length = |metres: Option<f64>| metres.map_or("–".to_owned(), centimetres);
    let rows = report.flights.iter().map(|flight| {
        let mut row = vec![
            flight.path.clone(),
            configuration_label(flight.configuration, flight.last_configuration),
        ];
        row.extend(
            flight
                .rollout
                .iter()
                .map(|r| format!("{} | {}", length(r.median_m), length(r.p95_m))),
        );
        row.push(length(
            flight
                .rollout
                .iter()
                .rev()
                .find(|r| r.windows > 0)
                .and_then(|r| r.worst_m),
        ));
        let diverged = flight
            .rollout
            .iter()
            .map(|r| r.diverged_share)
            .fold(0.0, f64::max);
        row.push(format!("{:.0} %", 100.0 * diverged));
        row
    });
    table(&header.iter().map(String::as_str).collect::<Vec<_>>(), rows)
}

/// All flights together, swings apart from the rest, and where the worst window is.
fn pooled_table(report: &CheckReport) -> String {
    let length = |metres: Option<f64>| metres.map_or("–".to_owned(), centimetres);
    let rows = report
        .pooled
        .iter()
        .filter(|pooled| pooled.error.windows > 0)
        .map(|pooled| {
            let error = &pooled.error;
            let kind = match pooled.kind {
                WindowKind::All => "all windows",
                WindowKind::Swings => "swings (arm leans over 30°)",
                WindowKind::Rest => "the rest",
            };
            vec![
                kind.to_owned(),
                format!("{} s", error.horizon_s),
                error.windows.to_string(),
                length(error.median_m),
                length(error.p95_m),
                length(error.worst_m),
                match (&pooled.worst_flight, error.worst_start_s) {
                    (Some(flight), Some(start_s)) => format!("{flight} from {start_s:.2} s"),
                    _ => "–".to_owned(),
                },
                error
                    .within_band
                    .map_or("–".to_owned(), |share| format!("{:.1} %", 100.0 * share)),
            ]
        });
    let header = [
        "all flights, cm",
        "horizon",
        "windows",
        "median",
        "p95",
        "worst",
        "worst window",
        "in the band",
    ];
    table(&header, rows)
}

/// A band's radii.
pub fn band_line(band: &PredictionBand) -> String {
    let radii: Vec<String> = band
        .horizons_s
        .iter()
        .zip(&band.radii_m)
        .map(|(horizon, radius)| {
            let leaning = band.radius_m(*horizon, std::f64::consts::FRAC_PI_6, 1.0);
            format!(
                "{} to {} cm at {horizon} s",
                centimetres(*radius),
                centimetres(leaning)
            )
        })
        .collect();
    format!(
        "{:.0} % of held-out predictions were within {} (arm straight down, to leaning 30°; midway between two configurations \
         twice that)",
        100.0 * band.confidence,
        radii.join(", ")
    )
}

fn one_step_table(report: &CheckReport) -> String {
    let mut header = vec!["one-step RMSE (mm; attitude 1e-3)"];
    header.extend(flyvine::flight::SIGNALS);
    let rows = report.flights.iter().map(|flight| {
        let value = |signal: &&str| {
            flight
                .one_step_rmse
                .get(*signal)
                .map_or("–".to_owned(), |v| format!("{:.2}", 1e3 * v))
        };
        std::iter::once(flight.path.clone())
            .chain(flyvine::flight::SIGNALS.iter().map(value))
            .collect()
    });
    table(&header, rows)
}

fn model_table(report: &CheckReport) -> String {
    let rows = report.models.iter().map(|model| {
        vec![
            configuration_label(model.configuration, None),
            format!("{:.4}", model.spectral_radius),
            format!("{:.1e}", model.condition_number),
        ]
    });
    table(&["model", "spectral radius", "condition number"], rows)
}
