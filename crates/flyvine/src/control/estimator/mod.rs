//! What the vehicle does and what the world does to it, from poses: an extended Kalman filter on a bank's model.
//!
//! The model's state z is joined by nine steady disturbances d (offset-free: whatever the model cannot explain in the
//! mean ends up there), nine gusts g that fade, the surroundings a (a steady wind, a gust of it that fades, and the share
//! by which the tip is heavier), and by how much later than the model believes commands arrive, τ in knots:
//!
//! ```text
//! z⁺ = f(z, û, a) + E (d + g),   d⁺ = d + w_d,   g⁺ = ρ g + w_g,   τ⁺ = τ + w_τ,   a⁺ as d or g
//! û_k = (1 − φ) u_{k−i} + φ u_{k−i−1},   i + φ = τ
//! y = C z + v,   C: the first nine entries
//! ```
//!
//! A wind pushes quadrotor and arm at once, and an arm that moves against it more than one that moves with it: that is why
//! it is more than two forces. Lag models know nothing of surroundings; there a stays zero.
//!
//! What is found of τ is used: [`Estimator::foresee`] begins where the next command begins to act, and horizons see commands
//! late by its fraction. On an independent simulator with 50 ms more delay than the models knew, predictive control without it
//! (`noise.delay_initial` next to nothing) was off by 1.35 and 2.55 cm where it is off by 0.47 and 1.02 cm with it (lemniscates of
//! 10 and 5 s, long arm).
//!
//! [`Estimator::predict`] is the time update with the command that really left; [`Estimator::correct`] takes in the
//! poses that were seen, entry by entry, refusing those that the filter finds impossible. A pose that is missing or
//! refused leaves the prediction: the filter coasts, and its covariance says how far it can be trusted.

mod covariance;
mod identification;
mod innovations;
mod layout;
mod outlook;

pub use identification::{NoiseError, NoiseReport, identify_noise};
pub use innovations::{DOUBT, Surprise};
pub use outlook::{Lateness, Outlook, Surrounded};

use super::Tick;
use super::trajectory::POSE_STATE_LEN;
use crate::flight::SurroundingsReport;
use crate::link::Observation;
use crate::model::physical::SURROUNDINGS_LEN;
use crate::model::{Model, NoiseLevelError, NoiseLevels, ScheduledModel};
use crate::trajopt::Dynamics;
use covariance::Covariance;
use layout::Layout;

/// Number of disturbances, and of gusts.
pub const DISTURBANCES: usize = 9;
/// Entries behind z: disturbances, gusts, surroundings, delay.
const EXTRA: usize = DELAY + 1;
/// Behind z: first of steady wind (3), its gust (3), load (1).
const AIR: usize = 2 * DISTURBANCES;
const AIR_GUST: usize = AIR + 3;
const TIP_LOAD: usize = AIR_GUST + 3;
const DELAY: usize = TIP_LOAD + 1;
/// Commands that are remembered: the largest delay, in knots, and one more to interpolate.
const COMMANDS_KEPT: usize = 6;
/// Largest delay beyond the model's, knots.
const DELAY_MAX: f64 = (COMMANDS_KEPT - 2) as f64;
/// Knots of hovering that [`Estimator::settle`] imagines: enough for the autopilot's slow integrator.
const SETTLING_KNOTS: usize = 100;
/// As many poses as the one that it sees counts for. Were it as many as knots, its noise would be taken for wind; were it one,
/// a wind would be found too weak.
const SETTLING_POSES: f64 = 6.0;

/// A model that the filter cannot run on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EstimatorError {
    /// The model's command is not a position.
    #[error("the model's command has {found} entries; expected 3 (commanded position)")]
    Command {
        /// Command length of the model.
        found: usize,
    },
    /// The start does not belong to the model.
    #[error("the start has {found} entries; expected the model's {expected}")]
    Start {
        /// Entries of the start.
        found: usize,
        /// State length of the model.
        expected: usize,
    },
    /// A noise level that is out of its range.
    #[error(transparent)]
    Noise(#[from] NoiseLevelError),
}

/// The estimate at one knot.
#[derive(Debug, Clone)]
pub struct Estimator<'a> {
    model: &'a ScheduledModel,
    layout: Layout,
    /// z (n), d (9), g (9), a (7), τ (1).
    mean: Vec<f64>,
    covariance: Covariance,
    /// Commands that left, the newest first, m.
    commands: [[f64; 3]; COMMANDS_KEPT],
    /// Rows running in which a body's pose was refused: quadrotor, end effector.
    refusals: [u32; 2],
    /// Workspace: the Jacobians of the model, row-major, and fresh entries.
    jacobian: Vec<f64>,
    by_surroundings: Vec<f64>,
    fresh: Vec<f64>,
    surprise: Surprise,
    inconsistency: f64,
    /// Knots of which it is the mean.
    knots: u32,
}

/// Whether entry `i` behind z is a gust.
fn fades(i: usize) -> bool {
    (DISTURBANCES..AIR).contains(&i) || (AIR_GUST..TIP_LOAD).contains(&i)
}

impl<'a> Estimator<'a> {
    /// Starts at the state `start` (n), at rest under the command `command`, m.
    ///
    /// # Errors
    /// The model does not take a position for its command, or `start` is not a state of it; a bad noise level.
    pub fn new(
        model: &'a ScheduledModel,
        noise: &NoiseLevels,
        start: &[f64],
        command: [f64; 3],
    ) -> Result<Self, EstimatorError> {
        noise.validate()?;
        let (n, m) = (model.state_len(), model.command_len());
        if m != 3 {
            return Err(EstimatorError::Command { found: m });
        }
        if start.len() != n {
            return Err(EstimatorError::Start {
                found: start.len(),
                expected: n,
            });
        }
        let layout = match model.at_knot(0) {
            Model::Lag(_) => Layout::lag(n, noise),
            Model::Physical(_) => Layout::physical(n, noise),
        };
        let mut mean = start.to_vec();
        mean.resize(n + EXTRA, 0.0);
        Ok(Self {
            model,
            covariance: Covariance::diagonal(&layout.initial),
            layout,
            mean,
            commands: [command; COMMANDS_KEPT],
            refusals: [0; 2],
            jacobian: vec![0.0; model.fresh_len() * (n + m)],
            by_surroundings: vec![0.0; model.fresh_len() * SURROUNDINGS_LEN],
            fresh: vec![0.0; model.fresh_len()],
            surprise: Surprise::default(),
            inconsistency: DOUBT,
            knots: 0,
        })
    }

    fn state_len(&self) -> usize {
        self.mean.len() - EXTRA
    }

    /// The estimated state z (n).
    pub fn state(&self) -> &[f64] {
        &self.mean[..self.state_len()]
    }

    /// The estimated steady disturbances d.
    pub fn disturbance(&self) -> &[f64] {
        &self.mean[self.state_len()..][..DISTURBANCES]
    }

    /// The estimated gusts g.
    pub fn gust(&self) -> &[f64] {
        &self.mean[self.state_len() + DISTURBANCES..][..DISTURBANCES]
    }

    /// What is left of a gust one knot later, ρ.
    pub fn gust_decay(&self) -> f64 {
        self.layout.gust_decay
    }

    /// How much later than the model believes commands arrive, knots, and its standard deviation.
    pub fn delay_knots(&self) -> (f64, f64) {
        let last = self.mean.len() - 1;
        (self.mean[last], self.covariance.variance(last).sqrt())
    }

    /// What is known of wind and load.
    pub fn surroundings(&self) -> SurroundingsReport {
        let first = self.state_len();
        let at = |i: usize| self.mean[first + i];
        let deviation = |i: usize| self.covariance.variance(first + i).sqrt();
        SurroundingsReport {
            wind_m_s: [at(AIR), at(AIR + 1)],
            wind_deviation_m_s: [deviation(AIR), deviation(AIR + 1)],
            gust_m_s: [at(AIR_GUST), at(AIR_GUST + 1)],
            gust_deviation_m_s: [deviation(AIR_GUST), deviation(AIR_GUST + 1)],
            tip_load: at(TIP_LOAD),
            tip_load_deviation: deviation(TIP_LOAD),
        }
    }

    /// Standard deviation of entry `index` of z.
    pub fn standard_deviation(&self, index: usize) -> f64 {
        self.covariance.variance(index).sqrt()
    }

    /// The command in force, given the delay, and how it changes per knot of delay.
    fn effective_command(&self) -> ([f64; 3], [f64; 3]) {
        let delay = self.delay_knots().0;
        let whole = (delay.floor() as usize).min(COMMANDS_KEPT - 2);
        let fraction = delay - whole as f64;
        let (newer, older) = (self.commands[whole], self.commands[whole + 1]);
        (
            std::array::from_fn(|axis| (1.0 - fraction) * newer[axis] + fraction * older[axis]),
            std::array::from_fn(|axis| older[axis] - newer[axis]),
        )
    }

    /// Everything that a controller's tick brings: time update with the command that was held, and the poses. What
    /// the first tick sees, [`Self::settle`] has seen.
    pub fn update(&mut self, tick: &Tick) {
        if let Some(before) = tick.knot.checked_sub(1) {
            self.predict(before, tick.held_command);
            self.correct(&tick.observation);
            self.follow_inconsistency();
        }
    }

    /// Time update from `knot` to the next, during which `command` was held.
    pub fn predict(&mut self, knot: usize, command: [f64; 3]) {
        self.commands.rotate_right(1);
        self.commands[0] = command;
        let (effective, per_knot) = self.effective_command();
        let n = self.state_len();
        self.model.linearize_in(
            knot,
            &self.outlook(knot).at(knot),
            &self.mean[..n],
            &effective,
            &mut self.fresh,
            &mut self.jacobian,
            Some(&mut self.by_surroundings),
        );
        for (entry, disturbance, gain) in &self.layout.entries {
            self.fresh[*entry] +=
                gain * (self.mean[n + disturbance] + self.mean[n + DISTURBANCES + disturbance]);
        }
        for i in (0..EXTRA).filter(|&i| fades(i)) {
            self.mean[n + i] *= self.layout.gust_decay;
        }
        let fresh = self.fresh.len();
        self.mean.copy_within(..n - fresh, fresh);
        self.mean[..fresh].copy_from_slice(&self.fresh);

        let transition = self.covariance.transition();
        transition.clear();
        for (i, row) in self.jacobian.chunks_exact(n + 3).enumerate() {
            for (j, &entry) in row[..n].iter().enumerate() {
                transition.set(i, j, entry);
            }
            let by_delay = (0..3).map(|axis| row[n + axis] * per_knot[axis]).sum();
            transition.set(i, n + DELAY, by_delay);
        }
        for (i, row) in self.by_surroundings.chunks_exact(SURROUNDINGS_LEN).enumerate() {
            for (j, &entry) in row.iter().enumerate() {
                transition.set(i, n + if j < 3 { AIR + j } else { TIP_LOAD }, entry);
                if j < 3 {
                    transition.set(i, n + AIR_GUST + j, entry);
                }
            }
        }
        for (entry, disturbance, gain) in &self.layout.entries {
            transition.set(*entry, n + disturbance, *gain);
            transition.set(*entry, n + DISTURBANCES + disturbance, *gain);
        }
        for i in fresh..n {
            transition.set(i, i - fresh, 1.0);
        }
        for i in 0..EXTRA {
            transition.set(n + i, n + i, if fades(i) { self.layout.gust_decay } else { 1.0 });
        }
        self.covariance.propagate(&self.layout.process);
    }

    /// Begins with a vehicle that has been hovering where `observation` sees it: what holds it there (tilt, a wind's
    /// steady push, the autopilot's integrator) is what the filter finds when it sees this pose again and again.
    /// How far the start may be from that is as uncertain as before.
    pub fn settle(&mut self, observation: &Observation) {
        let command = self.commands[0];
        let n = self.state_len();
        let measured = self.layout.measured;
        let weaker = (SETTLING_KNOTS as f64 / SETTLING_POSES).sqrt();
        self.layout.measured = measured.map(|noise| noise * weaker);
        for _ in 0..SETTLING_KNOTS {
            self.predict(0, command);
            self.correct(observation);
        }
        self.layout.measured = measured;
        // A hover tells nothing of delay and load: what would be found of them is the noise of this one pose.
        self.mean[n + DELAY] = 0.0;
        self.mean[n + TIP_LOAD] = 0.0;
        for i in (0..EXTRA).filter(|&i| fades(i)) {
            self.mean[n + i] = 0.0;
        }
        self.covariance.reset(&self.layout.initial);
        self.correct(observation);
    }
}

const _: () = assert!(POSE_STATE_LEN == DISTURBANCES);

#[cfg(test)]
mod tests;
