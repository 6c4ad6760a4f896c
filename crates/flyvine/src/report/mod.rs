//! Results in, tables, figures and a page out. Pure: nothing here reads files, clocks or the network.

mod results;
mod score;

pub use results::{
    Experiment, ExperimentKind, Finding, FlightRollout, HorizonError, ModelDiagnostics, Results, RunSummary,
    SolverSummary, SwingTask, Timing,
};
pub use score::{DistanceStatistics, Score, ScoreError, SwingTarget, score};
