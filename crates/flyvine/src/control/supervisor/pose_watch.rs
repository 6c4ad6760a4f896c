//! Whether one body's poses can be believed, and how old the newest credible one is.

use crate::DT;

/// Displacement beyond which a command or a body counts as moving, m. Motion capture is noisier than this,
/// and the rounding of text protocols is finer.
const MOVING_M: f64 = 1e-4;
/// Jumping poses in a row that end the flight; one alone is refused and counts as missing.
const JUMPS_TO_ABORT: u32 = 2;

/// What motion capture says of one body: its position, m, and for the quadrotor its attitude.
pub(super) type Seen = ([f64; 3], Option<[f64; 4]>);

/// Verdict on what was seen of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Verdict {
    Credible,
    Missing,
    /// Exactly the last pose again, while the command or the other body moved.
    Frozen,
    /// Farther from the last credible pose than the body can fly.
    Jump {
        distance_m: f64,
        limit_m: f64,
        /// Enough of them in a row to end the flight.
        last: bool,
    },
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PoseWatch {
    speed_max_m_s: f64,
    /// The last credible pose, and when it was taken, s.
    seen: Seen,
    seen_s: f64,
    frozen: bool,
    /// Poses refused as jumps since, and when the first of them was taken, s.
    jumps: u32,
    jumped_s: f64,
    /// Since `seen` first had its value: the command then held, the other body's position then (or when it
    /// was first seen after), and whether one of them has moved away from there.
    command: [f64; 3],
    other: Option<[f64; 3]>,
    moving: bool,
}

impl PoseWatch {
    /// Starts from a position known at `start_s`.
    pub(super) fn new(speed_max_m_s: f64, position: [f64; 3], start_s: f64, command: [f64; 3]) -> Self {
        Self {
            speed_max_m_s,
            seen: (position, None),
            seen_s: start_s,
            frozen: false,
            jumps: 0,
            jumped_s: start_s,
            command,
            other: None,
            moving: false,
        }
    }

    /// Judges what was seen at `capture_s`, with the command held until then and the other body's position.
    pub(super) fn judge(
        &mut self,
        capture_s: f64,
        seen: Option<Seen>,
        command: [f64; 3],
        other: Option<[f64; 3]>,
    ) -> Verdict {
        self.moving |= distance(command, self.command) > MOVING_M;
        match (self.other, other) {
            (Some(then), Some(now)) => self.moving |= distance(now, then) > MOVING_M,
            (None, now) => self.other = now,
            (_, None) => (),
        }
        let Some(seen) = seen else {
            return Verdict::Missing;
        };
        self.frozen = seen == self.seen && self.moving;
        if self.frozen {
            return Verdict::Frozen;
        }
        let distance_m = distance(seen.0, self.seen.0);
        // The gate opens with the age of the last credible pose, but not for a pose that has just jumped: it
        // would soon be wide enough to let it in.
        let until_s = if self.jumps == 0 { capture_s } else { self.jumped_s };
        let limit_m = self.speed_max_m_s * (until_s - self.seen_s).max(DT);
        if distance_m > limit_m {
            self.jumps += 1;
            self.jumped_s = until_s;
            return Verdict::Jump {
                distance_m,
                limit_m,
                last: self.jumps >= JUMPS_TO_ABORT,
            };
        }
        if seen != self.seen {
            (self.command, self.other, self.moving) = (command, other, false);
        }
        (self.seen, self.seen_s, self.jumps) = (seen, capture_s, 0);
        Verdict::Credible
    }

    /// Age of the newest credible pose, s.
    pub(super) fn age_s(&self, now_s: f64) -> f64 {
        now_s - self.seen_s
    }

    /// Whether the last pose seen was frozen.
    pub(super) fn is_frozen(&self) -> bool {
        self.frozen
    }

    /// Position in the newest credible pose, m.
    pub(super) fn position(&self) -> [f64; 3] {
        self.seen.0
    }
}

pub(super) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const REST: [f64; 3] = [0.0, 0.0, 1.5];
    const TIP: Option<[f64; 3]> = Some([0.0, 0.0, 0.8]);

    fn watch() -> PoseWatch {
        PoseWatch::new(8.0, REST, 0.0, REST)
    }

    fn at(x: f64) -> Option<Seen> {
        Some(([x, 0.0, 1.5], Some([1.0, 0.0, 0.0, 0.0])))
    }

    #[test]
    fn a_still_vehicle_may_repeat_its_pose() {
        let mut watch = watch();
        for k in 0..100 {
            assert_eq!(watch.judge(k as f64 * DT, at(0.0), REST, TIP), Verdict::Credible);
        }
        assert_eq!(watch.age_s(99.0 * DT), 0.0);
    }

    #[test]
    fn a_repeated_pose_is_frozen_once_the_command_or_the_other_body_moves() {
        for (command, other) in [([0.1, 0.0, 1.5], TIP), (REST, Some([0.0, 0.01, 0.8]))] {
            let mut watch = watch();
            for k in 0..10 {
                assert_eq!(watch.judge(k as f64 * DT, at(0.0), REST, TIP), Verdict::Credible);
            }
            // Moving away counts even when it comes back: the pose should have moved too.
            assert_eq!(watch.judge(10.0 * DT, at(0.0), command, other), Verdict::Frozen);
            assert_eq!(watch.judge(11.0 * DT, at(0.0), REST, TIP), Verdict::Frozen);
            assert!(
                (watch.age_s(11.0 * DT) - 2.0 * DT).abs() < 1e-12,
                "age runs from the last believed pose"
            );
            assert_eq!(watch.judge(12.0 * DT, at(1e-9), REST, TIP), Verdict::Credible);
            assert_eq!(watch.judge(13.0 * DT, at(1e-9), REST, TIP), Verdict::Credible);
        }
    }

    #[test]
    fn slow_motion_of_the_other_body_adds_up() {
        let mut watch = watch();
        let frozen = (0..20).position(|k| {
            watch.judge(k as f64 * DT, at(0.0), REST, Some([3e-5 * k as f64, 0.0, 0.8])) == Verdict::Frozen
        });
        assert_eq!(frozen, Some(4));
    }

    #[test]
    fn one_jump_is_refused_and_the_second_in_a_row_is_the_last() {
        let mut watch = watch();
        watch.judge(0.0, at(0.0), REST, TIP);
        assert!(matches!(
            watch.judge(DT, at(0.5), REST, TIP),
            Verdict::Jump { last: false, .. }
        ));
        assert_eq!(watch.judge(2.0 * DT, at(0.1), REST, TIP), Verdict::Credible);
        assert!(matches!(
            watch.judge(3.0 * DT, at(1.0), REST, TIP),
            Verdict::Jump { last: false, .. }
        ));
        assert_eq!(watch.judge(4.0 * DT, None, REST, TIP), Verdict::Missing);
        assert!(matches!(
            watch.judge(5.0 * DT, at(1.5), REST, TIP),
            Verdict::Jump { last: true, .. }
        ));
    }
}
