//! Colours and strokes that mean the same in every figure.

use std::collections::BTreeMap;

use super::chart::LegendEntry;
use super::svg::Stroke;
use crate::flight::Corner;

/// Colour of a reference.
pub const REFERENCE: Stroke = Stroke::solid("#1f2933", 1.3).dashed();
/// Colour of limits.
pub const LIMIT: Stroke = Stroke::solid("#6b7780", 1.3).dashed();
/// Opacity of the paper's curves.
const HALO_OPACITY: f64 = 0.3;

/// Okabe and Ito's palette, distinguishable with any colour vision.
const CORNERS: [&str; 4] = ["#0072B2", "#D55E00", "#009E73", "#B5519C"];
/// Colours of configurations that are not corners.
const OTHERS: [&str; 5] = ["#5B4BB7", "#8A6D00", "#1B8A99", "#8C4A2F", "#4F5B66"];

/// The colour of each configuration.
pub struct Palette(BTreeMap<String, &'static str>);

impl Palette {
    /// Corners get their fixed colours, other labels the remaining ones in order of appearance.
    pub fn new<'a>(labels: impl Iterator<Item = &'a str>) -> Self {
        let mut colors = BTreeMap::new();
        let mut others = OTHERS.iter().cycle();
        for label in labels {
            if !colors.contains_key(label) {
                let color = match Corner::from_label(label) {
                    Some(corner) => CORNERS[corner as usize],
                    None => others.next().copied().unwrap_or("#4F5B66"),
                };
                colors.insert(label.to_owned(), color);
            }
        }
        Self(colors)
    }

    /// The colour of a configuration.
    pub fn color(&self, label: &str) -> &'static str {
        self.0.get(label).copied().unwrap_or("#4F5B66")
    }
}

/// Our flight.
pub fn flown(color: &'static str) -> Stroke {
    Stroke::solid(color, 1.7)
}

/// The paper's measured curve behind ours.
pub fn measured(color: &'static str) -> Stroke {
    Stroke::solid(color, 4.0).faint(HALO_OPACITY)
}

/// A legend entry.
pub fn entry(label: impl Into<String>, stroke: Stroke) -> LegendEntry {
    LegendEntry {
        label: label.into(),
        stroke,
    }
}

/// Entries for configurations, described where they are corners.
pub fn configuration_entries<'a>(
    palette: &Palette,
    labels: impl Iterator<Item = &'a str>,
) -> Vec<LegendEntry> {
    let mut entries: Vec<LegendEntry> = Vec::new();
    for label in labels {
        let text = match Corner::from_label(label) {
            Some(corner) => format!("{label} ({})", corner.description()),
            None => label.to_owned(),
        };
        if entries.iter().all(|e| e.label != text) {
            entries.push(entry(text, flown(palette.color(label))));
        }
    }
    entries
}

/// Neutral entry that explains the paper's curves.
pub fn measured_entry() -> LegendEntry {
    entry("paper, measured on hardware", measured("#4F5B66"))
}
