//! One line of the child to one [`Observation`].

use serde::{Deserialize, Deserializer};

use super::ExecFault;
use crate::flight::Pose;
use crate::link::Observation;

/// How far the norm of an attitude quaternion may be from 1: rounding to three decimals passes.
const NORM_TOLERANCE: f64 = 1e-2;
/// How much of a bad reply an error message shows, bytes.
const SHOWN_BYTES: usize = 200;

#[derive(Deserialize)]
struct Reply {
    t_s: f64,
    #[serde(deserialize_with = "required")]
    qr: Option<[f64; 3]>,
    #[serde(deserialize_with = "required")]
    q: Option<[f64; 4]>,
    #[serde(deserialize_with = "required")]
    ee: Option<[f64; 3]>,
}

/// A value or null, but not a missing key (which serde's own `Option` would take for null).
fn required<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    Option::deserialize(deserializer)
}

/// Checks a line and brings it to flyvine's conventions: attitude of unit length with w ≥ 0.
pub(super) fn parse(line: &[u8]) -> Result<Observation, ExecFault> {
    let nonsense = |problem: String| ExecFault::Nonsense {
        problem,
        received: shown(line),
    };
    let reply: Reply = serde_json::from_slice(line).map_err(|error| {
        nonsense(if error.is_data() {
            error.to_string()
        } else {
            format!("not JSON ({error}; a missed pose is null, JSON has no NaN)")
        })
    })?;
    let quadrotor = match (reply.qr, reply.q) {
        (Some(position), Some(attitude)) => Some(Pose { position, attitude }),
        (None, None) => None,
        _ => {
            return Err(nonsense(
                "of `qr` and `q`, one is null and the other is not".into(),
            ));
        }
    };
    let finite = reply.t_s.is_finite()
        && quadrotor
            .iter()
            .all(|pose| pose.position.iter().chain(&pose.attitude).all(|x| x.is_finite()))
        && reply.ee.iter().flatten().all(|x| x.is_finite());
    if !finite {
        return Err(nonsense("a number is not finite".into()));
    }
    let quadrotor = match quadrotor {
        Some(Pose { position, attitude }) => {
            let norm = attitude.iter().map(|x| x * x).sum::<f64>().sqrt();
            if (norm - 1.0).abs() > NORM_TOLERANCE {
                return Err(nonsense(format!(
                    "the norm of `q` is {norm}; expected 1 ± {NORM_TOLERANCE}"
                )));
            }
            // q and −q are the same attitude.
            let scale = if attitude[0] < 0.0 {
                -1.0 / norm
            } else {
                1.0 / norm
            };
            Some(Pose {
                position,
                attitude: attitude.map(|x| x * scale),
            })
        }
        None => None,
    };
    Ok(Observation {
        t_s: reply.t_s,
        quadrotor,
        end_effector: reply.ee,
    })
}

/// The beginning of a line, fit for an error message.
pub(super) fn shown(line: &[u8]) -> String {
    let text = String::from_utf8_lossy(&line[..line.len().min(SHOWN_BYTES)]).into_owned();
    if line.len() > SHOWN_BYTES {
        format!("{text}… ({} bytes)", line.len())
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(line: &str) -> String {
        match parse(line.as_bytes()) {
            Err(ExecFault::Nonsense { problem, .. }) => problem,
            other => panic!("expected nonsense, found {other:?}"),
        }
    }

    #[test]
    fn a_reply_is_brought_to_conventions() {
        let observation =
            parse(br#"{"t_s": 0.05, "qr": [1, 2, 3], "q": [-0.5, 0.5, -0.5, 0.5], "ee": null, "wind": [1]}"#)
                .unwrap();
        let pose = observation.quadrotor.unwrap();
        assert_eq!(pose.position, [1.0, 2.0, 3.0]);
        assert_eq!(pose.attitude, [0.5, -0.5, 0.5, -0.5]);
        assert_eq!(observation.end_effector, None);
    }

    #[test]
    fn attitudes_are_normalized() {
        let observation =
            parse(br#"{"t_s": 0, "qr": [0, 0, 1], "q": [1.004, 0, 0, 0], "ee": null}"#).unwrap();
        assert_eq!(observation.quadrotor.unwrap().attitude, [1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn nonsense_is_named() {
        assert!(problem("hello").contains("not JSON"));
        assert!(problem("").contains("not JSON"));
        assert!(problem("[1]").contains("t_s") || problem("[1]").contains("invalid"));
        assert!(problem(r#"{"t_s": 0, "qr": null, "q": null}"#).contains("missing field `ee`"));
        assert!(problem(r#"{"t_s": 0, "q": null, "ee": null}"#).contains("missing field `qr`"));
        assert!(problem(r#"{"t_s": 0, "qr": [0, 0, NaN], "q": null, "ee": null}"#).contains("no NaN"));
        assert!(problem(r#"{"t_s": 0, "qr": [0, 0], "q": null, "ee": null}"#).contains("length 2"));
        assert!(problem(r#"{"t_s": 0, "qr": [0, 0, 1], "q": null, "ee": null}"#).contains("`q`"));
        assert!(problem(r#"{"t_s": null, "qr": null, "q": null, "ee": null}"#).contains("null"));
        assert!(
            problem(r#"{"t_s": 0, "qr": [0, 0, 1], "q": [0, 0, 0, 0], "ee": null}"#)
                .contains("norm of `q` is 0")
        );
        parse(br#"{"t_s": 0, "qr": [0, 0, 1e999], "q": [1, 0, 0, 0], "ee": null}"#).unwrap_err();
        parse(br#"{"t_s": 0, "qr": [0, 0, 1, 2], "q": [1, 0, 0, 0], "ee": null}"#).unwrap_err();
    }

    #[test]
    fn long_replies_are_cut_short_in_messages() {
        let text = shown("x".repeat(5000).as_bytes());
        assert!(text.len() < 300 && text.ends_with("(5000 bytes)"));
    }
}
