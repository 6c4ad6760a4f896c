//! What motion capture gets wrong in flight, found pose by pose.
//!
//! The rules are those of a recording's hygiene (`flyvine::flight::clean`), without a look into the future: a
//! pose that nothing yet explains is refused, and accepted only when the body stays where it appeared.

use std::fmt;

use serde::Serialize;

/// What counts as a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HygieneLimits {
    /// Fastest that a body can fly, m/s. Default 12: a limp arm's tip reaches 8.
    pub speed_max_m_s: f64,
    /// Farthest that noise alone can carry a position between two frames, m. Default 0.03.
    pub noise_m: f64,
    /// Fastest that a body can turn, rad/s. Default 30.
    pub turn_rate_max_rad_s: f64,
    /// Farthest that noise alone can turn a body between two frames, rad. Default 0.2.
    pub turn_noise_rad: f64,
    /// A jump that ends so near to another body is a swap, m. Default 0.15.
    pub swap_radius_m: f64,
    /// A body that stays where it jumped to is believed after so long, s. Default 0.5: longer than the 0.4 s after
    /// which a flight without credible poses is over.
    pub reacquire_s: f64,
    /// The same after a swap, s. Default 5: nothing flies any more.
    pub reacquire_swapped_s: f64,
}

impl Default for HygieneLimits {
    fn default() -> Self {
        HygieneLimits {
            speed_max_m_s: 12.0,
            noise_m: 0.03,
            turn_rate_max_rad_s: 30.0,
            turn_noise_rad: 0.2,
            swap_radius_m: 0.15,
            reacquire_s: 0.5,
            reacquire_swapped_s: 5.0,
        }
    }
}

/// Why a pose was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LiveFault {
    /// The server says that it does not see the body.
    Untracked,
    /// NaN or infinity.
    NotFinite,
    /// The quaternion is not of unit length.
    NotUnit,
    /// It is not newer than the last one: reordered or doubled on the way, or the server's clock stands still.
    Late,
    /// Exactly the last pose again, while another body moved.
    Frozen,
    /// Farther from the last credible pose than the body can fly.
    Jump,
    /// Turned farther than the body can turn.
    Turn,
    /// A jump to where another body is.
    Swapped,
}

impl LiveFault {
    /// Whether the server says where the body is, but it cannot be there. The other faults are poses that are missing.
    pub fn is_nonsense(self) -> bool {
        match self {
            LiveFault::NotFinite
            | LiveFault::NotUnit
            | LiveFault::Jump
            | LiveFault::Turn
            | LiveFault::Swapped => true,
            LiveFault::Untracked | LiveFault::Late | LiveFault::Frozen => false,
        }
    }
}

/// How often each fault was found in one body, in poses; for the last three, in events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct HygieneCounts {
    /// [`LiveFault::Untracked`]
    pub untracked: u64,
    /// [`LiveFault::NotFinite`]
    pub not_finite: u64,
    /// [`LiveFault::NotUnit`]
    pub not_unit: u64,
    /// [`LiveFault::Late`]
    pub late: u64,
    /// [`LiveFault::Frozen`]
    pub frozen: u64,
    /// [`LiveFault::Jump`]
    pub jump: u64,
    /// [`LiveFault::Turn`]
    pub turn: u64,
    /// [`LiveFault::Swapped`]
    pub swapped: u64,
    /// The quaternion changed its sign; repaired.
    pub sign_flip: u64,
    /// More than three frames in a row did not come.
    pub gap: u64,
    /// The body was believed where it had jumped to.
    pub reacquired: u64,
}

impl HygieneCounts {
    /// Counts a refused pose.
    pub(super) fn add(&mut self, fault: LiveFault) {
        let count = match fault {
            LiveFault::Untracked => &mut self.untracked,
            LiveFault::NotFinite => &mut self.not_finite,
            LiveFault::NotUnit => &mut self.not_unit,
            LiveFault::Late => &mut self.late,
            LiveFault::Frozen => &mut self.frozen,
            LiveFault::Jump => &mut self.jump,
            LiveFault::Turn => &mut self.turn,
            LiveFault::Swapped => &mut self.swapped,
        };
        *count += 1;
    }

    /// Each kind by name, with its count.
    pub fn by_name(&self) -> [(&'static str, u64); 11] {
        [
            ("untracked", self.untracked),
            ("not finite", self.not_finite),
            ("no unit quaternion", self.not_unit),
            ("late", self.late),
            ("frozen", self.frozen),
            ("jump", self.jump),
            ("turn", self.turn),
            ("swapped", self.swapped),
            ("sign flip", self.sign_flip),
            ("gap", self.gap),
            ("reacquired", self.reacquired),
        ]
    }
}

/// The kinds that occurred, with their counts; `nothing` if none did.
impl fmt::Display for HygieneCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found: Vec<String> = self
            .by_name()
            .into_iter()
            .filter(|(_, count)| *count > 0)
            .map(|(name, count)| format!("{count} × {name}"))
            .collect();
        f.pad(&if found.is_empty() {
            "nothing".to_owned()
        } else {
            found.join(", ")
        })
    }
}
