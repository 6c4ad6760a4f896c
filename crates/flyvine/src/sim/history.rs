//! The recent past, for everything that arrives late.

/// The newest values of a signal sampled at a fixed period.
#[derive(Debug, Clone)]
pub(super) struct History<T> {
    samples: Vec<T>,
    newest: usize,
}

impl<T: Copy> History<T> {
    /// Remembers at least `duration` seconds at one sample per `period`; `value` all along.
    pub(super) fn new(duration: f64, period: f64, value: T) -> History<T> {
        let length = (duration / period).ceil() as usize + 2;
        History {
            samples: vec![value; length],
            newest: 0,
        }
    }

    /// Forgets the past: `value` all along.
    pub(super) fn fill(&mut self, value: T) {
        self.samples.fill(value);
    }

    /// Adds the newest sample.
    pub(super) fn push(&mut self, value: T) {
        self.newest = (self.newest + 1) % self.samples.len();
        self.samples[self.newest] = value;
    }

    /// The sample of so many periods ago, at most as many as are remembered.
    pub(super) fn back(&self, periods: usize) -> T {
        let length = self.samples.len();
        self.samples[(self.newest + length - periods.min(length - 1)) % length]
    }
}
