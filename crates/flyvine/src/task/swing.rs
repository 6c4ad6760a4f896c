//! The swing's hand-made references (paper, Sec. IV-B): a back-and-forth trapezoid, delayed for the
//! quadrotor and delayed more for the end effector.

use super::file::Swing;
use super::path;
use crate::DT;

/// Knots by which the quadrotor's reference runs behind the command's.
const QUADROTOR_DELAY_KNOTS: f64 = 6.0;
/// Knots by which the end effector's reference runs behind the command's.
const END_EFFECTOR_DELAY_KNOTS: f64 = 10.0;

/// x of the command, quadrotor and end-effector references at `knot`, m.
pub(super) fn swing_x(swing: &Swing, knot: usize) -> [f64; 3] {
    [0.0, QUADROTOR_DELAY_KNOTS, END_EFFECTOR_DELAY_KNOTS]
        .map(|delay| path::linear(&swing.profile, (knot as f64 - delay) * DT))
}
