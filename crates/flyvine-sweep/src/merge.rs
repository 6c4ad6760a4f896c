//! From journals to the table.

use std::path::{Path, PathBuf};

use flyvine::file::write_whole;
use rayon::prelude::*;

use super::row::RowResult;
use super::table::parquet_bytes;
use super::{Sweep, SweepError, journal_rows};

/// Name of the table in a sweep's folder.
pub const RESULTS: &str = "results.parquet";

/// Every row's key and result, in order, from the journals in `folders`.
///
/// # Errors
/// A journal that cannot be read, or rows that none of them has.
pub fn collect(sweep: &Sweep, folders: &[PathBuf]) -> Result<Vec<(String, RowResult)>, SweepError> {
    let mut known = std::collections::BTreeMap::new();
    for folder in folders {
        known.extend(journal_rows(folder)?);
    }
    let keys: Vec<String> = (0..sweep.rows())
        .into_par_iter()
        .map(|index| sweep.key(index))
        .collect();
    let mut missing = keys
        .iter()
        .enumerate()
        .filter(|(_, key)| !known.contains_key(*key))
        .map(|(index, _)| index);
    if let Some(first) = missing.next() {
        return Err(SweepError::Missing {
            missing: 1 + missing.count(),
            rows: keys.len(),
            first,
        });
    }
    Ok(keys
        .into_iter()
        .map(|key| {
            let result = known[&key].clone();
            (key, result)
        })
        .collect())
}

/// Writes the table from the journals in `folders` to `folder`, whole or not at all, and returns its path and rows.
///
/// # Errors
/// As [`collect`]; the table cannot be written.
pub fn merge(
    sweep: &Sweep,
    folders: &[PathBuf],
    folder: &Path,
) -> Result<(PathBuf, Vec<(String, RowResult)>), SweepError> {
    let rows = collect(sweep, folders)?;
    let path = folder.join(RESULTS);
    write_whole(&path, &parquet_bytes(sweep, &rows)?).map_err(SweepError::file(&path))?;
    Ok((path, rows))
}
