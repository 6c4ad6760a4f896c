//! Vehicles around a given one, to try plans and controllers on more than a single guess of reality.

use super::VehicleParameters;
use super::free;
use rand::{Rng, RngExt};

/// A vehicle whose mass, inertia, arm, gains and delays (everything in [`free::all`]) each differ from
/// `parameters` by an even draw within ±`share`.
pub fn randomized(parameters: &VehicleParameters, share: f64, random: &mut impl Rng) -> VehicleParameters {
    let mut factor = || 1.0 + share * (2.0 * random.random::<f64>() - 1.0);
    let mut result = parameters.clone();
    result.quadrotor.total_mass_kg *= factor();
    for free in free::all() {
        (free.set)(&mut result, factor() * (free.get)(parameters));
    }
    result
}
