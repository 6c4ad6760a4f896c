//! The paper's figures, redrawn from a run with the paper's measured curves behind.
//!
//! Drawn without a plotting crate: the curves need sub-pixel coordinates, dash patterns, equal axes and
//! accessible titles, which the SVG back ends of the established crates round away or lack.

mod chart;
mod deploy;
mod errors;
mod lemniscate;
mod pretzel;
mod rollout;
mod style;
mod svg;
mod sweep;
mod swing;

pub(super) use style::Palette;
pub use sweep::{ErrorDistribution, SuccessMap, error_distributions, success_map};

use super::paper::Signal;
use super::results::{Experiment, ExperimentKind, Results};
use crate::flight::{Flight, Sample};

/// One finished figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// File stem and element id, for example `lemniscates`.
    pub name: String,
    /// Headline.
    pub title: String,
    /// What to see, in one or two sentences of plain text.
    pub caption: String,
    /// A self-contained SVG element.
    pub svg: String,
}

/// All figures that the results have data for, in reading order.
pub fn figures(results: &Results) -> Vec<Figure> {
    let palette = palette(results);
    let experiments = results.experiments_in_order();
    let of = |kind| -> Vec<&Experiment> { experiments.iter().copied().filter(|e| e.kind == kind).collect() };
    let mut figures = Vec::new();
    figures.extend(errors::figure(&experiments, &palette));
    figures.extend(lemniscate::figure(&of(ExperimentKind::Lemniscate), &palette));
    figures.extend(swing::figure(&of(ExperimentKind::Swing), &palette));
    figures.extend(
        of(ExperimentKind::Deploy)
            .into_iter()
            .map(|e| deploy::figure(e, &palette)),
    );
    figures.extend(
        of(ExperimentKind::Waypoints)
            .into_iter()
            .map(|e| deploy::figure(e, &palette)),
    );
    figures.extend(pretzel::figure(&results.training));
    figures.extend(rollout::figure(&results.rollouts, &palette));
    figures
}

/// The colours of all configurations in the results.
pub(super) fn palette(results: &Results) -> Palette {
    let flown = results
        .experiments_in_order()
        .into_iter()
        .map(|e| e.label.as_str());
    let checked = results.rollouts.iter().map(|r| r.label.as_str());
    Palette::new(flown.chain(checked))
}

/// A measured or commanded position of one row; the reference belongs to the plan, not to the flight.
fn position(sample: &Sample, signal: Signal) -> Option<[f64; 3]> {
    match signal {
        Signal::Command => Some(sample.command),
        Signal::Quadrotor => sample.quadrotor.map(|pose| pose.position),
        Signal::EndEffector => sample.end_effector,
        Signal::Reference => None,
    }
}

/// Path of a signal in the plane of axes `a` and `b`, `None` where motion capture missed it.
fn path(flight: &Flight, signal: Signal, [a, b]: [usize; 2]) -> impl Iterator<Item = Option<[f64; 2]>> {
    flight
        .samples
        .iter()
        .map(move |s| position(s, signal).map(|p| [p[a], p[b]]))
}

/// One axis of a signal over time since the flight's start.
fn over_time(flight: &Flight, signal: Signal, axis: usize) -> impl Iterator<Item = Option<[f64; 2]>> {
    let start_s = flight.samples.first().map_or(0.0, |s| s.t_s);
    flight
        .samples
        .iter()
        .map(move |s| position(s, signal).map(|p| [s.t_s - start_s, p[axis]]))
}

/// Knots against time.
fn knots_over_time(positions: &[[f64; 3]], axis: usize) -> Vec<[f64; 2]> {
    positions
        .iter()
        .enumerate()
        .map(|(k, p)| [k as f64 * crate::DT, p[axis]])
        .collect()
}
