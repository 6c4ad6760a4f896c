//! The command reference ū and its α.
//!
//! The paper sets `ū_x(k) = α_x q̄_x(k + α_t)`, `ū_y(k) = α_y q̄_y(k + α_t)`, `ū_z = q̄_z` and tunes α by hand on
//! the model (Sec. IV-A). Here α is searched: every shift up to one second, and for each the scales by
//! Gauss–Newton on the end effector's error in the model.

use super::file::{CommandShaping, Motion, Task};
use super::reference::Reference;
use super::swing::swing_x;
use crate::trajopt::Dynamics;

/// Greatest shift that is tried, knots.
const GREATEST_SHIFT: usize = 20;
/// Gauss–Newton steps on the scales; lagged models are nearly linear, so that few suffice.
const SCALE_STEPS: usize = 3;
/// Scales are kept in this range.
const SCALE_RANGE: [f64; 2] = [0.1, 2.0];

/// A command reference, and how well it does on its own.
#[derive(Debug, Clone, PartialEq)]
pub struct CommandReference {
    /// ū ((N−1) × 3), m.
    pub commands: Vec<[f64; 3]>,
    /// The α that made it; `None` for a swing, whose reference is its hand-made profile.
    pub shaping: Option<CommandShaping>,
    /// Mean 3-D distance of the end effector to its reference when ū is rolled out on the model, m; not finite
    /// if the rollout diverges.
    pub rollout_error_m: f64,
}

impl CommandReference {
    /// Builds ū for `task` on `dynamics`, whose state starts at `start` (n) and begins with x.
    pub fn build(task: &Task, reference: &Reference, dynamics: &dyn Dynamics, start: &[f64]) -> Self {
        let rollout = |commands: &[[f64; 3]]| EndEffectorRollout::new(reference, dynamics, start, commands);
        if let Motion::Swing(swing) = task.motion() {
            let knots = task.knots() - 1;
            let commands: Vec<_> = (0..knots)
                .map(|k| [swing_x(swing, k)[0], 0.0, crate::HOVER_HEIGHT_M])
                .collect();
            let rollout_error_m = rollout(&commands).mean_error_m();
            return Self {
                commands,
                shaping: None,
                rollout_error_m,
            };
        }
        let shaped = |shaping: CommandShaping| {
            let commands = shape(task, shaping);
            let rollout_error_m = rollout(&commands).mean_error_m();
            Self {
                commands,
                shaping: Some(shaping),
                rollout_error_m,
            }
        };
        if let Some(shaping) = task.command_reference {
            return shaped(shaping);
        }
        let candidates = (0..=GREATEST_SHIFT).map(|shift_knots| {
            let mut shaping = CommandShaping {
                shift_knots,
                scale: [1.0, 1.0],
            };
            for _ in 0..SCALE_STEPS {
                let residuals =
                    |scale: [f64; 2]| rollout(&shape(task, CommandShaping { scale, ..shaping })).errors;
                shaping.scale = improve_scale(shaping.scale, residuals);
            }
            shaped(shaping)
        });
        candidates
            .min_by(|a, b| a.rollout_error_m.total_cmp(&b.rollout_error_m))
            .expect("there is at least the shift 0")
    }
}

/// ū for given α.
fn shape(task: &Task, shaping: CommandShaping) -> Vec<[f64; 3]> {
    (0..task.knots() - 1)
        .map(|knot| {
            let (ahead, _) = task.positions_at(knot + shaping.shift_knots);
            let (now, _) = task.positions_at(knot);
            [shaping.scale[0] * ahead[0], shaping.scale[1] * ahead[1], now[2]]
        })
        .collect()
}

/// One Gauss–Newton step on the two scales, `Δ = −(JᵀJ)⁻¹ Jᵀ r`, with J by forward differences.
fn improve_scale(scale: [f64; 2], residuals: impl Fn([f64; 2]) -> Vec<f64>) -> [f64; 2] {
    const STEP: f64 = 1e-3;
    let at = residuals(scale);
    let column = |moved: [f64; 2]| -> Vec<f64> {
        residuals(moved)
            .iter()
            .zip(&at)
            .map(|(there, here)| (there - here) / STEP)
            .collect()
    };
    let (jx, jy) = (
        column([scale[0] + STEP, scale[1]]),
        column([scale[0], scale[1] + STEP]),
    );
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let (xx, xy, yy) = (dot(&jx, &jx), dot(&jx, &jy), dot(&jy, &jy));
    let (gx, gy) = (dot(&jx, &at), dot(&jy, &at));
    let determinant = xx * yy - xy * xy;
    let next = [
        scale[0] - (yy * gx - xy * gy) / determinant,
        scale[1] - (xx * gy - xy * gx) / determinant,
    ];
    // A diverging rollout or a path without motion on one axis gives no direction.
    if next.iter().all(|value| value.is_finite()) {
        next.map(|value| value.clamp(SCALE_RANGE[0], SCALE_RANGE[1]))
    } else {
        scale
    }
}

/// End-effector errors of a rollout, flat (N × 3), m.
struct EndEffectorRollout {
    errors: Vec<f64>,
}

impl EndEffectorRollout {
    fn new(reference: &Reference, dynamics: &dyn Dynamics, start: &[f64], commands: &[[f64; 3]]) -> Self {
        let fresh_len = dynamics.fresh_len();
        let mut state = start.to_vec();
        let mut fresh = vec![0.0; fresh_len];
        let mut command = vec![0.0; dynamics.command_len()];
        let mut errors = Vec::with_capacity(3 * reference.end_effector.len());
        for (knot, target) in reference.end_effector.iter().enumerate() {
            errors.extend((0..3).map(|axis| state[6 + axis] - target[axis]));
            if let Some(position) = commands.get(knot) {
                command[..3].copy_from_slice(position);
                dynamics.step(knot, &state, &command, &mut fresh);
                state.copy_within(..start.len() - fresh_len, fresh_len);
                state[..fresh_len].copy_from_slice(&fresh);
            }
        }
        Self { errors }
    }

    fn mean_error_m(&self) -> f64 {
        let distances = self
            .errors
            .chunks_exact(3)
            .map(|e| e.iter().map(|v| v * v).sum::<f64>().sqrt());
        let mean = distances.sum::<f64>() / (self.errors.len() / 3) as f64;
        if mean.is_finite() { mean } else { f64::INFINITY }
    }
}
