//! The whole vehicle's end of the wires under one clock: physics, autopilot, motion capture and arm, with scripted faults.
//!
//! Pure: time is told, bytes go in and out. [`super::virtual_station`] flies it in no time, [`super::serve`] over sockets.
//!
//! On the ground the vehicle stands on a platform as high as the arm hangs, wherever it lands: the physics know neither
//! ground nor folding arms. Its clock stands still there, as nothing moves.

use flyvine::DT;
use flyvine::flight::Configuration;
use flyvine::link::{Observation, Vehicle, VehicleError};
use flyvine::sim::{SimulatedVehicle, VehicleParameters};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::arm_end::ArmEnd;
use super::fault::{FaultClock, FaultKind, Phase, Script};
use super::px4::SimulatedPx4;
use super::px4_telemetry::Sensed;
use crate::autopilot::SigningKey;
use crate::mocap::{Bodies, BodyPose, Frame};

/// Name of the quadrotor's body in motion capture.
const QUADROTOR: &str = "drone";
/// Name of the end effector's.
const END_EFFECTOR: &str = "tip";

/// The bodies that a rig shows to motion capture, for the base station.
pub fn rig_bodies() -> Bodies {
    Bodies::named(QUADROTOR, END_EFFECTOR)
}

/// Period of physics and autopilot, s: its rate loop's, so that a set-point waits no longer than it must.
pub const PERIOD_S: f64 = 0.0025;
/// Periods from one frame of motion capture to the next: 100 Hz.
const MOCAP_PERIODS: u64 = 4;
/// How far the tip hangs above the floor when the vehicle stands, m.
const TIP_CLEARANCE_M: f64 = 0.05;
/// A target this far above a standing vehicle lifts it off, m.
const LIFT_M: f64 = 0.05;
/// How far below itself a vehicle without motors is drawn, m.
const FALL_M: f64 = 0.6;
/// A set-point this far beside the one at arming is the flight's own, m.
const AWAY_M: f64 = 0.01;
/// How far a jumping body jumps, m.
const JUMP_M: f64 = 1.0;
/// Longest delay of a frame on a link that reorders, s.
const REORDER_S: f64 = 0.08;

/// A frame under way, and when it arrives, s.
struct InFlight {
    arrives_s: f64,
    bytes: Vec<u8>,
}

/// The vehicle's end; see the [module](self).
pub struct Rig {
    vehicle: SimulatedVehicle,
    /// The autopilot.
    pub px4: SimulatedPx4,
    faults: FaultClock,
    random: ChaCha8Rng,
    configuration: Configuration,
    arm: ArmEnd,
    /// What the arm has said, on its way to the base station.
    arm_said: Vec<u8>,
    flying: bool,
    lifted: bool,
    periods: u64,
    now_s: f64,
    seen: Observation,
    /// The newest poses, as motion capture shows them.
    shown: Vec<BodyPose>,
    frames: Vec<Frame>,
    to_autopilot: Vec<InFlight>,
    to_base: Vec<InFlight>,
    armed_setpoint: Option<[f64; 3]>,
    loop_phase_s: f64,
    rebooted: bool,
    taken_over: bool,
}

impl Rig {
    /// A vehicle with its arm in `configuration`, standing under (0, 0), at time 0; `seed` is that of its noise.
    pub fn new(
        mut vehicle: SimulatedVehicle,
        configuration: Configuration,
        seed: u64,
        key: Option<SigningKey>,
        script: Script,
    ) -> Result<Self, VehicleError> {
        vehicle.reset(configuration, seed)?;
        // Down to the platform before anybody looks.
        let platform = [0.0, 0.0, platform_m(configuration)];
        for _ in 0..(SETTLING_S / DT) as usize {
            vehicle.step(platform.into(), configuration)?;
        }
        let seen = vehicle.advance(platform, configuration, 0.0)?;
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(FAULT_STREAM);
        Ok(Self {
            vehicle,
            px4: SimulatedPx4::new(0.0, key),
            faults: FaultClock::new(script),
            random,
            configuration,
            arm: ArmEnd::software(configuration),
            arm_said: Vec::new(),
            flying: false,
            lifted: false,
            periods: 0,
            now_s: 0.0,
            seen,
            shown: Vec::new(),
            frames: Vec::new(),
            to_autopilot: Vec::new(),
            to_base: Vec::new(),
            armed_setpoint: None,
            loop_phase_s: 0.0,
            rebooted: false,
            taken_over: false,
        })
    }

    /// The time that it has reached, s.
    pub fn now_s(&self) -> f64 {
        self.now_s
    }

    /// The script, and where it stands.
    pub fn faults(&self) -> &FaultClock {
        &self.faults
    }

    /// Whether the vehicle stands on the ground.
    pub fn stands(&self) -> bool {
        !self.flying
    }

    /// Time from a run of the vehicle's position loop to the flight's set-points, s, below the loop's period: they wait for the
    /// next run. The clocks of vehicle and base station know nothing of each other, so it is another one in every flight.
    pub fn loop_phase_s(&self) -> f64 {
        self.loop_phase_s
    }

    /// Whether a fault is there now.
    pub fn has(&self, kind: FaultKind) -> bool {
        self.faults.is_active(self.now_s, kind)
    }

    /// Takes bytes from the base station.
    pub fn receive(&mut self, bytes: &[u8]) {
        if self.link_is_down() || self.has(FaultKind::BaseKilled) {
            return;
        }
        let arrives_s = self.now_s + self.delay_s();
        self.to_autopilot.push(InFlight {
            arrives_s,
            bytes: bytes.to_vec(),
        });
    }

    /// The frames that have arrived at the base station since the last call.
    pub fn take_frames(&mut self) -> Vec<Vec<u8>> {
        let now_s = self.now_s;
        arrived(&mut self.to_base, now_s)
    }

    /// The frames of motion capture since the last call, by this clock.
    pub fn take_mocap_frames(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.frames)
    }

    /// Takes bytes from the base station on the arm's line.
    pub fn receive_arm(&mut self, bytes: &[u8]) {
        if !self.has(FaultKind::BaseKilled) && !self.has(FaultKind::VehicleKilled) {
            self.arm.receive(bytes, &mut self.arm_said);
        }
    }

    /// What the arm has said since the last call.
    pub fn take_arm_bytes(&mut self) -> Vec<u8> {
        let said = std::mem::take(&mut self.arm_said);
        match self.has(FaultKind::ArmSilent) || self.has(FaultKind::VehicleKilled) {
            true => Vec::new(),
            false => said,
        }
    }

    /// Puts a board with the firmware in the software arm's place: what it is told and says goes through the rig.
    pub fn use_board(&mut self) {
        self.arm = ArmEnd::board();
    }

    /// Bytes for the board, since the last call.
    pub fn take_for_board(&mut self) -> Vec<u8> {
        self.arm.take_for_board()
    }

    /// Takes what the board has said: the vehicle's arm is as the board's telemetry has it.
    pub fn hear_board(&mut self, bytes: &[u8]) {
        if let Some(configuration) = self.arm.hear_board(bytes) {
            self.set_configuration(configuration);
        }
        self.arm_said.extend_from_slice(bytes);
    }

    /// The arm has another length and pressure, as far as the vehicle can have them.
    fn set_configuration(&mut self, found: Configuration) {
        let parameters = self.vehicle.parameters();
        let [low, high] = parameters.arm.length_range_m;
        let highest_kpa = parameters.pneumatics.max_pressure_kpa;
        self.configuration = Configuration {
            length_m: found.length_m.clamp(low, high),
            pressure_kpa: found.pressure_kpa.clamp(0.0, highest_kpa),
        };
    }

    /// Lets time go on until `time_s`.
    pub fn advance_to(&mut self, time_s: f64) -> Result<(), VehicleError> {
        while (self.periods + 1) as f64 * PERIOD_S <= time_s {
            self.periods += 1;
            self.now_s = self.periods as f64 * PERIOD_S;
            self.period()?;
        }
        self.now_s = time_s.max(self.now_s);
        Ok(())
    }

    fn period(&mut self) -> Result<(), VehicleError> {
        let now_s = self.now_s;
        for bytes in arrived(&mut self.to_autopilot, now_s) {
            self.px4.receive(now_s, &bytes);
        }
        self.follow_script();
        let is_broken = self.has(FaultKind::ArmFault);
        if let Some(configuration) = self.arm.step(PERIOD_S, is_broken, &mut self.arm_said) {
            self.set_configuration(configuration);
        }
        self.fly()?;
        let pose = self.vehicle.truth().quadrotor;
        let sensed = Sensed {
            position: pose.position,
            attitude: pose.attitude,
            on_ground: !self.flying,
        };
        self.px4.tick(now_s, sensed, PERIOD_S);
        for bytes in self.px4.take_frames() {
            if !self.link_is_down() {
                let arrives_s = now_s + self.delay_s();
                self.to_base.push(InFlight { arrives_s, bytes });
            }
        }
        if self.periods.is_multiple_of(MOCAP_PERIODS) {
            self.capture();
        }
        Ok(())
    }

    /// One period of the physics, unless the vehicle stands.
    fn fly(&mut self) -> Result<(), VehicleError> {
        let position = self.vehicle.truth().quadrotor.position;
        let ground_m = platform_m(self.configuration);
        let target = self.px4.target();
        match target {
            Some(target) if target.position[2] > position[2] + LIFT_M => self.flying = true,
            _ => (),
        }
        // It has to leave the ground before it can land.
        self.lifted = self.flying && (self.lifted || position[2] > ground_m + LIFT_M);
        if self.lifted && position[2] <= ground_m || (target.is_none() && !self.lifted) {
            (self.flying, self.lifted) = (false, false);
        }
        if !self.flying {
            self.seen = self.vehicle.advance(position, self.configuration, 0.0)?;
            return Ok(());
        }
        // Without motors it falls; as far as this physics can fall.
        let [x, y, z] = position;
        let command = target.unwrap_or([x, y, z - FALL_M].into());
        self.seen = self.vehicle.advance(command, self.configuration, PERIOD_S)?;
        Ok(())
    }

    /// A frame of motion capture, with its faults.
    fn capture(&mut self) {
        if self.has(FaultKind::MocapStale) || self.has(FaultKind::VehicleKilled) {
            return;
        }
        if !self.has(FaultKind::MocapFrozen) {
            self.show();
        }
        if !self.shown.is_empty() {
            self.frames.push(Frame {
                captured_s: self.now_s,
                sent_s: self.now_s,
                bodies: self.shown.clone(),
            });
        }
    }

    /// What motion capture makes of what it sees.
    fn show(&mut self) {
        let (mut quadrotor, mut tip) = (self.seen.quadrotor, self.seen.end_effector);
        if self.has(FaultKind::MocapSwap)
            && let (Some(pose), Some(tip)) = (&mut quadrotor, &mut tip)
        {
            std::mem::swap(&mut pose.position, tip);
        }
        if self.has(FaultKind::MocapJump) {
            quadrotor.iter_mut().for_each(|pose| pose.position[0] += JUMP_M);
            tip.iter_mut().for_each(|tip| tip[0] += JUMP_M);
        }
        if self.has(FaultKind::MocapNan) {
            quadrotor.iter_mut().for_each(|pose| pose.position[2] = f64::NAN);
        }
        let body = |name: &str, position, attitude| BodyPose {
            name: name.to_owned(),
            position,
            attitude,
            tracked: true,
        };
        // A marker body that is missed is not sent.
        self.shown.clear();
        self.shown
            .extend(quadrotor.map(|pose| body(QUADROTOR, pose.position, pose.attitude)));
        self.shown
            .extend(tip.map(|tip| body(END_EFFECTOR, tip, [1.0, 0.0, 0.0, 0.0])));
    }

    /// Where the flight stands, and what goes wrong then once.
    fn follow_script(&mut self) {
        let setpoint = self.px4.setpoint();
        if self.px4.is_armed() && self.armed_setpoint.is_none() {
            self.armed_setpoint = setpoint;
        }
        let is_away = match (self.armed_setpoint, setpoint) {
            (Some(from), Some(to)) => (to[0] - from[0]).hypot(to[1] - from[1]) > AWAY_M,
            _ => false,
        };
        let phase = match setpoint {
            _ if self.px4.is_landing() => Phase::Land,
            Some(_) if is_away => Phase::Flight,
            Some(_) if self.px4.is_armed() => Phase::TakeOff,
            Some(_) => Phase::PreArm,
            None => Phase::Idle,
        };
        if phase == Phase::Flight && self.faults.phase() != Phase::Flight {
            let period_s = position_period_s(self.vehicle.parameters());
            self.loop_phase_s = self.vehicle.time_s().rem_euclid(period_s);
        }
        self.faults.advance(self.now_s, phase);
        if self.has(FaultKind::AutopilotReboot) && !self.rebooted {
            self.rebooted = true;
            self.px4.reboot(self.now_s);
        }
        if self.has(FaultKind::PilotTakesOver) && !self.taken_over {
            self.taken_over = true;
            self.px4.take_over();
        }
    }

    fn link_is_down(&self) -> bool {
        self.has(FaultKind::LinkLoss) || self.has(FaultKind::VehicleKilled)
    }

    fn delay_s(&mut self) -> f64 {
        match self.has(FaultKind::LinkReorder) {
            true => REORDER_S * self.random.random::<f64>(),
            false => 0.0,
        }
    }
}

/// How long the vehicle settles on its platform before time 0, s.
const SETTLING_S: f64 = 8.0;
/// Random stream of the faults, beside those of the physics.
const FAULT_STREAM: u64 = 7;

/// Period of a vehicle's position loop, s.
pub(super) fn position_period_s(parameters: &VehicleParameters) -> f64 {
    parameters.autopilot.rate_period_s * f64::from(parameters.autopilot.position_divider)
}

/// Height of the quadrotor on its platform, m.
fn platform_m(configuration: Configuration) -> f64 {
    configuration.length_m + TIP_CLEARANCE_M
}

fn arrived(under_way: &mut Vec<InFlight>, now_s: f64) -> Vec<Vec<u8>> {
    let mut here: Vec<InFlight> = under_way
        .extract_if(.., |frame| frame.arrives_s <= now_s)
        .collect();
    here.sort_by(|a, b| a.arrives_s.total_cmp(&b.arrives_s));
    here.into_iter().map(|frame| frame.bytes).collect()
}
