//! The inflated arm: growth motor and air, and the chain that they make of the present length and pressure.

use super::VehicleParameters;
use super::chain::{Base, Chain, Growth, Joint, Link, Slider, Tip};
use super::hysteresis::ElastoSlip;
use super::pneumatics::Pneumatics;
use crate::GRAVITY;
use crate::flight::Configuration;

/// Density of air, kg/m³.
const AIR_DENSITY: f64 = 1.2;

/// Length and pressure with their rates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arm {
    length_m: f64,
    rate_m_s: f64,
    acceleration_m_s2: f64,
    pneumatics: Pneumatics,
}

impl Arm {
    /// At rest.
    pub(super) fn at(configuration: &Configuration) -> Arm {
        Arm {
            length_m: configuration.length_m,
            rate_m_s: 0.0,
            acceleration_m_s2: 0.0,
            pneumatics: Pneumatics::at(configuration.pressure_kpa),
        }
    }

    /// Rest distance from quadrotor to end effector and pressure as they are now.
    pub(super) fn configuration(&self) -> Configuration {
        Configuration {
            length_m: self.length_m,
            pressure_kpa: self.pneumatics.pressure_kpa,
        }
    }

    /// Growth and pressure follow their setpoints for `period` seconds.
    pub(super) fn step(&mut self, parameters: &VehicleParameters, setpoint: &Configuration, period: f64) {
        let arm = &parameters.arm;
        // Speed towards the target, limited by the motor and so that it does not overshoot.
        let wanted = ((setpoint.length_m - self.length_m) / (2.0 * arm.growth_time_constant_s))
            .clamp(-arm.max_growth_rate_m_s, arm.max_growth_rate_m_s);
        let change = (wanted - self.rate_m_s) * (1.0 - (-period / arm.growth_time_constant_s).exp());
        self.acceleration_m_s2 = change / period;
        self.length_m += period * (self.rate_m_s + 0.5 * change);
        self.rate_m_s += change;

        let area = 0.25 * std::f64::consts::PI * arm.diameter_m * arm.diameter_m;
        self.pneumatics.step(
            &parameters.pneumatics,
            setpoint.pressure_kpa,
            area * self.tube_length(parameters),
            area * self.rate_m_s,
            period,
        );
    }

    /// Length of the part that bends, m.
    fn tube_length(&self, parameters: &VehicleParameters) -> f64 {
        self.length_m - parameters.quadrotor.clamp_offset_m - parameters.arm.tip_offset_m
    }

    /// Link lengths, masses and joints for the present length and pressure.
    pub(super) fn shape(&self, parameters: &VehicleParameters, chain: &mut Chain) {
        let arm = &parameters.arm;
        let links = chain.links.len() as f64;
        let tube = self.tube_length(parameters);
        let length = tube / links;
        let mass = arm.linear_density_kg_m * length;
        let radius = 0.5 * arm.diameter_m;
        // A thin-walled cylinder.
        let link = Link {
            length_m: length,
            mass_kg: mass,
            center_m: 0.5 * length,
            inertia_transverse_kg_m2: mass * (0.5 * radius * radius + length * length / 12.0),
            inertia_axial_kg_m2: mass * radius * radius,
            drag_normal: 0.5 * AIR_DENSITY * arm.drag_coefficient_normal * arm.diameter_m * length,
            drag_tangential: 0.5
                * AIR_DENSITY
                * arm.drag_coefficient_tangential
                * std::f64::consts::PI
                * arm.diameter_m
                * length,
        };
        chain.links.fill(link);
        let beam = arm.corners.at(self.length_m, self.pneumatics.pressure_kpa);
        let joint = Joint {
            stiffness: beam.stiffness_n_m2 / length,
            damping: beam.damping_n_m2_s / length,
            collapse_moment: beam.collapse_moment_n_m,
            hysteresis: (arm.slip_moment_n_m > 0.0).then_some(ElastoSlip {
                stiffness: arm.slip_stiffness_n_m2 / length,
                slip_moment: arm.slip_moment_n_m,
            }),
        };
        chain.joints.fill(joint);
        // From the clamp to the middle of the first link there is only half a link that bends.
        chain.joints[0] = Joint {
            stiffness: 2.0 * joint.stiffness,
            damping: 2.0 * joint.damping,
            hysteresis: joint.hysteresis.map(|element| ElastoSlip {
                stiffness: 2.0 * element.stiffness,
                ..element
            }),
            ..joint
        };
        let tip_mass = arm.tip_mass_kg - arm.linear_density_kg_m * tube;
        chain.tip.mass_kg = tip_mass + parameters.payload.tip_mass_kg;
        chain.tip.slider = Some(Slider {
            rest_force: tip_mass * GRAVITY,
            slack_stiffness: 1.0 / beam.slack_m_n,
            stretch_stiffness: 1.0 / beam.stretch_m_n,
            damping: arm.axial_damping_n_s_m,
        });
        chain.growth.link_rate = self.rate_m_s / links;
        chain.growth.link_acceleration = self.acceleration_m_s2 / links;
    }
}

/// A chain with everything that neither length nor pressure changes.
pub(super) fn empty_chain(parameters: &VehicleParameters) -> Chain {
    let (arm, quadrotor) = (&parameters.arm, &parameters.quadrotor);
    let links = parameters.simulation.links;
    let link = Link {
        length_m: 0.0,
        mass_kg: 0.0,
        center_m: 0.0,
        inertia_transverse_kg_m2: 0.0,
        inertia_axial_kg_m2: 0.0,
        drag_normal: 0.0,
        drag_tangential: 0.0,
    };
    Chain {
        base: Some(Base {
            mass_kg: quadrotor.total_mass_kg - arm.tip_mass_kg,
            inertia_kg_m2: quadrotor.inertia_kg_m2,
            clamp_offset_m: quadrotor.clamp_offset_m,
            drag: quadrotor.drag_n_s_m,
        }),
        links: vec![link; links],
        joints: vec![
            Joint {
                stiffness: 0.0,
                damping: 0.0,
                collapse_moment: f64::INFINITY,
                hysteresis: None,
            };
            links
        ],
        tip: Tip {
            mass_kg: arm.tip_mass_kg,
            offset_m: arm.tip_offset_m,
            inertia_transverse_kg_m2: arm.tip_inertia_transverse_kg_m2,
            inertia_axial_kg_m2: arm.tip_inertia_axial_kg_m2,
            drag: 0.5 * AIR_DENSITY * arm.tip_drag_area_m2,
            slider: None,
        },
        growth: Growth {
            linear_density: arm.linear_density_kg_m,
            ..Growth::default()
        },
        gravity: GRAVITY,
    }
}
