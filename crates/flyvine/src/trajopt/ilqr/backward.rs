//! The backward sweep: from the reduced gradient to a Newton step.
//!
//! The step minimizes the quadratic model `gᵀδu + ½ δuᵀ H δu` of the Lagrangian, with H the Hessian with respect
//! to the commands. The Riccati recursion is its block Cholesky factorization, one block per knot; the vector part
//!
//! ```text
//! h_k = g_k + B_kᵀ p_{k+1},   d_k = argmin ½ dᵀ Q_uu d + h_kᵀ d over the command box,   p_k = A_kᵀ p_{k+1} + Q_zu d_k
//! ```
//!
//! costs a fifteenth of it, so a factorization is used again as long as it serves.

use super::super::{Dynamics, Problem};
use super::adjoint::{Adjoint, add_transpose_step};
use super::command_box::{self, Hold, NotPositiveDefinite};
use super::expansion::Expansion;
use super::riccati::Riccati;
use super::{Shape, Trajectory};
use crate::kernel::{self, Entries, Rows, Wanted};

/// Which second derivatives enter the Hessian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convexification {
    /// Whether the curvature of the dynamics counts (Newton) or not (Gauss-Newton, always convex).
    pub curvature: bool,
    /// Levenberg term added to the diagonal of every `Q_uu`.
    pub damping: f64,
}

impl Convexification {
    /// Newton's method.
    pub const NEWTON: Self = Self {
        curvature: true,
        damping: 0.0,
    };
    /// Gauss and Newton's: convex for convex costs.
    pub const GAUSS_NEWTON: Self = Self {
        curvature: false,
        damping: 0.0,
    };
    /// Damping beyond which steps are too short to matter.
    pub const MAX_DAMPING: f64 = 1e8;
    /// Smallest damping other than none.
    const MIN_DAMPING: f64 = 1e-3;

    /// After a failure: first without curvature, then with ever more damping.
    pub fn tighten(&mut self) {
        if self.curvature {
            self.curvature = false;
        } else {
            self.damping = (10.0 * self.damping).max(Self::MIN_DAMPING);
        }
    }

    /// After a success.
    pub fn relax(&mut self) {
        self.damping = if self.damping <= Self::MIN_DAMPING {
            0.0
        } else {
            0.1 * self.damping
        };
    }
}

/// Why a factorization cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SweepFailure {
    /// `Q_uu` is not positive definite at some knot.
    NotPositiveDefinite,
    /// With an old factorization: a held command wants to move, or a free one to leave its bounds.
    HoldsChanged,
}

impl From<NotPositiveDefinite> for SweepFailure {
    fn from(_: NotPositiveDefinite) -> Self {
        Self::NotPositiveDefinite
    }
}

/// Feedforward steps and feedback gains at every knot, and the factorization they come from.
#[derive(Debug, Clone)]
pub struct Policy {
    shape: Shape,
    /// d, (N−1) × m.
    steps: Vec<f64>,
    /// K, (N−1) × m × stride.
    gains: Entries,
    /// `Q_uz`, (N−1) × m × stride.
    cross: Entries,
    /// `Q_uu`, (N−1) × m × m.
    hessians: Vec<f64>,
    /// Cholesky factors of the free part of `Q_uu`, (N−1) × m × m.
    factors: Vec<f64>,
    /// (N−1) × m.
    holds: Vec<Hold>,
    /// `Σ h_kᵀ d_k`: slope of the merit along the step.
    pub slope: f64,
    /// `½ Σ d_kᵀ Q_uu d_k`.
    pub quadratic: f64,
    riccati: Riccati,
    scratch: Scratch,
}

/// Entries of a commanded position: with a number that the compiler knows, the loops over so few entries cost half.
const USUAL_COMMAND: usize = 3;

#[derive(Debug, Clone)]
struct Scratch {
    /// p_{k+1} and p_k, 2 × stride.
    costate_change: [Entries; 2],
    lower: Vec<f64>,
    upper: Vec<f64>,
    gradient: Vec<f64>,
    /// m × m.
    inverse: Vec<f64>,
}

impl Policy {
    pub fn new(shape: Shape) -> Self {
        let (steps, m, stride) = (shape.steps(), shape.command, shape.stride);
        Self {
            shape,
            steps: vec![0.0; steps * m],
            gains: kernel::zeros(steps * m * stride),
            cross: kernel::zeros(steps * m * stride),
            hessians: vec![0.0; steps * m * m],
            factors: vec![0.0; steps * m * m],
            holds: vec![Hold::Free; steps * m],
            slope: 0.0,
            quadratic: 0.0,
            riccati: Riccati::new(shape),
            scratch: Scratch {
                costate_change: [kernel::zeros(stride), kernel::zeros(stride)],
                lower: vec![0.0; m],
                upper: vec![0.0; m],
                gradient: vec![0.0; m],
                inverse: vec![0.0; m * m],
            },
        }
    }

    /// d_k.
    pub fn step(&self, knot: usize) -> &[f64] {
        &self.steps[knot * self.shape.command..][..self.shape.command]
    }

    /// K_k, m × stride.
    pub fn gain(&self, knot: usize) -> &[f64] {
        let len = self.shape.command * self.shape.stride;
        &self.gains[knot * len..][..len]
    }

    /// Factorizes at the current expansion and computes the step.
    pub fn factorize<D: Dynamics + ?Sized>(
        &mut self,
        problem: &Problem,
        dynamics: &D,
        trajectory: &Trajectory,
        expansion: &Expansion,
        adjoint: &Adjoint,
        convexification: Convexification,
    ) -> Result<(), SweepFailure> {
        let Shape { fresh, stride, .. } = self.shape;
        let last = self.shape.steps();
        self.begin();
        self.riccati.start(expansion.diagonal(last));
        for knot in (0..last).rev() {
            let jacobian = trajectory.jacobian(knot);
            let diagonal = expansion.diagonal(knot);
            match &expansion.secant {
                _ if !convexification.curvature => self.riccati.begin(),
                None => {
                    let (state, command) = (trajectory.state(knot), trajectory.command(knot));
                    let fresh_costate = &adjoint.costate(knot + 1)[..fresh];
                    let curvature = self.riccati.begin_curved();
                    dynamics.add_curvature(knot, state, command, fresh_costate, stride, curvature);
                }
                Some(secant) => match secant.hessian(knot) {
                    Some(estimate) => self.riccati.begin_curved().copy_from_slice(estimate),
                    None => self.riccati.begin(),
                },
            }
            self.command_blocks(knot, jacobian, diagonal, convexification.damping);
            self.prepare_box(problem, trajectory, adjoint, knot);
            self.minimize(knot)?;
            self.feedback(knot);
            let rows = knot * self.shape.command * stride..(knot + 1) * self.shape.command * stride;
            let (gains, cross) = (&self.gains[rows.clone()], &self.cross[rows]);
            self.riccati.finish(jacobian, diagonal, gains, cross);
            self.pass_costate(knot);
        }
        Ok(())
    }

    /// Computes the step with the last factorization, though at the current expansion.
    pub fn reuse(
        &mut self,
        problem: &Problem,
        trajectory: &Trajectory,
        adjoint: &Adjoint,
    ) -> Result<(), SweepFailure> {
        let last = self.shape.steps();
        self.begin();
        for knot in (0..last).rev() {
            self.prepare_box(problem, trajectory, adjoint, knot);
            self.minimize_with_old_holds(knot)?;
            self.pass_costate(knot);
        }
        Ok(())
    }

    fn begin(&mut self) {
        (self.slope, self.quadratic) = (0.0, 0.0);
        self.scratch.costate_change[0].fill(0.0);
    }

    fn command_blocks(&mut self, knot: usize, jacobian: &[f64], diagonal: &[f64], damping: f64) {
        let Shape {
            command: m, stride, ..
        } = self.shape;
        let hessian = &mut self.hessians[knot * m * m..][..m * m];
        let cross = &mut self.cross[knot * m * stride..][..m * stride];
        self.riccati.command_blocks(jacobian, diagonal, hessian, cross);
        for j in 0..m {
            hessian[j * m + j] += damping;
        }
    }

    /// Bounds on d_k, and h_k = g_k + B_kᵀ p_{k+1}; turns p_{k+1} into `(A_kᵀ p_{k+1}, h_k)`.
    fn prepare_box(&mut self, problem: &Problem, trajectory: &Trajectory, adjoint: &Adjoint, knot: usize) {
        let Shape {
            state: n, command: m, ..
        } = self.shape;
        let Scratch {
            costate_change: [next, now],
            lower,
            upper,
            gradient,
            ..
        } = &mut self.scratch;
        now.fill(0.0);
        now[n..n + m].copy_from_slice(adjoint.gradient(knot));
        add_transpose_step(self.shape, trajectory.jacobian(knot), next, now);
        gradient.copy_from_slice(&now[n..n + m]);
        for (j, &u) in trajectory.command(knot).iter().enumerate() {
            lower[j] = problem.command_lower[j] - u;
            upper[j] = problem.command_upper[j] - u;
        }
    }

    fn minimize(&mut self, knot: usize) -> Result<(), SweepFailure> {
        match self.shape.command {
            USUAL_COMMAND => self.minimize_of(knot, USUAL_COMMAND),
            m => self.minimize_of(knot, m),
        }
    }

    #[inline(always)]
    fn minimize_of(&mut self, knot: usize, m: usize) -> Result<(), SweepFailure> {
        let Scratch {
            lower,
            upper,
            gradient,
            ..
        } = &self.scratch;
        let (lower, upper, gradient) = (&lower[..m], &upper[..m], &gradient[..m]);
        let holds = &mut self.holds[knot * m..][..m];
        for (j, hold) in holds.iter_mut().enumerate() {
            *hold = command_box::initial_hold(lower[j], upper[j], gradient[j]);
        }
        command_box::minimize(
            &self.hessians[knot * m * m..][..m * m],
            gradient,
            (lower, upper),
            holds,
            &mut self.factors[knot * m * m..][..m * m],
            &mut self.steps[knot * m..][..m],
        )?;
        Ok(())
    }

    fn minimize_with_old_holds(&mut self, knot: usize) -> Result<(), SweepFailure> {
        match self.shape.command {
            USUAL_COMMAND => self.minimize_with_old_holds_of(knot, USUAL_COMMAND),
            m => self.minimize_with_old_holds_of(knot, m),
        }
    }

    #[inline(always)]
    fn minimize_with_old_holds_of(&mut self, knot: usize, m: usize) -> Result<(), SweepFailure> {
        let Scratch {
            lower,
            upper,
            gradient,
            ..
        } = &self.scratch;
        let (lower, upper, gradient) = (&lower[..m], &upper[..m], &gradient[..m]);
        let hessian = &self.hessians[knot * m * m..][..m * m];
        let factor = &self.factors[knot * m * m..][..m * m];
        let (holds, step) = (&self.holds[knot * m..][..m], &mut self.steps[knot * m..][..m]);
        command_box::minimize_held(hessian, factor, gradient, (lower, upper), holds, step);
        match command_box::worst_fault(hessian, gradient, (lower, upper), holds, step) {
            Some(_) => Err(SweepFailure::HoldsChanged),
            None => Ok(()),
        }
    }

    /// `K = −Q_uu⁻¹ Q_uz` on the free commands, 0 on the held ones.
    fn feedback(&mut self, knot: usize) {
        match self.shape.command {
            USUAL_COMMAND => self.feedback_of(knot, USUAL_COMMAND),
            m => self.feedback_of(knot, m),
        }
    }

    #[inline(always)]
    fn feedback_of(&mut self, knot: usize, m: usize) {
        let stride = self.shape.stride;
        let factor = &self.factors[knot * m * m..][..m * m];
        let inverse = &mut self.scratch.inverse[..m * m];
        command_box::negative_inverse(factor, &self.holds[knot * m..][..m], inverse);
        let rows = knot * m * stride..(knot + 1) * m * stride;
        let (left, right) = (
            Rows::new(inverse, m, m),
            Rows::new(&self.cross[rows.clone()], m, stride),
        );
        kernel::sum_products([(left, right)], Wanted::All, stride, &mut self.gains[rows]);
    }

    /// Adds `Q_zu d_k` to p_k and accounts for the step's predicted decrease.
    fn pass_costate(&mut self, knot: usize) {
        let Shape {
            state: n,
            command: m,
            stride,
            ..
        } = self.shape;
        let step = &self.steps[knot * m..][..m];
        let hessian = &self.hessians[knot * m * m..][..m * m];
        let Scratch {
            costate_change: [next, now],
            gradient,
            ..
        } = &mut self.scratch;
        kernel::add_transpose_vector(&self.cross[knot * m * stride..][..m * stride], step, now);
        now[n..].fill(0.0);
        for i in 0..m {
            self.slope += gradient[i] * step[i];
            for j in 0..m {
                self.quadratic += 0.5 * step[i] * hessian[i * m + j] * step[j];
            }
        }
        std::mem::swap(next, now);
    }
}
