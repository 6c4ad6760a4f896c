//! The simulated vehicle: physics, flight controller, arm actuation and motion capture in lockstep.

use super::autopilot::mixer::Mixer;
use super::autopilot::position::ThrustModel;
use super::autopilot::{Autopilot, Estimate};
use super::chain::{Base, Chain, ChainState, Growth, Joint, Link, Load, Slider, Tip};
use super::contact::{self, Ball};
use super::integrator::{LinearlyImplicit, STAGE};
use super::mocap::{Mocap, MocapFaults, Scene, pose};
use super::parameters::{ParameterError, VehicleParameters};
use super::pneumatics::Pneumatics;
use super::wind::Gust;
use crate::flight::{Configuration, Pose};
use crate::link::{Observation, Vehicle, VehicleError};
use crate::{DT, GRAVITY};
use nalgebra::{UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// Density of air, kg/m³.
const AIR_DENSITY: f64 = 1.2;
/// Position at which a flight starts, m.
const START: Vector3<f64> = Vector3::new(0.0, 0.0, 1.5);
/// How long the vehicle hovers before the flight starts where wind has to be trimmed, s.
const SETTLING_S: f64 = 10.0;
/// Random streams of one seed: one for the sensors, one for the air, so that neither shifts the other.
const SENSOR_STREAM: u64 = 0;
const WIND_STREAM: u64 = 1;

/// The quadrotor with its autopilot and arm, as a [`Vehicle`].
///
/// Deterministic: the same parameters, seed and commands give the same bits.
#[derive(Debug, Clone)]
pub struct SimulatedVehicle {
    parameters: VehicleParameters,
    mixer: Mixer,
    chain: Chain,
    state: ChainState,
    integrator: LinearlyImplicit,
    autopilot: Autopilot,
    motors: [f64; 4],
    arm: ArmState,
    pneumatics: Pneumatics,
    gust: Gust,
    mocap: Mocap,
    ball: Option<Ball>,
    sensor_random: ChaCha8Rng,
    wind_random: ChaCha8Rng,
    /// Commands that have not reached the autopilot yet, with their time of arrival, s.
    pending: VecDeque<(f64, Vector3<f64>)>,
    command: Vector3<f64>,
    /// Rate-loop periods since the reset.
    tick: u64,
}

/// Length of the arm and its rate.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ArmState {
    length_m: f64,
    rate_m_s: f64,
    acceleration_m_s2: f64,
}

/// The vehicle without noise, for judging and drawing.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Vehicle time since the reset, s.
    pub t_s: f64,
    /// Quadrotor pose.
    pub quadrotor: Pose,
    /// End-effector position, m.
    pub end_effector: [f64; 3],
    /// Clamp, joints and the end of the tube, from the quadrotor outwards, m.
    pub nodes: Vec<[f64; 3]>,
    /// Rest distance from quadrotor to end effector and pressure as they are now.
    pub configuration: Configuration,
    /// Position of the ball, m, where there is one.
    pub ball: Option<[f64; 3]>,
    /// Poses that motion-capture faults took since the reset.
    pub mocap_faults: MocapFaults,
}

impl SimulatedVehicle {
    /// A vehicle at rest in the short, empty configuration with seed 0; parameters are validated.
    pub fn new(parameters: VehicleParameters) -> Result<SimulatedVehicle, ParameterError> {
        parameters.validate()?;
        let links = parameters.simulation.links;
        let quadrotor = &parameters.quadrotor;
        let mixer = Mixer {
            offset_m: quadrotor.motor_offset_m,
            torque_per_thrust_m: quadrotor.torque_per_thrust_m,
            max_n: 0.25 * quadrotor.max_thrust_n,
        };
        let length_m = 0.7_f64.clamp(parameters.arm.length_range_m[0], parameters.arm.length_range_m[1]);
        let mut wind_random = ChaCha8Rng::seed_from_u64(0);
        let gust = Gust::stationary(&parameters.wind, &mut wind_random);
        let mut vehicle = SimulatedVehicle {
            chain: empty_chain(&parameters),
            mixer,
            state: ChainState::hanging(START, links),
            integrator: LinearlyImplicit::new(links),
            autopilot: Autopilot::hovering(&parameters.autopilot, 0.0),
            motors: [0.0; 4],
            arm: ArmState {
                length_m,
                rate_m_s: 0.0,
                acceleration_m_s2: 0.0,
            },
            pneumatics: Pneumatics::at(0.0),
            gust,
            mocap: Mocap::new(
                &parameters.mocap,
                Scene {
                    position: START,
                    attitude: UnitQuaternion::identity(),
                    end_effector: START,
                },
                parameters.autopilot.rate_period_s,
            ),
            ball: None,
            sensor_random: ChaCha8Rng::seed_from_u64(0),
            wind_random,
            pending: VecDeque::with_capacity(64),
            command: START,
            tick: 0,
            parameters,
        };
        vehicle.restart(
            Configuration {
                length_m,
                pressure_kpa: 0.0,
            },
            0,
        );
        Ok(vehicle)
    }

    /// The parameters it was made with.
    pub fn parameters(&self) -> &VehicleParameters {
        &self.parameters
    }

    /// Vehicle time since the reset, s.
    pub fn time_s(&self) -> f64 {
        self.tick as f64 * self.parameters.autopilot.rate_period_s
    }

    /// Positions of quadrotor and end effector without noise, m.
    pub fn positions(&self) -> (Vector3<f64>, Vector3<f64>) {
        (self.state.position, self.chain.end_effector(&self.state))
    }

    /// The vehicle without noise.
    pub fn truth(&self) -> Truth {
        let mut nodes = Vec::with_capacity(self.chain.links.len() + 1);
        self.chain
            .for_each_node(&self.state, |node| nodes.push(node.into()));
        Truth {
            t_s: self.time_s(),
            quadrotor: pose(&self.state.position, &self.state.attitude),
            end_effector: self.chain.end_effector(&self.state).into(),
            nodes,
            configuration: Configuration {
                length_m: self.arm.length_m,
                pressure_kpa: self.pneumatics.pressure_kpa,
            },
            ball: self.ball.map(|ball| ball.position.into()),
            mocap_faults: self.mocap.faults,
        }
    }

    /// Thrust that holds the weight, N.
    fn weight(&self) -> f64 {
        (self.parameters.quadrotor.total_mass_kg + self.parameters.payload.tip_mass_kg) * GRAVITY
    }

    /// Hover at rest: the arm straight down, the motors holding the weight, nothing pending.
    fn restart(&mut self, configuration: Configuration, seed: u64) {
        let links = self.parameters.simulation.links;
        self.arm = ArmState {
            length_m: configuration.length_m,
            rate_m_s: 0.0,
            acceleration_m_s2: 0.0,
        };
        self.pneumatics = Pneumatics::at(configuration.pressure_kpa);
        self.state.copy_from(&ChainState::hanging(START, links));
        self.integrator.reset();
        self.autopilot = Autopilot::hovering(&self.parameters.autopilot, self.weight());
        self.motors = [0.25 * self.weight(); 4];
        self.sensor_random = ChaCha8Rng::seed_from_u64(seed);
        self.sensor_random.set_stream(SENSOR_STREAM);
        self.wind_random = ChaCha8Rng::seed_from_u64(seed);
        self.wind_random.set_stream(WIND_STREAM);
        self.gust = Gust::stationary(&self.parameters.wind, &mut self.wind_random);
        self.pending.clear();
        self.command = START;
        self.tick = 0;
        self.update_chain();
        // A payload stretches the tube at rest.
        if let Some(slider) = &self.chain.tip.slider {
            self.state.extension = self.parameters.payload.tip_mass_kg * GRAVITY / slider.stretch_stiffness;
        }
        self.ball = self.parameters.contact.ball.as_ref().map(Ball::at_rest);
        if !self.parameters.wind.is_calm() {
            let ticks = (SETTLING_S / self.parameters.autopilot.rate_period_s).round() as u64;
            for _ in 0..ticks {
                self.period(&configuration);
            }
            self.tick = 0;
        }
        let period = self.parameters.autopilot.rate_period_s;
        self.mocap = Mocap::new(&self.parameters.mocap, self.scene(), period);
    }

    fn scene(&self) -> Scene {
        Scene {
            position: self.state.position,
            attitude: self.state.attitude,
            end_effector: self.chain.end_effector(&self.state),
        }
    }

    /// One period of the rate loop.
    fn period(&mut self, configuration: &Configuration) {
        let period = self.parameters.autopilot.rate_period_s;
        let now = self.time_s();
        while self
            .pending
            .front()
            .is_some_and(|(arrival, _)| *arrival <= now + 1e-9)
        {
            if let Some((_, command)) = self.pending.pop_front() {
                self.command = command;
            }
        }
        let wanted = self.control();
        let wind = self
            .gust
            .step(&self.parameters.wind, period, &mut self.wind_random);
        self.actuate_arm(configuration, period);
        self.update_chain();

        let substeps = (period / self.parameters.simulation.max_step_s - 1e-9)
            .ceil()
            .max(1.0);
        let step = period / substeps;
        let effectiveness = self.thrust_effectiveness(now);
        for _ in 0..substeps as usize {
            let tip_force = self.contact_force(&wind, step);
            let loads = [STAGE, 1.0].map(|fraction| {
                let (thrust, torque) = self.mixer.wrench(&self.motors_after(&wanted, fraction * step));
                Load {
                    thrust: effectiveness * thrust,
                    torque: effectiveness * torque,
                    wind,
                    tip_force,
                }
            });
            self.integrator.step(&self.chain, &mut self.state, &loads, step);
            self.motors = self.motors_after(&wanted, step);
        }
        self.tick += 1;
        self.mocap.watch(self.scene());
    }

    /// Thrust per thrust asked for: the battery sags, and the ground (z = 0) helps by
    /// `1 / (1 − (r / 4z)²)` (Cheeseman and Bennett, ARC R&M 3021, 1955).
    fn thrust_effectiveness(&self, now: f64) -> f64 {
        let quadrotor = &self.parameters.quadrotor;
        let battery = (1.0 - quadrotor.battery_sag_per_minute * now / 60.0).max(0.0);
        if quadrotor.ground_effect_radius_m == 0.0 {
            return battery;
        }
        // The formula holds down to about one radius.
        let ratio = quadrotor.ground_effect_radius_m
            / (4.0 * self.state.position.z.max(quadrotor.ground_effect_radius_m));
        battery / (1.0 - ratio * ratio)
    }

    /// Contact force on the end effector, N; moves the ball.
    fn contact_force(&mut self, wind: &Vector3<f64>, step: f64) -> Vector3<f64> {
        let contact = &self.parameters.contact;
        if contact.floor_m.is_none() && self.ball.is_none() {
            return Vector3::zeros();
        }
        let (tip, velocity) = self.chain.end_effector_motion(&self.state);
        contact::step(contact, self.ball.as_mut(), &tip, &velocity, wind, step)
    }

    /// Motor thrusts after `time` of first-order lag towards `wanted`, N.
    fn motors_after(&self, wanted: &[f64; 4], time: f64) -> [f64; 4] {
        let keep = (-time / self.parameters.quadrotor.motor_time_constant_s).exp();
        std::array::from_fn(|i| wanted[i] + keep * (self.motors[i] - wanted[i]))
    }

    /// Motor thrusts that the flight controller asks for, N.
    fn control(&mut self) -> [f64; 4] {
        let parameters = &self.parameters;
        let estimate = Estimate {
            position: self.state.position,
            velocity: self.state.motion.linear,
            attitude: self.state.attitude,
            rate: self.state.attitude.inverse() * self.state.motion.angular,
        };
        let thrust = ThrustModel {
            hover_n: self.weight(),
            max_n: parameters.quadrotor.max_thrust_n,
        };
        let (collective, angular) =
            self.autopilot
                .update(&parameters.autopilot, &self.command, &estimate, &thrust);
        let torque = Vector3::from(parameters.quadrotor.inertia_kg_m2).component_mul(&angular);
        self.mixer.allocate(collective, &torque)
    }

    /// Growth and pressure follow their setpoints.
    fn actuate_arm(&mut self, configuration: &Configuration, period: f64) {
        let arm = &self.parameters.arm;
        // Speed towards the target, limited by the motor and so that it does not overshoot.
        let wanted = ((configuration.length_m - self.arm.length_m) / (2.0 * arm.growth_time_constant_s))
            .clamp(-arm.max_growth_rate_m_s, arm.max_growth_rate_m_s);
        let change = (wanted - self.arm.rate_m_s) * (1.0 - (-period / arm.growth_time_constant_s).exp());
        self.arm.acceleration_m_s2 = change / period;
        self.arm.length_m += period * (self.arm.rate_m_s + 0.5 * change);
        self.arm.rate_m_s += change;

        let area = 0.25 * std::f64::consts::PI * arm.diameter_m * arm.diameter_m;
        let tube = self.arm.length_m - self.parameters.quadrotor.clamp_offset_m - arm.tip_offset_m;
        self.pneumatics.step(
            &self.parameters.pneumatics,
            configuration.pressure_kpa,
            area * tube,
            area * self.arm.rate_m_s,
            period,
        );
    }

    /// Link lengths, masses and joints for the present length and pressure.
    fn update_chain(&mut self) {
        let (arm, quadrotor) = (&self.parameters.arm, &self.parameters.quadrotor);
        let links = self.chain.links.len() as f64;
        let tube = self.arm.length_m - quadrotor.clamp_offset_m - arm.tip_offset_m;
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
        self.chain.links.fill(link);
        let beam = arm.corners.at(self.arm.length_m, self.pneumatics.pressure_kpa);
        let joint = Joint {
            stiffness: beam.stiffness_n_m2 / length,
            damping: beam.damping_n_m2_s / length,
            collapse_moment: beam.collapse_moment_n_m,
        };
        self.chain.joints.fill(joint);
        // From the clamp to the middle of the first link there is only half a link that bends.
        self.chain.joints[0] = Joint {
            stiffness: 2.0 * joint.stiffness,
            damping: 2.0 * joint.damping,
            ..joint
        };
        let tip_mass = arm.tip_mass_kg - arm.linear_density_kg_m * tube;
        self.chain.tip.mass_kg = tip_mass + self.parameters.payload.tip_mass_kg;
        self.chain.tip.slider = Some(Slider {
            rest_force: tip_mass * GRAVITY,
            slack_stiffness: 1.0 / beam.slack_m_n,
            stretch_stiffness: 1.0 / beam.stretch_m_n,
            damping: arm.axial_damping_n_s_m,
        });
        self.chain.growth.link_rate = self.arm.rate_m_s / links;
        self.chain.growth.link_acceleration = self.arm.acceleration_m_s2 / links;
    }

    fn observe(&mut self) -> Observation {
        let (quadrotor, end_effector) = self.mocap.frame(&self.parameters.mocap, &mut self.sensor_random);
        Observation {
            t_s: self.time_s(),
            quadrotor,
            end_effector,
        }
    }

    fn check(&self, configuration: &Configuration) -> Result<(), VehicleError> {
        let [low, high] = self.parameters.arm.length_range_m;
        let highest = self.parameters.pneumatics.max_pressure_kpa;
        let refuse = |what: String| Err(VehicleError::Refused { what });
        if !(low..=high).contains(&configuration.length_m) {
            return refuse(format!(
                "length {} m, expected {low} to {high} m",
                configuration.length_m
            ));
        }
        if !(0.0..=highest).contains(&configuration.pressure_kpa) {
            return refuse(format!(
                "pressure {} kPa, expected 0 to {highest} kPa",
                configuration.pressure_kpa
            ));
        }
        Ok(())
    }
}

/// A chain with everything that neither length nor pressure changes.
fn empty_chain(parameters: &VehicleParameters) -> Chain {
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
                collapse_moment: f64::INFINITY
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

impl Vehicle for SimulatedVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        self.check(&configuration)?;
        self.restart(configuration, seed);
        Ok(self.observe())
    }

    fn step(&mut self, command: [f64; 3], configuration: Configuration) -> Result<Observation, VehicleError> {
        self.check(&configuration)?;
        if command.iter().any(|c| !c.is_finite()) {
            return Err(VehicleError::Refused {
                what: format!("command {command:?}, expected three finite numbers"),
            });
        }
        let arrival = self.time_s() + self.parameters.autopilot.command_delay_s;
        self.pending.push_back((arrival, command.into()));
        for _ in 0..(DT / self.parameters.autopilot.rate_period_s).round() as usize {
            self.period(&configuration);
        }
        if !self.state.is_finite() {
            return Err(VehicleError::Diverged {
                t_s: self.time_s(),
                what: "a position or velocity is not finite".to_owned(),
            });
        }
        Ok(self.observe())
    }
}
