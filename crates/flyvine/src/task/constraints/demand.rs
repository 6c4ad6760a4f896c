//! What a task file says of the whole motion.

use serde::{Deserialize, Serialize};

use super::obstacle::{Obstacle, Shape};
use crate::task::{Task, TaskError};

/// The end effector stays near a line for a while: the direction from which it approaches, or a pipe that it enters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tube {
    /// A point of the line, m.
    pub point_m: [f64; 3],
    /// The line's direction, of any length.
    pub direction: [f64; 3],
    /// Greatest distance of the end effector from the line, m.
    pub radius_m: f64,
    /// When it begins, s.
    pub from_s: f64,
    /// When it ends, s.
    pub until_s: f64,
}

/// The end effector stays on a plane for a while: contact with a wall or the ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contact {
    /// A point of the plane, m.
    pub point_m: [f64; 3],
    /// The plane's normal, of any length.
    pub normal: [f64; 3],
    /// Greatest distance of the end effector from the plane, m.
    pub tolerance_m: f64,
    /// When it begins, s.
    pub from_s: f64,
    /// When it ends, s.
    pub until_s: f64,
}

/// What it costs to leave the region that the bank's flights support: how far they tilted, how fast they flew, how far
/// the arm leaned. Plans that leave it rest on what no flight has shown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupportDemand {
    /// Cost, for each quantity at each knot, of the square of how far it is beyond the edge, as a share of its limit.
    pub weight: f64,
    /// Where the edge is, as a share of the limit: of what 99 % of the flights' rows stayed below.
    #[serde(default = "SupportDemand::default_share")]
    pub share: f64,
}

impl SupportDemand {
    fn default_share() -> f64 {
        1.0
    }
}

/// Refuses what cannot be posed, naming the field.
pub(in crate::task) fn validate(task: &Task) -> Result<(), TaskError> {
    let wrong = |field: String, found: String, expected: &str| {
        Err(TaskError::value(&task.name, &field, found, expected))
    };
    let positive = |value: f64| value.is_finite() && value > 0.0;
    let in_reach = |point: &[f64; 3]| point.iter().all(|entry| entry.abs() <= 100.0);
    for (index, obstacle) in task.obstacles.iter().enumerate() {
        let place = format!("obstacles[{index}]");
        let Obstacle {
            margin_m,
            quadrotor_margin_m,
            ..
        } = *obstacle;
        for (field, margin) in [("margin_m", margin_m), ("quadrotor_margin_m", quadrotor_margin_m)] {
            if !(margin.is_finite() && margin >= 0.0) {
                return wrong(format!("{place}.{field}"), margin.to_string(), "metres ≥ 0");
            }
        }
        match &obstacle.shape {
            Shape::Sphere { centre_m, radius_m } if !(in_reach(centre_m) && positive(*radius_m)) => {
                let found = format!("centre {centre_m:?}, radius {radius_m}");
                return wrong(place, found, "a centre within ±100 m and a positive radius");
            }
            Shape::Box { lower_m, upper_m }
                if !(in_reach(lower_m)
                    && in_reach(upper_m)
                    && lower_m.iter().zip(upper_m).all(|(low, high)| low < high)) =>
            {
                let found = format!("lower {lower_m:?}, upper {upper_m:?}");
                return wrong(place, found, "corners within ±100 m, lower below upper");
            }
            _ => {}
        }
    }
    let tubes = task.tubes.iter().enumerate().map(|(index, tube)| {
        let place = format!("tubes[{index}]");
        (
            place,
            tube.point_m,
            tube.direction,
            tube.radius_m,
            (tube.from_s, tube.until_s),
        )
    });
    let contacts = task.contacts.iter().enumerate().map(|(index, contact)| {
        let Contact {
            point_m,
            normal,
            tolerance_m,
            from_s,
            until_s,
        } = *contact;
        (
            format!("contacts[{index}]"),
            point_m,
            normal,
            tolerance_m,
            (from_s, until_s),
        )
    });
    let duration_s = (task.knots() - 1) as f64 * crate::DT;
    for (place, point_m, direction, distance_m, (from_s, until_s)) in tubes.chain(contacts) {
        let length = direction.iter().map(|entry| entry * entry).sum::<f64>().sqrt();
        if !(in_reach(&point_m) && positive(length) && positive(distance_m)) {
            let found = format!("point {point_m:?}, direction {direction:?}, distance {distance_m}");
            return wrong(
                place,
                found,
                "a point within ±100 m, a direction that is not zero, a positive distance",
            );
        }
        if !(from_s >= 0.0 && from_s <= until_s && until_s <= duration_s + 0.5 * crate::DT) {
            let expected = format!("0 ≤ from_s ≤ until_s ≤ {duration_s}");
            return wrong(place, format!("from_s {from_s}, until_s {until_s}"), &expected);
        }
    }
    if let Some(SupportDemand { weight, share }) = task.support
        && !(positive(weight) && positive(share))
    {
        let found = format!("weight {weight}, share {share}");
        return wrong("support".into(), found, "positive numbers");
    }
    Ok(())
}
