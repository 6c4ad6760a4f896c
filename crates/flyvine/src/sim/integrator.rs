//! Time integration of the [`Chain`].
//!
//! [`LinearlyImplicit`] is the vehicle's integrator: the two-stage, second-order, L-stable, stiffly accurate
//! diagonally implicit Runge–Kutta method of Alexander (SIAM J. Numer. Anal. 14, 1977) with
//! γ = 1 − 1/√2, attitudes advanced by the exponential map, each stage solved by one Newton step whose
//! Jacobian holds joint stiffness and damping (the rest is not stiff; its error keeps the order, because the
//! predictor is second-order accurate). A step costs two passes of the articulated-body algorithm.
//!
//! [`RungeKutta4`] is the classical explicit method: fourth order and almost without dissipation, but stable
//! only for small steps and light damping. It serves as the undamped mode, and to check the other.

use super::articulated::Workspace;
use super::chain::{Chain, Load};
use super::state::{ChainState, Motion};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// γ = 1 − 1/√2 of the L-stable two-stage method: the fraction of the step at its first stage.
pub const STAGE: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;

/// The linearly implicit second-order method; see the module's page.
#[derive(Debug, Clone)]
pub struct LinearlyImplicit {
    workspace: Workspace,
    start: ChainState,
    first: Motion,
    first_motion: Motion,
    mean: Motion,
    predicted: Motion,
    /// Acceleration at the end of the last step: the next step's predictor, and what an accelerometer sees.
    pub acceleration: Motion,
}

impl LinearlyImplicit {
    /// For chains of `links` links, starting from rest.
    pub fn new(links: usize) -> LinearlyImplicit {
        let zero = Motion::zeros(links);
        LinearlyImplicit {
            workspace: Workspace::new(links),
            start: ChainState::hanging(Vector3::zeros(), links),
            first: zero.clone(),
            first_motion: zero.clone(),
            mean: zero.clone(),
            predicted: zero.clone(),
            acceleration: zero,
        }
    }

    /// Forgets the past: the next step predicts zero acceleration.
    pub fn reset(&mut self) {
        let zero = Vector3::zeros();
        self.acceleration.linear = zero;
        self.acceleration.angular = zero;
        self.acceleration.links.fill(zero);
        self.acceleration.extension = 0.0;
    }

    /// Advances `state` by `step`; `loads` act at the fractions [`STAGE`] and 1 of the step.
    pub fn step(&mut self, chain: &Chain, state: &mut ChainState, loads: &[Load; 2], step: f64) {
        let eta = STAGE * step;
        self.start.copy_from(state);

        // Stage 1: V₁ = v + γh a₁, Q₁ = exp(γh V₁) q, about the prediction a₁ ≈ the last acceleration.
        self.predicted.copy_from(&self.acceleration);
        state.motion.add_scaled(eta, &self.predicted);
        self.mean.copy_from(&state.motion);
        state.advance(&self.start, eta, &self.mean);
        self.workspace
            .accelerations(chain, state, &loads[0], eta, &self.predicted, &mut self.first);
        self.first_motion.copy_from(&self.start.motion);
        self.first_motion.add_scaled(eta, &self.first);

        // Stage 2: V₂ = v + (1−γ)h a₁ + γh a₂, Q₂ = exp((1−γ)h V₁ + γh V₂) q, about a₂ ≈ a₁.
        self.predicted.copy_from(&self.first);
        state.motion.copy_from(&self.start.motion);
        state.motion.add_scaled(step, &self.first);
        self.average(&state.motion);
        state.advance(&self.start, step, &self.mean);
        self.workspace.accelerations(
            chain,
            state,
            &loads[1],
            eta,
            &self.predicted,
            &mut self.acceleration,
        );
        state.motion.copy_from(&self.start.motion);
        state.motion.add_scaled(step - eta, &self.first);
        state.motion.add_scaled(eta, &self.acceleration);
        self.average(&state.motion);
        state.advance(&self.start, step, &self.mean);
        chain.settle_sliders(state);
    }

    /// `mean = (1 − γ) V₁ + γ V₂`.
    fn average(&mut self, second: &Motion) {
        self.mean.linear = (1.0 - STAGE) * self.first_motion.linear + STAGE * second.linear;
        self.mean.angular = (1.0 - STAGE) * self.first_motion.angular + STAGE * second.angular;
        self.mean.extension = (1.0 - STAGE) * self.first_motion.extension + STAGE * second.extension;
        for ((mean, first), second) in self
            .mean
            .links
            .iter_mut()
            .zip(&self.first_motion.links)
            .zip(&second.links)
        {
            *mean = (1.0 - STAGE) * first + STAGE * second;
        }
    }
}

/// The classical explicit fourth-order Runge–Kutta method, quaternions integrated as `q̇ = ½ ω q`.
#[derive(Debug, Clone)]
pub struct RungeKutta4 {
    workspace: Workspace,
    start: ChainState,
    sum: Derivative,
    slope: Derivative,
}

/// Time derivative of a [`ChainState`].
#[derive(Debug, Clone)]
struct Derivative {
    position: Vector3<f64>,
    attitude: Quaternion<f64>,
    links: Vec<Quaternion<f64>>,
    extension: f64,
    motion: Motion,
}

impl Derivative {
    fn zeros(links: usize) -> Derivative {
        let zero = Quaternion::new(0.0, 0.0, 0.0, 0.0);
        Derivative {
            position: Vector3::zeros(),
            attitude: zero,
            links: vec![zero; links],
            extension: 0.0,
            motion: Motion::zeros(links),
        }
    }

    /// `self = self · keep + factor · other`.
    fn blend(&mut self, keep: f64, factor: f64, other: &Derivative) {
        self.position = keep * self.position + factor * other.position;
        self.attitude = self.attitude * keep + other.attitude * factor;
        self.extension = keep * self.extension + factor * other.extension;
        for (a, b) in self.links.iter_mut().zip(&other.links) {
            *a = *a * keep + b * factor;
        }
        let (motion, other) = (&mut self.motion, &other.motion);
        motion.linear = keep * motion.linear + factor * other.linear;
        motion.angular = keep * motion.angular + factor * other.angular;
        motion.extension = keep * motion.extension + factor * other.extension;
        for (a, b) in motion.links.iter_mut().zip(&other.links) {
            *a = keep * *a + factor * b;
        }
    }
}

/// `½ ω q`, ω in the world frame.
fn quaternion_rate(rate: &Vector3<f64>, q: &UnitQuaternion<f64>) -> Quaternion<f64> {
    Quaternion::from_imag(0.5 * rate) * q.quaternion()
}

impl RungeKutta4 {
    /// For chains of `links` links.
    pub fn new(links: usize) -> RungeKutta4 {
        RungeKutta4 {
            workspace: Workspace::new(links),
            start: ChainState::hanging(Vector3::zeros(), links),
            sum: Derivative::zeros(links),
            slope: Derivative::zeros(links),
        }
    }

    /// Advances `state` by `step` under a constant `load`.
    pub fn step(&mut self, chain: &Chain, state: &mut ChainState, load: &Load, step: f64) {
        self.start.copy_from(state);
        for (stage, (weight, next)) in [
            (1.0 / 6.0, 0.5),
            (1.0 / 3.0, 0.5),
            (1.0 / 3.0, 1.0),
            (1.0 / 6.0, 1.0),
        ]
        .into_iter()
        .enumerate()
        {
            self.evaluate(chain, state, load);
            let keep = if stage == 0 { 0.0 } else { 1.0 };
            self.sum.blend(keep, weight, &self.slope);
            if stage < 3 {
                move_along(state, &self.start, next * step, &self.slope);
            }
        }
        move_along(state, &self.start, step, &self.sum);
        chain.settle_sliders(state);
    }

    fn evaluate(&mut self, chain: &Chain, state: &ChainState, load: &Load) {
        let slope = &mut self.slope;
        slope.position = state.motion.linear;
        slope.extension = state.motion.extension;
        slope.attitude = quaternion_rate(&state.motion.angular, &state.attitude);
        for ((slope, rate), q) in slope.links.iter_mut().zip(&state.motion.links).zip(&state.links) {
            *slope = quaternion_rate(rate, q);
        }
        self.workspace
            .accelerations(chain, state, load, 0.0, &state.motion, &mut slope.motion);
    }
}

/// `state = start + step · slope`, quaternions normalized.
fn move_along(state: &mut ChainState, start: &ChainState, step: f64, slope: &Derivative) {
    let add = |q: &UnitQuaternion<f64>, rate: &Quaternion<f64>| {
        UnitQuaternion::new_normalize(q.quaternion() + rate * step)
    };
    state.position = start.position + step * slope.position;
    state.extension = start.extension + step * slope.extension;
    state.attitude = add(&start.attitude, &slope.attitude);
    for ((link, q), rate) in state.links.iter_mut().zip(&start.links).zip(&slope.links) {
        *link = add(q, rate);
    }
    state.motion.copy_from(&start.motion);
    state.motion.add_scaled(step, &slope.motion);
}
