//! Panels: a rectangle of the drawing with two axes, and the maps from data to pixels.

use super::svg::{Anchor, Canvas, Stroke, Text};

const INK: &str = "#1f2933";
const MUTED: &str = "#5b6770";
const GRID: Stroke = Stroke::solid("#e6e9ec", 1.0);
const FRAME: Stroke = Stroke::solid("#9aa5ae", 1.0);

/// Size of tick labels; other texts relate to it.
pub const TICK_SIZE: f64 = 12.0;
/// Room that a panel needs left of its rectangle for tick labels and the axis label.
pub const LEFT_ROOM: f64 = 58.0;
/// Room below for tick labels and the axis label.
pub const BOTTOM_ROOM: f64 = 44.0;
/// Room above for the title.
pub const TITLE_ROOM: f64 = 26.0;

/// How data maps to an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    Linear,
    /// Logarithmic; both ends must be positive.
    Log,
    /// Numbered rows from the top, unlabelled.
    Rows,
}

/// One axis of a panel.
#[derive(Debug, Clone)]
pub struct Axis {
    pub label: String,
    pub low: f64,
    pub high: f64,
    pub scale: Scale,
}

/// A rectangle with axes.
pub struct Panel {
    pub corner: [f64; 2],
    pub width: f64,
    pub height: f64,
    pub x: Axis,
    pub y: Axis,
    clip: String,
}

impl Axis {
    /// A linear axis from `low` to `high`.
    pub fn linear(label: &str, low: f64, high: f64) -> Self {
        Self {
            label: label.to_owned(),
            low,
            high,
            scale: Scale::Linear,
        }
    }

    /// A linear axis that holds all finite `values` with 4 % to spare on both sides, at least `span` wide.
    pub fn around(label: &str, values: impl Iterator<Item = f64>, span: f64) -> Self {
        let (low, high) = extent(values).unwrap_or((0.0, 0.0));
        let half = (0.5 * (high - low) * 1.08).max(0.5 * span);
        let middle = 0.5 * (low + high);
        Self::linear(label, middle - half, middle + half)
    }

    /// A logarithmic axis that holds all positive finite `values` with a third to spare on both sides.
    pub fn log_around(label: &str, values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = extent(values.filter(|&v| v > 0.0)).unwrap_or((1.0, 10.0));
        Self {
            label: label.to_owned(),
            low: low / 1.33,
            high: high * 1.33,
            scale: Scale::Log,
        }
    }

    /// An axis of `count` rows, 0 on top.
    pub fn rows(count: usize) -> Self {
        Self {
            label: String::new(),
            low: count as f64 - 0.5,
            high: -0.5,
            scale: Scale::Rows,
        }
    }

    /// `value` as a fraction of the axis, 0 at its low end.
    fn fraction(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear | Scale::Rows => (value - self.low) / (self.high - self.low),
            Scale::Log => (value / self.low).ln() / (self.high / self.low).ln(),
        }
    }

    /// Values to label, about `count` of them, with the decimals that they need.
    fn ticks(&self, count: usize) -> (Vec<f64>, usize) {
        if self.scale == Scale::Rows {
            return (Vec::new(), 0);
        }
        if self.scale == Scale::Log {
            let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
            let inside = |v: &f64| (self.low * 0.999..=self.high * 1.001).contains(v);
            let at = |mantissas: &[f64]| -> Vec<f64> {
                let decades = decades.clone().map(|d| 10.0_f64.powi(d));
                let ticks = decades.flat_map(|decade| mantissas.iter().map(move |m| m * decade));
                ticks.filter(inside).collect()
            };
            let mut ticks = at(&[1.0, 2.0, 5.0]);
            if ticks.len() < 3 {
                ticks = at(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0]);
            }
            let decimals = ticks
                .first()
                .map_or(0, |v| (-v.log10().floor()).max(0.0) as usize);
            return (ticks, decimals);
        }
        let step = nice_step((self.high - self.low) / count as f64);
        let slack = 1e-9 * step;
        let first = ((self.low - slack) / step).ceil() as i64;
        let last = ((self.high + slack) / step).floor() as i64;
        let ticks = (first..=last).map(|i| i as f64 * step).collect();
        (ticks, (-step.log10().floor()).max(0.0) as usize)
    }
}

impl Panel {
    /// A panel at `corner` (top left), its frame, grid, tick labels and title drawn.
    pub fn draw(
        canvas: &mut Canvas,
        corner: [f64; 2],
        [width, height]: [f64; 2],
        title: &str,
        x: Axis,
        y: Axis,
    ) -> Self {
        let clip = canvas.clip(corner, width, height);
        let panel = Self {
            corner,
            width,
            height,
            x,
            y,
            clip,
        };
        panel.draw_axes(canvas);
        if !title.is_empty() {
            let style = Text {
                bold: true,
                ..text(13.5, INK, Anchor::Start)
            };
            canvas.text([corner[0], corner[1] - 9.0], title, style);
        }
        panel
    }

    /// Height of a panel `width` wide whose two linear axes share one scale.
    pub fn equal_height(width: f64, x: &Axis, y: &Axis) -> f64 {
        width * (y.high - y.low) / (x.high - x.low)
    }

    /// Pixel of a data point.
    pub fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.corner[0] + self.width * self.x.fraction(x),
            self.corner[1] + self.height * (1.0 - self.y.fraction(y)),
        ]
    }

    /// Draws a series of data points, interrupted where one is `None`.
    pub fn series(
        &self,
        canvas: &mut Canvas,
        name: &str,
        points: impl Iterator<Item = Option<[f64; 2]>>,
        stroke: Stroke,
    ) {
        canvas.series(name, &self.clip, points.map(|p| Some(self.place(p?))), stroke);
    }

    /// Draws a complete curve.
    pub fn curve(&self, canvas: &mut Canvas, name: &str, points: &[[f64; 2]], stroke: Stroke) {
        self.series(canvas, name, points.iter().copied().map(Some), stroke);
    }

    fn draw_axes(&self, canvas: &mut Canvas) {
        let [left, top] = self.corner;
        let (right, bottom) = (left + self.width, top + self.height);
        let (ticks, decimals) = self.x.ticks((self.width / 75.0).round().max(2.0) as usize);
        for tick in ticks {
            let x = self.place([tick, self.y.low])[0];
            canvas.line([x, top], [x, bottom], GRID);
            let label = format_tick(tick, decimals, self.x.scale);
            canvas.text([x, bottom + 17.0], &label, text(TICK_SIZE, MUTED, Anchor::Middle));
        }
        let (ticks, decimals) = self.y.ticks((self.height / 38.0).round().max(2.0) as usize);
        for tick in ticks {
            let y = self.place([self.x.low, tick])[1];
            canvas.line([left, y], [right, y], GRID);
            let label = format_tick(tick, decimals, self.y.scale);
            canvas.text([left - 7.0, y + 4.0], &label, text(TICK_SIZE, MUTED, Anchor::End));
        }
        for (from, to) in [
            ([left, top], [right, top]),
            ([right, top], [right, bottom]),
            ([right, bottom], [left, bottom]),
            ([left, bottom], [left, top]),
        ] {
            canvas.line(from, to, FRAME);
        }
        let label = text(12.5, INK, Anchor::Middle);
        canvas.text([0.5 * (left + right), bottom + 36.0], &self.x.label, label);
        canvas.text(
            [left - 44.0, 0.5 * (top + bottom)],
            &self.y.label,
            Text {
                upright: true,
                ..label
            },
        );
    }
}

/// One entry of a legend.
pub struct LegendEntry {
    pub label: String,
    pub stroke: Stroke,
}

/// Draws legend entries in rows from `corner`, at most `width` wide, and returns the height used.
pub fn draw_legend(canvas: &mut Canvas, corner: [f64; 2], width: f64, entries: &[LegendEntry]) -> f64 {
    let (sample, gap, row) = (30.0, 22.0, 20.0);
    let [mut x, mut y] = corner;
    for entry in entries {
        let entry_width = sample + 7.0 + text_width(&entry.label, 12.5);
        if x > corner[0] && x + entry_width > corner[0] + width {
            (x, y) = (corner[0], y + row);
        }
        canvas.line([x, y + 8.0], [x + sample, y + 8.0], entry.stroke);
        canvas.text(
            [x + sample + 7.0, y + 12.0],
            &entry.label,
            text(12.5, INK, Anchor::Start),
        );
        x += entry_width + gap;
    }
    y + row - corner[1]
}

/// Plain text.
pub fn text(size: f64, color: &'static str, anchor: Anchor) -> Text {
    Text {
        size,
        color,
        anchor,
        bold: false,
        upright: false,
    }
}

/// About how wide a text is in a usual sans-serif font, without the font at hand.
pub fn text_width(content: &str, size: f64) -> f64 {
    let em = |c: char| match c {
        'i' | 'j' | 'l' | 'f' | 't' | 'r' | ' ' | ',' | '.' | ':' | '(' | ')' => 0.36,
        'm' | 'w' | 'M' | 'W' | '→' => 0.92,
        c if c.is_uppercase() => 0.68,
        _ => 0.6,
    };
    size * content.chars().map(em).sum::<f64>()
}

fn extent(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.filter(|v| v.is_finite()).fold(None, |extent, v| {
        let (low, high) = extent.unwrap_or((v, v));
        Some((low.min(v), high.max(v)))
    })
}

/// The smallest of 1, 2, 5 times a power of ten that is not below `step`.
fn nice_step(step: f64) -> f64 {
    let decade = 10.0_f64.powf(step.log10().floor());
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|m| m * decade)
        .find(|&s| s >= step * (1.0 - 1e-9))
        .unwrap_or(10.0 * decade)
}

fn format_tick(value: f64, decimals: usize, scale: Scale) -> String {
    let label = match scale {
        Scale::Linear | Scale::Rows => format!("{value:.decimals$}"),
        Scale::Log => format!("{}", (value * 1e6).round() / 1e6),
    };
    label.replace('-', "\u{2212}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_ticks_are_round_and_inside() {
        let (ticks, decimals) = Axis::linear("", -1.1, 1.1).ticks(5);
        assert_eq!((ticks, decimals), (vec![-1.0, -0.5, 0.0, 0.5, 1.0], 1));
        let (ticks, decimals) = Axis::linear("", 0.0, 20.0).ticks(8);
        assert_eq!((ticks, decimals), (vec![0.0, 5.0, 10.0, 15.0, 20.0], 0));
    }

    #[test]
    fn log_axis_encloses_its_values() {
        let axis = Axis::log_around("", [1.3, 42.0, f64::NAN, -1.0].into_iter());
        assert!(axis.low < 1.3 && axis.high > 42.0);
        assert_eq!(axis.ticks(5).0, vec![1.0, 2.0, 5.0, 10.0, 20.0, 50.0]);
        // Less than a decade has values between.
        let narrow = Axis::log_around("", [3.5, 6.7].into_iter());
        assert_eq!(narrow.ticks(5).0, vec![3.0, 4.0, 5.0, 6.0, 8.0]);
    }

    #[test]
    fn equal_axes_share_a_scale() {
        let (x, y) = (Axis::linear("", -1.0, 1.0), Axis::linear("", 0.0, 1.0));
        let height = Panel::equal_height(300.0, &x, &y);
        let panel = Panel::draw(
            &mut Canvas::new("t", 400.0, 400.0),
            [10.0, 20.0],
            [300.0, height],
            "",
            x,
            y,
        );
        let ([x0, y0], [x1, y1]) = (panel.place([0.0, 0.0]), panel.place([0.5, 0.5]));
        assert!(((x1 - x0) - (y0 - y1)).abs() < 1e-9);
        assert_eq!(panel.place([-1.0, 1.0]), [10.0, 20.0]);
    }

    #[test]
    fn an_axis_of_nothing_still_has_a_width() {
        let axis = Axis::around("", [f64::NAN].into_iter(), 1.0);
        assert_eq!((axis.low, axis.high), (-0.5, 0.5));
    }
}
