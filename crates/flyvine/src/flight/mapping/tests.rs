use proptest::prelude::*;

use super::*;
use crate::flight::shared_data::shared_csv_files;
use crate::flight::{HygieneOptions, Reading, clean};

const EXAMPLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/mappings");

fn example(name: &str) -> Mapping {
    Mapping::read(&Path::new(EXAMPLES).join(name)).unwrap()
}

fn example_text() -> String {
    std::fs::read_to_string(Path::new(EXAMPLES).join("crazyflie_slung.toml")).unwrap()
}

/// Half a second of a Crazyflie log at 100 Hz.
fn log() -> String {
    let header = "t,cmd_x,cmd_y,cmd_z,quad_x,quad_y,quad_z,quat_x,quat_y,quat_z,quat_w,\
                  payload_x,payload_y,payload_z,ok,cmd_vx,cmd_vy,cmd_vz\n";
    let row = |i: usize| {
        let t = i as f64 / 100.0;
        format!("{t},{t},0,1,{t},0,1,0,0,0,1,{t},0,0.49,1,1,0,0\n")
    };
    header.to_owned() + &(0..=50).map(row).collect::<String>()
}

#[track_caller]
fn assert_refused(mapping: &str, words: &[&str]) {
    let message = Mapping::parse("broken.toml", mapping).unwrap_err().to_string();
    assert!(message.starts_with("broken.toml"), "{message}");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
    assert!(message.lines().count() < 10, "{message}");
}

#[track_caller]
fn assert_log_refused(mapping: &Mapping, log: &str, words: &[&str]) {
    let message = mapping
        .parse_recording("log.csv", log.as_bytes())
        .unwrap_err()
        .to_string();
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
    assert!(
        message.starts_with("log.csv") && message.lines().count() == 1,
        "{message}"
    );
}

#[test]
fn broken_mappings_are_refused() {
    let text = example_text();
    assert_refused(
        &text.replace("rate_hz", "rate"),
        &["unknown field `rate`", "rate_hz"],
    );
    assert_refused(&text.replace("rate_hz = 100.0", ""), &["missing field `rate_hz`"]);
    assert_refused(&text.replace("100.0", "\"fast\""), &["line 3", "invalid type"]);
    assert_refused(&text.replace("100.0", "10.0"), &["`rate_hz`", "found 10", "20 …"]);
    assert_refused(&text.replace("100.0", "nan"), &["`rate_hz`", "found NaN"]);
    assert_refused(
        &text.replace("rate_hz", "max_gap_s = 5.0\nrate_hz"),
        &["`max_gap_s`", "found 5", "0 … 0.5 s"],
    );
    assert_refused(
        &text.replace("rate_hz", "delimiter = \"→\"\nrate_hz"),
        &["`delimiter`", "ASCII"],
    );
    assert_refused(
        &text.replace("unit = \"m\"", "unit = \"inch\""),
        &["unknown variant `inch`", "`mm`"],
    );
    assert_refused(&text.replace("w = \"quat_w\", ", ""), &["missing field `w`"]);
    assert_refused(
        &text.replace("\"quat_w\"", "\"quat_x\""),
        &["column `quat_x` twice"],
    );
    assert_refused(
        &text.replace("length_m = 0.51", ""),
        &["exactly one of `length_m`"],
    );
    assert_refused(
        &text.replace("0.51", "-0.51"),
        &["`configuration.length_m`", "-0.51"],
    );
    assert_refused(
        &text.replace("0.51", "510"),
        &["`configuration.length_m`", "millimetres"],
    );
    assert_refused(
        &text.replace("pressure_kpa = 0.0", "pressure_kpa = 400"),
        &["pressure_kpa", "pascals"],
    );
    assert_refused(&text.replace("[quadrotor]", "[quadrotor"), &["line"]);
}

#[test]
fn logs_that_do_not_fit_the_mapping_are_refused() {
    let (mapping, log) = (example("crazyflie_slung.toml"), log());
    assert_log_refused(
        &mapping,
        &log.replace("quat_w", "qw"),
        &["line 1, `quat_w`", "missing", "qw"],
    );
    assert_log_refused(&mapping, &log.replace(",ok,", ",t,"), &["`t`", "2 columns"]);
    assert_log_refused(
        &mapping,
        &log.replace("\n0.03,", "\n0.02,"),
        &["line 5, `t`", "increase"],
    );
    assert_log_refused(
        &mapping,
        &log.replace("0,0,0,1,0.3,", "0,0,0,0,0.3,"),
        &["line 32, `quat_w`", "norm 0.0000"],
    );
    assert_log_refused(
        &mapping,
        &log.replace("0,0,0,1,0.3,", "0,0,0,,0.3,"),
        &["line 32", "pose"],
    );
    assert_log_refused(
        &mapping,
        &log.replace("0,0,0,1,0.3,", "0,0,0,1,inf,"),
        &["line 32, `payload_x`", "inf"],
    );
    assert_log_refused(
        &mapping,
        &log.replace("0,0,0,1,0.3,", "0,0,0,1,left,"),
        &["line 32, `payload_x`", "`left`"],
    );
    assert_log_refused(
        &mapping,
        &log.replace(",0.49,", ",490,"),
        &["`payload_z`", "490 m", "millimetres"],
    );
    let milliseconds = Mapping::parse("ms", &example_text().replace("\"s\"", "\"ms\"")).unwrap();
    assert_log_refused(
        &milliseconds,
        &log,
        &["`t`", "100000.00 Hz", "expected 100 Hz", "unit of time"],
    );
}

#[test]
fn units_axes_validity_and_held_columns() {
    let mapping = example("motive_mm.toml");
    let header = "time_ms,setpoint.x,setpoint.y,setpoint.z,drone.x,drone.y,drone.z,\
                  drone.qx,drone.qy,drone.qz,drone.qw,tip.x,tip.y,tip.z,arm_length_mm,pressure_psi\n";
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // Level but turned by a quarter to the left: about the vertical, which is y there and z here.
    let row = |i: usize| {
        let time_ms = 1.7e12 + i as f64 * 1000.0 / 120.0;
        let (command, tip) = match i {
            0 => ("1,1.5,-2", "100,700,-200"),
            5 => (",,", ",,"),
            _ => (",,", "100,700,-200"),
        };
        let configuration = if i == 0 { "700,0.05" } else { "," };
        format!("{time_ms},{command},1000,1500,-2000,0,{half},0,{half},{tip},{configuration}\n")
    };
    let text = header.to_owned() + &(0..=12).map(row).collect::<String>();
    let recording = mapping.parse_recording("motive.csv", text.as_bytes()).unwrap();
    assert!((recording.rows[12].t_s - 0.1).abs() < 1e-3);
    let first = recording.rows[0];
    assert_eq!(first.command, Some([1.0, 2.0, 1.5]));
    assert_eq!(recording.rows[1].command, None);
    let Reading::Measured(pose) = first.quadrotor else {
        panic!("{first:?}")
    };
    assert_eq!(pose.position, [1.0, 2.0, 1.5]);
    assert!((pose.attitude[0] - half).abs() < 1e-15 && (pose.attitude[3] - half).abs() < 1e-15);
    assert_eq!(
        first.end_effector,
        Reading::Measured([0.1, 0.2, 0.7000000000000001])
    );
    assert_eq!(recording.rows[5].end_effector, Reading::Absent);
    let configuration = recording.rows[12].configuration;
    assert!((configuration.length_m - 0.7).abs() < 1e-15);
    assert!((configuration.pressure_kpa - 0.344_737_864_658_4).abs() < 1e-12);
}

#[test]
fn each_body_has_its_own_validity() {
    let text = example_text().replace(
        "[end_effector]\n",
        "[end_effector]\nvalid = { column = \"ok\", equals = \"yes\" }\n",
    );
    let text = text.replace("equals = 1 }", "equals = true }");
    let mapping = Mapping::parse("valid", &text).unwrap();
    let log = log().replace(",0.49,1,", ",0.49,YES,");
    let recording = mapping.parse_recording("log", log.as_bytes()).unwrap();
    // The same column can say neither `true` nor anything but `yes`: all rows are disowned for both bodies.
    assert!(
        recording
            .rows
            .iter()
            .all(|row| row.end_effector == Reading::Invalid)
    );
    let only_tip = Mapping::parse(
        "valid",
        &text.replace("valid = { column = \"ok\", equals = true }\n", ""),
    )
    .unwrap();
    let recording = only_tip.parse_recording("log", log.as_bytes()).unwrap();
    assert!(
        recording
            .rows
            .iter()
            .all(|row| matches!(row.end_effector, Reading::Measured(_)))
    );
    let log = log.replace("YES", "no");
    let recording = only_tip.parse_recording("log", log.as_bytes()).unwrap();
    assert!(
        recording
            .rows
            .iter()
            .all(|row| row.end_effector == Reading::Invalid)
    );
    assert!(
        recording
            .rows
            .iter()
            .all(|row| matches!(row.quadrotor, Reading::Measured(_)))
    );
}

#[test]
fn every_shared_slung_load_flight_is_read() {
    let (Some(single), Some(team)) = (
        shared_csv_files("slung_load/cf_slung_single"),
        shared_csv_files("slung_load/cf_slung_team"),
    ) else {
        return;
    };
    let flights = single.iter().map(|path| (path, "crazyflie_slung.toml"));
    for (path, mapping) in flights.chain(team.iter().map(|path| (path, "crazyflie_team.toml"))) {
        let mut flight = example(mapping).read_flight(path).unwrap();
        let report = clean(&mut flight, &HygieneOptions::default());
        assert_eq!(flight.samples[20].t_s, 1.0);
        assert!(
            flight
                .samples
                .iter()
                .all(|sample| sample.command_velocity.is_some())
        );
        let cable = |state: [f64; 9]| {
            (0..3)
                .map(|i| (state[i] - state[6 + i]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let lengths: Vec<f64> = flight
            .samples
            .iter()
            .filter_map(|s| s.state())
            .map(cable)
            .collect();
        assert!(
            lengths.iter().all(|length| (0.47..0.55).contains(length)),
            "{report}\n{lengths:?}"
        );
        assert!(lengths.len() * 100 > flight.samples.len() * 90, "{report}");
    }
}

proptest! {
    #[test]
    fn arbitrary_mappings_and_logs_never_panic(
        position in any::<prop::sample::Index>(),
        bytes in prop::collection::vec(any::<u8>(), 0..6),
        removed in 0..60usize,
    ) {
        let damage = |text: String| {
            let mut bytes_of_text = text.into_bytes();
            let start = position.index(bytes_of_text.len());
            let end = (start + removed).min(bytes_of_text.len());
            bytes_of_text.splice(start..end, bytes.clone());
            bytes_of_text
        };
        let _ = Mapping::parse("damaged", &String::from_utf8_lossy(&damage(example_text())));
        let mapping = example("crazyflie_slung.toml");
        if let Ok(recording) = mapping.parse_recording("damaged", damage(log()).as_slice()) {
            let _ = crate::flight::resample(&recording, mapping.max_gap_s);
        }
    }
}
