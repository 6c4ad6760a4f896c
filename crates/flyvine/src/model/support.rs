//! The region that flights support: how far they tilted, how fast they flew, how far the arm leaned.

use super::rollout::quantile;
use crate::DT;
use crate::flight::Flight;
use serde::{Deserialize, Serialize};

/// Share of the rows that lie within the region.
const SHARE: f64 = 0.99;

/// What 99 % of the rows of some flights stayed below: a plan that asks for much more is a guess, whatever the
/// model's error on such flights. Zero where nothing was seen.
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

impl Support {
    /// The region that `flights` support.
    pub fn of(flights: &[Flight]) -> Self {
        let (mut tilt, mut speed, mut angle, mut tip_speed, mut lead) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for flight in flights {
            for segment in flight.segments() {
                let states: Vec<_> = segment
                    .clone()
                    .map(|row| flight.samples[row].state().unwrap_or_default())
                    .collect();
                for (row, x) in segment.zip(&states) {
                    // The up-axis' height is 1 − 2 (q_x² + q_y²).
                    tilt.push((1.0 - 2.0 * (x[3] * x[3] + x[4] * x[4])).clamp(-1.0, 1.0).acos());
                    angle.push((x[6] - x[0]).hypot(x[7] - x[1]).atan2(x[2] - x[8]));
                    lead.push(distance(&flight.samples[row].command, &x[..3]));
                }
                for pair in states.windows(2) {
                    speed.push(distance(&pair[1][..3], &pair[0][..3]) / DT);
                    tip_speed.push(distance(&pair[1][6..], &pair[0][6..]) / DT);
                }
            }
        }
        let [tilt, speed_m_s, arm_angle, tip_speed_m_s, command_lead_m] =
            [tilt, speed, angle, tip_speed, lead].map(|mut values| {
                values.sort_by(f64::total_cmp);
                quantile(&values, SHARE).unwrap_or(0.0)
            });
        Support {
            tilt,
            speed_m_s,
            arm_angle,
            tip_speed_m_s,
            command_lead_m,
        }
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
}
