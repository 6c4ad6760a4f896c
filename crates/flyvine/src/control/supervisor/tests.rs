//! Each rule of flight by itself.

use super::*;
use crate::DT;
use crate::flight::{Configuration, Pose};
use crate::link::{Captured, Fault, Health, Observation};

const ARM: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};
const START: Start = Start {
    t_s: 0.0,
    quadrotor: [0.0, 0.0, 1.5],
    end_effector: [0.0, 0.0, 0.8],
};

/// A vehicle that drifts by 1 mm per tick, so that nothing repeats, and a supervisor told about it every
/// tick.
struct Flight {
    supervisor: Supervisor,
    tick: usize,
}

impl Flight {
    fn new(limits: Limits) -> Self {
        Self {
            supervisor: Supervisor::new(limits, START).unwrap(),
            tick: 0,
        }
    }

    fn now(&self) -> f64 {
        self.tick as f64 * DT
    }

    fn seen(&self) -> Observation {
        let x = 1e-3 * self.tick as f64;
        let pose = Pose {
            position: [x, 0.0, 1.5],
            attitude: [1.0, 0.0, 0.0, 0.0],
        };
        Observation {
            t_s: self.now(),
            quadrotor: Some(pose),
            end_effector: Some([x, 0.0, 0.8]),
        }
    }

    fn tick_with(&mut self, observation: Observation, proposal: Proposal) -> (Observation, Order) {
        let credible = self.supervisor.observe(self.now(), &observation, ARM);
        let order = self.supervisor.decide(self.now(), proposal);
        self.tick += 1;
        (credible, order)
    }

    /// The wires at this tick: how long autopilot and arm have been silent, s.
    fn hear(&mut self, autopilot_s: f64, arm_s: f64) {
        let now_s = self.now();
        self.supervisor.hear(&Health {
            autopilot_heard_s: now_s - autopilot_s,
            arm_heard_s: Some(now_s - arm_s),
            ..healthy(now_s)
        });
    }

    fn good(&mut self) -> Order {
        self.tick_with(self.seen(), HOVER).1
    }
}

/// Wires on which all is well, in a mode that nobody has asked for yet.
fn healthy(now_s: f64) -> Health {
    Health {
        now_s,
        captured: Captured {
            quadrotor_s: now_s,
            end_effector_s: now_s,
        },
        autopilot_heard_s: now_s,
        arm_heard_s: Some(now_s),
        missed_ticks: 0,
        armed: true,
        standing: false,
        mode: None,
        fault: None,
    }
}

const HOVER: Proposal = Proposal::Command([0.0, 0.0, 1.5]);

fn after(ticks: usize, limits: Limits) -> Flight {
    let mut flight = Flight::new(limits);
    for _ in 0..ticks {
        assert_eq!(
            flight.good(),
            Order {
                setpoint: Some([0.0, 0.0, 1.5].into()),
                mode: Mode::Offboard
            }
        );
    }
    assert_eq!(flight.supervisor.state(), State::Flying);
    assert!(flight.supervisor.take_events().is_empty());
    flight
}

/// The reason after one tick with a changed observation.
fn reason_for(change: impl Fn(&mut Observation)) -> Option<Reason> {
    let mut flight = after(10, Limits::default());
    let mut observation = flight.seen();
    change(&mut observation);
    flight.tick_with(observation, HOVER);
    flight.supervisor.reason()
}

#[test]
fn missing_poses_coast_after_100_ms_and_abort_after_400() {
    let mut flight = after(10, Limits::default());
    for missed in 1..=9 {
        let observation = Observation {
            end_effector: None,
            ..flight.seen()
        };
        flight.tick_with(observation, HOVER);
        let expected = match missed {
            1..=2 => State::Flying,
            3..=8 => State::Coasting,
            _ => State::Holding,
        };
        assert_eq!(flight.supervisor.state(), expected, "{missed} missed");
    }
    let reason = flight.supervisor.reason();
    assert!(
        matches!(
            reason,
            Some(Reason::StalePose {
                body: Body::EndEffector,
                ..
            })
        ),
        "{reason:?}"
    );
}

#[test]
fn a_pose_that_comes_back_ends_the_coasting() {
    let mut flight = after(10, Limits::default());
    for _ in 0..5 {
        flight.tick_with(
            Observation {
                quadrotor: None,
                ..flight.seen()
            },
            HOVER,
        );
    }
    flight.good();
    assert_eq!(flight.supervisor.state(), State::Flying);
    let kinds: Vec<_> = flight
        .supervisor
        .take_events()
        .into_iter()
        .map(|event| event.kind)
        .collect();
    assert!(matches!(
        kinds[..],
        [
            EventKind::Coasting {
                body: Body::Quadrotor,
                frozen: false,
                ..
            },
            EventKind::Fresh
        ]
    ));
}

#[test]
fn a_frozen_pose_is_not_passed_on_and_aborts() {
    let mut flight = after(10, Limits::default());
    let stuck = flight.seen().end_effector;
    for k in 0..10 {
        let (credible, _) = flight.tick_with(
            Observation {
                end_effector: stuck,
                ..flight.seen()
            },
            HOVER,
        );
        assert_eq!(credible.end_effector.is_some(), k == 0);
    }
    let reason = flight.supervisor.reason();
    assert!(
        matches!(
            reason,
            Some(Reason::FrozenPose {
                body: Body::EndEffector,
                ..
            })
        ),
        "{reason:?}"
    );
}

#[test]
fn old_capture_times_are_old_poses() {
    let mut flight = after(20, Limits::default());
    let observation = Observation {
        t_s: flight.now() - 0.45,
        ..flight.seen()
    };
    flight.tick_with(observation, HOVER);
    assert!(matches!(
        flight.supervisor.reason(),
        Some(Reason::StalePose {
            body: Body::Quadrotor,
            ..
        })
    ));
}

#[test]
fn impossible_poses_end_the_flight_at_once() {
    let quadrotor = Some(Reason::ImpossiblePose(Body::Quadrotor));
    let change =
        |position, attitude| move |o: &mut Observation| o.quadrotor = Some(Pose { position, attitude });
    assert_eq!(
        reason_for(change([0.0, f64::NAN, 1.5], [1.0, 0.0, 0.0, 0.0])),
        quadrotor
    );
    assert_eq!(
        reason_for(change([0.0, 0.0, 1.5], [f64::NAN, 0.0, 0.0, 0.0])),
        quadrotor
    );
    assert_eq!(reason_for(change([0.0, 0.0, 1.5], [0.0; 4])), quadrotor);
    let end_effector = Some(Reason::ImpossiblePose(Body::EndEffector));
    assert_eq!(
        reason_for(|o| o.end_effector = Some([f64::INFINITY, 0.0, 0.8])),
        end_effector
    );
}

#[test]
fn broken_clocks_end_the_flight_at_once() {
    for t_s in [f64::NAN, f64::INFINITY, 1e9] {
        assert!(matches!(reason_for(|o| o.t_s = t_s), Some(Reason::Clock { .. })));
    }
    for now_s in [f64::NAN, 0.1] {
        let mut flight = after(10, Limits::default());
        flight.supervisor.observe(now_s, &flight.seen(), ARM);
        assert!(matches!(flight.supervisor.reason(), Some(Reason::Clock { .. })));
        let mut flight = after(10, Limits::default());
        flight.supervisor.decide(now_s, HOVER);
        assert!(matches!(flight.supervisor.reason(), Some(Reason::Clock { .. })));
    }
}

#[test]
fn leaving_the_room_is_an_abort_that_holds_inside() {
    // Wide speed limits, to get there in one tick.
    let limits = Limits {
        quadrotor_speed_max_m_s: 1e3,
        end_effector_speed_max_m_s: 1e3,
        reach_margin_m: 1e3,
        ..Limits::default()
    };
    for (position, held) in [
        ([2.3, 0.0, 1.5], [2.2, 0.0, 1.5]),
        ([0.0, -2.3, 1.5], [0.0, -2.2, 1.5]),
        ([0.0, 0.0, 2.5], [0.0, 0.0, 2.4]),
        ([0.0, 0.0, 0.7], [0.0, 0.0, 0.8]),
    ] {
        let mut flight = after(3, limits);
        let pose = Pose {
            position,
            attitude: [1.0, 0.0, 0.0, 0.0],
        };
        let (_, order) = flight.tick_with(
            Observation {
                quadrotor: Some(pose),
                ..flight.seen()
            },
            HOVER,
        );
        assert_eq!(
            flight.supervisor.reason(),
            Some(Reason::LeftRoom {
                body: Body::Quadrotor,
                position
            })
        );
        assert_eq!(
            order,
            Order {
                setpoint: Some(held.into()),
                mode: Mode::Offboard
            }
        );
    }
    for position in [[2.3, 0.0, 0.8], [0.0, 2.3, 0.8], [0.0, 0.0, 0.1]] {
        let mut flight = after(3, limits);
        flight.tick_with(
            Observation {
                end_effector: Some(position),
                ..flight.seen()
            },
            HOVER,
        );
        assert_eq!(
            flight.supervisor.reason(),
            Some(Reason::LeftRoom {
                body: Body::EndEffector,
                position
            })
        );
    }
}

#[test]
fn a_tip_beyond_the_arms_reach_is_an_abort() {
    assert_eq!(reason_for(|o| o.end_effector = Some([0.0, 0.0, 0.71])), None);
    let reason = reason_for(|o| o.end_effector = Some([0.0, 0.0, 0.69]));
    assert!(matches!(reason, Some(Reason::Overstretched { .. })), "{reason:?}");
    let mut flight = after(10, Limits::default());
    let no_length = Configuration {
        length_m: f64::NAN,
        pressure_kpa: 0.0,
    };
    flight.supervisor.observe(flight.now(), &flight.seen(), no_length);
    assert!(matches!(
        flight.supervisor.reason(),
        Some(Reason::ArmLength { .. })
    ));
}

#[test]
fn a_jump_is_refused_once_and_ends_the_flight_if_it_stays() {
    let mut flight = after(10, Limits::default());
    for k in 0..2 {
        let mut observation = flight.seen();
        observation.end_effector = Some([0.65, 0.0, 1.2]);
        let (credible, _) = flight.tick_with(observation, HOVER);
        assert_eq!(credible.end_effector, None);
        assert_eq!(flight.supervisor.reason().is_some(), k == 1);
    }
    let reason = flight.supervisor.reason();
    assert!(
        matches!(
            reason,
            Some(Reason::JumpingPose {
                body: Body::EndEffector,
                ..
            })
        ),
        "{reason:?}"
    );
}

#[test]
fn one_late_answer_keeps_the_last_command_and_two_running_abort() {
    let mut flight = after(10, Limits::default());
    flight.tick_with(flight.seen(), Proposal::Command([0.1, 0.0, 1.5]));
    let (_, order) = flight.tick_with(flight.seen(), Proposal::Late);
    assert_eq!(order.setpoint, Some([0.1, 0.0, 1.5].into()));
    flight.good();
    flight.tick_with(flight.seen(), Proposal::Late);
    assert_eq!(flight.supervisor.reason(), None, "late, but not running");
    flight.tick_with(flight.seen(), Proposal::Late);
    assert_eq!(flight.supervisor.reason(), Some(Reason::ControllerLate));
}

#[test]
fn commands_outside_the_room_are_clipped_and_told_once() {
    let mut flight = after(10, Limits::default());
    for _ in 0..3 {
        let (_, order) = flight.tick_with(flight.seen(), Proposal::Command([5.0, 0.0, 0.0]));
        assert_eq!(order.setpoint, Some([2.2, 0.0, 0.8].into()));
    }
    assert_eq!(flight.supervisor.take_events().len(), 1);
}

#[test]
fn silence_of_the_autopilot_or_the_arm_is_an_abort_where_they_are_heard() {
    let limits = Limits {
        autopilot_silence_s: Some(0.3),
        arm_silence_s: Some(0.3),
        ..Limits::default()
    };
    for arm_is_silent in [false, true] {
        let mut flight = Flight::new(limits);
        for _ in 0..20 {
            flight.hear(0.0, 0.0);
            flight.good();
        }
        assert_eq!(flight.supervisor.reason(), None);
        let mut ticks = 0;
        while flight.supervisor.reason().is_none() {
            let silence_s = (ticks + 1) as f64 * DT;
            if arm_is_silent {
                flight.hear(0.0, silence_s);
            } else {
                flight.hear(silence_s, 0.0);
            }
            flight.good();
            ticks += 1;
        }
        assert!(ticks as f64 * DT <= 0.3 + DT + 1e-9, "{ticks} ticks");
        match flight.supervisor.reason() {
            Some(Reason::ArmSilent { .. }) => assert!(arm_is_silent),
            Some(Reason::AutopilotSilent { .. }) => assert!(!arm_is_silent),
            reason => panic!("{reason:?}"),
        }
    }
}

#[test]
fn the_abort_ladder_goes_down_rung_by_rung_and_never_up() {
    let mut flight = after(10, Limits::default());
    flight.supervisor.abort(Reason::Operator);
    flight.supervisor.abort(Reason::ControllerFailed);
    assert_eq!(
        flight.supervisor.reason(),
        Some(Reason::Operator),
        "the first reason stays"
    );
    let aborted_s = flight.supervisor.now_s;
    let mut orders = Vec::new();
    while flight.supervisor.state() != State::Stopped {
        let order = flight.good();
        let elapsed_s = flight.supervisor.now_s - aborted_s + 1e-9;
        let expected = match elapsed_s {
            t if t < 2.0 => Mode::Offboard,
            t if t < 7.0 => Mode::Hold,
            _ => Mode::Land,
        };
        assert_eq!(order.mode, expected, "{elapsed_s} s");
        orders.push(order);
    }
    assert_eq!(orders.len(), 540);
    let (last, streamed) = orders.split_last().unwrap();
    assert_eq!(last.setpoint, None);
    assert!(
        streamed
            .iter()
            .all(|order| order.setpoint == Some([1e-3 * 9.0, 0.0, 1.5].into()))
    );
    assert_eq!(flight.good(), *last);
}

#[test]
fn a_landing_that_is_over_stops_the_stream() {
    let mut flight = after(10, Limits::default());
    flight.supervisor.landed();
    assert_eq!(
        flight.supervisor.state(),
        State::Flying,
        "nobody asked it to land"
    );
    flight.supervisor.abort(Reason::Operator);
    while flight.supervisor.state() != State::Landing {
        flight.good();
    }
    flight.supervisor.landed();
    assert_eq!(flight.good().setpoint, None);
}

#[test]
fn a_landing_that_nobody_confirms_is_no_good_end() {
    let mut flight = after(10, Limits::default());
    flight.supervisor.land();
    while flight.supervisor.state() != State::Stopped {
        flight.good();
    }
    assert_eq!(
        flight.supervisor.reason(),
        Some(Reason::NotLanded { limit_s: 20.0 })
    );
}

#[test]
fn the_age_of_a_pose_is_that_of_its_capture() {
    let mut flight = after(10, Limits::default());
    // A pose that arrives 150 ms late is no fresh pose, however often it arrives.
    for (ticks, expected) in [(1, State::Coasting), (3, State::Coasting), (7, State::Holding)] {
        let mut flight = Flight {
            supervisor: flight.supervisor.clone(),
            ..flight
        };
        let captured_s = flight.now() - 0.15;
        for _ in 0..ticks {
            let now_s = flight.now();
            flight.supervisor.hear(&Health {
                captured: Captured {
                    quadrotor_s: captured_s,
                    end_effector_s: now_s,
                },
                ..healthy(now_s)
            });
            flight.good();
        }
        assert_eq!(flight.supervisor.state(), expected, "{ticks} ticks");
    }
    flight.hear(0.0, 0.0);
    flight.good();
    assert_eq!(flight.supervisor.state(), State::Flying);
}

#[test]
fn somebody_elses_hand_on_the_vehicle_stops_everything() {
    let in_mode = |flight: &mut Flight, armed: bool, mode: Option<Mode>| {
        let now_s = flight.now();
        flight.supervisor.hear(&Health {
            armed,
            mode,
            ..healthy(now_s)
        });
        flight.good()
    };
    for (armed, mode, fault) in [
        (true, None, Fault::TakenOver),
        (true, Some(Mode::Land), Fault::TakenOver),
        (false, Some(Mode::Offboard), Fault::Disarmed),
    ] {
        let mut flight = after(10, Limits::default());
        // A mode that was not confirmed yet is not one that was left.
        in_mode(&mut flight, true, None);
        in_mode(&mut flight, true, Some(Mode::Offboard));
        assert_eq!(flight.supervisor.state(), State::Flying);
        assert_eq!(in_mode(&mut flight, armed, mode).setpoint, None);
        assert_eq!(flight.supervisor.reason(), Some(Reason::Fault(fault)));
    }
}

#[test]
fn below_the_room_an_abort_lands_and_on_the_ground_it_stops() {
    let on_the_ground = Start {
        t_s: 0.0,
        quadrotor: [0.0, 0.0, 0.3],
        end_effector: [0.0, 0.0, 0.05],
    };
    assert!(Supervisor::new(Limits::default(), on_the_ground).is_err());
    let mut standing = Supervisor::standing(Limits::default(), on_the_ground).unwrap();
    let order = standing.decide(0.0, Proposal::Command([0.0, 0.0, 1.5]));
    assert_eq!(
        (order.mode, order.setpoint),
        (Mode::Standby, Some([0.0, 0.0, 1.5].into()))
    );
    let mut climbing = standing.clone();
    climbing.take_off();
    assert_eq!(climbing.decide(0.1, HOVER).mode, Mode::Offboard);
    for (supervisor, state) in [(&mut standing, State::Stopped), (&mut climbing, State::Landing)] {
        supervisor.abort(Reason::Operator);
        assert_eq!(supervisor.state(), state);
    }
    let mut slow = Supervisor::standing(Limits::default(), on_the_ground).unwrap();
    slow.take_off();
    slow.advance(Limits::default().climb_s);
    assert!(matches!(slow.reason(), Some(Reason::NotAirborne { .. })));
}

#[test]
fn velocities_are_those_of_what_is_sent_and_zero_where_it_stands_still() {
    let mut flight = Flight::new(Limits::default());
    flight.supervisor = flight.supervisor.with_feedforward(Feedforward::Velocity);
    let mut sent = |proposal: Proposal| {
        let (_, order) = flight.tick_with(flight.seen(), proposal);
        (order.setpoint.unwrap(), flight.supervisor.take_events())
    };
    let (hover, _) = sent(HOVER);
    assert_eq!(hover.velocity, Some([0.0; 3]));
    let (moved, events) = sent(Proposal::Command([0.1, -0.05, 1.5]));
    let velocity = moved.velocity.unwrap();
    assert!((velocity[0] - 2.0).abs() < 1e-9 && (velocity[1] + 1.0).abs() < 1e-9 && velocity[2] == 0.0);
    assert!(events.is_empty());
    // A tick without an answer repeats the position: it does not move.
    let (late, _) = sent(Proposal::Late);
    assert_eq!((late.position, late.velocity), (moved.position, Some([0.0; 3])));
    // A jump is fed forward no faster than allowed, which is said once.
    let (fast, events) = sent(Proposal::Command([1.1, -0.05, 1.5]));
    assert!((fast.velocity.unwrap()[0] - 6.0).abs() < 1e-9, "{fast:?}");
    let [Event { kind, .. }] = events[..] else {
        panic!("{events:?}")
    };
    assert_eq!(
        kind.to_string(),
        "commands move at 20.00 m/s: fed forward as 6 m/s"
    );
    assert!(sent(Proposal::Command([0.1, -0.05, 1.5])).1.is_empty());
    // What is clipped moves as far as it is sent.
    let (clipped, _) = sent(Proposal::Command([0.1, -0.05, 9.0]));
    assert_eq!(clipped.position[2], 2.4);
    // An abort holds: the jump back to where the vehicle is is no velocity.
    let (held, _) = sent(Proposal::Failed);
    assert_ne!(held.position, clipped.position);
    assert_eq!(held.velocity, Some([0.0; 3]));
}
