//! Rejecting what motion capture and loggers get wrong, each finding reported by time and body.

mod command;
mod freeze;
mod jump;
mod report;

use std::ops::Range;

use serde::{Deserialize, Serialize};

pub use report::{Body, Fault, Finding, HygieneReport};

use super::{Flight, Sample, quaternion};

/// What counts as a fault. The defaults leave real swings alone (8 m/s at the tip, 60° of tilt).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HygieneOptions {
    /// Quadrotor: largest deviation of one step from the mean of the steps beside it, m: half the third
    /// difference of the positions. A jump by `J` deviates by `J`, a spike by `1.5 J`. Default 0.06.
    pub jump_tolerance_m: f64,
    /// End effector: the same; a limp arm that whips round deviates by 0.07 m by itself. Default 0.075.
    pub tip_jump_tolerance_m: f64,
    /// The same for the attitude, as a distance of quaternions (half an angle in radians). Default 0.12.
    pub turn_tolerance: f64,
    /// Longest excursion, in rows, that is rejected as a whole; what stays away longer is a lasting shift,
    /// of which the first rows are rejected until the step across them could be flown. Default 10.
    pub max_excursion_rows: usize,
    /// A command that leaves for one or two rows by more than this and comes back was not flown, m. Default 0.5.
    pub command_spike_m: f64,
}

impl Default for HygieneOptions {
    fn default() -> Self {
        HygieneOptions {
            jump_tolerance_m: 0.06,
            tip_jump_tolerance_m: 0.075,
            turn_tolerance: 0.12,
            max_excursion_rows: 10,
            command_spike_m: 0.5,
        }
    }
}

/// Removes the faults of `flight` and reports them.
///
/// Rejected poses become `None`; attitudes get continuous signs, the first with `w ≥ 0`; times and commands
/// stay as they are. What is found:
///
/// - *missing*: poses that the recording does not have;
/// - *frozen*: a pose repeated in every digit although its body was moving (see `freeze.rs`);
/// - *jump*, *turn*: a position or attitude that its neighbours contradict (see `jump.rs`);
/// - *sign flip*: rows with the sign of the quaternion opposite to their predecessors';
/// - *clock gap*: a time step that is not [`DT`](crate::DT);
/// - *command spike*: a command that leaves and returns within two rows. The poses of these rows are
///   rejected, for nobody knows what was flown.
pub fn clean(flight: &mut Flight, options: &HygieneOptions) -> HygieneReport {
    let mut report = HygieneReport::new(flight);
    drop_non_finite(flight);
    report_missing(flight, &mut report);
    for row in (1..flight.samples.len()).filter(|&row| flight.clock_gap_before(row)) {
        let step_s = flight.samples[row].t_s - flight.samples[row - 1].t_s;
        report.add(flight, Body::Clock, Fault::ClockGap { step_s }, row..row + 1);
    }

    let frozen = freeze::frozen_rows(flight);
    for rows in frozen.quadrotor {
        reject(flight, &mut report, Body::Quadrotor, Fault::Frozen, rows);
    }
    for rows in frozen.end_effector {
        reject(flight, &mut report, Body::EndEffector, Fault::Frozen, rows);
    }
    for spike in command::spikes(flight, options.command_spike_m) {
        let fault = Fault::CommandSpike { size_m: spike.size };
        reject(flight, &mut report, Body::Command, fault, spike.rows);
    }

    let longest = options.max_excursion_rows;
    let positions = jump::track(flight, |sample| sample.quadrotor.map(|pose| pose.position));
    let attitudes = jump::track(flight, |sample| sample.quadrotor.map(|pose| pose.attitude));
    let tips = jump::track(flight, |sample| sample.end_effector);
    for jump in jump::find(positions, options.jump_tolerance_m, longest, |_, x| x) {
        let fault = Fault::Jump { size_m: jump.size };
        reject(flight, &mut report, Body::Quadrotor, fault, jump.rows);
    }
    for jump in jump::find(attitudes, options.turn_tolerance, longest, quaternion::align) {
        // Two unit quaternions that turn by θ are 2 sin(θ/4) apart.
        let fault = Fault::Turn {
            angle_rad: 4.0 * (0.5 * jump.size).asin(),
        };
        reject(flight, &mut report, Body::Quadrotor, fault, jump.rows);
    }
    for jump in jump::find(tips, options.tip_jump_tolerance_m, longest, |_, x| x) {
        let fault = Fault::Jump { size_m: jump.size };
        reject(flight, &mut report, Body::EndEffector, fault, jump.rows);
    }

    repair_signs(flight, &mut report);
    report
        .findings
        .sort_by_key(|finding| (finding.first_row, finding.body));
    report.rows_with_state = flight
        .samples
        .iter()
        .filter(|sample| sample.state().is_some())
        .count();
    report
}

/// Reports `fault` and removes the poses it spoils: the body's own, or both where the command is in doubt.
fn reject(flight: &mut Flight, report: &mut HygieneReport, body: Body, fault: Fault, rows: Range<usize>) {
    for sample in &mut flight.samples[rows.clone()] {
        if body != Body::EndEffector {
            sample.quadrotor = None;
        }
        if body != Body::Quadrotor {
            sample.end_effector = None;
        }
    }
    report.add(flight, body, fault, rows);
}

/// Turns poses with NaN or infinite numbers into missing ones.
fn drop_non_finite(flight: &mut Flight) {
    let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
    for sample in &mut flight.samples {
        sample.quadrotor = sample
            .quadrotor
            .filter(|pose| finite(&pose.position) && finite(&pose.attitude));
        sample.end_effector = sample.end_effector.filter(|position| finite(position));
    }
}

fn report_missing(flight: &Flight, report: &mut HygieneReport) {
    let missing = |of: fn(&Sample) -> bool| spans(flight.samples.iter().map(of));
    for rows in missing(|sample| sample.quadrotor.is_none()) {
        report.add(flight, Body::Quadrotor, Fault::Missing, rows);
    }
    for rows in missing(|sample| sample.end_effector.is_none()) {
        report.add(flight, Body::EndEffector, Fault::Missing, rows);
    }
}

/// Gives each attitude the sign that is nearest to its predecessor, and the first one `w ≥ 0`.
fn repair_signs(flight: &mut Flight, report: &mut HygieneReport) {
    const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
    let mut reference = UPRIGHT;
    let mut flipped = vec![false; flight.samples.len()];
    for (row, sample) in flight.samples.iter_mut().enumerate() {
        let Some(pose) = &mut sample.quadrotor else {
            continue;
        };
        reference = quaternion::align(reference, pose.attitude);
        flipped[row] = reference != pose.attitude;
        pose.attitude = reference;
    }
    for rows in spans(flipped.into_iter()) {
        report.add(flight, Body::Quadrotor, Fault::SignFlip, rows);
    }
}

/// The maximal ranges in which `marks` is true.
fn spans(marks: impl Iterator<Item = bool>) -> Vec<Range<usize>> {
    let mut spans: Vec<Range<usize>> = Vec::new();
    for (row, _) in marks.enumerate().filter(|(_, marked)| *marked) {
        match spans.last_mut() {
            Some(span) if span.end == row => span.end += 1,
            _ => spans.push(row..row + 1),
        }
    }
    spans
}

#[cfg(test)]
mod tests;
