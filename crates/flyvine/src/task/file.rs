//! The task file: TOML in, checked [`Task`] out.

use serde::{Deserialize, Serialize};
use std::path::Path;

use super::TaskError;
use super::constraints::{self, Contact, Obstacle, SupportDemand, Tube};
use super::growth::Growth;
use crate::DT;
use crate::flight::{Configuration, SIGNALS};
use crate::link::Feedforward;

/// One task, as read from its file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Name, used for files and figures.
    pub name: String,
    /// The arm's configuration at the start (and, except for `deploy`, throughout).
    pub configuration: Configuration,
    /// Track a lemniscate with the end effector.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lemniscate: Option<Lemniscate>,
    /// Swing the end effector to a target.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub swing: Option<Swing>,
    /// Track a lemniscate at constant height while the arm grows and inflates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deploy: Option<Deploy>,
    /// Pass the user's own points at the user's own times.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub waypoints: Option<Waypoints>,
    /// Cost weights; the paper's for the motion where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<Weights>,
    /// Command bounds, m; the paper's for the motion where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command_bounds: Option<Bounds>,
    /// What the vehicle is sent beside positions: as the flights were that the bank was fitted to.
    #[serde(default, skip_serializing_if = "Feedforward::is_none")]
    pub feedforward: Feedforward,
    /// What changes of the command cost, and how large they may be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command_change: Option<CommandChange>,
    /// Bounds on signals of the state, in addition to those that the motion brings.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub state_bounds: Vec<SignalBound>,
    /// What neither quadrotor nor arm may touch.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub obstacles: Vec<Obstacle>,
    /// Lines that the end effector stays near for a while.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tubes: Vec<Tube>,
    /// Planes that the end effector stays on for a while.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contacts: Vec<Contact>,
    /// What it costs to leave the region that the bank's flights support.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub support: Option<SupportDemand>,
    /// Length and pressure are the plan's choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub growth: Option<Growth>,
    /// The command reference's α: searched on the model where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command_reference: Option<CommandShaping>,
}

/// End effector on `x = sin φ, y = cos φ sin φ` with `φ = 2π s/T`, one period plus the ramp
/// (paper, Sec. IV-A).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lemniscate {
    /// Period T, s.
    pub period_s: f64,
    /// Ramp t_r over which the phase speed grows from 0 to 1, s.
    pub ramp_s: f64,
}

/// Swing the end effector to a target in the xz-plane (paper, Sec. IV-B).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Swing {
    /// Target (x, z) of the end effector, m.
    pub target_m: [f64; 2],
    /// Time at which the target is reached, s, a multiple of the sample time.
    #[serde(default = "Swing::default_target_time_s")]
    pub target_time_s: f64,
    /// Displacement (x, z) over the last sample before the target, m: the demanded velocity times dt.
    #[serde(default = "Swing::default_approach_m")]
    pub approach_m: [f64; 2],
    /// Cost per metre of distance from the target, along x and along z, at its knot and at the one before; where left
    /// out, the target must be met.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_price: Option<f64>,
    /// Length of the motion, s.
    #[serde(default = "Swing::default_duration_s")]
    pub duration_s: f64,
    /// Hand-made x command that the references are made of: (time s, x m) points, linear in between.
    #[serde(default = "Swing::default_profile")]
    pub profile: Vec<[f64; 2]>,
    /// Upper limits on the quadrotor's x and z, m.
    #[serde(default = "Swing::default_quadrotor_limits_m")]
    pub quadrotor_limits_m: [f64; 2],
}

impl Swing {
    fn default_target_time_s() -> f64 {
        1.25
    }
    fn default_approach_m() -> [f64; 2] {
        [0.1, 0.1]
    }
    fn default_duration_s() -> f64 {
        2.5
    }
    fn default_profile() -> Vec<[f64; 2]> {
        vec![
            [0.0, 0.0],
            [0.4, -0.8],
            [0.7, -0.8],
            [1.1, 0.8],
            [1.5, 0.8],
            [2.0, 0.0],
        ]
    }
    fn default_quadrotor_limits_m() -> [f64; 2] {
        [1.02, 1.53]
    }
    /// Knot at which the target is reached.
    pub fn target_knot(&self) -> usize {
        (self.target_time_s / DT).round() as usize
    }
}

/// Lemniscate at constant end-effector height while length and pressure go linearly to `final_configuration`
/// (paper, Sec. IV-C).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deploy {
    /// Period T, s.
    pub period_s: f64,
    /// Ramp t_r, s.
    pub ramp_s: f64,
    /// Length of the motion, s.
    pub duration_s: f64,
    /// Constant height of the end effector, m.
    pub end_effector_height_m: f64,
    /// Configuration at the last knot.
    pub final_configuration: Configuration,
}

/// The user's own path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoints {
    /// Points in time order; the motion starts at rest at t = 0 and ends at the last point.
    pub points: Vec<Waypoint>,
}

/// One point of the user's path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// Time, s.
    pub t_s: f64,
    /// End-effector position, m.
    pub end_effector: [f64; 3],
    /// Whether the plan must pass exactly here (an equality) or only come near (the cost).
    #[serde(default)]
    pub exact: bool,
}

/// Diagonal cost weights.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// On the newest end-effector position.
    pub end_effector: f64,
    /// On every other entry of the measured states, lags included.
    pub state: f64,
    /// On the command's deviation from its reference.
    pub command: f64,
}

/// A box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bounds {
    /// Lower corner.
    pub lower: [f64; 3],
    /// Upper corner.
    pub upper: [f64; 3],
}

/// What it costs that the command changes from one knot to the next. Without it a plan may use motions faster than any
/// flight that its models were fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandChange {
    /// Cost of the squared change of each axis, per m².
    #[serde(default)]
    pub weight: f64,
    /// Largest change of each axis, m per knot; no limit where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_m: Option<f64>,
}

/// Bound on one signal at every knot after the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalBound {
    /// Signal, one of [`SIGNALS`].
    pub signal: String,
    /// Lower bound, none where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<f64>,
    /// Upper bound, none where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper: Option<f64>,
    /// Cost of a unit of violation at every knot; where left out, the bound must hold.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub price: Option<f64>,
}

/// The paper's α: `ū_x(k) = scale[0] · q̄_x(k + shift)`, `ū_y(k) = scale[1] · q̄_y(k + shift)` (paper, Sec. IV-A).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandShaping {
    /// α_t, knots by which the command runs ahead.
    pub shift_knots: usize,
    /// (α_x, α_y).
    pub scale: [f64; 2],
}

/// The motion of a task.
#[derive(Debug, Clone, Copy)]
pub enum Motion<'a> {
    /// See [`Lemniscate`].
    Lemniscate(&'a Lemniscate),
    /// See [`Swing`].
    Swing(&'a Swing),
    /// See [`Deploy`].
    Deploy(&'a Deploy),
    /// See [`Waypoints`].
    Waypoints(&'a Waypoints),
}

impl Task {
    /// Reads and checks a task file.
    pub fn read(path: &Path) -> Result<Self, TaskError> {
        let text = std::fs::read_to_string(path).map_err(|source| TaskError::Read {
            path: path.display().to_string(),
            source,
        })?;
        Self::parse(&text, &path.display().to_string())
    }

    /// Checks the text of a task file; `path` is only named in errors.
    pub fn parse(text: &str, path: &str) -> Result<Self, TaskError> {
        let task: Self = toml::from_str(text).map_err(|error| TaskError::Parse {
            path: path.to_owned(),
            message: error.to_string(),
        })?;
        task.validate()?;
        Ok(task)
    }

    /// The task's motion.
    ///
    /// # Panics
    /// If the task has not exactly one motion, which [`Self::validate`] refuses.
    pub fn motion(&self) -> Motion<'_> {
        let lemniscate = self.lemniscate.as_ref().map(Motion::Lemniscate);
        let swing = self.swing.as_ref().map(Motion::Swing);
        let deploy = self.deploy.as_ref().map(Motion::Deploy);
        let waypoints = self.waypoints.as_ref().map(Motion::Waypoints);
        lemniscate
            .or(swing)
            .or(deploy)
            .or(waypoints)
            .expect("a validated task has a motion")
    }

    /// Number of knots N.
    pub fn knots(&self) -> usize {
        let steps = |duration_s: f64| (duration_s / DT).round() as usize;
        match self.motion() {
            Motion::Lemniscate(lemniscate) => {
                steps(lemniscate.period_s + lemniscate.ramp_s).saturating_add(1)
            }
            Motion::Swing(swing) => steps(swing.duration_s),
            Motion::Deploy(deploy) => steps(deploy.duration_s),
            Motion::Waypoints(waypoints) => {
                steps(waypoints.points.last().map_or(0.0, |point| point.t_s)).saturating_add(1)
            }
        }
    }

    /// Cost weights: the file's, or the paper's for this motion.
    pub fn weights(&self) -> Weights {
        self.weights.unwrap_or(match self.motion() {
            Motion::Swing(_) => Weights {
                end_effector: 1.0,
                state: 1.0,
                command: 10.0,
            },
            _ => Weights {
                end_effector: 20.0,
                state: 1.0,
                command: 1.0,
            },
        })
    }

    /// Command bounds: the file's, or the paper's for this motion.
    pub fn command_bounds(&self) -> Bounds {
        self.command_bounds.unwrap_or(match self.motion() {
            Motion::Swing(_) => Bounds {
                lower: [-2.0, -0.1, 1.4],
                upper: [2.0, 0.1, 1.6],
            },
            _ => Bounds {
                lower: [-3.0; 3],
                upper: [3.0; 3],
            },
        })
    }

    /// Refuses what cannot be posed, naming the field.
    pub fn validate(&self) -> Result<(), TaskError> {
        let name = self.name.as_str();
        let found = usize::from(self.lemniscate.is_some())
            + usize::from(self.swing.is_some())
            + usize::from(self.deploy.is_some())
            + usize::from(self.waypoints.is_some());
        if found != 1 {
            return Err(TaskError::MotionCount {
                task: name.to_owned(),
                found,
            });
        }
        if name.is_empty() || name.contains(['/', '\\']) || name.contains("..") {
            return Err(TaskError::value(
                name,
                "name",
                format!("`{name}`"),
                "a file name without folders",
            ));
        }
        let positive = |field: &str, value: f64| {
            (value.is_finite() && value > 0.0)
                .then_some(())
                .ok_or_else(|| TaskError::value(name, field, value, "a positive number"))
        };
        let finite = |field: &str, values: &[f64]| {
            values
                .iter()
                .all(|value| value.is_finite())
                .then_some(())
                .ok_or_else(|| TaskError::value(name, field, format!("{values:?}"), "finite numbers"))
        };
        if let Some(CommandChange { weight, max_m }) = self.command_change {
            if !(weight.is_finite() && weight >= 0.0) {
                return Err(TaskError::value(
                    name,
                    "command_change.weight",
                    weight,
                    "a number ≥ 0",
                ));
            }
            max_m.map_or(Ok(()), |max_m| positive("command_change.max_m", max_m))?;
        }
        let configuration = |field: &str, configuration: &Configuration| {
            positive(&format!("{field}.length_m"), configuration.length_m)?;
            let pressure = configuration.pressure_kpa;
            (pressure.is_finite() && pressure >= 0.0)
                .then_some(())
                .ok_or_else(|| {
                    TaskError::value(
                        name,
                        &format!("{field}.pressure_kpa"),
                        pressure,
                        "a gauge pressure ≥ 0 in kPa",
                    )
                })
        };
        configuration("configuration", &self.configuration)?;
        match self.motion() {
            Motion::Lemniscate(lemniscate) => {
                positive("lemniscate.period_s", lemniscate.period_s)?;
                positive("lemniscate.ramp_s", lemniscate.ramp_s)?;
            }
            Motion::Deploy(deploy) => {
                positive("deploy.period_s", deploy.period_s)?;
                positive("deploy.ramp_s", deploy.ramp_s)?;
                positive("deploy.duration_s", deploy.duration_s)?;
                positive("deploy.end_effector_height_m", deploy.end_effector_height_m)?;
                configuration("deploy.final_configuration", &deploy.final_configuration)?;
            }
            Motion::Swing(swing) => self.validate_swing(swing)?,
            Motion::Waypoints(waypoints) => self.validate_waypoints(waypoints)?,
        }
        let knots = self.knots();
        if !(4..=100_000).contains(&knots) {
            return Err(TaskError::value(
                name,
                "duration",
                format!("{knots} knots of {DT} s"),
                "4 to 100000 knots",
            ));
        }
        let weights = self.weights();
        positive("weights.command", weights.command)?;
        for (field, value) in [
            ("weights.end_effector", weights.end_effector),
            ("weights.state", weights.state),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(TaskError::value(name, field, value, "a number ≥ 0"));
            }
        }
        let bounds = self.command_bounds();
        finite("command_bounds.lower", &bounds.lower)?;
        finite("command_bounds.upper", &bounds.upper)?;
        for axis in 0..3 {
            if bounds.lower[axis] >= bounds.upper[axis] {
                let found = format!(
                    "lower {} ≥ upper {} on axis {axis}",
                    bounds.lower[axis], bounds.upper[axis]
                );
                return Err(TaskError::value(
                    name,
                    "command_bounds",
                    found,
                    "lower below upper on every axis",
                ));
            }
        }
        for bound in &self.state_bounds {
            if let Some(price) = bound.price {
                positive("state_bounds.price", price)?;
            }
            if !SIGNALS.contains(&bound.signal.as_str()) {
                let expected = format!("one of {}", SIGNALS.join(", "));
                return Err(TaskError::value(
                    name,
                    "state_bounds.signal",
                    format!("`{}`", bound.signal),
                    &expected,
                ));
            }
            let (lower, upper) = (
                bound.lower.unwrap_or(f64::NEG_INFINITY),
                bound.upper.unwrap_or(f64::INFINITY),
            );
            if lower.is_nan()
                || upper.is_nan()
                || lower >= upper
                || (lower, upper) == (f64::NEG_INFINITY, f64::INFINITY)
            {
                let found = format!("lower {lower}, upper {upper} on {}", bound.signal);
                return Err(TaskError::value(
                    name,
                    "state_bounds",
                    found,
                    "lower below upper, at least one of them given",
                ));
            }
        }
        if let Some(shaping) = &self.command_reference {
            finite("command_reference.scale", &shaping.scale)?;
            if shaping.shift_knots > 100 {
                return Err(TaskError::value(
                    name,
                    "command_reference.shift_knots",
                    shaping.shift_knots,
                    "at most 100",
                ));
            }
        }
        if let Some(growth) = &self.growth {
            growth.validate(self)?;
        }
        constraints::validate(self)
    }

    fn validate_swing(&self, swing: &Swing) -> Result<(), TaskError> {
        let name = self.name.as_str();
        if let Some(price) = swing.target_price
            && !(price.is_finite() && price > 0.0)
        {
            return Err(TaskError::value(
                name,
                "swing.target_price",
                price,
                "a positive number",
            ));
        }
        let numbers = [swing.target_m, swing.approach_m, swing.quadrotor_limits_m].concat();
        if numbers.iter().any(|value| value.is_nan() || value.abs() > 100.0) {
            return Err(TaskError::value(
                name,
                "swing",
                format!("{numbers:?}"),
                "positions in metres within ±100",
            ));
        }
        if !(swing.duration_s.is_finite() && swing.duration_s > 0.0) {
            return Err(TaskError::value(
                name,
                "swing.duration_s",
                swing.duration_s,
                "a positive number",
            ));
        }
        let in_motion = swing.target_time_s >= 2.0 * DT && swing.target_time_s <= swing.duration_s - DT;
        if !in_motion {
            let expected = format!(
                "between {} and duration_s − {DT} = {}",
                2.0 * DT,
                swing.duration_s - DT
            );
            return Err(TaskError::value(
                name,
                "swing.target_time_s",
                swing.target_time_s,
                &expected,
            ));
        }
        let increasing = swing.profile.windows(2).all(|pair| pair[0][0] < pair[1][0]);
        let finite = swing.profile.iter().flatten().all(|value| value.is_finite());
        if swing.profile.is_empty() || !increasing || !finite {
            let found = format!("{:?}", swing.profile);
            return Err(TaskError::value(
                name,
                "swing.profile",
                found,
                "finite (time, x) points in increasing time",
            ));
        }
        Ok(())
    }

    fn validate_waypoints(&self, waypoints: &Waypoints) -> Result<(), TaskError> {
        let name = self.name.as_str();
        let mut previous_s = 0.0;
        for (index, point) in waypoints.points.iter().enumerate() {
            if !(point.t_s.is_finite() && point.t_s >= previous_s + DT) {
                let expected = format!("a time at least {DT} s after the one before ({previous_s} s)");
                return Err(TaskError::value(
                    name,
                    &format!("waypoints.points[{index}].t_s"),
                    point.t_s,
                    &expected,
                ));
            }
            if point
                .end_effector
                .iter()
                .any(|value| value.is_nan() || value.abs() > 100.0)
            {
                let found = format!("{:?}", point.end_effector);
                let field = format!("waypoints.points[{index}].end_effector");
                return Err(TaskError::value(name, &field, found, "metres within ±100"));
            }
            previous_s = point.t_s;
        }
        if waypoints.points.is_empty() {
            return Err(TaskError::value(
                name,
                "waypoints.points",
                "none",
                "at least one point",
            ));
        }
        Ok(())
    }
}
