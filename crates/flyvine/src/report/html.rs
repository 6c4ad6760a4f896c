//! The page: one self-contained HTML file that works offline, from `file://`.

use super::escape::{escape, json_in_script};
use super::figures::{Figure, Palette, figures, palette};
use super::paper::{PublishedError, published_error};
use super::replay::replay_json;
use super::results::{Experiment, ExperimentKind, ReportError, Results, RunSummary};
use super::tables::{self, centimetres, published_range};

const PAGE: &str = include_str!("assets/page.html");
const STYLE: &str = include_str!("assets/style.css");
const REPLAY: &str = include_str!("assets/replay.html");
/// three.js as a classic script that defines `THREE`: what `assets/three/entry.js` names of it.
pub const THREE: &str = include_str!("assets/three/three.min.js");
/// What stands in a 3-D scene, as a JavaScript module that wants [`THREE`].
pub const MODELS: &str = include_str!("assets/models.js");
const SCENE: &str = include_str!("assets/scene.js");
const PLAYER: &str = include_str!("assets/player.js");

/// The report as one HTML page. The same results make the same bytes.
pub fn html(results: &Results) -> Result<String, ReportError> {
    let palette = palette(results);
    let experiments = results.experiments_in_order();
    let scripts = if !experiments.is_empty() {
        let data = json_in_script(&replay_json(&experiments, &palette)?);
        format!(
            "<script type=\"application/json\" id=\"replay-data\">{data}</script>\n\
             <script>{THREE}</script>\n<script type=\"module\">{MODELS}{SCENE}{PLAYER}</script>"
        )
    } else {
        String::new()
    };
    let title = if results.summary.title.is_empty() {
        "Flight report"
    } else {
        &results.summary.title
    };
    Ok(fill(
        PAGE,
        &[
            ("title", &escape(title)),
            ("style", STYLE),
            ("facts", &facts(&results.summary)),
            ("headlines", &headlines(&experiments)),
            ("sections", &sections(results, &experiments, &palette)),
            ("scripts", &scripts),
        ],
    ))
}

fn sections(results: &Results, experiments: &[&Experiment], palette: &Palette) -> String {
    let (model_figures, flight_figures): (Vec<Figure>, Vec<Figure>) = figures(results)
        .into_iter()
        .partition(|f| matches!(f.name.as_str(), "rollouts" | "pretzel"));
    let draw = |figures: &[Figure]| figures.iter().map(figure_card).collect::<String>();
    let mut page = String::new();
    if !experiments.is_empty() {
        page += REPLAY;
        page += &section("results", "Results", &tables::scores(experiments, palette));
        page += &section("figures", "Figures", &draw(&flight_figures));
    }
    let mut models = draw(&model_figures);
    if !results.rollouts.is_empty() {
        models += &tables::rollouts(&results.rollouts, palette);
    }
    if !results.models.is_empty() {
        models += &tables::models(&results.models);
    }
    page += &section("models", "Models", &models);
    if !experiments.is_empty() {
        page += &section("plans", "Plans", &tables::plans(experiments));
        page += &section("estimates", "Found in flight", &tables::estimates(experiments));
    }
    if !results.findings.is_empty() {
        page += &section("recordings", "Recordings", &tables::findings(&results.findings));
    }
    page += &section("remarks", "Remarks", &remarks(&results.summary));
    page
}

/// A headed section; nothing without content.
fn section(id: &str, heading: &str, content: &str) -> String {
    if content.is_empty() {
        return String::new();
    }
    format!(
        "<section id=\"{id}\" aria-labelledby=\"{id}-heading\">\n<h2 id=\"{id}-heading\">{heading}</h2>\n{content}</section>\n"
    )
}

fn figure_card(figure: &Figure) -> String {
    format!(
        "<figure class=\"card\" id=\"figure-{}\">\n<h3>{}</h3>\n<figcaption class=\"caption\">{}</figcaption>\n\
         <div class=\"plot\">{}</div>\n</figure>\n",
        escape(&figure.name),
        escape(&figure.title),
        escape(&figure.caption),
        figure.svg
    )
}

fn facts(summary: &RunSummary) -> String {
    let entries = [
        ("Vehicle", Some(summary.vehicle.clone())),
        ("Flown", Some(summary.controller.clone())),
        ("Seed", summary.seed.map(|seed| seed.to_string())),
        ("flyvine", Some(summary.tool_version.clone())),
        ("Date", summary.date.clone()),
    ];
    let items: String = entries
        .into_iter()
        .filter_map(|(name, value)| Some((name, value.filter(|v| !v.is_empty())?)))
        .map(|(name, value)| format!("<div><dt>{name}</dt><dd>{}</dd></div>\n", escape(&value)))
        .collect();
    format!("<dl class=\"facts\">\n{items}</dl>")
}

/// One card per kind of experiment: the range of its mean errors beside the paper's.
fn headlines(experiments: &[&Experiment]) -> String {
    let kinds = [
        (ExperimentKind::Lemniscate, "Lemniscates", "to the reference"),
        (ExperimentKind::Swing, "Swings", "to the prediction"),
        (ExperimentKind::Deploy, "Deployment", "to the prediction"),
        (ExperimentKind::Waypoints, "Waypoints", "to the reference"),
    ];
    let cards: String = kinds
        .into_iter()
        .filter_map(|(kind, name, against)| {
            let flown: Vec<&Experiment> = experiments.iter().copied().filter(|e| e.kind == kind).collect();
            let (low, high) = extent(flown.iter().filter_map(|e| Some(e.comparable_error()?.1.mean_m)))?;
            let mut notes = vec![format!(
                "mean end-effector error {against}, {} flown",
                flown.len()
            )];
            let published: Vec<PublishedError> = flown.iter().filter_map(|e| published_error(e)).collect();
            let ends = published.iter().flat_map(|p| [p.low_m, p.high_m]);
            if let Some((low_m, high_m)) = extent(ends) {
                let range = published_range(PublishedError { low_m, high_m });
                notes.push(format!("paper, on hardware: {range} cm"));
            }
            let misses = flown.iter().filter_map(|e| e.score.as_ref()?.target_miss_m);
            if let Some((low, high)) = extent(misses) {
                notes.push(format!("target missed by {} cm", range_in_centimetres(low, high)));
            }
            let notes: String = notes
                .iter()
                .map(|n| format!("<p class=\"note\">{n}</p>"))
                .collect();
            let value = range_in_centimetres(low, high);
            Some(format!(
                "<div class=\"card\"><p>{name}</p><p class=\"value\">{value} cm</p>{notes}</div>\n"
            ))
        })
        .collect();
    if cards.is_empty() {
        cards
    } else {
        format!("<div class=\"headlines\">\n{cards}</div>")
    }
}

fn remarks(summary: &RunSummary) -> String {
    let mut content: String = summary
        .notes
        .iter()
        .map(|note| format!("<p>{}</p>\n", escape(note)))
        .collect();
    if !summary.timings.is_empty() {
        let items: String = summary
            .timings
            .iter()
            .map(|t| {
                format!(
                    "<div><dt>{}</dt><dd>{:.1} s</dd></div>\n",
                    escape(&t.stage),
                    t.seconds
                )
            })
            .collect();
        content += &format!("<dl class=\"facts\">\n{items}</dl>\n");
    }
    if content.is_empty() {
        content
    } else {
        format!("<div class=\"card\">{content}</div>\n")
    }
}

fn extent(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values
        .filter(|v| v.is_finite())
        .fold(None, |extent: Option<(f64, f64)>, v| {
            let (low, high) = extent.unwrap_or((v, v));
            Some((low.min(v), high.max(v)))
        })
}

fn range_in_centimetres(low_m: f64, high_m: f64) -> String {
    let (low, high) = (centimetres(low_m), centimetres(high_m));
    if low == high {
        low
    } else {
        format!("{low}–{high}")
    }
}

/// Replaces each `{{key}}` of a template, once and from left to right, so that braces in a value stay text.
fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut page = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        page += before;
        let (key, after) = after.split_once("}}").unwrap_or((after, ""));
        page += values
            .iter()
            .find(|(name, _)| *name == key)
            .map_or("", |(_, value)| value);
        rest = after;
    }
    page + rest
}
