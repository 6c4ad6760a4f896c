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
//! [`Estimator::predict`] is the time update with the command that really left; [`Estimator::correct`] takes in the
//! poses that were seen, entry by entry, refusing those that the filter finds impossible. A pose that is missing or
//! refused leaves the prediction: the filter coasts, and its covariance says how far it can be trusted.

mod covariance;
mod identification;
mod layout;
mod outlook;

pub use identification::{NoiseError, NoiseReport, identify_noise};
pub use outlook::{Outlook, Surrounded};

use super::Tick;
use super::trajectory::POSE_STATE_LEN;
use crate::flight::Pose;
use crate::link::Observation;
use crate::model::physical::{SURROUNDINGS_LEN, Surroundings};
use crate::model::{Model, NoiseLevels, ScheduledModel};
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
/// Shares by which the tip may be heavier.
const TIP_LOADS: [f64; 2] = [-0.5, 1.5];
/// Commands that are remembered: the largest delay, in knots, and one more to interpolate.
const COMMANDS_KEPT: usize = 6;
/// Largest delay beyond the model's, knots.
const DELAY_MAX: f64 = (COMMANDS_KEPT - 2) as f64;
/// Innovations beyond this many standard deviations are refused …
const GATE: f64 = 6.0;
/// … unless so many rows running were: then it is the estimate that is wrong.
const REFUSALS_MAX: u32 = 3;

/// Knots of hovering that [`Estimator::settle`] imagines: enough for the autopilot's slow integrator.
const SETTLING_KNOTS: usize = 100;

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
    /// A noise level that is not positive, or not a number.
    #[error("noise level {name}: found {found}, expected a positive number")]
    Noise {
        /// Which.
        name: &'static str,
        /// Its value.
        found: f64,
    },
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
}

/// How late commands are: `whole` knots, and a `fraction` of −½ to ½ of a knot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lateness {
    /// Whole knots.
    pub whole: usize,
    /// What is left.
    pub fraction: f64,
}

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
        if let Some((name, found)) = noise.invalid() {
            return Err(EstimatorError::Noise { name, found });
        }
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

    /// Wind and load as expected from `knot` on, the knot of the estimate.
    pub fn outlook(&self, knot: usize) -> Outlook {
        let at = |first: usize| std::array::from_fn(|axis| self.mean[self.state_len() + first + axis]);
        Outlook {
            knot,
            steady: Surroundings {
                wind_m_s: at(AIR),
                tip_load: self.tip_load().0,
            },
            gust_m_s: at(AIR_GUST),
            gust_decay: self.layout.gust_decay,
        }
    }

    /// The model in that wind, under that load.
    pub fn surrounded(&self, knot: usize) -> Surrounded<'a> {
        Surrounded {
            model: self.model,
            outlook: self.outlook(knot),
        }
    }

    /// The steady wind, m/s, and its standard deviations.
    pub fn wind_m_s(&self) -> ([f64; 3], [f64; 3]) {
        let first = self.state_len() + AIR;
        (
            std::array::from_fn(|axis| self.mean[first + axis]),
            std::array::from_fn(|axis| self.covariance.variance(first + axis).sqrt()),
        )
    }

    /// The share by which the tip is heavier than when the model was fitted, and its standard deviation.
    pub fn tip_load(&self) -> (f64, f64) {
        let index = self.state_len() + TIP_LOAD;
        (self.mean[index], self.covariance.variance(index).sqrt())
    }

    /// How well the last correction was foreseen.
    pub fn surprise(&self) -> Surprise {
        self.surprise
    }

    /// Standard deviation of entry `index` of z.
    pub fn standard_deviation(&self, index: usize) -> f64 {
        self.covariance.variance(index).sqrt()
    }

    /// Writes what the steady disturbances and the gusts add to the fresh entries of a step, E d and E g.
    fn write_push(&self, steady: &mut [f64], gust: &mut [f64]) {
        for (push, sources) in [(steady, self.disturbance()), (gust, self.gust())] {
            push.fill(0.0);
            for (entry, disturbance, gain) in &self.layout.entries {
                push[*entry] += gain * sources[*disturbance];
            }
        }
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
            &mut self.by_surroundings,
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
        for _ in 0..SETTLING_KNOTS {
            self.predict(0, command);
            self.correct(observation);
        }
        self.mean[n + DELAY] = 0.0;
        for i in (0..EXTRA).filter(|&i| fades(i)) {
            self.mean[n + i] = 0.0;
        }
        self.covariance.reset(&self.layout.initial);
        self.correct(observation);
    }

    /// Looks ahead to the knot at which a command sent at `knot` begins to act: writes z there into `state` (n), under
    /// the commands that have left, and what disturbances and gusts will add to the fresh entries from then on.
    pub fn foresee(
        &mut self,
        knot: usize,
        state: &mut [f64],
        steady: &mut [f64],
        gust: &mut [f64],
    ) -> Lateness {
        let delay = self.delay_knots().0;
        let (whole, fraction) = (delay.round() as usize, delay - delay.round());
        state.copy_from_slice(self.state());
        self.write_push(steady, gust);
        let model = self.surrounded(knot);
        for ahead in 0..whole {
            let (newer, older) = (self.commands[whole - ahead - 1], self.commands[whole - ahead]);
            let effective: [f64; 3] =
                std::array::from_fn(|axis| (1.0 - fraction) * newer[axis] + fraction * older[axis]);
            model.step(knot + ahead, state, &effective, &mut self.fresh);
            for ((entry, steady), gust) in self.fresh.iter_mut().zip(&*steady).zip(&mut *gust) {
                *entry += steady + *gust;
                *gust *= self.layout.gust_decay;
            }
            let (n, fresh) = (state.len(), self.fresh.len());
            state.copy_within(..n - fresh, fresh);
            state[..fresh].copy_from_slice(&self.fresh);
        }
        Lateness { whole, fraction }
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
            let innovation = value - self.mean[entry];
            let variance = self.covariance.observe(
                entry,
                self.layout.measured[entry].powi(2),
                innovation,
                &mut self.mean,
            );
            self.surprise.entries += 1;
            self.surprise.squares += innovation * innovation / variance;
            self.surprise.log_variances += variance.ln();
        }
    }
}

const _: () = assert!(POSE_STATE_LEN == DISTURBANCES);

#[cfg(test)]
mod tests;
