use proptest::prelude::*;

use super::*;
use crate::flight::csv::tests::any_flight;
use crate::flight::shared_data::shared_csv_files;
use crate::flight::{read_flight, recover_flight, write_flight};

/// Forty seconds of a moving vehicle with some missed poses: several chunks.
fn flight() -> Flight {
    let samples = (0..800).map(|k| {
        let t_s = k as f64 / 20.0;
        let (x, half) = (t_s.sin(), 0.1 * t_s.cos());
        Sample {
            t_s,
            configuration: Configuration {
                length_m: 0.7 + 0.01 * t_s / 3.0,
                pressure_kpa: 0.1,
            },
            command: [x, 0.0, 1.5],
            command_velocity: (k % 2 == 0).then_some([t_s.cos(), -0.0, 1e-300]),
            quadrotor: (k % 7 != 3).then_some(Pose {
                position: [x, 0.1, 1.5],
                attitude: quaternion::unit([half.cos(), half.sin(), 0.0, 0.0]).unwrap(),
            }),
            end_effector: (k % 11 != 5).then_some([x - 0.1, 1.0 / 3.0, 0.8]),
        }
    });
    Flight {
        name: "flight".into(),
        samples: samples.collect(),
    }
}

#[test]
fn files_survive_a_round_trip_and_are_reproducible() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    write_flight(&path, &flight()).unwrap();
    assert_eq!(read_flight(&path).unwrap(), flight());
    assert_eq!(
        format_mcap("flight", &flight(), &[]).unwrap(),
        std::fs::read(&path).unwrap()
    );
}

#[test]
fn every_shared_flight_survives_a_round_trip() {
    let Some(files) = shared_csv_files("flights") else {
        return;
    };
    for path in files.iter().step_by(8) {
        let mut flight = read_flight(path).unwrap();
        flight.name = "flight".into();
        let bytes = format_mcap("flight", &flight, &[]).unwrap();
        assert_eq!(parse_mcap("flight", &bytes).unwrap(), flight);
    }
}

#[test]
fn a_file_that_was_cut_off_is_refused_but_recovered_up_to_the_last_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    let whole = format_mcap("whole", &flight(), &[]).unwrap();
    let mut fewest = usize::MAX;
    for share in [0.99, 0.9, 0.6, 0.35] {
        let cut = (share * whole.len() as f64) as usize;
        std::fs::write(&path, &whole[..cut]).unwrap();
        let error = read_flight(&path).unwrap_err();
        let Problem::CutOff { rows } = *error.problem else {
            panic!("{error}")
        };
        let recovered = recover_flight(&path).unwrap().samples;
        assert_eq!(recovered.len(), rows);
        assert_eq!(recovered[..], flight().samples[..rows]);
        // At most one chunk is lost on top of what is gone. The index takes little room.
        let expected = 800.0 * share - 2.0 * 800.0 * CHUNK_BYTES as f64 / whole.len() as f64;
        assert!(rows as f64 > expected, "{rows} rows of {share}");
        assert!(rows <= fewest);
        fewest = rows;
    }
}

#[test]
fn what_is_no_flight_is_refused() {
    let error = |bytes: &[u8]| parse_mcap("broken.mcap", bytes).unwrap_err();
    assert!(matches!(*error(b"t_s,length_m\n").problem, Problem::NotMcap(_)));
    assert!(matches!(*error(b"").problem, Problem::NotMcap(_)));
    let none = Flight {
        samples: Vec::new(),
        ..flight()
    };
    assert!(matches!(
        *format_mcap("none", &none, &[]).unwrap_err().problem,
        Problem::NoRows
    ));
    let mut bad = flight();
    bad.samples[3].command[1] = f64::INFINITY;
    let message = format_mcap("bad.mcap", &bad, &[]).unwrap_err().to_string();
    assert!(message.starts_with("bad.mcap, `/command, row 3`: "), "{message}");
    let mut backwards = flight();
    backwards.samples.swap(4, 5);
    let message = format_mcap("bad.mcap", &backwards, &[]).unwrap_err().to_string();
    assert!(
        message.contains("/configuration, row 5") && message.contains("increase"),
        "{message}"
    );
    let mut slow = flight();
    slow.samples.iter_mut().for_each(|sample| sample.t_s *= 2.0);
    assert!(matches!(
        *format_mcap("slow", &slow, &[]).unwrap_err().problem,
        Problem::NotTwentyHertz { .. }
    ));
}

/// What a fuzzer found: records that are longer than what is left of their chunk, the second in a chunk that is cut off, and
/// a name of 4 GB, and a record of 2⁶⁴ − 1 bytes. The crate `mcap` would not survive the last, nor, with overflow checks as in a
/// debug build or with little memory, the others.
#[test]
fn lengths_past_their_end_are_damage() {
    for damaged in [
        &include_bytes!("../../../tests/fixtures/record_past_its_chunk.mcap")[..],
        &include_bytes!("../../../tests/fixtures/record_past_its_cut_chunk.mcap")[..],
        &include_bytes!("../../../tests/fixtures/string_past_its_record.mcap")[..],
        &include_bytes!("../../../tests/fixtures/string_past_its_chunk_index.mcap")[..],
        &include_bytes!("../../../tests/fixtures/endless_record.mcap")[..],
    ] {
        assert!(sound_mcap(damaged).len() < damaged.len());
        assert!(parse_mcap("damaged", damaged).is_err() && parse_steps("damaged", damaged).is_err());
        let _ = recover_mcap("damaged", damaged);
    }
    let whole = format_mcap("flight", &flight(), &[]).unwrap();
    assert_eq!(sound_mcap(&whole).len(), whole.len());
    let cut = &whole[..whole.len() / 2];
    assert_eq!(
        sound_mcap(cut).len(),
        cut.len(),
        "a file that was cut off is not damaged"
    );
}

proptest! {
    #[test]
    fn any_flight_survives_a_round_trip_as_mcap(flight in any_flight()) {
        let bytes = format_mcap("flight", &flight, &[]).unwrap();
        prop_assert_eq!(parse_mcap("flight", &bytes).unwrap(), flight);
    }

    #[test]
    fn damaged_files_never_panic(
        position in any::<prop::sample::Index>(),
        bytes in prop::collection::vec(any::<u8>(), 0..6),
        removed in 0..200usize,
    ) {
        let short = Flight { samples: flight().samples[..20].to_vec(), ..flight() };
        let mut file = format_mcap("flight", &short, &[]).unwrap();
        let start = position.index(file.len());
        let end = (start + removed).min(file.len());
        file.splice(start..end, bytes);
        let _ = parse_mcap("damaged", &file);
        if let Ok(recovered) = recover_mcap("damaged", &file) {
            prop_assert!(recovered.samples.len() <= 20);
        }
    }
}
