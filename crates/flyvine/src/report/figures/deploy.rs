//! Tracking over time: x, y, z of reference, quadrotor and end effector, one panel per axis.

use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend};
use super::style::{self, Palette};
use super::svg::Canvas;
use super::{Figure, knots_over_time, over_time};
use crate::report::paper::{self, Signal};
use crate::report::results::{Experiment, ExperimentKind};

const WIDTH: f64 = 1040.0;
const PANEL_HEIGHT: f64 = 170.0;
const QUADROTOR: &str = "#7a8791";

/// Time series of one experiment. The paper's curves stand behind the deployment that it flew (T = 5 s).
pub fn figure(experiment: &Experiment, palette: &Palette) -> Figure {
    let color = palette.color(&experiment.label);
    let as_in_paper = experiment.kind == ExperimentKind::Deploy && experiment.period_s == Some(5.0);
    let name = element_id(&experiment.name);
    let legend_height = 30.0;
    let row = TITLE_ROOM + PANEL_HEIGHT + 22.0;
    let mut canvas = Canvas::new(&name, WIDTH, legend_height + 3.0 * row + BOTTOM_ROOM - 22.0);
    let mut legend = vec![
        style::entry("end effector", style::flown(color)),
        style::entry("quadrotor", style::flown(QUADROTOR)),
        style::entry("reference of the end effector", style::REFERENCE),
    ];
    if as_in_paper {
        legend.push(style::measured_entry());
    }
    draw_legend(&mut canvas, [LEFT_ROOM, 4.0], WIDTH - LEFT_ROOM, &legend);

    let last_s = experiment.flight.samples.len().max(2) as f64 * crate::DT;
    for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
        let top = legend_height + TITLE_ROOM + axis as f64 * row;
        let values = [Signal::Quadrotor, Signal::EndEffector]
            .into_iter()
            .flat_map(|signal| over_time(&experiment.flight, signal, axis))
            .flatten()
            .map(|p| p[1]);
        let references = experiment.reference.iter().map(|p| p[axis]);
        let measured = |signal| {
            let curve = if as_in_paper {
                paper::deploy(axis, signal)
            } else {
                None
            };
            curve
                .unwrap_or_default()
                .iter()
                .map(|&[t, value]| [t - paper::DEPLOY_LEAD_S, value])
        };
        let papers = measured(Signal::Quadrotor)
            .chain(measured(Signal::EndEffector))
            .filter(|p| p[0] >= 0.0)
            .map(|p| p[1]);
        let time = Axis::linear(if axis == 2 { "t (s)" } else { "" }, 0.0, last_s);
        let y = Axis::around(
            &format!("{letter} (m)"),
            values.chain(references).chain(papers),
            0.4,
        );
        let size = [WIDTH - LEFT_ROOM - 16.0, PANEL_HEIGHT];
        let panel = Panel::draw(&mut canvas, [LEFT_ROOM, top], size, letter, time, y);
        let bodies = [(Signal::Quadrotor, QUADROTOR), (Signal::EndEffector, color)];
        for (signal, color) in bodies {
            let points: Vec<[f64; 2]> = measured(signal).collect();
            panel.curve(
                &mut canvas,
                &format!("{}, paper", signal.name()),
                &points,
                style::measured(color),
            );
        }
        let reference = knots_over_time(&experiment.reference, axis);
        panel.curve(&mut canvas, "reference", &reference, style::REFERENCE);
        for (signal, color) in bodies {
            let points = over_time(&experiment.flight, signal, axis);
            panel.series(&mut canvas, signal.name(), points, style::flown(color));
        }
    }
    let title = match (experiment.kind, experiment.period_s) {
        (ExperimentKind::Deploy, Some(period_s)) => format!("Deployment, period {period_s} s"),
        _ => experiment.name.clone(),
    };
    let caption = if as_in_paper {
        format!(
            "The arm grows and inflates while its end effector tracks a lemniscate at constant height. Wide pale \
             lines are the paper's hardware flight, drawn {} s earlier because its recording starts with a hover.",
            paper::DEPLOY_LEAD_S
        )
    } else {
        "Position over time of quadrotor and end effector against the reference.".to_owned()
    };
    Figure {
        svg: canvas.finish(&format!("{title}: x, y and z over time")),
        name,
        title,
        caption,
    }
}

/// A name as an element id and file stem: letters, digits, hyphens and underscores only.
fn element_id(name: &str) -> String {
    let safe = |c: char| {
        if c.is_ascii_alphanumeric() || c == '_' {
            c
        } else {
            '-'
        }
    };
    format!("series-{}", name.chars().map(safe).collect::<String>())
}
