//! The region that flights support: how far they tilted, how fast they flew, how far the arm leaned.

use crate::DT;
use crate::flight::Flight;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Share of the rows that lie within the region.
const SHARE: f64 = 0.99;

/// What 99 % of the rows of some flights stayed within, rounded up to thousandths: a plan that asks for much more is a
/// guess, whatever the model's error on such flights. Zero where nothing was seen.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Tilt of the quadrotor, rad.
    pub tilt: f64,
    /// Speed of the quadrotor, m/s.
    pub speed_m_s: f64,
    /// Angle of the arm from below the quadrotor, rad.
    pub arm_angle: f64,
    /// Speed of the end effector, m/s.
    pub tip_speed_m_s: f64,
    /// Distance of the command from the quadrotor, m.
    pub command_lead_m: f64,
}

/// Steps in which quantities are counted: of an angle 1 mrad, of a distance 1 mm, of a speed 1 mm/s.
const STEP: f64 = 1e-3;
/// Anything from here on is counted as this: no flight comes near.
const LARGEST: f64 = 100.0;

/// How often the flights so far showed which value of each quantity, in steps: counts, so that flights may be taken in
/// any order and in parts, in memory that does not depend on their number.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SupportCounts {
    tilt: Counts,
    speed: Counts,
    arm_angle: Counts,
    tip_speed: Counts,
    command_lead: Counts,
}

/// Rows by value, in whole steps.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Counts(BTreeMap<u32, u64>);

impl Counts {
    fn add(&mut self, value: f64) {
        let steps = (value.min(LARGEST) / STEP).ceil() as u32;
        *self.0.entry(steps).or_default() += 1;
    }

    fn append(&mut self, other: &Self) {
        for (&steps, &rows) in &other.0 {
            *self.0.entry(steps).or_default() += rows;
        }
    }

    /// The least whole step that [`SHARE`] of the rows stayed within; zero without rows.
    fn limit(&self) -> f64 {
        let all: u64 = self.0.values().sum();
        let (mut within, enough) = (0, SHARE * all as f64);
        let reached = self.0.iter().find(|&(_, &rows)| {
            within += rows;
            within as f64 >= enough
        });
        reached.map_or(0.0, |(&steps, _)| f64::from(steps) * STEP)
    }
}

impl SupportCounts {
    /// Takes a flight in.
    pub fn add(&mut self, flight: &Flight) {
        for segment in flight.segments() {
            let states: Vec<_> = segment
                .clone()
                .map(|row| flight.samples[row].state().unwrap_or_default())
                .collect();
            for (row, x) in segment.zip(&states) {
                self.tilt.add(tilt(x));
                self.arm_angle.add(arm_angle(x));
                self.command_lead
                    .add(distance(&flight.samples[row].command, &x[..3]));
            }
            for pair in states.windows(2) {
                self.speed.add(distance(&pair[1][..3], &pair[0][..3]) / DT);
                self.tip_speed.add(distance(&pair[1][6..], &pair[0][6..]) / DT);
            }
        }
    }

    /// Takes in what other flights showed.
    pub fn append(&mut self, other: &Self) {
        self.tilt.append(&other.tilt);
        self.speed.append(&other.speed);
        self.arm_angle.append(&other.arm_angle);
        self.tip_speed.append(&other.tip_speed);
        self.command_lead.append(&other.command_lead);
    }

    /// The region.
    pub fn support(&self) -> Support {
        Support {
            tilt: self.tilt.limit(),
            speed_m_s: self.speed.limit(),
            arm_angle: self.arm_angle.limit(),
            tip_speed_m_s: self.tip_speed.limit(),
            command_lead_m: self.command_lead.limit(),
        }
    }
}

/// The quadrotor's tilt, rad, in the state `x`: its up-axis' height is 1 − 2 (q_x² + q_y²).
pub(super) fn tilt(x: &[f64]) -> f64 {
    let up = 1.0 - 2.0 * (x[3] * x[3] + x[4] * x[4]);
    up.clamp(-1.0, 1.0).acos()
}

/// The arm's angle from below the quadrotor, rad, in the state `x`.
pub(super) fn arm_angle(x: &[f64]) -> f64 {
    (x[6] - x[0]).hypot(x[7] - x[1]).atan2(x[2] - x[8])
}

impl Support {
    /// The region that `flights` support.
    pub fn of(flights: &[Flight]) -> Self {
        let mut counts = SupportCounts::default();
        for flight in flights {
            counts.add(flight);
        }
        counts.support()
    }

    /// The first limit that is no limit: its name and value.
    pub(super) fn invalid(&self) -> Option<(&'static str, f64)> {
        [
            ("tilt", self.tilt),
            ("speed_m_s", self.speed_m_s),
            ("arm_angle", self.arm_angle),
            ("tip_speed_m_s", self.tip_speed_m_s),
            ("command_lead_m", self.command_lead_m),
        ]
        .into_iter()
        .find(|(_, limit)| !(limit.is_finite() && *limit >= 0.0))
    }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::physical::Parameters;
    use super::super::physical::synthetic::{random_commands, simulate_flight};
    use super::*;

    #[test]
    fn a_livelier_flight_supports_more() {
        let commands = random_commands(200, 4);
        let flight = |scale: f64| {
            let commands: Vec<[f64; 3]> = commands
                .iter()
                .map(|u| [scale * u[0], scale * u[1], u[2]])
                .collect();
            simulate_flight("flight", &Parameters::defaults(), 0.8, &commands, 0.0, 1).0
        };
        let (calm, lively) = (Support::of(&[flight(0.3)]), Support::of(&[flight(1.0)]));
        assert!(lively.tilt > calm.tilt && lively.arm_angle > calm.arm_angle);
        assert!(lively.speed_m_s > calm.speed_m_s && lively.tip_speed_m_s > calm.tip_speed_m_s);
        assert!(calm.command_lead_m > 0.1 && lively.tilt < std::f64::consts::FRAC_PI_2);
        assert_eq!(Support::of(&[]), Support::default());
    }

    #[test]
    fn a_limit_is_the_quantile_and_parts_may_be_joined_in_any_order() {
        let mut counts = [Counts::default(), Counts::default()];
        for i in 1..=200 {
            counts[i % 2].add(0.01 * i as f64 - 1e-5);
        }
        let [mut one, two] = counts;
        let mut other = two.clone();
        other.append(&one);
        one.append(&two);
        assert_eq!(one, other);
        // 99 % of 200 values: the 198th.
        assert!((one.limit() - 1.98).abs() < 1e-9, "{}", one.limit());
        one.add(f64::INFINITY);
        assert!(one.limit() < LARGEST);
    }
}
