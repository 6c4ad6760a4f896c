//! The measurement update: poses against what was foreseen of them.

use super::{DELAY_MAX, Estimator, TIP_LOAD};
use crate::flight::Pose;
use crate::link::Observation;

/// Innovations beyond this many standard deviations are refused …
pub(super) const GATE: f64 = 6.0;
/// … unless so many rows running were: then it is the estimate that is wrong …
pub(super) const REFUSALS_MAX: u32 = 3;
/// … by no more than so many standard deviations, as far as one row can tell. A body that is seen for good where no arm of
/// the model's can be (a marker that slipped) would else throw velocities and winds out, farther with every row.
const BELIEVED: f64 = 3.0 * GATE;
/// How fast innovations that are larger than lately are believed, s …
const ALARM_S: f64 = 0.3;
/// … and how fast smaller ones: a model that was wrong does not become right while the vehicle stands still.
const RELIEF_S: f64 = 5.0;
/// The inconsistency of a model of which nothing was seen yet: trust is earned …
pub const DOUBT: f64 = 6.0;
/// … by foreseeing well for longer than so many knots.
const DOUBT_KNOTS: f64 = 40.0;
/// Shares by which the tip may be heavier.
const TIP_LOADS: [f64; 2] = [-0.5, 1.5];

/// How well the last correction was foreseen.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surprise {
    /// Number of entries taken in.
    pub entries: u32,
    /// Number of entries refused.
    pub refused: u32,
    /// Σ ν² / s over the entries taken in.
    pub squares: f64,
    /// Σ ln s.
    pub log_variances: f64,
}

impl Estimator<'_> {
    /// How well the last correction was foreseen.
    pub fn surprise(&self) -> Surprise {
        self.surprise
    }

    /// Begins with the inconsistency that an earlier flight of the same vehicle ended with, instead of with [`DOUBT`].
    pub(crate) fn with_inconsistency(mut self, inconsistency: f64) -> Self {
        self.inconsistency = inconsistency;
        self
    }

    /// How badly the model has foreseen the poses lately: the mean of ν² / s over their entries, which is 1 if the filter
    /// knows how well its model foresees and far beyond if the model is not that of the vehicle. It begins high, rises fast
    /// and falls slowly.
    pub fn inconsistency(&self) -> f64 {
        self.inconsistency
    }

    /// One knot of that.
    pub(super) fn follow_inconsistency(&mut self) {
        let Surprise {
            entries,
            refused,
            squares,
            ..
        } = self.surprise;
        if entries + refused == 0 {
            return;
        }
        // What was refused is at least as surprising as the gate allows.
        let seen = (squares + GATE.powi(2) * f64::from(refused)) / f64::from(entries + refused);
        self.knots += 1;
        let memory_s = if seen > self.inconsistency {
            ALARM_S
        } else {
            RELIEF_S.min(crate::DT * (DOUBT_KNOTS + f64::from(self.knots)))
        };
        self.inconsistency += crate::DT / memory_s * (seen - self.inconsistency);
    }

    /// Takes in the poses that were seen.
    pub fn correct(&mut self, observation: &Observation) {
        self.surprise = Surprise::default();
        if let Some(Pose { position, attitude }) = observation.quadrotor {
            let [_, x, y, z] = attitude;
            self.correct_body(0, 0, &[position[0], position[1], position[2], x, y, z]);
        }
        if let Some(position) = observation.end_effector {
            self.correct_body(1, 6, &position);
        }
        let last = self.mean.len() - 1;
        self.mean[last] = self.mean[last].clamp(0.0, DELAY_MAX);
        let load = self.state_len() + TIP_LOAD;
        self.mean[load] = self.mean[load].clamp(TIP_LOADS[0], TIP_LOADS[1]);
    }

    /// Takes in the entries `first ..` of the outputs as `seen`, or none of them if one is out of the gate.
    fn correct_body(&mut self, body: usize, first: usize, seen: &[f64]) {
        let noise = |entry: usize| self.layout.measured[entry].powi(2);
        let refused = seen.iter().enumerate().any(|(i, value)| {
            let entry = first + i;
            let variance = self.covariance.variance(entry) + noise(entry);
            (value - self.mean[entry]).powi(2) > GATE.powi(2) * variance
        });
        if refused && self.refusals[body] < REFUSALS_MAX {
            self.refusals[body] += 1;
            self.surprise.refused += seen.len() as u32;
            return;
        }
        self.refusals[body] = 0;
        for (i, value) in seen.iter().enumerate() {
            let entry = first + i;
            let deviation = (self.covariance.variance(entry) + noise(entry)).sqrt();
            let innovation = (value - self.mean[entry]).clamp(-BELIEVED * deviation, BELIEVED * deviation);
            let variance = self
                .covariance
                .observe(entry, noise(entry), innovation, &mut self.mean);
            self.surprise.entries += 1;
            self.surprise.squares += innovation * innovation / variance;
            self.surprise.log_variances += variance.ln();
        }
    }
}
