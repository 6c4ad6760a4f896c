//! The paper's way to fly: the planned commands, whatever happens.

use super::{Controller, Proposal, Tick, Trajectory};

/// u_k = u*_k.
pub struct OpenLoop<'a> {
    trajectory: &'a Trajectory,
}

impl<'a> OpenLoop<'a> {
    /// Flies the commands of `trajectory`.
    pub fn new(trajectory: &'a Trajectory) -> Self {
        Self { trajectory }
    }
}

impl Controller for OpenLoop<'_> {
    fn propose(&mut self, tick: &Tick) -> Proposal {
        Proposal::Command(self.trajectory.command(tick.knot))
    }
}
