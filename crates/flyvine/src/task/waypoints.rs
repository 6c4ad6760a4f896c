//! The user's own path: a smooth curve through the points, from rest.

use super::file::Waypoints;
use super::path;

/// End-effector reference at `t_s`, m: cubic Hermite from `start` at t = 0 through the points.
pub(super) fn waypoint_position(waypoints: &Waypoints, start: [f64; 3], t_s: f64) -> [f64; 3] {
    let times: Vec<f64> = std::iter::once(0.0)
        .chain(waypoints.points.iter().map(|point| point.t_s))
        .collect();
    std::array::from_fn(|axis| {
        let positions = waypoints.points.iter().map(|point| point.end_effector[axis]);
        let values: Vec<f64> = std::iter::once(start[axis]).chain(positions).collect();
        path::cubic(&times, &values, t_s)
    })
}
