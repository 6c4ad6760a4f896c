//! What the link needs of the arm: two numbers out, how it is back.

use flyvine::DT;
use flyvine::flight::Configuration;
use vine_arm::{Request, Setpoint, State, Telemetry};

use crate::arm::Arm;

/// What the arm's controller says of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmTelemetry {
    /// When it was last heard, s on the link's clock; −∞ before that.
    pub heard_s: f64,
    /// Length from its own estimate, m; `None` of an arm that has none.
    pub length_m: Option<f64>,
    /// Gauge pressure, kPa; `None` of an arm without a sensor.
    pub pressure_kpa: Option<f64>,
    /// The growth rate that its motor is asked for, m/s.
    pub growth_m_s: f64,
    /// What it is doing; `None` before it was heard.
    pub state: Option<State>,
}

impl ArmTelemetry {
    /// Its own number for what is wrong with it.
    pub fn fault(&self) -> Option<u8> {
        match self.state {
            Some(state @ State::Fault(_)) => Some(state.code()),
            _ => None,
        }
    }
}

/// The line to the arm. None of it waits.
pub trait ArmLink {
    /// Readies the arm for a flight that begins in `configuration`: one that was told to stop takes set-points again, one that
    /// cannot measure its length is told it.
    fn prepare(&mut self, now_s: f64, configuration: Configuration);

    /// Sends the growth rate, m/s (signed), and the pressure set-point, kPa gauge.
    fn command(&mut self, now_s: f64, growth_m_s: f64, pressure_kpa: f64);

    /// The newest telemetry; `None` where there is no arm on the wire.
    fn telemetry(&mut self, now_s: f64) -> Option<ArmTelemetry>;
}

/// No arm on the wire: one that is set by hand, or that another program drives.
pub struct NoArm;

impl ArmLink for NoArm {
    fn prepare(&mut self, _now_s: f64, _configuration: Configuration) {}

    fn command(&mut self, _now_s: f64, _growth_m_s: f64, _pressure_kpa: f64) {}

    fn telemetry(&mut self, _now_s: f64) -> Option<ArmTelemetry> {
        None
    }
}

/// Time between two questions to an arm that has not answered, s.
const ASK_S: f64 = 0.1;

/// An arm at an address of [`crate::arm`]. A line that fails is silent, and silence is for the supervisor to judge.
pub struct WiredArm {
    arm: Box<dyn Arm>,
    asked_s: f64,
    /// The length to tell it, m, once it answers and if it knows none.
    tell_length_m: Option<f64>,
}

impl WiredArm {
    /// An arm on a line that is open.
    pub fn new(arm: Box<dyn Arm>) -> Self {
        Self {
            arm,
            asked_s: f64::NEG_INFINITY,
            tell_length_m: None,
        }
    }

    /// What is still to be asked, once the last question is answered.
    fn go_on_preparing(&mut self, now_s: f64, telemetry: Option<Telemetry>) {
        let (Some(length_m), Some(telemetry)) = (self.tell_length_m, telemetry) else {
            return;
        };
        if telemetry.state == State::Stopped {
            // Refused, as older than what another host has just asked.
            if now_s >= self.asked_s + ASK_S {
                self.ask(now_s, Request::Resume);
            }
            return;
        }
        self.tell_length_m = None;
        if telemetry.length_m.is_none() {
            self.ask(now_s, Request::SetLength(length_m as f32));
        }
    }

    fn ask(&mut self, now_s: f64, request: Request) {
        self.asked_s = now_s;
        let _ = self.arm.ask(now_s, request);
    }
}

impl ArmLink for WiredArm {
    fn prepare(&mut self, now_s: f64, configuration: Configuration) {
        self.tell_length_m = Some(configuration.length_m);
        self.ask(now_s, Request::Resume);
    }

    fn command(&mut self, now_s: f64, growth_m_s: f64, pressure_kpa: f64) {
        let setpoint = Setpoint {
            growth_rate_m_s: growth_m_s as f32,
            pressure_kpa: pressure_kpa as f32,
        };
        let _ = self.arm.send(now_s, setpoint);
    }

    fn telemetry(&mut self, now_s: f64) -> Option<ArmTelemetry> {
        let _ = self.arm.poll(now_s);
        let status = self.arm.status(now_s);
        let telemetry = status.telemetry;
        match status.asked {
            // Set-points carry the question too, but there are none before the flight.
            Some(request) if now_s >= self.asked_s + ASK_S => self.ask(now_s, request),
            Some(_) => (),
            None => self.go_on_preparing(now_s, telemetry),
        }
        Some(ArmTelemetry {
            heard_s: telemetry.map_or(f64::NEG_INFINITY, |_| now_s - status.silence_s),
            length_m: telemetry.and_then(|telemetry| telemetry.length_m).map(f64::from),
            pressure_kpa: telemetry
                .and_then(|telemetry| telemetry.pressure_kpa)
                .map(f64::from),
            growth_m_s: telemetry.map_or(0.0, |telemetry| f64::from(telemetry.growth_rate_m_s)),
            state: telemetry.map(|telemetry| telemetry.state),
        })
    }
}

/// Fastest growth, m/s.
pub const GROWTH_MAX_M_S: f64 = 0.02;
/// Time in which an error of the length is taken back, s.
const LENGTH_TIME_S: f64 = 0.5;
/// An error of the length that is left alone, m.
const LENGTH_DEADBAND_M: f64 = 0.002;

/// The growth rate that takes the arm from the configuration it is told now to the next one, and what its measured length
/// lacks: `ṡ = (l⁺ − l) / dt + (l − l_measured) / T`, within ± 2 cm/s.
pub fn growth_rate(now: Configuration, next: Configuration, measured_m: Option<f64>) -> f64 {
    let planned = (next.length_m - now.length_m) / DT;
    let error_m = measured_m.map_or(0.0, |measured_m| now.length_m - measured_m);
    let correction = match error_m.abs() > LENGTH_DEADBAND_M {
        true => error_m / LENGTH_TIME_S,
        false => 0.0,
    };
    let rate = planned + correction;
    match rate.is_finite() {
        true => rate.clamp(-GROWTH_MAX_M_S, GROWTH_MAX_M_S),
        false => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::io::{ErrorKind, Read, Write};
    use std::rc::Rc;

    use vine_arm::{Device, Limits, Sensors};

    use super::*;
    use crate::arm::FramedArm;

    /// The firmware's device at the other end of a line; the first frames are lost.
    struct Line(Rc<RefCell<(Device, Vec<u8>)>>, u32);

    impl Read for Line {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            let said = std::mem::take(&mut self.0.borrow_mut().1);
            buffer[..said.len()].copy_from_slice(&said);
            (!said.is_empty())
                .then_some(said.len())
                .ok_or(ErrorKind::WouldBlock.into())
        }
    }

    impl Write for Line {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            if self.1 > 0 {
                self.1 -= 1;
                return Ok(bytes.len());
            }
            let (device, said) = &mut *self.0.borrow_mut();
            device.receive(bytes, |frame| said.extend_from_slice(frame));
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn an_arm_that_was_stopped_and_knows_no_length_is_readied_for_a_flight() {
        let mut device = Device::new(Limits::default()).unwrap();
        let stop = vine_arm::Frame {
            sequence: 7,
            message: vine_arm::Message::Request(Request::Stop),
        };
        device.receive(&stop.encode(), |_| ());
        let end = Rc::new(RefCell::new((device, Vec::new())));
        let mut arm = WiredArm::new(Box::new(FramedArm::new(Line(Rc::clone(&end), 2), 0.0)));
        assert_eq!(arm.telemetry(0.0).unwrap().heard_s, f64::NEG_INFINITY);
        let start = Configuration {
            length_m: 0.7,
            pressure_kpa: 0.0,
        };
        arm.prepare(0.0, start);
        let turn = |arm: &mut WiredArm, k: u32| {
            {
                let (device, said) = &mut *end.borrow_mut();
                device.step(5_000, Sensors::default(), |frame| said.extend_from_slice(frame));
            }
            arm.telemetry(0.005 * f64::from(k)).unwrap()
        };
        let readied = (1..400).map(|k| turn(&mut arm, k)).last().unwrap();
        assert_eq!(readied.state, Some(State::Waiting), "no longer stopped");
        assert_eq!(readied.length_m, Some(f64::from(0.7_f32)), "told");
        arm.command(2.0, 0.01, 0.1);
        let growing = (400..440).map(|k| turn(&mut arm, k)).last().unwrap();
        assert_eq!((growing.state, growing.fault()), (Some(State::Active), None));
        assert!(growing.length_m > readied.length_m);
    }

    #[test]
    fn growth_follows_the_plan_and_what_is_missing_within_its_limit() {
        let at = |length_m| Configuration {
            length_m,
            pressure_kpa: 0.0,
        };
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(near(growth_rate(at(0.7), at(0.7005), Some(0.7)), 0.01));
        assert!(near(growth_rate(at(0.7), at(0.7005), Some(0.696)), 0.018));
        assert!(near(growth_rate(at(0.7), at(0.7), Some(0.9)), -GROWTH_MAX_M_S));
        assert_eq!(growth_rate(at(0.7), at(0.7), None), 0.0);
        assert_eq!(growth_rate(at(0.7), at(0.7), Some(f64::NAN)), 0.0);
    }
}
