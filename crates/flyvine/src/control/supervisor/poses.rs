//! What the supervisor thinks of poses: which it believes, where they may be, how old.

use super::event::{Body, EventKind, Reason};
use super::pose_watch::{Seen, Verdict, distance};
use super::state::State;
use super::{ROUNDING_S, Supervisor};
use crate::DT;
use crate::flight::{Configuration, Pose};
use crate::link::{Captured, Observation};

/// How far the norm of an attitude may be from 1.
const NORM_TOLERANCE: f64 = 1e-2;

impl Supervisor {
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

        let held = self.setpoint.position;
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

    pub(super) fn check_ages(&mut self) {
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
}

fn is_possible(pose: &Pose) -> bool {
    let norm = pose.attitude.iter().map(|x| x * x).sum::<f64>().sqrt();
    // Not `>`: NaN must fail.
    pose.position.iter().all(|x| x.is_finite()) && (norm - 1.0).abs() <= NORM_TOLERANCE
}
