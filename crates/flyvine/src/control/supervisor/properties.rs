//! What holds for every order of events.

use proptest::prelude::*;

use super::pose_watch::distance;
use super::*;
use crate::DT;
use crate::flight::{Configuration, Pose};
use crate::link::{Captured, Health, Observation};

const ARM: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};
const START: Start = Start {
    t_s: 0.0,
    quadrotor: [0.0, 0.0, 1.5],
    end_effector: [0.0, 0.0, 0.8],
};

/// What motion capture says of one body at one tick.
#[derive(Debug, Clone, Copy)]
enum Capture {
    New,
    Missing,
    Frozen,
    Displaced([f64; 3]),
    NotFinite,
}

#[derive(Debug, Clone)]
struct TickEvents {
    duration_s: f64,
    quadrotor: Capture,
    end_effector: Capture,
    proposal: Proposal,
    autopilot_heard: bool,
    arm_heard: bool,
}

fn capture() -> impl Strategy<Value = Capture> {
    prop_oneof![
        20 => Just(Capture::New),
        4 => Just(Capture::Missing),
        4 => Just(Capture::Frozen),
        1 => prop::array::uniform3(-5.0..5.0).prop_map(Capture::Displaced),
        1 => Just(Capture::NotFinite),
    ]
}

fn proposal() -> impl Strategy<Value = Proposal> {
    prop_oneof![
        20 => prop::array::uniform3(-1.0..2.0).prop_map(Proposal::Command),
        4 => prop::array::uniform3(prop::num::f64::ANY).prop_map(Proposal::Command),
        2 => Just(Proposal::Late),
        1 => Just(Proposal::Failed),
    ]
}

fn tick() -> impl Strategy<Value = TickEvents> {
    let duration_s = prop_oneof![20 => Just(DT), 1 => 0.0..0.5, 1 => Just(f64::NAN), 1 => -1.0..0.0];
    (
        duration_s,
        capture(),
        capture(),
        proposal(),
        prop::bool::weighted(0.8),
        prop::bool::weighted(0.8),
    )
        .prop_map(
            |(duration_s, quadrotor, end_effector, proposal, autopilot_heard, arm_heard)| TickEvents {
                duration_s,
                quadrotor,
                end_effector,
                proposal,
                autopilot_heard,
                arm_heard,
            },
        )
}

/// Poses of a vehicle that moves a little all the time, with what motion capture makes of them.
struct MotionCapture {
    ticks: usize,
    last: [[f64; 3]; 2],
}

impl MotionCapture {
    fn see(&mut self, body: usize, capture: Capture) -> Option<[f64; 3]> {
        let place = [START.quadrotor, START.end_effector][body];
        let truth = [place[0] + 1e-3 * (self.ticks % 100) as f64, place[1], place[2]];
        let seen = match capture {
            Capture::New => truth,
            Capture::Missing => return None,
            Capture::Frozen => self.last[body],
            Capture::Displaced(by) => std::array::from_fn(|axis| truth[axis] + by[axis]),
            Capture::NotFinite => [f64::NAN, truth[1], truth[2]],
        };
        if seen.iter().all(|x| x.is_finite()) {
            self.last[body] = seen;
        }
        Some(seen)
    }
}

const LIMITS: Limits = Limits {
    room: Room {
        x_m: [-2.2, 2.2],
        y_m: [-2.2, 2.2],
        quadrotor_z_m: [0.8, 2.4],
        end_effector_z_min_m: 0.15,
    },
    coast_age_s: 0.1,
    abort_age_s: 0.4,
    reach_margin_m: 0.1,
    quadrotor_speed_max_m_s: 8.0,
    end_effector_speed_max_m_s: 12.0,
    command_speed_max_m_s: 6.0,
    autopilot_silence_s: Some(0.3),
    arm_silence_s: Some(0.3),
    hold_s: 0.5,
    autopilot_hold_s: 0.5,
    landing_s: 0.5,
    climb_s: 0.5,
};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn the_rules_hold_for_every_order_of_events(ticks in prop::collection::vec(tick(), 1..120)) {
        let mut supervisor = Supervisor::new(LIMITS, START).unwrap().with_feedforward(Feedforward::Velocity);
        let mut capture = MotionCapture { ticks: 0, last: [START.quadrotor, START.end_effector] };
        let mut now_s = 0.0;
        // This test's own account of when something was last good.
        let mut seen_s = [0.0; 2];
        let mut heard_s = [0.0; 2];
        let mut late = 0;
        let mut rank = 0;
        for events in ticks {
            let told_s = now_s + events.duration_s;
            let clock_is_good = told_s >= now_s;
            if clock_is_good {
                now_s = told_s;
            }
            capture.ticks += 1;
            let positions = [capture.see(0, events.quadrotor), capture.see(1, events.end_effector)];
            let observation = Observation {
                t_s: now_s,
                quadrotor: positions[0].map(|position| Pose { position, attitude: [1.0, 0.0, 0.0, 0.0] }),
                end_effector: positions[1],
            };
            let was_aborted = supervisor.reason().is_some();
            if events.autopilot_heard {
                heard_s[0] = now_s;
            }
            if events.arm_heard {
                heard_s[1] = now_s;
            }
            supervisor.hear(&Health {
                now_s: told_s,
                captured: Captured { quadrotor_s: now_s, end_effector_s: now_s },
                autopilot_heard_s: heard_s[0],
                arm_heard_s: Some(heard_s[1]),
                missed_ticks: 0,
                armed: true,
                standing: false,
                mode: None,
                fault: None,
            });
            let credible = supervisor.observe(told_s, &observation, ARM);
            let order = supervisor.decide(told_s, events.proposal);
            let aborted = supervisor.reason().is_some();

            // Whatever leaves is finite and in the room, no faster than allowed, and stands still once the flight is over.
            if let Some(setpoint) = order.setpoint {
                prop_assert!(LIMITS.room.holds_quadrotor(setpoint.position), "{setpoint:?}");
                let speed = setpoint.velocity.map(|velocity| distance(velocity, [0.0; 3]));
                let limit = if aborted { 0.0 } else { LIMITS.command_speed_max_m_s + 1e-9 };
                prop_assert!(speed.is_some_and(|speed| speed <= limit), "{setpoint:?}");
            }
            // Whatever is believed was seen, and is finite.
            if let Some(pose) = credible.quadrotor {
                prop_assert_eq!(Some(pose.position), positions[0]);
                prop_assert!(pose.position.iter().all(|x| x.is_finite()));
            }
            if let Some(position) = credible.end_effector {
                prop_assert_eq!(Some(position), positions[1]);
                prop_assert!(position.iter().all(|x| x.is_finite()));
            }
            // States are passed in one direction only once the flight is over.
            let new_rank = match supervisor.state() {
                State::Standing | State::Climbing | State::Flying | State::Coasting => 0,
                State::Holding => 1,
                State::AutopilotHold => 2,
                State::Landing => 3,
                State::Stopped => 4,
            };
            prop_assert!(new_rank >= rank && aborted == (new_rank > 0));
            rank = new_rank;

            // Faults that end a flight at once.
            let proposes_nan =
                matches!(events.proposal, Proposal::Command(u) if !u.iter().all(|x| x.is_finite()));
            let sees_nan = positions.iter().flatten().flatten().any(|x| !x.is_finite());
            if !clock_is_good || proposes_nan || sees_nan || events.proposal == Proposal::Failed {
                prop_assert!(aborted);
            }
            let both = credible.quadrotor.map(|pose| pose.position).zip(credible.end_effector);
            if let Some((quadrotor, tip)) = both {
                let inside = LIMITS.room.holds_quadrotor(quadrotor)
                    && LIMITS.room.holds_end_effector(tip)
                    && distance(quadrotor, tip) <= 0.8;
                prop_assert!(inside || aborted);
            }
            // Faults that end it after a time.
            late = if events.proposal == Proposal::Late { late + 1 } else { 0 };
            for body in 0..2 {
                if positions[body].is_some() {
                    seen_s[body] = now_s;
                }
                let age_s = now_s - seen_s[body];
                prop_assert!(age_s <= 0.4 + 1e-6 || aborted, "body {} not seen for {} s", body, age_s);
                prop_assert!(now_s - heard_s[body] <= 0.3 + 1e-6 || aborted);
            }
            prop_assert!(late < 2 || aborted);
            prop_assert!(!was_aborted || aborted);
        }
        // However it came to an abort, the ladder ends: at most three rungs of 0.5 s.
        if supervisor.reason().is_some() {
            supervisor.decide(now_s + 0.5, Proposal::Late);
            supervisor.decide(now_s + 1.0, Proposal::Late);
            let order = supervisor.decide(now_s + 1.5, Proposal::Late);
            prop_assert_eq!(order.setpoint, None);
        }
    }

    /// One body gives nothing new, by any mixture of frozen and missing poses, while the other moves.
    #[test]
    fn a_body_without_new_poses_ends_the_flight_in_time(
        frozen in prop::collection::vec(any::<bool>(), 10),
        body in 0..2_usize,
        good_ticks in 1..50_usize,
    ) {
        let limits = Limits { autopilot_silence_s: None, arm_silence_s: None, ..LIMITS };
        let mut supervisor = Supervisor::new(limits, START).unwrap();
        let mut capture = MotionCapture { ticks: 0, last: [START.quadrotor, START.end_effector] };
        let mut tick = |captures: [Capture; 2]| {
            capture.ticks += 1;
            let t_s = capture.ticks as f64 * DT;
            let attitude = [1.0, 0.0, 0.0, 0.0];
            let quadrotor = capture.see(0, captures[0]).map(|position| Pose { position, attitude });
            let observation = Observation { t_s, quadrotor, end_effector: capture.see(1, captures[1]) };
            let credible = supervisor.observe(t_s, &observation, ARM);
            supervisor.decide(t_s, Proposal::Command(START.quadrotor));
            let believed = [credible.quadrotor.is_some(), credible.end_effector.is_some()];
            (believed, supervisor.state())
        };
        for _ in 0..good_ticks {
            prop_assert_eq!(tick([Capture::New; 2]), ([true; 2], State::Flying));
        }
        for (ticks, frozen) in (1..).zip(frozen) {
            let mut captures = [Capture::New; 2];
            captures[body] = if frozen { Capture::Frozen } else { Capture::Missing };
            let (believed, state) = tick(captures);
            prop_assert!(!believed[body] && believed[1 - body]);
            // Ages are multiples of 50 ms: 150 ms is the first over 100, 450 ms the first over 400.
            let expected = match ticks {
                ..=2 => State::Flying,
                3..=8 => State::Coasting,
                _ => State::Holding,
            };
            prop_assert_eq!(state, expected, "after {} ticks", ticks);
        }
    }
}
