//! `flyvine fit --bootstrap`: the standard errors of physical parameters beside a bootstrap over flights.

use flyvine::flight::Flight;
use flyvine::model::physical::{PARAMETERS, PhysicalModel};
use flyvine::model::{Bank, Family, Model, bootstrap};

use crate::console::{print, progress, table};
use crate::flights::configuration_label;
use crate::outcome::{Blame, Failure, bad_input};

/// Refits `bank` to `draws` draws of its flights and prints, for every parameter, its standard error by the posterior and
/// the ratio of the bootstrap's to it.
pub fn run(bank: &Bank, flights: &[Flight], draws: u32, seed: u64) -> Result<(), Failure> {
    if bank.family() != Family::Physical {
        return bad_input(
            "--bootstrap: found a lag bank, expected a physical one (--family physical), whose parameters mean \
             something each on its own"
                .into(),
        );
    }
    let bar = progress(u64::from(draws), "bootstrap");
    let banks = bootstrap(bank, flights, draws as usize, seed, &mut |number| {
        bar.set_position(number as u64);
    });
    bar.finish_and_clear();
    let banks = banks.or_input()?;
    let mut header = vec!["parameter".to_owned()];
    let mut columns: Vec<Vec<[String; 2]>> = Vec::new();
    for (number, member) in bank.models().iter().enumerate() {
        let Model::Physical(model) = &member.model else {
            continue;
        };
        let drawn: Vec<&PhysicalModel> = banks
            .iter()
            .filter_map(|bank| match &bank.models()[number].model {
                Model::Physical(model) => Some(model.as_ref()),
                Model::Lag(_) => None,
            })
            .collect();
        let label = configuration_label(member.configuration, None);
        header.extend([label, "bootstrap / posterior".to_owned()]);
        columns.push(column(model, &drawn));
    }
    let rows = PARAMETERS.iter().enumerate().map(|(i, info)| {
        let cells = columns.iter().flat_map(|column| column[i].clone());
        std::iter::once(format!("{}, {}", info.name, info.unit))
            .chain(cells)
            .collect()
    });
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    print(&table(&header, rows))?;
    print(&format!(
        "± one standard error by the posterior; the ratio of {draws} draws' standard deviation to it, in the parameter's \
         scale. Far above 1: the flights differ in what the model does not know; 0: a bound or the prior holds it."
    ))
}

/// Value with standard error, and ratio, per parameter.
fn column(model: &PhysicalModel, drawn: &[&PhysicalModel]) -> Vec<[String; 2]> {
    let estimates = model.estimates();
    let posterior = model.standard_deviations();
    (0..PARAMETERS.len())
        .map(|i| {
            let spread = deviation(drawn.iter().map(|model| model.parameters.coordinates()[i]));
            let value = format!("{:.4} ± {:.4}", estimates[i].value, estimates[i].standard_error);
            [value, format!("{:.2}", spread / posterior[i])]
        })
        .collect()
}

/// Standard deviation of a sample of two or more.
fn deviation(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}
