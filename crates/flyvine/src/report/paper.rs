//! What the paper published: measured curves of its figures, and its numbers.
//!
//! Source: Jitosho et al., "Flying Vines", figures and Sec. IV (Results). The curves are the bundled files of
//! `data/paper_figures`, described there.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use super::results::{Experiment, ExperimentKind};
use crate::flight::Corner;

/// A measured curve: `[t, value]` over time (s, m) or a path `[horizontal, vertical]` (m), in order of time.
pub type Curve = [[f64; 2]];

/// How much lower the paper drew the short arms in its swing figure so that all targets coincide, m.
pub const SHORT_SWING_SHIFT_M: f64 = 0.25;

/// Hover at the start of the paper's deployment recording, before its lemniscate begins, s
/// (least-squares alignment of its reference with the T = 5 s, 3-s-ramp lemniscate).
pub const DEPLOY_LEAD_S: f64 = 1.5;

/// Which signal of a flight a curve shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// What the end effector shall do.
    Reference,
    /// Commanded quadrotor position.
    Command,
    /// Measured quadrotor position.
    Quadrotor,
    /// Measured end-effector position.
    EndEffector,
}

/// A range of published mean errors, m. Equal ends for a single published value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PublishedError {
    /// Lower end, m.
    pub low_m: f64,
    /// Upper end, m.
    pub high_m: f64,
}

impl Signal {
    /// The signal in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Command => "command",
            Self::Quadrotor => "quadrotor",
            Self::EndEffector => "end effector",
        }
    }

    /// The signal in the names of the bundled files.
    fn stem(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Command => "command",
            Self::Quadrotor => "quadrotor",
            Self::EndEffector => "end_effector",
        }
    }
}

/// Path of a signal in the horizontal plane during a training flight ("pretzel"); no reference.
pub fn pretzel_xy(signal: Signal) -> Option<&'static Curve> {
    curve(&format!("pretzel_{}_xy", signal.stem()))
}

/// Path of the lemniscate in the horizontal plane. The paper flew periods of 10 s and 5 s; it drew the
/// quadrotor, the end effector and their common reference.
pub fn lemniscate_xy(period_s: f64, corner: Corner, signal: Signal) -> Option<&'static Curve> {
    if signal == Signal::Reference {
        return curve("lemniscate_reference_xy");
    }
    curve(&format!(
        "lemniscate_{period_s}s_{}_{}_xy",
        corner.label(),
        signal.stem()
    ))
}

/// x over time of a swing: command, quadrotor and end effector.
pub fn swing_x(corner: Corner, signal: Signal) -> Option<&'static Curve> {
    curve(&format!("kick_{}_{}_x", corner.label(), signal.stem()))
}

/// Path of a swing in the xz plane: quadrotor and end effector; short arms are [`SHORT_SWING_SHIFT_M`] low.
pub fn swing_xz(corner: Corner, signal: Signal) -> Option<&'static Curve> {
    curve(&format!("kick_{}_{}_xz", corner.label(), signal.stem()))
}

/// One axis (0, 1, 2) over time of the deployment: reference, quadrotor and end effector, with
/// [`DEPLOY_LEAD_S`] of hover before the lemniscate begins.
pub fn deploy(axis: usize, signal: Signal) -> Option<&'static Curve> {
    curve(&format!(
        "growing_{}_{}",
        signal.stem(),
        ["x", "y", "z"].get(axis)?
    ))
}

/// The paper's mean 3-D end-effector error on hardware for a task like this: to the reference for
/// lemniscates, to the model's prediction for swings and the deployment. `None` where it published none.
pub fn published_error(experiment: &Experiment) -> Option<PublishedError> {
    let range = |low_m, high_m| Some(PublishedError { low_m, high_m });
    let corner = Corner::from_label(&experiment.label);
    match (experiment.kind, experiment.period_s) {
        (ExperimentKind::Lemniscate, Some(10.0)) if corner == Some(Corner::Is) => range(0.12, 0.12),
        (ExperimentKind::Lemniscate, Some(10.0 | 5.0)) if corner.is_some() => range(0.05, 0.09),
        (ExperimentKind::Swing, _) if corner.is_some() => range(0.13, 0.16),
        (ExperimentKind::Deploy, Some(5.0)) => range(0.15, 0.15),
        _ => None,
    }
}

fn curve(name: &str) -> Option<&'static Curve> {
    static CURVES: LazyLock<BTreeMap<&str, Vec<[f64; 2]>>> =
        LazyLock::new(|| FILES.iter().map(|&(name, text)| (name, parse(text))).collect());
    CURVES.get(name).map(Vec::as_slice)
}

/// Points of a bundled two-column CSV file. The files are part of the program and a test reads all of them.
fn parse(text: &str) -> Vec<[f64; 2]> {
    text.lines()
        .skip(1)
        .filter_map(|line| {
            let (first, second) = line.split_once(',')?;
            Some([first.parse().ok()?, second.parse().ok()?])
        })
        .collect()
}

macro_rules! bundled {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../../data/paper_figures/", $name, ".csv")))),*]
    };
}

const FILES: &[(&str, &str)] = bundled![
    "growing_end_effector_x",
    "growing_end_effector_y",
    "growing_end_effector_z",
    "growing_quadrotor_x",
    "growing_quadrotor_y",
    "growing_quadrotor_z",
    "growing_reference_x",
    "growing_reference_y",
    "growing_reference_z",
    "kick_EL_command_x",
    "kick_EL_end_effector_x",
    "kick_EL_end_effector_xz",
    "kick_EL_quadrotor_x",
    "kick_EL_quadrotor_xz",
    "kick_ES_command_x",
    "kick_ES_end_effector_x",
    "kick_ES_end_effector_xz",
    "kick_ES_quadrotor_x",
    "kick_ES_quadrotor_xz",
    "kick_IL_command_x",
    "kick_IL_end_effector_x",
    "kick_IL_end_effector_xz",
    "kick_IL_quadrotor_x",
    "kick_IL_quadrotor_xz",
    "kick_IS_command_x",
    "kick_IS_end_effector_x",
    "kick_IS_end_effector_xz",
    "kick_IS_quadrotor_x",
    "kick_IS_quadrotor_xz",
    "lemniscate_10s_EL_end_effector_xy",
    "lemniscate_10s_EL_quadrotor_xy",
    "lemniscate_10s_ES_end_effector_xy",
    "lemniscate_10s_ES_quadrotor_xy",
    "lemniscate_10s_IL_end_effector_xy",
    "lemniscate_10s_IL_quadrotor_xy",
    "lemniscate_10s_IS_end_effector_xy",
    "lemniscate_10s_IS_quadrotor_xy",
    "lemniscate_5s_EL_end_effector_xy",
    "lemniscate_5s_EL_quadrotor_xy",
    "lemniscate_5s_ES_end_effector_xy",
    "lemniscate_5s_ES_quadrotor_xy",
    "lemniscate_5s_IL_end_effector_xy",
    "lemniscate_5s_IL_quadrotor_xy",
    "lemniscate_5s_IS_end_effector_xy",
    "lemniscate_5s_IS_quadrotor_xy",
    "lemniscate_reference_xy",
    "pretzel_command_xy",
    "pretzel_end_effector_xy",
    "pretzel_quadrotor_xy",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_of_every_bundled_curve_is_read() {
        assert_eq!(FILES.len(), 49);
        for (name, text) in FILES {
            let points = curve(name).unwrap();
            assert_eq!(points.len(), text.lines().count() - 1, "{name}");
            assert!(points.iter().flatten().all(|v| v.is_finite()), "{name}");
        }
    }

    #[test]
    fn curves_are_found_by_what_they_show() {
        for corner in Corner::ALL {
            for period_s in [10.0, 5.0] {
                assert!(lemniscate_xy(period_s, corner, Signal::EndEffector).is_some());
                assert!(lemniscate_xy(period_s, corner, Signal::Quadrotor).is_some());
            }
            assert_eq!(swing_x(corner, Signal::EndEffector).unwrap()[0][0], 0.0);
            assert!(swing_xz(corner, Signal::Quadrotor).is_some());
            assert_eq!(Corner::from_label(corner.label()), Some(corner));
        }
        assert_eq!(pretzel_xy(Signal::Command).unwrap()[0], [0.0, 1.0]);
        assert!((0..3).all(|axis| deploy(axis, Signal::EndEffector).is_some()));
        assert!(deploy(3, Signal::EndEffector).is_none());
        assert!(lemniscate_xy(7.0, Corner::Es, Signal::Quadrotor).is_none());
    }
}
