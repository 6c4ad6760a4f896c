//! Units that recordings come in.

use serde::Deserialize;

/// Units of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the names say it")]
pub enum TimeUnit {
    S,
    Ms,
    Us,
    Ns,
}

/// Units of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the names say it")]
pub enum LengthUnit {
    M,
    Cm,
    Mm,
}

/// Units of velocity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[expect(missing_docs, reason = "the names say it")]
pub enum VelocityUnit {
    #[serde(rename = "m/s")]
    MPerS,
    #[serde(rename = "cm/s")]
    CmPerS,
    #[serde(rename = "mm/s")]
    MmPerS,
}

/// Units of gauge pressure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the names say it")]
pub enum PressureUnit {
    Kpa,
    Pa,
    Psi,
    Bar,
}

/// A unit as a factor to SI (kPa for pressure).
pub(super) trait Unit: Copy {
    /// How much one of it is.
    fn factor(self) -> f64;
}

impl Unit for TimeUnit {
    fn factor(self) -> f64 {
        match self {
            TimeUnit::S => 1.0,
            TimeUnit::Ms => 1e-3,
            TimeUnit::Us => 1e-6,
            TimeUnit::Ns => 1e-9,
        }
    }
}

impl Unit for LengthUnit {
    fn factor(self) -> f64 {
        match self {
            LengthUnit::M => 1.0,
            LengthUnit::Cm => 1e-2,
            LengthUnit::Mm => 1e-3,
        }
    }
}

impl Unit for VelocityUnit {
    fn factor(self) -> f64 {
        match self {
            VelocityUnit::MPerS => 1.0,
            VelocityUnit::CmPerS => 1e-2,
            VelocityUnit::MmPerS => 1e-3,
        }
    }
}

impl Unit for PressureUnit {
    fn factor(self) -> f64 {
        match self {
            PressureUnit::Kpa => 1.0,
            PressureUnit::Pa => 1e-3,
            PressureUnit::Psi => 6.894_757_293_168,
            PressureUnit::Bar => 100.0,
        }
    }
}
