//! Interpolation through timed points.

/// Linear interpolation through `(t, value)` points; constant outside them.
pub(super) fn linear(points: &[[f64; 2]], t: f64) -> f64 {
    let after = points.partition_point(|point| point[0] <= t);
    if after == 0 {
        return points[0][1];
    }
    if after == points.len() {
        return points[after - 1][1];
    }
    let ([t0, v0], [t1, v1]) = (points[after - 1], points[after]);
    v0 + (v1 - v0) * (t - t0) / (t1 - t0)
}

/// Cubic Hermite interpolation through `(times, values)` with zero end velocities and, inside, the velocity
/// of the parabola through a point and its two neighbours; constant outside the times.
pub(super) fn cubic(times: &[f64], values: &[f64], t: f64) -> f64 {
    let last = times.len() - 1;
    if t <= times[0] {
        return values[0];
    }
    if t >= times[last] {
        return values[last];
    }
    let velocity = |i: usize| {
        if i == 0 || i == last {
            return 0.0;
        }
        let (before, after) = (times[i] - times[i - 1], times[i + 1] - times[i]);
        let (slope_before, slope_after) = (
            (values[i] - values[i - 1]) / before,
            (values[i + 1] - values[i]) / after,
        );
        (slope_before * after + slope_after * before) / (before + after)
    };
    let i = times.partition_point(|&time| time <= t) - 1;
    let h = times[i + 1] - times[i];
    let s = (t - times[i]) / h;
    let (s2, s3) = (s * s, s * s * s);
    (2.0 * s3 - 3.0 * s2 + 1.0) * values[i]
        + (s3 - 2.0 * s2 + s) * h * velocity(i)
        + (3.0 * s2 - 2.0 * s3) * values[i + 1]
        + (s3 - s2) * h * velocity(i + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_holds_outside_and_interpolates_inside() {
        let points = [[1.0, 2.0], [3.0, 6.0]];
        assert_eq!(linear(&points, 0.0), 2.0);
        assert_eq!(linear(&points, 2.0), 4.0);
        assert_eq!(linear(&points, 9.0), 6.0);
    }

    #[test]
    fn cubic_passes_its_points_and_is_smooth_there() {
        let (times, values) = ([0.0, 1.0, 1.5, 4.0], [0.0, 2.0, 1.0, 1.5]);
        for (t, value) in times.iter().zip(values) {
            assert!((cubic(&times, &values, *t) - value).abs() < 1e-12);
        }
        let h = 1e-6;
        for t in [1.0, 1.5] {
            let before = (cubic(&times, &values, t) - cubic(&times, &values, t - h)) / h;
            let after = (cubic(&times, &values, t + h) - cubic(&times, &values, t)) / h;
            assert!(
                (before - after).abs() < 1e-4,
                "velocity jumps at {t}: {before} {after}"
            );
        }
    }
}
