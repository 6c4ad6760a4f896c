//! What a flight meets and no fit knows: moving air, and what hangs from the tip.

use super::scalar::Scalar;

/// Number of entries of [`Surroundings`].
pub const SURROUNDINGS_LEN: usize = 4;

/// Moving air and a load at the tip; the model was fitted without either.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surroundings<S = f64> {
    /// Velocity of the air in the world, m/s.
    pub wind_m_s: [S; 3],
    /// Share by which the tip is heavier than when the model was fitted.
    pub tip_load: S,
}

impl<S: Scalar> Surroundings<S> {
    /// Those in which models are fitted.
    pub fn calm() -> Self {
        Self::from_array([S::from(0.0); SURROUNDINGS_LEN])
    }

    /// Wind, then load.
    pub fn from_array([x, y, z, tip_load]: [S; SURROUNDINGS_LEN]) -> Self {
        Self {
            wind_m_s: [x, y, z],
            tip_load,
        }
    }
}

impl Surroundings {
    /// Wind, then load.
    pub fn to_array(self) -> [f64; SURROUNDINGS_LEN] {
        let [x, y, z] = self.wind_m_s;
        [x, y, z, self.tip_load]
    }
}
