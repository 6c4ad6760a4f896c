//! Sweeps: one plan or many, flown on many simulated vehicles.
//!
//! A sweep's file (TOML) says what is flown (plans, or tasks on a bank), with which control laws, on which vehicles
//! (a grid of parameters, and spreads that every seed draws from) and with how many seeds. Its flights are numbered; each
//! is one row of a table.
//!
//! - [`Sweep::read`] → [`Sweep`]: the numbered rows, [`Sweep::compute`] for one of them.
//! - [`run`]: all rows of a [`Shard`] on all cores into a folder's journal; [`merge`]: the journals of any number of
//!   folders into one Parquet file.
//! - [`summarize`]: shares of success, distributions of errors and the worst flights, as tables and figures.
//! - [`slurm_script`]: the same on a cluster, as an array of jobs.
//!
//! A row is addressed by its content: [`Sweep::key`] is a hash of everything that determines it (plan, control law,
//! vehicle, limits, seed, version). A row whose key is in the journal is not computed again, whichever sweep it was
//! computed for. The journal is appended to line by line, so that a process killed at any moment loses the rows in
//! flight and nothing else; the table is made from the journal, so that its bytes depend neither on how often the work was
//! interrupted nor on threads, shards or machines (of one kind of processor: others may round differently).

mod error;
mod file;
mod journal;
mod merge;
mod parameters;
mod row;
mod run;
mod slurm;
mod summary;
mod sweep;
mod table;

pub use error::SweepError;
pub use file::{Success, SweepFile};
pub use flyvine::Shard;
pub use journal::{Journal, journal_rows};
pub use merge::{RESULTS, collect, merge};
pub use parameters::Spread;
pub use row::{RowResult, RowStatus};
pub use run::{Progress, RunReport, run};
pub use slurm::{SlurmOptions, slurm_script};
pub use summary::{Group, Summary, WorstRow, summarize};
pub use sweep::{Row, Sweep};
pub use table::parquet_bytes;
