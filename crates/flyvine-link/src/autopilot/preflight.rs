//! The check before a flight: everything that must be so, from what was heard and what is planned. Pure.

use flyvine::DT;
use flyvine::control::Trajectory;
use flyvine::control::supervisor::Limits;

use super::arm_link::ArmTelemetry;
use super::checklist::{Checklist, Item};
use super::pose_source::LatestPoses;
use super::profile::Profile;
use super::telemetry::Telemetry;

/// How long motion capture is watched, s.
pub const WATCH_S: f64 = 1.5;
/// Slowest motion capture that is good enough, new poses per second and body.
const RATE_MIN_HZ: f64 = 20.0;
/// How far the autopilot's own position may be from motion capture, m.
const AGREEMENT_M: f64 = 0.1;
/// How far from under the plan's start the vehicle may stand, m.
const UNDER_START_M: f64 = 0.5;
/// Least battery, percent.
const BATTERY_MIN_PERCENT: f64 = 30.0;

/// What was seen of motion capture in [`WATCH_S`], one entry per body: quadrotor, end effector.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MocapWatch {
    /// New poses.
    pub poses: [usize; 2],
    /// Oldest that the newest pose ever was, s.
    pub oldest_s: [f64; 2],
    /// Time of watching, s.
    pub watched_s: f64,
    newest_s: [f64; 2],
}

impl MocapWatch {
    /// Takes in what was the newest at `now_s`, `elapsed_s` after the last call.
    pub fn see(&mut self, now_s: f64, elapsed_s: f64, latest: &LatestPoses) {
        self.watched_s += elapsed_s;
        let stamps = [
            latest.quadrotor.map(|stamped| stamped.captured_s),
            latest.end_effector.map(|stamped| stamped.captured_s),
        ];
        for (body, stamp) in stamps.into_iter().enumerate() {
            let Some(captured_s) = stamp else {
                self.oldest_s[body] = f64::INFINITY;
                continue;
            };
            if captured_s != self.newest_s[body] {
                self.poses[body] += 1;
                self.newest_s[body] = captured_s;
            }
            self.oldest_s[body] = self.oldest_s[body].max(now_s - captured_s);
        }
    }
}

/// All that the check looks at.
pub struct Findings<'a> {
    /// Which autopilot is expected.
    pub profile: Profile,
    /// What the autopilot said.
    pub telemetry: &'a Telemetry,
    /// The time of the check, s.
    pub now_s: f64,
    /// What was seen of motion capture.
    pub watch: MocapWatch,
    /// The newest poses.
    pub latest: LatestPoses,
    /// What the arm said, where there is one on the wire.
    pub arm: Option<ArmTelemetry>,
    /// What shall be flown.
    pub trajectory: &'a Trajectory,
    /// Within which limits.
    pub limits: &'a Limits,
}

/// Goes through the list.
pub fn check(findings: &Findings) -> Checklist {
    let mut list = Checklist::default();
    check_autopilot(findings, &mut list);
    if findings.telemetry.identity.is_some() {
        check_parameters(findings, &mut list);
    }
    check_mocap(findings, &mut list);
    check_arm(findings, &mut list);
    check_plan(findings, &mut list);
    list
}

fn check_autopilot(findings: &Findings, list: &mut Checklist) {
    let Telemetry {
        identity,
        armed,
        custom_mode,
        heartbeat_s,
        ..
    } = findings.telemetry;
    let expected = match findings.profile {
        Profile::Px4 => "the heartbeat of a PX4",
        Profile::ArduPilot => "the heartbeat of an ArduPilot",
    };
    let Some(autopilot) = identity else {
        let why = "nobody answers: is it powered, on this address, and with the same signing key?";
        list.must("autopilot", false, "silence", expected, why);
        return;
    };
    list.must(
        "autopilot",
        findings.now_s - heartbeat_s < 2.5,
        format!(
            "system {}, heartbeat {:.1} s ago",
            autopilot.system,
            findings.now_s - heartbeat_s
        ),
        expected,
        "a link that was lost before the flight is lost in it",
    );
    list.must(
        "disarmed",
        !armed,
        if *armed { "armed" } else { "disarmed" },
        "disarmed",
        "motors that somebody else armed are somebody else's to command",
    );
    let following = findings.profile.mode(*custom_mode) == Some(flyvine::link::Mode::Offboard);
    list.must(
        "mode",
        !following || findings.profile == Profile::ArduPilot,
        format!("custom mode {custom_mode:#x}"),
        "any but OFFBOARD",
        "a switch that already stands on OFFBOARD would make the vehicle jump at the first set-point",
    );
    list.must(
        "global origin",
        findings.telemetry.has_origin,
        if findings.telemetry.has_origin {
            "set"
        } else {
            "not set"
        },
        "set",
        "without one the autopilot refuses Hold, a rung of the abort ladder",
    );
    if let Some(percent) = findings.telemetry.battery_percent {
        let why = "the plan must end before the battery does";
        let expected = format!("at least {BATTERY_MIN_PERCENT} %");
        list.must(
            "battery",
            percent >= BATTERY_MIN_PERCENT,
            format!("{percent} %"),
            expected,
            why,
        );
    }
}

fn check_parameters(findings: &Findings, list: &mut Checklist) {
    for rule in findings.profile.rules() {
        let value = findings.telemetry.parameters.get(rule.name);
        list.items.push(Item {
            name: rule.name.to_owned(),
            good: value.is_some_and(|value| rule.expected.holds(*value)),
            found: value.map_or("no answer".to_owned(), f64::to_string),
            expected: rule.expected.to_string(),
            weight: rule.weight,
            why: rule.why,
        });
    }
}

fn check_mocap(findings: &Findings, list: &mut Checklist) {
    let watch = &findings.watch;
    for (body, name) in ["mocap: quadrotor", "mocap: end effector"]
        .into_iter()
        .enumerate()
    {
        let rate_hz = watch.poses[body] as f64 / watch.watched_s.max(DT);
        let (age_s, limit_s) = (watch.oldest_s[body], findings.limits.coast_age_s);
        let seen = [
            findings.latest.quadrotor.is_some(),
            findings.latest.end_effector.is_some(),
        ][body];
        let found = match seen {
            true => format!("{rate_hz:.0} poses/s, at most {:.0} ms old", 1e3 * age_s),
            false => "no pose".to_owned(),
        };
        list.must(
            name,
            seen && rate_hz >= RATE_MIN_HZ && age_s <= limit_s,
            found,
            format!(
                "at least {RATE_MIN_HZ} poses/s, at most {:.0} ms old",
                1e3 * limit_s
            ),
            "nothing else knows where the vehicle is; the flight ends when poses are older than 400 ms",
        );
    }
    let (Some(seen), Some(believed)) = (findings.latest.quadrotor, findings.telemetry.position) else {
        if findings.telemetry.identity.is_some() {
            let why = "an autopilot that does not fuse external vision does not hold its position";
            list.must("autopilot's position", false, "none", "an estimate", why);
        }
        return;
    };
    let apart_m = distance(seen.value.position, believed.value);
    list.must(
        "autopilot's position",
        apart_m <= AGREEMENT_M,
        format!("{apart_m:.3} m from motion capture"),
        format!("at most {AGREEMENT_M} m"),
        "if they disagree, an axis is swapped or the filter does not fuse vision: the first set-point would be a jump",
    );
}

fn check_arm(findings: &Findings, list: &mut Checklist) {
    let (Some(arm), Some(limit_s)) = (findings.arm, findings.limits.arm_silence_s) else {
        return;
    };
    let age_s = findings.now_s - arm.heard_s;
    list.must(
        "arm",
        age_s <= limit_s && arm.fault().is_none(),
        match arm.fault() {
            Some(code) => format!("fault {code}"),
            None => format!("heard {:.0} ms ago", 1e3 * age_s),
        },
        format!("heard within {:.0} ms, no fault", 1e3 * limit_s),
        "an arm that does not answer may go on growing",
    );
}

fn check_plan(findings: &Findings, list: &mut Checklist) {
    let (trajectory, room) = (findings.trajectory, &findings.limits.room);
    let knots = trajectory.knots();
    let outside = (0..knots).find(|&knot| {
        let tip = trajectory.state(knot);
        !room.holds_quadrotor(trajectory.command(knot.min(knots - 2)))
            || !room.holds_end_effector([tip[6], tip[7], tip[8]])
    });
    list.must(
        "plan in the room",
        outside.is_none(),
        outside.map_or("all of it".to_owned(), |knot| format!("knot {knot} is outside")),
        "commands and predicted tip in the room",
        "the supervisor would cut it off in the middle of the flight",
    );
    let fastest = (1..knots - 1)
        .map(|knot| distance(trajectory.command(knot), trajectory.command(knot - 1)) / DT)
        .fold(0.0, f64::max);
    let limit = findings.limits.quadrotor_speed_max_m_s;
    list.must(
        "plan's speed",
        fastest <= limit,
        format!("commands move at up to {fastest:.2} m/s"),
        format!("at most {limit} m/s"),
        "poses that move faster are refused as jumps",
    );
    if let Some(seen) = findings.latest.quadrotor {
        let (at, start) = (seen.value.position, trajectory.start().0);
        let apart_m = (at[0] - start[0]).hypot(at[1] - start[1]);
        list.must(
            "place",
            apart_m <= UNDER_START_M && at[2] <= start[2] + 0.1,
            format!(
                "{apart_m:.2} m beside the plan's start, at a height of {:.2} m",
                at[2]
            ),
            format!("within {UNDER_START_M} m, below the start"),
            "the way up is straight to the start",
        );
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}
