//! How well the ticks of 20 Hz were kept.

use flyvine::DT;
use serde::{Deserialize, Serialize};

/// A tick later than this is counted as late, s.
pub const LATE_S: f64 = 5e-3;

/// When the set-points left, s.
#[derive(Debug, Clone, Default)]
pub struct TickTimes {
    sent_s: Vec<f64>,
    late: usize,
    missed: usize,
}

/// What there is to say about them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TickReport {
    /// Set-points sent.
    pub setpoints: usize,
    /// Mean time between them, ms.
    pub period_ms: f64,
    /// |time between two − 50 ms|: the median, ms.
    pub jitter_median_ms: f64,
    /// Its 99.9th percentile, ms.
    pub jitter_p999_ms: f64,
    /// The largest, ms.
    pub jitter_max_ms: f64,
    /// Ticks that came more than 5 ms late.
    pub late: usize,
    /// Ticks that came a whole period late, or more.
    pub missed: usize,
}

impl TickTimes {
    /// A tick came `late_s` after its time; returns the whole periods in it.
    pub fn tick(&mut self, late_s: f64) -> u32 {
        self.late += usize::from(late_s > LATE_S);
        let missed = (late_s / DT).floor().max(0.0) as u32;
        self.missed += missed as usize;
        missed
    }

    /// A set-point left.
    pub fn sent(&mut self, now_s: f64) {
        self.sent_s.push(now_s);
    }

    /// Sums up; `None` before two set-points.
    pub fn report(&self) -> Option<TickReport> {
        let mut jitter_ms: Vec<f64> = self
            .sent_s
            .windows(2)
            .map(|pair| 1e3 * (pair[1] - pair[0] - DT).abs())
            .collect();
        jitter_ms.sort_by(f64::total_cmp);
        let (first, last) = (self.sent_s.first()?, self.sent_s.last()?);
        let intervals = jitter_ms.len();
        // The smallest value that 99.9 % are not above.
        let p999 = (0.999 * intervals as f64).ceil() as usize;
        Some(TickReport {
            setpoints: self.sent_s.len(),
            period_ms: 1e3 * (last - first) / intervals.max(1) as f64,
            jitter_median_ms: *jitter_ms.get(intervals / 2)?,
            jitter_p999_ms: jitter_ms[p999.saturating_sub(1)],
            jitter_max_ms: jitter_ms[intervals - 1],
            late: self.late,
            missed: self.missed,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jitter_is_the_distance_from_fifty_milliseconds() {
        let mut times = TickTimes::default();
        assert_eq!(times.report(), None);
        for sent_s in [0.0, 0.05, 0.101, 0.15, 0.2] {
            times.sent(sent_s);
        }
        assert_eq!([times.tick(1e-3), times.tick(6e-3), times.tick(0.12)], [0, 0, 2]);
        let report = times.report().unwrap();
        assert_eq!((report.setpoints, report.late, report.missed), (5, 2, 2));
        assert!((report.period_ms - 50.0).abs() < 1e-9 && (report.jitter_p999_ms - 1.0).abs() < 1e-9);
    }
}
