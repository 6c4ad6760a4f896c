//! Flights of plans are sent positions only: a bank whose flights were sent velocities, too, is planned without its feed-forward.

mod common;

use flyvine::model::physical::{ArmLength, Parameters, PhysicalModel};
use flyvine::model::{Bank, BankModel, Model};
use flyvine::task::{PlanOptions, make_plan};

/// The bank of the prior, with this feed-forward.
fn bank(velocity_feedforward: f64) -> Bank {
    let prior = common::prior_bank();
    let with_feedforward = |model: &BankModel| {
        let parameters = Parameters {
            velocity_feedforward,
            ..Parameters::defaults()
        };
        let arm = ArmLength::constant(model.configuration.length_m);
        BankModel {
            model: Model::Physical(Box::new(PhysicalModel::new(parameters, arm).unwrap())),
            ..model.clone()
        }
    };
    let models = prior.models().iter().map(with_feedforward).collect();
    Bank::new(models, prior.provenance().clone()).unwrap()
}

#[test]
fn plans_assume_no_velocity_that_is_not_sent() {
    let task = common::task("lemniscate_5s_ES.toml");
    let planned = |bank: &Bank| make_plan(&task, bank, &PlanOptions::default()).unwrap();
    let (with, without) = (planned(&bank(0.8)), planned(&bank(0.0)));
    assert_eq!(with.commands, without.commands);
    assert_eq!(with.bank.models(), without.bank.models());
}
