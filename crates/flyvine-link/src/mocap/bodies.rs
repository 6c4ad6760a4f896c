//! Which body of the motion-capture system is the quadrotor and which the end effector, as a TOML file.
//!
//! ```toml
//! axes = "y_up"            # the server's axes; z_up if absent
//! latency_ms = 4.0         # from exposure to the server's time stamp, as its maker states it
//!
//! [quadrotor]
//! name = "flying_vine"
//! origin_m = [0.0, 0.0, -0.03]   # the vehicle's centre, in the frame of the marker body
//! attitude = [1.0, 0.0, 0.0, 0.0] # from the vehicle's axes to those of the marker body; w, x, y, z
//!
//! [end_effector]
//! name = "tip"
//! ```

use std::path::Path;

use flyvine::flight::mapping::Axes;
use flyvine::flight::{Pose, quaternion};
use serde::Deserialize;

use super::MocapError;

/// Names, axes and frames of the tracked bodies. Unknown keys are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bodies {
    /// The server's axes, of world and bodies alike. Default `z_up`.
    #[serde(default)]
    pub axes: Axes,
    /// Time from the cameras' exposure to the server's time stamp, ms: part of a pose's age. Default 0.
    #[serde(default)]
    pub latency_ms: f64,
    /// The quadrotor.
    pub quadrotor: BodyFrame,
    /// The end effector.
    pub end_effector: BodyFrame,
}

/// A marker body, and where in it the body is that flyvine speaks of.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyFrame {
    /// Its name on the server.
    pub name: String,
    /// Origin of the body's own frame in the marker body's (x forward, y left, z up), m. Default 0.
    #[serde(default)]
    pub origin_m: [f64; 3],
    /// Hamilton quaternion that turns the body's own axes into the marker body's, `[w, x, y, z]`. Default: the same axes.
    #[serde(default = "same_axes")]
    pub attitude: [f64; 4],
}

fn same_axes() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

impl Bodies {
    /// Two bodies by name, in flyvine's own axes, without offsets.
    pub fn named(quadrotor: &str, end_effector: &str) -> Bodies {
        let body = |name: &str| BodyFrame {
            name: name.to_owned(),
            origin_m: [0.0; 3],
            attitude: same_axes(),
        };
        Bodies {
            axes: Axes::default(),
            latency_ms: 0.0,
            quadrotor: body(quadrotor),
            end_effector: body(end_effector),
        }
    }

    /// Reads a TOML file.
    ///
    /// # Errors
    /// The file cannot be read; unknown, missing or mistyped keys; values outside their range.
    pub fn read(path: &Path) -> Result<Bodies, MocapError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| MocapError::Bodies {
            file: file.clone(),
            problem: error.to_string(),
        })?;
        Bodies::parse(&file, &text)
    }

    /// Reads TOML text; `file` is what error messages call it.
    ///
    /// # Errors
    /// As [`Bodies::read`].
    pub fn parse(file: &str, text: &str) -> Result<Bodies, MocapError> {
        let error = |problem: String| MocapError::Bodies {
            file: file.to_owned(),
            problem,
        };
        let mut bodies: Bodies =
            toml::from_str(text).map_err(|problem| error(problem.to_string().trim_end().to_owned()))?;
        bodies.check().map_err(error)?;
        Ok(bodies)
    }

    /// The names of quadrotor and end effector.
    pub fn names(&self) -> [String; 2] {
        [self.quadrotor.name.clone(), self.end_effector.name.clone()]
    }

    fn check(&mut self) -> Result<(), String> {
        if !(0.0..=500.0).contains(&self.latency_ms) {
            let found = self.latency_ms;
            return Err(format!("`latency_ms`: found {found}, expected 0 … 500 ms"));
        }
        if self.quadrotor.name == self.end_effector.name {
            let name = &self.quadrotor.name;
            return Err(format!(
                "`quadrotor.name` and `end_effector.name`: found `{name}` twice, expected two bodies"
            ));
        }
        self.quadrotor
            .check()
            .map_err(|problem| format!("`quadrotor.{problem}"))?;
        self.end_effector
            .check()
            .map_err(|problem| format!("`end_effector.{problem}"))
    }

    /// A pose in the server's axes and marker frame as that of `body` in flyvine's world.
    pub(super) fn pose(&self, body: &BodyFrame, position: [f64; 3], attitude: [f64; 4]) -> Pose {
        let markers = self.axes.attitude(attitude);
        let origin = self.axes.vector(position);
        let offset = rotate(markers, body.origin_m);
        let attitude = quaternion::product(markers, body.attitude);
        Pose {
            position: std::array::from_fn(|i| origin[i] + offset[i]),
            attitude: quaternion::align([1.0, 0.0, 0.0, 0.0], attitude),
        }
    }
}

impl BodyFrame {
    /// The problem, if any, begins with the key and ends its quotation.
    fn check(&mut self) -> Result<(), String> {
        if self.name.is_empty() {
            return Err("name`: found an empty name".into());
        }
        if !self.origin_m.iter().all(|x| x.abs() <= 2.0) {
            let found = self.origin_m;
            return Err(format!("origin_m`: found {found:?}, expected −2 … 2 m"));
        }
        self.attitude = quaternion::unit(self.attitude)
            .map_err(|norm| format!("attitude`: found a quaternion of norm {norm:.4}, expected 1"))?;
        Ok(())
    }
}

/// The vector `v` turned by the unit quaternion `q`.
fn rotate(q: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let [w, a, b, c] = q;
    let [_, x, y, z] = quaternion::product(quaternion::product(q, [0.0, x, y, z]), [w, -a, -b, -c]);
    [x, y, z]
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

    fn parse(text: &str) -> Result<Bodies, String> {
        Bodies::parse("bodies.toml", text).map_err(|error| error.to_string())
    }

    const BOTH: &str = "[quadrotor]\nname = \"drone\"\n[end_effector]\nname = \"tip\"\n";

    #[test]
    fn two_names_are_enough() {
        assert_eq!(parse(BOTH), Ok(Bodies::named("drone", "tip")));
    }

    #[test]
    fn mistakes_are_named() {
        for (text, place) in [
            ("[quadrotor]\nname = \"drone\"\n".to_owned(), "end_effector"),
            (BOTH.replace("tip", "drone"), "found `drone` twice"),
            (format!("axis = \"y_up\"\n{BOTH}"), "axis"),
            (format!("axes = \"x_up\"\n{BOTH}"), "x_up"),
            (format!("latency_ms = -1\n{BOTH}"), "latency_ms"),
            (
                format!("{BOTH}origin_m = [nan, 0, 0]\n"),
                "`end_effector.origin_m`",
            ),
            (
                format!("{BOTH}attitude = [1, 1, 0, 0]\n"),
                "`end_effector.attitude`",
            ),
        ] {
            let error = parse(&text).unwrap_err();
            assert!(
                error.starts_with("bodies.toml: ") && error.contains(place),
                "{error}"
            );
        }
    }

    #[test]
    fn y_up_becomes_z_up() {
        let bodies = parse(&format!("axes = \"y_up\"\n{BOTH}")).unwrap();
        // Turned by 90° about the vertical, 1.5 m high.
        let pose = bodies.pose(&bodies.quadrotor, [1.0, 1.5, -2.0], [HALF, 0.0, HALF, 0.0]);
        assert_eq!(pose.position, [1.0, 2.0, 1.5]);
        assert_eq!(pose.attitude, [HALF, 0.0, 0.0, HALF]);
    }

    #[test]
    fn the_body_sits_at_its_place_in_the_marker_frame() {
        let text = format!("{BOTH}origin_m = [0.1, 0.0, -0.05]\nattitude = [{HALF}, 0.0, 0.0, {HALF}]\n");
        let bodies = parse(&text).unwrap();
        // Markers turned by 90° about z: their x axis points along y.
        let pose = bodies.pose(&bodies.end_effector, [1.0, 2.0, 3.0], [HALF, 0.0, 0.0, HALF]);
        for (found, expected) in pose.position.into_iter().zip([1.0, 2.1, 2.95]) {
            assert!((found - expected).abs() < 1e-12);
        }
        let half_turn = quaternion::dot(pose.attitude, [0.0, 0.0, 0.0, 1.0]);
        assert!((half_turn.abs() - 1.0).abs() < 1e-12);
        assert_eq!(
            bodies.pose(&bodies.quadrotor, [0.0; 3], UPRIGHT).attitude,
            UPRIGHT
        );
    }
}
