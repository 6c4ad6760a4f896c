use proptest::prelude::*;

use std::path::Path;

use super::*;
use crate::DT;
use crate::flight::shared_data::shared_csv_files;
use crate::flight::{read_flight, write_flight};

const HEADER: &str =
    "t_s,length_m,pressure_kpa,cmd_x,cmd_y,cmd_z,qr_x,qr_y,qr_z,qr_qw,qr_qx,qr_qy,qr_qz,ee_x,ee_y,ee_z";

/// A good file of five rows, for tests to break.
fn good() -> Vec<Vec<String>> {
    let row = |k: usize| {
        format!(
            "{},0.7,0.4,0,0,1.5,0.01,0,1.5,1,0,0,0,0.02,0,0.8",
            k as f64 / 20.0
        )
    };
    let rows = std::iter::once(HEADER.to_owned()).chain((0..5).map(row));
    rows.map(|row| row.split(',').map(str::to_owned).collect())
        .collect()
}

fn text(rows: &[Vec<String>]) -> String {
    rows.iter().map(|row| row.join(",") + "\n").collect()
}

/// The good file with one cell of line `line` replaced.
fn with(line: usize, column: &str, cell: &str) -> String {
    let mut rows = good();
    let index = rows[0].iter().position(|name| name == column).unwrap();
    rows[line - 1][index] = cell.to_owned();
    text(&rows)
}

/// The good file with all cells of some columns replaced.
fn with_all(columns: &[&str], cells: impl Fn(usize) -> String) -> String {
    let mut rows = good();
    for column in columns {
        let index = rows[0].iter().position(|name| name == column).unwrap();
        for line in 1..rows.len() {
            rows[line][index] = cells(line - 1);
        }
    }
    text(&rows)
}

#[track_caller]
fn message(text: &str) -> String {
    parse_csv("broken.csv", text.as_bytes()).unwrap_err().to_string()
}

/// The message names file, line and field, and contains `found` and `expected`.
#[track_caller]
fn assert_says(text: &str, place: &str, words: &[&str]) {
    let message = message(text);
    assert!(message.starts_with(place), "{message}");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
    assert!(message.lines().count() == 1 && message.len() < 600, "{message}");
}

#[test]
fn a_good_file_is_read_as_it_is_written() {
    let flight = parse_csv("good", text(&good()).as_bytes()).unwrap();
    assert_eq!(flight.samples.len(), 5);
    let sample = flight.samples[1];
    assert_eq!(sample.t_s, 0.05);
    assert_eq!(
        sample.configuration,
        Configuration {
            length_m: 0.7,
            pressure_kpa: 0.4
        }
    );
    assert_eq!(sample.command, [0.0, 0.0, 1.5]);
    assert_eq!(sample.command_velocity, None);
    assert_eq!(
        sample.state(),
        Some([0.01, 0.0, 1.5, 0.0, 0.0, 0.0, 0.02, 0.0, 0.8])
    );
}

#[test]
fn columns_come_in_any_order_with_others_between_and_blanks_around() {
    let mut rows = good();
    for row in &mut rows {
        row.reverse();
        row.insert(3, "a remark".into());
        row.iter_mut().for_each(|cell| *cell = format!(" {cell} "));
    }
    let text = format!("\u{feff}{}", text(&rows).replace('\n', "\r\n"));
    let expected = parse_csv("good", self::text(&good()).as_bytes()).unwrap();
    assert_eq!(parse_csv("good", text.as_bytes()).unwrap(), expected);
}

#[test]
fn empty_cells_are_missed_poses() {
    let mut rows = good();
    rows[2][6..13].iter_mut().for_each(String::clear);
    rows[3][13..16].iter_mut().for_each(String::clear);
    let flight = parse_csv("gaps", text(&rows).as_bytes()).unwrap();
    assert!(flight.samples[1].quadrotor.is_none() && flight.samples[1].end_effector.is_some());
    assert!(flight.samples[2].quadrotor.is_some() && flight.samples[2].end_effector.is_none());
    assert_eq!(flight.segments(), [0..1, 3..5]);
}

#[test]
fn broken_files_are_refused_with_place_found_and_expected() {
    let good_text = text(&good());
    assert_says("", "broken.csv: ", &["empty file", "header"]);
    assert_says(&(HEADER.to_owned() + "\n"), "broken.csv: ", &["no data rows"]);
    assert_says(
        &good_text.replace("qr_qw", "quality"),
        "broken.csv, line 1, `qr_qw`: ",
        &["missing", "quality"],
    );
    assert_says(
        &good_text.replace("ee_y", "ee_x"),
        "broken.csv, line 1, `ee_x`: ",
        &["2 columns", "expected one"],
    );
    assert_says(
        &good_text[..good_text.len() - 12],
        "broken.csv, line 6: ",
        &["found 13 cells", "expected 16"],
    );
    assert_says(
        &good_text.replace("0.1,0.7", "0.1,0.7,1"),
        "broken.csv, line 4: ",
        &["found 17 cells"],
    );
    assert_says(
        &with(3, "qr_x", "abc"),
        "broken.csv, line 3, `qr_x`: ",
        &["`abc`", "number"],
    );
    assert_says(
        &with(3, "ee_z", "0;8"),
        "broken.csv, line 3, `ee_z`: ",
        &["`0;8`"],
    );
    assert_says(
        &with(3, "ee_z", "NaN"),
        "broken.csv, line 3, `ee_z`: ",
        &["NaN", "finite"],
    );
    assert_says(
        &with(3, "cmd_x", "inf"),
        "broken.csv, line 3, `cmd_x`: ",
        &["inf", "finite"],
    );
    assert_says(
        &with(3, "cmd_x", "1e999"),
        "broken.csv, line 3, `cmd_x`: ",
        &["inf", "finite"],
    );
    assert_says(
        &with(4, "cmd_x", ""),
        "broken.csv, line 4, `cmd_x`: ",
        &["empty cell", "only poses"],
    );
    assert_says(
        &with(4, "qr_qy", ""),
        "broken.csv, line 4, `qr_qy`: ",
        &["empty cell in a pose"],
    );
    assert_says(
        &with(4, "ee_x", ""),
        "broken.csv, line 4, `ee_x`: ",
        &["empty cell in a pose"],
    );
    assert_says(
        &with(4, "t_s", "0.05"),
        "broken.csv, line 4, `t_s`: ",
        &["found 0.05 s after 0.05 s", "increase"],
    );
    assert_says(
        &with(4, "t_s", "0.01"),
        "broken.csv, line 4, `t_s`: ",
        &["found 0.01 s after 0.05 s"],
    );
    assert_says(
        &with(2, "qr_qw", "0.5"),
        "broken.csv, line 2, `qr_qw`: ",
        &["norm 0.5000", "Euler"],
    );
    assert_says(
        &with(2, "length_m", "-0.7"),
        "broken.csv, line 2, `length_m`: ",
        &["-0.7", "more than 0"],
    );
    assert_says(
        &with(2, "length_m", "700"),
        "broken.csv, line 2, `length_m`: ",
        &["700 m", "millimetres"],
    );
    assert_says(
        &with(2, "pressure_kpa", "400"),
        "broken.csv, line 2, `pressure_kpa`: ",
        &["400 kPa", "pascals"],
    );
    assert_says(
        &with(2, "qr_z", "1500"),
        "broken.csv, line 2, `qr_z`: ",
        &["1500 m", "millimetres"],
    );
    assert_says(
        &with(2, "cmd_z", "-1500"),
        "broken.csv, line 2, `cmd_z`: ",
        &["-1500 m", "millimetres"],
    );
    let times = |unit: f64| with_all(&["t_s"], |k| (k as f64 * unit).to_string());
    assert_says(
        &times(50.0),
        "broken.csv, `t_s`: ",
        &["step of 50.0000 s", "milliseconds"],
    );
    assert_says(&times(5e4), "broken.csv, `t_s`: ", &["microseconds"]);
    assert_says(&times(5e7), "broken.csv, `t_s`: ", &["nanoseconds"]);
    assert_says(
        &times(0.01),
        "broken.csv, `t_s`: ",
        &["0.0100 s", "20 Hz", "mapping"],
    );
    let not_text = [good_text.as_bytes(), &[0xff, 0xfe, b'\n']].concat();
    let error = parse_csv("broken.csv", not_text.as_slice()).unwrap_err();
    assert!(matches!(*error.problem, Problem::NotText), "{error}");
    let absent = read_flight(Path::new("no/such.csv")).unwrap_err();
    assert!(matches!(*absent.problem, Problem::Io(_)) && absent.to_string().starts_with("no/such.csv: "));
}

#[test]
fn a_flight_with_a_number_that_is_not_finite_is_not_written() {
    let mut flight = parse_csv("good", text(&good()).as_bytes()).unwrap();
    flight.samples[2].end_effector = Some([0.0, f64::NAN, 0.0]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.csv");
    let error = write_flight(&path, &flight).unwrap_err();
    assert_eq!(
        (error.place.line, error.place.field.as_deref()),
        (Some(4), Some("ee_y"))
    );
    assert!(!path.exists());
}

#[test]
fn every_shared_flight_is_read_and_survives_a_round_trip() {
    let Some(files) = shared_csv_files("flights") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    for path in files {
        let flight = read_flight(&path).unwrap();
        let copy = folder.path().join(path.file_name().unwrap());
        write_flight(&copy, &flight).unwrap();
        assert_eq!(read_flight(&copy).unwrap(), flight);
    }
}

pub(crate) fn any_flight() -> impl Strategy<Value = Flight> {
    let vector = || prop::array::uniform3(-100.0..100.0);
    let attitude = prop::array::uniform4(-1.0..1.0f64)
        .prop_map(|q| {
            let norm = quaternion::dot(q, q).sqrt();
            q.map(|c| c / norm)
        })
        .prop_filter("no direction", |q| q[0].is_finite());
    let quadrotor = prop::option::of((vector(), attitude))
        .prop_map(|pose| pose.map(|(position, attitude)| Pose { position, attitude }));
    let others = (vector(), prop::option::of(vector()), prop::option::of(vector()));
    let sample = (0.0..4e-4, 1e-9..10.0, -100.0..100.0, others, quadrotor);
    prop::collection::vec(sample, 1..20).prop_map(|rows| {
        let samples =
            rows.into_iter()
                .enumerate()
                .map(|(k, (jitter_s, length_m, pressure_kpa, others, quadrotor))| {
                    let (command, command_velocity, end_effector) = others;
                    let configuration = Configuration {
                        length_m,
                        pressure_kpa,
                    };
                    let t_s = k as f64 * DT + jitter_s;
                    Sample {
                        t_s,
                        configuration,
                        command,
                        command_velocity,
                        quadrotor,
                        end_effector,
                    }
                });
        let samples = samples.collect();
        Flight {
            name: "flight".into(),
            samples,
        }
    })
}

proptest! {
    #[test]
    fn any_flight_survives_a_round_trip(flight in any_flight()) {
        let text = format_csv("flight", &flight, &[]).unwrap();
        prop_assert_eq!(parse_csv("flight", text.as_bytes()).unwrap(), flight);
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = parse_csv("noise", bytes.as_slice());
        let below_a_header = [HEADER.as_bytes(), b"\n", &bytes].concat();
        let _ = parse_csv("noise", below_a_header.as_slice());
    }

    #[test]
    fn damaged_files_are_refused_or_read_never_a_panic(
        position in any::<prop::sample::Index>(),
        bytes in prop::collection::vec(any::<u8>(), 0..4),
        removed in 0..40usize,
    ) {
        let mut file = text(&good()).into_bytes();
        let start = position.index(file.len());
        let end = (start + removed).min(file.len());
        file.splice(start..end, bytes);
        if let Ok(flight) = parse_csv("damaged", file.as_slice()) {
            prop_assert!(flight.samples.iter().filter_map(Sample::state).flatten().all(f64::is_finite));
            prop_assert!(flight.samples.windows(2).all(|pair| pair[0].t_s < pair[1].t_s));
        }
    }
}
