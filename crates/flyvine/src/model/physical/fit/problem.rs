//! The fit's minimization problem: the misfits of one or several configurations that share a vehicle, and the
//! priors of the parameters.

use super::super::parameters::{PARAMETER_COUNT, PARAMETERS, Parameters, Part};
use super::residual::{Misfit, Value};
use nalgebra::{DMatrix, DVector};

/// Over the parameters of every configuration, with one vehicle for all of them, minimizes
///
/// ```text
/// Σ_configurations misfit  +  Σ_parameters ((coordinate − default) / prior σ)²
/// ```
pub struct Problem<'a> {
    /// One per configuration.
    pub misfits: Vec<Misfit<'a>>,
    /// Names of parameters that stay as they are.
    pub held: Vec<&'a str>,
}

/// Half the gradient and the Gauss–Newton half of the Hessian of a [`Problem`].
pub struct Quadratic {
    /// Half the gradient.
    pub gradient: DVector<f64>,
    /// Half the Hessian.
    pub hessian: DMatrix<f64>,
}

impl Problem<'_> {
    /// The objective at `parameters`, one set per configuration that agree on the vehicle, and what the
    /// simulations were like.
    pub fn value(&self, parameters: &[Parameters<f64>]) -> (f64, Value) {
        let values = self
            .misfits
            .iter()
            .zip(parameters)
            .map(|(misfit, own)| misfit.value(own));
        let total = values.fold(Value::default(), Value::and);
        let prior: f64 = self
            .entries()
            .map(|(configuration, i)| {
                let (deviation, precision) = prior(&parameters[configuration], i);
                precision * deviation * deviation
            })
            .sum();
        (total.loss + prior, total)
    }

    /// The quadratic model at `parameters`, in the order of [`Self::entries`].
    pub fn quadratic(&self, parameters: &[Parameters<f64>]) -> Quadratic {
        let size = self.entries().count();
        let (mut gradient, mut hessian) = (DVector::zeros(size), DMatrix::zeros(size, size));
        for (number, (misfit, own)) in self.misfits.iter().zip(parameters).enumerate() {
            let part = misfit.normal_equations(own);
            let places = self.places(number);
            for (i, &row) in places.iter().enumerate() {
                gradient[row] += part.gradient[i];
                for (j, &column) in places.iter().enumerate() {
                    hessian[(row, column)] += part.hessian[(i, j)];
                }
            }
        }
        for (entry, (configuration, i)) in self.entries().enumerate() {
            let (deviation, precision) = prior(&parameters[configuration], i);
            gradient[entry] += precision * deviation;
            hessian[(entry, entry)] += precision;
        }
        Quadratic { gradient, hessian }
    }

    /// The unknowns as (configuration, parameter): the vehicle's once, then the arm's of every configuration.
    pub fn entries(&self) -> impl Iterator<Item = (usize, usize)> {
        let of = |part: Part| (0..PARAMETER_COUNT).filter(move |&i| PARAMETERS[i].part == part);
        let arms = (0..self.misfits.len()).flat_map(move |number| of(Part::Arm).map(move |i| (number, i)));
        of(Part::Vehicle).map(|i| (0, i)).chain(arms)
    }

    /// Where the parameters of one configuration are among the unknowns.
    pub fn places(&self, configuration: usize) -> [usize; PARAMETER_COUNT] {
        let mut places = [0; PARAMETER_COUNT];
        for (entry, (owner, i)) in self.entries().enumerate() {
            if owner == configuration || PARAMETERS[i].part == Part::Vehicle {
                places[i] = entry;
            }
        }
        places
    }
}

/// Deviation of a parameter's coordinate from its default, and the prior's precision.
fn prior(parameters: &Parameters<f64>, i: usize) -> (f64, f64) {
    let info = &PARAMETERS[i];
    let deviation = info.coordinate(parameters.to_array()[i]) - info.coordinate(info.default);
    (deviation, info.prior_sigma.powi(-2))
}
