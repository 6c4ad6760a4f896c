//! The Python package's tests, on the extension as `cargo` built it.
//!
//! The package is put together in a folder of its own and tested by pytest there, so that nothing needs to be installed
//! but Python, numpy and pytest. `pip install ./crates/flyvine-py` builds the same extension by maturin.

#![allow(clippy::print_stdout)] // says that it skips

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What the tests compare with.
const PEERS: [&str; 5] = ["numpy", "pytest", "scipy", "statsmodels", "pandas"];

#[test]
fn the_python_package_passes_its_tests() {
    let python = std::env::var("FLYVINE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = |module: &str| {
        Command::new(&python)
            .args(["-c", &format!("import {module}")])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success())
    };
    let absent: Vec<&str> = PEERS.into_iter().filter(|module| !has(module)).collect();
    if !absent.is_empty() {
        let required = std::env::var_os("FLYVINE_REQUIRE_PEERS").is_some_and(|value| value == "1");
        assert!(
            !required,
            "{python} lacks {absent:?}, which FLYVINE_REQUIRE_PEERS asks for"
        );
        println!("skipped: {python} lacks {absent:?}");
        return;
    }
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let package = folder.path().join("flyvine");
    std::fs::create_dir(&package).unwrap();
    for entry in std::fs::read_dir(here.join("python/flyvine")).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            std::fs::copy(&path, package.join(path.file_name().unwrap())).unwrap();
        }
    }
    std::fs::copy(extension(), package.join("_flyvine.abi3.so")).unwrap();
    let status = Command::new(&python)
        .args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"])
        .arg(here.join("tests"))
        .env("PYTHONPATH", folder.path())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .status()
        .unwrap();
    assert!(status.success(), "pytest: {status}");
}

/// The extension beside this test's own binary.
fn extension() -> PathBuf {
    let name = format!(
        "{}_flyvine{}",
        std::env::consts::DLL_PREFIX,
        std::env::consts::DLL_SUFFIX
    );
    let binary = std::env::current_exe().unwrap();
    let path = binary.parent().unwrap().join(name);
    assert!(path.exists(), "{} was not built", path.display());
    path
}
