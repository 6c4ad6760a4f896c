//! The commands as a user types them, on the files of a demo run.

mod common;

use common::{demo_run, flyvine, repository};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;

#[test]
fn the_demo_flies_the_whole_paper() {
    let run = demo_run();
    let experiments = std::fs::read_dir(run.join("experiments")).unwrap().count();
    assert_eq!(experiments, 13);
    let page = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("lemniscate_10s_ES") && page.contains("swing_IL") && page.contains("deploy_5s"));
    for figure in ["lemniscates.svg", "swings.svg", "rollouts.svg"] {
        assert!(run.join("figures").join(figure).exists(), "{figure}");
    }
}

#[test]
fn the_same_seed_makes_the_same_bits() {
    let again = tempfile::tempdir().unwrap();
    // One thread instead of all of them: the split of the work must not show.
    flyvine()
        .env("RAYON_NUM_THREADS", "1")
        .arg("demo")
        .arg("--out")
        .arg(again.path().join("run"))
        .assert()
        .success();
    for file in [
        "bank.json",
        "check.json",
        "training/IS_swings.csv",
        "experiments/swing_EL/plan.json",
        "experiments/deploy_5s/flight.csv",
        "report.html",
    ] {
        let (first, second) = (demo_run().join(file), again.path().join("run").join(file));
        assert!(
            std::fs::read(first).unwrap() == std::fs::read(second).unwrap(),
            "{file} differs"
        );
    }
}

#[test]
fn a_lab_goes_from_recordings_to_a_scored_flight() {
    let (run, out) = (demo_run(), tempfile::tempdir().unwrap());
    let file = |name: &str| out.path().join(name);
    let training = run.join("training");
    let recordings = [
        "lemniscate_12s_to_4s",
        "swings",
        "pretzel",
        "small_lemniscate_7s_to_4s",
        "rising_rose",
    ]
    .map(|name| training.join(format!("ES_{name}.csv")));
    flyvine()
        .arg("fit")
        .args(&recordings)
        .arg("--out")
        .arg(file("bank.json"))
        .assert()
        .success();
    flyvine()
        .arg("check")
        .arg(file("bank.json"))
        .arg(training.join("ES_pretzel.csv"))
        .arg("--json")
        .assert()
        .success()
        .stdout(contains("\"one_step_rmse\"").and(contains("\"spectral_radius\"")));
    flyvine()
        .arg("plan")
        .arg(repository().join("examples/tasks/lemniscate_5s_ES.toml"))
        .arg("--bank")
        .arg(file("bank.json"))
        .arg("--out")
        .arg(file("plan.json"))
        .assert()
        .success()
        .stdout(contains("converged"));
    for controller in ["open-loop"] {
        flyvine()
            .args(["fly", "--vehicle", "sim", "--controller", controller, "--out"])
            .arg(file("flight.csv"))
            .arg(file("plan.json"))
            .assert()
            .success();
        let output = flyvine()
            .arg("score")
            .arg(file("flight.csv"))
            .arg("--plan")
            .arg(file("plan.json"))
            .arg("--json")
            .assert()
            .success();
        let score: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
        let mean = score["ee_vs_reference"]["mean_m"].as_f64().unwrap();
        assert!(
            mean < 0.09,
            "{controller}: {mean} m is worse than the paper's hardware"
        );
    }
    flyvine()
        .arg("convert")
        .arg(file("plan.json"))
        .arg(file("commands.csv"))
        .assert()
        .success();
    let commands = std::fs::read_to_string(file("commands.csv")).unwrap();
    assert_eq!(commands.lines().count(), 162, "a header and one row per knot");
    assert!(commands.starts_with("t_s,cmd_x,cmd_y,cmd_z,length_m,pressure_kpa\n0.00,"));
}

#[test]
fn a_flight_goes_through_convert_unchanged() {
    let out = tempfile::tempdir().unwrap();
    let (input, output) = (
        demo_run().join("experiments/swing_ES/flight.csv"),
        out.path().join("copy.csv"),
    );
    flyvine()
        .arg("convert")
        .arg(&input)
        .arg(&output)
        .assert()
        .success();
    assert_eq!(std::fs::read(input).unwrap(), std::fs::read(output).unwrap());
}

#[test]
fn a_report_can_be_made_again_from_its_folder() {
    let page = demo_run().join("report.html");
    let before = std::fs::read(&page).unwrap();
    flyvine()
        .arg("report")
        .arg(demo_run())
        .assert()
        .success()
        .stdout(contains("report.html"));
    assert!(before == std::fs::read(&page).unwrap());
}

#[test]
fn a_plan_flies_on_a_vehicle_in_another_process() {
    let out = tempfile::tempdir().unwrap();
    let vehicle = format!(
        "exec:python3 '{}'",
        repository().join("examples/vehicle.py").display()
    );
    flyvine()
        .arg("fly")
        .arg(demo_run().join("experiments/lemniscate_10s_ES/plan.json"))
        .args(["--vehicle", &vehicle, "--out"])
        .arg(out.path().join("flight.csv"))
        .assert()
        .success();
    let rows = std::fs::read_to_string(out.path().join("flight.csv"))
        .unwrap()
        .lines()
        .count();
    assert_eq!(rows, 242, "a header and one row per knot");
}

#[test]
fn a_vehicle_that_dies_aborts_the_flight_and_keeps_the_recording() {
    let out = tempfile::tempdir().unwrap();
    let script = r#"exec:sh -c 'read line; echo "{\"t_s\":0,\"qr\":[0,0,1.5],\"q\":[1,0,0,0],\"ee\":[0,0,0.8]}"; exit 7'"#;
    flyvine()
        .arg("fly")
        .arg(demo_run().join("experiments/lemniscate_10s_ES/plan.json"))
        .args(["--vehicle", script, "--out"])
        .arg(out.path().join("flight.csv"))
        .assert()
        .code(3)
        .stderr(contains("aborted"));
    assert_eq!(
        std::fs::read_to_string(out.path().join("flight.csv"))
            .unwrap()
            .lines()
            .count(),
        2
    );
}

#[test]
fn solve_prints_the_neutral_format() {
    let problem = repository().join("bench/problems/lem5_ES.json");
    let output = flyvine()
        .arg("solve")
        .arg(problem)
        .args(["--json", "--repeat", "2"])
        .assert()
        .success();
    let result: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    assert!((result["cost"].as_f64().unwrap() / 39.05654 - 1.0).abs() < 1e-6);
    assert_eq!(result["converged"], true);
    assert_eq!(result["u"].as_array().unwrap().len(), 160);
    assert_eq!(result["solve_ms_all"].as_array().unwrap().len(), 2);
}

#[test]
fn help_teaches_and_a_closed_pipe_is_no_error() {
    flyvine()
        .arg("--help")
        .assert()
        .success()
        .stdout(contains("Exit codes").and(contains("flyvine fit")));
    for command in [
        "demo", "fit", "check", "plan", "fly", "score", "report", "solve", "convert",
    ] {
        flyvine().args([command, "--help"]).assert().success();
    }
    flyvine().assert().code(2);
}
