//! What a controller reports of its steps, beside the flight that they made.
//!
//! In a CSV file these are further columns, `step_ms` to `step_tip_load_deviation`; in an MCAP file the topic
//! `/controller`. Rows without a report (other controllers, the last row) are empty. Files from before wind and load were
//! recorded read as if neither had been estimated.

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
    /// How badly poses were foreseen lately: mean squared innovation by its expected variance, 1 if as well as the noise levels
    /// say. Rises fast, falls slowly.
    pub inconsistency: f64,
    /// Air and load.
    pub surroundings: SurroundingsReport,
}

/// What an estimator finds of the air and of the load at the tip, with standard deviations; all 0 where neither is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SurroundingsReport {
    /// Steady wind along x and y, m/s.
    pub wind_m_s: [f64; 2],
    /// Its standard deviation.
    pub wind_deviation_m_s: [f64; 2],
    /// What the gust of the moment adds to it, m/s.
    pub gust_m_s: [f64; 2],
    /// Its standard deviation.
    pub gust_deviation_m_s: [f64; 2],
    /// Share by which the tip is heavier than when the model was fitted.
    pub tip_load: f64,
    /// Its standard deviation.
    pub tip_load_deviation: f64,
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
pub(super) const STEP_COLUMNS: [&str; 18] = [
    "step_ms",
    "step_status",
    "step_changes",
    "step_active",
    "step_residual",
    "step_delay_knots",
    "step_delay_deviation_knots",
    "step_inconsistency",
    "step_wind_x",
    "step_wind_y",
    "step_wind_x_deviation",
    "step_wind_y_deviation",
    "step_gust_x",
    "step_gust_y",
    "step_gust_x_deviation",
    "step_gust_y_deviation",
    "step_tip_load",
    "step_tip_load_deviation",
];

/// A row of the CSV format, and the message `flyvine.ControlStep`; in JSON other keys are ignored.
#[derive(Clone, PartialEq, prost::Message, Serialize, Deserialize)]
pub(super) struct StepRow {
    #[prost(double, required, tag = "1")]
    step_ms: f64,
    #[prost(string, tag = "2")]
    step_status: String,
    #[prost(uint64, tag = "3")]
    step_changes: u64,
    #[prost(uint64, tag = "4")]
    step_active: u64,
    #[prost(double, required, tag = "5")]
    step_residual: f64,
    #[prost(double, required, tag = "6")]
    step_delay_knots: f64,
    #[prost(double, required, tag = "7")]
    step_delay_deviation_knots: f64,
    // Absent in older files.
    #[prost(double, required, tag = "8")]
    #[serde(default)]
    step_inconsistency: f64,
    #[prost(double, required, tag = "9")]
    #[serde(default)]
    step_wind_x: f64,
    #[prost(double, required, tag = "10")]
    #[serde(default)]
    step_wind_y: f64,
    #[prost(double, required, tag = "11")]
    #[serde(default)]
    step_wind_x_deviation: f64,
    #[prost(double, required, tag = "12")]
    #[serde(default)]
    step_wind_y_deviation: f64,
    #[prost(double, required, tag = "13")]
    #[serde(default)]
    step_gust_x: f64,
    #[prost(double, required, tag = "14")]
    #[serde(default)]
    step_gust_y: f64,
    #[prost(double, required, tag = "15")]
    #[serde(default)]
    step_gust_x_deviation: f64,
    #[prost(double, required, tag = "16")]
    #[serde(default)]
    step_gust_y_deviation: f64,
    #[prost(double, required, tag = "17")]
    #[serde(default)]
    step_tip_load: f64,
    #[prost(double, required, tag = "18")]
    #[serde(default)]
    step_tip_load_deviation: f64,
}

impl StepRow {
    pub fn new(step: &ControlStep) -> Self {
        let report = step.report;
        let around = report.surroundings;
        Self {
            step_ms: step.step_ms,
            step_status: report.status.name().to_owned(),
            step_changes: report.changes as u64,
            step_active: report.active as u64,
            step_residual: report.residual,
            step_delay_knots: report.delay_knots,
            step_delay_deviation_knots: report.delay_deviation_knots,
            step_inconsistency: report.inconsistency,
            step_wind_x: around.wind_m_s[0],
            step_wind_y: around.wind_m_s[1],
            step_wind_x_deviation: around.wind_deviation_m_s[0],
            step_wind_y_deviation: around.wind_deviation_m_s[1],
            step_gust_x: around.gust_m_s[0],
            step_gust_y: around.gust_m_s[1],
            step_gust_x_deviation: around.gust_deviation_m_s[0],
            step_gust_y_deviation: around.gust_deviation_m_s[1],
            step_tip_load: around.tip_load,
            step_tip_load_deviation: around.tip_load_deviation,
        }
    }

    /// The step, of the row that this belongs to.
    ///
    /// # Errors
    /// The status does not exist.
    pub fn step(&self, row: usize) -> Result<ControlStep, String> {
        let status = StepStatus::from_name(&self.step_status);
        Ok(ControlStep {
            row,
            step_ms: self.step_ms,
            report: StepReport {
                status: status.ok_or_else(|| format!("unknown step_status `{}`", self.step_status))?,
                changes: self.step_changes as usize,
                active: self.step_active as usize,
                residual: self.step_residual,
                delay_knots: self.step_delay_knots,
                delay_deviation_knots: self.step_delay_deviation_knots,
                inconsistency: self.step_inconsistency,
                surroundings: SurroundingsReport {
                    wind_m_s: [self.step_wind_x, self.step_wind_y],
                    wind_deviation_m_s: [self.step_wind_x_deviation, self.step_wind_y_deviation],
                    gust_m_s: [self.step_gust_x, self.step_gust_y],
                    gust_deviation_m_s: [self.step_gust_x_deviation, self.step_gust_y_deviation],
                    tip_load: self.step_tip_load,
                    tip_load_deviation: self.step_tip_load_deviation,
                },
            },
        })
    }

    /// Cells of the CSV format, under [`STEP_COLUMNS`].
    pub fn cells(&self) -> [String; STEP_COLUMNS.len()] {
        [
            self.step_ms.to_string(),
            self.step_status.clone(),
            self.step_changes.to_string(),
            self.step_active.to_string(),
            self.step_residual.to_string(),
            self.step_delay_knots.to_string(),
            self.step_delay_deviation_knots.to_string(),
            self.step_inconsistency.to_string(),
            self.step_wind_x.to_string(),
            self.step_wind_y.to_string(),
            self.step_wind_x_deviation.to_string(),
            self.step_wind_y_deviation.to_string(),
            self.step_gust_x.to_string(),
            self.step_gust_y.to_string(),
            self.step_gust_x_deviation.to_string(),
            self.step_gust_y_deviation.to_string(),
            self.step_tip_load.to_string(),
            self.step_tip_load_deviation.to_string(),
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
                inconsistency: 4.0 / 3.0,
                surroundings: SurroundingsReport {
                    wind_m_s: [0.1 / 3.0, -2.0],
                    wind_deviation_m_s: [0.2, 0.3],
                    gust_m_s: [-0.7 / 3.0, 0.4],
                    gust_deviation_m_s: [0.5, 0.6],
                    tip_load: 1.0 / 3.0,
                    tip_load_deviation: 0.7,
                },
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

    #[test]
    fn files_from_before_wind_and_load_were_recorded_are_still_read() {
        let flight = Flight {
            name: "old".into(),
            samples: vec![Sample {
                t_s: 0.0,
                configuration: Configuration {
                    length_m: 0.7,
                    pressure_kpa: 0.0,
                },
                command: [0.0, 0.0, 1.5],
                command_velocity: None,
                quadrotor: None,
                end_effector: None,
            }],
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("old.csv");
        write_controlled_flight(&path, &flight, &[]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let (header, row) = text.trim_end().split_once('\n').unwrap();
        let columns = STEP_COLUMNS[..7].join(",");
        std::fs::write(
            &path,
            format!("{header},{columns}\n{row},0.3,optimal,2,1,1e-9,0.4,0.1\n"),
        )
        .unwrap();
        let steps = read_control_steps(&path).unwrap();
        assert_eq!(steps[0].report.delay_knots, 0.4);
        assert_eq!(steps[0].report.surroundings, SurroundingsReport::default());
        std::fs::write(
            &path,
            format!("{header},{columns}\n{row},0.3,superb,2,1,1e-9,0.4,0.1\n"),
        )
        .unwrap();
        let error = read_control_steps(&path).unwrap_err().to_string();
        assert!(error.contains("superb"), "{error}");
    }
}
