use std::f64::consts::TAU;

use proptest::prelude::*;
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};

use super::*;
use crate::DT;
use crate::flight::shared_data::shared_csv_files;
use crate::flight::{Configuration, Pose, read_flight};

const ROWS: usize = 120;

/// A violent flight: the quadrotor sways by 0.8 m and tilts by 50°, the arm swings by 57° (22 m/s² at the tip).
fn swing(noise_m: f64) -> Flight {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let normal = Normal::new(0.0, noise_m).unwrap();
    let mut noisy = |v: [f64; 3]| v.map(|x| x + normal.sample(&mut random));
    let samples = (0..ROWS).map(|k| {
        let t_s = k as f64 / 20.0;
        let (x, tilt, arm) = (
            0.8 * (TAU * 0.7 * t_s).sin(),
            0.87 * (TAU * 0.7 * t_s).cos(),
            (TAU * 0.9 * t_s).sin(),
        );
        let [qx, qy, qz] = noisy([0.0, (0.5 * tilt).sin(), 0.0]);
        let qw = (1.0 - qx * qx - qy * qy - qz * qz).sqrt();
        Sample {
            t_s,
            configuration: Configuration {
                length_m: 0.7,
                pressure_kpa: 0.0,
            },
            command: [if t_s < 3.0 { 0.8 } else { -0.8 }, 0.0, 1.5],
            command_velocity: None,
            quadrotor: Some(Pose {
                position: noisy([x, 0.0, 1.5]),
                attitude: [qw, qx, qy, qz],
            }),
            end_effector: Some(noisy([x + 0.7 * arm.sin(), 0.0, 1.5 - 0.7 * arm.cos()])),
        }
    });
    Flight {
        name: "swing".into(),
        samples: samples.collect(),
    }
}

fn cleaned(flight: &Flight) -> (Flight, HygieneReport) {
    let mut flight = flight.clone();
    let report = clean(&mut flight, &HygieneOptions::default());
    (flight, report)
}

/// Rows without quadrotor and end effector.
fn rejected(flight: &Flight) -> (Vec<usize>, Vec<usize>) {
    let rows = |missing: fn(&Sample) -> bool| (0..ROWS).filter(|&k| missing(&flight.samples[k])).collect();
    (
        rows(|sample| sample.quadrotor.is_none()),
        rows(|sample| sample.end_effector.is_none()),
    )
}

fn kinds(report: &HygieneReport) -> Vec<(Body, &'static str)> {
    let mut kinds: Vec<_> = report.findings.iter().map(|f| (f.body, f.fault.name())).collect();
    kinds.dedup();
    kinds
}

#[test]
fn a_violent_swing_is_left_alone() {
    for noise_m in [0.0, 1e-6, 3e-4, 2e-3] {
        let flight = swing(noise_m);
        let (after, report) = cleaned(&flight);
        assert!(report.is_clean(), "{report}");
        assert_eq!(after, flight);
        assert_eq!(report.rows_with_state, ROWS);
    }
}

proptest! {
    #[test]
    fn frozen_poses_are_found(first in 2..ROWS - 10, length in 1..9usize, tip in any::<bool>()) {
        let mut flight = swing(3e-4);
        for k in first..first + length {
            if tip {
                flight.samples[k].end_effector = flight.samples[first - 1].end_effector;
            } else {
                flight.samples[k].quadrotor = flight.samples[first - 1].quadrotor;
            }
        }
        let (after, report) = cleaned(&flight);
        let (quadrotor, end_effector) = rejected(&after);
        let (frozen, other) = if tip { (end_effector, quadrotor) } else { (quadrotor, end_effector) };
        prop_assert_eq!(frozen, (first..first + length).collect::<Vec<_>>());
        prop_assert!(other.is_empty());
        let body = if tip { Body::EndEffector } else { Body::Quadrotor };
        prop_assert_eq!(kinds(&report), [(body, "frozen")]);
    }

    #[test]
    fn a_stream_that_freezes_as_a_whole_is_found(first in 2..ROWS - 10, length in 1..9usize) {
        let mut flight = swing(3e-4);
        for k in first..first + length {
            flight.samples[k].quadrotor = flight.samples[first - 1].quadrotor;
            flight.samples[k].end_effector = flight.samples[first - 1].end_effector;
        }
        let expected: Vec<usize> = (first..first + length).collect();
        prop_assert_eq!(rejected(&cleaned(&flight).0), (expected.clone(), expected));
    }

    #[test]
    fn jumps_of_ten_centimetres_and_more_are_found(
        first in 2..ROWS - 10,
        length in 1..8usize,
        size_m in prop_oneof![0.1..0.2, 0.2..5.0],
        direction in 0.0..TAU,
        tip in any::<bool>(),
    ) {
        let mut flight = swing(3e-4);
        let shift = [size_m * direction.cos(), 0.0, size_m * direction.sin()];
        for sample in &mut flight.samples[first..first + length] {
            let position = match (&mut sample.end_effector, &mut sample.quadrotor) {
                (Some(position), _) if tip => position,
                (_, Some(pose)) => &mut pose.position,
                _ => unreachable!("the swing misses nothing"),
            };
            (0..3).for_each(|i| position[i] += shift[i]);
        }
        let (after, report) = cleaned(&flight);
        let (quadrotor, end_effector) = rejected(&after);
        let (jumped, other) = if tip { (end_effector, quadrotor) } else { (quadrotor, end_effector) };
        prop_assert_eq!(jumped, (first..first + length).collect::<Vec<_>>());
        prop_assert!(other.is_empty());
        let body = if tip { Body::EndEffector } else { Body::Quadrotor };
        prop_assert_eq!(kinds(&report), [(body, "jump")]);
    }

    #[test]
    fn scattered_wild_positions_are_all_found(
        rows in prop::collection::btree_set(4..ROWS - 4, 1..12),
        wild in prop::array::uniform3(2.0..9.0),
    ) {
        let mut flight = swing(3e-4);
        for (i, &k) in rows.iter().enumerate() {
            let sign = if i % 2 == 0 { 1.0 } else { -1.3 };
            flight.samples[k].end_effector = Some(wild.map(|x| sign * x));
        }
        let (after, _) = cleaned(&flight);
        let (quadrotor, end_effector) = rejected(&after);
        prop_assert!(quadrotor.is_empty());
        prop_assert!(rows.iter().all(|k| end_effector.contains(k)));
        // Good rows between bad ones may fall with them, and one beside each.
        prop_assert!(end_effector.len() <= 4 * rows.len(), "{rows:?} {end_effector:?}");
    }

    #[test]
    fn wrong_attitudes_are_found_and_signs_repaired(
        turned in 2..ROWS - 2,
        angle in 0.6..3.1f64,
        flips in prop::collection::vec(any::<bool>(), ROWS),
    ) {
        let good = swing(3e-4);
        let mut flight = good.clone();
        let (sin, cos) = (0.5 * angle).sin_cos();
        for (k, sample) in flight.samples.iter_mut().enumerate() {
            let Some(pose) = &mut sample.quadrotor else { continue };
            if k == turned {
                pose.attitude = quaternion::product(pose.attitude, [cos, 0.0, 0.0, sin]);
            }
            if flips[k] {
                pose.attitude = pose.attitude.map(|c| -c);
            }
        }
        let (after, report) = cleaned(&flight);
        prop_assert_eq!(rejected(&after), (vec![turned], vec![]));
        for k in (0..ROWS).filter(|&k| k != turned) {
            prop_assert_eq!(after.samples[k], good.samples[k]);
        }
        let turn = report.findings.iter().find_map(|f| match f.fault {
            Fault::Turn { angle_rad } => Some(angle_rad),
            _ => None,
        });
        // The vehicle itself turns by up to 0.2 rad from row to row.
        prop_assert!((turn.unwrap() - angle).abs() < 0.3);
        let flipped: usize =
            report.findings.iter().filter(|f| f.fault == Fault::SignFlip).map(Finding::num_rows).sum();
        prop_assert_eq!(flipped, (0..ROWS).filter(|&k| k != turned && flips[k]).count());
    }

    #[test]
    fn missing_poses_and_lost_rows_are_reported_and_nothing_reaches_across(
        missing in prop::collection::btree_set(0..ROWS, 0..10),
        lost in 5..ROWS - 5,
        num_lost in 1..4usize,
        lags in 1..5usize,
    ) {
        let mut flight = swing(3e-4);
        for &k in &missing {
            flight.samples[k].quadrotor = None;
        }
        flight.samples.drain(lost..lost + num_lost);
        let report = clean(&mut flight, &HygieneOptions::default());
        let rows = |body| -> usize {
            report.findings.iter().filter(|f| f.body == body).map(Finding::num_rows).sum()
        };
        prop_assert_eq!(rows(Body::Quadrotor), flight.samples.iter().filter(|s| s.quadrotor.is_none()).count());
        prop_assert_eq!(rows(Body::Clock), 1);
        prop_assert_eq!(rows(Body::EndEffector), 0);

        let valid = |k: usize| {
            k + 1 >= lags + usize::from(k + 1 < lags)
                && k + 1 < flight.samples.len()
                && k + 1 >= lags
                && (k + 1 - lags..=k + 1).all(|row| flight.samples[row].state().is_some())
                && (k + 2 - lags..=k + 1)
                    .all(|row| (flight.samples[row].t_s - flight.samples[row - 1].t_s - DT).abs() < 1e-9)
        };
        let expected: Vec<usize> = (0..flight.samples.len()).filter(|&k| valid(k)).collect();
        prop_assert_eq!(flight.valid_transitions(lags), expected);
    }
}

/// A noise-free vehicle that rests, moves smoothly and rests again; numbers rounded to `digits`.
fn rest_move_rest(digits: i32) -> Flight {
    let round = |x: f64| (x * 10f64.powi(digits)).round() / 10f64.powi(digits);
    let mut flight = swing(0.0);
    for (k, sample) in flight.samples.iter_mut().enumerate() {
        // The command steps in row 30; the vehicle answers three rows later, the tip still later.
        let answer = |delay: usize| {
            let t = k.saturating_sub(30 + delay) as f64 * DT;
            1.0 - (1.0 + 6.0 * t) * (-6.0 * t).exp()
        };
        sample.command = [if k < 30 { 0.0 } else { 1.0 }, 0.0, 1.5];
        let position = [round(answer(3)), 0.0, 1.5];
        sample.quadrotor = Some(Pose {
            position,
            attitude: [1.0, 0.0, 0.0, 0.0],
        });
        sample.end_effector = Some([round(answer(4)), 0.0, 0.8]);
    }
    flight
}

#[test]
fn exact_rest_in_noise_free_flights_is_left_alone() {
    for digits in [3, 4, 6, 12, 15] {
        let (_, report) = cleaned(&rest_move_rest(digits));
        assert!(report.is_clean(), "{digits} digits: {report}");
    }
}

#[test]
fn slow_motion_in_whole_millimetres_is_left_alone() {
    let mut flight = swing(0.0);
    for (k, sample) in flight.samples.iter_mut().enumerate() {
        let x = (0.31 * k as f64).round() * 1e-3; // 6 mm/s: most rows repeat
        let position = [x, (1.7 * k as f64).round() * 1e-3, 1.5];
        sample.quadrotor = Some(Pose {
            position,
            attitude: [1.0, 0.0, 0.0, 0.0],
        });
        sample.end_effector = Some([x, 0.0, 0.8]);
    }
    let (_, report) = cleaned(&flight);
    assert!(report.is_clean(), "{report}");
}

#[test]
fn frozen_from_the_first_row_on() {
    let mut flight = swing(3e-4);
    for k in 1..6 {
        flight.samples[k].end_effector = flight.samples[0].end_effector;
    }
    assert_eq!(rejected(&cleaned(&flight).0), (vec![], vec![1, 2, 3, 4, 5]));
}

#[test]
fn a_lasting_shift_breaks_the_track_at_one_row() {
    let mut flight = swing(3e-4);
    for sample in &mut flight.samples[60..] {
        sample.end_effector.as_mut().unwrap()[2] += 0.3;
    }
    let (after, report) = cleaned(&flight);
    assert_eq!(rejected(&after), (vec![], vec![60]));
    assert_eq!(after.segments(), [0..60, 61..ROWS]);
    assert!(
        matches!(report.findings[0].fault, Fault::Jump { size_m } if size_m > 0.2),
        "{report}"
    );
}

#[test]
fn jumps_at_either_end_are_rejected() {
    for (rows, may_fall) in [(0..3, 0..4), (ROWS - 3..ROWS, ROWS - 4..ROWS)] {
        let mut flight = swing(3e-4);
        for sample in &mut flight.samples[rows.clone()] {
            sample.end_effector.as_mut().unwrap()[1] += 1.0;
        }
        let (_, rejected) = rejected(&cleaned(&flight).0);
        assert!(
            rows.clone().all(|k| rejected.contains(&k)),
            "{rows:?}: {rejected:?}"
        );
        assert!(
            rejected.iter().all(|k| may_fall.contains(k)),
            "{rows:?}: {rejected:?}"
        );
    }
}

#[test]
fn a_command_spike_disqualifies_its_rows_but_steps_and_pulses_are_commands() {
    let mut flight = swing(3e-4);
    for sample in &mut flight.samples[40..42] {
        sample.command = [0.0, 0.0, 0.0];
    }
    for sample in &mut flight.samples[80..84] {
        sample.command[0] += 1.0;
    }
    let (after, report) = cleaned(&flight);
    assert_eq!(rejected(&after), (vec![40, 41], vec![40, 41]));
    assert_eq!(kinds(&report), [(Body::Command, "command spike")]);
}

#[test]
fn numbers_that_are_not_finite_count_as_missing() {
    let mut flight = swing(3e-4);
    flight.samples[7].end_effector = Some([0.0, f64::NAN, 0.0]);
    let (after, report) = cleaned(&flight);
    assert_eq!(rejected(&after), (vec![], vec![7]));
    assert_eq!(kinds(&report), [(Body::EndEffector, "missing")]);
}

#[test]
fn the_report_is_a_table_and_survives_json() {
    let mut flight = swing(3e-4);
    for k in [20, 21, 50] {
        flight.samples[k].end_effector = None;
    }
    flight.samples[70].quadrotor = flight.samples[69].quadrotor;
    let (_, report) = cleaned(&flight);
    assert_eq!(
        report.to_string(),
        "swing: 116 of 120 rows have a state\n  \
           quadrotor     frozen            1 × in     1 rows, at 3.50 s\n  \
           end effector  missing           2 × in     3 rows, at 1.00, 2.50 s"
    );
    let json = serde_json::to_string(&report).unwrap();
    assert_eq!(serde_json::from_str::<HygieneReport>(&json).unwrap(), report);
    assert!(
        json.contains(
            r#"{"body":"quadrotor","kind":"frozen","first_row":70,"last_row":70,"from_s":3.5,"to_s":3.5}"#
        ),
        "{json}"
    );
}

/// The shared flights have frozen poses in `*_train2_*` (every exact repetition is one) and no other fault.
#[test]
fn in_the_shared_flights_all_frozen_poses_are_found_and_nothing_else() {
    let Some(files) = shared_csv_files("flights") else {
        return;
    };
    let mut num_frozen = 0;
    for path in files {
        let flight = read_flight(&path).unwrap();
        let (after, report) = cleaned(&flight);
        let repeats = |same: fn(&Sample, &Sample) -> bool| -> Vec<usize> {
            (1..flight.samples.len())
                .filter(|&k| same(&flight.samples[k], &flight.samples[k - 1]))
                .collect()
        };
        let missing = |of: fn(&Sample) -> bool| -> Vec<usize> {
            (0..after.samples.len())
                .filter(|&k| of(&after.samples[k]))
                .collect()
        };
        let (quadrotor, end_effector) = (
            repeats(|a, b| a.quadrotor == b.quadrotor),
            repeats(|a, b| a.end_effector == b.end_effector),
        );
        assert_eq!(
            missing(|sample| sample.quadrotor.is_none()),
            quadrotor,
            "{report}"
        );
        assert_eq!(
            missing(|sample| sample.end_effector.is_none()),
            end_effector,
            "{report}"
        );
        assert!(
            report
                .findings
                .iter()
                .all(|finding| finding.fault == Fault::Frozen),
            "{report}"
        );
        assert_eq!(report.is_clean(), !flight.name.contains("_train2_"), "{report}");
        num_frozen += quadrotor.len() + end_effector.len();
    }
    assert_eq!(num_frozen, 62);
}
