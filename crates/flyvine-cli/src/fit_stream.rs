//! `flyvine fit --stream`, `--shard` and `--merge`: fits of more flights than memory holds.

use std::path::{Path, PathBuf};

use flyvine::Shard;
use flyvine::flight::Flight;
use flyvine::model::streaming::{PartialFit, Reduction, StreamReport};
use flyvine::model::{Bank, FitOptions, InputFile, ModelError};
use rayon::prelude::*;

use crate::console::{print, print_json, progress, say, table};
use crate::fit::write_bank;
use crate::flights::{configuration_label, load_flight};
use crate::outcome::{Blame, CommandResult, Failure, Outcome, bad_input};

/// Fits `paths` in one pass over them, and in a second one by orthogonal factors where the first did not determine
/// the coefficients.
pub fn stream(
    paths: &[PathBuf],
    options: &FitOptions,
    reduction: Reduction,
    out: &Path,
    json: bool,
) -> CommandResult {
    let reduce = |reduction| reduce(paths, options, reduction, Shard::WHOLE)?.bank().or_input();
    let (bank, report) = match reduce(reduction) {
        Err(Failure::Input(error)) if is_ill_conditioned(&error) && reduction == Reduction::Moments => {
            say(&format!("note: {error}; reading the flights again for it"));
            reduce(Reduction::Orthogonal)?
        }
        done => done?,
    };
    finish(&bank, &report, out, json)
}

/// Reduces one shard of `paths` to a partial fit.
pub fn shard(
    paths: &[PathBuf],
    options: &FitOptions,
    reduction: Reduction,
    shard: Shard,
    out: &Path,
) -> CommandResult {
    reduce(paths, options, reduction, shard)?
        .write(out)
        .or_internal()?;
    say(&format!("wrote {}", out.display()));
    Ok(Outcome::Done)
}

/// Joins partial fits, given in any order.
pub fn merge(paths: &[PathBuf], out: &Path, json: bool) -> CommandResult {
    // Whole partial fits are many times a bank: no more than two are in memory.
    let mut order = Vec::with_capacity(paths.len());
    for path in paths {
        order.push((PartialFit::read(path).or_input()?.range().start, path));
    }
    order.sort();
    let mut merged: Option<PartialFit> = None;
    for (_, path) in order {
        let part = PartialFit::read(path).or_input()?;
        match &mut merged {
            None => merged = Some(part),
            Some(merged) => match merged.append(part) {
                Ok(()) => {}
                Err(error) => return bad_input(format!("{}: {error}", path.display())),
            },
        }
    }
    let Some(merged) = merged else {
        return bad_input("found no partial fit, expected at least one".into());
    };
    match merged.bank() {
        Err(error @ ModelError::IllConditioned { .. }) => {
            bad_input(format!("{error}: make the shards with --orthogonal"))
        }
        done => {
            let (bank, report) = done.or_input()?;
            finish(&bank, &report, out, json)
        }
    }
}

fn is_ill_conditioned(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(ModelError::IllConditioned { .. }))
}

/// Reads the shard's flights, as many at once as there are threads, and reduces them.
fn reduce(
    paths: &[PathBuf],
    options: &FitOptions,
    reduction: Reduction,
    shard: Shard,
) -> Result<PartialFit, Failure> {
    let mut part = PartialFit::new(options, reduction, paths.len(), shard).or_input()?;
    let own = &paths[shard.range(paths.len())];
    let bar = progress(own.len() as u64, "reading");
    for group in own.chunks(rayon::current_num_threads()) {
        let read = |path: &PathBuf| -> Result<(Flight, InputFile), Failure> {
            Ok((load_flight(path)?.0, InputFile::of(path).or_input()?))
        };
        let flights = group.par_iter().map(read).collect::<Result<Vec<_>, Failure>>()?;
        part.add(&flights).or_input()?;
        bar.inc(group.len() as u64);
    }
    bar.finish_and_clear();
    Ok(part)
}

/// Writes the bank and says what the fit found.
fn finish(bank: &Bank, report: &StreamReport, out: &Path, json: bool) -> CommandResult {
    write_bank(bank, out)?;
    if json {
        print_json(report)?;
    } else {
        print(&report_table(report))?;
        if !report.unused.is_empty() {
            print(&format!(
                "{} flights at interior or changing configurations were not fitted: let `flyvine check` judge by them.",
                report.unused.len()
            ))?;
        }
    }
    say(
        "note: nothing was held out: let `flyvine check` judge the bank on other flights before planning on it",
    );
    Ok(Outcome::Done)
}

fn report_table(report: &StreamReport) -> String {
    let header = [
        "configuration",
        "flights",
        "rows",
        "condition number",
        "height residual, mm",
        "rounding adds at most",
        "spectral radius",
    ];
    let rows = report.corners.iter().map(|corner| {
        vec![
            configuration_label(corner.configuration, None),
            corner.flights.to_string(),
            corner.rows.to_string(),
            format!("{:.2e}", corner.condition_number),
            format!("{:.4}", 1e3 * corner.height_residual_m),
            format!("{:.0e}", corner.excess),
            format!("{:.4}", corner.spectral_radius),
        ]
    });
    table(&header, rows)
}
