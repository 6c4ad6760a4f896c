//! A plan: the optimized commands of a task on a bank, what the model predicts they do, and the feedback
//! gains around them. The plan carries its task and its bank, so that flying it needs no other file.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{CommandShaping, Task, TaskError};
use crate::DT;
use crate::file::write_whole;
use crate::flight::{Configuration, SIGNALS, VELOCITY_COLUMNS};
use crate::model::{Bank, ModelError};
use crate::trajopt::{EnsembleError, Options, ProblemError};

/// What the file says it is.
pub(super) const SCHEMA: &str = "flyvine-plan";
/// Version of the plan format that this library writes and reads.
pub const PLAN_SCHEMA_VERSION: u64 = 1;

/// The optimized motion for one task on one bank. Knots are counted from 0; there are N states and N − 1
/// commands, [`DT`] apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Always `flyvine-plan`.
    pub schema: String,
    /// See [`PLAN_SCHEMA_VERSION`].
    pub schema_version: u64,
    /// The task.
    pub task: Task,
    /// Configuration of the arm at each knot (N).
    pub configurations: Vec<Configuration>,
    /// Commanded quadrotor position ((N−1) × 3), m.
    pub commands: Vec<[f64; 3]>,
    /// Predicted states (N × n); the first nine entries of each are x.
    pub states: Vec<Vec<f64>>,
    /// Feedback gains ((N−1) × 3n, each 3 × n row-major): `u = u_k + K_k (z − z_k)`.
    pub gains: Vec<Vec<f64>>,
    /// End-effector reference (N × 3), m.
    pub reference: Vec<[f64; 3]>,
    /// The command reference's α and its own error on the model; no α for a swing.
    pub command_reference: CommandReferenceSummary,
    /// How the solve ended.
    pub solve: SolveSummary,
    /// Where it came from.
    pub provenance: Provenance,
    /// The models it was made on; for an ensemble the first member's, on which `states` and `gains` are.
    pub bank: Bank,
    /// What the end effector was off the model's prediction in an earlier flight, which the plan makes up for (N × 3), m;
    /// empty if nothing was learnt.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub model_error_m: Vec<[f64; 3]>,
    /// What each member of an ensemble makes of the commands; empty for a plan on one bank.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ensemble: Vec<MemberPrediction>,
}

/// What one member of an ensemble predicts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MemberPrediction {
    /// For a swing, the xz distance between end effector and target at its knot, m.
    pub target_miss_m: Option<f64>,
    /// Mean distance from predicted end effector to reference, m.
    pub predicted_error_m: f64,
    /// Largest violation of a state bound.
    pub max_violation: f64,
}

/// The command reference that the solve started from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandReferenceSummary {
    /// α, searched or given.
    pub shaping: Option<CommandShaping>,
    /// Whether α was searched on the model.
    pub searched: bool,
    /// Mean end-effector error when the reference itself is rolled out on the model, m; none if it diverges.
    pub rollout_error_m: Option<f64>,
}

/// How a solve ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolveSummary {
    /// In words.
    pub status: String,
    /// Whether violation and stationarity are within tolerance.
    pub converged: bool,
    /// Cost J.
    pub cost: f64,
    /// Largest constraint violation.
    pub max_violation: f64,
    /// Largest projected gradient over 1 + |J|.
    pub stationarity: f64,
    /// Iterations.
    pub iterations: usize,
    /// The constraints that are violated, worst first, in words.
    pub violated: Vec<String>,
    /// Where that cannot be helped: active bounds, in words, and whether the task could be solved with those alone moved out;
    /// empty in plans of older versions.
    #[serde(default)]
    pub loosened: Vec<String>,
    /// Mean distance from predicted end effector to reference, m.
    pub predicted_error_m: f64,
    /// What every active bound and equality costs; empty in plans of older versions.
    #[serde(default)]
    pub sensitivities: Vec<Sensitivity>,
}

/// What one active bound or equality costs at one knot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensitivity {
    /// The constraint, in words.
    pub constraint: String,
    /// Knot.
    pub knot: usize,
    /// Its multiplier: raising the bound, or the value demanded, by ε changes the cost J by −ε · multiplier.
    pub multiplier: f64,
}

/// Where a plan came from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Program and version.
    pub tool: String,
    /// SHA-256 of the task file's text, hexadecimal.
    pub task_sha256: String,
    /// SHA-256 of the bank file, hexadecimal.
    pub bank_sha256: String,
}

/// Settings of planning.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlanOptions {
    /// Settings of the solver.
    pub solver: Options,
    /// SHA-256 of the task file's text, for provenance.
    pub task_sha256: String,
    /// SHA-256 of the bank file, for provenance.
    pub bank_sha256: String,
}

/// Why no plan could be made, read or written. A solve that does not converge is no error: its status says so.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The task cannot be posed.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The bank has no model for the task.
    #[error("task `{task}`: {source}")]
    Model {
        /// The task.
        task: String,
        /// What the bank says.
        source: ModelError,
    },
    /// The optimal-control problem is malformed.
    #[error("task `{task}`: {source}")]
    Problem {
        /// The task.
        task: String,
        /// What is wrong.
        source: ProblemError,
    },
    /// The banks make no ensemble.
    #[error("task `{task}`: {source}")]
    Ensemble {
        /// The task.
        task: String,
        /// What is wrong.
        source: EnsembleError,
    },
    /// The bank's models take inputs that a plan does not command.
    #[error(
        "task `{task}`: found models with {found} inputs, expected 3 (commanded position); \
         ask for feedforward = \"velocity\", or fit the bank without commanded velocity, to plan on it"
    )]
    Inputs {
        /// The task.
        task: String,
        /// Inputs of the models.
        found: usize,
    },
    /// The task's flights shall be sent velocities, which the bank's were not.
    #[error(
        "task `{task}`, feedforward: found a bank whose flights were sent positions only, expected one whose flights were \
         sent velocities, too; fit it to such flights, or leave feedforward out"
    )]
    NoFeedforward {
        /// The task.
        task: String,
    },
    /// The task shall stay in the region that flights support, which the bank does not know.
    #[error(
        "task `{task}`, support: found a bank without the region that its flights support; \
         fit the flights again with this version, or leave [support] out"
    )]
    NoSupport {
        /// The task.
        task: String,
    },
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a plan.
    #[error("{path} is not a plan: {message}")]
    Format {
        /// The file.
        path: String,
        /// Field or position, what was found, what was expected.
        message: String,
    },
}

/// What every version of the plan format begins with.
#[derive(Deserialize)]
struct Header {
    schema: String,
    schema_version: u64,
}

impl Header {
    fn validate(&self) -> Result<(), String> {
        if self.schema != SCHEMA {
            return Err(format!("found schema {:?}, expected {SCHEMA:?}", self.schema));
        }
        if self.schema_version != PLAN_SCHEMA_VERSION {
            return Err(format!(
                "schema_version: found {}, expected {PLAN_SCHEMA_VERSION}; plan again with this version",
                self.schema_version
            ));
        }
        Ok(())
    }
}

impl Plan {
    /// Number of knots N.
    pub fn knots(&self) -> usize {
        self.states.len()
    }

    /// Predicted quadrotor positions (N × 3), m.
    pub fn predicted_quadrotor(&self) -> Vec<[f64; 3]> {
        self.states.iter().map(|x| [x[0], x[1], x[2]]).collect()
    }

    /// Predicted end-effector positions (N × 3), m: the model's, and what it was off by.
    pub fn predicted_end_effector(&self) -> Vec<[f64; 3]> {
        let off = |knot: usize| self.model_error_m.get(knot).unwrap_or(&[0.0; 3]);
        let predicted =
            |(knot, x): (usize, &Vec<f64>)| std::array::from_fn(|axis| x[6 + axis] + off(knot)[axis]);
        self.states.iter().enumerate().map(predicted).collect()
    }

    /// Refuses a plan that cannot be flown, naming the field.
    fn validate(&self) -> Result<(), String> {
        self.task.validate().map_err(|error| error.to_string())?;
        let knots = self.task.knots();
        let lengths = [
            ("configurations", self.configurations.len(), knots),
            ("commands", self.commands.len(), knots - 1),
            ("states", self.states.len(), knots),
            ("gains", self.gains.len(), knots - 1),
            ("reference", self.reference.len(), knots),
        ];
        for (field, found, expected) in lengths {
            if found != expected {
                return Err(format!("{field}: found {found} entries, expected {expected}"));
            }
        }
        let learnt = self.model_error_m.len();
        if learnt != 0 && learnt != knots {
            return Err(format!(
                "model_error_m: found {learnt} entries, expected {knots} or none"
            ));
        }
        let state_len = self.states[0].len();
        if state_len < SIGNALS.len() || self.states.iter().any(|state| state.len() != state_len) {
            return Err(format!(
                "states: expected rows of one length, at least {}",
                SIGNALS.len()
            ));
        }
        if self.gains.iter().any(|gain| gain.len() != 3 * state_len) {
            return Err(format!("gains: expected rows of {} entries", 3 * state_len));
        }
        let rows = [("commands", &self.commands), ("reference", &self.reference)];
        for (field, values) in rows {
            if let Some(knot) = values
                .iter()
                .position(|row| row.iter().any(|value| !value.is_finite()))
            {
                return Err(format!(
                    "{field}[{knot}]: found {:?}, expected finite numbers",
                    values[knot]
                ));
            }
        }
        for (field, values) in [("states", &self.states), ("gains", &self.gains)] {
            if let Some(knot) = values
                .iter()
                .position(|row| row.iter().any(|value| !value.is_finite()))
            {
                return Err(format!("{field}[{knot}]: expected finite numbers"));
            }
        }
        Ok(())
    }
}

/// Reads and checks a plan.
///
/// # Errors
/// The file cannot be read, is not JSON, has unknown or missing fields, another schema version, arrays of the
/// wrong length, or numbers that are not finite.
pub fn read_plan(path: &Path) -> Result<Plan, PlanError> {
    let named = || path.display().to_string();
    let contents = std::fs::read(path).map_err(|source| PlanError::File {
        path: named(),
        source,
    })?;
    let format_error = |message| PlanError::Format {
        path: named(),
        message,
    };
    // The version decides how the rest is read, so it is looked at first.
    let header: Header =
        serde_json::from_slice(&contents).map_err(|error| format_error(error.to_string()))?;
    header.validate().map_err(format_error)?;
    let plan: Plan = serde_json::from_slice(&contents).map_err(|error| format_error(error.to_string()))?;
    plan.validate().map_err(format_error)?;
    Ok(plan)
}

/// Writes a plan as JSON, whole or not at all.
///
/// # Errors
/// The file cannot be written.
pub fn write_plan(path: &Path, plan: &Plan) -> Result<(), PlanError> {
    let file_error = |source| PlanError::File {
        path: path.display().to_string(),
        source,
    };
    let contents = serde_json::to_vec(plan).map_err(|error| file_error(error.into()))?;
    write_whole(path, &contents).map_err(file_error)
}

/// Writes a plan's commands as CSV: `t_s,cmd_x,cmd_y,cmd_z,length_m,pressure_kpa`, N rows, the last repeating
/// the final command; and `cmd_vx,cmd_vy,cmd_vz` (m/s) behind, where the task's flights are sent velocities.
///
/// # Errors
/// The file cannot be written.
pub fn write_plan_csv(path: &Path, plan: &Plan) -> Result<(), PlanError> {
    let mut text = String::from("t_s,cmd_x,cmd_y,cmd_z,length_m,pressure_kpa");
    let feedforward = plan.task.feedforward;
    if !feedforward.is_none() {
        text += &format!(",{}", VELOCITY_COLUMNS.join(","));
    }
    text.push('\n');
    let mut before = plan.predicted_quadrotor()[0];
    for (knot, configuration) in plan.configurations.iter().enumerate() {
        let setpoint = feedforward.setpoint(plan.commands[knot.min(plan.commands.len() - 1)], before);
        before = setpoint.position;
        let [x, y, z] = setpoint.position;
        let Configuration {
            length_m,
            pressure_kpa,
        } = configuration;
        text += &format!("{:.2},{x},{y},{z},{length_m},{pressure_kpa}", knot as f64 * DT);
        if let Some([vx, vy, vz]) = setpoint.velocity {
            text += &format!(",{vx},{vy},{vz}");
        }
        text.push('\n');
    }
    write_whole(path, text.as_bytes()).map_err(|source| PlanError::File {
        path: path.display().to_string(),
        source,
    })
}
