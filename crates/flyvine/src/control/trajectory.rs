//! What is flown: the part of a plan that control needs.

use crate::flight::Configuration;
use crate::link::Feedforward;
use crate::task::Plan;

/// Entries of the state x at one instant: quadrotor position, attitude vector part, end-effector position.
pub(super) const POSE_STATE_LEN: usize = 9;

/// N knots of commands, predicted states, feedback gains and arm configurations, checked for size and
/// finiteness.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    commands: Vec<[f64; 3]>,
    states: Vec<Vec<f64>>,
    gains: Vec<Vec<f64>>,
    configurations: Vec<Configuration>,
    command_lower: [f64; 3],
    command_upper: [f64; 3],
    feedforward: Feedforward,
}

/// Arrays that do not make a trajectory.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Fewer than two knots.
    #[error("a trajectory has at least 2 knots; found {found}")]
    TooShort {
        /// Knots found.
        found: usize,
    },
    /// An array of the wrong length.
    #[error("{array}: length {found}; expected {expected}")]
    Length {
        /// Which array.
        array: String,
        /// Its length.
        found: usize,
        /// The length that fits the others.
        expected: String,
    },
    /// A NaN or an infinity.
    #[error("{array}: not finite")]
    NotFinite {
        /// Which array.
        array: String,
    },
    /// No command satisfies the bounds.
    #[error("command bounds, axis {axis}: [{lower}, {upper}]; expected lower ≤ upper")]
    Bounds {
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// Lower bound, m.
        lower: f64,
        /// Upper bound, m.
        upper: f64,
    },
}

impl Trajectory {
    /// The trajectory of a plan, with feedback within the command bounds of its task and its task's feed-forward.
    pub fn of_plan(plan: &Plan) -> Result<Self, TrajectoryError> {
        let bounds = plan.task.command_bounds();
        let trajectory = Self::new(
            plan.commands.clone(),
            plan.states.clone(),
            plan.gains.clone(),
            plan.configurations.clone(),
            bounds.lower,
            bounds.upper,
        )?;
        Ok(trajectory.with_feedforward(plan.task.feedforward))
    }

    /// Checks and keeps a trajectory of N knots:
    ///
    /// - `commands` (N−1): u*_k, m;
    /// - `states` (N, each of length n ≥ 9): z*_k, whose first nine entries are the state x at t_k;
    /// - `gains` (N−1, each 3 × n row-major, or none at all): K_k in u_k = u*_k + K_k (z_k − z*_k);
    /// - `configurations` (N);
    /// - `command_lower`, `command_upper`: bounds on feedback's commands, m, infinite for none.
    pub fn new(
        commands: Vec<[f64; 3]>,
        states: Vec<Vec<f64>>,
        gains: Vec<Vec<f64>>,
        configurations: Vec<Configuration>,
        command_lower: [f64; 3],
        command_upper: [f64; 3],
    ) -> Result<Self, TrajectoryError> {
        let knots = states.len();
        if knots < 2 {
            return Err(TrajectoryError::TooShort { found: knots });
        }
        let length = |array: String, found: usize, expected: usize| {
            if found == expected {
                return Ok(());
            }
            Err(TrajectoryError::Length {
                array,
                found,
                expected: expected.to_string(),
            })
        };
        let finite = |array: String, numbers: &[f64]| {
            if numbers.iter().all(|number| number.is_finite()) {
                return Ok(());
            }
            Err(TrajectoryError::NotFinite { array })
        };
        let state_len = states[0].len();
        if state_len < POSE_STATE_LEN {
            return Err(TrajectoryError::Length {
                array: "state at knot 0".into(),
                found: state_len,
                expected: format!("at least {POSE_STATE_LEN}"),
            });
        }
        length("commands".into(), commands.len(), knots - 1)?;
        length("configurations".into(), configurations.len(), knots)?;
        if !gains.is_empty() {
            length("gains".into(), gains.len(), knots - 1)?;
        }
        for (knot, state) in states.iter().enumerate() {
            length(format!("state at knot {knot}"), state.len(), state_len)?;
            finite(format!("state at knot {knot}"), state)?;
        }
        for (knot, gain) in gains.iter().enumerate() {
            length(format!("gain at knot {knot}"), gain.len(), 3 * state_len)?;
            finite(format!("gain at knot {knot}"), gain)?;
        }
        for (knot, command) in commands.iter().enumerate() {
            finite(format!("command at knot {knot}"), command)?;
        }
        for (
            knot,
            Configuration {
                length_m,
                pressure_kpa,
            },
        ) in configurations.iter().enumerate()
        {
            finite(
                format!("configuration at knot {knot}"),
                &[*length_m, *pressure_kpa],
            )?;
        }
        for axis in 0..3 {
            let (lower, upper) = (command_lower[axis], command_upper[axis]);
            if lower.is_nan() || upper.is_nan() || lower > upper {
                return Err(TrajectoryError::Bounds { axis, lower, upper });
            }
        }
        Ok(Self {
            commands,
            states,
            gains,
            configurations,
            command_lower,
            command_upper,
            feedforward: Feedforward::None,
        })
    }

    /// The same trajectory, flown with `feedforward` beside the positions.
    pub fn with_feedforward(self, feedforward: Feedforward) -> Self {
        Self { feedforward, ..self }
    }

    /// What the vehicle is sent beside positions.
    pub fn feedforward(&self) -> Feedforward {
        self.feedforward
    }

    /// Number of knots N.
    pub fn knots(&self) -> usize {
        self.states.len()
    }

    /// Length n of the states.
    pub fn state_len(&self) -> usize {
        self.states[0].len()
    }

    /// The command u*_k, k < N − 1, m.
    pub fn command(&self, knot: usize) -> [f64; 3] {
        self.commands[knot]
    }

    /// The state z*_k (n).
    pub fn state(&self, knot: usize) -> &[f64] {
        &self.states[knot]
    }

    /// The gain K_k, k < N − 1 (3 × n, row-major), if the trajectory has gains.
    pub fn gain(&self, knot: usize) -> Option<&[f64]> {
        self.gains.get(knot).map(Vec::as_slice)
    }

    /// The arm's configuration at t_k.
    pub fn configuration(&self, knot: usize) -> Configuration {
        self.configurations[knot]
    }

    /// Where the quadrotor and the end effector are predicted at t_0, m.
    pub fn start(&self) -> ([f64; 3], [f64; 3]) {
        let state = &self.states[0];
        ([state[0], state[1], state[2]], [state[6], state[7], state[8]])
    }

    /// Lower and upper bounds of the command, m.
    pub fn command_bounds(&self) -> ([f64; 3], [f64; 3]) {
        (self.command_lower, self.command_upper)
    }

    /// `command` within the plan's bounds; NaN stays NaN.
    pub fn clip(&self, command: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| command[axis].clamp(self.command_lower[axis], self.command_upper[axis]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Configuration = Configuration {
        length_m: 0.7,
        pressure_kpa: 0.0,
    };

    struct Parts {
        commands: Vec<[f64; 3]>,
        states: Vec<Vec<f64>>,
        gains: Vec<Vec<f64>>,
        configurations: Vec<Configuration>,
        upper: [f64; 3],
    }

    fn parts() -> Parts {
        Parts {
            commands: vec![[0.0, 0.0, 1.5]; 2],
            states: vec![vec![0.0; 9]; 3],
            gains: vec![vec![0.0; 27]; 2],
            configurations: vec![SHORT; 3],
            upper: [3.0; 3],
        }
    }

    fn build(change: impl FnOnce(&mut Parts)) -> Result<Trajectory, TrajectoryError> {
        let mut parts = parts();
        change(&mut parts);
        let Parts {
            commands,
            states,
            gains,
            configurations,
            upper,
        } = parts;
        Trajectory::new(commands, states, gains, configurations, [-3.0; 3], upper)
    }

    #[test]
    fn arrays_that_fit_are_kept() {
        let trajectory = build(|_| ()).unwrap();
        assert_eq!((trajectory.knots(), trajectory.state_len()), (3, 9));
        assert_eq!(trajectory.clip([5.0, -5.0, 1.0]), [3.0, -3.0, 1.0]);
        assert_eq!(build(|p| p.gains.clear()).unwrap().gain(0), None);
    }

    #[test]
    fn each_wrong_size_and_number_is_named() {
        let message = |change: fn(&mut Parts)| build(change).unwrap_err().to_string();
        assert!(message(|p| p.states.truncate(1)).contains("at least 2 knots; found 1"));
        assert!(message(|p| p.commands.push([0.0; 3])).contains("commands: length 3; expected 2"));
        assert!(message(|p| p.states[0].truncate(8)).contains("expected at least 9"));
        assert!(message(|p| p.states[2].push(0.0)).contains("state at knot 2: length 10; expected 9"));
        assert!(message(|p| p.gains.truncate(1)).contains("gains: length 1; expected 2"));
        assert!(message(|p| p.gains[1].truncate(26)).contains("gain at knot 1: length 26; expected 27"));
        assert!(message(|p| p.configurations.truncate(2)).contains("configurations: length 2; expected 3"));
        assert!(message(|p| p.commands[1][2] = f64::NAN).contains("command at knot 1: not finite"));
        assert!(message(|p| p.states[1][4] = f64::INFINITY).contains("state at knot 1: not finite"));
        assert!(message(|p| p.gains[0][5] = f64::NAN).contains("gain at knot 0: not finite"));
        assert!(message(|p| p.configurations[2].length_m = f64::NAN).contains("configuration at knot 2"));
        assert!(message(|p| p.upper[1] = -4.0).contains("axis 1"));
        assert!(message(|p| p.upper[0] = f64::NAN).contains("axis 0"));
    }
}
