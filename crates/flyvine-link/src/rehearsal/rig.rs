//! The whole vehicle's end of the wires under one clock: physics, autopilot, motion capture and arm, with scripted faults.
//!
//! Pure: time is told, bytes go in and out. [`super::virtual_station`] flies it in no time, [`super::serve`] over sockets.
//!
//! On the ground the vehicle stands on a platform as high as the arm hangs, wherever it lands: the physics know neither
//! ground nor folding arms. Its clock stands still there, as nothing moves.

use flyvine::DT;
use flyvine::flight::{Configuration, Pose};
use flyvine::link::{Observation, Vehicle, VehicleError};
use flyvine::sim::SimulatedVehicle;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::fault::{FaultClock, FaultKind, Phase, Script};
use super::px4::SimulatedPx4;
use super::px4_telemetry::Sensed;
use crate::autopilot::{ArmTelemetry, GROWTH_MAX_M_S, LatestPoses, SigningKey, Stamped};

/// Period of physics and autopilot, s.
pub const PERIOD_S: f64 = 0.005;
/// Periods from one frame of motion capture to the next: 100 Hz.
const MOCAP_PERIODS: u64 = 2;
/// Periods from one word of the arm to the next: 50 Hz.
const ARM_PERIODS: u64 = 4;
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
    growth_m_s: f64,
    arm_heard_s: f64,
    flying: bool,
    lifted: bool,
    periods: u64,
    now_s: f64,
    seen: Observation,
    latest: LatestPoses,
    to_autopilot: Vec<InFlight>,
    to_base: Vec<InFlight>,
    armed_setpoint: Option<[f64; 3]>,
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
            vehicle.step(platform, configuration)?;
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
            growth_m_s: 0.0,
            arm_heard_s: 0.0,
            flying: false,
            lifted: false,
            periods: 0,
            now_s: 0.0,
            seen,
            latest: LatestPoses::default(),
            to_autopilot: Vec::new(),
            to_base: Vec::new(),
            armed_setpoint: None,
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

    /// The newest poses of motion capture.
    pub fn latest_poses(&self) -> LatestPoses {
        self.latest
    }

    /// The newest word of the arm.
    pub fn arm_telemetry(&self) -> ArmTelemetry {
        ArmTelemetry {
            heard_s: self.arm_heard_s,
            length_m: Some(self.configuration.length_m),
            fault: self.has(FaultKind::ArmFault).then_some(1),
        }
    }

    /// Growth rate, m/s, and pressure, kPa, from the base station.
    pub fn command_arm(&mut self, growth_m_s: f64, pressure_kpa: f64) {
        if self.has(FaultKind::BaseKilled) || !(growth_m_s.is_finite() && pressure_kpa.is_finite()) {
            return;
        }
        self.growth_m_s = growth_m_s.clamp(-GROWTH_MAX_M_S, GROWTH_MAX_M_S);
        self.configuration.pressure_kpa = pressure_kpa;
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
        let arm_speaks = !self.has(FaultKind::ArmSilent) && !self.has(FaultKind::VehicleKilled);
        if self.periods.is_multiple_of(ARM_PERIODS) && arm_speaks {
            self.arm_heard_s = now_s;
        }
        Ok(())
    }

    /// One period of the physics, unless the vehicle stands.
    fn fly(&mut self) -> Result<(), VehicleError> {
        let position = self.vehicle.truth().quadrotor.position;
        let ground_m = platform_m(self.configuration);
        let target = self.px4.target();
        match target {
            Some(target) if target[2] > position[2] + LIFT_M => self.flying = true,
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
        let [low, high] = self.vehicle.parameters().arm.length_range_m;
        let length_m = self.configuration.length_m + self.growth_m_s * PERIOD_S;
        self.configuration.length_m = length_m.clamp(low, high);
        // Without motors it falls; as far as this physics can fall.
        let [x, y, z] = position;
        let command = target.unwrap_or([x, y, z - FALL_M]);
        self.seen = self.vehicle.advance(command, self.configuration, PERIOD_S)?;
        Ok(())
    }

    /// A frame of motion capture, with its faults.
    fn capture(&mut self) {
        if self.has(FaultKind::MocapStale) || self.has(FaultKind::VehicleKilled) {
            return;
        }
        let captured_s = self.now_s;
        if self.has(FaultKind::MocapFrozen) {
            let again = |stamp: &mut f64| *stamp = captured_s;
            self.latest
                .quadrotor
                .iter_mut()
                .for_each(|pose| again(&mut pose.captured_s));
            self.latest
                .end_effector
                .iter_mut()
                .for_each(|tip| again(&mut tip.captured_s));
            return;
        }
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
            quadrotor
                .iter_mut()
                .for_each(|pose: &mut Pose| pose.position[2] = f64::NAN);
        }
        if let Some(value) = quadrotor {
            self.latest.quadrotor = Some(Stamped { value, captured_s });
        }
        if let Some(value) = tip {
            self.latest.end_effector = Some(Stamped { value, captured_s });
        }
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
