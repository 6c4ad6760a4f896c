//! A fitted physical model: parameters, how sure they are, and where they came from.

use super::arm::ArmLength;
use super::correction::Correction;
use super::error::PhysicalError;
use super::fit::PhysicalFitOptions;
use super::parameters::{PARAMETER_COUNT, Parameters};
use super::state::{STATE_LEN, State};
use crate::flight::Configuration;
use serde::{Deserialize, Serialize};

/// A physical model at one configuration, as [`crate::trajopt::Dynamics`] for an arm of one length and growth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhysicalModel {
    /// The parameters.
    pub parameters: Parameters<f64>,
    /// The arm's length, and its growth while the model steps.
    pub arm: ArmLength,
    /// What physics leaves over, if it was worth correcting.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correction: Option<Correction>,
    /// Posterior covariance of the parameters' coordinates ([`Parameters::coordinates`]),
    /// [`PARAMETER_COUNT`] × [`PARAMETER_COUNT`]; empty for an interpolated model.
    pub covariance: Vec<Vec<f64>>,
    /// Where it came from; `None` for an interpolated model.
    pub fit: Option<FitSummary>,
}

/// Provenance of a fitted model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitSummary {
    /// Program and version that fitted it.
    pub tool: String,
    /// Names of the flights.
    pub flights: Vec<String>,
    /// Their configuration.
    pub configuration: Configuration,
    /// Rows simulated.
    pub rows: usize,
    /// Mean distance of the simulated end effector from where it was seen, m, over whole flights.
    pub tip_error_m: f64,
    /// The objective at the parameters, of all configurations that were fitted together.
    pub objective: f64,
    /// Iterations on whole flights.
    pub iterations: usize,
    /// Whether the objective had stopped decreasing.
    pub converged: bool,
    /// Options of the fit.
    pub options: PhysicalFitOptions,
}

/// Least room for the arm below its base, m.
const SHORTEST_ARM_M: f64 = 0.05;

impl PhysicalModel {
    /// A model that was not fitted.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn new(parameters: Parameters<f64>, arm: ArmLength) -> Result<Self, PhysicalError> {
        let model = PhysicalModel {
            parameters,
            arm,
            correction: None,
            covariance: Vec::new(),
            fit: None,
        };
        model.validate()?;
        Ok(model)
    }

    /// The model between `parts` for an arm of `length_m`: [`Parameters::mean`] of theirs, with weights that sum
    /// to one. A single part is itself, to the last bit.
    pub fn between(parts: &[(f64, &Self)], length_m: f64) -> Self {
        if let [(1.0, only)] = parts {
            return (*only).clone();
        }
        let parameters: Vec<_> = parts
            .iter()
            .map(|(weight, part)| (*weight, &part.parameters))
            .collect();
        let corrections: Vec<_> = parts
            .iter()
            .map(|(weight, part)| (*weight, part.correction.as_ref()))
            .collect();
        PhysicalModel {
            parameters: Parameters::mean(&parameters),
            arm: ArmLength::constant(length_m),
            correction: Correction::mean(&corrections),
            covariance: Vec::new(),
            fit: None,
        }
    }

    /// Standard deviation of every parameter's coordinate: for logarithmic ones a relative error.
    pub fn standard_deviations(&self) -> Vec<f64> {
        self.covariance
            .iter()
            .enumerate()
            .map(|(i, row)| row[i].sqrt())
            .collect()
    }

    /// Refuses what a damaged file may hold.
    ///
    /// # Errors
    /// A parameter outside its bounds, an arm without length, or a covariance of the wrong size.
    pub fn validate(&self) -> Result<(), PhysicalError> {
        if let Some((info, found)) = self.parameters.out_of_bounds() {
            return Err(PhysicalError::OutOfBounds {
                name: info.name,
                found,
                lower: info.lower,
                upper: info.upper,
                unit: info.unit,
            });
        }
        let ArmLength { length_m, rate_m_s } = self.arm;
        let shortest_m = self.parameters.base_offset + SHORTEST_ARM_M;
        if !(length_m >= shortest_m && length_m.is_finite() && rate_m_s.is_finite()) {
            return Err(PhysicalError::ArmTooShort {
                length_m,
                rate_m_s,
                shortest_m,
            });
        }
        if let Some(correction) = &self.correction {
            correction.validate()?;
        }
        let sizes = std::iter::once(self.covariance.len()).chain(self.covariance.iter().map(Vec::len));
        for found in sizes {
            if !self.covariance.is_empty() && found != PARAMETER_COUNT {
                return Err(PhysicalError::Shape {
                    what: "rows or columns of the parameters' covariance",
                    found,
                    expected: PARAMETER_COUNT,
                });
            }
        }
        Ok(())
    }

    /// The flat state at rest at `position`.
    pub fn rest_state(&self, position: [f64; 3]) -> Vec<f64> {
        let mut flat = vec![0.0; STATE_LEN];
        State::rest(&self.parameters, self.arm.length_m, position).write_flat(&mut flat);
        flat
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_damaged_file_may_hold_is_refused_by_name() {
        let good = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.7)).unwrap();
        let mut bad = good.clone();
        bad.parameters.rate_gain = -1.0;
        assert!(bad.validate().unwrap_err().to_string().contains("rate_gain"));
        for length_m in [0.01, f64::NAN, f64::INFINITY] {
            bad = good.clone();
            bad.arm.length_m = length_m;
            assert!(matches!(bad.validate(), Err(PhysicalError::ArmTooShort { .. })));
        }
        bad = good.clone();
        bad.covariance = vec![vec![1.0; 3]; PARAMETER_COUNT];
        assert!(matches!(
            bad.validate(),
            Err(PhysicalError::Shape { found: 3, .. })
        ));
    }
}
