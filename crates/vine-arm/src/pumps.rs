//! On-off pressure control with hysteresis and interlocks.

use crate::limits::Limits;

/// What moves air. One value, so that inflating while venting cannot be said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Air {
    /// Pumps off, vent closed.
    #[default]
    Off = 0,
    /// The pumps run (the prototype's two, in parallel on one channel).
    Inflate = 1,
    /// The vent is open.
    Vent = 2,
}

impl Air {
    /// The value of a wire code.
    pub(crate) fn from_code(code: u8) -> Option<Air> {
        [Air::Off, Air::Inflate, Air::Vent]
            .into_iter()
            .find(|air| *air as u8 == code)
    }
}

/// The pumps' controller.
///
/// Interlocks: pumps and vent rest for [`Limits::min_off_s`] after every run, whoever ended it, and for
/// [`Limits::changeover_s`] before they follow each other; a run lasts [`Limits::min_on_s`] unless it is
/// [shut off](Pumps::shut_off).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pumps {
    air: Air,
    /// What ran last; off before the first run.
    last: Air,
    /// Since the last change, s.
    since_change_s: f32,
}

impl Default for Pumps {
    /// At rest for ever.
    fn default() -> Self {
        Pumps {
            air: Air::Off,
            last: Air::Off,
            since_change_s: f32::MAX,
        }
    }
}

impl Pumps {
    /// What is running.
    pub fn air(&self) -> Air {
        self.air
    }

    /// How long the pumps have been running, s; zero if they are not.
    pub fn inflating_for_s(&self) -> f32 {
        if self.air == Air::Inflate {
            self.since_change_s
        } else {
            0.0
        }
    }

    /// Advances the interlocks' clocks; the first thing in every step, whatever else it does.
    pub fn elapse(&mut self, dt_s: f32) {
        self.since_change_s += dt_s;
    }

    /// One decision at `pressure_kpa` for `setpoint_kpa`: start below the set-point minus the hysteresis, stop above
    /// it plus the hysteresis. A tube that grows falls through the band by itself, limp where the pumps come late: there
    /// they start below the set-point. The vent, where there is one, opens at three times the hysteresis above and closes
    /// at once, so that it never chases the pumps' own overshoot.
    pub fn control(
        &mut self,
        limits: &Limits,
        pressure_kpa: f32,
        setpoint_kpa: f32,
        is_growing: bool,
    ) -> Air {
        let above = pressure_kpa - setpoint_kpa;
        let start = if is_growing { 0.0 } else { -limits.hysteresis_kpa };
        let wanted = match self.air {
            Air::Off if setpoint_kpa > 0.0 && above < start => Air::Inflate,
            Air::Off if limits.has_vent && above > 3.0 * limits.hysteresis_kpa => Air::Vent,
            // A set-point of zero is "off": otherwise the pumps would idle around a limp tube.
            Air::Inflate if setpoint_kpa <= 0.0 || above > limits.hysteresis_kpa => Air::Off,
            Air::Vent if above < limits.hysteresis_kpa => Air::Off,
            unchanged => unchanged,
        };
        let shortest = match self.air {
            Air::Off => self.rest_s(limits, wanted),
            Air::Inflate | Air::Vent => limits.min_on_s,
        };
        if wanted != self.air && self.since_change_s >= shortest {
            self.change(wanted);
        }
        self.air
    }

    /// The rest before `next` may run, s.
    fn rest_s(&self, limits: &Limits, next: Air) -> f32 {
        if self.last == next {
            limits.min_off_s
        } else {
            limits.changeover_s
        }
    }

    /// Stops at once: safety does not wait for a shortest run.
    pub fn shut_off(&mut self) {
        if self.air != Air::Off {
            self.change(Air::Off);
        }
    }

    /// Stops the pumps at once and opens the vent, where there is one, after the rest between the two.
    pub fn relieve(&mut self, limits: &Limits) {
        if self.air == Air::Inflate {
            self.shut_off();
        } else if self.air == Air::Off
            && limits.has_vent
            && self.since_change_s >= self.rest_s(limits, Air::Vent)
        {
            self.change(Air::Vent);
        }
    }

    fn change(&mut self, air: Air) {
        if self.air != Air::Off {
            self.last = self.air;
        }
        self.air = air;
        self.since_change_s = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 0.005;

    fn run(pumps: &mut Pumps, limits: &Limits, seconds: f32, pressure_kpa: f32, setpoint_kpa: f32) -> Air {
        for _ in 0..(seconds / DT) as u32 {
            pumps.elapse(DT);
            pumps.control(limits, pressure_kpa, setpoint_kpa, false);
        }
        pumps.air()
    }

    #[test]
    fn hysteresis_holds_between_its_ends() {
        let limits = Limits::default();
        let mut pumps = Pumps::default();
        assert_eq!(run(&mut pumps, &limits, 1.0, 0.39, 0.4), Air::Off);
        assert_eq!(run(&mut pumps, &limits, 1.0, 0.37, 0.4), Air::Inflate);
        assert_eq!(run(&mut pumps, &limits, 1.0, 0.41, 0.4), Air::Inflate);
        assert_eq!(run(&mut pumps, &limits, 1.0, 0.43, 0.4), Air::Off);
    }

    #[test]
    fn a_growing_tube_is_filled_from_the_set_point_on() {
        let limits = Limits::default();
        let mut pumps = Pumps::default();
        pumps.elapse(DT);
        assert_eq!(pumps.control(&limits, 0.39, 0.4, false), Air::Off);
        assert_eq!(pumps.control(&limits, 0.39, 0.4, true), Air::Inflate);
        assert_eq!(run(&mut pumps, &limits, 0.1, 0.43, 0.4), Air::Off);
        assert_eq!(pumps.control(&limits, 0.0, 0.0, true), Air::Off, "zero is off");
    }

    #[test]
    fn the_prototype_does_not_vent() {
        let limits = Limits::default();
        let mut pumps = Pumps::default();
        assert_eq!(run(&mut pumps, &limits, 1.0, 1.0, 0.4), Air::Off);
        pumps.relieve(&limits);
        assert_eq!(pumps.air(), Air::Off);
    }

    #[test]
    fn pumps_and_vent_rest_in_between() {
        let limits = Limits {
            has_vent: true,
            ..Limits::default()
        };
        let mut pumps = Pumps::default();
        assert_eq!(run(&mut pumps, &limits, 1.0, 0.0, 0.4), Air::Inflate);
        pumps.relieve(&limits);
        assert_eq!(pumps.air(), Air::Off);
        pumps.relieve(&limits);
        assert_eq!(pumps.air(), Air::Off, "no vent before the rest is over");
        assert_eq!(run(&mut pumps, &limits, 0.2, 1.0, 0.4), Air::Vent);
        assert_eq!(
            run(&mut pumps, &limits, 0.08, 0.0, 0.4),
            Air::Off,
            "no pumps either"
        );
        assert_eq!(run(&mut pumps, &limits, 0.2, 0.0, 0.4), Air::Inflate);
    }

    #[test]
    fn a_run_has_a_shortest_length() {
        let limits = Limits {
            min_on_s: 0.1,
            ..Limits::default()
        };
        let mut pumps = Pumps::default();
        run(&mut pumps, &limits, 0.011, 0.0, 0.4);
        assert_eq!(run(&mut pumps, &limits, 0.05, 1.0, 0.4), Air::Inflate);
        assert_eq!(run(&mut pumps, &limits, 0.06, 1.0, 0.4), Air::Off);
    }
}
