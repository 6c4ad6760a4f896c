//! All rows of a shard on all cores.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use flyvine::Shard;
use rayon::prelude::*;

use super::{Journal, Sweep, SweepError, journal_rows};

/// Where a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Rows of the shard that this run has computed.
    pub computed: usize,
    /// Rows that it has to compute.
    pub to_compute: usize,
}

/// What a run did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunReport {
    /// Rows of the shard.
    pub rows: usize,
    /// Rows that were in the journal.
    pub kept: usize,
    /// Rows that were computed.
    pub computed: usize,
}

/// Computes every row of `shard` that no journal in `folder` has. `progress` is called from many threads, with every
/// row.
///
/// # Errors
/// The journal cannot be read or written, or another process computes this shard.
pub fn run(
    sweep: &Sweep,
    folder: &Path,
    shard: Shard,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<RunReport, SweepError> {
    let journal = Journal::open(folder, shard)?;
    let known = journal_rows(folder)?;
    let indices: Vec<usize> = shard.indices(sweep.rows()).collect();
    let keys: Vec<String> = indices.par_iter().map(|&index| sweep.key(index)).collect();
    // Equal rows are computed once.
    let mut seen = BTreeSet::new();
    let missing: Vec<(usize, &str)> = indices
        .iter()
        .copied()
        .zip(keys.iter().map(String::as_str))
        .filter(|(_, key)| !known.contains_key(*key) && seen.insert(*key))
        .collect();
    let done = AtomicUsize::new(0);
    let at = |computed| {
        progress(Progress {
            computed,
            to_compute: missing.len(),
        });
    };
    at(0);
    // One row at a time: rows differ in cost, and a flight outweighs the scheduling by far.
    missing.par_iter().with_max_len(1).try_for_each(|(index, key)| {
        journal.append(key, &sweep.compute(*index))?;
        at(done.fetch_add(1, Ordering::Relaxed) + 1);
        Ok::<(), SweepError>(())
    })?;
    Ok(RunReport {
        rows: indices.len(),
        kept: indices.len() - missing.len(),
        computed: missing.len(),
    })
}
