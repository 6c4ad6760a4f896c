//! Lemniscates: quadrotor above, end effector below; one column per period, slow to fast.

use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend};
use super::style::{self, Palette};
use super::svg::Canvas;
use super::{Figure, path};
use crate::flight::Corner;
use crate::report::paper::{self, Signal};
use crate::report::results::Experiment;

const WIDTH: f64 = 1040.0;
const LEGEND_HEIGHT: f64 = 48.0;
const BODIES: [Signal; 2] = [Signal::Quadrotor, Signal::EndEffector];

/// `None` without experiments.
pub fn figure(experiments: &[&Experiment], palette: &Palette) -> Option<Figure> {
    let mut periods: Vec<f64> = experiments.iter().filter_map(|e| e.period_s).collect();
    periods.sort_by(|a, b| b.total_cmp(a));
    periods.dedup();
    if periods.is_empty() {
        return None;
    }

    let points: Vec<[f64; 2]> = experiments
        .iter()
        .flat_map(|e| {
            BODIES
                .into_iter()
                .flat_map(|b| flown(e, b).flatten().chain(measured(e, b).iter().copied()))
        })
        .collect();
    let x = Axis::around("x (m)", points.iter().map(|p| p[0]), 1.0);
    let y = Axis::around("y (m)", points.iter().map(|p| p[1]), 1.0);
    let width = (WIDTH - 16.0) / periods.len() as f64 - LEFT_ROOM - 12.0;
    let height = Panel::equal_height(width, &x, &y);
    let row_height = TITLE_ROOM + height + BOTTOM_ROOM;

    let mut canvas = Canvas::new("lemniscates", WIDTH, LEGEND_HEIGHT + 2.0 * row_height + 6.0);
    let mut legend = style::configuration_entries(palette, experiments.iter().map(|e| e.label.as_str()));
    legend.push(style::entry("reference", style::REFERENCE));
    legend.push(style::measured_entry());
    draw_legend(&mut canvas, [LEFT_ROOM, 4.0], WIDTH - LEFT_ROOM, &legend);
    for (row, body) in BODIES.into_iter().enumerate() {
        for (column, &period_s) in periods.iter().enumerate() {
            let left = LEFT_ROOM + column as f64 * (LEFT_ROOM + width + 12.0);
            let top = LEGEND_HEIGHT + TITLE_ROOM + row as f64 * row_height;
            let title = format!("Path of the {}, period {period_s} s", body.name());
            let panel = Panel::draw(
                &mut canvas,
                [left, top],
                [width, height],
                &title,
                x.clone(),
                y.clone(),
            );
            let shown: Vec<&Experiment> = experiments
                .iter()
                .copied()
                .filter(|e| e.period_s == Some(period_s))
                .collect();
            draw_paths(&mut canvas, &panel, &shown, body, palette);
        }
    }
    Some(Figure {
        name: "lemniscates".into(),
        title: "Lemniscates".into(),
        caption:
            "Paths in the horizontal plane: quadrotor above, end effector below; slow left, fast right. \
                  Thin lines are this run, wide pale lines the paper's hardware flights."
                .into(),
        svg: canvas.finish("Lemniscate paths of quadrotor and end effector"),
    })
}

fn draw_paths(
    canvas: &mut Canvas,
    panel: &Panel,
    experiments: &[&Experiment],
    body: Signal,
    palette: &Palette,
) {
    for experiment in experiments {
        let stroke = style::measured(palette.color(&experiment.label));
        panel.curve(
            canvas,
            &format!("{}, paper", experiment.label),
            measured(experiment, body),
            stroke,
        );
    }
    if body == Signal::EndEffector
        && let Some(experiment) = experiments.first()
    {
        let reference: Vec<[f64; 2]> = experiment.reference.iter().map(|p| [p[0], p[1]]).collect();
        panel.curve(canvas, "reference", &reference, style::REFERENCE);
    }
    for experiment in experiments {
        let stroke = style::flown(palette.color(&experiment.label));
        panel.series(canvas, &experiment.label, flown(experiment, body), stroke);
    }
}

fn flown(experiment: &Experiment, body: Signal) -> impl Iterator<Item = Option<[f64; 2]>> {
    path(&experiment.flight, body, [0, 1])
}

/// The paper's path for this configuration and period; empty where it has none.
fn measured(experiment: &Experiment, body: Signal) -> &'static paper::Curve {
    Corner::from_label(&experiment.label)
        .zip(experiment.period_s)
        .and_then(|(corner, period_s)| paper::lemniscate_xy(period_s, corner, body))
        .unwrap_or_default()
}
