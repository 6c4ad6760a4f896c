//! The one interface between models and the solver.

/// Discrete dynamics in companion form.
///
/// The next state is `fresh_len` newly computed entries followed by a shifted copy of the old state:
///
/// ```text
/// z⁺ = ( f_k(z, u),  z[0 .. state_len − fresh_len] )
/// ```
///
/// A lagged model has `state_len = lags · 9` and `fresh_len = 9`; a model without lags has
/// `fresh_len = state_len` and nothing is shifted. The solver exploits the shift.
pub trait Dynamics: Sync {
    /// Length n of the state z.
    fn state_len(&self) -> usize;
    /// Length m of the command u.
    fn command_len(&self) -> usize;
    /// Number of entries of z⁺ that [`Self::step`] computes; the rest are shifted copies.
    fn fresh_len(&self) -> usize;

    /// `fresh = f_k(z, u)`, with `fresh` of length [`Self::fresh_len`].
    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]);

    /// [`Self::step`], and the Jacobian `[∂f_k/∂z  ∂f_k/∂u]`, `fresh_len × (n + m)`, row-major.
    fn linearize(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64], jacobian: &mut [f64]);

    /// [`Self::linearize`], with rows of the Jacobian `stride` entries apart, n + m rounded up to a multiple of 8, and
    /// zeros in between: worth writing for models that keep theirs so.
    fn linearize_padded(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        fresh: &mut [f64],
        stride: usize,
        jacobian: &mut [f64],
    ) {
        linearize_and_spread(self, knot, state, command, fresh, stride, jacobian);
    }

    /// The Jacobian alone, as [`Self::linearize`] gives it.
    fn jacobian(&self, knot: usize, state: &[f64], command: &[f64], jacobian: &mut [f64]) {
        self.linearize(knot, state, command, &mut vec![0.0; self.fresh_len()], jacobian);
    }

    /// Adds `Σ_i adjoint_i ∇²f_i` at `(z, u)` to `hessian`: full symmetric, n + m rows of
    /// `stride` entries: n + m rounded up to a multiple of 8. A model that leaves it alone has its curvature estimated
    /// from how its Jacobians change.
    fn add_curvature(
        &self,
        knot: usize,
        state: &[f64],
        command: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        let _ = (knot, state, command, adjoint, stride, hessian);
    }
}

/// [`Dynamics::linearize_padded`] for models whose rows stand one behind the other.
pub(crate) fn linearize_and_spread<D: Dynamics + ?Sized>(
    dynamics: &D,
    knot: usize,
    state: &[f64],
    command: &[f64],
    fresh: &mut [f64],
    stride: usize,
    jacobian: &mut [f64],
) {
    let (rows, width) = (dynamics.fresh_len(), state.len() + command.len());
    dynamics.linearize(knot, state, command, fresh, &mut jacobian[..rows * width]);
    for row in (0..rows).rev() {
        jacobian.copy_within(row * width..(row + 1) * width, row * stride);
        jacobian[row * stride + width..(row + 1) * stride].fill(0.0);
    }
}

impl<D: Dynamics + ?Sized> Dynamics for &D {
    fn state_len(&self) -> usize {
        (**self).state_len()
    }

    fn command_len(&self) -> usize {
        (**self).command_len()
    }

    fn fresh_len(&self) -> usize {
        (**self).fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        (**self).step(knot, state, command, fresh);
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        (**self).linearize(knot, z, u, fresh, jacobian);
    }

    fn linearize_padded(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        fresh: &mut [f64],
        stride: usize,
        jacobian: &mut [f64],
    ) {
        (**self).linearize_padded(knot, z, u, fresh, stride, jacobian);
    }

    fn add_curvature(
        &self,
        knot: usize,
        z: &[f64],
        u: &[f64],
        adjoint: &[f64],
        stride: usize,
        hessian: &mut [f64],
    ) {
        (**self).add_curvature(knot, z, u, adjoint, stride, hessian);
    }
}
