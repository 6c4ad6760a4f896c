//! What a fit says about every parameter: value, standard error, bounds, and whether the flights determined it.

use super::model::PhysicalModel;
use super::parameters::{PARAMETERS, ParameterInfo};
use serde::Serialize;

/// A parameter closer to a bound than this share of its range, in its scale, is at that bound.
const AT_BOUND: f64 = 0.01;
/// A posterior wider than this share of the prior says little that the prior did not.
const NOT_IDENTIFIED: f64 = 0.7;

/// One parameter of a fitted model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// Name, as in files.
    pub name: &'static str,
    /// What it is.
    pub meaning: &'static str,
    /// Unit; "kg" in it counts quadrotor masses.
    pub unit: &'static str,
    /// The estimate.
    pub value: f64,
    /// Its standard error, in the same unit (posterior standard deviation, to first order).
    pub standard_error: f64,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// It was stopped by a bound: the model wants to be something that it cannot be, or that is not believed.
    pub at_bound: bool,
    /// The flights determined it: its posterior is much narrower than its prior. What is not identified keeps
    /// about its default, and does not matter to flights like those.
    pub identified: bool,
}

impl PhysicalModel {
    /// Every parameter in the table's order; empty for a model that was not fitted.
    pub fn estimates(&self) -> Vec<ParameterEstimate> {
        let values = self.parameters.to_array();
        let estimate = |((info, value), deviation): ((&ParameterInfo, f64), f64)| {
            let [low, here, high] = [info.lower, value, info.upper].map(|value| info.coordinate(value));
            let nearest = (here - low).min(high - here);
            ParameterEstimate {
                name: info.name,
                meaning: info.meaning,
                unit: info.unit,
                value,
                standard_error: deviation * info.value_slope(value),
                lower: info.lower,
                upper: info.upper,
                at_bound: nearest <= AT_BOUND * (high - low),
                identified: deviation < NOT_IDENTIFIED * info.prior_sigma,
            }
        };
        PARAMETERS
            .iter()
            .zip(values)
            .zip(self.standard_deviations())
            .map(estimate)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::arm::ArmLength;
    use super::super::parameters::{PARAMETER_COUNT, Parameters};
    use super::*;

    #[test]
    fn bounds_and_priors_are_noticed() {
        let mut model = PhysicalModel::new(Parameters::defaults(), ArmLength::constant(0.7)).unwrap();
        assert!(model.estimates().is_empty());
        model.parameters.tip_mass = 1.0;
        model.covariance = (0..PARAMETER_COUNT)
            .map(|i| {
                (0..PARAMETER_COUNT)
                    .map(|j| if i == j { 0.01 } else { 0.0 })
                    .collect()
            })
            .collect();
        let estimates = model.estimates();
        let named = |name: &str| *estimates.iter().find(|estimate| estimate.name == name).unwrap();
        assert!(named("tip_mass").at_bound && !named("joint_mass").at_bound);
        // A relative standard error of 0.1 on a logarithm; an absolute one, wider than the prior, otherwise.
        assert!((named("tip_mass").standard_error - 0.1).abs() < 1e-12 && named("tip_mass").identified);
        assert!((named("command_delay").standard_error - 0.1).abs() < 1e-12);
        assert!(!named("command_delay").identified);
    }
}
