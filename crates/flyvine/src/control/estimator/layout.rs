//! Where disturbances enter a model's state, and how uncertain its entries are.

use super::DISTURBANCES;
use crate::model::physical::offset;
use crate::model::{NoiseLevels, SurroundingsNoise};

/// Where disturbances enter a family's state, and how uncertain its entries are. Vectors are over z, d, g, a, τ.
#[derive(Debug, Clone)]
pub(super) struct Layout {
    /// (entry of the fresh state, disturbance, gain).
    pub entries: Vec<(usize, usize, f64)>,
    /// Standard deviations at the start.
    pub initial: Vec<f64>,
    /// What a knot adds to them.
    pub process: Vec<f64>,
    /// Of the measured outputs.
    pub measured: [f64; DISTURBANCES],
    /// What is left of a gust one knot later.
    pub gust_decay: f64,
}

/// How uncertain the steady disturbances are at the start, in knots of their wandering: a wind may blow already.
const DISTURBANCE_INITIAL_KNOTS: f64 = 50.0;
/// The same of a steady wind and of the load.
const SURROUNDINGS_INITIAL_KNOTS: f64 = 200.0;
/// Of a family that does not know its surroundings.
pub(super) const NOT_ESTIMATED: SurroundingsNoise = SurroundingsNoise {
    wind_m_s: 0.0,
    gust_m_s: 0.0,
    tip_load: 0.0,
};

/// Standard deviations of the physical state's blocks: at the start, at rest, and what a knot adds; m, s, rad.
const PHYSICAL: [(usize, f64, f64, usize); 14] = [
    (3, 2e-3, 1e-4, 0), // position
    (3, 5e-3, 5e-4, 1), // attitude
    (3, 5e-3, 1e-4, 2), // tip
    (3, 1e-2, 3e-3, 0), // velocity
    (3, 5e-2, 2e-2, 1), // body rate
    (3, 0.5, 0.2, 1),   // angular acceleration
    (3, 0.2, 2e-2, 1),  // rate integrator
    (3, 0.3, 5e-3, 0),  // integrator
    (3, 1e-2, 5e-3, 0), // filtered velocity
    (1, 0.1, 3e-2, 0),  // thrust
    (6, 1e-4, 1e-5, 0), // commands in transport
    (3, 2e-2, 5e-3, 2), // tip velocity
    (3, 1e-2, 2e-4, 2), // inner joint
    (3, 2e-2, 5e-3, 2), // its velocity
];
/// First entry of the inner joint's velocity.
const JOINT_VELOCITY: usize = offset::JOINTS + 3;
/// What pushes the tip pushes the inner joint by this share.
const JOINT_SHARE: f64 = 0.5;

impl Layout {
    /// Lagged poses: each disturbance adds to its entry of the newest pose.
    pub fn lag(state_len: usize, noise: &NoiseLevels) -> Self {
        let mut initial = vec![2e-3; state_len];
        let mut process = vec![0.0; state_len];
        process[..DISTURBANCES].copy_from_slice(&noise.process.entries());
        append(noise, &NOT_ESTIMATED, &mut initial, &mut process);
        Self {
            entries: (0..DISTURBANCES).map(|i| (i, i, 1.0)).collect(),
            initial,
            process,
            measured: noise.measured.entries(),
            gust_decay: gust_decay(noise),
        }
    }

    /// Physics: forces on quadrotor and arm, as velocities gained per knot, and a drift of the attitude.
    pub fn physical(state_len: usize, noise: &NoiseLevels) -> Self {
        let share = noise.process.entries();
        let blocks = || {
            PHYSICAL
                .iter()
                .flat_map(|&(count, initial, step, body)| std::iter::repeat_n((initial, step, body), count))
        };
        let mut initial: Vec<f64> = blocks().map(|(initial, ..)| initial).collect();
        let mut process: Vec<f64> = blocks().map(|(_, step, body)| step * share[3 * body]).collect();
        assert_eq!(process.len(), state_len, "the blocks cover the physical state");
        // What a poor model gets wrong must not be taken for a wind or a load.
        let around = SurroundingsNoise {
            wind_m_s: noise.surroundings.wind_m_s * noise.trust(),
            gust_m_s: noise.surroundings.gust_m_s * noise.trust(),
            tip_load: noise.surroundings.tip_load * noise.trust(),
        };
        append(noise, &around, &mut initial, &mut process);
        let mut entries = Vec::new();
        for axis in 0..3 {
            entries.push((offset::VELOCITY + axis, axis, 1.0));
            entries.push((offset::ATTITUDE + axis, 3 + axis, 1.0));
            entries.push((offset::TIP_VELOCITY + axis, 6 + axis, 1.0));
            entries.push((JOINT_VELOCITY + axis, 6 + axis, JOINT_SHARE));
        }
        Self {
            entries,
            initial,
            process,
            measured: noise.measured.entries(),
            gust_decay: gust_decay(noise),
        }
    }
}

fn gust_decay(noise: &NoiseLevels) -> f64 {
    (-crate::DT / noise.gust_s).exp()
}

/// Disturbances, gusts, surroundings and delay, behind the state.
fn append(noise: &NoiseLevels, around: &SurroundingsNoise, initial: &mut Vec<f64>, process: &mut Vec<f64>) {
    // What keeps g⁺ = ρ g + w at its strength.
    let renewed = (1.0 - gust_decay(noise).powi(2)).sqrt();
    for level in noise.disturbance.entries() {
        initial.push(level * DISTURBANCE_INITIAL_KNOTS);
        process.push(level);
    }
    for strength in noise.gust.entries() {
        initial.push(strength);
        process.push(strength * renewed);
    }
    // Winds are horizontal: a tip that an arm lifts by folding, which no model knows, is not blown upwards.
    let horizontal = |level: f64| [level, level, 0.0];
    for level in horizontal(around.wind_m_s) {
        initial.push(level);
        process.push(level / SURROUNDINGS_INITIAL_KNOTS);
    }
    for strength in horizontal(around.gust_m_s) {
        initial.push(strength);
        process.push(strength * renewed);
    }
    initial.push(around.tip_load);
    process.push(around.tip_load / SURROUNDINGS_INITIAL_KNOTS);
    initial.push(noise.delay_initial);
    process.push(noise.delay);
}
