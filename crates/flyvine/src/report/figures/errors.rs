//! Mean end-effector error of every experiment beside the paper's published range.

use super::Figure;
use super::chart::{Axis, BOTTOM_ROOM, Panel, draw_legend, text, text_width};
use super::style::{self, Palette};
use super::svg::{Anchor, Canvas, Stroke};
use crate::report::paper::published_error;
use crate::report::results::Experiment;

const WIDTH: f64 = 1040.0;
const ROW: f64 = 27.0;
const BAND: &str = "#d3d9de";

/// `None` without experiments.
pub fn figure(experiments: &[&Experiment], palette: &Palette) -> Option<Figure> {
    if experiments.is_empty() {
        return None;
    }
    let published: Vec<_> = experiments.iter().map(|e| published_error(e)).collect();
    let centimetres = |experiment: &Experiment| {
        experiment
            .comparable_error()
            .map(|(_, error)| 100.0 * error.mean_m)
    };
    let largest = experiments
        .iter()
        .filter_map(|e| centimetres(e))
        .chain(published.iter().flatten().map(|p| 100.0 * p.high_m))
        .fold(1.0, f64::max);

    let names = experiments
        .iter()
        .map(|e| text_width(&e.title(), 12.5))
        .fold(0.0, f64::max);
    let left = (names + 16.0).clamp(120.0, 340.0);
    let legend_height = 34.0;
    let height = ROW * experiments.len() as f64 + 8.0;
    let mut canvas = Canvas::new("errors", WIDTH, legend_height + height + BOTTOM_ROOM);
    let legend = [
        style::entry("this run", Stroke::solid("#4F5B66", 9.0)),
        style::entry("paper, hardware", Stroke::solid(BAND, 15.0)),
    ];
    draw_legend(&mut canvas, [left, 4.0], WIDTH - left, &legend);
    let x = Axis::linear("mean 3-D end-effector error (cm)", 0.0, 1.12 * largest);
    let y = Axis::rows(experiments.len());
    let size = [WIDTH - left - 16.0, height];
    let panel = Panel::draw(&mut canvas, [left, legend_height], size, "", x, y);
    for (row, (experiment, published)) in experiments.iter().zip(published).enumerate() {
        let [zero, middle] = panel.place([0.0, row as f64]);
        let at = |cm: f64| panel.place([cm, 0.0])[0];
        if let Some(range) = published {
            // A single published value is drawn as a mark of 0.3 cm.
            let (low, high) = (
                100.0 * range.low_m,
                (100.0 * range.high_m).max(100.0 * range.low_m + 0.3),
            );
            canvas.rectangle([at(low), middle - 11.0], at(high) - at(low), 22.0, BAND, 3.0);
        }
        let color = palette.color(&experiment.label);
        if let Some(error) = centimetres(experiment).filter(|e| e.is_finite()) {
            canvas.rectangle([zero, middle - 5.0], at(error) - zero, 10.0, color, 2.0);
            let value = format!("{error:.1}");
            canvas.text(
                [at(error) + 6.0, middle + 4.0],
                &value,
                text(12.0, "#1f2933", Anchor::Start),
            );
        }
        canvas.text(
            [left - 10.0, middle + 4.0],
            &experiment.title(),
            text(12.5, "#1f2933", Anchor::End),
        );
    }
    Some(Figure {
        name: "errors".into(),
        title: "Mean end-effector error".into(),
        caption: "Measured as the paper does: to the reference for lemniscates, to the model's prediction for swings \
                  and the deployment. Grey bands are the paper's published hardware results."
            .into(),
        svg: canvas.finish("Mean end-effector error of every experiment beside the paper's"),
    })
}
