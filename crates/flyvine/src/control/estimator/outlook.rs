//! What the estimator expects: of air and load, with a bank's model in it, and of the vehicle until a command acts.

use super::{AIR, AIR_GUST, Estimator, TIP_LOAD};
use crate::model::ScheduledModel;
use crate::model::physical::Surroundings;
use crate::trajopt::Dynamics;

/// Air and load as they are expected from a knot on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlook {
    /// The knot.
    pub knot: usize,
    /// What stays.
    pub steady: Surroundings,
    /// What a gust adds to the wind there, m/s …
    pub gust_m_s: [f64; 3],
    /// … of which this share is left at each further knot.
    pub gust_decay: f64,
}

impl Outlook {
    /// The surroundings at `knot`.
    pub fn at(&self, knot: usize) -> Surroundings {
        let left = self.gust_decay.powi(knot.saturating_sub(self.knot) as i32);
        let mut around = self.steady;
        for (wind, gust) in around.wind_m_s.iter_mut().zip(self.gust_m_s) {
            *wind += left * gust;
        }
        around
    }
}

/// How late commands are: `whole` knots, and a `fraction` of −½ to ½ of a knot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lateness {
    /// Whole knots.
    pub whole: usize,
    /// What is left.
    pub fraction: f64,
}

/// A bank's model in the surroundings that are expected.
#[derive(Debug, Clone, Copy)]
pub struct Surrounded<'a> {
    /// The model.
    pub model: &'a ScheduledModel,
    /// The surroundings.
    pub outlook: Outlook,
}

impl Dynamics for Surrounded<'_> {
    fn state_len(&self) -> usize {
        self.model.state_len()
    }

    fn command_len(&self) -> usize {
        self.model.command_len()
    }

    fn fresh_len(&self) -> usize {
        self.model.fresh_len()
    }

    fn step(&self, knot: usize, state: &[f64], command: &[f64], fresh: &mut [f64]) {
        self.model
            .step_in(knot, &self.outlook.at(knot), state, command, fresh);
    }

    fn linearize(&self, knot: usize, z: &[f64], u: &[f64], fresh: &mut [f64], jacobian: &mut [f64]) {
        self.model
            .linearize_in(knot, &self.outlook.at(knot), z, u, fresh, jacobian, None);
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
        self.model.add_curvature(knot, z, u, adjoint, stride, hessian);
    }
}

impl<'a> Estimator<'a> {
    /// Wind and load as expected from `knot` on, the knot of the estimate.
    pub fn outlook(&self, knot: usize) -> Outlook {
        let at = |first: usize| std::array::from_fn(|axis| self.mean[self.state_len() + first + axis]);
        Outlook {
            knot,
            steady: Surroundings {
                wind_m_s: at(AIR),
                tip_load: self.mean[self.state_len() + TIP_LOAD],
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

    /// Writes what the steady disturbances and the gusts add to the fresh entries of a step, E d and E g.
    fn write_push(&self, steady: &mut [f64], gust: &mut [f64]) {
        for (push, sources) in [(steady, self.disturbance()), (gust, self.gust())] {
            push.fill(0.0);
            for (entry, disturbance, gain) in &self.layout.entries {
                push[*entry] += gain * sources[*disturbance];
            }
        }
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
}
