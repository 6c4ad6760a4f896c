//! Commands that leave and come back within two rows: logging glitches, not flown.

use std::ops::Range;

use super::Flight;

/// A short excursion of the command.
pub(super) struct Spike {
    pub rows: Range<usize>,
    /// How far the command went, m.
    pub size: f64,
}

/// Finds commands that are more than `size_m` away from both the row before and the row after an excursion of
/// one or two rows, while these two agree within a tenth of that.
pub(super) fn spikes(flight: &Flight, size_m: f64) -> Vec<Spike> {
    const LONGEST: usize = 2;
    let command = |k: usize| flight.samples[k].command;
    let mut spikes = Vec::new();
    let mut k = 1;
    while k < flight.samples.len() {
        let found = (1..=LONGEST)
            .filter(|length| k + length < flight.samples.len())
            .find_map(|length| {
                let (before, after) = (command(k - 1), command(k + length));
                let nearest = (k..k + length)
                    .map(|row| distance(command(row), before).min(distance(command(row), after)))
                    .fold(f64::INFINITY, f64::min);
                (nearest > size_m && distance(before, after) < 0.1 * nearest).then_some(Spike {
                    rows: k..k + length,
                    size: nearest,
                })
            });
        k = found.as_ref().map_or(k + 1, |spike| spike.rows.end + 1);
        spikes.extend(found);
    }
    spikes
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}
