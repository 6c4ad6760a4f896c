//! A drawing that becomes one SVG element. Coordinates are pixels, y down, kept to 1/100 pixel.

use std::fmt::Write;

use crate::report::escape::escape;

const FONTS: &str =
    "system-ui, -apple-system, 'Segoe UI', 'Helvetica Neue', Arial, 'Liberation Sans', sans-serif";

/// How a line is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Stroke {
    pub color: &'static str,
    pub width: f64,
    pub opacity: f64,
    pub dash: Dash,
}

/// The pattern of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Dash {
    Solid,
    Dashed,
    Dotted,
}

/// Where a text stands relative to its position.
#[derive(Debug, Clone, Copy)]
pub enum Anchor {
    Start,
    Middle,
    End,
}

/// How a text is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Text {
    pub size: f64,
    pub color: &'static str,
    pub anchor: Anchor,
    pub bold: bool,
    /// Reads upwards, turned about its position.
    pub upright: bool,
}

/// An SVG element under construction.
pub struct Canvas {
    name: String,
    width: f64,
    height: f64,
    body: String,
    clips: usize,
}

impl Stroke {
    pub const fn solid(color: &'static str, width: f64) -> Self {
        Self {
            color,
            width,
            opacity: 1.0,
            dash: Dash::Solid,
        }
    }

    pub const fn dashed(self) -> Self {
        Self {
            dash: Dash::Dashed,
            ..self
        }
    }

    pub const fn dotted(self) -> Self {
        Self {
            dash: Dash::Dotted,
            ..self
        }
    }

    pub const fn faint(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    fn attributes(&self) -> String {
        let mut attributes = format!(r#"stroke="{}" stroke-width="{}""#, self.color, self.width);
        if self.opacity < 1.0 {
            let _ = write!(attributes, r#" stroke-opacity="{}""#, self.opacity);
        }
        let unit = self.width.max(1.2);
        match self.dash {
            Dash::Solid => {}
            Dash::Dashed => {
                let _ = write!(
                    attributes,
                    r#" stroke-dasharray="{} {}""#,
                    Px(4.0 * unit),
                    Px(2.5 * unit)
                );
            }
            Dash::Dotted => {
                let _ = write!(attributes, r#" stroke-dasharray="0.1 {}""#, Px(2.2 * unit));
            }
        }
        attributes
    }
}

impl Canvas {
    /// An empty drawing; `name` makes its element ids unique within a page.
    pub fn new(name: &str, width: f64, height: f64) -> Self {
        Self {
            name: name.to_owned(),
            width,
            height,
            body: String::new(),
            clips: 0,
        }
    }

    pub fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], stroke: Stroke) {
        let _ = writeln!(
            self.body,
            r#"<path d="M{} {}L{} {}" {}/>"#,
            Px(x1),
            Px(y1),
            Px(x2),
            Px(y2),
            stroke.attributes()
        );
    }

    /// A line through `points`, interrupted where one is `None`, shown by `series` on hovering and clipped to
    /// the area `clip` that [`Self::clip`] returned.
    pub fn series(
        &mut self,
        series: &str,
        clip: &str,
        points: impl Iterator<Item = Option<[f64; 2]>>,
        stroke: Stroke,
    ) {
        let mut data = String::new();
        let mut pen = 'M';
        for point in points {
            match point.filter(|p| p.iter().all(|v| v.is_finite())) {
                Some([x, y]) => {
                    let _ = write!(data, "{pen}{} {}", Px(x), Px(y));
                    pen = 'L';
                }
                None => pen = 'M',
            }
        }
        if data.is_empty() {
            return;
        }
        let series = escape(series);
        let _ = writeln!(
            self.body,
            r#"<path class="series" data-series="{series}" clip-path="url(#{clip})" d="{data}" {}><title>{series}</title></path>"#,
            stroke.attributes()
        );
    }

    pub fn circle(&mut self, [x, y]: [f64; 2], radius: f64, fill: &str, stroke: Option<Stroke>) {
        let outline = stroke.map_or(r#"stroke="none""#.to_owned(), |s| s.attributes());
        let _ = writeln!(
            self.body,
            r#"<circle cx="{}" cy="{}" r="{radius}" fill="{fill}" {outline}/>"#,
            Px(x),
            Px(y)
        );
    }

    pub fn rectangle(&mut self, [x, y]: [f64; 2], width: f64, height: f64, fill: &str, corner: f64) {
        let _ = writeln!(
            self.body,
            r#"<rect x="{}" y="{}" width="{}" height="{}" rx="{corner}" fill="{fill}" stroke="none"/>"#,
            Px(x),
            Px(y),
            Px(width),
            Px(height)
        );
    }

    pub fn text(&mut self, [x, y]: [f64; 2], content: &str, style: Text) {
        let anchor = match style.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let (x, y) = (Px(x), Px(y));
        let weight = if style.bold { r#" font-weight="600""# } else { "" };
        let turn = if style.upright {
            format!(r#" transform="rotate(-90 {x} {y})""#)
        } else {
            String::new()
        };
        let _ = writeln!(
            self.body,
            r#"<text x="{x}" y="{y}" font-size="{}" fill="{}" stroke="none" text-anchor="{anchor}"{weight}{turn}>{}</text>"#,
            style.size,
            style.color,
            escape(content)
        );
    }

    /// Declares a rectangular clipping area and returns its id.
    pub fn clip(&mut self, [x, y]: [f64; 2], width: f64, height: f64) -> String {
        let id = format!("{}-clip{}", self.name, self.clips);
        self.clips += 1;
        let _ = writeln!(
            self.body,
            r#"<clipPath id="{id}"><rect x="{}" y="{}" width="{}" height="{}"/></clipPath>"#,
            Px(x),
            Px(y),
            Px(width),
            Px(height)
        );
        id
    }

    /// The finished element, with a title for those who cannot see it.
    pub fn finish(self, title: &str) -> String {
        let Self {
            name,
            width,
            height,
            body,
            ..
        } = self;
        format!(
            concat!(
                r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" "#,
                r#"height="{height}" role="img" aria-labelledby="{name}-title" font-family="{fonts}" "#,
                r#"fill="none" stroke-linecap="round" stroke-linejoin="round">"#,
                "\n<title id=\"{name}-title\">{title}</title>\n",
                "<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{body}</svg>\n"
            ),
            width = Px(width),
            height = Px(height),
            name = name,
            fonts = FONTS,
            title = escape(title),
            body = body,
        )
    }
}

/// A pixel coordinate, rounded to 1/100 and written without trailing zeros.
struct Px(f64);

impl std::fmt::Display for Px {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Adding zero turns -0 into 0.
        let rounded = (self.0 * 100.0).round() / 100.0 + 0.0;
        write!(f, "{rounded}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_points_interrupt_a_series() {
        let mut canvas = Canvas::new("test", 10.0, 10.0);
        let points = [
            Some([0.0, 0.0]),
            Some([1.0, 1.234]),
            None,
            Some([f64::NAN, 0.0]),
            Some([3.0, -0.001]),
        ];
        canvas.series("a<b", "c", points.into_iter(), Stroke::solid("#000", 1.0));
        let svg = canvas.finish("t&t");
        assert!(svg.contains(r#"d="M0 0L1 1.23M3 0""#), "{svg}");
        assert!(svg.contains("a&lt;b") && svg.contains("t&amp;t"));
    }

    #[test]
    fn nothing_to_draw_draws_nothing() {
        let mut canvas = Canvas::new("test", 10.0, 10.0);
        canvas.series("empty", "c", [None, None].into_iter(), Stroke::solid("#000", 1.0));
        assert!(!canvas.finish("t").contains("series"));
    }
}
