//! Figures of a sweep: where in the plane of two varied parameters flights succeed, and how errors are distributed.

use super::Figure;
use super::chart::{Axis, BOTTOM_ROOM, LEFT_ROOM, Panel, TITLE_ROOM, draw_legend, text};
use super::style::{self, Palette};
use super::svg::{Anchor, Canvas};

const MAP_WIDTH: f64 = 620.0;
const CELL_HEIGHT: f64 = 46.0;
const CHART: [f64; 2] = [720.0, 340.0];
/// Room for the labels of the rows of a map.
const ROW_LABELS: f64 = 84.0;

/// Shares of successful flights over two varied parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct SuccessMap {
    /// Headline, for example the task and the control law.
    pub title: String,
    /// Name of the parameter across, with its unit.
    pub across: String,
    /// Its values, ascending.
    pub across_values: Vec<f64>,
    /// Name of the parameter upwards, with its unit.
    pub upwards: String,
    /// Its values, ascending.
    pub upwards_values: Vec<f64>,
    /// Share of successes, 0 to 1, and flights, per cell: one row per value upwards. `None` where nothing was flown.
    pub cells: Vec<Vec<Option<(f64, usize)>>>,
}

/// The errors of one group of flights.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorDistribution {
    /// What the group has in common.
    pub label: String,
    /// Errors of its flights, m, ascending: swings' misses of the target, otherwise mean end-effector errors; infinite for
    /// a flight that did not end well.
    pub errors_m: Vec<f64>,
}

/// Draws `map` as figure `name`: one cell per pair of values, its colour and text the share of successes.
pub fn success_map(name: &str, map: &SuccessMap) -> Figure {
    let (columns, rows) = (map.across_values.len(), map.upwards_values.len());
    let height = CELL_HEIGHT * rows as f64;
    let mut canvas = Canvas::new(
        name,
        ROW_LABELS + MAP_WIDTH + 16.0,
        TITLE_ROOM + height + BOTTOM_ROOM,
    );
    let ink = |anchor| text(12.5, "#1f2933", anchor);
    canvas.text([ROW_LABELS, TITLE_ROOM - 9.0], &map.title, ink(Anchor::Start));
    let width = MAP_WIDTH / columns.max(1) as f64;
    for (row, cells) in map.cells.iter().enumerate() {
        let top = TITLE_ROOM + CELL_HEIGHT * (rows - 1 - row) as f64;
        let middle = top + 0.5 * CELL_HEIGHT + 4.0;
        let label = number(map.upwards_values[row]);
        canvas.text([ROW_LABELS - 8.0, middle], &label, ink(Anchor::End));
        for (column, cell) in cells.iter().enumerate() {
            let left = ROW_LABELS + width * column as f64;
            let (color, words) = match cell {
                Some((share, flights)) => (shade(*share), format!("{:.0} % of {flights}", 100.0 * share)),
                None => ("#ffffff".to_owned(), "–".to_owned()),
            };
            let corner = [left + 1.0, top + 1.0];
            canvas.rectangle(corner, width - 2.0, CELL_HEIGHT - 2.0, &color, 2.0);
            canvas.text([left + 0.5 * width, middle], &words, ink(Anchor::Middle));
        }
    }
    let bottom = TITLE_ROOM + height;
    for (column, value) in map.across_values.iter().enumerate() {
        let center = ROW_LABELS + width * (column as f64 + 0.5);
        canvas.text([center, bottom + 17.0], &number(*value), ink(Anchor::Middle));
    }
    let middle = ROW_LABELS + 0.5 * MAP_WIDTH;
    canvas.text([middle, bottom + 36.0], &map.across, ink(Anchor::Middle));
    let upright = super::svg::Text {
        upright: true,
        ..ink(Anchor::Middle)
    };
    canvas.text([14.0, TITLE_ROOM + 0.5 * height], &map.upwards, upright);
    Figure {
        name: name.to_owned(),
        title: format!("Successful flights: {}", map.title),
        caption: format!(
            "Share of flights that succeeded, over {} (across) and {} (upwards).",
            map.across, map.upwards
        ),
        svg: canvas.finish(&format!("Share of successful flights, {}", map.title)),
    }
}

/// Draws cumulative distributions as figure `name`: the share of a group's flights with at most an error. A curve
/// that ends below 1 belongs to a group of which some flights did not end well.
pub fn error_distributions(name: &str, groups: &[ErrorDistribution]) -> Figure {
    let finite = |group: &ErrorDistribution| {
        let finite = group.errors_m.iter().filter(|error| error.is_finite());
        finite.map(|error| 100.0 * error).collect::<Vec<f64>>()
    };
    let palette = Palette::new(groups.iter().map(|group| group.label.as_str()));
    let legend: Vec<_> = groups
        .iter()
        .map(|group| style::entry(&group.label, style::flown(palette.color(&group.label))))
        .collect();
    let mut canvas = Canvas::new(
        name,
        LEFT_ROOM + CHART[0] + 16.0,
        26.0 * legend.len() as f64 + TITLE_ROOM + CHART[1] + BOTTOM_ROOM,
    );
    let used = draw_legend(&mut canvas, [LEFT_ROOM, 4.0], CHART[0], &legend);
    let x = Axis::log_around(
        "mean end-effector error, of swings the target miss (cm)",
        groups.iter().flat_map(finite),
    );
    let start = x.low;
    let panel = Panel::draw(
        &mut canvas,
        [LEFT_ROOM, used + 12.0],
        CHART,
        "",
        x,
        Axis::linear("share of flights", 0.0, 1.0),
    );
    for group in groups {
        let share = |count: usize| count as f64 / group.errors_m.len() as f64;
        let mut steps = vec![[start, 0.0]];
        for (below, error) in finite(group).into_iter().enumerate() {
            steps.extend([[error, share(below)], [error, share(below + 1)]]);
        }
        panel.curve(
            &mut canvas,
            &group.label,
            &steps,
            style::flown(palette.color(&group.label)),
        );
    }
    Figure {
        name: name.to_owned(),
        title: "Distribution of errors".into(),
        caption:
            "Share of flights whose mean end-effector error (of swings: miss of the target) is at most so large; a \
                  curve that ends below 1 belongs to a group of which some flights did not end well."
                .into(),
        svg: canvas.finish("Cumulative distribution of end-effector errors"),
    }
}

/// From vermilion (0) over white to blue (1): told apart with any colour vision.
fn shade(share: f64) -> String {
    let (end, strength) = if share < 0.5 {
        ([213.0, 94.0, 0.0], 1.0 - 2.0 * share)
    } else {
        ([0.0, 114.0, 178.0], 2.0 * share - 1.0)
    };
    // Three quarters of the full colour at most: the text on it stays readable.
    let channel = |full: f64| (255.0 + 0.75 * strength * (full - 255.0)).round() as u8;
    let [red, green, blue] = end.map(channel);
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// A parameter's value without the digits that rounding left.
fn number(value: f64) -> String {
    format!("{}", (value * 1e6).round() / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_has_a_cell_for_every_pair() {
        let map = SuccessMap {
            title: "swing, mpc".into(),
            across: "wind (m/s)".into(),
            across_values: vec![0.0, 1.0, 2.0],
            upwards: "payload (kg)".into(),
            upwards_values: vec![0.0, 0.05],
            cells: vec![
                vec![Some((1.0, 4)), Some((0.5, 4)), None],
                vec![Some((0.25, 4)), Some((0.0, 4)), Some((0.0, 4))],
            ],
        };
        let svg = success_map("map", &map).svg;
        assert_eq!(svg.matches("<rect x=").count(), 6);
        for words in ["100 % of 4", "25 % of 4", "–", "wind (m/s)", "0.05"] {
            assert!(svg.contains(words), "{words}");
        }
        let document = roxmltree::Document::parse(&svg).unwrap();
        assert_eq!(document.root_element().tag_name().name(), "svg");
    }

    #[test]
    fn a_distribution_climbs_by_equal_steps_and_stops_at_the_flights_that_failed() {
        let group = ErrorDistribution {
            label: "mpc".into(),
            errors_m: vec![0.01, 0.02, 0.04, f64::INFINITY],
        };
        let svg = error_distributions("errors", &[group]).svg;
        let document = roxmltree::Document::parse(&svg).unwrap();
        let series = document
            .descendants()
            .find(|node| node.attribute("data-series") == Some("mpc"))
            .unwrap();
        // Start, then two corners for each finite error.
        let path = series.attribute("d").unwrap();
        assert_eq!(path.matches(['M', 'L']).count(), 7);
    }

    #[test]
    fn the_middle_of_the_scale_is_white() {
        assert_eq!(shade(0.5), "#ffffff");
        assert_ne!(shade(0.0), shade(1.0));
    }
}
