//! The supervisor: one pure state machine that owns every command that leaves the machine.
//!
//! ```text
//! Flying ◀──▶ Coasting          a pose older than 100 ms
//!    │            │
//!    └─────┬──────┘  any Reason
//!          ▼
//!       Holding ──▶ AutopilotHold ──▶ Landing ──▶ Stopped
//! ```
//!
//! Each tick it is told the time and the poses ([`Supervisor::observe`]), gives back those that it believes,
//! and turns the controller's proposal into an [`Order`] ([`Supervisor::decide`]). It does no I/O and reads
//! no clock. It fails closed: what it cannot judge ends the flight, and no flight that was ended goes on.
//! Set-points it gives out are finite and inside the room, always.

mod event;
mod limits;
mod pose_watch;
mod state;

pub use event::{Body, Event, EventKind, Reason};
pub use limits::{Limits, LimitsError, Room};
pub use state::{Mode, Order, Start, State};

use super::Proposal;
use crate::DT;
use crate::flight::{Configuration, Pose};
use crate::link::Observation;
use pose_watch::{PoseWatch, Seen, Verdict, distance};

/// How far the norm of an attitude may be from 1.
const NORM_TOLERANCE: f64 = 1e-2;
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
    /// The last set-point, m.
    setpoint: [f64; 3],
    clipping: bool,
    late: u32,
    events: Vec<Event>,
}

impl Supervisor {
    /// Starts supervising a vehicle that stands or hovers where `start` says.
    pub fn new(limits: Limits, start: Start) -> Result<Self, SupervisorError> {
        limits.validate()?;
        let Start {
            t_s,
            quadrotor,
            end_effector,
        } = start;
        let room = &limits.room;
        if !(t_s.is_finite() && room.holds_quadrotor(quadrotor) && room.holds_end_effector(end_effector)) {
            return Err(SupervisorError::Start(start));
        }
        let watch = |speed_max, position| PoseWatch::new(speed_max, position, t_s, quadrotor);
        Ok(Self {
            limits,
            state: State::Flying,
            reason: None,
            since_s: t_s,
            now_s: t_s,
            quadrotor: watch(limits.quadrotor_speed_max_m_s, quadrotor),
            end_effector: watch(limits.end_effector_speed_max_m_s, end_effector),
            autopilot_heard_s: t_s,
            arm_heard_s: t_s,
            setpoint: quadrotor,
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

    /// The autopilot was heard since the last tick.
    pub fn heard_autopilot(&mut self) {
        self.autopilot_heard_s = self.now_s;
    }

    /// The arm was heard since the last tick.
    pub fn heard_arm(&mut self) {
        self.arm_heard_s = self.now_s;
    }

    /// The autopilot reports that it has landed: nothing more to send, if the supervisor asked for it.
    pub fn landed(&mut self) {
        if self.state == State::Landing {
            self.enter(State::Stopped, EventKind::Stopped);
        }
    }

    /// Ends the flight for a reason that comes from outside.
    pub fn abort(&mut self, reason: Reason) {
        if self.reason.is_some() {
            return;
        }
        self.reason = Some(reason);
        self.setpoint = self.limits.room.clip(self.quadrotor.position());
        self.enter(State::Holding, EventKind::Aborted(reason));
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
        // A pose of this instant may carry the time of the tick's end.
        if !newest.t_s.is_finite() || newest.t_s > self.now_s + DT {
            self.abort(Reason::Clock {
                found: newest.t_s,
                last: self.now_s,
            });
            return nothing;
        }
        let capture_s = newest.t_s.min(self.now_s);
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
        let verdict = self.quadrotor.judge(capture_s, quadrotor_seen, held, tip);
        let quadrotor = newest
            .quadrotor
            .filter(|_| self.believe(Body::Quadrotor, verdict));
        let verdict = self
            .end_effector
            .judge(capture_s, end_effector_seen, held, position);
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
        let mode = match self.state {
            State::Flying | State::Coasting | State::Holding => Mode::Offboard,
            State::AutopilotHold => Mode::Hold,
            State::Landing | State::Stopped => Mode::Land,
        };
        Order {
            setpoint: (self.state != State::Stopped).then_some(self.setpoint),
            mode,
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
                self.enter(State::Stopped, EventKind::Stopped);
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
        let room = self.limits.room;
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

fn is_possible(pose: &Pose) -> bool {
    let norm = pose.attitude.iter().map(|x| x * x).sum::<f64>().sqrt();
    // Not `>`: NaN must fail.
    pose.position.iter().all(|x| x.is_finite()) && (norm - 1.0).abs() <= NORM_TOLERANCE
}

#[cfg(test)]
mod properties;
#[cfg(test)]
mod tests;
