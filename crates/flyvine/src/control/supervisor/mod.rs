//! The supervisor: one pure state machine that owns every command that leaves the machine.
//!
//! ```text
//! Standing ──▶ Climbing ──▶ Flying ◀──▶ Coasting          a pose older than 100 ms
//!    │          │     │        │ └──────────┤
//!    │          │     │        └─────┬──────┘  any Reason
//!    │          │     └──────────▶ Holding ──▶ AutopilotHold
//!    ▼          ▼ below the room                  │
//! Stopped ◀── Landing ◀───────────────────────────┘       also the good end, from Flying
//! ```
//!
//! Supervision starts in `Flying` for a vehicle that hovers at the start, in `Standing` for one on the ground. Somebody
//! else's hand on the vehicle ([`Fault::TakenOver`](crate::link::Fault::TakenOver)) stops everything from any state: nobody is
//! fought over the controls.
//!
//! Each tick it is told what the wires say ([`Supervisor::hear`], in real time only) and the poses
//! ([`Supervisor::observe`]), gives back those that it believes, and turns the controller's proposal into an [`Order`]
//! ([`Supervisor::decide`]). It does no I/O and reads
//! no clock. It fails closed: what it cannot judge ends the flight, and no flight that was ended goes on.
//! Set-points it gives out are finite and inside the room, always; where velocities go with them they are those of the
//! positions given out, no faster than [`Limits::command_speed_max_m_s`], and zero from an abort on.

mod event;
mod limits;
mod pose_watch;
mod poses;
mod state;
mod wires;

pub use crate::link::Mode;
pub use event::{Body, Event, EventKind, Reason};
pub use limits::{Limits, LimitsError, Room};
pub use state::{Order, Start, State};

use super::Proposal;
use crate::link::{Captured, Feedforward, Setpoint};
use pose_watch::PoseWatch;
use wires::is_out_of_our_hands;

/// Ages are compared with limits up to rounding, s.
const ROUNDING_S: f64 = 1e-9;
/// Late answers in a row that end the flight.
const LATE_TO_ABORT: u32 = 2;
/// A supervisor that cannot be set up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SupervisorError {
    /// Bad limits.
    #[error("supervisor limits: {0}")]
    Limits(#[from] LimitsError),
    /// The vehicle starts outside the room, or nobody knows where or when.
    #[error(
        "start at t = {} s: quadrotor {:?}, end effector {:?}; expected both in the room",
        .0.t_s, .0.quadrotor, .0.end_effector
    )]
    Start(Start),
}

/// The state machine; see the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub struct Supervisor {
    limits: Limits,
    state: State,
    reason: Option<Reason>,
    /// When the present state was entered, s.
    since_s: f64,
    now_s: f64,
    quadrotor: PoseWatch,
    end_effector: PoseWatch,
    autopilot_heard_s: f64,
    arm_heard_s: f64,
    /// When the poses of this tick were captured, where the wires tell, and the newest capture so far.
    captured: Option<Captured>,
    newest: Captured,
    /// The mode that the autopilot was seen in when it was asked for it.
    confirmed: Option<Mode>,
    /// What goes with positions.
    feedforward: Feedforward,
    /// The last set-point.
    setpoint: Setpoint,
    clipping: bool,
    slowing: bool,
    late: u32,
    events: Vec<Event>,
}

impl Supervisor {
    /// Starts supervising a vehicle that hovers where `start` says, in the room.
    pub fn new(limits: Limits, start: Start) -> Result<Self, SupervisorError> {
        Self::starting(limits, start, State::Flying)
    }

    /// Starts supervising a vehicle that stands on the ground where `start` says: in the room, or below it.
    pub fn standing(limits: Limits, start: Start) -> Result<Self, SupervisorError> {
        Self::starting(limits, start, State::Standing)
    }

    fn starting(limits: Limits, start: Start, state: State) -> Result<Self, SupervisorError> {
        limits.validate()?;
        let Start {
            t_s,
            quadrotor,
            end_effector,
        } = start;
        let room = match state {
            State::Standing => limits.room.without_floor(),
            _ => limits.room,
        };
        if !(t_s.is_finite() && room.holds_quadrotor(quadrotor) && room.holds_end_effector(end_effector)) {
            return Err(SupervisorError::Start(start));
        }
        let watch = |speed_max, position| PoseWatch::new(speed_max, position, t_s, quadrotor);
        Ok(Self {
            limits,
            state,
            reason: None,
            since_s: t_s,
            now_s: t_s,
            quadrotor: watch(limits.quadrotor_speed_max_m_s, quadrotor),
            end_effector: watch(limits.end_effector_speed_max_m_s, end_effector),
            autopilot_heard_s: t_s,
            arm_heard_s: t_s,
            captured: None,
            newest: Captured {
                quadrotor_s: f64::NEG_INFINITY,
                end_effector_s: f64::NEG_INFINITY,
            },
            confirmed: None,
            feedforward: Feedforward::None,
            setpoint: limits.room.clip(quadrotor).into(),
            clipping: false,
            slowing: false,
            late: 0,
            events: Vec::new(),
        })
    }

    /// The same supervisor, whose set-points carry `feedforward` beside the positions.
    pub fn with_feedforward(self, feedforward: Feedforward) -> Self {
        let Setpoint { position, .. } = self.setpoint;
        Self {
            feedforward,
            setpoint: feedforward.setpoint(position, position),
            ..self
        }
    }

    /// Where the flight stands.
    pub fn state(&self) -> State {
        self.state
    }

    /// Why the flight was ended, if it was.
    pub fn reason(&self) -> Option<Reason> {
        self.reason
    }

    /// The last set-point that was given out; before the first one, the start position.
    pub fn setpoint(&self) -> Setpoint {
        self.setpoint
    }

    /// What happened since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// The autopilot reports that it has landed: nothing more to send, if the supervisor asked for it.
    pub fn landed(&mut self) {
        if self.state == State::Landing {
            self.enter(State::Stopped, EventKind::Stopped);
        }
    }

    /// Leaves the ground, if it stands there: from now on the autopilot is to be armed and to follow.
    pub fn take_off(&mut self) {
        if self.state == State::Standing {
            self.enter(State::Climbing, EventKind::Climbing);
        }
    }

    /// The vehicle has climbed to the start and is at rest there: the controller takes it.
    pub fn at_start(&mut self) {
        if self.state == State::Climbing {
            self.enter(State::Flying, EventKind::AtStart);
        }
    }

    /// Ends a flight in good order.
    pub fn land(&mut self) {
        if matches!(self.state, State::Flying | State::Coasting) {
            self.enter(State::Landing, EventKind::Land);
        }
    }

    /// Ends the flight for a reason that comes from outside.
    pub fn abort(&mut self, reason: Reason) {
        if self.reason.is_some() || self.state == State::Stopped {
            return;
        }
        self.reason = Some(reason);
        let position = self.quadrotor.position();
        self.hold(self.limits.room.clip(position));
        let below_room = position[2] < self.limits.room.quadrotor_z_m[0];
        self.say(EventKind::Aborted(reason));
        match self.state {
            _ if is_out_of_our_hands(reason) => self.enter(State::Stopped, EventKind::Stopped),
            State::Standing => self.enter(State::Stopped, EventKind::Stopped),
            State::Climbing if below_room => self.enter(State::Landing, EventKind::Land),
            State::Landing => (),
            _ => (self.state, self.since_s) = (State::Holding, self.now_s),
        }
    }

    /// The mode that goes with the state.
    fn mode(&self) -> Mode {
        match self.state {
            State::Standing => Mode::Standby,
            State::Climbing | State::Flying | State::Coasting | State::Holding => Mode::Offboard,
            State::AutopilotHold => Mode::Hold,
            State::Landing | State::Stopped => Mode::Land,
        }
    }

    /// Turns the controller's proposal at `now_s` into what may leave.
    pub fn decide(&mut self, now_s: f64, proposal: Proposal) -> Order {
        self.advance(now_s);
        self.check_ages();
        self.check_silence();
        if self.reason.is_none() {
            match proposal {
                Proposal::Command(command) => self.accept(command),
                Proposal::Late => {
                    self.hold(self.setpoint.position);
                    self.late += 1;
                    self.say(EventKind::ControllerLate);
                    if self.late >= LATE_TO_ABORT {
                        self.abort(Reason::ControllerLate);
                    }
                }
                Proposal::Failed => self.abort(Reason::ControllerFailed),
            }
        }
        Order {
            setpoint: (self.state != State::Stopped).then_some(self.setpoint),
            mode: self.mode(),
        }
    }

    /// Moves the clock on, and with it the abort ladder.
    fn advance(&mut self, now_s: f64) {
        if !now_s.is_finite() || now_s < self.now_s {
            self.abort(Reason::Clock {
                found: now_s,
                last: self.now_s,
            });
            return;
        }
        self.now_s = now_s;
        let spent_s = now_s - self.since_s + ROUNDING_S;
        match self.state {
            State::Holding if spent_s >= self.limits.hold_s => {
                self.enter(State::AutopilotHold, EventKind::AutopilotHold);
            }
            State::AutopilotHold if spent_s >= self.limits.autopilot_hold_s => {
                self.enter(State::Landing, EventKind::Land);
            }
            State::Landing if spent_s >= self.limits.landing_s => {
                let limit_s = self.limits.landing_s;
                self.release(Reason::NotLanded { limit_s });
            }
            State::Climbing if spent_s >= self.limits.climb_s => {
                let limit_s = self.limits.climb_s;
                self.abort(Reason::NotAirborne { limit_s });
            }
            _ => (),
        }
    }

    fn accept(&mut self, command: [f64; 3]) {
        if !command.iter().all(|x| x.is_finite()) {
            self.abort(Reason::CommandNotFinite);
            return;
        }
        self.late = 0;
        let position = self.limits.room.clip(command);
        let clipped = position != command;
        if clipped && !self.clipping {
            self.say(EventKind::Clipped {
                proposed: command,
                sent: position,
            });
        }
        self.clipping = clipped;
        self.setpoint = self.feedforward.setpoint(position, self.setpoint.position);
        self.limit_speed();
    }

    /// Shortens a velocity that is too fast to feed forward.
    fn limit_speed(&mut self) {
        let Some(velocity) = &mut self.setpoint.velocity else {
            return;
        };
        let limit_m_s = self.limits.command_speed_max_m_s;
        let speed_m_s = velocity.iter().map(|v| v * v).sum::<f64>().sqrt();
        let slowed = speed_m_s > limit_m_s;
        if slowed {
            *velocity = velocity.map(|v| v * (limit_m_s / speed_m_s));
        }
        if slowed && !self.slowing {
            self.say(EventKind::Slowed { speed_m_s, limit_m_s });
        }
        self.slowing = slowed;
    }

    /// Sends `position` from now on, and no velocity but zero.
    fn hold(&mut self, position: [f64; 3]) {
        self.setpoint = self.feedforward.setpoint(position, position);
    }

    fn enter(&mut self, state: State, event: EventKind) {
        self.state = state;
        self.since_s = self.now_s;
        self.say(event);
    }

    fn say(&mut self, kind: EventKind) {
        self.events.push(Event {
            t_s: self.now_s,
            kind,
        });
    }
}

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
