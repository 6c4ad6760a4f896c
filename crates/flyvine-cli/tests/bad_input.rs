//! Broken inputs: each is refused with exit code 2 and one screen that names place, found and expected, and leaves no
//! file behind.

mod common;

use std::path::{Path, PathBuf};

use common::{demo_run, flyvine, repository};
use tempfile::TempDir;

/// A folder with the input under test; everything a command writes goes to `out` in it.
struct Case {
    folder: TempDir,
}

impl Case {
    fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    fn write(&self, name: &str, contents: impl AsRef<[u8]>) -> PathBuf {
        let path = self.folder.path().join(name);
        std::fs::write(&path, contents).unwrap();
        path
    }

    /// Runs flyvine with `arguments`, where `<OUT>` stands for a file that must not appear (brackets: no random
    /// name of a folder has them).
    fn refuses(&self, arguments: &[&str], says: &[&str]) {
        let out = self.folder.path().join("out.csv");
        let arguments: Vec<String> = arguments
            .iter()
            .map(|argument| argument.replace("<OUT>", &out.display().to_string()))
            .collect();
        let assert = flyvine().args(&arguments).assert();
        let output = assert.get_output();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}\n{stderr}");
        assert!(stderr.lines().count() <= 24, "more than one screen: {stderr}");
        let longest = stderr.lines().map(|line| line.chars().count()).max();
        assert!(longest <= Some(400), "a line of {longest:?} characters");
        for word in says {
            assert!(
                stderr.contains(word),
                "{arguments:?}: expected `{word}` in:\n{stderr}"
            );
        }
        assert!(!out.exists(), "{arguments:?} left a file behind");
        let leftovers = std::fs::read_dir(self.folder.path()).unwrap().count();
        assert!(leftovers <= 2, "temporary files left behind");
    }

    fn refuses_flight(&self, contents: impl AsRef<[u8]>, says: &[&str]) {
        let path = self.write("flight.csv", contents);
        self.refuses(&["convert", &text(&path), "<OUT>"], says);
    }

    fn refuses_task(&self, contents: &str, says: &[&str]) {
        let path = self.write("task.toml", contents);
        let bank = text(&demo_run().join("bank.json"));
        self.refuses(&["plan", &text(&path), "--bank", &bank, "--out", "<OUT>"], says);
    }

    fn refuses_bank(&self, contents: impl AsRef<[u8]>, says: &[&str]) {
        let path = self.write("bank.json", contents);
        let task = text(&repository().join("examples/tasks/swing_ES.toml"));
        self.refuses(&["plan", &task, "--bank", &text(&path), "--out", "<OUT>"], says);
    }

    fn refuses_plan(&self, contents: impl AsRef<[u8]>, says: &[&str]) {
        let path = self.write("plan.json", contents);
        self.refuses(&["fly", &text(&path), "--vehicle", "sim", "--out", "<OUT>"], says);
    }

    fn refuses_problem(&self, change: impl Fn(&mut serde_json::Value), says: &[&str]) {
        let contents = std::fs::read(repository().join("bench/problems/kick_ES.json")).unwrap();
        let mut problem: serde_json::Value = serde_json::from_slice(&contents).unwrap();
        change(&mut problem);
        let path = self.write("problem.json", problem.to_string());
        self.refuses(&["solve", &text(&path), "--json"], says);
    }
}

fn text(path: &Path) -> String {
    path.display().to_string()
}

/// A good flight of 40 rows, for breaking.
fn good_flight() -> String {
    let recording =
        std::fs::read_to_string(demo_run().join("experiments/lemniscate_10s_ES/flight.csv")).unwrap();
    recording
        .lines()
        .take(41)
        .map(|line| format!("{line}\n"))
        .collect()
}

/// The good flight with cell (`row`, `column`) replaced; row 0 is the first after the header.
fn with_cell(row: usize, column: &str, value: &str) -> String {
    let flight = good_flight();
    let header: Vec<&str> = flight.lines().next().unwrap().split(',').collect();
    let column = header.iter().position(|name| *name == column).unwrap();
    let replace = |(index, line): (usize, &str)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if index == row + 1 {
            cells[column] = value;
        }
        cells.join(",") + "\n"
    };
    flight.lines().enumerate().map(replace).collect()
}

/// The good flight with every number of the columns that start with `prefix` scaled.
fn scaled(prefixes: &[&str], factor: f64) -> String {
    let flight = good_flight();
    let header: Vec<&str> = flight.lines().next().unwrap().split(',').collect();
    let scale = |(index, line): (usize, &str)| {
        let cells = line.split(',').zip(&header).map(|(cell, name)| {
            if index > 0 && prefixes.iter().any(|prefix| name.starts_with(prefix)) {
                (cell.parse::<f64>().unwrap() * factor).to_string()
            } else {
                cell.to_owned()
            }
        });
        cells.collect::<Vec<_>>().join(",") + "\n"
    };
    flight.lines().enumerate().map(scale).collect()
}

#[test]
fn broken_flights() {
    let flight = good_flight();
    let case = Case::new();
    let missing = case.folder.path().join("nowhere.csv");
    case.refuses(&["convert", &text(&missing), "<OUT>"], &["nowhere.csv"]);
    Case::new().refuses_flight("", &["flight.csv"]);
    Case::new().refuses_flight(flight.lines().next().unwrap(), &["flight.csv"]);
    Case::new().refuses_flight(flight.replacen("qr_qw", "quat_w", 1), &["qr_qw"]);
    Case::new().refuses_flight(flight.replacen("ee_y", "ee_x", 1), &["ee_x"]);
    Case::new().refuses_flight(with_cell(7, "cmd_y", "NaN"), &["line 9", "cmd_y", "NaN"]);
    Case::new().refuses_flight(with_cell(7, "ee_z", "inf"), &["line 9", "ee_z"]);
    Case::new().refuses_flight(with_cell(3, "qr_x", "half"), &["line 5", "qr_x", "half"]);
    Case::new().refuses_flight(with_cell(3, "qr_x", ""), &["line 5", "qr_x"]);
    Case::new().refuses_flight(with_cell(10, "t_s", "0.1"), &["line 12", "t_s"]);
    Case::new().refuses_flight(with_cell(5, "qr_qw", "0.2"), &["line 7", "norm 0.2"]);
    Case::new().refuses_flight(with_cell(5, "length_m", "-0.7"), &["line 7", "length_m", "-0.7"]);
    Case::new().refuses_flight(
        scaled(&["qr_x", "qr_y", "qr_z", "ee_", "cmd_"], 1000.0),
        &["millimetres"],
    );
    Case::new().refuses_flight(scaled(&["t_s"], 1000.0), &["milliseconds"]);
    let (half, _) = flight.split_at(flight.len() - 60);
    Case::new().refuses_flight(half, &["line 41"]);
    Case::new().refuses_flight(
        [b"t_s,length_m\n".as_slice(), &[0xff, 0xfe, 0, 1, 2]].concat(),
        &["flight.csv"],
    );
}

#[test]
fn broken_mappings() {
    let mapping =
        std::fs::read_to_string(repository().join("examples/mappings/crazyflie_slung.toml")).unwrap();
    for (contents, says) in [
        (format!("{mapping}\nsurprise = 1\n"), "surprise"),
        (mapping.replace("\"quad_x\"", "\"quadrotor_x\""), "quadrotor_x"),
        ("this is no TOML".to_owned(), "mapping.toml"),
    ] {
        let case = Case::new();
        let path = case.write("mapping.toml", contents);
        let log = case.write(
            "log.csv",
            "t,cmd_x,cmd_y,cmd_z,quad_x,quad_y,quad_z,quat_x,quat_y,quat_z,quat_w,payload_x,payload_y,payload_z,ok,cmd_vx,cmd_vy,cmd_vz\n\
             0.00,0,0,1,0,0,1,0,0,0,1,0,0,0.5,1,0,0,0\n0.01,0,0,1,0,0,1,0,0,0,1,0,0,0.5,1,0,0,0\n",
        );
        let out = case.folder.path().join("out.csv");
        let assert = flyvine()
            .arg("convert")
            .arg("--mapping")
            .arg(path)
            .arg(log)
            .arg(&out)
            .assert()
            .code(2);
        let stderr = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
        assert!(stderr.contains(says), "expected `{says}` in:\n{stderr}");
        assert!(!out.exists());
    }
}

#[test]
fn recordings_that_cannot_be_fitted() {
    let training = demo_run().join("training");
    let recording = text(&training.join("ES_pretzel.csv"));
    Case::new().refuses(
        &["fit", &recording, &recording, "--out", "<OUT>"],
        &["ES_pretzel", "twice"],
    );
    let case = Case::new();
    let short = case.write("short.csv", good_flight());
    case.refuses(
        &["fit", "--family", "lag", &text(&short), "--out", "<OUT>"],
        &["37 usable rows", "496 coefficients"],
    );
    let three = ["ES", "IS", "EL"].map(|corner| text(&training.join(format!("{corner}_pretzel.csv"))));
    Case::new().refuses(
        &["fit", &three[0], &three[1], &three[2], "--out", "<OUT>"],
        &["corner"],
    );
    Case::new().refuses(
        &[
            "fit",
            &recording,
            "--family",
            "lag",
            "--correction",
            "--out",
            "<OUT>",
        ],
        &["--correction", "physical"],
    );
    Case::new().refuses(
        &["fit", &recording, "--height-ridge=-1", "--out", "<OUT>"],
        &["--height-ridge", "-1"],
    );
    Case::new().refuses(
        &["fit", &recording, "--lags", "99", "--out", "<OUT>"],
        &["lags", "99"],
    );
}

#[test]
fn broken_tasks() {
    let swing = std::fs::read_to_string(repository().join("examples/tasks/swing_ES.toml")).unwrap();
    let lemniscate =
        std::fs::read_to_string(repository().join("examples/tasks/lemniscate_5s_ES.toml")).unwrap();
    let task = |contents: &str, says: &[&str]| Case::new().refuses_task(contents, says);
    task(&swing.replace("target_m", "goal_m"), &["goal_m"]);
    task(
        &swing.replace("target_time_s = 1.25", "target_time_s = 9.0"),
        &["swing.target_time_s", "9"],
    );
    task(
        &swing.replace("lower = [-2.0", "lower = [2.5"),
        &["command_bounds", "2.5"],
    );
    task(
        &swing.replace("weight = 30.0", "weight = -1.0"),
        &["command_change.weight", "-1"],
    );
    task(
        &swing.replace("weight = 30.0", "max_m = 0.0"),
        &["command_change.max_m", "0"],
    );
    task(
        &format!("{swing}\n[lemniscate]\nperiod_s = 5.0\nramp_s = 3.0\n"),
        &["exactly one"],
    );
    task(
        &lemniscate.replace("period_s = 5.0", "period_s = -5.0"),
        &["lemniscate.period_s", "-5"],
    );
    task(
        &lemniscate.replace("period_s = 5.0", "period_s = nan"),
        &["lemniscate.period_s", "NaN"],
    );
    task(
        &lemniscate
            .replace("period_s = 5.0", "period_s = 0.01")
            .replace("ramp_s = 3.0", "ramp_s = 0.01"),
        &["knots"],
    );
    task(
        &lemniscate.replace("period_s = 5.0", "period_s = 1e300"),
        &["found 18446744073709551615 knots", "100000"],
    );
    // A bank instead of a task: one line of a hundred thousand characters.
    task(
        &std::fs::read_to_string(demo_run().join("bank.json")).unwrap(),
        &["not a task", "line 1, column 1"],
    );
    task(
        &lemniscate.replace("length_m = 0.7", "length_m = 1.4"),
        &["1.4", "1.000"],
    );
    task(
        &format!("{lemniscate}\n[[state_bounds]]\nsignal = \"qr_w\"\nupper = 1.0\n"),
        &["qr_w", "ee_z"],
    );
    task(
        &lemniscate.replace("end_effector = 20.0", "end_effector = -1.0"),
        &["weights.end_effector", "-1"],
    );
}

#[test]
fn broken_banks_and_plans() {
    let bank = std::fs::read_to_string(demo_run().join("bank.json")).unwrap();
    let refuse = |contents: &str, says: &[&str]| Case::new().refuses_bank(contents, says);
    refuse("not json", &["bank.json"]);
    refuse(&bank[..bank.len() / 2], &["bank.json"]);
    refuse(
        &bank.replacen("\"schema_version\":2", "\"schema_version\":99", 1),
        &["schema_version", "99"],
    );
    refuse(
        &bank.replacen("\"length\":\"m\"", "\"length\":\"mm\"", 1),
        &["units"],
    );
    refuse("{}", &["expected a bank"]);

    let plan = std::fs::read_to_string(demo_run().join("experiments/swing_ES/plan.json")).unwrap();
    let refuse = |contents: &str, says: &[&str]| Case::new().refuses_plan(contents, says);
    refuse(&plan[..plan.len() - 10], &["plan.json"]);
    refuse(
        &plan.replacen("\"schema_version\":2", "\"schema_version\":7", 1),
        &["schema_version", "7"],
    );
    let mut value: serde_json::Value = serde_json::from_str(&plan).unwrap();
    value["commands"].as_array_mut().unwrap().pop();
    refuse(&value.to_string(), &["commands", "48", "49"]);
}

#[test]
fn broken_vehicles() {
    let plan = text(&demo_run().join("experiments/swing_ES/plan.json"));
    let fly = |case: &Case, vehicle: &str, says: &[&str]| {
        case.refuses(&["fly", &plan, "--vehicle", vehicle, "--out", "<OUT>"], says);
    };
    fly(&Case::new(), "helicopter", &["helicopter", "exec:PROGRAM"]);
    fly(&Case::new(), "sim:nowhere.toml", &["nowhere.toml"]);
    fly(
        &Case::new(),
        "exec:no-such-program-anywhere",
        &["no-such-program-anywhere"],
    );
    let case = Case::new();
    let file = case.write("vehicle.toml", "wings = 2\n");
    fly(&case, &format!("sim:{}", text(&file)), &["wings"]);
    let case = Case::new();
    let file = case.write("vehicle.toml", "[supervisor]\nabort_after_s = 1\n");
    fly(&case, &format!("sim:{}", text(&file)), &["abort_after_s"]);
    Case::new().refuses(
        &["fly", &plan, "--vehicle", "sim", "--out", "<OUT>.txt"],
        &[".csv"],
    );
}

#[test]
fn broken_problems() {
    let refuse =
        |change: &dyn Fn(&mut serde_json::Value), says: &[&str]| Case::new().refuses_problem(change, says);
    refuse(&|p| p["N"] = 1.into(), &["N"]);
    refuse(
        &|p| p["umin"] = serde_json::json!([3.0, 0.0, 0.0]),
        &["command bounds", "[3, 2]"],
    );
    refuse(&|p| p["z0"] = serde_json::json!([0.0]), &["z0"]);
    refuse(&|p| p["Q"][0] = serde_json::Value::Null, &["Q"]);
    refuse(&|p| p["equalities"][0]["k"] = 500.into(), &["500"]);
}

#[test]
fn runs_and_outputs_that_are_in_the_way() {
    let case = Case::new();
    case.write("precious.txt", "keep me");
    case.refuses(&["demo", "--out", &text(case.folder.path())], &["not empty"]);
    assert!(case.folder.path().join("precious.txt").exists());
    let case = Case::new();
    case.refuses(&["report", &text(case.folder.path())], &["not a run folder"]);
    Case::new().refuses(&["convert", "flight.doc", "<OUT>"], &[".doc"]);
}
