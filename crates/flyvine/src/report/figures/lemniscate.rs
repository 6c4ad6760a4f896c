//! Lemniscates: quadrotor above, end effector below; one column per period, slow to fast.

use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend};
use super::style::{self, Palette};
use super::svg::Canvas;
use super::{Figure, path};
use crate::report::paper::{self, Corner, Signal};
use crate::report::results::Experiment;

const WIDTH: f64 = 1040.0;

/// `None` without experiments.
pub fn figure(experiments: &[&Experiment], palette: &Palette) -> Option<Figure> {
    let mut periods: Vec<f64> = experiments.iter().filter_map(|e| e.period_s).collect();
    periods.sort_by(|a, b| b.total_cmp(a));
    periods.dedup();
    if periods.is_empty() {
        return None;
    }

    let seen = |axis: usize| {
        experiments
            .iter()
            .flat_map(move |e| {
                [Signal::Quadrotor, Signal::EndEffector].map(|s| path(&e.flight, s, [axis, axis]))
            })
            .flatten()
            .flatten()
            .map(|p| p[0])
    };
    let x = Axis::around("x (m)", seen(0).chain([-1.1, 1.1]), 1.0);
    let y = Axis::around("y (m)", seen(1).chain([-0.65, 0.65]), 1.0);

    let columns = periods.len() as f64;
    let panel_width = (WIDTH - 16.0) / columns - LEFT_ROOM - 12.0;
    let panel_height = Panel::equal_height(panel_width, &x, &y);
    let mut legend = style::configuration_entries(palette, experiments.iter().map(|e| e.label.as_str()));
    legend.push(style::entry("reference", style::REFERENCE));
    legend.push(style::measured_entry());
    let legend_height = 48.0;
    let row_height = TITLE_ROOM + panel_height + BOTTOM_ROOM;
    let mut canvas = Canvas::new("lemniscates", WIDTH, legend_height + 2.0 * row_height + 6.0);
    draw_legend(&mut canvas, [LEFT_ROOM, 4.0], WIDTH - LEFT_ROOM, &legend);

    for (row, (signal, body)) in [
        (Signal::Quadrotor, "Quadrotor"),
        (Signal::EndEffector, "End effector"),
    ]
    .into_iter()
    .enumerate()
    {
        for (column, &period_s) in periods.iter().enumerate() {
            let corner = [
                LEFT_ROOM + column as f64 * (LEFT_ROOM + panel_width + 12.0),
                legend_height + TITLE_ROOM + row as f64 * row_height,
            ];
            let title = format!("{body}, period {period_s} s");
            let size = [panel_width, panel_height];
            let panel = Panel::draw(&mut canvas, corner, size, &title, x.clone(), y.clone());
            let column: Vec<&&Experiment> = experiments
                .iter()
                .filter(|e| e.period_s == Some(period_s))
                .collect();
            for experiment in &column {
                let corner = Corner::from_label(&experiment.label);
                if let Some(points) = corner.and_then(|c| paper::lemniscate_xy(period_s, c, signal)) {
                    let name = format!("{}, paper", experiment.label);
                    let stroke = style::measured(palette.color(&experiment.label));
                    panel.curve(&mut canvas, &name, points, stroke);
                }
            }
            if signal == Signal::EndEffector
                && let Some(experiment) = column.first()
            {
                let reference: Vec<[f64; 2]> = experiment.reference.iter().map(|p| [p[0], p[1]]).collect();
                panel.curve(&mut canvas, "reference", &reference, style::REFERENCE);
            }
            for experiment in &column {
                let stroke = style::flown(palette.color(&experiment.label));
                panel.series(
                    &mut canvas,
                    &experiment.label,
                    path(&experiment.flight, signal, [0, 1]),
                    stroke,
                );
            }
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
