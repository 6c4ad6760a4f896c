//! A training flight in the horizontal plane, beside the paper's: command, quadrotor, end effector.

use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend};
use super::svg::{Canvas, Stroke};
use super::{Figure, path, style};
use crate::DT;
use crate::flight::Flight;
use crate::report::paper::{self, Signal};

const WIDTH: f64 = 1040.0;
/// Length of the excerpt: about one closed figure.
const WINDOW_S: f64 = 18.0;
const STROKES: [(Signal, Stroke); 3] = [
    (Signal::EndEffector, Stroke::solid("#D55E00", 1.8)),
    (Signal::Quadrotor, Stroke::solid("#0072B2", 1.8).dashed()),
    (Signal::Command, Stroke::solid("#1f2933", 2.0).dotted()),
];

/// `None` without training flights.
pub fn figure(training: &[Flight]) -> Option<Figure> {
    let flight = training
        .iter()
        .find(|f| f.name.contains("pretzel"))
        .or(training.first())?;
    let excerpt = excerpt(flight);
    let paths = STROKES.map(|(signal, _)| signal);
    let seen = |axis: usize| {
        let ours = paths.into_iter().flat_map({
            let excerpt = &excerpt;
            move |signal| path(excerpt, signal, [axis, axis]).flatten().map(|p| p[0])
        });
        let theirs = paths.into_iter().flat_map(move |signal| {
            paper::pretzel_xy(signal)
                .unwrap_or_default()
                .iter()
                .map(move |p| p[axis])
        });
        ours.chain(theirs)
    };
    let (x, y) = (
        Axis::around("x (m)", seen(0), 1.0),
        Axis::around("y (m)", seen(1), 1.0),
    );

    let width = (WIDTH - 16.0) / 2.0 - LEFT_ROOM - 12.0;
    let height = Panel::equal_height(width, &x, &y);
    let legend_height = 30.0;
    let mut canvas = Canvas::new(
        "pretzel",
        WIDTH,
        legend_height + TITLE_ROOM + height + BOTTOM_ROOM,
    );
    let legend = STROKES.map(|(signal, stroke)| style::entry(signal.name(), stroke));
    draw_legend(&mut canvas, [LEFT_ROOM, 4.0], WIDTH - LEFT_ROOM, &legend);
    let top = legend_height + TITLE_ROOM;
    let start_s = excerpt.samples.first().map_or(0.0, |s| s.t_s);
    let title = format!("{}, {start_s:.0} s to {:.0} s", flight.name, start_s + WINDOW_S);
    let ours = Panel::draw(
        &mut canvas,
        [LEFT_ROOM, top],
        [width, height],
        &title,
        x.clone(),
        y.clone(),
    );
    let corner = [LEFT_ROOM + width + 12.0 + LEFT_ROOM, top];
    let theirs = Panel::draw(&mut canvas, corner, [width, height], "Paper, hardware", x, y);
    for (signal, stroke) in STROKES {
        ours.series(&mut canvas, signal.name(), path(&excerpt, signal, [0, 1]), stroke);
        let name = format!("{}, paper", signal.name());
        theirs.curve(
            &mut canvas,
            &name,
            paper::pretzel_xy(signal).unwrap_or_default(),
            stroke,
        );
    }
    Some(Figure {
        name: "pretzel".into(),
        title: "A training flight".into(),
        caption:
            "Command, quadrotor and end effector differ: these are the offsets that the model must learn. \
                  Left an excerpt of a training flight of this run, right the paper's."
                .into(),
        svg: canvas.finish("Training flight in the horizontal plane"),
    })
}

/// [`WINDOW_S`] of the flight from the moment its command first moves.
fn excerpt(flight: &Flight) -> Flight {
    let rows = (WINDOW_S / DT) as usize;
    let first = flight.samples.first().map(|s| s.command);
    let moved = flight
        .samples
        .iter()
        .position(|s| Some(s.command) != first)
        .unwrap_or(0);
    let samples = flight.samples.iter().skip(moved).take(rows).copied().collect();
    Flight {
        name: flight.name.clone(),
        samples,
    }
}
