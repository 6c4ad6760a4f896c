//! The physical parameters: one table with names, units, bounds and priors.

use super::scalar::{Dual, Scalar};
use serde::{Deserialize, Serialize};

/// How a parameter is varied in a fit, interpolated, and what its prior is a normal distribution in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// The parameter itself.
    Linear,
    /// The logarithm of a positive parameter.
    Log,
    /// The same of a beam's stiffness or damping. Between configurations its reciprocal is interpolated: how far a beam
    /// bends under a moment is proportional to its length.
    Beam,
}

/// What a parameter belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The quadrotor and its autopilot: the same whatever the arm's configuration.
    Vehicle,
    /// The arm.
    Arm,
}

/// One row of the parameter table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterInfo {
    /// Name, as in files.
    pub name: &'static str,
    /// Unit; "kg" in it counts quadrotor masses, since poses tell only ratios of masses.
    pub unit: &'static str,
    /// Start of a fit and mean of the prior.
    pub default: f64,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// Linear or logarithmic.
    pub scale: Scale,
    /// Standard deviation of the prior, in the parameter's scale.
    pub prior_sigma: f64,
    /// What it belongs to.
    pub part: Part,
    /// What it is.
    pub meaning: &'static str,
}

macro_rules! parameters {
    ($($part:ident $name:ident: $unit:literal, $default:literal in $lower:literal .. $upper:literal, $scale:ident $sigma:literal, $meaning:literal;)*) => {
        /// The parameters by name; units and meanings are in [`PARAMETERS`].
        #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Parameters<S> {
            $(#[doc = concat!($meaning, ", ", $unit, ".")] pub $name: S,)*
        }

        /// The parameter table, in the order of [`Parameters::to_array`].
        pub const PARAMETERS: [ParameterInfo; PARAMETER_COUNT] = [$(ParameterInfo {
            name: stringify!($name), unit: $unit, default: $default, lower: $lower, upper: $upper,
            scale: Scale::$scale, prior_sigma: $sigma, part: Part::$part, meaning: $meaning,
        },)*];

        /// Number of parameters.
        pub const PARAMETER_COUNT: usize = [$(stringify!($name)),*].len();

        impl<S: Copy> Parameters<S> {
            /// In the table's order.
            pub fn to_array(self) -> [S; PARAMETER_COUNT] {
                [$(self.$name),*]
            }

            /// From the table's order.
            pub fn from_array(array: [S; PARAMETER_COUNT]) -> Self {
                let [$($name),*] = array;
                Parameters { $($name),* }
            }
        }
    };
}

parameters! {
    Vehicle position_gain_xy: "1/s", 0.95 in 0.2..5.0, Log 0.5, "commanded horizontal velocity per position error";
    Vehicle position_gain_z: "1/s", 1.0 in 0.2..5.0, Log 0.5, "commanded vertical velocity per height error";
    Vehicle velocity_gain_xy: "1/s", 1.8 in 0.3..10.0, Log 0.5, "horizontal acceleration per velocity error";
    Vehicle velocity_gain_z: "1/s", 4.0 in 0.5..20.0, Log 0.5, "vertical acceleration per velocity error";
    Vehicle integral_gain_xy: "1/s^2", 0.4 in 0.01..5.0, Log 1.0, "growth of the horizontal integrator per velocity error";
    Vehicle integral_gain_z: "1/s^2", 2.0 in 0.01..10.0, Log 1.0, "growth of the vertical integrator per velocity error";
    Vehicle derivative_gain_xy: "1", 0.2 in 0.002..3.0, Log 1.0, "horizontal acceleration taken back per measured acceleration";
    Vehicle derivative_gain_z: "1", 0.02 in 0.001..3.0, Log 1.0, "vertical acceleration taken back per measured acceleration";
    Vehicle derivative_time_constant: "s", 0.03 in 0.001..0.3, Log 0.5, "low-pass of the velocity derivative";
    Vehicle horizontal_speed_limit: "m/s", 12.0 in 0.3..30.0, Log 1.0, "largest commanded horizontal velocity";
    Vehicle vertical_speed_limit: "m/s", 2.0 in 0.5..5.0, Log 0.5, "largest commanded vertical velocity";
    Vehicle tilt_limit: "rad", 0.785 in 0.3..1.2, Log 0.3, "largest commanded tilt";
    Vehicle thrust_maximum: "m/s^2", 30.0 in 16.0..60.0, Log 0.2, "largest collective thrust per quadrotor mass";
    Vehicle attitude_gain: "1/s", 6.5 in 1.0..30.0, Log 0.5, "commanded body rate per attitude error";
    Vehicle rate_limit: "rad/s", 3.8 in 1.0..10.0, Log 0.3, "largest commanded body rate";
    Vehicle rate_gain: "1/s", 20.0 in 5.0..100.0, Log 0.5, "angular acceleration per body-rate error";
    Vehicle rate_integral_gain: "1/s^2", 20.0 in 0.1..300.0, Log 1.0, "growth of the rate integrator per body-rate error";
    Vehicle rate_time_constant: "s", 0.03 in 0.005..0.1, Log 0.5, "lag of the angular acceleration (motors)";
    Vehicle thrust_time_constant: "s", 0.03 in 0.001..0.3, Log 0.5, "lag of the collective thrust (motors)";
    Vehicle command_delay: "s", 0.035 in 0.0..0.1, Linear 0.03, "transport delay of the position command";
    Vehicle velocity_feedforward: "1", 0.0 in -0.5..1.5, Linear 1.0, "share of the commanded velocity that the velocity loop is given beside the position loop's";
    Vehicle acceleration_feedforward: "1", 0.0 in -0.5..1.5, Linear 1.0, "share of the commanded acceleration that the attitude loop is given beside the velocity loop's";
    Vehicle quadrotor_drag: "1/s", 0.1 in 0.001..2.0, Log 1.0, "linear drag of the quadrotor per its mass";
    Vehicle arm_torque_gain: "1/m^2", 50.0 in 0.1..1000.0, Log 1.5, "quadrotor mass over its moment of inertia, as far as the rate loop lets the arm turn it";
    Arm base_offset: "m", 0.05 in -0.05..0.3, Linear 0.05, "arm's base below the quadrotor's reference point";
    Arm joint_fraction: "1", 0.5 in 0.15..0.85, Linear 0.2, "inner joint's place along the arm, from the base";
    Arm base_stiffness: "N m/(rad kg)", 0.5 in 0.001..50.0, Beam 2.0, "bending stiffness of the joint at the base";
    Arm joint_stiffness: "N m/(rad kg)", 0.5 in 0.001..50.0, Beam 2.0, "bending stiffness of the inner joint";
    Arm base_damping: "N m s/(rad kg)", 0.02 in 0.0005..5.0, Beam 1.5, "viscous damping of the joint at the base";
    Arm joint_damping: "N m s/(rad kg)", 0.02 in 0.0005..1.0, Beam 1.5, "viscous damping of the inner joint";
    Arm tip_drag: "kg/m", 0.02 in 0.0005..0.5, Log 1.0, "quadratic air drag of the tip";
    Arm joint_drag: "kg/m", 0.01 in 0.0005..0.5, Log 1.0, "quadratic air drag of the inner mass";
    Arm tip_mass: "kg", 0.2 in 0.02..1.0, Log 0.5, "mass at the tip";
    Arm joint_mass: "kg", 0.1 in 0.02..0.5, Log 0.5, "mass at the inner joint";
}

impl Parameters<f64> {
    /// Every parameter at its default.
    pub fn defaults() -> Self {
        Self::from_array(PARAMETERS.map(|info| info.default))
    }

    /// The same numbers as constants of another scalar type.
    pub fn lift<S: Scalar>(&self) -> Parameters<S> {
        Parameters::from_array(self.to_array().map(S::from))
    }

    /// The coordinates that a fit varies: every value or its logarithm.
    pub fn coordinates(&self) -> [f64; PARAMETER_COUNT] {
        let values = self.to_array();
        std::array::from_fn(|i| PARAMETERS[i].coordinate(values[i]))
    }

    /// Inverse of [`Self::coordinates`], kept within the bounds.
    pub fn from_coordinates(coordinates: [f64; PARAMETER_COUNT]) -> Self {
        Self::from_array(std::array::from_fn(|i| {
            let info = &PARAMETERS[i];
            info.value(coordinates[i]).clamp(info.lower, info.upper)
        }))
    }

    /// Variables of a derivative with respect to the coordinates. No feed-forward of velocities is a vehicle that is
    /// not sent any: then both feed-forwards are constants, of which flights say nothing.
    pub fn variables(&self) -> Parameters<Dual> {
        let values = self.to_array();
        let mut variables = Parameters::from_array(std::array::from_fn(|i| {
            Dual::variable(values[i], i).chain(values[i], PARAMETERS[i].value_slope(values[i]))
        }));
        if self.velocity_feedforward == 0.0 {
            variables.velocity_feedforward = Dual::from(0.0);
            variables.acceleration_feedforward = Dual::from(0.0);
        }
        variables
    }

    /// Weighted mean, each parameter in its [`Scale`]: arithmetic, geometric, or (of a beam) harmonic. The weights sum
    /// to one; the result is kept within the bounds.
    pub fn mean(parts: &[(f64, &Self)]) -> Self {
        if let [(1.0, only)] = parts {
            return **only; // to the last bit
        }
        let values: Vec<_> = parts
            .iter()
            .map(|(weight, part)| (*weight, part.to_array()))
            .collect();
        Self::from_array(std::array::from_fn(|i| {
            let info = &PARAMETERS[i];
            let sum = |term: &dyn Fn(f64) -> f64| -> f64 {
                values.iter().map(|(weight, value)| weight * term(value[i])).sum()
            };
            let mean = match info.scale {
                Scale::Linear => sum(&|value| value),
                Scale::Log => sum(&f64::ln).exp(),
                Scale::Beam => 1.0 / sum(&f64::recip),
            };
            mean.clamp(info.lower, info.upper)
        }))
    }

    /// This arm on another vehicle.
    pub fn with_vehicle(&self, vehicle: &Self) -> Self {
        let (own, other) = (self.to_array(), vehicle.to_array());
        Self::from_array(std::array::from_fn(|i| match PARAMETERS[i].part {
            Part::Vehicle => other[i],
            Part::Arm => own[i],
        }))
    }

    /// The first parameter that is not a number within its bounds.
    pub fn out_of_bounds(&self) -> Option<(&'static ParameterInfo, f64)> {
        PARAMETERS
            .iter()
            .zip(self.to_array())
            .find(|(info, value)| !(info.lower..=info.upper).contains(value))
    }
}

impl ParameterInfo {
    /// The coordinate that is varied: the value or its logarithm.
    pub fn coordinate(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => value,
            Scale::Log | Scale::Beam => value.ln(),
        }
    }

    /// Inverse of [`Self::coordinate`].
    pub fn value(&self, coordinate: f64) -> f64 {
        match self.scale {
            Scale::Linear => coordinate,
            Scale::Log | Scale::Beam => coordinate.exp(),
        }
    }

    /// `d value / d coordinate` at `value`.
    pub fn value_slope(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => 1.0,
            Scale::Log | Scale::Beam => value,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_lie_within_their_bounds_and_names_differ() {
        assert_eq!(Parameters::defaults().out_of_bounds(), None);
        for (i, info) in PARAMETERS.iter().enumerate() {
            assert!(PARAMETERS[..i].iter().all(|other| other.name != info.name));
            assert!(info.scale == Scale::Linear || info.lower > 0.0, "{}", info.name);
        }
    }

    #[test]
    fn mean_is_that_of_the_parameters_scale() {
        let (mut soft, mut stiff) = (Parameters::defaults(), Parameters::defaults());
        (soft.base_stiffness, stiff.base_stiffness) = (0.1, 10.0);
        (soft.base_offset, stiff.base_offset) = (0.0, 0.1);
        (soft.tip_mass, stiff.tip_mass) = (0.1, 0.4);
        let middle = Parameters::mean(&[(0.5, &soft), (0.5, &stiff)]);
        // A beam of half the one and half the other bends as much as both halves.
        assert!((1.0 / middle.base_stiffness - 5.05).abs() < 1e-12);
        assert!((middle.tip_mass - 0.2).abs() < 1e-12);
        assert!((middle.base_offset - 0.05).abs() < 1e-12);
        assert_eq!(Parameters::mean(&[(1.0, &stiff)]), stiff);
    }

    #[test]
    fn out_of_bounds_names_the_parameter() {
        let mut parameters = Parameters::defaults();
        parameters.tip_mass = f64::NAN;
        assert_eq!(parameters.out_of_bounds().unwrap().0.name, "tip_mass");
    }
}
