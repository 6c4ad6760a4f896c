//! What a report is made of: plain data, gathered from a run folder by the caller.

use serde::{Deserialize, Serialize};

use super::score::{DistanceStatistics, Score, SwingTarget};
use crate::flight::Corner;
use crate::flight::{Configuration, Flight, StepReport};

/// Everything that one report shows. Lists may be empty: what is absent is left out of the page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Results {
    /// What was run.
    pub summary: RunSummary,
    /// Planned, flown and scored tasks, in any order.
    pub experiments: Vec<Experiment>,
    /// Flights that the models were fitted on; the first one whose name contains "pretzel" (or else the
    /// first) is drawn.
    pub training: Vec<Flight>,
    /// Rollout errors of the models, one entry per checked flight.
    pub rollouts: Vec<FlightRollout>,
    /// Diagnostics of the models in the bank.
    pub models: Vec<ModelDiagnostics>,
    /// What motion-capture hygiene found in the recordings.
    pub findings: Vec<Finding>,
}

impl Results {
    /// The experiments in reading order: by task, slow before fast, corners as the paper lists them, then by name.
    pub fn experiments_in_order(&self) -> Vec<&Experiment> {
        let corner = |e: &Experiment| {
            Corner::ALL
                .iter()
                .position(|corner| corner.label() == e.label)
                .unwrap_or(Corner::ALL.len())
        };
        let period_s = |e: &Experiment| e.period_s.unwrap_or(0.0);
        let mut ordered: Vec<&Experiment> = self.experiments.iter().collect();
        ordered.sort_by(|a, b| {
            a.kind
                .cmp(&b.kind)
                .then(period_s(b).total_cmp(&period_s(a)))
                .then(corner(a).cmp(&corner(b)))
                .then(a.name.cmp(&b.name))
        });
        ordered
    }
}

/// What was run, by what.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RunSummary {
    /// Title of the page.
    pub title: String,
    /// Version of the tool.
    pub tool_version: String,
    /// What was flown, for example "built-in simulated vehicle".
    pub vehicle: String,
    /// How it was flown, for example "open loop".
    pub controller: String,
    /// Seed of the run, where it has one.
    pub seed: Option<u64>,
    /// Date as it shall be printed. Nothing here reads a clock: the same results make the same page.
    pub date: Option<String>,
    /// Wall-clock times, where the caller wants them printed (they differ from run to run).
    pub timings: Vec<Timing>,
    /// Further remarks, one paragraph each.
    pub notes: Vec<String>,
}

/// How long one stage took.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// The stage.
    pub stage: String,
    /// Wall-clock time, s.
    pub seconds: f64,
}

/// What an experiment asked of the end effector, in reading order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExperimentKind {
    /// Track a lemniscate.
    Lemniscate,
    /// Swing through a target.
    Swing,
    /// Track a lemniscate while the arm grows and inflates.
    Deploy,
    /// Pass the user's waypoints.
    Waypoints,
}

/// One planned, flown and scored task. All positions are ENU, m; row k of the flight belongs to knot k, and an
/// aborted flight has fewer rows than the plan has knots.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// Unique name, for example `lemniscate_10s_ES`.
    pub name: String,
    /// What was asked.
    pub kind: ExperimentKind,
    /// Configuration as drawn in legends: `ES`, `IS`, `EL`, `IL` get their fixed colours.
    pub label: String,
    /// Period of the lemniscate, s.
    pub period_s: Option<f64>,
    /// End-effector reference, one per knot; empty, as the predictions, for a flight without a plan, of which there is
    /// only a replay.
    pub reference: Vec<[f64; 3]>,
    /// Predicted quadrotor positions, one per knot.
    pub predicted_quadrotor: Vec<[f64; 3]>,
    /// Predicted end-effector positions, one per knot.
    pub predicted_end_effector: Vec<[f64; 3]>,
    /// The flight: commands, poses, configuration.
    pub flight: Flight,
    /// Arm centre line in the world frame for each row of the flight, base to tip, where the vehicle knows it.
    /// Empty otherwise; the replay then draws a smooth curve from the quadrotor's down axis to the tip.
    pub arm: Vec<Vec<[f64; 3]>>,
    /// Target and limits of a swing.
    pub swing: Option<SwingTask>,
    /// How the flight went; `None` where it was aborted before the plan's end.
    pub score: Option<Score>,
    /// A remark for the tables, for example why the flight was aborted.
    pub remark: Option<String>,
    /// How the plan was found.
    pub solver: SolverSummary,
    /// The last report of the controller, where it makes reports.
    pub last_step: Option<StepReport>,
}

/// What an error is measured against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Against {
    /// The task's reference.
    Reference,
    /// The plan's prediction.
    Prediction,
}

/// Why results cannot be drawn.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReportError {
    /// A list has not one entry per knot of the plan.
    #[error("experiment {experiment}: found {found} {what}, expected {knots}, one for each knot of the plan")]
    KnotCount {
        /// Name of the experiment.
        experiment: String,
        /// Which list.
        what: &'static str,
        /// Entries found.
        found: usize,
        /// Knots of the reference.
        knots: usize,
    },
    /// A flight with more rows than the plan has knots.
    #[error(
        "experiment {experiment}: its flight has {rows} rows, expected at most {knots}, the knots of its plan"
    )]
    RowCount {
        /// Name of the experiment.
        experiment: String,
        /// Rows of the flight.
        rows: usize,
        /// Knots of the reference.
        knots: usize,
    },
    /// Arm shapes are given, but not one per row of the flight.
    #[error(
        "experiment {experiment}: found {found} arm shapes, expected none or {rows}, one for each row of the flight"
    )]
    ArmCount {
        /// Name of the experiment.
        experiment: String,
        /// Shapes found.
        found: usize,
        /// Rows of the flight.
        rows: usize,
    },
    /// A flight without rows.
    #[error("experiment {experiment}: its flight has no rows, expected at least one")]
    EmptyFlight {
        /// Name of the experiment.
        experiment: String,
    },
    /// An arm whose number of nodes changes, or that has fewer than two.
    #[error(
        "experiment {experiment}, row {row}: found {found} arm nodes, expected {expected} as in row 0, at least 2"
    )]
    ArmNodes {
        /// Name of the experiment.
        experiment: String,
        /// Row, from 0.
        row: usize,
        /// Nodes found.
        found: usize,
        /// Nodes of row 0.
        expected: usize,
    },
    /// The replay's data could not be written.
    #[error("the replay's data: {reason}")]
    Json {
        /// What the writer said.
        reason: String,
    },
}

impl Experiment {
    /// The name for people, for example "Lemniscate, period 10 s, ES"; the user's own name for waypoints.
    pub fn title(&self) -> String {
        let task = match self.kind {
            ExperimentKind::Lemniscate => "Lemniscate",
            ExperimentKind::Swing => "Swing",
            ExperimentKind::Deploy => "Deployment",
            ExperimentKind::Waypoints => return self.name.clone(),
        };
        match self.period_s {
            Some(period_s) => format!("{task}, period {period_s} s, {}", self.label),
            None => format!("{task}, {}", self.label),
        }
    }

    /// Checks that the lists belong together: one entry per knot, no more rows than knots, one arm per row.
    pub(super) fn check_shapes(&self) -> Result<(), ReportError> {
        let (rows, knots) = (self.flight.samples.len(), self.reference.len());
        let experiment = || self.name.clone();
        if rows == 0 {
            return Err(ReportError::EmptyFlight {
                experiment: experiment(),
            });
        }
        for (what, found) in [
            ("predicted quadrotor positions", self.predicted_quadrotor.len()),
            (
                "predicted end-effector positions",
                self.predicted_end_effector.len(),
            ),
        ] {
            if found != knots {
                return Err(ReportError::KnotCount {
                    experiment: experiment(),
                    what,
                    found,
                    knots,
                });
            }
        }
        if knots > 0 && rows > knots {
            return Err(ReportError::RowCount {
                experiment: experiment(),
                rows,
                knots,
            });
        }
        if !self.arm.is_empty() && self.arm.len() != rows {
            return Err(ReportError::ArmCount {
                experiment: experiment(),
                found: self.arm.len(),
                rows,
            });
        }
        let expected = self.arm.first().map_or(2, Vec::len);
        for (row, found) in self.arm.iter().map(Vec::len).enumerate() {
            if found != expected || found < 2 {
                return Err(ReportError::ArmNodes {
                    experiment: experiment(),
                    row,
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }

    /// The error as the paper reports it (Sec. IV): to the reference where the end effector tracks one, to the
    /// model's prediction for swings and deployments. `None` without a score.
    pub fn comparable_error(&self) -> Option<(Against, DistanceStatistics)> {
        let score = self.score.as_ref()?;
        Some(match self.kind {
            ExperimentKind::Lemniscate | ExperimentKind::Waypoints => {
                (Against::Reference, score.ee_vs_reference)
            }
            ExperimentKind::Swing | ExperimentKind::Deploy => (Against::Prediction, score.ee_vs_prediction),
        })
    }
}

/// Target and limits of a swing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SwingTask {
    /// Where and when.
    pub target: SwingTarget,
    /// Largest quadrotor x, m.
    pub quadrotor_x_max: Option<f64>,
    /// Largest quadrotor z, m.
    pub quadrotor_z_max: Option<f64>,
}

/// How the solver left the plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SolverSummary {
    /// Status in words, for example "converged".
    pub status: String,
    /// Whether the plan may be trusted.
    pub converged: bool,
    /// Iterations over all passes.
    pub iterations: usize,
    /// Cost at the solution.
    pub cost: f64,
    /// Largest constraint violation, in the units of the state.
    pub max_violation: f64,
}

/// Rollout errors of a bank on one flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlightRollout {
    /// The flight.
    pub path: String,
    /// Configuration as drawn in legends.
    pub label: String,
    /// Configuration.
    pub configuration: Configuration,
    /// One entry per horizon, ascending.
    pub rollout: Vec<HorizonError>,
}

/// Mean 3-D end-effector distance over rollouts of one horizon.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HorizonError {
    /// Horizon, s.
    pub horizon_s: f64,
    /// Number of windows rolled out.
    pub windows: usize,
    /// Median over the windows, m; `None` without windows or where it is not finite.
    pub median_m: Option<f64>,
    /// 95th percentile, m; `None` without windows or where it is not finite.
    pub p95_m: Option<f64>,
    /// Share of windows that diverged, 0 to 1.
    pub diverged_share: f64,
}

/// Diagnostics of one fitted model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelDiagnostics {
    /// Configuration as drawn in legends.
    pub label: String,
    /// Configuration.
    pub configuration: Configuration,
    /// Spectral radius of the Jacobian at rest.
    pub spectral_radius: f64,
    /// Condition number of the least-squares problem after column scaling.
    pub condition_number: f64,
}

/// One remark of motion-capture hygiene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The flight.
    pub flight: String,
    /// What was found, where.
    pub what: String,
}
