//! How far a flown end effector was from where it should have been.

use serde::{Deserialize, Serialize};

use crate::DT;
use crate::flight::{Flight, Sample};

/// Where a swing shall bring the end effector, and when.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SwingTarget {
    /// Knot at which the end effector shall be there, from 0.
    pub knot: usize,
    /// Position `[x, z]`, m.
    pub position: [f64; 2],
}

/// Statistics of a 3-D distance over the scored rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DistanceStatistics {
    /// Mean, m.
    pub mean_m: f64,
    /// Root mean square, m.
    pub rms_m: f64,
    /// Maximum, m.
    pub max_m: f64,
}

/// The score of one flight of one plan; its JSON is what `flyvine score --json` prints.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Measured end effector to the task's reference.
    pub ee_vs_reference: DistanceStatistics,
    /// Measured end effector to what the plan's model predicted.
    pub ee_vs_prediction: DistanceStatistics,
    /// Rows of the flight, those without an end-effector pose included.
    pub rows: usize,
    /// Rows without an end-effector pose; they are in no statistic.
    pub rows_missing: usize,
    /// Knots of the plan that an aborted flight did not reach; they are in no statistic.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub knots_not_flown: usize,
    /// Swings: distance in the xz plane from the target at the target knot, m.
    /// Absent when the end effector was not seen there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_miss_m: Option<f64>,
    /// Swings: end-effector velocity `[v_x, v_z]` over the step that ends at the target knot, m/s.
    /// Absent when the end effector was not seen at both ends of the step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_velocity_m_s: Option<[f64; 2]>,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Why a flight cannot be scored against a plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScoreError {
    /// The flight is not a flight of this plan.
    #[error(
        "flight {flight}: found {rows} rows, expected at most {knots}, one for each knot of the plan, but for rows in \
         which the last command was held"
    )]
    RowCount {
        /// Name of the flight.
        flight: String,
        /// Rows found.
        rows: usize,
        /// Knots of the plan.
        knots: usize,
    },
    /// The plan contradicts itself.
    #[error("the plan predicts {predictions} end-effector positions, expected {knots}, one for each knot")]
    PredictionCount {
        /// Predicted positions found.
        predictions: usize,
        /// Knots of the reference.
        knots: usize,
    },
    /// A plan without knots scores nothing.
    #[error("the plan has no knots, expected at least one")]
    EmptyPlan,
    /// A row is not where the plan's clock is.
    #[error(
        "flight {flight}, row {row}: found t = {found_s} s, expected {expected_s} s (rows are {DT} s apart)"
    )]
    Clock {
        /// Name of the flight.
        flight: String,
        /// Row, from 0.
        row: usize,
        /// Time found, s.
        found_s: f64,
        /// Time expected, s.
        expected_s: f64,
    },
    /// A position is NaN or infinite.
    #[error("{place} {index}: found {found:?}, expected finite coordinates in metres")]
    NotFinite {
        /// Which list.
        place: &'static str,
        /// Row or knot, from 0.
        index: usize,
        /// The position.
        found: [f64; 3],
    },
    /// Motion capture saw nothing to score.
    #[error("flight {flight}: none of its {rows} rows has an end-effector pose, expected at least one")]
    NothingSeen {
        /// Name of the flight.
        flight: String,
        /// Rows of the flight.
        rows: usize,
    },
    /// The target knot is not in the plan.
    #[error("target knot {knot}: expected 1 to {last} (the plan's last knot)")]
    TargetKnot {
        /// Knot found.
        knot: usize,
        /// Last knot of the plan.
        last: usize,
    },
    /// The target is NaN or infinite.
    #[error("target: found {found:?}, expected finite x and z in metres")]
    TargetNotFinite {
        /// The target `[x, z]`.
        found: [f64; 2],
    },
}

/// Scores `flight` against a plan: row k against knot k, no time shift, ramp included, 3-D distance from
/// the measured end effector; rows without an end-effector pose are left out and counted.
///
/// `reference` and `prediction` are end-effector positions, m, one per knot; `swing` adds what only a swing
/// has. The flight must have one row per knot, [`DT`] apart (to within half a step); one that was aborted has
/// fewer, and is scored as far as it went.
pub fn score(
    flight: &Flight,
    reference: &[[f64; 3]],
    prediction: &[[f64; 3]],
    swing: Option<SwingTarget>,
) -> Result<Score, ScoreError> {
    check_shapes(flight, reference, prediction, swing)?;
    check_finite("flight row", flight.samples.iter().map(|s| s.end_effector))?;
    check_finite("reference knot", reference.iter().copied().map(Some))?;
    check_finite("prediction knot", prediction.iter().copied().map(Some))?;

    let measured = |k: usize| flight.samples.get(k)?.end_effector;
    // Behind an abort near the plan's end the position was held on.
    let rows = flight.samples.len().min(reference.len());
    let seen: Vec<usize> = (0..rows).filter(|&k| measured(k).is_some()).collect();
    let statistics_to = |expected: &[[f64; 3]]| {
        DistanceStatistics::of(
            seen.iter()
                .filter_map(|&k| Some(distance(measured(k)?, expected[k]))),
        )
        .ok_or_else(|| ScoreError::NothingSeen {
            flight: flight.name.clone(),
            rows,
        })
    };
    let (target_miss_m, target_velocity_m_s) = match swing {
        None => (None, None),
        Some(SwingTarget {
            knot,
            position: [x, z],
        }) => {
            let at = measured(knot);
            let before = measured(knot - 1);
            (
                at.map(|ee| (ee[0] - x).hypot(ee[2] - z)),
                at.zip(before)
                    .map(|(ee, old)| [(ee[0] - old[0]) / DT, (ee[2] - old[2]) / DT]),
            )
        }
    };
    Ok(Score {
        ee_vs_reference: statistics_to(reference)?,
        ee_vs_prediction: statistics_to(prediction)?,
        rows,
        rows_missing: rows - seen.len(),
        knots_not_flown: reference.len() - rows,
        target_miss_m,
        target_velocity_m_s,
    })
}

impl DistanceStatistics {
    /// Mean, RMS and maximum of `distances` (m); `None` of nothing.
    pub fn of(distances: impl Iterator<Item = f64>) -> Option<Self> {
        let (mut count, mut sum, mut sum_of_squares, mut max) = (0_usize, 0.0, 0.0, 0.0_f64);
        for distance in distances {
            count += 1;
            sum += distance;
            sum_of_squares += distance * distance;
            max = max.max(distance);
        }
        (count > 0).then(|| Self {
            mean_m: sum / count as f64,
            rms_m: (sum_of_squares / count as f64).sqrt(),
            max_m: max,
        })
    }
}

fn check_shapes(
    flight: &Flight,
    reference: &[[f64; 3]],
    prediction: &[[f64; 3]],
    swing: Option<SwingTarget>,
) -> Result<(), ScoreError> {
    let knots = reference.len();
    if knots == 0 {
        return Err(ScoreError::EmptyPlan);
    }
    if prediction.len() != knots {
        return Err(ScoreError::PredictionCount {
            predictions: prediction.len(),
            knots,
        });
    }
    let held = |row: &Sample| row.command == flight.samples[knots - 1].command;
    if !flight.samples[knots.min(flight.samples.len())..].iter().all(held) {
        let (flight, rows) = (flight.name.clone(), flight.samples.len());
        return Err(ScoreError::RowCount { flight, rows, knots });
    }
    let start_s = flight.samples.first().map_or(0.0, |first| first.t_s);
    for (row, sample) in flight.samples.iter().enumerate() {
        let expected_s = start_s + row as f64 * DT;
        let on_time = (sample.t_s - expected_s).abs() <= 0.5 * DT; // false for NaN
        if !on_time {
            let (flight, found_s) = (flight.name.clone(), sample.t_s);
            return Err(ScoreError::Clock {
                flight,
                row,
                found_s,
                expected_s,
            });
        }
    }
    if let Some(SwingTarget { knot, position }) = swing {
        if knot == 0 || knot >= knots {
            return Err(ScoreError::TargetKnot {
                knot,
                last: knots - 1,
            });
        }
        if !position.iter().all(|v| v.is_finite()) {
            return Err(ScoreError::TargetNotFinite { found: position });
        }
    }
    Ok(())
}

fn check_finite(
    place: &'static str,
    positions: impl Iterator<Item = Option<[f64; 3]>>,
) -> Result<(), ScoreError> {
    for (index, position) in positions.enumerate() {
        if let Some(found) = position.filter(|p| !p.iter().all(|v| v.is_finite())) {
            return Err(ScoreError::NotFinite { place, index, found });
        }
    }
    Ok(())
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Configuration;

    /// A flight whose rows hold the given end-effector positions.
    fn flight(positions: &[Option<[f64; 3]>]) -> Flight {
        let samples = positions
            .iter()
            .enumerate()
            .map(|(k, &end_effector)| Sample {
                t_s: k as f64 * DT,
                configuration: Configuration {
                    length_m: 0.7,
                    pressure_kpa: 0.0,
                },
                command: [0.0; 3],
                command_velocity: None,
                quadrotor: None,
                end_effector,
            })
            .collect();
        Flight {
            name: "golden".into(),
            samples,
        }
    }

    #[test]
    fn statistics_by_hand() {
        // Distances to the reference 5, (missing), 13, 0; to the prediction 0, (missing), 1, 2.
        let flown = flight(&[
            Some([3.0, 4.0, 0.0]),
            None,
            Some([0.0, 5.0, 12.0]),
            Some([1.0, 1.0, 1.0]),
        ]);
        let reference = [[0.0; 3], [9.0; 3], [0.0; 3], [1.0; 3]];
        let prediction = [[3.0, 4.0, 0.0], [9.0; 3], [0.0, 5.0, 11.0], [1.0, 3.0, 1.0]];
        let score = score(&flown, &reference, &prediction, None).unwrap();
        assert_eq!((score.rows, score.rows_missing), (4, 1));
        assert_eq!(score.ee_vs_reference.mean_m, 6.0);
        assert!((score.ee_vs_reference.rms_m - (194.0_f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(score.ee_vs_reference.max_m, 13.0);
        assert_eq!(score.ee_vs_prediction.mean_m, 1.0);
        assert!((score.ee_vs_prediction.rms_m - (5.0_f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(score.ee_vs_prediction.max_m, 2.0);
        assert_eq!(score.target_miss_m, None);
    }

    #[test]
    fn swing_ignores_y_and_uses_the_step_before_the_target() {
        let flown = flight(&[Some([0.0; 3]), Some([1.0, 7.0, 0.5]), Some([1.2, 9.0, 0.4])]);
        let plan = [[0.0; 3]; 3];
        let target = SwingTarget {
            knot: 2,
            position: [1.5, 0.8],
        };
        let score = score(&flown, &plan, &plan, Some(target)).unwrap();
        assert!((score.target_miss_m.unwrap() - 0.5).abs() < 1e-12);
        let [vx, vz] = score.target_velocity_m_s.unwrap();
        assert!((vx - 4.0).abs() < 1e-12 && (vz + 2.0).abs() < 1e-12, "{vx} {vz}");
    }

    #[test]
    fn swing_whose_target_row_was_missed_says_nothing_about_it() {
        let flown = flight(&[Some([0.0; 3]), None, Some([1.2, 0.0, 0.4])]);
        let plan = [[0.0; 3]; 3];
        let at = |knot| {
            score(
                &flown,
                &plan,
                &plan,
                Some(SwingTarget {
                    knot,
                    position: [0.0; 2],
                }),
            )
            .unwrap()
        };
        assert_eq!((at(1).target_miss_m, at(1).target_velocity_m_s), (None, None));
        assert!(at(2).target_miss_m.is_some() && at(2).target_velocity_m_s.is_none());
    }

    #[test]
    fn json_names_are_the_contract() {
        let flown = flight(&[Some([3.0, 4.0, 0.0]), Some([0.0; 3])]);
        let plan = [[0.0; 3]; 2];
        let plain = score(&flown, &plan, &plan, None).unwrap();
        assert_eq!(
            serde_json::to_string(&plain).unwrap(),
            r#"{"ee_vs_reference":{"mean_m":2.5,"rms_m":3.5355339059327378,"max_m":5.0},"#.to_owned()
                + r#""ee_vs_prediction":{"mean_m":2.5,"rms_m":3.5355339059327378,"max_m":5.0},"#
                + r#""rows":2,"rows_missing":0}"#
        );
        let target = SwingTarget {
            knot: 1,
            position: [0.0; 2],
        };
        let swing = score(&flown, &plan, &plan, Some(target)).unwrap();
        let json = serde_json::to_value(&swing).unwrap();
        assert_eq!(json["target_miss_m"], 0.0);
        assert_eq!(json["target_velocity_m_s"], serde_json::json!([-60.0, 0.0]));
        assert_eq!(serde_json::from_value::<Score>(json).unwrap(), swing);
    }

    #[test]
    fn an_aborted_flight_is_scored_as_far_as_it_went() {
        let flown = flight(&[Some([0.0; 3]), Some([3.0, 4.0, 0.0])]);
        let plan = [[0.0; 3]; 5];
        let target = SwingTarget {
            knot: 3,
            position: [1.5, 0.8],
        };
        let score = score(&flown, &plan, &plan, Some(target)).unwrap();
        assert_eq!((score.rows, score.rows_missing, score.knots_not_flown), (2, 0, 3));
        assert_eq!(score.ee_vs_reference.mean_m, 2.5);
        assert_eq!((score.target_miss_m, score.target_velocity_m_s), (None, None));
    }

    #[test]
    fn rows_behind_the_plan_count_only_as_a_hold_after_an_abort() {
        let held = flight(&[Some([0.0; 3]), Some([0.1; 3]), Some([5.0; 3]), Some([5.0; 3])]);
        let plan = [[0.0; 3]; 2];
        let score = score(&held, &plan, &plan, None).unwrap();
        assert_eq!((score.rows, score.rows_missing, score.knots_not_flown), (2, 0, 0));
        assert!(score.ee_vs_reference.max_m < 0.2);
    }

    #[test]
    fn mismatches_are_named() {
        let mut flown = flight(&[Some([0.0; 3]), Some([0.0; 3])]);
        flown.samples[1].command = [0.1; 3];
        let plan = [[0.0; 3]; 2];
        let target = |knot, x| {
            Some(SwingTarget {
                knot,
                position: [x, 0.0],
            })
        };
        assert!(matches!(
            score(&flown, &plan[..1], &plan[..1], None),
            Err(ScoreError::RowCount {
                rows: 2,
                knots: 1,
                ..
            })
        ));
        assert!(matches!(
            score(&flown, &plan, &[[0.0; 3]; 1], None),
            Err(ScoreError::PredictionCount {
                predictions: 1,
                knots: 2
            })
        ));
        assert_eq!(score(&flown, &[], &[], None), Err(ScoreError::EmptyPlan));
        assert!(matches!(
            score(&flown, &plan, &plan, target(0, 0.0)),
            Err(ScoreError::TargetKnot { .. })
        ));
        assert!(matches!(
            score(&flown, &plan, &plan, target(2, 0.0)),
            Err(ScoreError::TargetKnot { .. })
        ));
        assert!(matches!(
            score(&flown, &plan, &plan, target(1, f64::NAN)),
            Err(ScoreError::TargetNotFinite { .. })
        ));
        assert!(matches!(
            score(&flown, &[[f64::NAN; 3]; 2], &plan, None),
            Err(ScoreError::NotFinite {
                place: "reference knot",
                index: 0,
                ..
            })
        ));
        assert!(matches!(
            score(
                &flight(&[Some([0.0; 3]), Some([f64::INFINITY; 3])]),
                &plan,
                &plan,
                None
            ),
            Err(ScoreError::NotFinite {
                place: "flight row",
                index: 1,
                ..
            })
        ));
        assert!(matches!(
            score(&flight(&[None, None]), &plan, &plan, None),
            Err(ScoreError::NothingSeen { rows: 2, .. })
        ));
        let mut late = flown.clone();
        late.samples[1].t_s += 0.6 * DT;
        assert!(matches!(
            score(&late, &plan, &plan, None),
            Err(ScoreError::Clock { row: 1, .. })
        ));
        late.samples[1].t_s = f64::NAN;
        assert!(matches!(
            score(&late, &plan, &plan, None),
            Err(ScoreError::Clock { row: 1, .. })
        ));
    }
}
