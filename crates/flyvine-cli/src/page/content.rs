//! data.json: what the page is opened with.

use flyvine::DT;
use flyvine::flight::ControlStep;
use flyvine::report::paper::{PublishedError, published_error};
use flyvine::report::{Experiment, ReplayTrack, Results, replay_tracks};
use serde::Serialize;
use serde_json::{Value, json};

use super::paper_curves::{PaperPath, PaperSeries, paper_paths, paper_series};
use crate::outcome::{Blame, Failure};

/// A flight as the page is given it.
pub struct PageFlight {
    /// Plan and flight; without reference and prediction where there is no plan.
    pub experiment: Experiment,
    /// What the controller reported of its steps.
    pub steps: Vec<ControlStep>,
    /// Where it came from, if the page shows flights from several places.
    pub source: Option<String>,
}

/// A flight as the page reads it (`web/src/flight.js`).
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Shown<'a> {
    #[serde(flatten)]
    track: ReplayTrack<'a>,
    source: Option<&'a str>,
    steps: Vec<Value>,
    paper_paths: Vec<PaperPath>,
    paper_series: Vec<PaperSeries>,
    /// The paper's mean error on hardware, `[low, high]`, m.
    published: Option<[f64; 2]>,
    remark: Option<&'a str>,
}

/// data.json. A live page has one flight, of which no row was flown yet.
pub fn page_content(title: &str, flights: &[PageFlight], live: bool) -> Result<Vec<u8>, Failure> {
    let mut shown = Vec::with_capacity(flights.len());
    for flight in flights {
        // One at a time: flights from several places keep their order, and their names need not differ.
        let results = Results {
            experiments: vec![flight.experiment.clone()],
            ..Results::default()
        };
        for (experiment, track) in replay_tracks(&results).or_input()? {
            shown.push(serde_json::to_value(show(flight, experiment, track)).or_internal()?);
        }
    }
    serde_json::to_vec(&json!({ "dt": DT, "title": title, "live": live, "flights": shown })).or_internal()
}

fn show<'a>(flight: &'a PageFlight, experiment: &'a Experiment, track: ReplayTrack<'a>) -> Shown<'a> {
    Shown {
        track,
        source: flight.source.as_deref(),
        steps: flight
            .steps
            .iter()
            .map(|step| json!({ "row": step.row, "ms": step.step_ms, "status": step.report.status }))
            .collect(),
        paper_paths: paper_paths(experiment),
        paper_series: paper_series(experiment),
        published: published_error(experiment).map(|PublishedError { low_m, high_m }| [low_m, high_m]),
        remark: experiment.remark.as_deref(),
    }
}
