//! A run: the folder with everything that one experiment used and made, and the files that more than one part reads.
//!
//! ```text
//! run.json                         title, vehicle, controller, seed
//! training/*.csv, test/*.csv       recordings
//! bank.json, check.json, hygiene.json
//! experiments/NAME/plan.json, flight.csv, score.json; arm.json where the arm's shape is known
//! report.html, figures/*.svg       made from the files above, and only from them
//! ```

mod folder;
mod score;
mod vehicle_file;

pub use folder::{
    ArmShapes, configuration_label, experiment_folder, flight_experiment, plan_experiment, read_experiment,
    read_experiments, read_results, write_experiment, write_report,
};
pub use score::{score_flight, swing_target};
pub use vehicle_file::{VehicleFileError, parse_vehicle_file, read_vehicle_file};

use std::path::PathBuf;

use crate::flight::FlightError;
use crate::model::ModelError;
use crate::report::{ReportError, ScoreError};
use crate::task::PlanError;

/// Why a run folder cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Neither a plan nor a check in it.
    #[error(
        "{} is not a run folder: found neither experiments/NAME/plan.json nor check.json",
        folder.display()
    )]
    NotARun {
        /// The folder.
        folder: PathBuf,
    },
    /// No experiment in it.
    #[error(
        "{} is not a run folder with flights: found no experiments/NAME/plan.json",
        folder.display()
    )]
    NoFlights {
        /// The folder.
        folder: PathBuf,
    },
    /// A file or folder that cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file that is not what its name says.
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What was found, with line and column.
        source: serde_json::Error,
    },
    /// A recording that cannot be read or written.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// A plan that cannot be read or written.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A bank that cannot be read.
    #[error(transparent)]
    Bank(#[from] ModelError),
    /// A flight that is not one of its plan.
    #[error(transparent)]
    Score(#[from] ScoreError),
    /// Results that make no report.
    #[error(transparent)]
    Report(#[from] ReportError),
}
