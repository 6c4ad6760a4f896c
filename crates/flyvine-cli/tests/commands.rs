//! The commands as a user types them, on the files of a demo run.

mod common;

use std::io::{BufRead, BufReader};
use std::process::Stdio;

use common::{demo_run, flyvine, repository};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::json;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, connect};

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
        .args(["fit", "--family", "lag"])
        .args(&recordings)
        .arg("--out")
        .arg(file("bank.json"))
        .assert()
        .success();
    let output = flyvine()
        .arg("check")
        .arg(file("bank.json"))
        .arg(run.join("test/ES_test_mixed.csv"))
        .arg("--json")
        .output()
        .unwrap();
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(report["flights"][0]["one_step_rmse"]["ee_z"].is_number());
    assert!(report["models"][0]["spectral_radius"].as_f64().unwrap() < 1.0);
    let rollouts = report["flights"][0]["rollout"].as_array().unwrap();
    let diverges = rollouts
        .iter()
        .any(|rollout| rollout["diverged_share"].as_f64().unwrap() > 0.0);
    assert_eq!(output.status.code(), Some(if diverges { 3 } else { 0 }));
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
    flyvine()
        .args(["fly", "--vehicle", "sim", "--out"])
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
    assert!(mean < 0.09, "{mean} m is worse than the paper's hardware");
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

/// Feedback on a plan's gains may fail on a vehicle that the model knows badly; then it is aborted, and no command
/// leaves the room either way.
#[test]
fn a_physical_bank_is_reported_excited_and_learnt_with() {
    let (run, out) = (demo_run(), tempfile::tempdir().unwrap());
    let file = |name: &str| out.path().join(name);
    let recordings = ["pretzel", "swings", "small_lemniscate_7s_to_4s"]
        .map(|name| run.join("training").join(format!("ES_{name}.csv")));
    flyvine()
        .args(["fit", "--family", "physical", "--correction"])
        .args(&recordings)
        .arg("--out")
        .arg(file("bank.json"))
        .arg("--report")
        .arg(file("report"))
        .assert()
        .success()
        .stdout(
            contains("tilt_limit")
                .and(contains("band of confidence").and(contains("correction: on held-out"))),
        )
        .stderr(contains("first 10 s of every flight").and(contains("held-out rollouts")));
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(file(name)).unwrap()).unwrap()
    };
    let report = json("report/fit.json");
    let corner = &report["chosen"]["corners"][0];
    assert_eq!(corner["parameters"][0]["name"], "position_gain_xy");
    assert!(corner["parameters"][0]["standard_error"].as_f64().unwrap() > 0.0);
    assert_eq!(corner["timing"]["flights"].as_array().unwrap().len(), 3);

    let bank = |value: &str| format!("{value}={}", file("bank.json").display());
    let mix = |at: &str| {
        let mut command = flyvine();
        command.args([
            "mix",
            "--along",
            "payload_kg",
            &bank("0"),
            &bank("0.05"),
            "--at",
            at,
            "--out",
        ]);
        command.arg(file("mixed.json")).assert()
    };
    mix("0.06")
        .code(2)
        .stderr(contains("payload_kg = 0.06").and(contains("[0.0, 0.05]")));
    mix("0.02").success();
    let (fitted, mixed) = (json("bank.json"), json("mixed.json"));
    assert_eq!(mixed["provenance"]["between"]["at"], 0.02);
    let gain =
        |bank: &serde_json::Value| bank["models"][0]["model"]["parameters"]["position_gain_xy"].as_f64();
    assert!((gain(&mixed).unwrap() - gain(&fitted).unwrap()).abs() < 1e-12);

    let designed = flyvine()
        .arg("excite")
        .arg(file("bank.json"))
        .args([
            "--length",
            "0.7",
            "--duration",
            "20",
            "--candidates",
            "8",
            "--json",
        ])
        .arg("--out")
        .arg(file("excite.csv"))
        .arg("--compare")
        .arg(&recordings[0])
        .output()
        .unwrap();
    let gains: serde_json::Value = serde_json::from_slice(&designed.stdout).unwrap();
    let gain = |index: usize| gains[index]["information_gain_nats"].as_f64().unwrap();
    assert!(gain(0) > gain(1), "{gains}");
    let commands = std::fs::read_to_string(file("excite.csv")).unwrap();
    assert_eq!(commands.lines().count(), 401);

    flyvine()
        .arg("learn")
        .arg(repository().join("examples/tasks/lemniscate_10s_ES.toml"))
        .args(["--vehicle", "sim", "--rounds", "1", "--bank"])
        .arg(file("bank.json"))
        .arg("--out")
        .arg(file("learnt"))
        .assert()
        .success()
        .stdout(contains("to reference, cm"));
    let learnt = json("learnt/learn.json");
    let rounds = &learnt["rounds"];
    assert_eq!(rounds.as_array().unwrap().len(), 2);
    let miss = |round: usize| rounds[round]["miss_m"].as_f64().unwrap();
    let best = usize::from(miss(1) < miss(0));
    assert_eq!(learnt["best_round"], best);
    let kept = std::fs::read(file("learnt/plan.json")).unwrap();
    let flown = format!("learnt/experiments/lemniscate_10s_ES_round_{best}/plan.json");
    assert!(kept == std::fs::read(file(&flown)).unwrap());
    assert!(rounds[0]["lesson"]["trials"][0]["weight"].is_number() && rounds[1]["lesson"].is_null());
    assert!(file("learnt/experiments/lemniscate_10s_ES_round_1/flight.csv").exists());
}

#[test]
fn predictive_control_on_lag_models_ends_well_or_says_why_not() {
    let plan = demo_run().join("experiments/lemniscate_10s_ES/plan.json");
    let out = tempfile::tempdir().unwrap();
    let flight = out.path().join("flight.csv");
    let output = flyvine()
        .args([
            "fly".as_ref(),
            plan.as_os_str(),
            "--out".as_ref(),
            flight.as_os_str(),
        ])
        .args(["--vehicle", "sim", "--controller", "mpc"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    match output.status.code() {
        Some(0) => assert!(said.contains("steps: median"), "{said}"),
        code => assert!(
            code == Some(3) && said.contains("flight aborted at"),
            "{code:?}: {said}"
        ),
    }
    assert!(flight.exists());
}

#[test]
fn a_tracking_flight_stays_in_the_room_and_says_how_it_ended() {
    let out = tempfile::tempdir().unwrap();
    let recording = out.path().join("flight.csv");
    let output = flyvine()
        .arg("fly")
        .arg(demo_run().join("experiments/lemniscate_5s_ES/plan.json"))
        .args(["--vehicle", "sim", "--controller", "tracking", "--out"])
        .arg(&recording)
        .output()
        .unwrap();
    let flight = flyvine::flight::read_flight(&recording).unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    match output.status.code() {
        Some(0) => assert_eq!(flight.samples.len(), 161),
        Some(3) => assert!(stderr.contains("flight aborted at"), "{stderr}"),
        code => panic!("exit code {code:?}: {stderr}"),
    }
    for sample in &flight.samples {
        let [x, y, z] = sample.command;
        assert!(
            x.abs() <= 2.2 && y.abs() <= 2.2 && (0.8..=2.4).contains(&z),
            "{:?}",
            sample.command
        );
    }
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
        "demo", "fit", "check", "plan", "fly", "learn", "excite", "score", "report", "solve", "convert",
    ] {
        flyvine().args([command, "--help"]).assert().success();
    }
    flyvine().assert().code(2);
}

#[test]
fn a_vehicle_is_calibrated_on_recordings_and_judged_on_others() {
    let (run, out) = (demo_run(), tempfile::tempdir().unwrap());
    let file = |name: &str| out.path().join(name);
    let (start, calibrated, flight) = (file("start.toml"), file("vehicle.toml"), file("swings.csv"));
    std::fs::write(
        &start,
        "[autopilot.position]\nxy_p = 1.3\n[supervisor]\nreach_margin_m = 0.2\n",
    )
    .unwrap();
    let swings = std::fs::read_to_string(run.join("training/ES_swings.csv")).unwrap();
    let first_15_s: Vec<&str> = swings.lines().take(301).collect();
    std::fs::write(&flight, first_15_s.join("\n") + "\n").unwrap();
    let output = flyvine()
        .arg("calibrate")
        .arg(&flight)
        .arg("--hold-out")
        .arg(run.join("training/ES_rising_rose.csv"))
        .arg("--vehicle")
        .arg(&start)
        .arg("--out")
        .arg(&calibrated)
        .args([
            "--parameters",
            "autopilot.position.xy_p,arm.corners.empty_short.stiffness",
        ])
        .args(["--iterations", "4", "--json"])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // The built-in vehicle that flew the recordings has 1.54.
    let gain = report["parameters"][0]["value"].as_f64().unwrap();
    assert!((gain - 1.54).abs() < 0.02, "{report}");
    let hover = &report["hover"][0];
    assert!(
        (0.1..3.0).contains(&hover["frequency_hz"].as_f64().unwrap()),
        "{report}"
    );
    let held_out = &report["flights"][1];
    assert_eq!(held_out["role"], "held_out");
    let distance = |which: &str| held_out[which]["end_effector_m"].as_f64().unwrap();
    assert!(distance("calibrated") < 0.2 * distance("start"), "{report}");
    let written = std::fs::read_to_string(&calibrated).unwrap();
    assert!(
        written.contains("reach_margin_m"),
        "the supervisor's limits are kept"
    );
}

#[test]
fn a_foxglove_client_subscribes_to_a_flight_under_way() {
    let out = tempfile::tempdir().unwrap();
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("flyvine"))
        .args(["fly", "--vehicle", "sim", "--foxglove", "0", "--out"])
        .arg(out.path().join("flight.mcap"))
        .arg(demo_run().join("experiments/lemniscate_5s_ES/plan.json"))
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
    let address = said
        .find_map(|line| Some(line.unwrap().split_once("ws://")?.1.to_owned()))
        .expect("an address is printed");

    // Without the protocol's name, and from a foreign page, there is nothing to be had.
    assert!(connect(format!("ws://{address}")).is_err());
    let request = |origin: Option<&str>| {
        let mut request = format!("ws://{address}").into_client_request().unwrap();
        let headers = request.headers_mut();
        let protocol = HeaderValue::from_static("foxglove.websocket.v1");
        headers.insert("sec-websocket-protocol", protocol);
        if let Some(origin) = origin {
            headers.insert("origin", HeaderValue::from_str(origin).unwrap());
        }
        request
    };
    assert!(connect(request(Some("https://example.org"))).is_err());

    let (mut socket, _) = connect(request(None)).unwrap();
    let mut text = || match socket.read().unwrap() {
        Message::Text(text) => serde_json::from_str::<serde_json::Value>(&text).unwrap(),
        other => panic!("expected text, found {other:?}"),
    };
    assert_eq!(text()["op"], "serverInfo");
    let advertised = text();
    assert_eq!(advertised["op"], "advertise");
    let quadrotor = advertised["channels"]
        .as_array()
        .unwrap()
        .iter()
        .find(|channel| channel["topic"] == "/quadrotor")
        .unwrap();
    assert_eq!(quadrotor["schemaName"], "foxglove.PoseInFrame");
    assert_eq!(quadrotor["encoding"], "protobuf");
    let subscribe =
        json!({ "op": "subscribe", "subscriptions": [{ "id": 42, "channelId": quadrotor["id"] }] });
    socket.send(Message::text(subscribe.to_string())).unwrap();
    let mut times = Vec::new();
    while let Ok(message) = socket.read() {
        if let Message::Binary(frame) = message {
            assert_eq!(frame[0], 1, "message data");
            assert_eq!(frame[1..5], 42_u32.to_le_bytes());
            times.push(u64::from_le_bytes(frame[5..13].try_into().unwrap()));
            assert!(frame.len() > 13 + 9 * 7, "seven numbers");
        }
    }
    // The simulated vehicle flies its 8 s in real time, so most of them come after the subscription.
    assert!(times.len() > 10, "{} messages", times.len());
    assert!(times.windows(2).all(|pair| pair[1] > pair[0]));
    assert!(child.wait().unwrap().success());
}
