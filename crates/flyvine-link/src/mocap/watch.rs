//! One body's poses as they come: which are credible, how often, how late.

use std::collections::VecDeque;

use flyvine::flight::quaternion;

use super::hygiene::{HygieneCounts, HygieneLimits, LiveFault};
use super::{BodyPose, LiveFault::*};

/// Displacement beyond which another body counts as moving, m; noise is larger, the rounding of protocols finer.
const MOVING_M: f64 = 1e-4;
/// Time over which the rate is taken, s.
const RATE_WINDOW_S: f64 = 2.0;
/// Delays and steps that are kept for quantiles.
const KEPT: usize = 2000;

/// The newest credible pose, in the server's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Credible {
    /// When it was captured, our clock, s. A body that rests, and repeats its pose as everything else does, is as
    /// fresh as its newest frame.
    pub captured_s: f64,
    pub position: [f64; 3],
    pub attitude: [f64; 4],
}

/// A place where a body appeared that it cannot have reached.
#[derive(Debug, Clone, Copy)]
struct Suspect {
    /// When it left the credible poses, our clock, s.
    left_s: f64,
    /// Since when it has stayed where it appeared.
    since_s: f64,
    captured_s: f64,
    position: [f64; 3],
    attitude: [f64; 4],
    swapped: bool,
}

/// Nonsense that has come of a body since it was last credible, one pose after the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nonsense {
    /// What was wrong with the newest.
    pub fault: LiveFault,
    /// When the first was captured, our clock, s.
    pub since_s: f64,
    /// When the newest was, our clock, s.
    pub newest_s: f64,
}

/// The times of a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stamp {
    /// When it was captured, server clock, s: the order of poses.
    pub server_s: f64,
    /// The same by our clock.
    pub captured_s: f64,
    /// How much later it came than the fastest would have, s.
    pub delay_s: f64,
}

/// Watches one body.
#[derive(Debug)]
pub(super) struct BodyWatch {
    pub name: String,
    limits: HygieneLimits,
    pub credible: Option<Credible>,
    /// What has come since instead, if it was nonsense.
    pub nonsense: Option<Nonsense>,
    /// Where the other bodies were when `credible` first had its value.
    others: Vec<(usize, [f64; 3])>,
    suspect: Option<Suspect>,
    newest_server_s: Option<f64>,
    newest_s: f64,
    pub counts: HygieneCounts,
    /// Poses that came, whatever became of them.
    pub received: u64,
    /// Capture times of the last two seconds.
    recent: VecDeque<f64>,
    /// Delay above the fastest, s, newest last.
    pub delays: VecDeque<f64>,
    /// Longest time between two frames, s.
    pub longest_gap_s: f64,
}

impl BodyWatch {
    pub fn new(name: &str, limits: HygieneLimits) -> Self {
        BodyWatch {
            name: name.to_owned(),
            limits,
            credible: None,
            nonsense: None,
            others: Vec::new(),
            suspect: None,
            newest_server_s: None,
            newest_s: 0.0,
            counts: HygieneCounts::default(),
            received: 0,
            recent: VecDeque::new(),
            delays: VecDeque::new(),
            longest_gap_s: 0.0,
        }
    }

    /// Rate over the last two seconds, Hz; `None` from fewer than two frames.
    pub fn rate_hz(&self) -> Option<f64> {
        let span_s = self.recent.back()? - self.recent.front()?;
        (span_s > 0.0).then(|| (self.recent.len() - 1) as f64 / span_s)
    }

    /// Takes a pose. `others` are the newest credible positions of the other bodies, by their index.
    pub fn take(&mut self, pose: &BodyPose, stamp: Stamp, others: &[(usize, [f64; 3])]) {
        self.received += 1;
        self.delays.push_back(stamp.delay_s);
        if self.delays.len() > KEPT {
            self.delays.pop_front();
        }
        match self.judge(pose, stamp, others) {
            Ok(()) => self.nonsense = None,
            Err(fault) => {
                self.counts.add(fault);
                if fault.is_nonsense() {
                    let newest_s = stamp.captured_s;
                    let since_s = self.nonsense.map_or(newest_s, |nonsense| nonsense.since_s);
                    self.nonsense = Some(Nonsense {
                        fault,
                        since_s,
                        newest_s,
                    });
                }
            }
        }
    }

    /// The server's clock was set: its old time stamps say nothing about the order of new ones.
    pub fn clock_set(&mut self) {
        self.newest_server_s = None;
    }

    fn judge(
        &mut self,
        pose: &BodyPose,
        stamp: Stamp,
        others: &[(usize, [f64; 3])],
    ) -> Result<(), LiveFault> {
        let captured_s = stamp.captured_s;
        if self
            .newest_server_s
            .is_some_and(|newest_s| stamp.server_s <= newest_s)
        {
            return Err(Late);
        }
        self.time(stamp);
        if !pose.tracked {
            return Err(Untracked);
        }
        let numbers = pose.position.iter().chain(&pose.attitude);
        if !numbers.into_iter().all(|number| number.is_finite()) {
            return Err(NotFinite);
        }
        let position = pose.position;
        let mut attitude = quaternion::unit(pose.attitude).map_err(|_| NotUnit)?;
        let Some(last) = self.credible else {
            attitude = quaternion::align([1.0, 0.0, 0.0, 0.0], attitude);
            self.accept(captured_s, position, attitude, others);
            return Ok(());
        };
        let aligned = quaternion::align(last.attitude, attitude);
        let flipped = aligned != attitude;
        attitude = aligned;

        if (position, attitude) == (last.position, last.attitude) {
            return self.repeated(captured_s, others);
        }
        if let Some(fault) = self.implausible(&last, captured_s, position, attitude, others) {
            return self.suspect(fault, captured_s, position, attitude, others);
        }
        self.counts.sign_flip += u64::from(flipped);
        self.accept(captured_s, position, attitude, others);
        Ok(())
    }

    /// Keeps count of the frames' times.
    fn time(
        &mut self,
        Stamp {
            server_s, captured_s, ..
        }: Stamp,
    ) {
        if self.received > 1 {
            let step_s = captured_s - self.newest_s;
            self.longest_gap_s = self.longest_gap_s.max(step_s);
            if self.rate_hz().is_some_and(|rate_hz| step_s * rate_hz > 4.0) {
                self.counts.gap += 1;
            }
        }
        (self.newest_server_s, self.newest_s) = (Some(server_s), captured_s);
        self.recent.push_back(captured_s);
        while self
            .recent
            .front()
            .is_some_and(|oldest| captured_s - oldest > RATE_WINDOW_S)
            && self.recent.len() > 2
        {
            self.recent.pop_front();
        }
    }

    /// The last pose again: credible only while everything else rests too.
    fn repeated(&mut self, captured_s: f64, others: &[(usize, [f64; 3])]) -> Result<(), LiveFault> {
        let moved = others.iter().any(|(index, now)| {
            let then = self.others.iter().find(|(then, _)| then == index);
            then.is_some_and(|(_, then)| distance(*then, *now) > MOVING_M)
        });
        if moved {
            return Err(Frozen);
        }
        if let Some(credible) = &mut self.credible {
            credible.captured_s = captured_s;
        }
        // Bodies that are seen for the first time since.
        for other in others {
            if !self.others.iter().any(|(index, _)| *index == other.0) {
                self.others.push(*other);
            }
        }
        self.suspect = None;
        Ok(())
    }

    /// What is wrong with a pose, seen from the last credible one.
    fn implausible(
        &self,
        last: &Credible,
        captured_s: f64,
        position: [f64; 3],
        attitude: [f64; 4],
        others: &[(usize, [f64; 3])],
    ) -> Option<LiveFault> {
        // The gate opens with time, but not for a pose that has already jumped: it would soon let it in.
        let until_s = self.suspect.map_or(captured_s, |suspect| suspect.left_s);
        let fault = self.step_fault(
            until_s - last.captured_s,
            last.position,
            last.attitude,
            position,
            attitude,
        )?;
        let near = |(_, other): &(usize, [f64; 3])| distance(*other, position) < self.limits.swap_radius_m;
        if fault == Jump && others.iter().any(near) {
            return Some(Swapped);
        }
        Some(fault)
    }

    /// Whether a body can get so far in so long.
    fn step_fault(
        &self,
        step_s: f64,
        from: [f64; 3],
        from_attitude: [f64; 4],
        to: [f64; 3],
        to_attitude: [f64; 4],
    ) -> Option<LiveFault> {
        let limits = &self.limits;
        if distance(from, to) > limits.noise_m + limits.speed_max_m_s * step_s.max(0.0) {
            return Some(Jump);
        }
        let turn_rad = 2.0 * quaternion::dot(from_attitude, to_attitude).abs().min(1.0).acos();
        (turn_rad > limits.turn_noise_rad + limits.turn_rate_max_rad_s * step_s.max(0.0)).then_some(Turn)
    }

    /// Refuses an implausible pose, unless the body has stayed where it appeared for long enough.
    fn suspect(
        &mut self,
        fault: LiveFault,
        captured_s: f64,
        position: [f64; 3],
        attitude: [f64; 4],
        others: &[(usize, [f64; 3])],
    ) -> Result<(), LiveFault> {
        let fresh = Suspect {
            left_s: captured_s,
            since_s: captured_s,
            captured_s,
            position,
            attitude,
            swapped: fault == Swapped,
        };
        let Some(before) = self.suspect else {
            self.suspect = Some(fresh);
            return Err(fault);
        };
        let step_s = captured_s - before.captured_s;
        let stays = self
            .step_fault(step_s, before.position, before.attitude, position, attitude)
            .is_none();
        let swapped = before.swapped || fresh.swapped;
        let patience_s = if swapped {
            self.limits.reacquire_swapped_s
        } else {
            self.limits.reacquire_s
        };
        if stays && captured_s - before.since_s >= patience_s {
            self.counts.reacquired += 1;
            self.accept(captured_s, position, attitude, others);
            return Ok(());
        }
        // The time of staying begins anew with another jump.
        self.suspect = Some(Suspect {
            left_s: before.left_s,
            since_s: if stays { before.since_s } else { captured_s },
            swapped,
            ..fresh
        });
        Err(if before.swapped && stays { Swapped } else { fault })
    }

    fn accept(
        &mut self,
        captured_s: f64,
        position: [f64; 3],
        attitude: [f64; 4],
        others: &[(usize, [f64; 3])],
    ) {
        self.credible = Some(Credible {
            captured_s,
            position,
            attitude,
        });
        self.others.clear();
        self.others.extend(others);
        self.suspect = None;
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests;
