//! The fit's minimization problem: the misfits of one or several configurations of one vehicle, and the priors of
//! the parameters.

use super::super::parameters::{PARAMETER_COUNT, PARAMETERS, Parameters, Part};
use super::residual::{Misfit, Value};
use nalgebra::{DMatrix, DVector};

/// How much the configurations of one vehicle differ, in standard deviations of the prior (κ): in the vehicle's own
/// parameters hardly, only as far as they stand in for what the model lacks; in the arm's, more.
const ALIKE: [(Part, f64); 2] = [(Part::Vehicle, 0.1), (Part::Arm, 0.3)];

/// Over the parameters of every configuration, minimizes
///
/// ```text
///    Σ_configurations misfit
/// +  Σ_parameters ((coordinate − default) / prior σ)²
/// +  Σ_parameters ((coordinate − mean over the configurations) / (κ · prior σ))²
/// ( + Σ_parameters ((coordinate − known) / (radius · prior σ))² )
/// ```
///
/// The third sum says that it is one vehicle, with arms that are alike. Without it, what a corner's flights leave
/// open (the place of the base against the stiffness of its joint, say) would be settled differently from corner to
/// corner, and the models between them would be like neither.
pub struct Problem<'a> {
    /// One per configuration.
    pub misfits: Vec<Misfit<'a>>,
    /// Names of parameters that stay as they are.
    pub held: Vec<&'a str>,
    /// Known parameters of every configuration to keep near, and the radius.
    pub trust: Option<(Vec<Parameters<f64>>, f64)>,
}

/// Half the gradient and the Gauss–Newton half of the Hessian of a [`Problem`], with [`PARAMETER_COUNT`] unknowns
/// per configuration.
pub struct Quadratic {
    /// Half the gradient.
    pub gradient: DVector<f64>,
    /// Half the Hessian.
    pub hessian: DMatrix<f64>,
}

impl Problem<'_> {
    /// The objective at `parameters`, one set per configuration, and what the simulations were like.
    pub fn value(&self, parameters: &[Parameters<f64>]) -> (f64, Value) {
        let values = self
            .misfits
            .iter()
            .zip(parameters)
            .map(|(misfit, own)| misfit.value(own));
        let total = values.fold(Value::default(), Value::and);
        let mut penalty = 0.0;
        for number in 0..parameters.len() {
            for i in 0..PARAMETER_COUNT {
                for (deviation, precision, _) in self.penalties(parameters, number, i) {
                    penalty += precision * deviation * deviation;
                }
            }
        }
        (total.loss + penalty, total)
    }

    /// The quadratic model at `parameters`.
    pub fn quadratic(&self, parameters: &[Parameters<f64>]) -> Quadratic {
        let count = parameters.len();
        let size = count * PARAMETER_COUNT;
        let (mut gradient, mut hessian) = (DVector::zeros(size), DMatrix::zeros(size, size));
        for (number, (misfit, own)) in self.misfits.iter().zip(parameters).enumerate() {
            let part = misfit.normal_equations(own);
            let at = number * PARAMETER_COUNT;
            gradient.rows_mut(at, PARAMETER_COUNT).copy_from(&part.gradient);
            hessian
                .view_mut((at, at), (PARAMETER_COUNT, PARAMETER_COUNT))
                .copy_from(&part.hessian);
            for i in 0..PARAMETER_COUNT {
                let entry = at + i;
                for (deviation, precision, about_mean) in self.penalties(parameters, number, i) {
                    gradient[entry] += precision * deviation;
                    hessian[(entry, entry)] += precision;
                    if about_mean {
                        for other in 0..count {
                            hessian[(entry, other * PARAMETER_COUNT + i)] -= precision / count as f64;
                        }
                    }
                }
            }
        }
        Quadratic { gradient, hessian }
    }

    /// What a coordinate should be near to: its deviation from there, the precision, and whether that is the mean
    /// over the configurations (which moves with it).
    fn penalties(
        &self,
        parameters: &[Parameters<f64>],
        number: usize,
        i: usize,
    ) -> impl Iterator<Item = (f64, f64, bool)> {
        let info = &PARAMETERS[i];
        let coordinate = |own: &Parameters<f64>| info.coordinate(own.to_array()[i]);
        let here = coordinate(&parameters[number]);
        let precision = info.prior_sigma.powi(-2);
        let prior = (here - info.coordinate(info.default), precision, false);
        let mean = parameters.iter().map(coordinate).sum::<f64>() / parameters.len() as f64;
        let alike = ALIKE
            .into_iter()
            .find(|(part, _)| *part == info.part && parameters.len() > 1)
            .map(|(_, kappa)| (here - mean, precision / (kappa * kappa), true));
        let known = self.trust.as_ref().map(|(known, radius)| {
            let deviation = here - coordinate(&known[number]);
            (deviation, precision / (radius * radius), false)
        });
        std::iter::once(prior).chain(alike).chain(known)
    }
}
