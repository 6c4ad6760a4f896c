//! What a sweep says: shares of success, distributions of errors, and the flights to look at first.

use std::collections::BTreeMap;

use flyvine::report::{ErrorDistribution, Figure, SuccessMap, error_distributions, success_map};
use serde::Serialize;

use super::row::RowResult;
use super::{Sweep, row::RowStatus};

/// Worst flights that a summary names.
const WORST: usize = 10;

/// What a sweep says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The sweep's name.
    pub name: String,
    /// Number of flights.
    pub flights: usize,
    /// One per task and control law, in the sweep's order.
    pub groups: Vec<Group>,
    /// The flights with the largest errors, the worst first; those that did not end well come before all others.
    pub worst: Vec<WorstRow>,
    /// Success maps over two parameters of the grid, and the distribution of errors.
    #[serde(skip)]
    pub figures: Vec<Figure>,
}

/// The flights of one task under one control law.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Group {
    /// The task.
    pub task: String,
    /// The control law.
    pub controller: String,
    /// Number of flights.
    pub flights: usize,
    /// Flights that succeeded.
    pub successes: usize,
    /// Flights that were aborted.
    pub aborted: usize,
    /// Rows in which nothing was flown.
    pub refused: usize,
    /// Median over all flights of [`RowResult::error_m`]; `None` if it is that of a flight that did not end well.
    pub median_error_m: Option<f64>,
    /// 95th percentile, m; likewise.
    pub p95_error_m: Option<f64>,
}

/// A flight to look at.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstRow {
    /// Position in the sweep, from 0.
    pub index: usize,
    /// Its key.
    pub key: String,
    /// The task.
    pub task: String,
    /// The control law.
    pub controller: String,
    /// The seed.
    pub seed: u64,
    /// The varied parameters.
    pub parameters: BTreeMap<String, f64>,
    /// How it ended.
    pub status: RowStatus,
    /// Why it did not end well.
    pub cause: String,
    /// [`RowResult::error_m`], where it was flown to the end.
    pub error_m: Option<f64>,
}

/// Summarizes `rows` (each row's key and result, in the sweep's order).
pub fn summarize(sweep: &Sweep, rows: &[(String, RowResult)]) -> Summary {
    let groups = grouped(sweep, rows);
    Summary {
        name: sweep.name().to_owned(),
        flights: rows.len(),
        worst: worst(sweep, rows),
        figures: figures(sweep, rows, &groups),
        groups: groups
            .into_iter()
            .map(|((task, controller), indices)| group(sweep, rows, task, controller, &indices))
            .collect(),
    }
}

type Groups = Vec<((String, String), Vec<usize>)>;

/// Indices of the rows of every task and control law, in the sweep's order.
fn grouped(sweep: &Sweep, rows: &[(String, RowResult)]) -> Groups {
    let mut groups: Groups = Vec::new();
    for index in 0..rows.len() {
        let row = sweep.row(index);
        let name = (row.plan.task.name.clone(), row.law.name().to_owned());
        match groups.iter_mut().find(|(other, _)| *other == name) {
            Some((_, indices)) => indices.push(index),
            None => groups.push((name, vec![index])),
        }
    }
    groups
}

fn group(
    sweep: &Sweep,
    rows: &[(String, RowResult)],
    task: String,
    controller: String,
    indices: &[usize],
) -> Group {
    let results = || indices.iter().map(|&index| &rows[index].1);
    let count = |status| results().filter(|result| result.status == status).count();
    let errors = sorted_errors(rows, indices);
    // The smallest error that this share of the flights does not exceed.
    let quantile = |share: f64| {
        let place = ((share * errors.len() as f64).ceil() as usize).clamp(1, errors.len());
        Some(errors[place - 1]).filter(|error| error.is_finite())
    };
    Group {
        flights: indices.len(),
        successes: results()
            .filter(|result| result.succeeded(sweep.success()))
            .count(),
        aborted: count(RowStatus::Aborted),
        refused: count(RowStatus::Refused),
        median_error_m: quantile(0.5),
        p95_error_m: quantile(0.95),
        task,
        controller,
    }
}

fn sorted_errors(rows: &[(String, RowResult)], indices: &[usize]) -> Vec<f64> {
    let mut errors: Vec<f64> = indices.iter().map(|&index| rows[index].1.error_m()).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

fn worst(sweep: &Sweep, rows: &[(String, RowResult)]) -> Vec<WorstRow> {
    let mut indices: Vec<usize> = (0..rows.len()).collect();
    // Stable: among equals, the sweep's order.
    indices.sort_by(|a, b| rows[*b].1.error_m().total_cmp(&rows[*a].1.error_m()));
    indices.truncate(WORST);
    let describe = |index: usize| {
        let (key, result) = &rows[index];
        let row = sweep.row(index);
        let names = sweep.parameters().into_iter().map(str::to_owned);
        WorstRow {
            index,
            key: key.clone(),
            task: row.plan.task.name.clone(),
            controller: row.law.name().to_owned(),
            seed: row.seed,
            parameters: names.zip(row.values).collect(),
            status: result.status,
            cause: result.cause.clone(),
            error_m: Some(result.error_m()).filter(|error| error.is_finite()),
        }
    };
    indices.into_iter().map(describe).collect()
}

fn figures(sweep: &Sweep, rows: &[(String, RowResult)], groups: &Groups) -> Vec<Figure> {
    let distributions: Vec<ErrorDistribution> = groups
        .iter()
        .map(|((task, controller), indices)| ErrorDistribution {
            label: format!("{task}, {controller}"),
            errors_m: sorted_errors(rows, indices),
        })
        .collect();
    let mut figures = vec![error_distributions("errors", &distributions)];
    let axes: Vec<(usize, &String, &Vec<f64>)> = sweep
        .grid()
        .iter()
        .enumerate()
        .map(|(place, (path, values))| (place, path, values))
        .filter(|(_, _, values)| values.len() > 1)
        .collect();
    // The last of the grid's parameters across, as it varies fastest; every pair of them has a map.
    for (later, across) in axes.iter().enumerate() {
        for upwards in &axes[..later] {
            for (number, ((task, controller), indices)) in groups.iter().enumerate() {
                let map = map(
                    sweep,
                    rows,
                    indices,
                    *across,
                    *upwards,
                    format!("{task}, {controller}"),
                );
                let name = format!("success_{}_{}_{}", number + 1, upwards.0 + 1, across.0 + 1);
                figures.push(success_map(&name, &map));
            }
        }
    }
    figures
}

fn map(
    sweep: &Sweep,
    rows: &[(String, RowResult)],
    indices: &[usize],
    across: (usize, &String, &Vec<f64>),
    upwards: (usize, &String, &Vec<f64>),
    title: String,
) -> SuccessMap {
    let ascending = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted.dedup();
        sorted
    };
    let (across_values, upwards_values) = (ascending(across.2), ascending(upwards.2));
    let mut counts = vec![vec![(0, 0); across_values.len()]; upwards_values.len()];
    for &index in indices {
        let values = sweep.row(index).values;
        let place = |sorted: &[f64], value: f64| sorted.iter().position(|other| *other == value);
        let cell = place(&upwards_values, values[upwards.0]).zip(place(&across_values, values[across.0]));
        if let Some((i, j)) = cell {
            let (successes, flights) = &mut counts[i][j];
            *successes += usize::from(rows[index].1.succeeded(sweep.success()));
            *flights += 1;
        }
    }
    let share = |(successes, flights): (usize, usize)| {
        (flights > 0).then(|| (successes as f64 / flights as f64, flights))
    };
    SuccessMap {
        title,
        across: across.1.clone(),
        upwards: upwards.1.clone(),
        cells: counts
            .into_iter()
            .map(|row| row.into_iter().map(share).collect())
            .collect(),
        across_values,
        upwards_values,
    }
}
