//! Length and pressure as the plan's own choice.

use serde::{Deserialize, Serialize};

use super::constraints::QUADROTOR;
use super::{Motion, Task, TaskError};
use crate::DT;
use crate::flight::{Configuration, SIGNALS};
use crate::model::{Bank, Extrapolation, Model};
use crate::trajopt::{Parametric, Problem, Steered, WithParameters};

/// The plan also chooses the arm's length and pressure, from the task's configuration on. What the quadrotor's height is
/// then costs nothing: bound it (`[[state_bounds]]`, `qr_z`) to say where it shall stay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Growth {
    /// Range of the length, m; the bank's where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub length_m: Option<[f64; 2]>,
    /// Range of the pressure, kPa; the bank's where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pressure_kpa: Option<[f64; 2]>,
    /// Fastest growth and retraction, m/s (paper, Sec. II: about 2 cm/s).
    #[serde(default = "Growth::default_rate_m_s")]
    pub max_rate_m_s: f64,
    /// Fastest inflation and deflation, kPa/s.
    #[serde(default = "Growth::default_pressure_rate_kpa_s")]
    pub max_pressure_rate_kpa_s: f64,
    /// What the square of the rates costs at each knot, per (m/s)² and per (kPa/s)².
    #[serde(default = "Growth::default_weight")]
    pub weight: f64,
    /// Configuration at the last knot; the plan's choice where left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub final_configuration: Option<Configuration>,
}

impl Growth {
    fn default_rate_m_s() -> f64 {
        0.02
    }

    fn default_pressure_rate_kpa_s() -> f64 {
        0.05
    }

    fn default_weight() -> f64 {
        1.0
    }

    /// Refuses what cannot be posed, naming the field.
    pub(super) fn validate(&self, task: &Task) -> Result<(), TaskError> {
        let wrong = |field: &str, found: String, expected: &str| {
            Err(TaskError::value(
                &task.name,
                &format!("growth{field}"),
                found,
                expected,
            ))
        };
        if let Motion::Deploy(_) = task.motion() {
            let expected = "either [deploy], whose configurations are given, or [growth], which chooses them";
            return wrong("", "[deploy] and [growth]".into(), expected);
        }
        for (field, value) in [
            (".max_rate_m_s", self.max_rate_m_s),
            (".max_pressure_rate_kpa_s", self.max_pressure_rate_kpa_s),
            (".weight", self.weight),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, value.to_string(), "a positive number");
            }
        }
        let Configuration {
            length_m,
            pressure_kpa,
        } = task.configuration;
        let last = self.final_configuration.unwrap_or(task.configuration);
        for (field, range, start, end, least) in [
            (
                ".length_m",
                self.length_m,
                length_m,
                last.length_m,
                f64::MIN_POSITIVE,
            ),
            (
                ".pressure_kpa",
                self.pressure_kpa,
                pressure_kpa,
                last.pressure_kpa,
                0.0,
            ),
        ] {
            let Some(range) = range else { continue };
            let holds = |value: f64| (range[0]..=range[1]).contains(&value);
            if !(range.iter().all(|end| end.is_finite()) && range[0] >= least && holds(start) && holds(end)) {
                let expected = "an ascending range that holds the configurations at start and end";
                return wrong(field, format!("{range:?}"), expected);
            }
        }
        Ok(())
    }

    /// `bank` with its configuration to be steered, and `problem` posed on it.
    pub(super) fn pose(&self, task: &Task, bank: &Bank, problem: &Problem) -> (Growing, Problem) {
        let Configuration {
            length_m,
            pressure_kpa,
        } = task.configuration;
        let dynamics = WithParameters::new(Configured::new(bank), &[length_m, pressure_kpa]);
        let steered = |start, range, greatest: f64, end: Option<f64>| Steered {
            start,
            range,
            change: [-greatest * DT, greatest * DT],
            weight: self.weight / (DT * DT),
            end,
        };
        let last = self.final_configuration;
        let [lengths_m, pressures_kpa] = self.ranges(bank);
        let steered = [
            steered(
                length_m,
                lengths_m,
                self.max_rate_m_s,
                last.map(|last| last.length_m),
            ),
            steered(
                pressure_kpa,
                pressures_kpa,
                self.max_pressure_rate_kpa_s,
                last.map(|last| last.pressure_kpa),
            ),
        ];
        let mut free = problem.clone();
        let lags = bank.models()[0].model.lags();
        for lag in 0..lags {
            free.state_weight[lag * SIGNALS.len() + QUADROTOR + 2] = 0.0;
        }
        let posed = dynamics.pose(&free, &steered);
        (dynamics, posed)
    }

    /// The configurations at each knot, out of the states of `dynamics`; a solution may be outside their range by the
    /// solver's tolerance.
    pub(super) fn configurations(
        &self,
        bank: &Bank,
        dynamics: &Growing,
        states: &[f64],
    ) -> Vec<Configuration> {
        let [lengths_m, pressures_kpa] = self.ranges(bank);
        let at = |parameters: Vec<f64>| Configuration {
            length_m: parameters[0].clamp(lengths_m[0], lengths_m[1]),
            pressure_kpa: parameters[1].clamp(pressures_kpa[0], pressures_kpa[1]),
        };
        dynamics.parameters(states).into_iter().map(at).collect()
    }

    /// Of length and pressure.
    fn ranges(&self, bank: &Bank) -> [[f64; 2]; 2] {
        [
            self.length_m.unwrap_or(bank.length_range_m()),
            self.pressure_kpa.unwrap_or(bank.pressure_range_kpa()),
        ]
    }
}

/// Names of what joins the state.
pub(super) const PARAMETERS: [&str; 2] = ["length", "pressure"];

/// A bank whose configuration is part of the state.
pub(super) type Growing = WithParameters<Configured>;

/// A bank's models as functions of length and pressure.
#[derive(Debug, Clone)]
pub(super) struct Configured {
    bank: Bank,
}

impl Configured {
    fn new(bank: &Bank) -> Self {
        // A solver's iterates may stray from the range that its solution keeps.
        Self {
            bank: bank.clone().with_extrapolation(Extrapolation::Allow),
        }
    }
}

impl Parametric for Configured {
    type Model = Model;

    fn at(&self, parameters: &[f64], changes: &[f64]) -> Model {
        let configuration = Configuration {
            length_m: parameters[0],
            pressure_kpa: parameters[1],
        };
        // Only numbers that are not finite are refused, and these the solver rejects with the state that holds them.
        let model = self.bank.at(configuration);
        model
            .unwrap_or_else(|_| self.bank.models()[0].model.clone())
            .growing(changes[0] / DT)
    }

    fn gives_curvature(&self) -> bool {
        matches!(self.bank.models()[0].model, Model::Lag(_))
    }
}
