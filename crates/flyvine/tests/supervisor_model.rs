//! The supervisor model-checked: every order of events to a stated depth, from every state of a flight.
//!
//! Depth 4 from each of ten starting points by default, 4.8 million ticks; with `-- --ignored`, depth 5, 124 million:
//! `cargo test --release -p flyvine --test supervisor_model -- --ignored`

use flyvine::control::Proposal;
use flyvine::control::supervisor::{Limits, Mode, Order, Room, Start, State, Supervisor};
use flyvine::flight::{Configuration, Pose};
use flyvine::link::{Captured, Fault, Health, Observation};

const ARM: Configuration = Configuration {
    length_m: 0.7,
    pressure_kpa: 0.0,
};
/// A tick so long that every time limit passes within the depth of the search, s.
const TICK_S: f64 = 0.15;
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
    autopilot_silence_s: Some(0.25),
    arm_silence_s: Some(0.25),
    hold_s: 0.3,
    autopilot_hold_s: 0.3,
    landing_s: 0.6,
    climb_s: 1.2,
};

/// What may happen in one tick; everything that is not named is in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Happens {
    Nothing,
    QuadrotorMissing,
    TipMissing,
    TipFrozen,
    OldDatagram,
    Jump,
    NotFinite,
    TipTooLow,
    FarCommand,
    NanCommand,
    Late,
    Failed,
    AutopilotSilent,
    ArmSilent,
    TickLost,
    TicksMissed,
    Disarmed,
    OtherMode,
    HoldMode,
    ArmFault,
    ClockBack,
    StampFromTheFuture,
    TakeOff,
    AtStart,
    Land,
    Operator,
}

use Happens::*;
const ALPHABET: [Happens; 26] = [
    Nothing,
    QuadrotorMissing,
    TipMissing,
    TipFrozen,
    OldDatagram,
    Jump,
    NotFinite,
    TipTooLow,
    FarCommand,
    NanCommand,
    Late,
    Failed,
    AutopilotSilent,
    ArmSilent,
    TickLost,
    TicksMissed,
    Disarmed,
    OtherMode,
    HoldMode,
    ArmFault,
    ClockBack,
    StampFromTheFuture,
    TakeOff,
    AtStart,
    Land,
    Operator,
];

/// The supervisor in its world, and this test's own account of what it has been told.
#[derive(Clone)]
struct World {
    supervisor: Supervisor,
    now_s: f64,
    /// The autopilot does what it was last asked.
    armed: bool,
    mode: Option<Mode>,
    autopilot_heard_s: f64,
    arm_heard_s: f64,
    /// When each body was last seen somewhere new, s.
    seen_s: [f64; 2],
    /// When the frames before this tick were captured, s.
    stamp_s: f64,
    last: [[f64; 3]; 2],
    /// The tip's position as it was last delivered, m.
    delivered_tip: [f64; 3],
    /// Whether the quadrotor was seen at or since the tick in which the tip was last somewhere new.
    tip_has_reference: bool,
    late: u32,
    took_off: bool,
    order: Order,
    history: Vec<Happens>,
}

impl World {
    fn new(standing: bool) -> Self {
        let height = if standing { 0.75 } else { 1.5 };
        let start = Start {
            t_s: 0.0,
            quadrotor: [0.0, 0.0, height],
            end_effector: [0.0, 0.0, height - 0.7],
        };
        let supervisor = match standing {
            true => Supervisor::standing(LIMITS, start),
            false => Supervisor::new(LIMITS, start),
        };
        Self {
            supervisor: supervisor.unwrap(),
            now_s: 0.0,
            armed: !standing,
            mode: (!standing).then_some(Mode::Offboard),
            autopilot_heard_s: 0.0,
            arm_heard_s: 0.0,
            seen_s: [0.0; 2],
            stamp_s: 0.0,
            last: [start.quadrotor, start.end_effector],
            delivered_tip: start.end_effector,
            tip_has_reference: false,
            late: 0,
            took_off: !standing,
            order: Order {
                setpoint: None,
                mode: Mode::Standby,
            },
            history: Vec::new(),
        }
    }

    /// Whether poses were taken in before this tick.
    fn was_seen_before(&self) -> bool {
        let before = &self.history[..self.history.len() - 1];
        before
            .iter()
            .any(|happens| !matches!(happens, StampFromTheFuture | ClockBack))
    }

    /// The poses of this tick: the vehicle drifts by a millimetre all the time.
    fn observe(&mut self, happens: Happens) -> (Observation, Captured) {
        let moved = self.last.map(|[x, y, z]| [x + 1e-3, y, z]);
        let mut seen = moved;
        match happens {
            Jump => seen[0][0] += 3.0,
            NotFinite => seen[1][2] = f64::NAN,
            TipTooLow => seen[1][2] = 0.1,
            TipFrozen => seen[1] = self.delivered_tip,
            _ => (),
        }
        // A pose that repeats is a body at rest, unless the other is known to have moved since it was new.
        let alone = !self.tip_has_reference;
        let shown = match happens {
            NotFinite => [false, false],
            OldDatagram if self.was_seen_before() => [false, false],
            Jump => [false, true],
            TipFrozen => [true, alone],
            _ => [happens != QuadrotorMissing, happens != TipMissing],
        };
        let quadrotor_shown = shown[0] || happens == Jump;
        if shown[1] && happens != TipFrozen {
            self.tip_has_reference = quadrotor_shown;
        } else {
            self.tip_has_reference |= quadrotor_shown;
        }
        if shown[1] || happens == TipFrozen {
            self.delivered_tip = seen[1];
        }
        for body in 0..2 {
            if shown[body] {
                // A tip that hung too low is back in its place at the next tick.
                self.last[body] = if happens == TipTooLow {
                    moved[body]
                } else {
                    seen[body]
                };
                self.seen_s[body] = self.now_s;
            }
        }
        let captured_s = match happens {
            OldDatagram => self.stamp_s,
            StampFromTheFuture => self.now_s + 1.0,
            _ => self.now_s,
        };
        // What came with a broken clock was never taken in, and an old datagram brings nothing new.
        if !matches!(happens, StampFromTheFuture | ClockBack | OldDatagram) {
            self.stamp_s = self.now_s;
        }
        let attitude = [1.0, 0.0, 0.0, 0.0];
        let observation = Observation {
            t_s: self.now_s,
            quadrotor: (happens != QuadrotorMissing).then_some(Pose {
                position: seen[0],
                attitude,
            }),
            end_effector: (happens != TipMissing).then_some(seen[1]),
        };
        let captured = Captured {
            quadrotor_s: captured_s,
            end_effector_s: captured_s,
        };
        (observation, captured)
    }

    fn tick(&mut self, happens: Happens) {
        self.history.push(happens);
        let before = (self.supervisor.state(), self.supervisor.reason().is_some());
        let held = self.supervisor.setpoint().position;
        self.now_s += TICK_S;
        let told_s = if happens == ClockBack {
            self.now_s - 1.0
        } else {
            self.now_s
        };
        if happens != AutopilotSilent {
            self.autopilot_heard_s = self.now_s;
        }
        if happens != ArmSilent {
            self.arm_heard_s = self.now_s;
        }
        // An autopilot that does as it is told, one tick later.
        match self.order.mode {
            Mode::Standby => (),
            mode => (self.armed, self.mode) = (true, Some(mode)),
        }
        match happens {
            Disarmed => self.armed = false,
            OtherMode => self.mode = None,
            HoldMode => self.mode = Some(Mode::Hold),
            _ => (),
        }
        match happens {
            TakeOff => self.supervisor.take_off(),
            AtStart => {
                self.supervisor.at_start();
                let [quadrotor, tip] = &mut self.last;
                (quadrotor[2], tip[2]) = (1.5, 0.8);
            }
            Land => self.supervisor.land(),
            Operator => self
                .supervisor
                .abort(flyvine::control::supervisor::Reason::Operator),
            _ => (),
        }
        self.took_off |= happens == TakeOff;
        let called = (self.supervisor.state(), self.supervisor.reason().is_some());
        let (observation, captured) = self.observe(happens);
        self.supervisor.hear(&Health {
            now_s: told_s,
            captured,
            autopilot_heard_s: self.autopilot_heard_s,
            arm_heard_s: Some(self.arm_heard_s),
            missed_ticks: match happens {
                TickLost => 1,
                TicksMissed => 2,
                _ => 0,
            },
            armed: self.armed,
            standing: !self.armed,
            mode: self.mode,
            fault: (happens == ArmFault).then_some(Fault::Arm { code: 1 }),
        });
        let credible = self.supervisor.observe(told_s, &observation, ARM);
        let proposal = match happens {
            FarCommand => Proposal::Command([9.0, -9.0, 9.0]),
            NanCommand => Proposal::Command([0.0, f64::NAN, 1.5]),
            Late => Proposal::Late,
            Failed => Proposal::Failed,
            _ => Proposal::Command([0.0, 0.0, 1.5]),
        };
        self.late = if happens == Late { self.late + 1 } else { 0 };
        self.order = self.supervisor.decide(told_s, proposal);
        self.check(happens, before, called, held, &observation, &credible);
    }

    fn check(
        &self,
        happens: Happens,
        before: (State, bool),
        called: (State, bool),
        held: [f64; 3],
        observation: &Observation,
        credible: &Observation,
    ) {
        let (state, reason) = (self.supervisor.state(), self.supervisor.reason());
        let history = &self.history;
        // Whatever leaves is in the room, and something leaves until the stop.
        match self.order.setpoint {
            Some(setpoint) => assert!(
                LIMITS.room.holds_quadrotor(setpoint.position),
                "{setpoint:?} {history:?}"
            ),
            None => assert_eq!(state, State::Stopped, "{history:?}"),
        }
        assert_eq!(
            self.order.setpoint.is_none(),
            state == State::Stopped,
            "{history:?}"
        );
        // Nothing is armed before somebody says so.
        if !self.took_off {
            assert!(
                matches!(state, State::Standing | State::Stopped),
                "{state:?} {history:?}"
            );
        }
        let mode = match state {
            State::Standing => Mode::Standby,
            State::Climbing | State::Flying | State::Coasting | State::Holding => Mode::Offboard,
            State::AutopilotHold => Mode::Hold,
            State::Landing | State::Stopped => Mode::Land,
        };
        assert_eq!(self.order.mode, mode, "{history:?}");
        // A flight that was ended never goes on, and only ended flights are on the ladder.
        assert!(reason.is_some() || !called.1, "{history:?}");
        assert!(
            reason.is_none()
                || matches!(
                    state,
                    State::Holding | State::AutopilotHold | State::Landing | State::Stopped
                ),
            "{state:?} {history:?}"
        );
        assert!(
            rank(state) >= rank(before.0),
            "{:?} to {state:?} {history:?}",
            before.0
        );
        if matches!(state, State::Holding | State::AutopilotHold) {
            assert!(reason.is_some(), "{history:?}");
            if before.1 {
                assert_eq!(
                    self.supervisor.setpoint().position,
                    held,
                    "a hold that moves: {history:?}"
                );
            }
        }
        // Whatever is believed was seen, this tick, and is finite. The first datagram of all is not an old one.
        let is_old = happens == OldDatagram && self.was_seen_before();
        if let Some(pose) = credible.quadrotor {
            assert_eq!(Some(pose), observation.quadrotor);
            assert!(
                !is_old && pose.position.iter().all(|x| x.is_finite()),
                "{history:?}"
            );
        }
        if let Some(tip) = credible.end_effector {
            assert!(!is_old && tip.iter().all(|x| x.is_finite()), "{history:?}");
        }
        // From here on: what must have ended the flight, if there still was one.
        if called.0 == State::Stopped {
            return;
        }
        let is_told = match happens {
            NotFinite | NanCommand | Failed | TicksMissed | ArmFault | ClockBack | StampFromTheFuture
            | Operator => true,
            TipTooLow => !matches!(called.0, State::Standing | State::Climbing | State::Landing),
            Late => self.late >= 2,
            _ => false,
        };
        // A proposal is only looked at while there is somebody whose proposals count.
        let landed = state == State::Stopped && called.0 == State::Landing;
        assert!(!is_told || reason.is_some() || landed, "{happens:?} {history:?}");
        let oldest_s = self.seen_s.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        let is_stale = self.now_s - oldest_s > LIMITS.abort_age_s + 1e-6;
        let is_silent = self.now_s - self.autopilot_heard_s.min(self.arm_heard_s) > 0.25 + 1e-6;
        let stopped_in_good_order = state == State::Stopped && reason.is_none();
        if (is_stale || is_silent) && happens != ClockBack && !stopped_in_good_order {
            assert!(
                reason.is_some(),
                "stale {is_stale}, silent {is_silent}: {history:?}"
            );
        }
    }
}

/// States are passed in this order only; flying and coasting alternate.
fn rank(state: State) -> u8 {
    match state {
        State::Standing => 0,
        State::Climbing => 1,
        State::Flying | State::Coasting => 2,
        State::Holding => 3,
        State::AutopilotHold => 4,
        State::Landing => 5,
        State::Stopped => 6,
    }
}

/// Goes through all orders of `depth` events from `world`; gives the number of ticks.
fn explore(world: &World, depth: usize) -> usize {
    if depth == 0 {
        return 0;
    }
    ALPHABET
        .iter()
        .map(|&happens| {
            let mut next = world.clone();
            next.tick(happens);
            1 + explore(&next, depth - 1)
        })
        .sum()
}

/// Every state of a flight, and some that have a past.
fn starting_points() -> Vec<World> {
    let after = |standing: bool, events: &[Happens], state: State| {
        let mut world = World::new(standing);
        for &happens in events {
            world.tick(happens);
        }
        assert_eq!(world.supervisor.state(), state, "{events:?}");
        world
    };
    let holding = [Nothing, Nothing, Operator];
    let hold_by_itself = [Nothing, Nothing, Operator, Nothing, Nothing];
    let landing_after_abort = [Nothing, Nothing, Operator, Nothing, Nothing, Nothing, Nothing];
    vec![
        after(true, &[], State::Standing),
        after(true, &[Nothing, Nothing], State::Standing),
        after(true, &[Nothing, TakeOff], State::Climbing),
        after(
            true,
            &[Nothing, TakeOff, Nothing, AtStart, Nothing],
            State::Flying,
        ),
        after(false, &[Nothing, Nothing, Nothing], State::Flying),
        after(false, &[Nothing, TipMissing, TipMissing], State::Coasting),
        after(false, &holding, State::Holding),
        after(false, &hold_by_itself, State::AutopilotHold),
        after(false, &landing_after_abort, State::Landing),
        after(false, &[Nothing, Nothing, Land], State::Landing),
    ]
}

fn explore_all(depth: usize) -> usize {
    starting_points().iter().map(|world| explore(world, depth)).sum()
}

#[test]
fn the_rules_hold_for_every_order_of_four_events() {
    let per_start: usize = (1..=4).map(|depth| ALPHABET.len().pow(depth)).sum();
    assert_eq!(explore_all(4), 10 * per_start);
}

#[test]
#[ignore = "124 million ticks: minutes"]
fn the_rules_hold_for_every_order_of_five_events() {
    explore_all(5);
}
