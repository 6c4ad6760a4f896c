//! What the supervisor hears of the wires: heartbeats, faults, somebody else's hand on the vehicle.

use super::event::{EventKind, Reason};
use super::state::State;
use super::{ROUNDING_S, Supervisor};
use crate::link::{Fault, Health};

/// Periods missed in a row that end the flight.
const MISSED_TO_ABORT: u32 = 2;

impl Supervisor {
    /// Takes in what the wires say at this tick; before [`Supervisor::observe`].
    pub fn hear(&mut self, health: &Health) {
        self.advance(health.now_s);
        self.captured = Some(health.captured);
        // Not from the future, and a NaN counts as silence.
        self.autopilot_heard_s = self
            .autopilot_heard_s
            .max(health.autopilot_heard_s.min(self.now_s));
        if let Some(heard_s) = health.arm_heard_s {
            self.arm_heard_s = self.arm_heard_s.max(heard_s.min(self.now_s));
        }
        if health.missed_ticks >= MISSED_TO_ABORT {
            self.abort(Reason::TicksMissed {
                missed: health.missed_ticks,
            });
        }
        if let Some(fault) = health.fault {
            self.abort(Reason::Fault(fault));
        }
        self.check_hands(health);
    }

    /// Whether the autopilot still does what it was seen to do when it was asked.
    fn check_hands(&mut self, health: &Health) {
        if matches!(self.state, State::Standing | State::Stopped) {
            return;
        }
        let was_confirmed = self.confirmed.is_some();
        if !health.armed {
            match self.state {
                State::Landing if was_confirmed || health.standing => self.landed(),
                _ if was_confirmed => self.release(Fault::Disarmed.into()),
                _ => (),
            }
            return;
        }
        let wanted = self.mode();
        if health.mode == Some(wanted) {
            self.confirmed = Some(wanted);
        } else if was_confirmed && health.mode != self.confirmed {
            self.release(Fault::TakenOver.into());
        }
    }

    /// Somebody else has the vehicle, or nobody: nothing more is sent, whatever came before.
    pub(super) fn release(&mut self, reason: Reason) {
        self.abort(reason);
        if self.state != State::Stopped {
            self.enter(State::Stopped, EventKind::Stopped);
        }
    }

    pub(super) fn check_silence(&mut self) {
        if let Some(limit_s) = self.limits.autopilot_silence_s {
            let silence_s = self.now_s - self.autopilot_heard_s;
            if silence_s > limit_s + ROUNDING_S {
                self.abort(Reason::AutopilotSilent { silence_s, limit_s });
            }
        }
        if let Some(limit_s) = self.limits.arm_silence_s {
            let silence_s = self.now_s - self.arm_heard_s;
            if silence_s > limit_s + ROUNDING_S {
                self.abort(Reason::ArmSilent { silence_s, limit_s });
            }
        }
    }
}

/// Whether the vehicle is not ours to command any more.
pub(super) fn is_out_of_our_hands(reason: Reason) -> bool {
    matches!(reason, Reason::Fault(Fault::TakenOver | Fault::Disarmed))
}
