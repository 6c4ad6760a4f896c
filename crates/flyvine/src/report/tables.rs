//! The tables of the page, as HTML.

use super::escape::escape;
use super::figures::Palette;
use super::paper::{PublishedError, published_error};
use super::results::{Against, Experiment, Finding, FlightRollout, ModelDiagnostics};

/// What stands where there is nothing to say.
const NOTHING: &str = "–";

/// Scores beside the paper's numbers, one row per experiment; the error that the paper reports is bold.
pub fn scores(experiments: &[&Experiment], palette: &Palette) -> String {
    let rows: String = experiments.iter().map(|e| score_row(e, palette)).collect();
    format!(
        "<div class=\"card scroll\"><table>\n<caption>End-effector distances in centimetres. Bold: the error as the \
         paper measures it, green where it is below the paper’s range, red where it is above.</caption>\n\
         <thead><tr><th scope=\"col\">Experiment</th><th scope=\"col\">to reference<br>mean</th>\
         <th scope=\"col\"><br>RMS</th><th scope=\"col\"><br>max</th><th scope=\"col\">to prediction<br>mean</th>\
         <th scope=\"col\">target<br>missed by</th><th scope=\"col\">velocity there<br>v<sub>x</sub>, v<sub>z</sub> (m/s)</th>\
         <th scope=\"col\">rows<br>not seen</th><th scope=\"col\">paper,<br>mean</th></tr></thead>\n\
         <tbody>\n{rows}</tbody></table></div>\n"
    )
}

fn score_row(experiment: &Experiment, palette: &Palette) -> String {
    let published = published_error(experiment);
    let title = escape(&experiment.title());
    let heading = format!(
        "<th scope=\"row\"><button type=\"button\" class=\"small\" data-replay=\"{}\" aria-label=\"Replay {title}\">▶</button>\
         <span class=\"dot\" style=\"background:{}\"></span>{title}</th>",
        escape(&experiment.name),
        palette.color(&experiment.label),
    );
    let paper = published.map_or(NOTHING.to_owned(), published_range);
    let remark = experiment.remark.as_deref().map_or(String::new(), |remark| {
        format!(
            "<tr><td class=\"text wrap\" colspan=\"9\">{}</td></tr>\n",
            escape(remark)
        )
    });
    let Some((score, (against, error))) = experiment.score.as_ref().zip(experiment.comparable_error()) else {
        let gap = "<td class=\"text\" colspan=\"7\">not scored</td>";
        return format!("<tr>{heading}{gap}<td>{paper}</td></tr>\n{remark}");
    };
    let mean = |metres: f64, what: Against| {
        if what == against {
            format!(
                "<td class=\"metric{}\">{}</td>",
                verdict(error.mean_m, published),
                centimetres(metres)
            )
        } else {
            format!("<td>{}</td>", centimetres(metres))
        }
    };
    format!(
        "<tr>{heading}{}<td>{}</td><td>{}</td>{}<td>{}</td><td>{}</td><td>{}</td><td>{paper}</td></tr>\n{remark}",
        mean(score.ee_vs_reference.mean_m, Against::Reference),
        centimetres(score.ee_vs_reference.rms_m),
        centimetres(score.ee_vs_reference.max_m),
        mean(score.ee_vs_prediction.mean_m, Against::Prediction),
        score.target_miss_m.map_or(NOTHING.to_owned(), centimetres),
        score
            .target_velocity_m_s
            .map_or(NOTHING.to_owned(), |[x, z]| format!(
                "{}, {}",
                signed(x),
                signed(z)
            )),
        score.rows_missing,
    )
}

/// Rollout errors, one row per checked flight.
pub fn rollouts(rollouts: &[FlightRollout], palette: &Palette) -> String {
    let mut horizons: Vec<f64> = rollouts
        .iter()
        .flat_map(|r| r.rollout.iter().map(|e| e.horizon_s))
        .collect();
    horizons.sort_by(f64::total_cmp);
    horizons.dedup();
    let head: String = horizons
        .iter()
        .map(|h| format!("<th scope=\"col\">{h} s</th>"))
        .collect();
    let cell = |rollout: &FlightRollout, horizon_s: f64| {
        let Some(error) = rollout.rollout.iter().find(|e| e.horizon_s == horizon_s) else {
            return format!("<td>{NOTHING}</td>");
        };
        let text = |value: Option<f64>| value.map_or(NOTHING.to_owned(), centimetres);
        let diverged = if error.diverged_share > 0.0 {
            format!(
                "<br><span class=\"worse\">{:.1} % diverged</span>",
                100.0 * error.diverged_share
            )
        } else {
            String::new()
        };
        format!(
            "<td>{} / {}{diverged}</td>",
            text(error.median_m),
            text(error.p95_m)
        )
    };
    let rows: String = rollouts
        .iter()
        .map(|rollout| {
            let cells: String = horizons.iter().map(|&h| cell(rollout, h)).collect();
            let color = palette.color(&rollout.label);
            format!(
                "<tr><th scope=\"row\"><span class=\"dot\" style=\"background:{color}\"></span>{}</th>\
                 <td class=\"text\">{}</td>{cells}</tr>\n",
                escape(&rollout.path),
                escape(&rollout.label)
            )
        })
        .collect();
    format!(
        "<div class=\"card scroll\"><table>\n<caption>End-effector rollout error: median / 95th percentile over the \
         windows, centimetres, by horizon.</caption>\n<thead><tr><th scope=\"col\">Flight</th>\
         <th scope=\"col\" class=\"text\">configuration</th>{head}</tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n"
    )
}

/// Diagnostics of the bank's models.
pub fn models(models: &[ModelDiagnostics]) -> String {
    let rows: String = models
        .iter()
        .map(|m| {
            format!(
                "<tr><th scope=\"row\">{}</th><td>{:.2} m</td><td>{:.2} kPa</td><td>{:.4}</td><td>{:.2e}</td></tr>\n",
                escape(&m.label),
                m.configuration.length_m,
                m.configuration.pressure_kpa,
                m.spectral_radius,
                m.condition_number
            )
        })
        .collect();
    format!(
        "<div class=\"card scroll\"><table>\n<caption>Models of the bank. A spectral radius above 1 means that small \
         errors grow from step to step.</caption>\n<thead><tr><th scope=\"col\">Model</th><th scope=\"col\">length</th>\
         <th scope=\"col\">pressure</th><th scope=\"col\">spectral radius at rest</th>\
         <th scope=\"col\">condition number</th></tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n"
    )
}

/// How each plan was found.
pub fn plans(experiments: &[&Experiment]) -> String {
    let rows: String = experiments
        .iter()
        .map(|e| {
            let trust = if e.solver.converged { "" } else { " worse" };
            format!(
                "<tr><th scope=\"row\">{}</th><td class=\"text wrap{trust}\">{}</td><td>{}</td><td>{:.6}</td><td>{:.1e}</td></tr>\n",
                escape(&e.title()),
                escape(&e.solver.status),
                e.solver.iterations,
                e.solver.cost,
                e.solver.max_violation
            )
        })
        .collect();
    format!(
        "<div class=\"card scroll\"><table>\n<thead><tr><th scope=\"col\">Plan</th><th scope=\"col\" class=\"text\">status</th>\
         <th scope=\"col\">iterations</th><th scope=\"col\">cost</th><th scope=\"col\">largest violation</th></tr></thead>\n\
         <tbody>\n{rows}</tbody></table></div>\n"
    )
}

/// What the controllers' estimators had found at the end of each flight; nothing where none reported.
pub fn estimates(experiments: &[&Experiment]) -> String {
    let rows: String = experiments
        .iter()
        .filter_map(|e| Some((e, e.last_step?)))
        .map(|(e, step)| {
            let around = step.surroundings;
            let [x, y] = [0, 1].map(|i| with_deviation(around.wind_m_s[i], around.wind_deviation_m_s[i]));
            format!(
                "<tr><th scope=\"row\">{}</th><td>{x}</td><td>{y}</td><td>{}</td><td>{}</td></tr>\n",
                escape(&e.title()),
                with_deviation(100.0 * around.tip_load, 100.0 * around.tip_load_deviation),
                with_deviation(step.delay_knots, step.delay_deviation_knots),
            )
        })
        .collect();
    if rows.is_empty() {
        return rows;
    }
    format!(
        "<div class=\"card scroll\"><table>\n<caption>What the controller's estimator had found at the end, ± one standard \
         deviation.</caption>\n<thead><tr><th scope=\"col\">Flight</th><th scope=\"col\">steady wind<br>x (m/s)</th>\
         <th scope=\"col\"><br>y (m/s)</th><th scope=\"col\">tip heavier<br>by (%)</th>\
         <th scope=\"col\">commands later than<br>modelled (knots)</th></tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n"
    )
}

/// An estimate; nothing for what was not estimated.
fn with_deviation(value: f64, deviation: f64) -> String {
    if deviation > 0.0 {
        format!("{value:.2} ± {deviation:.2}")
    } else {
        NOTHING.to_owned()
    }
}

/// What hygiene found, folded away when it is long.
pub fn findings(findings: &[Finding]) -> String {
    let items: String = findings
        .iter()
        .map(|f| {
            format!(
                "<li><strong>{}</strong>: {}</li>\n",
                escape(&f.flight),
                escape(&f.what)
            )
        })
        .collect();
    let open = if findings.len() <= 12 { " open" } else { "" };
    let noun = if findings.len() == 1 {
        "finding"
    } else {
        "findings"
    };
    format!(
        "<div class=\"card\"><details{open}><summary>{} {noun}</summary>\n<ul class=\"findings\">\n{items}</ul></details></div>\n",
        findings.len()
    )
}

/// Metres as centimetres with one decimal.
pub fn centimetres(metres: f64) -> String {
    if metres.is_finite() {
        format!("{:.1}", 100.0 * metres)
    } else {
        NOTHING.to_owned()
    }
}

/// A published range, "5–9" or "12".
pub fn published_range(PublishedError { low_m, high_m }: PublishedError) -> String {
    let (low, high) = (100.0 * low_m, 100.0 * high_m);
    if low_m == high_m {
        format!("{low:.0}")
    } else {
        format!("{low:.0}–{high:.0}")
    }
}

fn verdict(mean_m: f64, published: Option<PublishedError>) -> &'static str {
    match published {
        Some(range) if mean_m < range.low_m => " better",
        Some(range) if mean_m > range.high_m => " worse",
        _ => "",
    }
}

fn signed(value: f64) -> String {
    format!("{value:.2}").replace('-', "\u{2212}")
}
