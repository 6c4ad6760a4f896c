//! The prototype's serial line: `g<number>` sets the growth rate, `p<number>` the pressure; nothing comes back.
//!
//! Terminator, range and units were never published, so they are options. What the old arm lacks is added here: its
//! set-points go through the same [`Device`] that new firmware runs, which refuses what is out of range, reckons the
//! length (once it has been set) against the end stops, and sends `g0` and `p0` when the host falls silent. That
//! watchdog runs in this process, not in the arm: if the process dies, the old arm goes on with its last command.

use std::io::{ErrorKind, Write};

use vine_arm::{Device, Limits, LimitsError, Request, Sensors, Setpoint, State};

use super::client::{ArmClient, ArmStatus};
use super::{Arm, ArmError, check_finite};

/// What ends a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Terminator {
    /// Nothing.
    None,
    /// `\n`.
    LineFeed,
    /// `\r`.
    CarriageReturn,
    /// `\r\n`.
    Both,
}

impl Terminator {
    fn text(self) -> &'static str {
        match self {
            Terminator::None => "",
            Terminator::LineFeed => "\n",
            Terminator::CarriageReturn => "\r",
            Terminator::Both => "\r\n",
        }
    }
}

/// How an old arm wants its numbers. The defaults are a guess (cm/s and kPa, a line each): try them on a bench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LegacyOptions {
    /// What ends a command.
    pub terminator: Terminator,
    /// The number for a growth rate of 1 m/s.
    pub growth_per_m_s: f64,
    /// Greatest number after `g`, either way.
    pub greatest_growth: f64,
    /// The number for a pressure of 1 kPa.
    pub pressure_per_kpa: f64,
    /// Greatest number after `p`.
    pub greatest_pressure: f64,
    /// Digits after the decimal point.
    pub decimals: usize,
    /// What the arm may do.
    pub limits: Limits,
}

impl Default for LegacyOptions {
    fn default() -> Self {
        LegacyOptions {
            terminator: Terminator::LineFeed,
            growth_per_m_s: 100.0,
            greatest_growth: 7.0,
            pressure_per_kpa: 1.0,
            greatest_pressure: 2.0,
            decimals: 3,
            limits: Limits::default(),
        }
    }
}

/// Options that are none.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LegacyOptionsError {
    /// A number that is not positive and finite, or too many decimals.
    #[error("legacy arm: {name} is {found}; expected {expected}")]
    Value {
        /// The option.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// The greatest set-point would not fit.
    #[error(
        "legacy arm: the greatest {what} would be the number {number}; the line takes at most {greatest}"
    )]
    Range {
        /// Growth rate or pressure.
        what: &'static str,
        /// The number for the arm's limit.
        number: f64,
        /// The line's limit.
        greatest: f64,
    },
    /// Impossible limits.
    #[error("legacy arm: {0}")]
    Limits(#[from] LimitsError),
}

impl LegacyOptions {
    fn validate(&self) -> Result<(), LegacyOptionsError> {
        for (name, found) in [
            ("growth_per_m_s", self.growth_per_m_s),
            ("greatest_growth", self.greatest_growth),
            ("pressure_per_kpa", self.pressure_per_kpa),
            ("greatest_pressure", self.greatest_pressure),
        ] {
            if !(found.is_finite() && found > 0.0) {
                let expected = "a positive number";
                return Err(LegacyOptionsError::Value {
                    name,
                    found,
                    expected,
                });
            }
        }
        if self.decimals > 9 {
            return Err(LegacyOptionsError::Value {
                name: "decimals",
                found: self.decimals as f64,
                expected: "at most 9",
            });
        }
        let limits = &self.limits;
        for (what, number, greatest) in [
            (
                "growth rate",
                f64::from(limits.max_growth_rate_m_s) * self.growth_per_m_s,
                self.greatest_growth,
            ),
            (
                "pressure",
                f64::from(limits.max_pressure_kpa) * self.pressure_per_kpa,
                self.greatest_pressure,
            ),
        ] {
            // A limit is a 32-bit number: 0.02 is 0.0199999996.
            if number > greatest * (1.0 + 1e-6) {
                return Err(LegacyOptionsError::Range {
                    what,
                    number,
                    greatest,
                });
            }
        }
        Ok(())
    }

    /// Both commands.
    fn commands(&self, growth_rate_m_s: f32, pressure_kpa: f32) -> String {
        let growth = f64::from(growth_rate_m_s) * self.growth_per_m_s;
        let pressure = f64::from(pressure_kpa) * self.pressure_per_kpa;
        let (decimals, end) = (self.decimals, self.terminator.text());
        // Adding zero turns -0 into 0.
        format!(
            "g{:.decimals$}{end}p{:.decimals$}{end}",
            growth + 0.0,
            pressure + 0.0
        )
    }
}

/// An old arm made to look like a new one: frames of [`vine_arm`]'s protocol in, ASCII commands out.
#[derive(Debug, Clone)]
pub struct LegacyDevice {
    device: Device,
    options: LegacyOptions,
}

impl LegacyDevice {
    /// A device at power-up.
    pub fn new(options: LegacyOptions) -> Result<LegacyDevice, LegacyOptionsError> {
        options.validate()?;
        let device = Device::new(options.limits)?;
        Ok(LegacyDevice { device, options })
    }

    /// Takes bytes of the protocol and hands the answers to `send`.
    pub fn receive(&mut self, bytes: &[u8], send: impl FnMut(&[u8])) {
        self.device.receive(bytes, send);
    }

    /// Advances by `dt_us`, hands telemetry to `send`, and gives the commands for the arm's line.
    pub fn step(&mut self, dt_us: u32, send: impl FnMut(&[u8])) -> String {
        // Nothing is measured on an old arm.
        self.device.step(dt_us, Sensors::default(), send);
        let controller = self.device.controller();
        self.options
            .commands(controller.growth_rate_m_s(), controller.pressure_setpoint_kpa())
    }

    /// State or fault.
    pub fn state(&self) -> State {
        self.device.controller().state()
    }
}

/// An old arm on a line that never blocks.
#[derive(Debug)]
pub struct LegacyArm<L> {
    line: L,
    device: LegacyDevice,
    client: ArmClient,
    setpoint: Setpoint,
    stepped_s: f64,
}

impl<L: Write> LegacyArm<L> {
    /// An arm on a line that is open already.
    pub fn new(line: L, options: LegacyOptions, now_s: f64) -> Result<LegacyArm<L>, LegacyOptionsError> {
        Ok(LegacyArm {
            line,
            device: LegacyDevice::new(options)?,
            client: ArmClient::new(now_s),
            setpoint: Setpoint::default(),
            stepped_s: now_s,
        })
    }

    fn request(&mut self, now_s: f64) -> Result<(), ArmError> {
        let frame = self.client.tick(now_s, self.setpoint);
        let client = &mut self.client;
        self.device
            .receive(&frame, |answer| client.receive(now_s, answer));
        self.step(now_s)
    }

    fn step(&mut self, now_s: f64) -> Result<(), ArmError> {
        let elapsed_us = ((now_s - self.stepped_s) * 1e6) as u32;
        if elapsed_us == 0 {
            return Ok(());
        }
        self.stepped_s = now_s;
        let client = &mut self.client;
        let commands = self.device.step(elapsed_us, |frame| client.receive(now_s, frame));
        match self.line.write(commands.as_bytes()) {
            // Commands that a full line does not take come again at the next tick.
            Ok(_) => Ok(()),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

impl<L: Write> Arm for LegacyArm<L> {
    fn send(&mut self, now_s: f64, setpoint: Setpoint) -> Result<(), ArmError> {
        check_finite(&Request::Setpoint(setpoint))?;
        self.setpoint = setpoint;
        self.request(now_s)
    }

    fn ask(&mut self, now_s: f64, request: Request) -> Result<(), ArmError> {
        check_finite(&request)?;
        self.client.ask(request);
        self.request(now_s)
    }

    fn poll(&mut self, now_s: f64) -> Result<(), ArmError> {
        self.step(now_s)
    }

    fn status(&self, now_s: f64) -> ArmStatus {
        ArmStatus {
            silence_s: 0.0,
            ..self.client.status(now_s)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setpoint(growth_rate_m_s: f32, pressure_kpa: f32) -> Setpoint {
        Setpoint {
            growth_rate_m_s,
            pressure_kpa,
        }
    }

    /// An arm on a `Vec`, whose length has been set.
    fn arm(options: LegacyOptions) -> LegacyArm<Vec<u8>> {
        let mut arm = LegacyArm::new(Vec::new(), options, 0.0).unwrap();
        arm.ask(0.05, Request::SetLength(0.8)).unwrap();
        arm.line.clear();
        arm
    }

    fn written(arm: &mut LegacyArm<Vec<u8>>) -> String {
        String::from_utf8(std::mem::take(&mut arm.line)).unwrap()
    }

    #[test]
    fn commands_are_the_prototype_s() {
        let mut arm = arm(LegacyOptions::default());
        arm.send(0.1, setpoint(-0.0125, 0.4)).unwrap();
        assert_eq!(written(&mut arm), "g-1.250\np0.400\n");
        let options = LegacyOptions {
            terminator: Terminator::Both,
            growth_per_m_s: 350.0,
            decimals: 0,
            ..LegacyOptions::default()
        };
        let mut arm = self::arm(options);
        arm.send(0.1, setpoint(0.02, 1.0)).unwrap();
        assert_eq!(written(&mut arm), "g7\r\np1\r\n");
    }

    #[test]
    fn silence_of_the_host_stops_an_old_arm() {
        let mut arm = arm(LegacyOptions::default());
        arm.send(0.1, setpoint(0.01, 0.4)).unwrap();
        for tick in 1..=6 {
            arm.line.clear();
            arm.poll(0.1 + 0.05 * f64::from(tick)).unwrap();
        }
        assert_eq!(written(&mut arm), "g0.000\np0.000\n");
        assert_eq!(arm.status(0.4).telemetry.unwrap().state, State::Silent);
    }

    #[test]
    fn a_stop_and_an_end_stop_hold_an_old_arm_too() {
        let mut arm = arm(LegacyOptions::default());
        let mut now_s = 0.1;
        for _ in 0..400 {
            arm.send(now_s, setpoint(0.02, 0.4)).unwrap();
            now_s += 0.05;
        }
        // 20 s at 2 cm/s would be 0.4 m; the end stop was 0.3 m away.
        assert!(written(&mut arm).ends_with("g0.000\np0.400\n"));
        let length = arm.status(now_s).telemetry.unwrap().length_m.unwrap();
        assert!((length - 1.1).abs() < 1e-3, "{length}");
        arm.ask(now_s, Request::Stop).unwrap();
        assert!(written(&mut arm).ends_with("g0.000\np0.000\n"));
    }

    #[test]
    fn growth_before_the_length_is_known_is_refused() {
        let mut arm = LegacyArm::new(Vec::new(), LegacyOptions::default(), 0.0).unwrap();
        arm.send(0.05, setpoint(0.01, 0.4)).unwrap();
        assert_eq!(written(&mut arm), "g0.000\np0.000\n");
        assert_eq!(arm.status(0.05).refusal, Some(vine_arm::Refusal::LengthUnknown));
        assert!(matches!(
            arm.send(0.1, setpoint(f32::NAN, 0.0)),
            Err(ArmError::NotFinite(_))
        ));
    }

    #[test]
    fn options_that_cannot_be_are_named() {
        let spoilt = |spoil: fn(&mut LegacyOptions)| {
            let mut options = LegacyOptions::default();
            spoil(&mut options);
            LegacyDevice::new(options).unwrap_err().to_string()
        };
        assert!(spoilt(|o| o.growth_per_m_s = f64::NAN).contains("growth_per_m_s"));
        assert!(spoilt(|o| o.growth_per_m_s = 400.0).contains("greatest growth rate would be the number"));
        assert!(spoilt(|o| o.decimals = 10).contains("decimals"));
        assert!(spoilt(|o| o.limits.watchdog_s = 1.0).contains("watchdog_s"));
    }
}
