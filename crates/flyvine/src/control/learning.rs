//! Iterative learning: the same task again, with a reference that makes up for the last lap's error.
//!
//! ```text
//! r_{i+1} = r̄ + bounded(r_i − r̄ + γ F (r̄ − y_i))
//! ```
//!
//! with the task's reference r̄, the end effector y_i that lap i measured, and a zero-phase low-pass F, so that what
//! changes from lap to lap (noise, gusts) is not learned. The next lap starts from the best one flown: a lap that was
//! worse halves γ.

use crate::flight::Flight;

/// Share of the error that is corrected at first.
const FIRST_SHARE: f64 = 0.7;
/// Largest distance between learned and true reference on an axis, m.
const SHIFT_MAX_M: f64 = 0.15;
/// Standard deviation of the low-pass's Gaussian, knots, and how many knots it reaches to each side.
const SMOOTHING_KNOTS: f64 = 1.5;
const REACH_KNOTS: usize = 4;

/// What is learned over laps of one task.
#[derive(Debug, Clone, PartialEq)]
pub struct LapLearning {
    /// r̄ (N), m.
    target: Vec<[f64; 3]>,
    /// r of the lap to be flown (N), m.
    reference: Vec<[f64; 3]>,
    best: Option<Lap>,
    share: f64,
}

/// A lap that was flown.
#[derive(Debug, Clone, PartialEq)]
pub struct Lap {
    /// Mean distance of the measured end effector to the task's reference, m.
    pub error_m: f64,
    /// The reference that the controller was given (N), m.
    pub reference: Vec<[f64; 3]>,
    /// Low-passed error r̄ − y (N), m.
    miss: Vec<[f64; 3]>,
}

impl LapLearning {
    /// Starts with the task's own reference (N positions of the end effector, m).
    pub fn new(target: Vec<[f64; 3]>) -> Self {
        Self {
            reference: target.clone(),
            target,
            best: None,
            share: FIRST_SHARE,
        }
    }

    /// The reference of the next lap (N), m.
    pub fn reference(&self) -> &[[f64; 3]] {
        &self.reference
    }

    /// The best lap so far.
    pub fn best(&self) -> Option<&Lap> {
        self.best.as_ref()
    }

    /// Learns from a lap that was flown on [`Self::reference`], and gives its mean error, m. A lap that does not have
    /// all its rows is not learned from and has no error.
    pub fn learn(&mut self, flight: &Flight) -> Option<f64> {
        if flight.samples.len() < self.target.len() {
            return None;
        }
        let seen = || {
            let rows = self.target.iter().zip(&flight.samples);
            rows.map(|(target, sample)| {
                let tip = sample.end_effector?;
                Some(std::array::from_fn(|axis| target[axis] - tip[axis]))
            })
        };
        let distances: Vec<f64> = seen()
            .flatten()
            .map(|miss: [f64; 3]| miss.iter().map(|x| x * x).sum::<f64>().sqrt())
            .collect();
        let error_m = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
        let lap = Lap {
            error_m,
            reference: self.reference.clone(),
            miss: low_pass(&seen().map(Option::unwrap_or_default).collect::<Vec<_>>()),
        };
        match &self.best {
            Some(best) if best.error_m <= error_m => self.share *= 0.5,
            _ => self.best = Some(lap),
        }
        if let Some(best) = &self.best {
            for (k, reference) in self.reference.iter_mut().enumerate() {
                for axis in 0..3 {
                    let target = self.target[k][axis];
                    let shift = best.reference[k][axis] - target + self.share * best.miss[k][axis];
                    reference[axis] = target + shift.clamp(-SHIFT_MAX_M, SHIFT_MAX_M);
                }
            }
        }
        Some(error_m)
    }
}

/// Gaussian smoothing of each axis, the same forwards as backwards.
fn low_pass(signal: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let weight = |offset: usize| (-0.5 * (offset as f64 / SMOOTHING_KNOTS).powi(2)).exp();
    (0..signal.len())
        .map(|k| {
            let window = k.saturating_sub(REACH_KNOTS)..=(k + REACH_KNOTS).min(signal.len() - 1);
            let (mut sum, mut weights) = ([0.0; 3], 0.0);
            for other in window {
                let weight = weight(other.abs_diff(k));
                weights += weight;
                for axis in 0..3 {
                    sum[axis] += weight * signal[other][axis];
                }
            }
            sum.map(|x| x / weights)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::{Configuration, Sample};

    const KNOTS: usize = 60;

    fn target() -> Vec<[f64; 3]> {
        let at = |k: usize| [(0.1 * k as f64).sin(), 0.5 * (0.07 * k as f64).cos(), 0.8];
        (0..KNOTS).map(at).collect()
    }

    fn flown(tip: impl Fn(usize) -> Option<[f64; 3]>) -> Flight {
        let sample = |k: usize| Sample {
            t_s: k as f64 * crate::DT,
            configuration: Configuration {
                length_m: 0.7,
                pressure_kpa: 0.0,
            },
            command: [0.0, 0.0, 1.5],
            command_velocity: None,
            quadrotor: None,
            end_effector: tip(k),
        };
        Flight {
            name: "lap".into(),
            samples: (0..KNOTS).map(sample).collect(),
        }
    }

    #[test]
    fn a_repeatable_error_is_learned_away() {
        let target = target();
        let mut learning = LapLearning::new(target.clone());
        let mut errors = Vec::new();
        for _ in 0..6 {
            // A vehicle that falls short, and is off to one side.
            let reference = learning.reference().to_vec();
            let flight = flown(|k| Some([0.95 * reference[k][0], reference[k][1] + 0.02, reference[k][2]]));
            errors.push(learning.learn(&flight).unwrap());
        }
        assert!(errors[5] < 0.05 * errors[0], "{errors:?}");
        let best = learning.best().unwrap();
        assert_eq!(best.error_m, errors.iter().copied().fold(f64::INFINITY, f64::min));
    }

    #[test]
    fn learning_is_bounded_keeps_the_best_and_ignores_what_was_not_flown() {
        let target = target();
        let mut learning = LapLearning::new(target.clone());
        let good = flown(|k| Some([target[k][0] + 0.01, target[k][1], target[k][2]]));
        learning.learn(&good).unwrap();
        let after_good = learning.reference().to_vec();
        // Whatever the next laps do, the best one stays; the step from it becomes smaller.
        for _ in 0..3 {
            let far = flown(|k| (k % 2 == 0).then_some([target[k][0] + 1.0, target[k][1], target[k][2]]));
            learning.learn(&far).unwrap();
            assert!((learning.best().unwrap().error_m - 0.01).abs() < 1e-12);
        }
        for (now, before) in learning.reference().iter().zip(&after_good) {
            assert!(now[0] > before[0], "half the step, half the step, half the step");
        }
        let mut aborted = good.clone();
        aborted.samples.truncate(KNOTS / 2);
        assert_eq!(learning.learn(&aborted), None);
        let mut wild = LapLearning::new(target.clone());
        wild.learn(&flown(|k| Some([target[k][0] - 5.0, 0.0, 0.0])))
            .unwrap();
        for (learned, target) in wild.reference().iter().zip(&target) {
            assert!((0..3).all(|axis| (learned[axis] - target[axis]).abs() <= SHIFT_MAX_M + 1e-12));
        }
    }
}
