//! `flyvine mix`: the bank between banks that were fitted along a third variable.

use std::path::PathBuf;

use clap::Args;
use flyvine::model::{Bank, InputFile, bank_between};

use crate::console::say;
use crate::outcome::{Blame, CommandResult, Outcome, bad_input};

/// Make the bank at a payload, or at a value of anything else, between banks that were fitted at others.
///
/// A bank interpolates over length and pressure. What else changes the dynamics and stays what it is during a flight (a
/// payload, a battery, another tip) is scheduled by banks: fit one at each of a few values, and mix the one that is
/// needed. Models are interpolated linearly between the two neighbours; the result is a bank like any other.
///
///   flyvine fit empty/*.csv --out empty.json
///   flyvine fit loaded/*.csv --out loaded.json
///   flyvine mix --along payload_kg 0=empty.json 0.05=loaded.json --at 0.02 --out bank.json
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub struct MixArguments {
    /// Two or more banks, each with the value that it was fitted at.
    #[arg(value_name = "VALUE=BANK.json", num_args = 2.., required = true)]
    banks: Vec<String>,
    /// Name of the variable, with its unit: it is kept in the bank.
    #[arg(long, value_name = "NAME")]
    along: String,
    /// Value to make the bank for, within those fitted.
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    at: f64,
    /// Where to write the bank.
    #[arg(long, value_name = "BANK.json")]
    out: PathBuf,
}

/// Runs `flyvine mix`.
pub fn run(arguments: &MixArguments) -> CommandResult {
    let mut banks = Vec::with_capacity(arguments.banks.len());
    let mut inputs = Vec::with_capacity(arguments.banks.len());
    for argument in &arguments.banks {
        let parts = argument.split_once('=');
        let Some((value, path)) = parts.and_then(|(value, path)| Some((value.parse().ok()?, path))) else {
            return bad_input(format!(
                "{argument}: expected VALUE=BANK.json, as in 0.05=loaded.json"
            ));
        };
        let path = PathBuf::from(path);
        inputs.push(InputFile::of(&path).or_input()?);
        banks.push((value, Bank::read(&path).or_input()?));
    }
    let bank = bank_between(&arguments.along, &banks, arguments.at).or_input()?;
    let recordings = bank.provenance().inputs.clone();
    let bank = bank.with_inputs([inputs, recordings].concat());
    bank.write(&arguments.out).or_input()?;
    say(&format!("wrote {}", arguments.out.display()));
    Ok(Outcome::Done)
}
