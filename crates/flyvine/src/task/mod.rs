//! What the end effector shall do: task files, their references, the optimal-control problem that they
//! pose on a bank, and the plan that solves it.
//!
//! A task file (TOML) has a name, the arm's configuration, exactly one of the tables `[lemniscate]`,
//! `[swing]`, `[deploy]` and `[waypoints]`, and optionally weights, bounds, obstacles and a command reference; what is
//! left out takes the paper's values (Jitosho et al., Sec. IV).

mod command_reference;
mod constraints;
mod file;
mod growth;
mod lemniscate;
mod path;
mod plan;
mod planning;
mod problem;
mod reference;
mod solve;
mod swing;
mod training;
mod waypoints;

pub use command_reference::CommandReference;
pub(crate) use constraints::Constraints;
pub use constraints::{Contact, Obstacle, Shape, SupportDemand, Tube};
pub use file::{
    Bounds, CommandChange, CommandShaping, Deploy, Lemniscate, Motion, SignalBound, Swing, Task, Waypoint,
    Waypoints, Weights,
};
pub use growth::Growth;
pub use plan::{
    CommandReferenceSummary, MemberPrediction, PLAN_SCHEMA_VERSION, Plan, PlanError, PlanOptions, Provenance,
    Sensitivity, SolveSummary, read_plan, write_plan, write_plan_csv,
};
pub use planning::{make_corrected_plan, make_ensemble_plan, make_plan};
pub use problem::pose_problem;
pub use reference::Reference;
pub use training::{TrainingFlight, test_flight, training_flights};

/// Why a task cannot be posed.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// The file could not be read.
    #[error("cannot read the task file {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a task: wrong TOML, unknown key, missing key, wrong type.
    #[error("{path} is not a task file:\n{message}")]
    Parse {
        /// The file.
        path: String,
        /// Line, column and reason, as the TOML parser gives them.
        message: String,
    },
    /// Not exactly one motion was given.
    #[error(
        "task `{task}`: found {found} of the tables [lemniscate], [swing], [deploy], [waypoints]; expected exactly one"
    )]
    MotionCount {
        /// The task's name.
        task: String,
        /// How many were found.
        found: usize,
    },
    /// A value cannot be flown.
    #[error("task `{task}`, field `{field}`: found {found}, expected {expected}")]
    Value {
        /// The task's name.
        task: String,
        /// The field, dotted.
        field: String,
        /// What was found.
        found: String,
        /// What would be accepted.
        expected: String,
    },
}

impl TaskError {
    fn value(task: &str, field: &str, found: impl std::fmt::Display, expected: &str) -> Self {
        Self::Value {
            task: task.to_owned(),
            field: field.to_owned(),
            found: found.to_string(),
            expected: expected.to_owned(),
        }
    }
}
