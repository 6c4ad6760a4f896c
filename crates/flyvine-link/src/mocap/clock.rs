//! Whose clock is it? The offset between a server's clock and ours, from one-way delays.
//!
//! Each frame gives a delay `d = t_here − t_server`: the clocks' offset, plus the transport, which is never
//! negative. So the offset lies on or below all delays, and near the smallest. The filter keeps the smallest delay
//! of each second (the minimum-delay filter of NTP; D. Mills, RFC 5905, §10) for half a minute, and takes the line below all of
//! them that is closest to them on average: the edge of their lower convex hull under their mean time (S. Moon, P. Skelly,
//! D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999). Its slope is
//! the drift.
//!
//! What no one-way measurement can see is the smallest transport delay itself: ages are too small by it (some 0.1 ms
//! on a wired network) and by the cameras' own latency, where the server stamps frames later than their exposure.

use std::collections::VecDeque;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use serde::Serialize;

/// One smallest delay is kept per so many seconds.
const BIN_S: f64 = 1.0;
/// So many of them.
const BINS: usize = 30;
/// No drift is estimated from less, s.
const SHORTEST_BASE_S: f64 = 8.0;
/// Fastest drift that is believed; crystals stay below 100 ppm, clocks that are being disciplined below 500 ppm.
const DRIFT_MAX: f64 = 500e-6;
/// A delay smaller than expected by more than this is no faster transport: the server's clock was set.
const EARLY_S: f64 = 0.05;
/// Delays larger by more than this …
const LATE_S: f64 = 0.5;
/// … for so long mean the same, s.
const LATE_FOR_S: f64 = 2.0;

/// The time from `origin` to `instant`, s; negative if that is earlier.
pub(crate) fn seconds_since(origin: Instant, instant: Instant) -> f64 {
    match instant.checked_duration_since(origin) {
        Some(since) => since.as_secs_f64(),
        None => -(origin - instant).as_secs_f64(),
    }
}

/// Unix time, s.
pub(super) fn unix_s() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}

/// What is known of the server's clock.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClockEstimate {
    /// Our clock minus the server's, s, at the newest frame; our clock counts from the start of the source.
    pub offset_s: f64,
    /// How fast the offset grows, parts per million; 0 until some seconds of frames have come.
    pub drift_ppm: f64,
    /// How long it has been watched, s, at most half a minute.
    pub window_s: f64,
    /// How often the server's clock was set.
    pub steps: u32,
}

/// Estimates the offset of a server's clock.
#[derive(Debug, Clone, Default)]
pub struct ClockFilter {
    /// The smallest delay of each second: `(t_server, d)`.
    smallest: VecDeque<(f64, f64)>,
    /// Offset at a server time, and slope.
    line: Option<Line>,
    newest_s: f64,
    /// Since when all delays have been late, our clock, s.
    late_since: Option<f64>,
    steps: u32,
}

#[derive(Debug, Clone, Copy)]
struct Line {
    at_s: f64,
    offset_s: f64,
    slope: f64,
}

impl Line {
    fn at(&self, server_s: f64) -> f64 {
        self.offset_s + self.slope * (server_s - self.at_s)
    }
}

impl ClockFilter {
    /// Takes a frame sent at `server_s` (its clock) that arrived at `here_s` (ours), both finite; returns by how much it came
    /// later than the fastest could have, s, never negative.
    pub fn observe(&mut self, server_s: f64, here_s: f64) -> f64 {
        let delay = here_s - server_s;
        if let Some(line) = self.line {
            let excess = delay - line.at(server_s);
            if excess < LATE_S {
                self.late_since = None;
            }
            let late_since = if excess >= LATE_S {
                *self.late_since.get_or_insert(here_s)
            } else {
                here_s
            };
            if excess < -EARLY_S || here_s - late_since > LATE_FOR_S {
                *self = ClockFilter {
                    steps: self.steps + 1,
                    ..ClockFilter::default()
                };
            }
        }
        self.newest_s = server_s;
        if self.keep(server_s, delay) {
            self.line = Some(self.fit());
        }
        let line = self.line.expect("the first delay is kept");
        (delay - line.at(server_s)).max(0.0)
    }

    /// When a frame of this server time was captured, our clock, s; `None` before the first frame.
    pub fn here_s(&self, server_s: f64) -> Option<f64> {
        Some(server_s + self.line?.at(server_s))
    }

    /// What is known; `None` before the first frame.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        let line = self.line?;
        Some(ClockEstimate {
            offset_s: line.at(self.newest_s),
            drift_ppm: 1e6 * line.slope,
            window_s: self.newest_s - self.smallest.front()?.0,
            steps: self.steps,
        })
    }

    /// Whether the smallest delays changed.
    fn keep(&mut self, server_s: f64, delay: f64) -> bool {
        let bin = |time: f64| (time / BIN_S).floor();
        match self.smallest.back_mut() {
            Some(newest) if bin(newest.0) >= bin(server_s) => {
                if delay >= newest.1 {
                    return false;
                }
                *newest = (server_s.max(newest.0), delay);
            }
            _ => self.smallest.push_back((server_s, delay)),
        }
        if self.smallest.len() > BINS {
            self.smallest.pop_front();
        }
        true
    }

    /// The line below all smallest delays that is closest to them on average.
    fn fit(&self) -> Line {
        let points = &self.smallest;
        let count = points.len() as f64;
        let mean_s = points.iter().map(|(time, _)| time / count).sum::<f64>();
        let base_s = points.back().map_or(0.0, |newest| newest.0 - points[0].0);
        let slope = if base_s >= SHORTEST_BASE_S {
            hull_slope(points, mean_s).clamp(-DRIFT_MAX, DRIFT_MAX)
        } else {
            0.0
        };
        let offset_s = points
            .iter()
            .map(|(time, delay)| delay - slope * (time - mean_s))
            .fold(f64::INFINITY, f64::min);
        Line {
            at_s: mean_s,
            offset_s,
            slope,
        }
    }
}

/// Slope of the lower convex hull's edge over `at`.
fn hull_slope(points: &VecDeque<(f64, f64)>, at: f64) -> f64 {
    let slope = |a: (f64, f64), b: (f64, f64)| (b.1 - a.1) / (b.0 - a.0);
    let mut hull: Vec<(f64, f64)> = Vec::with_capacity(points.len());
    for &point in points {
        while let [.., a, b] = hull[..]
            && slope(a, b) >= slope(b, point)
        {
            hull.pop();
        }
        hull.push(point);
    }
    let edge = hull.windows(2).find(|edge| edge[1].0 >= at);
    edge.map_or(0.0, |edge| slope(edge[0], edge[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A fixed sequence of numbers that look random, in 0 … 1.
    fn noise(k: u64) -> f64 {
        let mut x = k
            .wrapping_add(0x9e37_79b9_7f4a_7c15)
            .wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x ^= x >> 31;
        x = x.wrapping_mul(0x94d0_49bb_1331_11eb);
        (x >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Server clock minus ours, and its drift.
    const AHEAD_S: f64 = 1.7e9;
    const DRIFT: f64 = 40e-6;

    fn server(here_s: f64) -> f64 {
        AHEAD_S + here_s * (1.0 + DRIFT)
    }

    #[test]
    fn offset_and_drift_are_found_under_bursty_delays() {
        let mut clock = ClockFilter::default();
        let mut worst = 0.0_f64;
        for k in 0..6000_u64 {
            let sent_s = k as f64 / 100.0;
            // Mostly 0.2 ms … 5 ms, now and then 40 ms.
            let burst = if noise(3 * k) < 0.05 { 0.04 } else { 0.0 };
            let delay = 2e-4 + 5e-3 * noise(3 * k + 1).powi(2) + burst;
            clock.observe(server(sent_s), sent_s + delay);
            if k > 3000 {
                worst = worst.max((clock.here_s(server(sent_s)).unwrap() - sent_s - 2e-4).abs());
            }
        }
        assert!(worst < 2e-4, "{worst}");
        let estimate = clock.estimate().unwrap();
        assert!((estimate.drift_ppm + 40.0).abs() < 10.0, "{estimate:?}");
        assert!(estimate.window_s > 25.0 && estimate.steps == 0);
    }

    #[test]
    fn a_stalled_network_is_late_and_does_not_move_the_clock() {
        let mut clock = ClockFilter::default();
        for k in 0..2000_u64 {
            let sent_s = k as f64 / 100.0;
            // Frames of one second come together at its end.
            let arrived_s = if (1000..1100).contains(&k) {
                11.0
            } else {
                sent_s + 1e-3
            };
            let late = clock.observe(server(sent_s), arrived_s);
            if k == 1000 {
                assert!((late - 1.0).abs() < 5e-3, "{late}");
            }
        }
        assert_eq!(clock.estimate().unwrap().steps, 0);
        let error = clock.here_s(server(19.9)).unwrap() - 19.9 - 1e-3;
        assert!(error.abs() < 2e-4, "{error}");
    }

    #[test]
    fn a_clock_that_is_set_is_followed() {
        for step_s in [-30.0, 30.0] {
            let mut clock = ClockFilter::default();
            for k in 0..2000_u64 {
                let sent_s = k as f64 / 100.0;
                let stamp = server(sent_s) + if k < 1000 { 0.0 } else { step_s };
                clock.observe(stamp, sent_s + 1e-3);
            }
            assert_eq!(clock.estimate().unwrap().steps, 1);
            let error = clock.here_s(server(19.9) + step_s).unwrap() - 19.9 - 1e-3;
            assert!(error.abs() < 2e-4, "{error}");
        }
    }

    #[test]
    fn nothing_is_captured_after_it_arrived() {
        let mut clock = ClockFilter::default();
        for k in 0..5000_u64 {
            let sent_s = k as f64 / 50.0;
            let arrived_s = sent_s + 0.02 * noise(k);
            assert!(clock.observe(server(sent_s), arrived_s) >= 0.0);
            assert!(clock.here_s(server(sent_s)).unwrap() <= arrived_s + 1e-6);
        }
    }
}
