//! What a controller reports of its steps, beside the flight that they made.
//!
//! In a CSV file these are further columns, `step_ms` to `step_delay_deviation_knots`; in an MCAP file the topic
//! `/controller`. Rows without a report (other controllers, the last row) are empty.

use serde::{Deserialize, Serialize};

/// How a controller's optimization ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepStatus {
    /// The optimum, to rounding.
    Optimal,
    /// The budget ran out: the best answer until then, within the hard limits.
    BudgetSpent,
    /// No command keeps all hard limits; the answer keeps the command's own.
    Infeasible,
}

impl StepStatus {
    /// As in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Optimal => "optimal",
            Self::BudgetSpent => "budget_spent",
            Self::Infeasible => "infeasible",
        }
    }

    /// The one that files call so.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        [Self::Optimal, Self::BudgetSpent, Self::Infeasible]
            .into_iter()
            .find(|status| status.name() == name)
    }
}

/// What a controller that optimizes says of one step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StepReport {
    /// How its optimization ended.
    pub status: StepStatus,
    /// Changes of the active set: with this budget the step can be repeated to the last bit.
    pub changes: usize,
    /// Active constraints.
    pub active: usize,
    /// Optimality residual.
    pub residual: f64,
    /// Estimated lateness of commands beyond the model's, knots.
    pub delay_knots: f64,
    /// Its standard deviation, knots.
    pub delay_deviation_knots: f64,
}

/// One step of a controller, as it is recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlStep {
    /// Row of the flight.
    pub row: usize,
    /// Wall-clock time that the step took, ms.
    pub step_ms: f64,
    /// What the controller says of it.
    pub report: StepReport,
}

/// Columns of the CSV format, in order.
pub(super) const STEP_COLUMNS: [&str; 7] = [
    "step_ms",
    "step_status",
    "step_changes",
    "step_active",
    "step_residual",
    "step_delay_knots",
    "step_delay_deviation_knots",
];

/// A row of the CSV format, or a message of the MCAP topic; other keys are ignored.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct StepRow {
    step_ms: f64,
    step_status: StepStatus,
    step_changes: usize,
    step_active: usize,
    step_residual: f64,
    step_delay_knots: f64,
    step_delay_deviation_knots: f64,
}

impl StepRow {
    pub fn new(step: &ControlStep) -> Self {
        let StepReport {
            status,
            changes,
            active,
            residual,
            delay_knots,
            delay_deviation_knots,
        } = step.report;
        Self {
            step_ms: step.step_ms,
            step_status: status,
            step_changes: changes,
            step_active: active,
            step_residual: residual,
            step_delay_knots: delay_knots,
            step_delay_deviation_knots: delay_deviation_knots,
        }
    }

    pub fn step(&self, row: usize) -> ControlStep {
        ControlStep {
            row,
            step_ms: self.step_ms,
            report: StepReport {
                status: self.step_status,
                changes: self.step_changes,
                active: self.step_active,
                residual: self.step_residual,
                delay_knots: self.step_delay_knots,
                delay_deviation_knots: self.step_delay_deviation_knots,
            },
        }
    }

    /// Cells of the CSV format.
    pub fn cells(&self) -> [String; 7] {
        [
            self.step_ms.to_string(),
            self.step_status.name().to_owned(),
            self.step_changes.to_string(),
            self.step_active.to_string(),
            self.step_residual.to_string(),
            self.step_delay_knots.to_string(),
            self.step_delay_deviation_knots.to_string(),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::{
        Configuration, Flight, Sample, read_control_steps, read_flight, write_controlled_flight,
    };

    #[test]
    fn both_formats_give_steps_and_flight_back_to_the_last_bit() {
        let sample = |row: usize| Sample {
            t_s: row as f64 * crate::DT,
            configuration: Configuration {
                length_m: 0.7,
                pressure_kpa: 0.1,
            },
            command: [0.1 / 3.0, 0.2, 1.5],
            command_velocity: None,
            quadrotor: None,
            end_effector: (row != 2).then_some([0.1, 0.2 / 3.0, 0.8]),
        };
        let step = |row: usize, status: StepStatus| ControlStep {
            row,
            step_ms: 0.1 / 3.0,
            report: StepReport {
                status,
                changes: 3,
                active: 7,
                residual: 1e-15 / 3.0,
                delay_knots: 0.4,
                delay_deviation_knots: 0.01,
            },
        };
        let flight = Flight {
            name: "controlled".into(),
            samples: (0..4).map(sample).collect(),
        };
        // The last row has no step, as after the last command.
        let steps = [
            step(0, StepStatus::Optimal),
            step(1, StepStatus::BudgetSpent),
            step(2, StepStatus::Infeasible),
        ];
        let folder = tempfile::tempdir().unwrap();
        for name in ["controlled.csv", "controlled.mcap"] {
            let path = folder.path().join(name);
            write_controlled_flight(&path, &flight, &steps).unwrap();
            assert_eq!(read_control_steps(&path).unwrap(), steps, "{name}");
            assert_eq!(read_flight(&path).unwrap(), flight, "{name}");
            write_controlled_flight(&path, &flight, &[]).unwrap();
            assert_eq!(read_control_steps(&path).unwrap(), [], "{name}");
        }
    }
}
