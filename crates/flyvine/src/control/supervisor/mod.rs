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
//! else's hand on the vehicle ([`Fault::TakenOver`]) stops everything from any state: nobody is fought over the controls.
//!
//! Each tick it is told what the wires say ([`Supervisor::hear`], in real time only) and the poses
//! ([`Supervisor::observe`]), gives back those that it believes, and turns the controller's proposal into an [`Order`]
//! ([`Supervisor::decide`]). It does no I/O and reads
//! no clock. It fails closed: what it cannot judge ends the flight, and no flight that was ended goes on.
//! Set-points it gives out are finite and inside the room, always.

mod event;
mod limits;
mod pose_watch;
mod state;

pub use crate::link::Mode;
pub use event::{Body, Event, EventKind, Reason};
pub use limits::{Limits, LimitsError, Room};
pub use state::{Order, Start, State};

use super::Proposal;
use crate::DT;
use crate::flight::{Configuration, Pose};
use crate::link::{Captured, Fault, Health, Observation};
use pose_watch::{PoseWatch, Seen, Verdict, distance};

/// How far the norm of an attitude may be from 1.
const NORM_TOLERANCE: f64 = 1e-2;
/// Ages are compared with limits up to rounding, s.
const ROUNDING_S: f64 = 1e-9;
/// Late answers in a row that end the flight.
const LATE_TO_ABORT: u32 = 2;
/// Periods missed in a row that end the flight.
const MISSED_TO_ABORT: u32 = 2;

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
    /// The last set-point, m.
    setpoint: [f64; 3],
    clipping: bool,
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
            setpoint: limits.room.clip(quadrotor),
            clipping: false,
            late: 0,
            events: Vec::new(),
        })
    }

    /// Where the flight stands.
    pub fn state(&self) -> State {
        self.state
    }

    /// Why the flight was ended, if it was.
    pub fn reason(&self) -> Option<Reason> {
        self.reason
    }

    /// The last set-point that was given out, m; before the first one, the start position.
    pub fn setpoint(&self) -> [f64; 3] {
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
        self.setpoint = self.limits.room.clip(position);
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
    fn release(&mut self, reason: Reason) {
        self.abort(reason);
        if self.state != State::Stopped {
            self.enter(State::Stopped, EventKind::Stopped);
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

    /// Takes in the newest poses at `now_s` and gives back those that can be believed, the others as `None`.
    /// `configuration` is what the arm is told to be.
    pub fn observe(&mut self, now_s: f64, newest: &Observation, configuration: Configuration) -> Observation {
        let nothing = Observation {
            t_s: newest.t_s,
            quadrotor: None,
            end_effector: None,
        };
        self.advance(now_s);
        let Some((newest, captured)) = self.captured_since(newest) else {
            return nothing;
        };
        if newest.quadrotor.is_some_and(|pose| !is_possible(&pose)) {
            self.abort(Reason::ImpossiblePose(Body::Quadrotor));
            return nothing;
        }
        if newest
            .end_effector
            .is_some_and(|position| !position.iter().all(|x| x.is_finite()))
        {
            self.abort(Reason::ImpossiblePose(Body::EndEffector));
            return nothing;
        }

        let held = self.setpoint;
        let quadrotor_seen: Option<Seen> = newest.quadrotor.map(|pose| (pose.position, Some(pose.attitude)));
        let end_effector_seen: Option<Seen> = newest.end_effector.map(|position| (position, None));
        let (position, tip) = (quadrotor_seen.map(|seen| seen.0), newest.end_effector);
        let verdict = self
            .quadrotor
            .judge(captured.quadrotor_s, quadrotor_seen, held, tip);
        let quadrotor = newest
            .quadrotor
            .filter(|_| self.believe(Body::Quadrotor, verdict));
        let verdict = self
            .end_effector
            .judge(captured.end_effector_s, end_effector_seen, held, position);
        let end_effector = newest
            .end_effector
            .filter(|_| self.believe(Body::EndEffector, verdict));
        self.check_place(quadrotor, end_effector, configuration.length_m);
        Observation {
            quadrotor,
            end_effector,
            ..nothing
        }
    }

    /// The poses of `newest` that were captured since the last tick, and when; `None` if their clock is broken. Without
    /// stamps from the wires a pose is as old as its observation.
    fn captured_since(&mut self, newest: &Observation) -> Option<(Observation, Captured)> {
        let stamped = self.captured.take();
        let captured = stamped.unwrap_or(Captured {
            quadrotor_s: newest.t_s,
            end_effector_s: newest.t_s,
        });
        let stamps = [
            newest.quadrotor.map(|_| captured.quadrotor_s),
            newest.end_effector.map(|_| captured.end_effector_s),
            Some(newest.t_s),
        ];
        // A pose of this instant may carry the time of the tick's end.
        let broken = stamps
            .into_iter()
            .flatten()
            .find(|stamp_s| !stamp_s.is_finite() || *stamp_s > self.now_s + DT);
        if let Some(found) = broken {
            let last = self.now_s;
            self.abort(Reason::Clock { found, last });
            return None;
        }
        let mut observation = *newest;
        if stamped.is_some() {
            observation.quadrotor = newest
                .quadrotor
                .filter(|_| captured.quadrotor_s > self.newest.quadrotor_s);
            observation.end_effector = newest
                .end_effector
                .filter(|_| captured.end_effector_s > self.newest.end_effector_s);
            self.newest = Captured {
                quadrotor_s: self.newest.quadrotor_s.max(captured.quadrotor_s),
                end_effector_s: self.newest.end_effector_s.max(captured.end_effector_s),
            };
        }
        let captured = Captured {
            quadrotor_s: captured.quadrotor_s.min(self.now_s),
            end_effector_s: captured.end_effector_s.min(self.now_s),
        };
        Some((observation, captured))
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

    /// Whether a pose with this verdict goes on to the controller.
    fn believe(&mut self, body: Body, verdict: Verdict) -> bool {
        if let Verdict::Jump {
            distance_m,
            limit_m,
            last,
        } = verdict
        {
            self.say(EventKind::JumpRefused { body, distance_m });
            if last {
                self.abort(Reason::JumpingPose {
                    body,
                    distance_m,
                    limit_m,
                });
            }
        }
        verdict == Verdict::Credible
    }

    /// The room and the arm's reach, for the poses that are believed.
    fn check_place(&mut self, quadrotor: Option<Pose>, end_effector: Option<[f64; 3]>, length_m: f64) {
        let room = match self.state {
            State::Standing | State::Climbing | State::Landing => self.limits.room.without_floor(),
            _ => self.limits.room,
        };
        if !(length_m.is_finite() && length_m > 0.0) {
            self.abort(Reason::ArmLength { length_m });
        }
        if let Some(Pose { position, .. }) = quadrotor
            && !room.holds_quadrotor(position)
        {
            self.abort(Reason::LeftRoom {
                body: Body::Quadrotor,
                position,
            });
        }
        if let Some(position) = end_effector
            && !room.holds_end_effector(position)
        {
            self.abort(Reason::LeftRoom {
                body: Body::EndEffector,
                position,
            });
        }
        if let (Some(Pose { position, .. }), Some(tip)) = (quadrotor, end_effector) {
            let (distance_m, limit_m) = (distance(position, tip), length_m + self.limits.reach_margin_m);
            if distance_m > limit_m {
                self.abort(Reason::Overstretched { distance_m, limit_m });
            }
        }
    }

    fn check_ages(&mut self) {
        if self.reason.is_some() {
            return;
        }
        let (coast_s, limit_s) = (self.limits.coast_age_s, self.limits.abort_age_s);
        let watches = [
            (Body::Quadrotor, self.quadrotor),
            (Body::EndEffector, self.end_effector),
        ];
        let mut oldest = None;
        for (body, watch) in watches {
            let (age_s, frozen) = (watch.age_s(self.now_s), watch.is_frozen());
            if age_s > limit_s + ROUNDING_S {
                self.abort(match frozen {
                    true => Reason::FrozenPose { body, age_s, limit_s },
                    false => Reason::StalePose { body, age_s, limit_s },
                });
                return;
            }
            if age_s > coast_s + ROUNDING_S && oldest.is_none_or(|(_, oldest_s, _)| age_s > oldest_s) {
                oldest = Some((body, age_s, frozen));
            }
        }
        match (self.state, oldest) {
            (State::Flying, Some((body, age_s, frozen))) => {
                self.enter(State::Coasting, EventKind::Coasting { body, age_s, frozen });
            }
            (State::Coasting, None) => self.enter(State::Flying, EventKind::Fresh),
            _ => (),
        }
    }

    fn check_silence(&mut self) {
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

    fn accept(&mut self, command: [f64; 3]) {
        if !command.iter().all(|x| x.is_finite()) {
            self.abort(Reason::CommandNotFinite);
            return;
        }
        self.late = 0;
        self.setpoint = self.limits.room.clip(command);
        let clipped = self.setpoint != command;
        if clipped && !self.clipping {
            self.say(EventKind::Clipped {
                proposed: command,
                sent: self.setpoint,
            });
        }
        self.clipping = clipped;
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

/// Whether the vehicle is not ours to command any more.
fn is_out_of_our_hands(reason: Reason) -> bool {
    matches!(reason, Reason::Fault(Fault::TakenOver | Fault::Disarmed))
}

fn is_possible(pose: &Pose) -> bool {
    let norm = pose.attitude.iter().map(|x| x * x).sum::<f64>().sqrt();
    // Not `>`: NaN must fail.
    pose.position.iter().all(|x| x.is_finite()) && (norm - 1.0).abs() <= NORM_TOLERANCE
}

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
