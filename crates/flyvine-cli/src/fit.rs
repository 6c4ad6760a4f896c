//! `flyvine fit`: flights in, bank out.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use flyvine::Shard;
use flyvine::flight::Flight;
use flyvine::model::physical::PhysicalFitOptions;
use flyvine::model::streaming::Reduction;
use flyvine::model::{
    Bank, Candidate, CheckReport, Chosen, CommandInputs, FamiliesReport, Family, FamilyOptions, FamilyTrial,
    Finding, FitOptions, FitReport, HeldOutError, InputFile, Positions, Refinement, Ridge, Structure,
    VelocityInput, bootstrap, check,
};

use crate::check::{band_line, check_table};
use crate::console::{centimetres, print, print_json, progress, say, table};
use crate::flights::load_flights;
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};
use crate::{fit_bootstrap, fit_progress, fit_stream, physical_report};

/// Identify models from flights and join them in a bank.
///
/// Flights are grouped by configuration (arm length, pressure). The extreme configurations become the bank's
/// models: one, two along one axis, or four corners. Flights in between, and flights during which the
/// configuration changes, only judge the interpolation. The family of the models and their settings are chosen by the
/// error of whole rollouts on flights that were held out, because that is what a plan depends on; what the rollouts
/// missed becomes the bank's band of confidence.
///
///   flyvine fit recordings/*.csv --out bank.json --report fit_report
///
/// More recordings than memory holds are fitted with --stream: the lag family's least squares with the ridges given (none
/// by default), in one pass, nothing held out. Several machines share the work with --shard and --merge; the bank has the
/// same bits:
///
///   flyvine fit --shard 1/2 recordings/*.csv --out part_1.json      (and 2/2, elsewhere)
///   flyvine fit --merge part_1.json part_2.json --out bank.json
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct FitArguments {
    /// Recordings in flyvine's CSV format (see `flyvine convert` for others).
    #[arg(required_unless_present = "merge", value_name = "FLIGHT")]
    flights: Vec<PathBuf>,
    /// Where to write the bank; with --ensemble, the folder for it and its members; with --shard, the partial fit.
    #[arg(long, value_name = "BANK.json")]
    out: PathBuf,
    /// Also fit this many banks on flights drawn with replacement: models that the flights allow beside the best one,
    /// to plan against all of them. --out is a folder then, for bank.json and member_1.json, member_2.json, …
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    ensemble: Option<u32>,
    /// Check the standard errors of a physical bank's parameters: refit it to this many draws of the flights with
    /// replacement, and print the spread of each parameter over its standard error.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=100), conflicts_with = "json")]
    bootstrap: Option<u32>,
    /// Seed of the draws of --ensemble and --bootstrap.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Also write fit.json (everything that was tried) and check.json (errors on these flights) into this folder.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Family of the models: `lag` is the paper's; `physical` is reduced-order physics of quadrotor, autopilot and
    /// arm, fitted by simulation error (a minute or so), to which the other settings do not apply; `auto` tries both
    /// and keeps the one that predicts held-out flights better.
    #[arg(long, value_enum, default_value_t = FamilyChoice::Auto)]
    family: FamilyChoice,
    /// Rows of the model: `paper` has a quadratic end-effector height, `linear` has not.
    #[arg(long, value_enum, default_value_t = StructureChoice::Paper)]
    structure: StructureChoice,
    /// Past states that the model looks at.
    #[arg(long, default_value_t = 3)]
    lags: usize,
    /// Ridge strength of the height row: `auto`, or a number ≥ 0.
    #[arg(long, default_value = "auto", value_parser = parse_ridge)]
    height_ridge: Ridge,
    /// Ridge strength of the linear rows: `auto`, or a number ≥ 0.
    #[arg(long, default_value = "auto", value_parser = parse_ridge)]
    linear_ridge: Ridge,
    /// Whether the commanded velocity is an input too, where recordings have it.
    #[arg(long, value_enum, default_value_t = VelocityChoice::Auto)]
    command_velocity: VelocityChoice,
    /// Whether rows depend on where in the room the vehicle is, as in the paper, or only on positions relative to the
    /// quadrotor: then shifting the room shifts the prediction. `auto`: whichever predicts held-out flights better.
    #[arg(long, value_enum, default_value_t = PositionsChoice::Auto)]
    positions: PositionsChoice,
    /// Whether models are refined on the error of whole rollouts after one-step least squares; `auto` keeps the
    /// refinement only where it predicts held-out flights better.
    #[arg(long, value_enum, default_value_t = RefinementChoice::Auto)]
    refinement: RefinementChoice,
    /// Try a small linear correction of the velocities on top of physical models, fitted to what physics leaves over, and
    /// keep it if it predicts held-out flights better.
    #[arg(long, conflicts_with_all = ["stream", "shard", "merge", "ensemble"])]
    correction: bool,
    /// Read the recordings one after the other, in memory that does not depend on their number: least squares of the
    /// lag family, ridges and velocity input as given (auto means none), no refinement.
    #[arg(long, conflicts_with_all = ["ensemble", "bootstrap", "report", "merge"])]
    stream: bool,
    /// Reduce part i of n of the recordings (the same list on every machine) to a partial fit for --merge.
    #[arg(long, value_name = "i/n", conflicts_with_all = ["ensemble", "bootstrap", "report", "merge", "json"])]
    shard: Option<Shard>,
    /// Make the bank from the partial fits of all shards, in any order.
    #[arg(long, value_name = "PARTIAL", num_args = 1.., conflicts_with_all = ["flights", "ensemble", "bootstrap", "report"])]
    merge: Vec<PathBuf>,
    /// With --stream or --shard: reduce rows to triangular factors instead of sums of products. Several times slower;
    /// for columns that depend on each other, where --stream falls back to it by itself.
    #[arg(long)]
    orthogonal: bool,
    /// Print the fit's report as JSON.
    #[arg(long)]
    json: bool,
}

/// The families to try.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FamilyChoice {
    /// All of them.
    Auto,
    /// The paper's.
    Lag,
    /// Reduced-order physics.
    Physical,
}

impl FamilyChoice {
    /// The families to try, in order.
    pub fn families(self) -> Vec<Family> {
        match self {
            Self::Auto => vec![Family::Lag, Family::Physical],
            Self::Lag => vec![Family::Lag],
            Self::Physical => vec![Family::Physical],
        }
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum StructureChoice {
    Paper,
    Linear,
}

#[derive(Clone, Copy, ValueEnum)]
enum VelocityChoice {
    Auto,
    Off,
    On,
}

#[derive(Clone, Copy, ValueEnum)]
enum PositionsChoice {
    Auto,
    Absolute,
    Relative,
}

#[derive(Clone, Copy, ValueEnum)]
enum RefinementChoice {
    Auto,
    Off,
    On,
}

fn parse_ridge(text: &str) -> Result<Ridge, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(Ridge::Value(value)),
        _ if text == "auto" => Ok(Ridge::Auto),
        _ => Err(format!("found `{text}`, expected `auto` or a number ≥ 0")),
    }
}

impl FitArguments {
    fn options(&self) -> FitOptions {
        FitOptions {
            structure: match self.structure {
                StructureChoice::Paper => Structure::Paper,
                StructureChoice::Linear => Structure::Linear,
            },
            lags: self.lags,
            height_ridge: self.height_ridge,
            linear_ridge: self.linear_ridge,
            command_velocity: match self.command_velocity {
                VelocityChoice::Auto => VelocityInput::Auto,
                VelocityChoice::Off => VelocityInput::Off,
                VelocityChoice::On => VelocityInput::On,
            },
            positions: match self.positions {
                PositionsChoice::Auto => None,
                PositionsChoice::Absolute => Some(Positions::Absolute),
                PositionsChoice::Relative => Some(Positions::Relative),
            },
            refinement: match self.refinement {
                RefinementChoice::Auto => Refinement::Auto,
                RefinementChoice::Off => Refinement::Off,
                RefinementChoice::On => Refinement::On,
            },
        }
    }
}

/// Runs `flyvine fit`.
pub fn run(arguments: &FitArguments) -> CommandResult {
    if let Some(result) = run_streaming(arguments) {
        return result;
    }
    let flights = load_flights(&arguments.flights)?;
    if arguments.bootstrap.is_some() && arguments.family == FamilyChoice::Lag {
        return bad_input("--bootstrap: found --family lag, expected physical, whose parameters mean something each on its own".into());
    }
    if arguments.correction && arguments.family == FamilyChoice::Lag {
        return bad_input(
            "--correction: found --family lag, expected physical: the lag family has nothing to correct"
                .into(),
        );
    }
    let options = FamilyOptions {
        families: arguments.family.families(),
        lag: arguments.options(),
        physical: PhysicalFitOptions {
            correction: arguments.correction,
            ..PhysicalFitOptions::default()
        },
    };
    say(&format!("fitting {} flights …", flights.len()));
    let (bank, report) = fit_progress::fit(&flights, &options)?;
    if arguments.correction
        && matches!(&report.chosen, Chosen::Physical(physical) if physical.correction.is_none())
    {
        say(
            "warning: --correction: too few flights to hold any out, which would tell whether it helps: none was tried",
        );
    }
    let bank = bank.with_inputs(inputs(arguments)?);
    let noise = fit_progress::identify(&bank, &flights)?;
    let levels = noise.as_ref().map(|noise| noise.levels);
    let bank = bank.with_noise(levels).or_internal()?;
    let checked = check(&bank, &flights).or_internal()?;
    match arguments.ensemble {
        None => write_bank(&bank, &arguments.out)?,
        Some(members) => write_ensemble(arguments, &bank, &flights, members)?,
    }
    if let Some(folder) = &arguments.report {
        write_json(&folder.join("fit.json"), &report)?;
        write_json(&folder.join("check.json"), &checked)?;
        write_json(&folder.join("noise.json"), &noise)?;
    }
    if arguments.json {
        print_json(&report)?;
    } else {
        print_report(&report, &checked)?;
    }
    if let Some(draws) = arguments.bootstrap {
        fit_bootstrap::run(&bank, &flights, draws, arguments.seed)?;
    }
    Ok(say_outcome(&report))
}

/// Runs `flyvine fit --stream`, `--shard` or `--merge`; `None` if it is none of them.
fn run_streaming(arguments: &FitArguments) -> Option<CommandResult> {
    let FitArguments {
        flights, out, json, ..
    } = arguments;
    if !arguments.merge.is_empty() {
        return Some(fit_stream::merge(&arguments.merge, out, *json));
    }
    if !arguments.stream && arguments.shard.is_none() {
        return arguments
            .orthogonal
            .then(|| bad_input("--orthogonal goes with --stream or --shard".into()));
    }
    if arguments.family == FamilyChoice::Physical {
        return Some(bad_input(
            "found --family physical, expected lag: only least squares streams".into(),
        ));
    }
    let reduction = if arguments.orthogonal {
        Reduction::Orthogonal
    } else {
        Reduction::Moments
    };
    let options = arguments.options();
    Some(match arguments.shard {
        Some(shard) => fit_stream::shard(flights, &options, reduction, shard, out),
        None => fit_stream::stream(flights, &options, reduction, out, *json),
    })
}

/// The recordings and their hashes.
fn inputs(arguments: &FitArguments) -> Result<Vec<InputFile>, Failure> {
    let hashed = arguments.flights.iter().map(|path| InputFile::of(path));
    hashed.collect::<Result<_, _>>().or_input()
}

/// Writes a bank and says so.
pub fn write_bank(bank: &Bank, path: &Path) -> Result<(), Failure> {
    bank.write(path).or_internal()?;
    say(&format!("wrote {}", path.display()));
    Ok(())
}

/// Writes the bank and as many members, each as soon as all of them are fitted.
fn write_ensemble(
    arguments: &FitArguments,
    bank: &Bank,
    flights: &[Flight],
    members: u32,
) -> Result<(), Failure> {
    let bar = progress(u64::from(members), "ensemble");
    let banks = bootstrap(bank, flights, members as usize, arguments.seed, &mut |number| {
        bar.set_position(number as u64);
    });
    bar.finish_and_clear();
    write_bank(bank, &arguments.out.join("bank.json"))?;
    for (number, member) in banks.or_input()?.into_iter().enumerate() {
        let member = member.with_inputs(bank.provenance().inputs.clone());
        write_bank(
            &member,
            &arguments.out.join(format!("member_{}.json", number + 1)),
        )?;
    }
    Ok(())
}

/// Writes a value as JSON, whole or not at all.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), Failure> {
    let contents = serde_json::to_vec_pretty(value).or_internal()?;
    flyvine::file::write_whole(path, &contents).or_internal()
}

fn print_report(report: &FamiliesReport, checked: &CheckReport) -> Result<(), Failure> {
    match &report.chosen {
        Chosen::Lag(lag) => print(&candidate_table(lag))?,
        Chosen::Physical(physical) => print(&physical_report::tables(physical))?,
    }
    if report.trials.iter().any(|trial| trial.score_m().is_some()) {
        print(&family_table(report))?;
    }
    if let Some(band) = &checked.band {
        print(&format!("band of confidence: {}", band_line(band)))?;
    }
    print("On the flights themselves (held-out flights: `flyvine check`):")?;
    print(&check_table(checked))
}

/// How the families did on held-out flights.
fn family_table(report: &FamiliesReport) -> String {
    let chosen = report.chosen.family();
    let error = |error: &Option<HeldOutError>| {
        error.map_or("–".to_owned(), |error| {
            format!("{} ({} windows)", centimetres(error.mean_m), error.windows)
        })
    };
    let diverged = |trial: &FamilyTrial| {
        let share = [trial.corners, trial.interior]
            .iter()
            .flatten()
            .map(|error| error.diverged_share)
            .fold(0.0, f64::max);
        format!("{:.1} %", 100.0 * share)
    };
    let rows = report.trials.iter().map(|trial| {
        vec![
            if trial.family == chosen { "▶" } else { "" }.to_owned(),
            trial.family.to_string(),
            error(&trial.corners),
            error(&trial.interior),
            if trial.failure.is_some() {
                "–".to_owned()
            } else {
                diverged(trial)
            },
        ]
    });
    let header = [
        "chosen",
        "family",
        "held-out rollouts, cm",
        "interpolated, cm",
        "diverged",
    ];
    table(&header, rows)
}

fn candidate_table(report: &FitReport) -> String {
    let chosen = &report.chosen;
    let strength = |ridge: Option<f64>| ridge.map_or("–".to_owned(), |value| format!("{value:e}"));
    let error =
        |error: &Option<HeldOutError>| error.map_or("–".to_owned(), |error| centimetres(error.mean_m));
    let rows = report.candidates.iter().map(|candidate| {
        // What was chosen may have been refined since.
        let is_chosen = Candidate {
            refined: chosen.refined,
            ..candidate.clone()
        } == *chosen;
        vec![
            if is_chosen { "▶" } else { "" }.to_owned(),
            match candidate.inputs {
                CommandInputs::Position => "position",
                CommandInputs::PositionAndVelocity => "and velocity",
            }
            .to_owned(),
            match candidate.positions {
                Positions::Absolute => "absolute",
                Positions::Relative => "relative",
            }
            .to_owned(),
            format!("{:e}", candidate.linear_ridge),
            strength(candidate.height_ridge),
            error(&candidate.corners),
            error(&candidate.interior),
        ]
    });
    let header = [
        "chosen",
        "command",
        "positions",
        "linear ridge",
        "height ridge",
        "held-out rollouts, cm",
        "interpolated, cm",
    ];
    table(&header, rows)
}

/// Says what the user should know about a fit; the result is not to be trusted if a finding says so.
pub fn say_outcome(report: &FamiliesReport) -> Outcome {
    let mut outcome = match &report.chosen {
        Chosen::Lag(report) => say_findings(&report.findings),
        Chosen::Physical(report) => {
            for warning in physical_report::warnings(report) {
                say(&format!("warning: {warning}"));
            }
            Outcome::Done
        }
    };
    for family in &report.diverging {
        let why = format!("{family} family: rollouts diverge on the very flights that it was fitted on");
        if *family == report.chosen.family() {
            say(&format!("warning: do not plan on this bank: {why}"));
            outcome = Outcome::Untrusted;
        } else {
            say(&format!("note: not chosen: {why}"));
        }
    }
    outcome
}

fn say_findings(findings: &[Finding]) -> Outcome {
    let mut outcome = Outcome::Done;
    for finding in findings {
        let severity = match finding {
            Finding::PlainLeastSquaresUnusable { .. } => "note",
            Finding::TooShortToCrossCheck => "warning",
            Finding::NotToBeTrusted { .. } | Finding::Unstable { .. } => {
                outcome = Outcome::Untrusted;
                "warning: do not plan on this bank"
            }
        };
        say(&format!("{severity}: {finding}"));
    }
    outcome
}
