//! The simulated vehicle: physics, flight controller, arm actuation and motion capture in lockstep.

use super::arm::{Arm, empty_chain};
use super::autopilot::mixer::Mixer;
use super::autopilot::position::{PositionCommand, ThrustModel};
use super::autopilot::{Autopilot, Estimate};
use super::chain::{Chain, Load};
use super::contact::{self, Ball};
use super::integrator::{LinearlyImplicit, STAGE};
use super::mocap::{Mocap, MocapFaults, Scene, pose};
use super::parameters::{ParameterError, VehicleParameters};
use super::state::ChainState;
use super::wind::Gust;
use crate::flight::{Configuration, Pose};
use crate::link::{Observation, Setpoint, Vehicle, VehicleError};
use crate::{DT, GRAVITY};
use nalgebra::{UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// Position at which a flight starts, m.
const START: Vector3<f64> = Vector3::new(0.0, 0.0, 1.5);
/// How long the vehicle hovers before the flight starts where wind has to be trimmed, s.
const SETTLING_S: f64 = 10.0;
/// Random streams of one seed: for the sensors, the air and the radio, so that none shifts the others.
const SENSOR_STREAM: u64 = 0;
const WIND_STREAM: u64 = 1;
const RADIO_STREAM: u64 = 2;

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
    arm: Arm,
    gust: Gust,
    mocap: Mocap,
    ball: Option<Ball>,
    sensor_random: ChaCha8Rng,
    wind_random: ChaCha8Rng,
    radio_random: ChaCha8Rng,
    /// Commands that have not reached the autopilot yet, with their time of arrival, s.
    pending: VecDeque<(f64, PositionCommand)>,
    command: PositionCommand,
    /// Commands lost since the reset.
    lost_commands: usize,
    /// Rate-loop periods since the reset.
    tick: u64,
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
    /// Commands lost on their way since the reset.
    pub lost_commands: usize,
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
        let configuration = Configuration {
            length_m,
            pressure_kpa: 0.0,
        };
        let mut wind_random = ChaCha8Rng::seed_from_u64(0);
        let gust = Gust::stationary(&parameters.wind, &mut wind_random);
        let mut vehicle = SimulatedVehicle {
            chain: empty_chain(&parameters),
            mixer,
            state: ChainState::hanging(START, links),
            integrator: LinearlyImplicit::new(links),
            autopilot: Autopilot::hovering(&parameters.autopilot, 0.0),
            motors: [0.0; 4],
            arm: Arm::at(&configuration),
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
            radio_random: ChaCha8Rng::seed_from_u64(0),
            pending: VecDeque::with_capacity(64),
            command: PositionCommand::at(START),
            lost_commands: 0,
            tick: 0,
            parameters,
        };
        vehicle.restart(configuration, 0);
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
            configuration: self.arm.configuration(),
            ball: self.ball.map(|ball| ball.position.into()),
            mocap_faults: self.mocap.faults,
            lost_commands: self.lost_commands,
        }
    }

    /// Thrust that holds the weight, N.
    fn weight(&self) -> f64 {
        (self.parameters.quadrotor.total_mass_kg + self.parameters.payload.tip_mass_kg) * GRAVITY
    }

    /// Hover at rest: the arm straight down, the motors holding the weight, nothing pending.
    fn restart(&mut self, configuration: Configuration, seed: u64) {
        let links = self.parameters.simulation.links;
        self.arm = Arm::at(&configuration);
        self.state.copy_from(&ChainState::hanging(START, links));
        self.integrator.reset();
        self.autopilot = Autopilot::hovering(&self.parameters.autopilot, self.weight());
        self.motors = [0.25 * self.weight(); 4];
        self.sensor_random = ChaCha8Rng::seed_from_u64(seed);
        self.sensor_random.set_stream(SENSOR_STREAM);
        self.wind_random = ChaCha8Rng::seed_from_u64(seed);
        self.wind_random.set_stream(WIND_STREAM);
        self.radio_random = ChaCha8Rng::seed_from_u64(seed);
        self.radio_random.set_stream(RADIO_STREAM);
        self.gust = Gust::stationary(&self.parameters.wind, &mut self.wind_random);
        self.pending.clear();
        self.command = PositionCommand::at(START);
        self.lost_commands = 0;
        self.tick = 0;
        self.arm.shape(&self.parameters, &mut self.chain);
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
        self.arm.step(&self.parameters, configuration, period);
        self.arm.shape(&self.parameters, &mut self.chain);

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
        self.mocap.watch(&self.parameters.mocap, self.scene());
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

    fn observe(&mut self) -> Observation {
        let (quadrotor, end_effector) = self.mocap.frame(&self.parameters.mocap, &mut self.sensor_random);
        Observation {
            t_s: self.time_s(),
            quadrotor,
            end_effector,
        }
    }

    /// Like a step of [`Vehicle`], but for `duration_s`, rounded to periods of the rate loop: for a vehicle whose commands
    /// and poses come and go at other times than [`DT`].
    pub fn advance(
        &mut self,
        setpoint: impl Into<Setpoint>,
        configuration: Configuration,
        duration_s: f64,
    ) -> Result<Observation, VehicleError> {
        self.check(&configuration)?;
        let setpoint = setpoint.into();
        if !setpoint.is_finite() {
            return Err(VehicleError::Refused {
                what: format!("{setpoint:?}, expected finite numbers"),
            });
        }
        let autopilot = &self.parameters.autopilot;
        if self.radio_random.random::<f64>() < autopilot.command_dropout_probability {
            self.lost_commands += 1;
        } else {
            let command = PositionCommand {
                position: setpoint.position.into(),
                velocity: setpoint.velocity.unwrap_or_default().into(),
            };
            let arrival = self.time_s() + autopilot.command_delay_s;
            self.pending.push_back((arrival, command));
        }
        for _ in 0..(duration_s / self.parameters.autopilot.rate_period_s).round() as usize {
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

impl Vehicle for SimulatedVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        self.check(&configuration)?;
        self.restart(configuration, seed);
        Ok(self.observe())
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        self.advance(setpoint, configuration, DT)
    }
}
