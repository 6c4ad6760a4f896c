//! One demo run, shared by the tests of a binary: every other command has real files to work on.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use assert_cmd::Command;
use tempfile::TempDir;

/// The built binary.
pub fn flyvine() -> Command {
    Command::cargo_bin("flyvine").expect("the binary is built")
}

/// The run folder of `flyvine demo`.
#[allow(dead_code)] // not every test wants it
pub fn demo_run() -> &'static Path {
    static RUN: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, run) = RUN.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let run = folder.path().join("run");
        flyvine().arg("demo").arg("--out").arg(&run).assert().success();
        (folder, run)
    });
    run
}

/// The repository's root.
#[allow(dead_code)] // not every test wants it
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A file in `folder` that says which of motion capture's bodies is which.
#[allow(dead_code)] // not every test wants it
pub fn bodies_file(folder: &Path) -> PathBuf {
    let path = folder.join("bodies.toml");
    let bodies = "[quadrotor]\nname = \"drone\"\n[end_effector]\nname = \"tip\"\n";
    std::fs::write(&path, bodies).expect("a writable folder");
    path
}
