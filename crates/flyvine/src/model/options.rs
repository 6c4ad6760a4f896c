//! What the user may choose about a fit.

use super::error::ModelError;
use super::lag::require_lags;
use serde::{Deserialize, Serialize};

/// Structure of the model's rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Structure {
    /// Eight linear rows; the end-effector height full quadratic with offset (Jitosho et al., Sec. III-A).
    #[default]
    Paper,
    /// All nine rows linear, no offset.
    Linear,
}

/// How strongly coefficients are held back: λ in `min ‖y − Xθ‖² + λ‖Dθ‖²`, D being X's column norms and y
/// the increment of the row's signal.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ridge {
    /// By rollout error on flights that were held out; zero is among the candidates.
    #[default]
    Auto,
    /// This strength, dimensionless, ≥ 0.
    Value(f64),
}

/// Whether the commanded velocity is an input beside the commanded position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VelocityInput {
    /// Where every flight has it and held-out rollouts are better for it.
    Auto,
    /// No.
    #[default]
    Off,
    /// Yes; a flight without it is an error.
    On,
}

/// Whether models are refined on multi-step simulation error after one-step least squares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Refinement {
    /// Where it predicts flights that it was not fitted on better (three flights per configuration, or more).
    #[default]
    Auto,
    /// No: plain one-step least squares, as in the paper.
    Off,
    /// Yes.
    On,
}

/// Which positions the rows depend on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Positions {
    /// Also where in the room the vehicle is, as in the paper.
    #[default]
    Absolute,
    /// Only relative to the quadrotor's present position (translation-equivariant): shifting the whole room, its commands
    /// and all, shifts the prediction by as much. Fewer coefficients; wrong where the room itself acts on the vehicle,
    /// as a wall or the ground does. Every row has an offset then.
    Relative,
}

/// Options of [`super::fit_bank`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FitOptions {
    /// Structure of the rows.
    pub structure: Structure,
    /// States in z; the paper has 3.
    pub lags: usize,
    /// Ridge strength of the quadratic height row.
    pub height_ridge: Ridge,
    /// Ridge strength of the linear rows.
    pub linear_ridge: Ridge,
    /// Commanded velocity as an input.
    pub command_velocity: VelocityInput,
    /// Positions in the room, or relative ones; `None`: those with which held-out rollouts are better.
    pub positions: Option<Positions>,
    /// Refinement on multi-step simulation error.
    pub refinement: Refinement,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            structure: Structure::Paper,
            lags: 3,
            height_ridge: Ridge::Auto,
            linear_ridge: Ridge::Auto,
            command_velocity: VelocityInput::Auto,
            positions: None,
            refinement: Refinement::Auto,
        }
    }
}

impl FitOptions {
    /// Refuses options outside their range.
    pub(crate) fn validate(&self) -> Result<(), ModelError> {
        require_lags(self.lags)?;
        for (what, ridge) in [
            ("height_ridge", self.height_ridge),
            ("linear_ridge", self.linear_ridge),
        ] {
            if let Ridge::Value(value) = ridge
                && !(value.is_finite() && value >= 0.0)
            {
                return Err(ModelError::Unsupported {
                    what,
                    found: value.to_string(),
                    expected: "a finite number ≥ 0".into(),
                });
            }
        }
        Ok(())
    }
}
