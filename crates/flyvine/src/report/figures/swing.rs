//! Swings to a target: paths in the xz plane, and x over time of command, quadrotor and end effector.

use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend, text};
use super::style::{self, Palette};
use super::svg::{Anchor, Canvas, Stroke};
use super::{Figure, over_time, path};
use crate::DT;
use crate::report::paper::{self, Corner, Signal};
use crate::report::results::{Experiment, SwingTask};

const WIDTH: f64 = 1040.0;
const XZ_WIDTH: f64 = 520.0;
const LEGEND_HEIGHT: f64 = 72.0;

/// A swing and how much lower than it was flown it is drawn, so that all targets coincide.
struct Drawn<'a> {
    experiment: &'a Experiment,
    task: SwingTask,
    shift_m: f64,
}

/// `None` without experiments that have a target.
pub fn figure(experiments: &[&Experiment], palette: &Palette) -> Option<Figure> {
    let lowest = experiments
        .iter()
        .filter_map(|e| Some(e.swing?.target.position[1]))
        .fold(f64::INFINITY, f64::min);
    let swings: Vec<Drawn> = experiments
        .iter()
        .filter_map(|&experiment| {
            let task = experiment.swing?;
            Some(Drawn {
                experiment,
                task,
                shift_m: task.target.position[1] - lowest,
            })
        })
        .collect();
    if swings.is_empty() {
        return None;
    }

    let xz_axes = path_axes(&swings);
    let xz_height = Panel::equal_height(XZ_WIDTH, &xz_axes.0, &xz_axes.1);
    let body_height = (TITLE_ROOM + xz_height + BOTTOM_ROOM).max(500.0);
    let mut canvas = Canvas::new("swings", WIDTH, LEGEND_HEIGHT + body_height);
    let mut legend =
        style::configuration_entries(palette, swings.iter().map(|s| s.experiment.label.as_str()));
    legend.extend([
        style::entry("end effector", style::flown("#1f2933")),
        style::entry("quadrotor", style::flown("#1f2933").dashed()),
        style::measured_entry(),
        style::entry("quadrotor limits", style::LIMIT),
    ]);
    draw_legend(&mut canvas, [LEFT_ROOM, 4.0], WIDTH - LEFT_ROOM, &legend);
    draw_paths(&mut canvas, &swings, palette, xz_axes, xz_height);
    draw_time_series(&mut canvas, &swings, palette, body_height);

    let shifted: Vec<String> = swings
        .iter()
        .filter(|s| s.shift_m > 0.0)
        .map(|s| format!("{} {:.2} m", s.experiment.label, s.shift_m))
        .collect();
    let note = if shifted.is_empty() {
        String::new()
    } else {
        format!(
            " As in the paper, short arms are drawn lower so that the targets coincide ({}).",
            shifted.join(", ")
        )
    };
    Some(Figure {
        name: "swings".into(),
        title: "Swings to a target".into(),
        caption: format!(
            "The end effector shall pass the target (circle) while the quadrotor keeps its limits. Thin lines are \
             this run, wide pale lines the paper's hardware flights.{note}"
        ),
        svg: canvas.finish("Swings: paths in the xz plane, and x over time"),
    })
}

fn path_axes(swings: &[Drawn]) -> (Axis, Axis) {
    let seen = |axis: usize| {
        swings.iter().flat_map(move |s| {
            let down = if axis == 2 { s.shift_m } else { 0.0 };
            [Signal::Quadrotor, Signal::EndEffector]
                .into_iter()
                .flat_map(move |signal| path(&s.experiment.flight, signal, [axis, axis]))
                .flatten()
                .map(move |p| p[0] - down)
        })
    };
    let targets = |i: usize| swings.iter().map(move |s| s.task.target.position[i]);
    let x = Axis::around("x (m)", seen(0).chain(targets(0)).chain([-0.6, 1.6]), 1.0);
    let lowest = swings.iter().map(|s| s.task.target.position[1] - s.shift_m);
    let limits = swings
        .iter()
        .filter_map(|s| Some(s.task.quadrotor_z_max? - s.shift_m));
    let z = Axis::around("z (m)", seen(2).chain(lowest).chain(limits), 1.0);
    (x, z)
}

fn draw_paths(canvas: &mut Canvas, swings: &[Drawn], palette: &Palette, (x, z): (Axis, Axis), height: f64) {
    let corner = [LEFT_ROOM, LEGEND_HEIGHT + TITLE_ROOM];
    let panel = Panel::draw(canvas, corner, [XZ_WIDTH, height], "Paths in the xz plane", x, z);
    draw_limits(canvas, &panel, swings);
    for Drawn {
        experiment,
        task,
        shift_m,
    } in swings
    {
        // The paper drew its short arms low enough for targets at its long arms' height.
        let corner = Corner::from_label(&experiment.label);
        let lift_m = corner.map_or(0.0, |c| {
            (task.target.position[1] - shift_m) - paper_target_z(c, task.target.position[1])
        });
        for signal in [Signal::Quadrotor, Signal::EndEffector] {
            if let Some(points) = corner.and_then(|c| paper::swing_xz(c, signal)) {
                let points: Vec<[f64; 2]> = points.iter().map(|p| [p[0], p[1] + lift_m]).collect();
                let name = format!("{}, {}, paper", experiment.label, signal.name());
                panel.curve(
                    canvas,
                    &name,
                    &points,
                    style::measured(palette.color(&experiment.label)),
                );
            }
        }
    }
    for Drawn {
        experiment, shift_m, ..
    } in swings
    {
        for signal in [Signal::Quadrotor, Signal::EndEffector] {
            let points = path(&experiment.flight, signal, [0, 2]).map(|p| p.map(|[x, z]| [x, z - shift_m]));
            let name = format!("{}, {}", experiment.label, signal.name());
            panel.series(
                canvas,
                &name,
                points,
                body_stroke(signal, palette.color(&experiment.label)),
            );
        }
    }
    let mut circles: Vec<[f64; 2]> = Vec::new();
    for Drawn { task, shift_m, .. } in swings {
        let [x, z] = task.target.position;
        if !circles.contains(&[x, z - shift_m]) {
            circles.push([x, z - shift_m]);
            canvas.circle(
                panel.place([x, z - shift_m]),
                9.0,
                "none",
                Some(Stroke::solid("#1f2933", 2.2)),
            );
        }
    }
}

/// Height at which the paper's figure shows the target of a task whose target is at `target_z`.
fn paper_target_z(corner: Corner, target_z: f64) -> f64 {
    if corner.is_short() {
        target_z - paper::SHORT_SWING_SHIFT_M
    } else {
        target_z
    }
}

fn draw_limits(canvas: &mut Canvas, panel: &Panel, swings: &[Drawn]) {
    let mut limits: Vec<f64> = swings.iter().filter_map(|s| s.task.quadrotor_x_max).collect();
    limits.sort_by(f64::total_cmp);
    limits.dedup();
    for x in limits {
        let ends = [[x, panel.y.low], [x, panel.y.high]].map(Some);
        panel.series(canvas, "limit", ends.into_iter(), style::LIMIT);
    }
    let mut limits: Vec<(f64, Vec<&str>)> = Vec::new();
    for Drawn {
        experiment,
        task,
        shift_m,
    } in swings
    {
        let Some(z) = task.quadrotor_z_max.map(|z| z - shift_m) else {
            continue;
        };
        match limits.iter_mut().find(|(limit, _)| (limit - z).abs() < 1e-9) {
            Some((_, labels)) => labels.push(&experiment.label),
            None => limits.push((z, vec![&experiment.label])),
        }
    }
    for (z, labels) in limits {
        let ends = [[panel.x.low, z], [panel.x.high, z]].map(Some);
        panel.series(canvas, "limit", ends.into_iter(), style::LIMIT);
        let [x, y] = panel.place([panel.x.high, z]);
        canvas.text(
            [x - 6.0, y - 6.0],
            &labels.join(", "),
            text(11.0, "#5b6770", Anchor::End),
        );
    }
}

fn draw_time_series(canvas: &mut Canvas, swings: &[Drawn], palette: &Palette, body_height: f64) {
    let left = LEFT_ROOM + XZ_WIDTH + LEFT_ROOM + 14.0;
    let width = WIDTH - left - 16.0;
    let height = (body_height - BOTTOM_ROOM - 3.0 * TITLE_ROOM - 2.0 * 22.0) / 3.0;
    let last_s = swings
        .iter()
        .map(|s| s.experiment.flight.samples.len())
        .max()
        .unwrap_or(1) as f64
        * DT;
    for (row, signal) in [Signal::Command, Signal::Quadrotor, Signal::EndEffector]
        .into_iter()
        .enumerate()
    {
        let top = LEGEND_HEIGHT + TITLE_ROOM + row as f64 * (height + TITLE_ROOM + 22.0);
        let values = swings
            .iter()
            .flat_map(|s| over_time(&s.experiment.flight, signal, 0))
            .flatten()
            .map(|p| p[1]);
        let x = Axis::linear(if row == 2 { "t (s)" } else { "" }, 0.0, last_s);
        let y = Axis::around("x (m)", values.chain([-0.6, 1.6]), 1.0);
        let title = format!("x of the {}", signal.name());
        let panel = Panel::draw(canvas, [left, top], [width, height], &title, x, y);
        for swing in swings {
            let label = &swing.experiment.label;
            let target_s = swing.task.target.knot as f64 * DT;
            if signal == Signal::EndEffector {
                let at = panel.place([target_s, swing.task.target.position[0]]);
                canvas.circle(at, 5.0, "none", Some(Stroke::solid("#1f2933", 1.8)));
            }
            if let Some(points) = Corner::from_label(label).and_then(|c| paper::swing_x(c, signal)) {
                panel.curve(
                    canvas,
                    &format!("{label}, paper"),
                    points,
                    style::measured(palette.color(label)),
                );
            }
        }
        if signal == Signal::Quadrotor
            && let Some(limit) = swings.iter().find_map(|s| s.task.quadrotor_x_max)
        {
            let ends = [[0.0, limit], [last_s, limit]].map(Some);
            panel.series(canvas, "limit", ends.into_iter(), style::LIMIT);
        }
        for Drawn { experiment, .. } in swings {
            let points = over_time(&experiment.flight, signal, 0);
            panel.series(
                canvas,
                &experiment.label,
                points,
                style::flown(palette.color(&experiment.label)),
            );
        }
    }
}

fn body_stroke(signal: Signal, color: &'static str) -> Stroke {
    match signal {
        Signal::Quadrotor => style::flown(color).dashed(),
        _ => style::flown(color),
    }
}
