//! What shall go wrong in a rehearsal, and when.

use serde::{Deserialize, Serialize};

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// No poses any more.
    MocapStale,
    /// The last pose again and again, with new stamps.
    MocapFrozen,
    /// Poses a metre beside the bodies.
    MocapJump,
    /// The bodies taken for each other.
    MocapSwap,
    /// Poses that are not numbers.
    MocapNan,
    /// Nothing gets through to the autopilot, nor back.
    LinkLoss,
    /// Frames are up to 80 ms late and out of order, both ways.
    LinkReorder,
    /// The autopilot starts anew.
    AutopilotReboot,
    /// The pilot takes the vehicle with the sticks.
    PilotTakesOver,
    /// The arm's controller says nothing any more.
    ArmSilent,
    /// The arm's controller reports a fault.
    ArmFault,
    /// The controller does not answer in time.
    SolverLate,
    /// The base station stands still for 160 ms.
    BaseStalls,
    /// The recording cannot be written.
    DiskFull,
    /// The base station's process is killed.
    BaseKilled,
    /// The processes at the vehicle's end are killed: motion capture, autopilot and arm fall silent together.
    VehicleKilled,
}

impl FaultKind {
    /// All of them.
    pub const ALL: [FaultKind; 16] = [
        FaultKind::MocapStale,
        FaultKind::MocapFrozen,
        FaultKind::MocapJump,
        FaultKind::MocapSwap,
        FaultKind::MocapNan,
        FaultKind::LinkLoss,
        FaultKind::LinkReorder,
        FaultKind::AutopilotReboot,
        FaultKind::PilotTakesOver,
        FaultKind::ArmSilent,
        FaultKind::ArmFault,
        FaultKind::SolverLate,
        FaultKind::BaseStalls,
        FaultKind::DiskFull,
        FaultKind::BaseKilled,
        FaultKind::VehicleKilled,
    ];

    /// Time from the fault to the abort that is allowed, s, without the tick in which it is noticed; `None` if the fault
    /// is one to live with.
    pub fn abort_limit_s(self) -> Option<f64> {
        match self {
            FaultKind::MocapStale | FaultKind::MocapFrozen => Some(0.4),
            FaultKind::LinkReorder => None,
            _ => Some(0.3),
        }
    }
}

/// Where a flight stands, as it can be seen from the vehicle's end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// Before the first set-point.
    Idle,
    /// Set-points stream, the motors are off.
    PreArm,
    /// Armed, on the way up.
    TakeOff,
    /// From the first set-point that is not straight above the ground.
    Flight,
    /// The autopilot lands.
    Land,
}

/// One fault of a script.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptedFault {
    /// What goes wrong.
    pub kind: FaultKind,
    /// In which phase.
    pub phase: Phase,
    /// How long after the phase has begun, s.
    #[serde(default)]
    pub after_s: f64,
    /// For how long, s; to the end if left out.
    #[serde(default)]
    pub duration_s: Option<f64>,
}

/// A script: what goes wrong in one rehearsal.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// The faults, in any order.
    #[serde(default)]
    pub fault: Vec<ScriptedFault>,
}

/// A script that cannot be followed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScriptError {
    /// Not TOML, or not of this form.
    #[error("{0}")]
    Form(#[from] toml::de::Error),
    /// A time that is negative or not a number.
    #[error("fault {index}: {key} = {found}; expected a number of seconds, 0 or more")]
    Time {
        /// Which fault, from 1.
        index: usize,
        /// Its key.
        key: &'static str,
        /// The value.
        found: f64,
    },
}

impl Script {
    /// Reads `[[fault]]` tables with `kind`, `phase`, `after_s` and `duration_s`.
    pub fn parse(text: &str) -> Result<Self, ScriptError> {
        let script: Script = toml::from_str(text)?;
        for (i, fault) in script.fault.iter().enumerate() {
            let times = [("after_s", Some(fault.after_s)), ("duration_s", fault.duration_s)];
            for (key, time_s) in times {
                if let Some(found) = time_s
                    && !(found.is_finite() && found >= 0.0)
                {
                    return Err(ScriptError::Time {
                        index: i + 1,
                        key,
                        found,
                    });
                }
            }
        }
        Ok(script)
    }
}

/// Follows a script.
#[derive(Debug, Clone)]
pub struct FaultClock {
    script: Script,
    begun_s: Vec<Option<f64>>,
    phase: Phase,
    phase_s: f64,
}

impl FaultClock {
    /// A script of which nothing has happened yet.
    pub fn new(script: Script) -> Self {
        Self {
            begun_s: vec![None; script.fault.len()],
            script,
            phase: Phase::Idle,
            phase_s: 0.0,
        }
    }

    /// The phase at `now_s`; phases are never left backwards.
    pub fn advance(&mut self, now_s: f64, phase: Phase) {
        if phase > self.phase {
            (self.phase, self.phase_s) = (phase, now_s);
        }
        for (fault, begun_s) in self.script.fault.iter().zip(&mut self.begun_s) {
            // Flights are too short to wait for a phase that was skipped.
            let due = self.phase == fault.phase && now_s - self.phase_s >= fault.after_s;
            if due && begun_s.is_none() {
                *begun_s = Some(now_s);
            }
        }
    }

    /// Where the flight stands.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether a fault is there at `now_s`.
    pub fn is_active(&self, now_s: f64, kind: FaultKind) -> bool {
        self.script
            .fault
            .iter()
            .zip(&self.begun_s)
            .any(|(fault, begun_s)| {
                let lasts = |begun_s: f64| {
                    fault
                        .duration_s
                        .is_none_or(|duration_s| now_s - begun_s < duration_s)
                };
                fault.kind == kind && begun_s.is_some_and(lasts)
            })
    }

    /// When the first fault began, s.
    pub fn first_begun_s(&self) -> Option<f64> {
        self.begun_s.iter().copied().flatten().reduce(f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_is_followed_and_a_bad_one_is_refused() {
        let script = Script::parse(
            "[[fault]]\nkind = \"mocap-stale\"\nphase = \"flight\"\nafter_s = 2.0\nduration_s = 0.5",
        )
        .unwrap();
        let mut clock = FaultClock::new(script);
        clock.advance(1.0, Phase::PreArm);
        clock.advance(5.0, Phase::Flight);
        clock.advance(6.9, Phase::Flight);
        assert!(!clock.is_active(6.9, FaultKind::MocapStale));
        clock.advance(7.0, Phase::TakeOff);
        assert_eq!((clock.phase(), clock.first_begun_s()), (Phase::Flight, Some(7.0)));
        assert!(clock.is_active(7.4, FaultKind::MocapStale) && !clock.is_active(7.5, FaultKind::MocapStale));
        assert!(!clock.is_active(7.4, FaultKind::MocapNan));
        for bad in [
            "[[fault]]\nkind = \"gremlin\"\nphase = \"flight\"",
            "[[fault]]\nkind = \"disk-full\"\nphase = \"flight\"\nafter_s = nan",
            "[[fault]]\nkind = \"disk-full\"\nphase = \"flight\"\nwhen = 1.0",
        ] {
            Script::parse(bad).unwrap_err();
        }
    }
}
