//! Recordings for tests that are not part of the project.

#![allow(dead_code)] // no test binary uses all of it

use flyvine::flight::{Flight, HygieneOptions, clean, read_flight};
use std::path::{Path, PathBuf};

/// The shared data, or `None` (said on stderr) where `folder` in them is absent and not required.
pub fn shared_data(folder: &str) -> Option<PathBuf> {
    let beside_workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let data = std::env::var_os("FLYVINE_SHARED_DATA").map_or(beside_workspace, PathBuf::from);
    if data.join(folder).is_dir() {
        return Some(data);
    }
    let required = std::env::var_os("FLYVINE_REQUIRE_SHARED_DATA").is_some_and(|value| value == "1");
    assert!(
        !required,
        "shared data required, but {} is absent",
        data.join(folder).display()
    );
    eprintln!("skipped: no shared data at {}", data.join(folder).display());
    None
}

/// The recordings in `folder` whose file names match, by name, cleaned.
pub fn flights(folder: &Path, matches: impl Fn(&str) -> bool, read: impl Fn(&Path) -> Flight) -> Vec<Flight> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| matches(path.file_name().unwrap().to_str().unwrap()))
        .collect();
    paths.sort();
    let cleaned = |path: &PathBuf| {
        let mut flight = read(path);
        clean(&mut flight, &HygieneOptions::default());
        flight
    };
    paths.iter().map(cleaned).collect()
}

/// The reference vehicle's flights whose file names match, as [`flights`].
pub fn reference_flights(matches: impl Fn(&str) -> bool) -> Option<Vec<Flight>> {
    let folder = shared_data("flights")?.join("flights");
    Some(flights(&folder, matches, |path| read_flight(path).unwrap()))
}
