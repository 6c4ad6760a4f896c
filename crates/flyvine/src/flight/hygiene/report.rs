//! What hygiene found, for machines (serde) and as a table (`Display`).

use std::fmt;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::Flight;

/// What a finding is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Body {
    /// The quadrotor's pose.
    Quadrotor,
    /// The end effector's position.
    EndEffector,
    /// The time stamps.
    Clock,
    /// The commanded position.
    Command,
}

/// What was wrong.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Fault {
    /// The recording has no pose here, or one that is not finite.
    Missing,
    /// The pose repeats the one before in every digit although the body was moving; rejected.
    Frozen,
    /// The position is not where its neighbours put it; rejected.
    Jump {
        /// Distance between the first rejected position and the last good one, m.
        size_m: f64,
    },
    /// The attitude is not what its neighbours make it; rejected with the position.
    Turn {
        /// Angle between the first rejected attitude and the last good one, rad.
        angle_rad: f64,
    },
    /// The quaternion had the opposite sign; repaired.
    SignFlip,
    /// The time between the row before and this one is not [`crate::DT`]; nothing looks back across it.
    ClockGap {
        /// The time step, s.
        step_s: f64,
    },
    /// The command left and came back within two rows; the poses of these rows are rejected.
    CommandSpike {
        /// How far it went, m.
        size_m: f64,
    },
}

/// One fault in a span of successive rows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// What it is about.
    pub body: Body,
    /// What was wrong.
    #[serde(flatten)]
    pub fault: Fault,
    /// First row concerned, counted from 0.
    pub first_row: usize,
    /// Last row concerned.
    pub last_row: usize,
    /// Time of the first row, s.
    pub from_s: f64,
    /// Time of the last row, s.
    pub to_s: f64,
}

/// Everything that hygiene found in one flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HygieneReport {
    /// The flight's name.
    pub flight: String,
    /// Rows of the flight.
    pub rows: usize,
    /// Rows that have a state afterwards.
    pub rows_with_state: usize,
    /// The findings in time order.
    pub findings: Vec<Finding>,
}

impl Fault {
    /// What the fault is called in tables.
    pub fn name(&self) -> &'static str {
        match self {
            Fault::Missing => "missing",
            Fault::Frozen => "frozen",
            Fault::Jump { .. } => "jump",
            Fault::Turn { .. } => "turn",
            Fault::SignFlip => "sign flip",
            Fault::ClockGap { .. } => "clock gap",
            Fault::CommandSpike { .. } => "command spike",
        }
    }
}

impl Finding {
    /// How many rows it concerns.
    pub fn num_rows(&self) -> usize {
        self.last_row + 1 - self.first_row
    }
}

impl HygieneReport {
    pub(super) fn new(flight: &Flight) -> Self {
        let (name, rows) = (flight.name.clone(), flight.samples.len());
        HygieneReport {
            flight: name,
            rows,
            rows_with_state: 0,
            findings: Vec::new(),
        }
    }

    /// Whether nothing was found.
    pub fn is_clean(&self) -> bool {
        self.findings.is_empty()
    }

    /// Adds a finding in `rows`, which is not empty.
    pub(super) fn add(&mut self, flight: &Flight, body: Body, fault: Fault, rows: Range<usize>) {
        let (first_row, last_row) = (rows.start, rows.end - 1);
        let (from_s, to_s) = (flight.samples[first_row].t_s, flight.samples[last_row].t_s);
        self.findings.push(Finding {
            body,
            fault,
            first_row,
            last_row,
            from_s,
            to_s,
        });
    }
}

impl fmt::Display for Body {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Body::Quadrotor => "quadrotor",
            Body::EndEffector => "end effector",
            Body::Clock => "clock",
            Body::Command => "command",
        })
    }
}

/// One line per body and kind of fault, with the times of the first few.
impl fmt::Display for HygieneReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const TIMES_SHOWN: usize = 4;
        write!(
            f,
            "{}: {} of {} rows have a state",
            self.flight, self.rows_with_state, self.rows
        )?;
        if self.is_clean() {
            return write!(f, "; nothing found");
        }
        let mut kinds: Vec<(Body, &'static str)> = self
            .findings
            .iter()
            .map(|finding| (finding.body, finding.fault.name()))
            .collect();
        kinds.sort_unstable();
        kinds.dedup();
        for (body, name) in kinds {
            let same: Vec<&Finding> = self
                .findings
                .iter()
                .filter(|finding| (finding.body, finding.fault.name()) == (body, name))
                .collect();
            let rows: usize = same.iter().map(|finding| finding.num_rows()).sum();
            let times: Vec<String> = same
                .iter()
                .take(TIMES_SHOWN)
                .map(|finding| format!("{:.2}", finding.from_s))
                .collect();
            let more = if same.len() > TIMES_SHOWN { ", …" } else { "" };
            let (spans, times) = (same.len(), times.join(", "));
            write!(
                f,
                "\n  {body:<12}  {name:<13}  {spans:>4} × in {rows:>5} rows, at {times}{more} s"
            )?;
        }
        Ok(())
    }
}
