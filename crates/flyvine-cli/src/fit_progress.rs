//! What a fit is doing, in words.

use flyvine::control::estimator::{NoiseError, NoiseReport, identify_noise};
use flyvine::flight::{Configuration, Flight};
use flyvine::model::physical::{FitProgress, FitStage};
use flyvine::model::{
    Bank, FamiliesReport, Family, FamilyOptions, FamilyProgress, FamilyTrial, fit_families,
};
use indicatif::ProgressBar;

use crate::console::{centimetres, progress, say};
use crate::flights::configuration_label;
use crate::outcome::{Blame, Failure};

/// [`fit_families`], telling on stderr what it does and why.
pub fn fit(flights: &[Flight], options: &FamilyOptions) -> Result<(Bank, FamiliesReport), Failure> {
    let mut narrator = Narrator {
        bar: progress(0, "fitting"),
        simulating: None,
    };
    let fitted = fit_families(flights, options, &mut |at| narrator.tell(at));
    narrator.end_stage();
    narrator.bar.finish_and_clear();
    fitted.or_input()
}

/// The noise levels of estimators on `bank`; `None` if no flight stays at one of its configurations, or the bank's
/// commands are not positions alone, which is said.
pub fn identify(bank: &Bank, flights: &[Flight]) -> Result<Option<NoiseReport>, Failure> {
    let bar = progress(0, "finding noise levels");
    let found = identify_noise(bank, flights, &mut |configuration| {
        bar.set_message(format!(
            "finding noise levels at {}",
            configuration_label(configuration, None)
        ));
    });
    bar.finish_and_clear();
    match found {
        Err(error @ (NoiseError::TooShort { .. } | NoiseError::Estimator(_))) => {
            say(&format!(
                "note: estimators take the family's typical noise levels: {error}"
            ));
            Ok(None)
        }
        other => other.map(Some).or_internal(),
    }
}

struct Narrator {
    bar: ProgressBar,
    /// The last report of a simulation.
    simulating: Option<(Option<Configuration>, FitProgress)>,
}

impl Narrator {
    fn tell(&mut self, at: FamilyProgress) {
        match at {
            FamilyProgress::Physical(configuration, at) => {
                if self
                    .simulating
                    .is_some_and(|(before, ended)| (before, ended.stage) != (configuration, at.stage))
                {
                    self.end_stage();
                }
                self.simulating = Some((configuration, at));
                self.bar.set_message(simulation(configuration, at));
            }
            FamilyProgress::Trying(Family::Lag) => {
                self.say("lag family, without the held-out flights: least squares, ridge by cross-validated rollouts");
            }
            FamilyProgress::Trying(Family::Physical) => self.say(
                "physical family, without the held-out flights: every flight is simulated from its first row; the \
                 parameters of quadrotor, autopilot and arm are those whose simulations stay closest",
            ),
            FamilyProgress::Tried(trial) => {
                self.end_stage();
                self.say(&tried(trial));
            }
            FamilyProgress::Chosen(family) => {
                self.say(&format!("{family} family, on all flights"));
            }
            FamilyProgress::Band(family) => {
                self.end_stage();
                self.say(&format!(
                    "{family} family, without another third of the flights, for the band of confidence"
                ));
            }
        }
    }

    /// The last line of a stage of simulations stays.
    fn end_stage(&mut self) {
        if let Some((configuration, at)) = self.simulating.take() {
            self.say(&format!("  {}", simulation(configuration, at)));
        }
    }

    fn say(&self, line: &str) {
        self.bar.suspend(|| say(line));
    }
}

/// Where a simulation-error fit is.
fn simulation(configuration: Option<Configuration>, at: FitProgress) -> String {
    let who = configuration.map_or("all corners".to_owned(), |configuration| {
        configuration_label(configuration, None)
    });
    let what = match at.stage {
        FitStage::FirstSeconds { start: 0 } => "first 10 s of every flight".to_owned(),
        FitStage::FirstSeconds { start } => {
            format!("first 10 s of every flight, once more from start {}", start + 1)
        }
        FitStage::WholeFlights => "whole flights".to_owned(),
        FitStage::AllConfigurations => "whole flights, drawn towards one vehicle".to_owned(),
    };
    format!(
        "{who}: {what}: tip {:.2} cm off on average after {} iterations",
        100.0 * at.tip_error_m,
        at.iteration
    )
}

/// How a family did.
fn tried(trial: &FamilyTrial) -> String {
    let family = trial.family;
    match (&trial.failure, trial.score_m()) {
        (Some(failure), _) => format!("{family} family: cannot be used here: {failure}"),
        (None, None) => format!("{family} family: no held-out stretch is long enough to judge it"),
        (None, Some(score)) => format!(
            "{family} family: {} cm off in held-out rollouts of 2.5 and 10 s",
            centimetres(score)
        ),
    }
}
