//! A recording of the end effector on another clock than the log's.

use anyhow::{Context, Result, ensure};
use flyvine::flight::{Pose, Reading};
use serde::Deserialize;

use super::TipOptions;
use super::log::Stamped;

/// Steps of the search for the clocks' offset, s: a quadrotor moves by centimetres in it.
const STEP_S: f64 = 0.05;
/// Poses of the log are compared no more often than this, s.
const COMPARE_S: f64 = 0.1;
/// The offset is told to this, s.
const RESOLUTION_S: f64 = 1e-4;
/// The quadrotor must have moved by more than this (standard deviation) to tell the clocks by, m.
const LEAST_MOTION_M: f64 = 0.1;
/// The tracks must agree to this (root mean square) once the clocks do, m.
const AGREEMENT_M: f64 = 0.1;

/// The end effector on the log's clock.
pub struct Tip {
    /// Its positions, m, ENU.
    pub positions: Vec<Stamped<Reading<[f64; 3]>>>,
    /// How well the quadrotor's tracks agree, where they were compared.
    pub agreement: Option<String>,
}

/// One row of the table; a missed position is empty cells.
#[derive(Debug, Deserialize)]
struct Row {
    t_s: f64,
    ee_x: Option<f64>,
    ee_y: Option<f64>,
    ee_z: Option<f64>,
    qr_x: Option<f64>,
    qr_y: Option<f64>,
    qr_z: Option<f64>,
}

/// Reads the table, and puts it on the clock of `poses`, the quadrotor's in the log; `span_s` is from when to when the flight
/// is.
pub fn read(options: &TipOptions, poses: &[Stamped<Reading<Pose>>], span_s: [f64; 2]) -> Result<Tip> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(&options.file)?;
    let rows: Vec<Row> = reader.deserialize().collect::<Result<_, _>>()?;
    ensure!(!rows.is_empty(), "no rows");
    for (row, line) in rows.iter().zip(2..) {
        let numbers = [row.ee_x, row.ee_y, row.ee_z, row.qr_x, row.qr_y, row.qr_z];
        let is_finite = numbers.iter().flatten().all(|number| number.is_finite());
        ensure!(
            row.t_s.is_finite() && is_finite,
            "row {line}: expected finite numbers"
        );
    }
    ensure!(
        rows.is_sorted_by(|a, b| a.t_s < b.t_s),
        "t_s: expected time to increase from row to row"
    );
    let (offset_s, agreement) = match options.clock_offset_s {
        Some(offset_s) => (offset_s, None),
        None => {
            let (offset_s, rms_m) = clock_offset(&rows, poses, span_s)?;
            let agreement = format!(
                "the quadrotor's tracks agree to {:.1} cm with its time 0 at {offset_s:.4} s of the log",
                100.0 * rms_m
            );
            (offset_s, Some(agreement))
        }
    };
    let position =
        |row: &Row| triple([row.ee_x, row.ee_y, row.ee_z]).map_or(Reading::Absent, Reading::Measured);
    Ok(Tip {
        positions: rows
            .iter()
            .map(|row| Stamped {
                t_s: row.t_s + offset_s,
                value: position(row),
            })
            .collect(),
        agreement,
    })
}

/// The log's time at the table's time 0, at which the quadrotor's two tracks differ least (root mean square, m) over the whole
/// flight.
fn clock_offset(rows: &[Row], poses: &[Stamped<Reading<Pose>>], span_s: [f64; 2]) -> Result<(f64, f64)> {
    let track: Vec<Stamped<[f64; 3]>> = rows
        .iter()
        .filter_map(|row| {
            let value = triple([row.qr_x, row.qr_y, row.qr_z])?;
            Some(Stamped { t_s: row.t_s, value })
        })
        .collect();
    ensure!(
        track.len() >= 2,
        "no clock_offset_s, and no columns qr_x, qr_y, qr_z to tell it by"
    );
    let logged = thinned(poses, span_s);
    ensure!(
        deviation_m(&logged) > LEAST_MOTION_M,
        "the quadrotor moved too little to tell the clocks by; give clock_offset_s"
    );
    let first_s = span_s[1] - track[track.len() - 1].t_s;
    let last_s = span_s[0] - track[0].t_s;
    ensure!(
        first_s <= last_s,
        "found {:.2} s of quadrotor positions, expected them to cover the flight's {:.2} s",
        last_s - first_s + span_s[1] - span_s[0],
        span_s[1] - span_s[0]
    );
    let difference = |offset_s: f64| difference_m(&track, &logged, offset_s);
    let steps = ((last_s - first_s) / STEP_S).ceil() as usize;
    let candidates = (0..=steps).map(|step| (first_s + step as f64 * STEP_S).min(last_s));
    let coarse_s = candidates
        .min_by(|a, b| difference(*a).total_cmp(&difference(*b)))
        .context("no offset to try")?;
    // Between its neighbours the difference has one minimum: thirds of the interval are thrown away.
    let (mut low_s, mut high_s) = ((coarse_s - STEP_S).max(first_s), (coarse_s + STEP_S).min(last_s));
    while high_s - low_s > RESOLUTION_S {
        let third_s = (high_s - low_s) / 3.0;
        match difference(low_s + third_s) < difference(high_s - third_s) {
            true => high_s -= third_s,
            false => low_s += third_s,
        }
    }
    let offset_s = 0.5 * (low_s + high_s);
    let rms_m = difference(offset_s);
    ensure!(
        rms_m <= AGREEMENT_M,
        "the quadrotor's tracks here and in the log differ by {rms_m:.3} m at best, expected at most {AGREEMENT_M} m: are \
         both of one flight, in ENU?"
    );
    Ok((offset_s, rms_m))
}

/// Positions of the log during the flight, not too many.
fn thinned(poses: &[Stamped<Reading<Pose>>], span_s: [f64; 2]) -> Vec<Stamped<[f64; 3]>> {
    let mut thinned: Vec<Stamped<[f64; 3]>> = Vec::new();
    for pose in poses
        .iter()
        .filter(|pose| (span_s[0]..=span_s[1]).contains(&pose.t_s))
    {
        let is_due = thinned.last().is_none_or(|last| pose.t_s - last.t_s >= COMPARE_S);
        if let (Reading::Measured(measured), true) = (pose.value, is_due) {
            thinned.push(Stamped {
                t_s: pose.t_s,
                value: measured.position,
            });
        }
    }
    thinned
}

/// The standard deviation of positions about their mean, m.
fn deviation_m(track: &[Stamped<[f64; 3]>]) -> f64 {
    let count = track.len() as f64;
    let mean: [f64; 3] =
        std::array::from_fn(|i| track.iter().map(|point| point.value[i]).sum::<f64>() / count);
    let square: f64 = track
        .iter()
        .map(|point| squared_distance(point.value, mean))
        .sum();
    (square / count).sqrt()
}

/// Root mean square of the distances between the logged positions and the track, m.
fn difference_m(track: &[Stamped<[f64; 3]>], logged: &[Stamped<[f64; 3]>], offset_s: f64) -> f64 {
    let square: f64 = logged
        .iter()
        .map(|point| squared_distance(point.value, interpolated(track, point.t_s - offset_s)))
        .sum();
    (square / logged.len() as f64).sqrt()
}

/// The track's position at a time, held beyond its ends.
fn interpolated(track: &[Stamped<[f64; 3]>], t_s: f64) -> [f64; 3] {
    let after = track.partition_point(|point| point.t_s < t_s);
    match (
        after.checked_sub(1).and_then(|before| track.get(before)),
        track.get(after),
    ) {
        (Some(a), Some(b)) => {
            let share = (t_s - a.t_s) / (b.t_s - a.t_s);
            std::array::from_fn(|i| a.value[i] + share * (b.value[i] - a.value[i]))
        }
        (Some(end), None) | (None, Some(end)) => end.value,
        (None, None) => unreachable!("a track has points"),
    }
}

fn squared_distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum()
}

/// Three numbers, where there are three.
fn triple([x, y, z]: [Option<f64>; 3]) -> Option<[f64; 3]> {
    Some([x?, y?, z?])
}
