//! Poses that a tracker repeated instead of measuring.
//!
//! Two measurements of a moving, noisy body never agree in every digit, so an exact repetition is a frozen
//! pose. But a body at rest in a noise-free simulation, or one that moves by less than the last digit of the
//! file, repeats itself honestly. A repetition is therefore called frozen only where
//!
//! 1. the body was moving: its last step before was more than ten units of the last digit (where there is no
//!    step before, because the file begins so: the other body moved at once, and this one resumes with a
//!    step), and
//! 2. something moved meanwhile: the command, the other body, or this one as it resumes.

use std::ops::Range;

use super::Flight;

/// Steps up to so many units of the last digit may be rounding.
const DIGITS: f64 = 10.0;

/// Rows whose pose repeats the row before.
pub(super) struct Frozen {
    pub quadrotor: Vec<Range<usize>>,
    pub end_effector: Vec<Range<usize>>,
}

/// One body's poses, one list of numbers per row, positions first.
struct Track<const N: usize> {
    poses: Vec<Option<[f64; N]>>,
    /// Steps up to this, m, may be rounding.
    rounding_m: f64,
}

/// The frozen rows of each body; the first row of a repetition is good and not among them.
pub(super) fn frozen_rows(flight: &Flight) -> Frozen {
    let quadrotor = Track::new(flight.samples.iter().map(|sample| {
        let pose = sample.quadrotor?;
        let ([x, y, z], [qw, qx, qy, qz]) = (pose.position, pose.attitude);
        Some([x, y, z, qw, qx, qy, qz])
    }));
    let end_effector = Track::new(flight.samples.iter().map(|sample| sample.end_effector));
    Frozen {
        quadrotor: quadrotor.frozen(&end_effector, flight),
        end_effector: end_effector.frozen(&quadrotor, flight),
    }
}

impl<const N: usize> Track<N> {
    fn new(poses: impl Iterator<Item = Option<[f64; N]>>) -> Self {
        let poses: Vec<_> = poses.collect();
        let rounding_m = DIGITS * resolution(poses.iter().flatten().flat_map(|pose| &pose[..3]));
        Track { poses, rounding_m }
    }

    fn frozen<const M: usize>(&self, other: &Track<M>, flight: &Flight) -> Vec<Range<usize>> {
        let mut frozen = Vec::new();
        let mut first = 0;
        while first < self.poses.len() {
            let mut last = first;
            while last + 1 < self.poses.len() && self.repeats(last + 1) {
                last += 1;
            }
            if last > first {
                let resumes = self.step(last).is_some_and(|step| step > self.rounding_m);
                let was_moving = match first.checked_sub(1).and_then(|before| self.step(before)) {
                    Some(step) => step > self.rounding_m,
                    None => resumes && other.step(first).is_some_and(|step| step > other.rounding_m),
                };
                let command_moved =
                    (first..last).any(|k| flight.samples[k].command != flight.samples[k + 1].command);
                let other_moved = (first + 1..=last).any(|k| !other.repeats(k) && other.poses[k].is_some());
                if was_moving && (command_moved || other_moved || resumes) {
                    frozen.push(first + 1..last + 1);
                }
            }
            first = last + 1;
        }
        frozen
    }

    /// Whether row `k` repeats the row before.
    fn repeats(&self, k: usize) -> bool {
        self.poses[k].is_some() && self.poses[k] == self.poses[k - 1]
    }

    /// Distance between the positions of row `k` and the next, if both exist, m.
    fn step(&self, k: usize) -> Option<f64> {
        let (here, next) = ((*self.poses.get(k)?)?, (*self.poses.get(k + 1)?)?);
        Some((0..3).map(|i| (next[i] - here[i]).powi(2)).sum::<f64>().sqrt())
    }
}

/// The last digit in which the values are written: the largest power of ten, 1 … 1e-9, of which all are multiples.
fn resolution<'a>(values: impl Iterator<Item = &'a f64> + Clone) -> f64 {
    (0..9)
        .map(|digits| 10f64.powi(digits))
        .find(|scale| {
            values
                .clone()
                .all(|x| (x * scale - (x * scale).round()).abs() < 1e-4)
        })
        .map_or(1e-9, f64::recip)
}

#[cfg(test)]
mod tests {
    use super::resolution;

    #[test]
    fn resolution_is_the_last_digit_written() {
        assert_eq!(resolution([1.25, 3.0, -0.5].iter()), 0.01);
        assert_eq!(resolution([0.000123, 12.0].iter()), 1e-6);
        assert_eq!(resolution([1.0 / 3.0, 12.0].iter()), 1e-9);
    }
}
