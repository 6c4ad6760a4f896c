//! The clock that everything on the link is stamped with.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::mocap::clock::seconds_since;

/// Time that never runs backwards, s since the link was opened.
pub trait Clock {
    /// Now.
    fn now_s(&self) -> f64;

    /// Waits until `time_s`; does nothing if it is past.
    fn sleep_until(&mut self, time_s: f64);
}

/// The machine's monotonic clock.
#[derive(Debug, Clone, Copy)]
pub struct MonotonicClock {
    origin: Instant,
    unix_origin_s: f64,
}

impl MonotonicClock {
    /// A clock that is now at 0.
    pub fn start() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH);
        Self {
            origin: Instant::now(),
            unix_origin_s: unix.map_or(0.0, |since| since.as_secs_f64()),
        }
    }

    /// An instant on this clock, s.
    pub fn at(&self, instant: Instant) -> f64 {
        seconds_since(self.origin, instant)
    }

    /// A time on this clock in whole nanoseconds since 1970.
    pub fn unix_ns(&self, time_s: f64) -> u64 {
        let origin_ns = (self.unix_origin_s * 1e9) as u64;
        origin_ns.saturating_add_signed((time_s * 1e9) as i64)
    }

    /// A time on this clock since 1970, s.
    pub fn unix_s(&self, time_s: f64) -> f64 {
        time_s + self.unix_origin_s
    }
}

impl Clock for MonotonicClock {
    fn now_s(&self) -> f64 {
        self.origin.elapsed().as_secs_f64()
    }

    fn sleep_until(&mut self, time_s: f64) {
        let left_s = time_s - self.now_s();
        if left_s > 0.0 {
            std::thread::sleep(Duration::from_secs_f64(left_s));
        }
    }
}
