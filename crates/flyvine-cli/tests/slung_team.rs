//! Real flights: Crazyflies that carry a payload together, seen from one of them (see the shared data's README).

#[path = "../../flyvine/tests/common/mod.rs"]
mod common;

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use common::shared_data;
use predicates::str::contains;

fn flyvine() -> Command {
    Command::cargo_bin("flyvine").unwrap()
}

/// The flights of two vehicles in `room`, at 20 Hz; `None`, said on stderr, without the shared data.
fn flights(room: &str, folder: &Path) -> Option<Vec<PathBuf>> {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let team = shared_data("slung_load/cf_slung_team")?.join("slung_load/cf_slung_team");
    let mut names: Vec<String> = std::fs::read_dir(&team)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.starts_with(&format!("2cfs_{room}")))
        .collect();
    names.sort();
    let convert = |name: &String| {
        let path = folder.join(name);
        flyvine()
            .arg("convert")
            .arg("--mapping")
            .arg(repository.join("examples/mappings/crazyflie_team.toml"))
            .args([&team.join(name), &path])
            .assert()
            .success();
        path
    };
    Some(names.iter().map(convert).collect())
}

#[test]
fn a_room_supports_its_own_flights_and_not_another_rooms() {
    let folder = tempfile::tempdir().unwrap();
    let (Some(window), Some(forest)) = (flights("window", folder.path()), flights("forest", folder.path()))
    else {
        return;
    };
    let (held_out, fitted) = window.split_last().unwrap();
    let bank = folder.path().join("bank.json");
    flyvine()
        .args(["fit", "--family", "lag", "--out"])
        .arg(&bank)
        .args(fitted)
        .assert()
        .success();
    let check = |flight: &Path| {
        let mut command = flyvine();
        command.args(["check", "--json"]).arg(&bank).arg(flight);
        command
    };
    let output = check(held_out).assert().success().get_output().stdout.clone();
    let report: serde_json::Value = serde_json::from_slice(&output).unwrap();
    let rollouts = report["flights"][0]["rollout"].as_array().unwrap();
    let rollout = rollouts
        .iter()
        .find(|rollout| rollout["horizon_s"] == 2.5)
        .unwrap();
    let median_m = rollout["median_m"].as_f64().unwrap();
    assert!(median_m <= 0.04, "{median_m}");
    check(&forest[0]).assert().code(3).stderr(contains(
        "the flights that the models were fitted on do not support these",
    ));
}
