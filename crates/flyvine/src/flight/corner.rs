//! The paper's four configurations.

use super::Configuration;

/// Corner of the paper's configuration grid: the arm empty or inflated (0 or 0.4 kPa), short or long (0.7 or 1.0 m).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Corner {
    /// Empty, short.
    Es,
    /// Inflated, short.
    Is,
    /// Empty, long.
    El,
    /// Inflated, long.
    Il,
}

impl Corner {
    /// All corners in the paper's order.
    pub const ALL: [Self; 4] = [Self::Es, Self::Is, Self::El, Self::Il];

    /// The corner's two letters.
    pub fn label(self) -> &'static str {
        match self {
            Self::Es => "ES",
            Self::Is => "IS",
            Self::El => "EL",
            Self::Il => "IL",
        }
    }

    /// What the two letters mean.
    pub fn description(self) -> &'static str {
        match self {
            Self::Es => "empty, short",
            Self::Is => "inflated, short",
            Self::El => "empty, long",
            Self::Il => "inflated, long",
        }
    }

    /// Length and pressure.
    pub fn configuration(self) -> Configuration {
        Configuration {
            length_m: if self.is_short() { 0.7 } else { 1.0 },
            pressure_kpa: match self {
                Self::Es | Self::El => 0.0,
                Self::Is | Self::Il => 0.4,
            },
        }
    }

    /// The corner with these two letters.
    pub fn from_label(label: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|corner| corner.label() == label)
    }

    /// The corner with exactly this configuration.
    pub fn from_configuration(configuration: Configuration) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|corner| corner.configuration() == configuration)
    }

    /// Whether the arm is short.
    pub fn is_short(self) -> bool {
        matches!(self, Self::Es | Self::Is)
    }
}
