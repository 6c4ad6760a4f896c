//! `flyvine fit` with the physical family: progress in words, and the table of parameters.

use flyvine::flight::{Configuration, Flight};
use flyvine::model::physical::{FitProgress, FitStage, ParameterEstimate, PhysicalFitOptions};
use flyvine::model::{Bank, CornerFit, PhysicalFitReport, fit_physical_bank};

use crate::console::{progress, say, table};
use crate::flights::configuration_label;
use crate::outcome::{Blame, Failure};

/// Fits the physical family, saying what it does.
pub fn fit(flights: &[Flight]) -> Result<(Bank, PhysicalFitReport), Failure> {
    say(
        "physical family: every flight is simulated from its first row; the parameters of quadrotor, autopilot \
         and arm are those whose simulations stay closest to the recordings",
    );
    let bar = progress(0, "simulating");
    let mut last: Option<(Option<Configuration>, FitProgress)> = None;
    let fitted = fit_physical_bank(
        flights,
        &PhysicalFitOptions::default(),
        &mut |configuration, at| {
            if let Some((before, ended)) = last
                && (before, ended.stage) != (configuration, at.stage)
            {
                bar.suspend(|| say(&describe(before, ended)));
            }
            bar.set_message(describe(configuration, at));
            last = Some((configuration, at));
        },
    );
    bar.finish_and_clear();
    if let Some((configuration, at)) = last {
        say(&describe(configuration, at));
    }
    fitted.or_input()
}

/// Where a fit is, as a sentence.
fn describe(configuration: Option<Configuration>, at: FitProgress) -> String {
    let who = configuration.map_or("all corners".to_owned(), |configuration| {
        configuration_label(configuration, None)
    });
    let what = match at.stage {
        FitStage::FirstSeconds { start } => {
            format!("first 10 s of every flight, from start {}", start + 1)
        }
        FitStage::WholeFlights => "whole flights".to_owned(),
        FitStage::SharedVehicle => "whole flights, one vehicle with several arms".to_owned(),
    };
    format!(
        "{who}: {what}: tip {:.2} cm off on average after {} iterations",
        100.0 * at.tip_error_m,
        at.iteration
    )
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
