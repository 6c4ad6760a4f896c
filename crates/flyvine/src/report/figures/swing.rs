//! Swings to a target: paths in the xz plane, and x over time of command, quadrotor and end effector.

use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend, text};
use super::style::{self, Palette};
use super::svg::{Anchor, Canvas, Stroke};
use super::{Figure, over_time, path};
use crate::DT;
use crate::flight::Corner;
use crate::report::paper::{self, Signal};
use crate::report::results::{Experiment, SwingTask};

const WIDTH: f64 = 1040.0;
const XZ_WIDTH: f64 = WIDTH - LEFT_ROOM - 16.0;
const TIME_HEIGHT: f64 = 210.0;
const LEGEND_HEIGHT: f64 = 48.0;
const BODIES: [Signal; 2] = [Signal::Quadrotor, Signal::EndEffector];

/// A swing and how much lower than it was flown it is drawn, so that all targets coincide.
struct Drawn<'a> {
    experiment: &'a Experiment,
    task: SwingTask,
    shift_m: f64,
}

impl Drawn<'_> {
    fn label(&self) -> &str {
        &self.experiment.label
    }

    /// The target as drawn.
    fn target(&self) -> [f64; 2] {
        let [x, z] = self.task.target.position;
        [x, z - self.shift_m]
    }

    /// Our path as drawn.
    fn flown_xz(&self, signal: Signal) -> impl Iterator<Item = Option<[f64; 2]>> {
        path(&self.experiment.flight, signal, [0, 2]).map(|p| p.map(|[x, z]| [x, z - self.shift_m]))
    }

    /// The paper's path as drawn; its own shift of the short arms is undone first.
    fn measured_xz(&self, signal: Signal) -> Vec<[f64; 2]> {
        let Some(corner) = Corner::from_label(self.label()) else {
            return Vec::new();
        };
        let paper_shift_m = if corner.is_short() {
            paper::SHORT_SWING_SHIFT_M
        } else {
            0.0
        };
        let points = paper::swing_xz(corner, signal).unwrap_or_default();
        points
            .iter()
            .map(|&[x, z]| [x, z + paper_shift_m - self.shift_m])
            .collect()
    }

    /// The paper's x over time.
    fn measured_x(&self, signal: Signal) -> &'static paper::Curve {
        Corner::from_label(self.label())
            .and_then(|c| paper::swing_x(c, signal))
            .unwrap_or_default()
    }
}

/// `None` without experiments that have a target.
pub fn figure(experiments: &[&Experiment], palette: &Palette) -> Option<Figure> {
    let tasks = || experiments.iter().filter_map(|&e| Some((e, e.swing?)));
    let lowest = tasks()
        .map(|(_, task)| task.target.position[1])
        .fold(f64::INFINITY, f64::min);
    let drawn = |(experiment, task): (_, SwingTask)| {
        let shift_m = task.target.position[1] - lowest;
        Drawn {
            experiment,
            task,
            shift_m,
        }
    };
    let swings: Vec<Drawn> = tasks().map(drawn).collect();
    if swings.is_empty() {
        return None;
    }

    let (x, z) = path_axes(&swings);
    let xz_height = Panel::equal_height(XZ_WIDTH, &x, &z);
    let time_top = LEGEND_HEIGHT + TITLE_ROOM + xz_height + BOTTOM_ROOM + 6.0 + TITLE_ROOM;
    let mut canvas = Canvas::new("swings", WIDTH, time_top + TIME_HEIGHT + BOTTOM_ROOM);
    let mut legend = style::configuration_entries(palette, swings.iter().map(Drawn::label));
    legend.extend([
        style::entry("end effector", style::flown("#1f2933")),
        style::entry("quadrotor", style::flown("#1f2933").dashed()),
        style::measured_entry(),
        style::entry("quadrotor limits", style::LIMIT),
    ]);
    draw_legend(&mut canvas, [LEFT_ROOM, 4.0], WIDTH - LEFT_ROOM, &legend);
    draw_paths(&mut canvas, &swings, palette, (x, z), xz_height);
    draw_time_series(&mut canvas, &swings, palette, time_top);
    Some(Figure {
        name: "swings".into(),
        title: "Swings to a target".into(),
        caption: format!(
            "The end effector shall pass the target (circle) while the quadrotor keeps its limits. Thin lines are \
             this run, wide pale lines the paper's hardware flights.{}",
            shift_note(&swings)
        ),
        svg: canvas.finish("Swings: paths in the xz plane, and x over time"),
    })
}

fn shift_note(swings: &[Drawn]) -> String {
    let shifted: Vec<String> = swings
        .iter()
        .filter(|s| s.shift_m > 0.0)
        .map(|s| format!("{} by {:.2} m", s.label(), s.shift_m))
        .collect();
    if shifted.is_empty() {
        return String::new();
    }
    format!(
        " As in the paper, short arms are drawn lower so that all targets coincide: {}.",
        shifted.join(", ")
    )
}

fn path_axes(swings: &[Drawn]) -> (Axis, Axis) {
    let flown = swings
        .iter()
        .flat_map(|s| BODIES.into_iter().flat_map(|b| s.flown_xz(b).flatten()));
    let measured = swings
        .iter()
        .flat_map(|s| BODIES.into_iter().flat_map(|b| s.measured_xz(b)));
    let points: Vec<[f64; 2]> = flown
        .chain(measured)
        .chain(swings.iter().map(Drawn::target))
        .collect();
    let limits = swings
        .iter()
        .filter_map(|s| Some(s.task.quadrotor_z_max? - s.shift_m));
    (
        Axis::around("x (m)", points.iter().map(|p| p[0]), 1.0),
        Axis::around("z (m)", points.iter().map(|p| p[1]).chain(limits), 1.0),
    )
}

fn draw_paths(canvas: &mut Canvas, swings: &[Drawn], palette: &Palette, (x, z): (Axis, Axis), height: f64) {
    let corner = [LEFT_ROOM, LEGEND_HEIGHT + TITLE_ROOM];
    let panel = Panel::draw(canvas, corner, [XZ_WIDTH, height], "Paths in the xz plane", x, z);
    draw_limits(canvas, &panel, swings);
    for swing in swings {
        let stroke = style::measured(palette.color(swing.label()));
        for body in BODIES {
            let name = format!("{}, {}, paper", swing.label(), body.name());
            panel.curve(canvas, &name, &swing.measured_xz(body), stroke);
        }
    }
    for swing in swings {
        let stroke = style::flown(palette.color(swing.label()));
        for (body, stroke) in BODIES.into_iter().zip([stroke.dashed(), stroke]) {
            let name = format!("{}, {}", swing.label(), body.name());
            panel.series(canvas, &name, swing.flown_xz(body), stroke);
        }
    }
    let mut targets: Vec<[f64; 2]> = swings.iter().map(Drawn::target).collect();
    targets.dedup();
    for target in targets {
        canvas.circle(
            panel.place(target),
            10.0,
            "none",
            Some(Stroke::solid("#1f2933", 2.4)),
        );
    }
}

/// Vertical lines for the limits of x, horizontal ones, with the configurations that they hold for, for those of z.
fn draw_limits(canvas: &mut Canvas, panel: &Panel, swings: &[Drawn]) {
    let mut in_x: Vec<f64> = swings.iter().filter_map(|s| s.task.quadrotor_x_max).collect();
    in_x.sort_by(f64::total_cmp);
    in_x.dedup();
    for x in in_x {
        panel.curve(
            canvas,
            "limit",
            &[[x, panel.y.low], [x, panel.y.high]],
            style::LIMIT,
        );
    }
    let mut in_z: Vec<(f64, Vec<&str>)> = Vec::new();
    for swing in swings {
        let Some(z) = swing.task.quadrotor_z_max.map(|z| z - swing.shift_m) else {
            continue;
        };
        match in_z.iter_mut().find(|(limit, _)| (limit - z).abs() < 1e-9) {
            Some((_, labels)) => labels.push(swing.label()),
            None => in_z.push((z, vec![swing.label()])),
        }
    }
    for (z, labels) in in_z {
        panel.curve(
            canvas,
            "limit",
            &[[panel.x.low, z], [panel.x.high, z]],
            style::LIMIT,
        );
        let [x, y] = panel.place([panel.x.high, z]);
        canvas.text(
            [x - 6.0, y - 6.0],
            &labels.join(", "),
            text(11.5, "#5b6770", Anchor::End),
        );
    }
}

fn draw_time_series(canvas: &mut Canvas, swings: &[Drawn], palette: &Palette, top: f64) {
    let width = (WIDTH - 16.0) / 3.0 - LEFT_ROOM - 6.0;
    let last_s = swings
        .iter()
        .map(|s| s.experiment.flight.samples.len())
        .max()
        .unwrap_or(1) as f64
        * DT;
    for (column, signal) in [Signal::Command, Signal::Quadrotor, Signal::EndEffector]
        .into_iter()
        .enumerate()
    {
        let left = LEFT_ROOM + column as f64 * (LEFT_ROOM + width + 6.0);
        let flown = swings
            .iter()
            .flat_map(|s| over_time(&s.experiment.flight, signal, 0))
            .flatten();
        let measured = swings.iter().flat_map(|s| s.measured_x(signal)).copied();
        let x = Axis::linear("t (s)", 0.0, last_s);
        let y = Axis::around("x (m)", flown.chain(measured).map(|p| p[1]), 1.0);
        let title = format!("x of the {}", signal.name());
        let panel = Panel::draw(canvas, [left, top], [width, TIME_HEIGHT], &title, x, y);
        for swing in swings {
            let stroke = style::measured(palette.color(swing.label()));
            panel.curve(
                canvas,
                &format!("{}, paper", swing.label()),
                swing.measured_x(signal),
                stroke,
            );
        }
        if signal == Signal::Quadrotor
            && let Some(limit) = swings.iter().find_map(|s| s.task.quadrotor_x_max)
        {
            panel.curve(canvas, "limit", &[[0.0, limit], [last_s, limit]], style::LIMIT);
        }
        for swing in swings {
            let stroke = style::flown(palette.color(swing.label()));
            panel.series(
                canvas,
                swing.label(),
                over_time(&swing.experiment.flight, signal, 0),
                stroke,
            );
        }
        if signal == Signal::EndEffector {
            let mut targets: Vec<[f64; 2]> = swings
                .iter()
                .map(|s| [s.task.target.knot as f64 * DT, s.task.target.position[0]])
                .collect();
            targets.dedup();
            for target in targets {
                canvas.circle(
                    panel.place(target),
                    6.0,
                    "none",
                    Some(Stroke::solid("#1f2933", 1.8)),
                );
            }
        }
    }
}
