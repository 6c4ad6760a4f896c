//! Results in, tables, figures and a page out.
//!
//! [`score()`] compares one flight with its plan. [`Results`] gathers what a run made; [`figures()`] redraws the paper's
//! figures from it with the paper's measured curves behind, and [`html()`] makes one self-contained page of tables,
//! figures and a 3-D replay that works offline, from `file://`.
//!
//! Pure: nothing here reads files, clocks or the network, and it knows of no model, solver or simulator. The same
//! results make the same bytes.

mod escape;
mod figures;
mod html;
pub mod paper;
mod replay;
mod results;
mod score;
mod tables;
#[cfg(test)]
mod tests;

pub use figures::{ErrorDistribution, SuccessMap, error_distributions, success_map};
pub use figures::{Figure, figures};
pub use html::{MODELS, THREE, html};
pub use replay::{ReplayTrack, replay_tracks};
pub use results::{
    Against, Experiment, ExperimentKind, Finding, FlightRollout, HorizonError, ModelDiagnostics, ReportError,
    Results, RunSummary, SolverSummary, SwingTask, Timing,
};
pub use score::{DistanceStatistics, Score, ScoreError, SwingTarget, score};
