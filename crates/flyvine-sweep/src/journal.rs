//! The journal: results as they come, one JSON line each, appended and never rewritten.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::row::RowResult;
use super::{Shard, SweepError};

/// One line.
#[derive(Serialize, Deserialize)]
struct Line {
    key: String,
    result: RowResult,
}

/// A journal that this process appends to; no other can meanwhile.
#[derive(Debug)]
pub struct Journal {
    file: Mutex<File>,
    path: std::path::PathBuf,
}

impl Journal {
    /// Opens the journal of `shard` in `folder/journal`. A line that a killed process left unfinished is ended, and
    /// ignored from then on.
    ///
    /// # Errors
    /// It cannot be opened, or another process holds it.
    pub fn open(folder: &Path, shard: Shard) -> Result<Self, SweepError> {
        let folder = folder.join("journal");
        std::fs::create_dir_all(&folder).map_err(SweepError::file(&folder))?;
        let path = folder.join(format!("{}-of-{}.jsonl", shard.number, shard.of));
        let mut file = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .open(&path)
            .map_err(SweepError::file(&path))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(SweepError::Busy { path }),
            Err(TryLockError::Error(error)) => return Err(SweepError::file(&path)(error)),
        }
        end_last_line(&mut file).map_err(SweepError::file(&path))?;
        Ok(Self {
            file: Mutex::new(file),
            path,
        })
    }

    /// Appends the result of the row with this key, by one write.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn append(&self, key: &str, result: &RowResult) -> Result<(), SweepError> {
        let line = Line {
            key: key.to_owned(),
            result: result.clone(),
        };
        let mut text =
            serde_json::to_vec(&line).map_err(|source| SweepError::Json { what: "row", source })?;
        text.push(b'\n');
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(&text).map_err(SweepError::file(&self.path))
    }
}

/// Ends the last line if a killed process left it open.
fn end_last_line(file: &mut File) -> std::io::Result<()> {
    if file.seek(SeekFrom::End(0))? == 0 {
        return Ok(());
    }
    file.seek(SeekFrom::End(-1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    if last != *b"\n" {
        file.write_all(b"\n")?;
    }
    Ok(())
}

/// Every whole line of the journals in `folder/journal`, by key; none where there is no such folder. Lines that are not
/// whole are left out: their rows are computed again.
///
/// # Errors
/// A journal that cannot be read.
pub fn journal_rows(folder: &Path) -> Result<BTreeMap<String, RowResult>, SweepError> {
    let folder = folder.join("journal");
    let mut rows = BTreeMap::new();
    if !folder.exists() {
        return Ok(rows);
    }
    for entry in std::fs::read_dir(&folder).map_err(SweepError::file(&folder))? {
        let path = entry.map_err(SweepError::file(&folder))?.path();
        if path.extension().is_none_or(|extension| extension != "jsonl") {
            continue;
        }
        let bytes = std::fs::read(&path).map_err(SweepError::file(&path))?;
        for line in bytes.split(|byte| *byte == b'\n') {
            if let Ok(Line { key, result }) = serde_json::from_slice(line) {
                rows.insert(key, result);
            }
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::row::RowStatus;

    const ALL: Shard = Shard { number: 1, of: 1 };

    fn result(flown_s: f64) -> RowResult {
        RowResult {
            status: RowStatus::Aborted,
            cause: "a\nb".into(),
            flown_s,
            score: None,
        }
    }

    #[test]
    fn what_was_appended_comes_back_to_the_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        assert!(journal_rows(folder.path()).unwrap().is_empty());
        let awkward = 0.1 + 0.2;
        Journal::open(folder.path(), ALL)
            .unwrap()
            .append("k", &result(awkward))
            .unwrap();
        assert_eq!(journal_rows(folder.path()).unwrap()["k"], result(awkward));
    }

    #[test]
    fn a_torn_line_costs_its_row_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Journal::open(folder.path(), ALL).unwrap();
        open().append("a", &result(1.0)).unwrap();
        open().append("b", &result(2.0)).unwrap();
        let path = folder.path().join("journal/1-of-1.jsonl");
        let whole = std::fs::read(&path).unwrap();
        let first = whole.iter().position(|byte| *byte == b'\n').unwrap();
        for length in first + 1..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            open().append("c", &result(3.0)).unwrap();
            let rows = journal_rows(folder.path()).unwrap();
            let keys: Vec<&str> = rows.keys().map(String::as_str).collect();
            // The last cut leaves the whole line without its end.
            let expected: &[&str] = if length == whole.len() - 1 {
                &["a", "b", "c"]
            } else {
                &["a", "c"]
            };
            assert_eq!(keys, expected, "cut at {length}");
        }
    }

    #[test]
    fn a_journal_has_one_writer() {
        let folder = tempfile::tempdir().unwrap();
        let held = Journal::open(folder.path(), ALL).unwrap();
        assert!(matches!(
            Journal::open(folder.path(), ALL),
            Err(SweepError::Busy { .. })
        ));
        assert!(Journal::open(folder.path(), Shard { number: 1, of: 2 }).is_ok());
        drop(held);
        assert!(Journal::open(folder.path(), ALL).is_ok());
    }
}
