//! All rows of a shard on all cores.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{Journal, Sweep, SweepError, journal_rows};

/// Every `of`-th row, beginning with the `number`-th: shards 1 to `of` make the whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    pub number: usize,
    /// Number of shards.
    pub of: usize,
}

impl Shard {
    /// Everything.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// The indices of its rows.
    pub fn indices(self, rows: usize) -> impl Iterator<Item = usize> {
        (self.number - 1..rows).step_by(self.of)
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/');
        let shard = parts.and_then(|(number, of)| {
            Some(Self {
                number: number.parse().ok()?,
                of: of.parse().ok()?,
            })
        });
        shard
            .filter(|shard| (1..=shard.of).contains(&shard.number))
            .ok_or_else(|| format!("found `{text}`, expected i/n with 1 ≤ i ≤ n, as 3/8"))
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_make_the_whole_without_overlap() {
        let mut rows: Vec<usize> = (1..=3)
            .flat_map(|number| Shard { number, of: 3 }.indices(11))
            .collect();
        rows.sort_unstable();
        assert_eq!(rows, (0..11).collect::<Vec<_>>());
    }

    #[test]
    fn a_shard_is_one_of_its_count() {
        assert_eq!("3/8".parse(), Ok(Shard { number: 3, of: 8 }));
        for wrong in ["0/8", "9/8", "3", "a/b", "1/0", "-1/2"] {
            let error = wrong.parse::<Shard>().unwrap_err();
            assert!(error.contains(wrong) && error.contains("expected i/n"), "{error}");
        }
    }
}
