//! Each rule of flight by itself.

use super::*;

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

    fn good(&mut self) -> Order {
        self.tick_with(self.seen(), HOVER).1
    }
}

const HOVER: Proposal = Proposal::Command([0.0, 0.0, 1.5]);

fn after(ticks: usize, limits: Limits) -> Flight {
    let mut flight = Flight::new(limits);
    for _ in 0..ticks {
        assert_eq!(
            flight.good(),
            Order {
                setpoint: Some([0.0, 0.0, 1.5]),
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
                setpoint: Some(held),
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
    assert_eq!(order.setpoint, Some([0.1, 0.0, 1.5]));
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
        assert_eq!(order.setpoint, Some([2.2, 0.0, 0.8]));
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
            flight.supervisor.heard_autopilot();
            flight.supervisor.heard_arm();
            flight.good();
        }
        assert_eq!(flight.supervisor.reason(), None);
        let mut ticks = 0;
        while flight.supervisor.reason().is_none() {
            if arm_is_silent {
                flight.supervisor.heard_autopilot();
            } else {
                flight.supervisor.heard_arm();
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
            .all(|order| order.setpoint == Some([1e-3 * 9.0, 0.0, 1.5]))
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
