//! References of a task: where quadrotor and end effector should be at each knot.

use super::file::{Motion, Task};
use super::lemniscate::lemniscate_xy;
use super::swing::swing_x;
use super::waypoints::waypoint_position;
use crate::flight::Configuration;
use crate::{DT, HOVER_HEIGHT_M};

/// References over the N knots of a task.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// Quadrotor position (N × 3), m.
    pub quadrotor: Vec<[f64; 3]>,
    /// End-effector position (N × 3), m.
    pub end_effector: Vec<[f64; 3]>,
    /// Configuration of the arm at each knot (N).
    pub configurations: Vec<Configuration>,
}

impl Task {
    /// The task's references.
    pub fn reference(&self) -> Reference {
        let knots = 0..self.knots();
        let configurations: Vec<_> = knots.clone().map(|knot| self.configuration_at(knot)).collect();
        let (quadrotor, end_effector) = knots.map(|knot| self.positions_at(knot)).unzip();
        Reference {
            quadrotor,
            end_effector,
            configurations,
        }
    }

    /// Configuration at a knot: constant, or linear in `k/(N−1)` while deploying.
    fn configuration_at(&self, knot: usize) -> Configuration {
        let Motion::Deploy(deploy) = self.motion() else {
            return self.configuration;
        };
        let share = knot as f64 / (self.knots() - 1) as f64;
        let mix = |from: f64, to: f64| from + (to - from) * share;
        Configuration {
            length_m: mix(self.configuration.length_m, deploy.final_configuration.length_m),
            pressure_kpa: mix(
                self.configuration.pressure_kpa,
                deploy.final_configuration.pressure_kpa,
            ),
        }
    }

    /// (quadrotor, end effector) at a knot, which may lie beyond the last one: paths go on analytically.
    pub(super) fn positions_at(&self, knot: usize) -> ([f64; 3], [f64; 3]) {
        let t_s = knot as f64 * DT;
        let length = self.configuration_at(knot).length_m;
        let above = |[x, y, z]: [f64; 3]| [x, y, z + length];
        match self.motion() {
            Motion::Lemniscate(lemniscate) => {
                let [x, y] = lemniscate_xy(t_s, lemniscate.period_s, lemniscate.ramp_s);
                let end_effector = [x, y, HOVER_HEIGHT_M - length];
                (above(end_effector), end_effector)
            }
            Motion::Deploy(deploy) => {
                let [x, y] = lemniscate_xy(t_s, deploy.period_s, deploy.ramp_s);
                let end_effector = [x, y, deploy.end_effector_height_m];
                (above(end_effector), end_effector)
            }
            Motion::Swing(swing) => {
                let [_, quadrotor_x, end_effector_x] = swing_x(swing, knot);
                (
                    [quadrotor_x, 0.0, HOVER_HEIGHT_M],
                    [end_effector_x, 0.0, HOVER_HEIGHT_M - length],
                )
            }
            Motion::Waypoints(waypoints) => {
                let rest = [0.0, 0.0, HOVER_HEIGHT_M - self.configuration.length_m];
                let end_effector = waypoint_position(waypoints, rest, t_s);
                (above(end_effector), end_effector)
            }
        }
    }
}
