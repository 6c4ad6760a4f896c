//! Every number of the simulated vehicle, from TOML or as calibrated.

mod arm;
mod check;

pub use arm::{ArmParameters, Beam, CORNER_LENGTHS_M, CORNER_PRESSURES_KPA, Corners};
pub(super) use check::Checker;
pub use check::ParameterError;

use super::autopilot::AutopilotParameters;
use super::contact::ContactParameters;
use super::mocap::MocapParameters;
use super::pneumatics::PneumaticsParameters;
use super::wind::WindParameters;
use serde::{Deserialize, Serialize};

/// The simulated vehicle. [`Default`] is the set calibrated against the paper's flights.
///
/// In TOML every table and key may be left out; unknown keys are refused.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VehicleParameters {
    /// Time steps and discretization.
    pub simulation: SimulationParameters,
    /// The flying body.
    pub quadrotor: QuadrotorParameters,
    /// The inflated arm.
    pub arm: ArmParameters,
    /// Pumps, leak and pressure control.
    pub pneumatics: PneumaticsParameters,
    /// Flight controller.
    pub autopilot: AutopilotParameters,
    /// Motion capture.
    pub mocap: MocapParameters,
    /// Moving air.
    pub wind: WindParameters,
    /// What the arm carries.
    pub payload: PayloadParameters,
    /// What the end effector can touch.
    pub contact: ContactParameters,
}

/// Time steps and discretization.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationParameters {
    /// Longest physics step, s. The step used is the rate loop's period over a whole number.
    pub max_step_s: f64,
    /// Number of links of the arm.
    pub links: usize,
}

/// The flying body: frame, motors, battery and the arm's electronics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct QuadrotorParameters {
    /// Mass of the whole vehicle, arm included and payload not, kg.
    pub total_mass_kg: f64,
    /// Principal moments of inertia without the arm, body axes, kg m².
    pub inertia_kg_m2: [f64; 3],
    /// Distance of the motors from the centre along body x and along body y (X layout), m.
    pub motor_offset_m: f64,
    /// Thrust of all four motors at full throttle, N.
    pub max_thrust_n: f64,
    /// First-order lag of the motors' thrust, s.
    pub motor_time_constant_s: f64,
    /// Yaw torque per thrust of a propeller, m.
    pub torque_per_thrust_m: f64,
    /// Linear air drag per body axis, N/(m/s).
    pub drag_n_s_m: [f64; 3],
    /// Distance from the centre of mass down to the clamp, where the tube starts to bend, m.
    pub clamp_offset_m: f64,
    /// Share of thrust lost per minute of flight at the same throttle.
    pub battery_sag_per_minute: f64,
    /// Radius that counts for the ground effect (of one propeller, or more where they act as one), m; zero
    /// for none.
    pub ground_effect_radius_m: f64,
}

/// What the arm carries besides itself.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PayloadParameters {
    /// Point mass at the end effector, kg. The autopilot does not know of it, but has trimmed its weight
    /// when a flight starts.
    pub tip_mass_kg: f64,
}

impl Default for SimulationParameters {
    fn default() -> Self {
        SimulationParameters {
            max_step_s: 0.0025,
            links: 8,
        }
    }
}

impl Default for QuadrotorParameters {
    fn default() -> Self {
        QuadrotorParameters {
            total_mass_kg: 1.7,
            inertia_kg_m2: [0.02355, 0.02355, 0.03532],
            motor_offset_m: 0.09,
            max_thrust_n: 4.0 * 9.81,
            motor_time_constant_s: 0.05977,
            torque_per_thrust_m: 0.015,
            drag_n_s_m: [0.4011, 0.4011, 0.4011],
            clamp_offset_m: 0.1601,
            battery_sag_per_minute: 0.0,
            ground_effect_radius_m: 0.0,
        }
    }
}

impl VehicleParameters {
    /// Reads and validates TOML.
    pub fn from_toml(text: &str) -> Result<VehicleParameters, ParameterError> {
        let parameters: VehicleParameters = toml::from_str(text).map_err(|error| ParameterError::Syntax {
            message: error.to_string(),
        })?;
        parameters.validate()?;
        Ok(parameters)
    }

    /// Refuses numbers that are not finite, outside the physical range, or contradict each other.
    pub fn validate(&self) -> Result<(), ParameterError> {
        self.simulation.validate()?;
        self.quadrotor.validate()?;
        self.arm.validate()?;
        self.pneumatics.validate()?;
        self.autopilot.validate()?;
        self.mocap.validate()?;
        self.wind.validate()?;
        self.contact.validate()?;
        Checker::new("payload").range("tip_mass_kg", self.payload.tip_mass_kg, 0.0, 1.0, "kg")?;
        self.validate_together()
    }

    fn validate_together(&self) -> Result<(), ParameterError> {
        let contradiction = |what: String| Err(ParameterError::Contradiction { what });
        let arm = &self.arm;
        let [shortest, longest] = arm.length_range_m;
        let rigid = self.quadrotor.clamp_offset_m + arm.tip_offset_m;
        if shortest < rigid + 0.05 {
            return contradiction(format!(
                "arm.length_range_m starts at {shortest} m, but clamp and tip offsets alone take {rigid:.3} m: \
                 at least 0.05 m of tube must remain"
            ));
        }
        if longest <= shortest {
            return contradiction(format!(
                "arm.length_range_m = [{shortest}, {longest}]: must be ascending"
            ));
        }
        let wound = arm.tip_mass_kg - arm.linear_density_kg_m * (longest - rigid);
        if wound < 0.001 {
            return contradiction(format!(
                "arm.tip_mass_kg = {} leaves {wound:.3} kg at the tip of the longest arm: at least 0.001 kg expected",
                arm.tip_mass_kg
            ));
        }
        let quadrotor = &self.quadrotor;
        if quadrotor.total_mass_kg - arm.tip_mass_kg < 0.01 {
            return contradiction(format!(
                "quadrotor.total_mass_kg = {} with an arm of {} kg leaves less than 0.01 kg for the quadrotor",
                quadrotor.total_mass_kg, arm.tip_mass_kg
            ));
        }
        let weight = (quadrotor.total_mass_kg + self.payload.tip_mass_kg) * crate::GRAVITY;
        if quadrotor.max_thrust_n < 1.1 * weight {
            return contradiction(format!(
                "quadrotor.max_thrust_n = {} cannot carry the weight of {weight:.2} N with a tenth to spare",
                quadrotor.max_thrust_n
            ));
        }
        Ok(())
    }
}

impl SimulationParameters {
    fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("simulation");
        check.range("max_step_s", self.max_step_s, 1e-6, 0.01, "s")?;
        check.range("links", self.links as f64, 1.0, 200.0, "links")
    }
}

impl QuadrotorParameters {
    fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("quadrotor");
        check.range("total_mass_kg", self.total_mass_kg, 0.01, 100.0, "kg")?;
        for inertia in self.inertia_kg_m2 {
            check.range("inertia_kg_m2", inertia, 1e-6, 10.0, "kg m²")?;
        }
        check.range("motor_offset_m", self.motor_offset_m, 0.01, 2.0, "m")?;
        check.range("max_thrust_n", self.max_thrust_n, 0.1, 5000.0, "N")?;
        check.range(
            "motor_time_constant_s",
            self.motor_time_constant_s,
            1e-3,
            0.5,
            "s",
        )?;
        check.range("torque_per_thrust_m", self.torque_per_thrust_m, 1e-4, 0.5, "m")?;
        for drag in self.drag_n_s_m {
            check.range("drag_n_s_m", drag, 0.0, 10.0, "N/(m/s)")?;
        }
        check.range(
            "battery_sag_per_minute",
            self.battery_sag_per_minute,
            0.0,
            0.5,
            "1/min",
        )?;
        check.range(
            "ground_effect_radius_m",
            self.ground_effect_radius_m,
            0.0,
            1.0,
            "m",
        )?;
        check.range("clamp_offset_m", self.clamp_offset_m, 0.0, 0.5, "m")
    }
}
