//! The lemniscate of the paper (Sec. IV-A), with its ramp.

use std::f64::consts::TAU;

/// Phase time: `s = t²/(2 t_r)` on the ramp, `s = t − t_r/2` after it, so that `ds/dt` grows linearly to 1.
pub(super) fn phase_time(t_s: f64, ramp_s: f64) -> f64 {
    if t_s < ramp_s {
        t_s * t_s / (2.0 * ramp_s)
    } else {
        t_s - ramp_s / 2.0
    }
}

/// `(x, y) = (sin φ, cos φ sin φ)`, φ = 2π s/T, in metres.
pub(super) fn lemniscate_xy(t_s: f64, period_s: f64, ramp_s: f64) -> [f64; 2] {
    let (sine, cosine) = (TAU * phase_time(t_s, ramp_s) / period_s).sin_cos();
    [sine, cosine * sine]
}
