//! Poses that their neighbours contradict.
//!
//! A step from `x_b` to `x_c` is compared with the steps beside it, `x_a → x_b` and `x_c → x_d`. At equal
//! time steps
//!
//! ```text
//! |(x_c − x_b) − ½((x_b − x_a) + (x_d − x_c))| = ½ |third difference|
//! ```
//!
//! so steady speed and steady acceleration, however large, cancel: a violent swing leaves centimetres where a
//! marker that jumps by J leaves J, or 1.5 J where it is back in the next row. A third difference grows with
//! the cube of the time step, and so does the tolerance across missing rows. Implausible steps cut the track
//! into pieces; a piece is rejected where the track goes on plausibly without it.

use std::ops::Range;

use super::Flight;
use crate::DT;
use crate::flight::Sample;

/// A pose that exists.
pub(super) struct Knot<const N: usize> {
    row: usize,
    t_s: f64,
    x: [f64; N],
}

/// Rows to reject.
pub(super) struct Jump {
    pub rows: Range<usize>,
    /// Distance of the first of them from the last good pose (of the last from the next good one at the
    /// start of a track).
    pub size: f64,
}

/// Steps longer than this say nothing about the steps beside them, s.
const LONGEST_NEIGHBOUR_S: f64 = 2.5 * DT;
/// Across longer gaps a jump cannot be told from motion, s.
const LONGEST_BRIDGE_S: f64 = 5.5 * DT;
/// With one step beside it only, a step is compared by the second difference: acceleration does not cancel.
const ONE_SIDED: f64 = 4.0;
/// Faster than this nothing flies in a room, m/s (for a step with no neighbours).
const FASTEST: f64 = 20.0;

/// The existing poses of one body.
pub(super) fn track<const N: usize>(
    flight: &Flight,
    pose: impl Fn(&Sample) -> Option<[f64; N]>,
) -> Vec<Knot<N>> {
    let knot = |(row, sample): (usize, &Sample)| {
        Some(Knot {
            row,
            t_s: sample.t_s,
            x: pose(sample)?,
        })
    };
    flight.samples.iter().enumerate().filter_map(knot).collect()
}

/// Finds the jumps of a track. `align(reference, x)` is the representation of `x` to compare with
/// `reference` (quaternions have two).
pub(super) fn find<const N: usize>(
    mut track: Vec<Knot<N>>,
    tolerance: f64,
    max_excursion_rows: usize,
    align: fn([f64; N], [f64; N]) -> [f64; N],
) -> Vec<Jump> {
    let mut jumps = Vec::new();
    // A large jump hides a small one beside it, so look again without it.
    loop {
        let found = find_largest(&track, tolerance, max_excursion_rows, align);
        if found.is_empty() {
            return jumps;
        }
        track.retain(|knot| !found.iter().any(|jump| jump.rows.contains(&knot.row)));
        jumps.extend(found);
    }
}

/// One pass over the track: the jumps that no larger one beside them hides.
fn find_largest<const N: usize>(
    track: &[Knot<N>],
    tolerance: f64,
    max_excursion_rows: usize,
    align: fn([f64; N], [f64; N]) -> [f64; N],
) -> Vec<Jump> {
    let gate = Gate {
        track,
        tolerance,
        align,
    };
    let cuts = gate.cuts();
    let is_gap = |i: usize| track[i + 1].t_s - track[i].t_s > LONGEST_BRIDGE_S;
    let num_rows = |piece: Range<usize>| track[piece.end - 1].row + 1 - track[piece.start].row;
    let mut jumps = Vec::new();
    // The piece being walked began at `start`; `before` and `good` are the last two good knots.
    let (mut start, mut before, mut good) = (0, None, 0);
    while good + 1 < track.len() {
        let next = good + 1;
        if is_gap(good) {
            (start, before, good) = (next, None, next);
            continue;
        }
        if !cuts[good] {
            (before, good) = (Some(good), next);
            continue;
        }
        // Where does the track go on? Behind one of the next cuts, if it fits and stays.
        let near = |last: &usize| !is_gap(*last) && num_rows(next..last + 1) <= max_excursion_rows;
        let resumes = |last: &usize| {
            let resumed = last + 1;
            let stays = resumed < cuts.len() && !cuts[resumed];
            cuts[*last] && stays && gate.excess(before, good, resumed, Some(resumed + 1)) <= 1.0
        };
        if let Some(last) = (next..cuts.len()).take_while(near).find(resumes) {
            jumps.push(gate.jump(next..last + 1, good));
            (before, good) = (None, last + 1);
            continue;
        }
        // It does not: one of the pieces at this cut is wrong for good.
        let border = (next..cuts.len()).find(|&i| cuts[i] || is_gap(i));
        let end = border.map_or(track.len(), |i| i + 1);
        let ends_in_nothing = border.is_none_or(is_gap);
        let is_short = |piece| num_rows(piece) <= max_excursion_rows;
        if is_short(start..next) && !is_short(next..end) {
            jumps.push(gate.jump(start..next, next));
        } else if is_short(next..end) && ends_in_nothing {
            jumps.push(gate.jump(next..end, good));
        } else {
            jumps.push(gate.jump(next..next + 1, good));
        }
        (start, before, good) = (next, None, next);
    }
    jumps
}

struct Gate<'a, const N: usize> {
    track: &'a [Knot<N>],
    tolerance: f64,
    align: fn([f64; N], [f64; N]) -> [f64; N],
}

impl<const N: usize> Gate<'_, N> {
    /// For each step `i → i + 1` whether the track is cut there. A jump makes the steps beside it look odd by
    /// half as much; what a step has beyond that, and beyond the curvature of real motion, is its own.
    fn cuts(&self) -> Vec<bool> {
        let last = self.track.len().saturating_sub(1);
        let excess: Vec<f64> = (0..last)
            .map(|i| self.excess(i.checked_sub(1), i, i + 1, (i + 2 <= last).then_some(i + 2)))
            .collect();
        let beside = |i: usize| excess[i.saturating_sub(1)].max(excess[(i + 1).min(last - 1)]);
        (0..last)
            .map(|i| excess[i] > 1.0 && excess[i] >= 0.5 * beside(i) + 0.6)
            .collect()
    }

    /// How much the step `b → c` deviates from the steps `a → b` and `c → d`, in units of the tolerance.
    fn excess(&self, a: Option<usize>, b: usize, c: usize, d: Option<usize>) -> f64 {
        let (step, duration) = self.step(b, b, c);
        let near = |(_, duration): &([f64; N], f64)| *duration <= LONGEST_NEIGHBOUR_S;
        let left = a.map(|a| self.step(b, a, b)).filter(near);
        let right = d.map(|d| self.step(b, c, d)).filter(near);
        let deviation =
            |mean: [f64; N]| norm::<N>(std::array::from_fn(|i| step[i] / duration - mean[i])) * duration;
        // Durations in time steps, not less than one so that jittering stamps do not tighten the gate.
        let order = |other: f64| (duration.max(other) / DT).max(1.0);
        match (left, right) {
            (Some((left, dt_left)), Some((right, dt_right))) => {
                let mean = std::array::from_fn(|i| 0.5 * (left[i] / dt_left + right[i] / dt_right));
                deviation(mean) / (self.tolerance * order(dt_left.max(dt_right)).powi(3))
            }
            (Some((beside, dt)), None) | (None, Some((beside, dt))) => {
                let mean = beside.map(|x| x / dt);
                deviation(mean) / (ONE_SIDED * self.tolerance * order(dt).powi(2))
            }
            (None, None) => norm(step) / (FASTEST * duration),
        }
    }

    /// The step from `i` to `j` and how long it took, both aligned with `reference`.
    fn step(&self, reference: usize, i: usize, j: usize) -> ([f64; N], f64) {
        let [reference, from, to] = [reference, i, j].map(|k| self.track[k].x);
        let (from, to) = ((self.align)(reference, from), (self.align)(reference, to));
        (
            std::array::from_fn(|k| to[k] - from[k]),
            self.track[j].t_s - self.track[i].t_s,
        )
    }

    /// The jump that rejects `knots`, seen from the good knot beside them.
    fn jump(&self, knots: Range<usize>, good: usize) -> Jump {
        let nearest = if good < knots.start {
            knots.start
        } else {
            knots.end - 1
        };
        let rows = self.track[knots.start].row..self.track[knots.end - 1].row + 1;
        Jump {
            rows,
            size: norm(self.step(good, good, nearest).0),
        }
    }
}

fn norm<const N: usize>(v: [f64; N]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
