//! Recordings for tests that are not part of the project.

use std::path::PathBuf;

/// The CSV files in a folder of the shared data, sorted, or `None` (said on stderr) where it is absent and
/// not required.
#[expect(clippy::print_stderr, reason = "a skipped test must say so")]
pub(crate) fn shared_csv_files(folder: &str) -> Option<Vec<PathBuf>> {
    let default = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data"));
    let folder = std::env::var_os("FLYVINE_SHARED_DATA")
        .map_or(default, PathBuf::from)
        .join(folder);
    if !folder.is_dir() {
        let required = std::env::var_os("FLYVINE_REQUIRE_SHARED_DATA").is_some_and(|value| value == "1");
        assert!(
            !required,
            "shared data is required, but {} is absent",
            folder.display()
        );
        eprintln!("skipped: no shared data at {}", folder.display());
        return None;
    }
    let entries = std::fs::read_dir(&folder).expect("a readable folder");
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.expect("a readable folder").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "csv"))
        .collect();
    files.sort();
    assert!(!files.is_empty(), "no CSV files in {}", folder.display());
    Some(files)
}
