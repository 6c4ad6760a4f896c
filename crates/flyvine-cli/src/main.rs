//! The `flyvine` command line: parses arguments, runs one command, prints, exits.

mod arm_shape;
mod bench;
mod calibrate;
mod calibrate_report;
mod check;
mod completions;
mod console;
mod convert;
mod convert_parquet;
mod convert_ros;
mod demo;
mod excite;
mod fit;
mod fit_bootstrap;
mod fit_progress;
mod fit_stream;
mod flights;
mod fly;
mod fly_autopilot;
mod help;
mod learn;
mod man;
mod merge;
mod mix;
mod mocap;
mod onboard;
mod outcome;
mod page;
mod physical_report;
mod plan;
mod query;
mod rehearse;
mod rehearse_process;
mod rehearse_vehicle;
mod report;
mod score;
mod solve;
mod sweep;
mod ulog;
mod view;

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

/// From motion-capture logs to flights of a drone with a soft arm whose tip goes where it is told.
///
/// Five commands take a lab from its recordings to a plan that it can fly:
///
///   flyvine convert --mapping mine.toml log.csv flight.csv   (if the recordings are not in flyvine's format)
///   flyvine fit flights/*.csv --out bank.json
///   flyvine check bank.json held-out.csv
///   flyvine plan task.toml --bank bank.json --out plan.json
///   flyvine convert plan.json commands.csv
#[derive(Parser)]
#[command(name = "flyvine", version, verbatim_doc_comment)]
#[command(
    after_help = "Exit codes: 0 done; 2 bad usage or input; 3 finished, but the result is not to be trusted \
(not converged, diverging rollouts, aborted flight; what was made is still written); 1 internal failure.\n\
Results go to stdout, logs and progress to stderr."
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::DemoArguments),
    Fit(fit::FitArguments),
    Check(check::CheckArguments),
    Mix(mix::MixArguments),
    Plan(plan::PlanArguments),
    Fly(fly::FlyArguments),
    Rehearse(rehearse::RehearseArguments),
    #[command(hide = true)]
    RehearseVehicle(rehearse_vehicle::RehearseVehicleArguments),
    Learn(learn::LearnArguments),
    Excite(excite::ExciteArguments),
    Score(score::ScoreArguments),
    Report(report::ReportArguments),
    Sweep(sweep::SweepArguments),
    Merge(merge::MergeArguments),
    Query(query::QueryArguments),
    Solve(solve::SolveArguments),
    Bench(bench::BenchArguments),
    Convert(convert::ConvertArguments),
    Calibrate(calibrate::CalibrateArguments),
    Onboard(onboard::OnboardArguments),
    Mocap(mocap::MocapArguments),
    View(view::ViewArguments),
    Completions(completions::CompletionsArguments),
    Man(man::ManArguments),
}

fn main() -> ExitCode {
    let command = help::flowing(Arguments::command());
    let matches = command.clone().get_matches();
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    outcome::exit_code(match &arguments.command {
        Command::Demo(arguments) => demo::run(arguments),
        Command::Fit(arguments) => fit::run(arguments),
        Command::Check(arguments) => check::run(arguments),
        Command::Mix(arguments) => mix::run(arguments),
        Command::Plan(arguments) => plan::run(arguments),
        Command::Fly(arguments) => fly::run(arguments),
        Command::Rehearse(arguments) => rehearse::run(arguments),
        Command::RehearseVehicle(arguments) => rehearse_vehicle::run(arguments),
        Command::Learn(arguments) => learn::run(arguments),
        Command::Excite(arguments) => excite::run(arguments),
        Command::Score(arguments) => score::run(arguments),
        Command::Report(arguments) => report::run(arguments),
        Command::Sweep(arguments) => sweep::run(arguments),
        Command::Merge(arguments) => merge::run(arguments),
        Command::Query(arguments) => query::run(arguments),
        Command::Bench(arguments) => bench::run(arguments),
        Command::Solve(arguments) => solve::run(arguments),
        Command::Convert(arguments) => convert::run(arguments),
        Command::Calibrate(arguments) => calibrate::run(arguments),
        Command::Onboard(arguments) => onboard::run(arguments),
        Command::Mocap(arguments) => mocap::run(arguments),
        Command::View(arguments) => view::run(arguments),
        Command::Completions(arguments) => completions::run(arguments, command),
        Command::Man(arguments) => man::run(arguments, &command),
    })
}
