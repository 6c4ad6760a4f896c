//! Bending hysteresis: an elasto-slip element in parallel with a joint's spring.
//!
//! The folds and layers of an inflated tube stick to each other until the bending moment between them overcomes
//! their friction; from there on they slide. Jenkin's element, a spring k_s in series with a Coulomb slider of moment
//! M_s, is the simplest model of it (Iwan, "A Distributed-Element Model for Hysteresis", J. Appl. Mech. 33, 1966), and
//! eight joints in a row, each slipping at its own time, round the loop of the whole arm:
//!
//! ```text
//! τ = −k_s (φ − s),   |k_s (φ − s)| ≤ M_s,   s follows φ where the bound is reached
//! ```
//!
//! φ is the joint's bend and s the slider's place, both in the parent link's axes. It is rate-independent. A cycle
//! between ±Φ dissipates `4 M_s (Φ − M_s/k_s)`, and nothing if Φ ≤ M_s/k_s. Within a step of the integration the slider
//! stands still and the torque saturates at M_s, a conservative force (Huber's potential); at its end the slider is put
//! where the bound is just reached, which lowers that potential or leaves it. So no energy is ever created.

use nalgebra::Vector3;

/// The elasto-slip element of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElastoSlip {
    /// Stiffness k_s while it sticks, N m/rad; positive.
    pub stiffness: f64,
    /// Moment M_s at which it slips, N m; positive.
    pub slip_moment: f64,
}

impl ElastoSlip {
    /// Torque on the child for a bend φ with the slider at s, both in the parent's axes, N m.
    pub(super) fn torque(&self, bend: &Vector3<f64>, slider: &Vector3<f64>) -> Vector3<f64> {
        (-self.stiffness * (bend - slider)).cap_magnitude(self.slip_moment)
    }

    /// The slider's place after a step that ended at the bend φ.
    pub(super) fn settled(&self, bend: &Vector3<f64>, slider: &Vector3<f64>) -> Vector3<f64> {
        bend + self.torque(bend, slider) / self.stiffness
    }

    /// Potential of the torque at a standing slider, J: quadratic while it sticks, linear beyond.
    pub(super) fn energy(&self, bend: &Vector3<f64>, slider: &Vector3<f64>) -> f64 {
        let stretch = (bend - slider).norm();
        let limit = self.slip_moment / self.stiffness;
        if stretch <= limit {
            0.5 * self.stiffness * stretch * stretch
        } else {
            self.slip_moment * (stretch - 0.5 * limit)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ELEMENT: ElastoSlip = ElastoSlip {
        stiffness: 2.0,
        slip_moment: 0.1,
    };

    /// Work done on the element by one cycle between ±`amplitude` in `steps` steps, from the loop's second round on.
    fn loop_area(amplitude: f64, steps: usize) -> f64 {
        let direction = Vector3::new(0.6, -0.8, 0.0);
        let at = |k: usize| amplitude * (std::f64::consts::TAU * k as f64 / steps as f64).sin() * direction;
        let mut slider = Vector3::zeros();
        let mut work = 0.0;
        for k in 1..=2 * steps {
            let (before, after) = (at(k - 1), at(k));
            let torque = ELEMENT.torque(&before, &slider);
            slider = ELEMENT.settled(&after, &slider);
            if k > steps {
                work -= 0.5 * (torque + ELEMENT.torque(&after, &slider)).dot(&(after - before));
            }
        }
        work
    }

    #[test]
    fn loop_area_is_the_closed_form_and_independent_of_the_rate() {
        for amplitude in [0.06, 0.1, 0.4] {
            let exact = 4.0 * ELEMENT.slip_moment * (amplitude - ELEMENT.slip_moment / ELEMENT.stiffness);
            // The number of steps per cycle stands for the rate: time itself does not enter.
            for steps in [400, 4000] {
                let area = loop_area(amplitude, steps);
                assert!(
                    (area - exact).abs() < 2e-2 * exact,
                    "{amplitude}: {area} instead of {exact}"
                );
            }
        }
        assert!(
            loop_area(0.049, 400).abs() < 1e-15,
            "it sticks below M/k = 0.05 rad"
        );
    }

    /// Whatever the path in two planes, what comes out is never more than what went in.
    #[test]
    fn no_path_creates_energy() {
        let mut slider = Vector3::zeros();
        let mut bend = Vector3::zeros();
        for k in 0..5000 {
            let t = 0.01 * f64::from(k);
            let next = Vector3::new(0.3 * t.sin(), 0.2 * (1.7 * t).cos() - 0.2, 0.1 * (0.3 * t).sin());
            let before = ELEMENT.energy(&bend, &slider);
            // Moving with the slider held changes the potential by the work; letting it settle only lowers it.
            let held = ELEMENT.energy(&next, &slider);
            slider = ELEMENT.settled(&next, &slider);
            let after = ELEMENT.energy(&next, &slider);
            assert!(after <= held + 1e-15, "{k}: {after} > {held}, from {before}");
            assert!(ELEMENT.torque(&next, &slider).norm() <= ELEMENT.slip_moment * (1.0 + 1e-12));
            bend = next;
        }
    }

    #[test]
    fn torque_is_the_slope_of_the_energy() {
        let slider = Vector3::new(0.02, -0.01, 0.03);
        for bend in [Vector3::new(0.03, 0.0, 0.02), Vector3::new(0.3, -0.2, 0.1)] {
            let slope = Vector3::from_fn(|i, _| {
                let mut step = Vector3::zeros();
                step[i] = 1e-6;
                (ELEMENT.energy(&(bend + step), &slider) - ELEMENT.energy(&(bend - step), &slider)) / 2e-6
            });
            assert!((ELEMENT.torque(&bend, &slider) + slope).norm() < 1e-8);
        }
    }
}
