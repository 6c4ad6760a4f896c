//! `flyvine score`: how well a flight did what its plan wanted.

use std::path::PathBuf;

use clap::Args;
use flyvine::report::{DistanceStatistics, Score};
use flyvine::run::score_flight;
use flyvine::task::read_plan;

use crate::console::{centimetres, print, print_json, say, table};
use crate::flights::load_flight;
use crate::outcome::{Blame, CommandResult, Outcome};

/// Score a flight against its plan: mean, RMS and greatest 3-D distance of the measured end effector to the task's
/// reference and to the model's prediction.
///
/// Row k of the flight against knot k of the plan, without any time shift and with the ramp. Exit code 3 if rows are
/// missing or the flight was aborted.
#[derive(Args)]
pub struct ScoreArguments {
    /// The recording.
    #[arg(value_name = "FLIGHT")]
    flight: PathBuf,
    /// The plan that was flown.
    #[arg(long, value_name = "PLAN.json")]
    plan: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `flyvine score`.
pub fn run(arguments: &ScoreArguments) -> CommandResult {
    let plan = read_plan(&arguments.plan).or_input()?;
    let (flight, _) = load_flight(&arguments.flight)?;
    let score = score_flight(&plan, &flight).or_input()?;
    if arguments.json {
        print_json(&score)?;
    } else {
        print(&score_table(&score))?;
    }
    let mut outcome = Outcome::Done;
    if score.rows_missing > 0 {
        say(&format!(
            "warning: {} of {} rows have no end-effector pose",
            score.rows_missing, score.rows
        ));
        outcome = Outcome::Untrusted;
    }
    if score.knots_not_flown > 0 {
        say(&format!(
            "warning: the flight ended early: {} of the plan's {} knots were not flown",
            score.knots_not_flown,
            score.rows + score.knots_not_flown
        ));
        outcome = Outcome::Untrusted;
    }
    Ok(outcome)
}

fn score_table(score: &Score) -> String {
    let row = |name: &str, statistics: &DistanceStatistics| {
        let DistanceStatistics { mean_m, rms_m, max_m } = statistics;
        vec![
            name.to_owned(),
            centimetres(*mean_m),
            centimetres(*rms_m),
            centimetres(*max_m),
        ]
    };
    let rows = [
        row("reference", &score.ee_vs_reference),
        row("prediction", &score.ee_vs_prediction),
    ];
    let mut text = table(&["end effector against, cm", "mean", "RMS", "max"], rows);
    if let (Some(miss), Some([vx, vz])) = (score.target_miss_m, score.target_velocity_m_s) {
        text += &format!(
            "\ntarget missed by {} cm, at a velocity of ({vx:.2}, {vz:.2}) m/s",
            centimetres(miss)
        );
    }
    text
}
