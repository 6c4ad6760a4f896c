//! A sweep's file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use flyvine::control::ControlLaw;
use flyvine::control::mpc::MpcOptions;
use serde::{Deserialize, Serialize};

use super::SweepError;
use super::parameters::Spread;

/// A sweep as its file says it; paths are relative to the file.
///
/// ```toml
/// name = "wind and payload"
/// bank = "bank.json"                      # tasks are planned on it …
/// tasks = ["tasks/swing_ES.toml"]
/// plans = ["plan.json"]                   # … finished plans need none
/// controllers = ["open-loop", "mpc"]
/// seeds = 20                              # flights of every cell
///
/// [grid]                                  # every combination of these
/// "payload.tip_mass_kg" = [0.0, 0.05, 0.1]
/// "wind.mean_m_s.0" = [0.0, 1.0, 2.0]
///
/// [spread]                                # drawn by every seed, the same in every cell
/// "arm.tip_mass_kg" = { relative = 0.1 }
/// "autopilot.command_delay_s" = { uniform = [0.0, 0.05] }
///
/// [success]
/// mean_error_m = 0.1
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepFile {
    /// Its name, for titles and messages.
    pub name: String,
    /// Finished plans.
    #[serde(default)]
    pub plans: Vec<PathBuf>,
    /// Tasks to plan on the bank.
    #[serde(default)]
    pub tasks: Vec<PathBuf>,
    /// The bank for the tasks.
    pub bank: Option<PathBuf>,
    /// The vehicle that parameters are varied about (TOML, with a table `[supervisor]` for the limits); the built-in one
    /// if absent.
    pub vehicle: Option<PathBuf>,
    /// The control laws that every plan is flown with.
    #[serde(default = "open_loop")]
    pub controllers: Vec<ControlLaw>,
    /// Settings of model-predictive control.
    #[serde(default)]
    pub mpc: MpcOptions,
    /// Seeds per combination: `first_seed`, `first_seed` + 1, …
    #[serde(default = "one")]
    pub seeds: u64,
    /// The first seed.
    #[serde(default = "one")]
    pub first_seed: u64,
    /// Vehicle parameters, by their path in the vehicle's TOML (an array's entry by its number), and the values to take;
    /// every combination is flown.
    #[serde(default)]
    pub grid: BTreeMap<String, Vec<f64>>,
    /// Vehicle parameters that every seed draws anew.
    #[serde(default)]
    pub spread: BTreeMap<String, Spread>,
    /// What counts as a success.
    #[serde(default)]
    pub success: Success,
}

/// What counts as a success: a flight flown to the end, within these.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Success {
    /// Greatest mean end-effector error against the reference, m.
    pub mean_error_m: Option<f64>,
    /// Swings: greatest miss of the target, m.
    pub target_miss_m: Option<f64>,
}

fn one() -> u64 {
    1
}

fn open_loop() -> Vec<ControlLaw> {
    vec![ControlLaw::OpenLoop]
}

impl SweepFile {
    /// Reads a sweep's file.
    ///
    /// # Errors
    /// The file cannot be read, or as [`Self::parse`].
    pub fn read(path: &Path) -> Result<Self, SweepError> {
        let text = std::fs::read_to_string(path).map_err(SweepError::file(path))?;
        Self::parse(&text, &path.display().to_string())
    }

    /// Reads the text of a sweep's file; `file` names it in errors.
    ///
    /// # Errors
    /// Wrong TOML, unknown or missing keys, wrong types.
    pub fn parse(text: &str, file: &str) -> Result<Self, SweepError> {
        toml::from_str(text).map_err(|error| SweepError::Syntax {
            file: file.to_owned(),
            message: error.to_string(),
        })
    }
}
