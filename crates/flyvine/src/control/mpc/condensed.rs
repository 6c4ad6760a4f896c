//! The horizon's quadratic cost condensed onto its commands.

use crate::kernel;
use crate::trajopt::Dynamics;
use nalgebra::DMatrix;

/// Weights of the tracking cost; no factor ½.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackingWeights {
    /// Diagonal of Q (n).
    pub state: Vec<f64>,
    /// Diagonal of R (m), on u − ū.
    pub command: Vec<f64>,
    /// Diagonal of S (m), on the change of u − ū from one command to the next.
    pub command_change: Vec<f64>,
}

/// Sizes of a model in companion form and where its Jacobians are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// Length n of the state.
    pub state: usize,
    /// Length m of the command.
    pub command: usize,
    /// Entries that a step computes; the rest are shifted.
    pub fresh: usize,
}

impl Stage {
    /// The sizes of `model`.
    pub fn of(model: &dyn Dynamics) -> Self {
        Self {
            state: model.state_len(),
            command: model.command_len(),
            fresh: model.fresh_len(),
        }
    }

    /// Length of a row of the Jacobian [∂f/∂z ∂f/∂u], padded.
    pub fn stride(&self) -> usize {
        kernel::padded(self.state + self.command)
    }

    /// Entries of a stage's Jacobian.
    pub fn jacobian_len(&self) -> usize {
        self.fresh * self.stride()
    }

    /// A and B of `z⁺ = A z + B u` from a padded Jacobian.
    pub fn transition(&self, jacobian: &[f64]) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, fresh, stride) = (self.state, self.fresh, self.stride());
        let a = DMatrix::from_fn(n, n, |i, j| {
            if i < fresh {
                jacobian[i * stride + j]
            } else {
                f64::from(j + fresh == i)
            }
        });
        let b = DMatrix::from_fn(n, self.command, |i, j| {
            if i < fresh {
                jacobian[i * stride + n + j]
            } else {
                0.0
            }
        });
        (a, b)
    }
}

/// A horizon whose Hessian cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CondensedError {
    /// Some change of the commands costs nothing, or the model has left the finite numbers.
    #[error(
        "the condensed Hessian of the {stages} stages from knot {knot} on is not positive definite; \
         expected finite Jacobians and positive command weights"
    )]
    NotPositiveDefinite {
        /// First knot of the horizon.
        knot: usize,
        /// Number of stages.
        stages: usize,
    },
}

/// A horizon of N stages: its Hessians, and the sensitivities of the softly bounded states.
///
/// With `δz_j = G_j v`: `H = 2 (Σ G_jᵀ Q G_j + G_Nᵀ P G_N + σ (R + Dᵀ S D))`, D taking differences of commands. The scale σ
/// of the weights on commands can be chosen anew at every step from those that were condensed.
#[derive(Debug, Clone, PartialEq)]
pub struct Condensed {
    /// N.
    pub stages: usize,
    /// H for each scale of the weights on commands.
    pub hessians: Vec<Hessian>,
    /// ∂z_j\[i\]/∂v for j = 1 … N and every bounded entry i (rows padded).
    pub soft: Vec<f64>,
}

/// H of a horizon for one scale of the weights on commands.
#[derive(Debug, Clone, PartialEq)]
pub struct Hessian {
    /// σ.
    pub command_scale: f64,
    /// H (N m rows, padded).
    pub matrix: Vec<f64>,
    /// H⁻¹, likewise.
    pub inverse: Vec<f64>,
}

impl Condensed {
    /// Condenses the stages whose Jacobians are `jacobians`, one after the other, for each of `command_scales`. `terminal`
    /// is P (n × n); `bounded` lists the softly bounded entries of the state.
    ///
    /// # Errors
    /// A Hessian is not positive definite; the error counts knots from 0.
    pub fn new(
        stage: &Stage,
        jacobians: &[f64],
        weights: &TrackingWeights,
        command_scales: &[f64],
        terminal: Option<&DMatrix<f64>>,
        bounded: &[usize],
    ) -> Result<Self, CondensedError> {
        let stages = jacobians.len() / stage.jacobian_len();
        let (m, variables) = (stage.command, stages * stage.command);
        let mut hessian = DMatrix::zeros(variables, variables);
        let mut sensitivity = DMatrix::zeros(stage.state, variables);
        let mut soft = Vec::with_capacity(stages * bounded.len() * kernel::padded(variables));
        let weighted: Vec<usize> = (0..stage.state).filter(|&i| weights.state[i] > 0.0).collect();
        for (j, jacobian) in jacobians.chunks_exact(stage.jacobian_len()).enumerate() {
            let (a, b) = stage.transition(jacobian);
            let reached = (j + 1) * m;
            // Columns of later commands are zero.
            let moved = &a * sensitivity.columns(0, j * m);
            sensitivity.columns_mut(0, j * m).copy_from(&moved);
            sensitivity.columns_mut(j * m, m).copy_from(&b);
            let used = sensitivity.columns(0, reached);
            let scaled = DMatrix::from_fn(weighted.len(), reached, |i, column| {
                weights.state[weighted[i]].sqrt() * used[(weighted[i], column)]
            });
            let mut block = hessian.view_mut((0, 0), (reached, reached));
            block += scaled.transpose() * &scaled;
            for &index in bounded {
                soft.extend(sensitivity.row(index).iter());
                soft.resize(soft.len().next_multiple_of(kernel::padded(variables)), 0.0);
            }
        }
        if let Some(terminal) = terminal {
            hessian += sensitivity.transpose() * terminal * &sensitivity;
        }
        let hessians = command_scales
            .iter()
            .map(|&scale| Hessian::new(hessian.clone(), weights, scale))
            .collect::<Option<_>>()
            .ok_or(CondensedError::NotPositiveDefinite { knot: 0, stages })?;
        Ok(Self {
            stages,
            hessians,
            soft,
        })
    }
}

impl Hessian {
    /// From half of what the states cost and the weights on commands; none if it is not positive definite.
    fn new(mut half: DMatrix<f64>, weights: &TrackingWeights, command_scale: f64) -> Option<Self> {
        let (m, variables) = (weights.command.len(), half.nrows());
        for i in 0..variables {
            let command = command_scale * weights.command[i % m];
            let change = command_scale * weights.command_change[i % m];
            let followed = i + m < variables;
            half[(i, i)] += command + if followed { 2.0 * change } else { change };
            if followed {
                half[(i, i + m)] -= change;
                half[(i + m, i)] -= change;
            }
        }
        let matrix = &half + half.transpose(); // the factor 2, exactly symmetric
        let inverse = matrix
            .clone()
            .cholesky()
            .map(|factor| factor.inverse())
            .filter(|inverse| inverse.iter().all(|entry| entry.is_finite()))?;
        Some(Self {
            command_scale,
            matrix: padded_rows(&matrix),
            inverse: padded_rows(&inverse),
        })
    }
}

/// A symmetric matrix with padded rows.
fn padded_rows(matrix: &DMatrix<f64>) -> Vec<f64> {
    let stride = kernel::padded(matrix.ncols());
    let mut rows = vec![0.0; matrix.nrows() * stride];
    for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
        for j in 0..matrix.ncols() {
            // Both halves the same, to the last bit.
            row[j] = matrix[(i.max(j), i.min(j))];
        }
    }
    rows
}
