//! Rollout error of the bank against the horizon, one line per checked flight.

use super::Figure;
use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend};
use super::style::{self, Palette};
use super::svg::Canvas;
use crate::report::results::{FlightRollout, HorizonError};

const WIDTH: f64 = 1040.0;
const PANEL_HEIGHT: f64 = 300.0;

/// What a panel shows: its title and which value of a horizon.
type Statistic = (&'static str, fn(&HorizonError) -> Option<f64>);

const STATISTICS: [Statistic; 2] = [
    ("Median over the rollouts", |e| e.median_m),
    ("95th percentile", |e| e.p95_m),
];

/// `None` without checked flights.
pub fn figure(rollouts: &[FlightRollout], palette: &Palette) -> Option<Figure> {
    if rollouts.is_empty() {
        return None;
    }
    let points = |rollout: &FlightRollout, value: fn(&HorizonError) -> Option<f64>| -> Vec<[f64; 2]> {
        rollout
            .rollout
            .iter()
            .filter_map(|e| Some([e.horizon_s, 100.0 * value(e)?]))
            .collect()
    };
    let all: Vec<[f64; 2]> = rollouts
        .iter()
        .flat_map(|r| STATISTICS.map(|(_, value)| points(r, value)))
        .flatten()
        .collect();
    let x = Axis::log_around("horizon (s)", all.iter().map(|p| p[0]));
    let y = Axis::log_around("mean end-effector error (cm)", all.iter().map(|p| p[1]));

    let legend = style::configuration_entries(palette, rollouts.iter().map(|r| r.label.as_str()));
    let legend_height = 34.0;
    let mut canvas = Canvas::new(
        "rollouts",
        WIDTH,
        legend_height + TITLE_ROOM + PANEL_HEIGHT + BOTTOM_ROOM,
    );
    draw_legend(&mut canvas, [LEFT_ROOM, 4.0], WIDTH - LEFT_ROOM, &legend);
    let width = (WIDTH - 16.0) / 2.0 - LEFT_ROOM - 12.0;
    for (column, (title, value)) in STATISTICS.into_iter().enumerate() {
        let corner = [
            LEFT_ROOM + column as f64 * (LEFT_ROOM + width + 12.0),
            legend_height + TITLE_ROOM,
        ];
        let panel = Panel::draw(
            &mut canvas,
            corner,
            [width, PANEL_HEIGHT],
            title,
            x.clone(),
            y.clone(),
        );
        for rollout in rollouts {
            let color = palette.color(&rollout.label);
            let points = points(rollout, value);
            let name = format!("{} ({})", rollout.path, rollout.label);
            panel.curve(&mut canvas, &name, &points, style::flown(color));
            for point in points {
                canvas.circle(panel.place(point), 3.2, color, None);
            }
        }
    }
    Some(Figure {
        name: "rollouts".into(),
        title: "How far the models can be trusted".into(),
        caption:
            "End-effector error of open-loop rollouts with the recorded commands, against their length; one \
                  line per checked flight."
                .into(),
        svg: canvas.finish("Rollout error against horizon"),
    })
}
