//! The arm's state machine: set-points and readings in, actuators out.

use crate::growth::{Growth, allowed_rate};
use crate::limits::{Limits, LimitsError};
use crate::message::{Refusal, Request, Setpoint};
use crate::pumps::{Air, Pumps};
use crate::state::{Fault, State};
use crate::watch::{SensorWatch, StallWatch};

/// What the board reads. `None` where the arm has no such sensor; one that was there must not go away.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensors {
    /// Length by the spool's encoder, m.
    pub length_m: Option<f32>,
    /// Gauge pressure of the tube, kPa.
    pub pressure_kpa: Option<f32>,
}

/// What the board applies until the next step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Actuators {
    /// Motor duty, −1 (retract) to 1 (grow).
    pub growth_duty: f32,
    /// Pumps and vent.
    pub air: Air,
}

/// The newest accepted request, against which late ones are told.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Newest {
    sequence: u16,
    age_s: f32,
}

/// The controller of one arm: [`request`](Controller::request) whenever one comes, [`step`](Controller::step) at a steady
/// rate, 200 Hz on the board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    limits: Limits,
    state: State,
    setpoint: Setpoint,
    /// Age of the set-point, s.
    setpoint_age_s: Option<f32>,
    newest: Option<Newest>,
    /// Measured, or reckoned from where it was set, m.
    length_m: Option<f32>,
    rate_m_s: f32,
    growth: Growth,
    pumps: Pumps,
    sensors: SensorWatch,
    stall: StallWatch,
}

impl Controller {
    /// A controller at power-up: everything off.
    pub fn new(limits: Limits) -> Result<Controller, LimitsError> {
        limits.validate()?;
        Ok(Controller {
            limits,
            state: State::Waiting,
            setpoint: Setpoint::default(),
            setpoint_age_s: None,
            newest: None,
            length_m: None,
            rate_m_s: 0.0,
            growth: Growth::default(),
            pumps: Pumps::default(),
            sensors: SensorWatch::default(),
            stall: StallWatch::default(),
        })
    }

    /// What the arm may do.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// State or fault.
    pub fn state(&self) -> State {
        self.state
    }

    /// Length estimate, m.
    pub fn length_m(&self) -> Option<f32> {
        self.length_m
    }

    /// Growth rate after the end stops, m/s; zero unless active.
    pub fn growth_rate_m_s(&self) -> f32 {
        self.rate_m_s
    }

    /// Pressure set-point in force, kPa; zero unless active.
    pub fn pressure_setpoint_kpa(&self) -> f32 {
        if self.state == State::Active {
            self.setpoint.pressure_kpa
        } else {
            0.0
        }
    }

    /// Age of the newest accepted set-point, s.
    pub fn setpoint_age_s(&self) -> Option<f32> {
        self.setpoint_age_s
    }

    /// Takes one request, or says why not; a refused one changes nothing.
    ///
    /// A request older than one already accepted is refused (a network may reorder), a repeated one is accepted and
    /// does nothing; both as long as the accepted one is younger than the watchdog's time, so that a host may begin
    /// anew. [`Request::Stop`] is accepted always.
    pub fn request(&mut self, sequence: u16, request: &Request) -> Result<(), Refusal> {
        if *request != Request::Stop
            && let Some(newest) = self.newest
        {
            match sequence.wrapping_sub(newest.sequence) as i16 {
                0 => return Ok(()),
                ..0 => return Err(Refusal::OldSequence),
                _ => {}
            }
        }
        match request {
            Request::Setpoint(setpoint) => self.follow(setpoint)?,
            Request::Stop => {
                // A fault stays one: it already stops everything, and asks for more than a resume.
                if !matches!(self.state, State::Fault(_)) {
                    self.state = State::Stopped;
                }
            }
            Request::Resume => self.resume()?,
            Request::SetLength(length_m) => self.set_length(*length_m)?,
        }
        self.newest = Some(Newest { sequence, age_s: 0.0 });
        Ok(())
    }

    fn follow(&mut self, setpoint: &Setpoint) -> Result<(), Refusal> {
        let Setpoint {
            growth_rate_m_s,
            pressure_kpa,
        } = *setpoint;
        if !growth_rate_m_s.is_finite() {
            return Err(Refusal::GrowthRateNotFinite);
        }
        if growth_rate_m_s.abs() > self.limits.max_growth_rate_m_s {
            return Err(Refusal::GrowthRateOutOfRange);
        }
        if !pressure_kpa.is_finite() {
            return Err(Refusal::PressureNotFinite);
        }
        if !(0.0..=self.limits.max_pressure_kpa).contains(&pressure_kpa) {
            return Err(Refusal::PressureOutOfRange);
        }
        match self.state {
            State::Stopped => return Err(Refusal::Stopped),
            State::Fault(_) => return Err(Refusal::Faulted),
            State::Waiting | State::Active | State::Silent => {}
        }
        if growth_rate_m_s != 0.0 && self.length_m.is_none() {
            return Err(Refusal::LengthUnknown);
        }
        self.state = State::Active;
        self.setpoint = *setpoint;
        self.setpoint_age_s = Some(0.0);
        Ok(())
    }

    fn resume(&mut self) -> Result<(), Refusal> {
        match self.state {
            State::Stopped => self.state = State::Waiting,
            State::Fault(fault) if self.sensors.has_gone(&self.limits, fault) => self.state = State::Waiting,
            State::Fault(_) => return Err(Refusal::FaultPersists),
            State::Waiting | State::Active | State::Silent => {}
        }
        Ok(())
    }

    fn set_length(&mut self, length_m: f32) -> Result<(), Refusal> {
        if !length_m.is_finite() {
            return Err(Refusal::LengthNotFinite);
        }
        if !(self.limits.min_length_m..=self.limits.max_length_m).contains(&length_m) {
            return Err(Refusal::LengthOutOfRange);
        }
        if self.sensors.measures_length() {
            return Err(Refusal::LengthMeasured);
        }
        self.length_m = Some(length_m);
        Ok(())
    }

    /// Advances by `dt_s` with the newest readings, and says what to do for the next `dt_s`.
    pub fn step(&mut self, dt_s: f32, sensors: Sensors) -> Actuators {
        if !(dt_s.is_finite() && dt_s > 0.0) {
            self.state = State::Fault(Fault::Clock);
            return self.all_off();
        }
        self.elapse(dt_s);
        if let Some(fault) = self.sensors.check(&self.limits, dt_s, sensors) {
            self.state = State::Fault(fault);
        }
        // Measured, or reckoned by what the motor was asked for since the last step.
        let measured_m = self.sensors.length_m(&self.limits);
        self.length_m = measured_m.or(self.length_m.map(|length_m| length_m + self.rate_m_s * dt_s));

        if self.state == State::Active {
            self.supervise(dt_s, measured_m);
        }
        match self.state {
            State::Active => self.drive(dt_s, sensors, measured_m),
            State::Fault(Fault::OverPressure) => {
                self.pumps.relieve(&self.limits);
                Actuators {
                    air: self.pumps.air(),
                    ..self.motor_off()
                }
            }
            State::Waiting | State::Silent | State::Stopped | State::Fault(_) => self.all_off(),
        }
    }

    /// Advances every age.
    fn elapse(&mut self, dt_s: f32) {
        self.pumps.elapse(dt_s);
        self.setpoint_age_s = self.setpoint_age_s.map(|age_s| age_s + dt_s);
        self.newest = self
            .newest
            .map(|newest| Newest {
                age_s: newest.age_s + dt_s,
                ..newest
            })
            .filter(|newest| newest.age_s < self.limits.watchdog_s);
    }

    /// What may end `Active` from one step to the next.
    fn supervise(&mut self, dt_s: f32, measured_m: Option<f32>) {
        // Silence that would outlast the limit before the next step is too long already.
        if self
            .setpoint_age_s
            .is_none_or(|age_s| age_s + dt_s >= self.limits.watchdog_s)
        {
            self.state = State::Silent;
        }
        if self.stall.check(&self.limits, dt_s, self.rate_m_s, measured_m) {
            self.state = State::Fault(Fault::MotorStalled);
        }
        if self.pumps.inflating_for_s() > self.limits.pump_timeout_s {
            self.state = State::Fault(Fault::PumpsIneffective);
        }
    }

    fn drive(&mut self, dt_s: f32, sensors: Sensors, measured_m: Option<f32>) -> Actuators {
        let wanted_m_s = match self.setpoint.growth_rate_m_s {
            // Retracting compresses the air: wait for the leak or the vent.
            retract if retract < 0.0 && sensors.pressure_kpa > Some(self.limits.max_pressure_kpa) => 0.0,
            rate => rate,
        };
        self.rate_m_s = allowed_rate(&self.limits, self.length_m, wanted_m_s);
        let growth_duty = self.growth.duty(&self.limits, dt_s, self.rate_m_s, measured_m);
        // Without a sensor there is no pressure control here.
        let air = match sensors.pressure_kpa {
            Some(pressure_kpa) => self.pumps.control(
                &self.limits,
                pressure_kpa,
                self.setpoint.pressure_kpa,
                self.rate_m_s > 0.0,
            ),
            None => Air::Off,
        };
        Actuators { growth_duty, air }
    }

    fn motor_off(&mut self) -> Actuators {
        self.rate_m_s = 0.0;
        self.growth = Growth::default();
        self.stall = StallWatch::default();
        Actuators::default()
    }

    fn all_off(&mut self) -> Actuators {
        self.pumps.shut_off();
        self.motor_off()
    }
}
