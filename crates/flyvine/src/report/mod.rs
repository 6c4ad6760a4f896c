//! Results in, tables, figures and a page out. Pure: nothing here reads files, clocks or the network.

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

pub use figures::{Figure, figures};
pub use html::html;
pub use results::{
    Against, Experiment, ExperimentKind, Finding, FlightRollout, HorizonError, ModelDiagnostics, ReportError,
    Results, RunSummary, SolverSummary, SwingTask, Timing,
};
pub use score::{DistanceStatistics, Score, ScoreError, SwingTarget, score};
