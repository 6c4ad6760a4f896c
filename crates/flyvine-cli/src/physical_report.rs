//! The parameters of the physical family as a table.

use flyvine::model::physical::ParameterEstimate;
use flyvine::model::{CornerFit, PhysicalFitReport};

use crate::console::table;
use crate::flights::configuration_label;

/// What the user should know about the flights' clocks and the parameters' bounds.
pub fn warnings(report: &PhysicalFitReport) -> Vec<String> {
    let mut warnings = Vec::new();
    for corner in &report.corners {
        let here = configuration_label(corner.configuration, None);
        if corner.timing.streams_apart() {
            warnings.push(format!(
                "{here}: the end effector's poses are {:.0} ms behind the quadrotor's in all flights alike",
                1e3 * corner.timing.end_effector_behind_quadrotor_s
            ));
        }
        for timing in corner.timing.flights.iter().filter(|timing| timing.notable()) {
            warnings.push(format!(
                "{here}: the streams of a flight are not in time with the others: {timing}"
            ));
        }
        for estimate in corner.parameters.iter().filter(|estimate| estimate.at_bound) {
            warnings.push(format!(
                "{here}: {} is at a bound ({} {}): the vehicle has what the model has not, or the flights do not \
                 determine it",
                estimate.name, estimate.value, estimate.unit
            ));
        }
    }
    warnings
}

/// The parameters with their standard errors, and what is to be said about them.
pub fn tables(report: &PhysicalFitReport) -> String {
    let corners = &report.corners;
    let label = |corner: &CornerFit| configuration_label(corner.configuration, None);
    let Some(first) = corners.first() else {
        return String::new();
    };
    // What all corners share stands once.
    let shared = |i: usize| {
        corners.len() > 1
            && corners
                .iter()
                .all(|corner| corner.parameters[i].value == first.parameters[i].value)
    };
    let mut header = vec!["parameter".to_owned(), "unit".to_owned(), "bounds".to_owned()];
    header.extend(corners.iter().map(label));
    let rows = (0..first.parameters.len()).map(|i| {
        let estimate = &first.parameters[i];
        let mut row = vec![
            estimate.name.to_owned(),
            estimate.unit.to_owned(),
            format!("{} … {}", estimate.lower, estimate.upper),
        ];
        if shared(i) {
            row.push(value(estimate));
            row.extend(corners[1..].iter().map(|_| "″".to_owned()));
        } else {
            row.extend(corners.iter().map(|corner| value(&corner.parameters[i])));
        }
        row
    });
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut text = table(&header, rows);
    text += "\n± one standard error; kg counts quadrotor masses; ! at a bound; (…) not identified: the flights say \
             little more than the prior, so such a parameter does not matter to flights like these";
    for corner in corners {
        text += &format!(
            "\n{}: {} flights, {} rows simulated whole, tip {:.2} cm off on average{}",
            label(corner),
            corner.flights.len(),
            corner.rows,
            100.0 * corner.tip_error_m,
            if corner.converged {
                ""
            } else {
                " (stopped while still improving a little)"
            }
        );
        let support = corner.support;
        text += &format!(
            "; the flights support tilts to {:.0}°, {:.1} m/s, arm angles to {:.0}°, tip speeds to {:.1} m/s, commands \
             {:.1} m ahead (99 % of rows)",
            support.tilt.to_degrees(),
            support.speed_m_s,
            support.arm_angle.to_degrees(),
            support.tip_speed_m_s,
            support.command_lead_m
        );
    }
    if let Some(trial) = &report.correction {
        text += &format!(
            "\ncorrection: on held-out flights the tip is {:.2} cm off with it, {:.2} without: {}",
            100.0 * trial.corrected.mean_m(),
            100.0 * trial.plain.mean_m(),
            if trial.worthwhile() {
                "kept"
            } else {
                "not worth keeping"
            }
        );
    }
    text
}

/// `0.953 ± 0.004`, marked at a bound, in brackets if not identified.
fn value(estimate: &ParameterEstimate) -> String {
    let digits = (2 - estimate.standard_error.log10().floor() as i32).clamp(0, 5) as usize;
    let digits = digits.saturating_sub(1);
    let text = format!(
        "{:.digits$} ± {:.digits$}",
        estimate.value, estimate.standard_error
    );
    match (estimate.at_bound, estimate.identified) {
        (true, _) => format!("! {text}"),
        (false, true) => text,
        (false, false) => format!("({text})"),
    }
}
