//! `flyvine view`: flights on a local page.

use std::path::{Path, PathBuf};

use clap::Args;
use flyvine::flight::read_control_steps;
use flyvine::run::{flight_experiment, plan_experiment, read_experiment, read_experiments};
use flyvine::task::{Plan, read_plan};

use crate::console::{print, say};
use crate::flights::{load_flight, say_findings};
use crate::outcome::{Blame, CommandResult, Failure, bad_input};
use crate::page::{PageFlight, PageServer, open_browser, page_content};

/// Look at flights on a local page: 3-D replay of vehicle and arm, plots locked to it, plan against flight against the
/// paper's measured curves, several flights compared.
///
/// RUN is a run folder (`flyvine demo` makes one), one of its experiments, or a recording; recordings are compared with
/// the plan that --plan names. The page is served to this machine alone, at an address that carries a token, until Ctrl-C.
/// It works from the keyboard: press ? for its keys.
///
///   flyvine view run-demo
///   flyvine view first.mcap second.csv --plan plan.json
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct ViewArguments {
    /// Run folders, experiments of a run, or recordings (.csv, .mcap).
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// The plan that the recordings are flights of.
    #[arg(long, value_name = "PLAN.json")]
    plan: Option<PathBuf>,
    /// The page's port on 127.0.0.1; 0 takes any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
    /// Print the page's address and open no browser.
    #[arg(long)]
    no_open: bool,
}

/// Runs `flyvine view`.
pub fn run(arguments: &ViewArguments) -> CommandResult {
    let plan = match &arguments.plan {
        Some(path) => Some(read_plan(path).or_input()?),
        None => None,
    };
    let mut flights = Vec::new();
    for path in &arguments.runs {
        let several = arguments.runs.len() > 1;
        flights.extend(read(path, plan.as_ref(), several)?);
    }
    if flights.is_empty() {
        return bad_input("no flights: the run folders hold no experiments".to_owned());
    }
    let title = match arguments.runs.as_slice() {
        [only] => name(only),
        several => format!("{} and {} more", name(&several[0]), several.len() - 1),
    };
    let content = page_content(&title, &flights, false)?;
    let server = PageServer::start(content, arguments.port, None)?;
    print(server.url())?;
    if !arguments.no_open {
        open_browser(server.url());
    }
    say("serving until Ctrl-C");
    loop {
        std::thread::park();
    }
}

/// The flights of a run folder, of one experiment, or of a recording.
fn read(path: &Path, plan: Option<&Plan>, several: bool) -> Result<Vec<PageFlight>, Failure> {
    if !path.is_dir() {
        let (flight, _) = load_flight(path)?;
        let experiment = match plan {
            Some(plan) => plan_experiment(plan, flight, Vec::new()).or_input()?,
            None => flight_experiment(&name(path), flight),
        };
        return Ok(vec![PageFlight {
            experiment,
            steps: read_control_steps(path).or_input()?,
            source: several.then(|| name(path)),
        }]);
    }
    let (experiments, folder) = if path.join("plan.json").exists() {
        (
            vec![read_experiment(path, &mut say_findings).or_input()?],
            path.parent().unwrap_or(path).to_owned(),
        )
    } else {
        (
            read_experiments(path, &mut say_findings).or_input()?,
            path.join("experiments"),
        )
    };
    experiments
        .into_iter()
        .map(|experiment| {
            let recording = folder.join(&experiment.name).join("flight.csv");
            Ok(PageFlight {
                steps: match recording.exists() {
                    true => read_control_steps(&recording).or_input()?,
                    false => Vec::new(),
                },
                experiment,
                source: several.then(|| name(path)),
            })
        })
        .collect()
}

/// A path's last part, without extension.
fn name(path: &Path) -> String {
    let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let part = if path.is_dir() {
        path.file_name()
    } else {
        path.file_stem()
    };
    part.unwrap_or_default().to_string_lossy().into_owned()
}
