//! Problem files that are none.

use super::super::{BenchmarkError, parse_problem, read_problem};
use super::problem_path;

/// The document with the value at `pointer` replaced.
fn with(document: &str, pointer: &str, value: serde_json::Value) -> String {
    let mut json: serde_json::Value = serde_json::from_str(document).expect("valid");
    *json.pointer_mut(pointer).expect("exists") = value;
    json.to_string()
}

#[test]
fn broken_files_are_refused_by_name() {
    let text = std::fs::read_to_string(problem_path("kick_ES")).expect("shipped");
    let null = serde_json::Value::Null;
    for (broken, place) in [
        (with(&text, "/zref/3/5", null.clone()), "zref[3][5]: found null"),
        (
            with(&text, "/N", 51.into()),
            "zref: found a list of 50, expected a list of 51",
        ),
        (with(&text, "/N", 1.into()), "at least 2 knots"),
        (
            with(&text, "/N", 1_000_000_000_000_u64.into()),
            "zref: found a list of 50, expected a list of 1000000000000",
        ),
        (
            with(&text, "/umin/0", 9.0.into()),
            "command bounds[0]: found the interval [9, 2]",
        ),
        (
            with(&text, "/equalities/0/k", 77.into()),
            "equalities[0]: found knots 77..=77",
        ),
        (
            with(&text, "/equalities/0/idx", 27.into()),
            "equalities[0]: found state index 27",
        ),
        (
            with(&text, "/state_bounds/0/k1", 50.into()),
            "state_bounds[0]: found knots 1..=50",
        ),
        (
            with(&text, "/state_bounds/0/k0", 0.into()).replace("1.02", "-0.5"),
            "state_bounds[0]: the start",
        ),
        (with(&text, "/R/1", (-1.0).into()), "command_weight[1]: found -1"),
        (
            with(&text, "/models/0/A/8", null.clone()),
            "models[0].A[8]: found null",
        ),
        (
            with(&text, "/models", serde_json::json!([])),
            "models: found a list of 0",
        ),
        (text.replace("\"schedule\"", "\"other\""), "schedule: missing"),
        (text[..text.len() / 2].to_string(), "not JSON"),
        (text.replacen("0.0", "NaN", 1), "not JSON"),
    ] {
        let message = parse_problem(&broken).expect_err(place).to_string();
        assert!(message.contains(place), "{message:?} should contain {place:?}");
    }
    let missing = read_problem(&problem_path("absent")).expect_err("no such file");
    assert!(matches!(missing, BenchmarkError::Io { .. }));
}
