//! Why a sweep cannot be read, run or merged.

use std::path::PathBuf;

use flyvine::control::FlyingError;
use flyvine::model::ModelError;
use flyvine::run::VehicleFileError;
use flyvine::task::{PlanError, TaskError};

/// Why a sweep cannot be read, run or merged. What goes wrong in one of its flights is no error, but that row's status.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// A file or folder that cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not a sweep's file: wrong TOML, unknown key, wrong type.
    #[error("{file}: {message}")]
    Syntax {
        /// The file.
        file: String,
        /// Line, column and reason.
        message: String,
    },
    /// A field of the sweep that makes no sense.
    #[error("sweep `{sweep}`, {field}: found {found}, expected {expected}")]
    Field {
        /// The sweep's name.
        sweep: String,
        /// Which field.
        field: String,
        /// What it says.
        found: String,
        /// What would be accepted.
        expected: String,
    },
    /// A plan that cannot be read or made.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A task that cannot be read.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// A bank that cannot be read.
    #[error(transparent)]
    Bank(#[from] ModelError),
    /// A vehicle's file that cannot be used.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// A plan that cannot be flown with a control law of the sweep.
    #[error("sweep `{sweep}`: plan {plan} cannot be flown with `{controller}`: {source}")]
    Flying {
        /// The sweep's name.
        sweep: String,
        /// The plan's task.
        plan: String,
        /// The control law.
        controller: &'static str,
        /// Why.
        source: Box<FlyingError>,
    },
    /// Another process is working on the same shard.
    #[error("{}: another process is computing this shard; wait for it, or take another one", path.display())]
    Busy {
        /// The journal.
        path: PathBuf,
    },
    /// Rows that no journal has.
    #[error("{missing} of {rows} rows are missing: run `flyvine sweep` for them (the first is row {first})")]
    Missing {
        /// Rows missing.
        missing: usize,
        /// Rows of the sweep.
        rows: usize,
        /// Index of the first, from 0.
        first: usize,
    },
    /// No row has this key, or several do.
    #[error("key `{key}`: {found} rows begin with it; expected exactly one")]
    Key {
        /// What was asked for.
        key: String,
        /// Rows that match.
        found: usize,
    },
    /// The table cannot be written.
    #[error("results: {0}")]
    Table(#[from] parquet::errors::ParquetError),
    /// A value that cannot be written as JSON, or read from it.
    #[error("{what}: {source}")]
    Json {
        /// What.
        what: &'static str,
        /// The reason.
        source: serde_json::Error,
    },
}

impl SweepError {
    /// An error of the system about `path`.
    pub(crate) fn file(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::File { path, source }
    }
}
