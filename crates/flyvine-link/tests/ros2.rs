//! ROS 2 with a node of the package `cyclonedds` at the other end, both ways. Only with the feature `ros2`, and by
//! `.ci/ros2`, which keeps DDS in a network of its own.
#![cfg(feature = "ros2")]

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use flyvine::flight::{Configuration, Pose, Sample};
use flyvine_link::mocap::{Bodies, HygieneLimits, MocapSource};
use flyvine_link::ros2::{RosAddress, RosPublisher, TOPICS};

/// Not ROS's own default: others' nodes on this machine are not disturbed.
const DOMAIN: &str = "87";

#[test]
#[ignore = "DDS needs a network of its own: .ci/ros2"]
fn a_cyclonedds_node_reads_our_topics_and_we_read_its() {
    let python = std::env::var("FLYVINE_PEERS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut node = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/cyclonedds_node.py"))
        .arg(DOMAIN)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let address: RosAddress = DOMAIN.parse().unwrap();
    let publisher = RosPublisher::start(&address).unwrap();
    let bodies = Bodies::named("/mocap/drone/pose", "/mocap/tip/pose");
    let mocap = format!("ros2:{DOMAIN}").parse().unwrap();
    let source = MocapSource::start(&mocap, Some(bodies), HygieneLimits::default(), None).unwrap();

    let sample = |k: u32| Sample {
        t_s: 0.05 * f64::from(k),
        configuration: Configuration {
            length_m: 0.7 + 1e-3 * f64::from(k),
            pressure_kpa: 0.1,
        },
        command: [0.3, f64::from(k), 1.5],
        command_velocity: None,
        quadrotor: Some(Pose {
            position: [1.0 / 3.0, -2.0, f64::from(k)],
            attitude: [0.8, 0.0, 0.6, 0.0],
        }),
        end_effector: Some([0.1, 0.2, 0.8]),
    };
    let begun = Instant::now();
    let (mut rows, mut seen) = (0, None);
    while node.try_wait().unwrap().is_none() && begun.elapsed() < Duration::from_secs(60) {
        // What is told before it is subscribed to is lost: all topics first.
        if publisher.subscribers() == TOPICS.len() {
            publisher.row(1_700_000_000_123_456_789 + u64::from(rows), &sample(rows));
            rows += 1;
        }
        seen = source.latest(Instant::now()).quadrotor.or(seen);
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = node.wait_with_output().unwrap();
    assert!(output.status.success());
    let heard: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();

    let quadrotor = &heard["/flyvine/quadrotor/pose"];
    let k = quadrotor["position"][2].as_f64().unwrap();
    assert!((19.0..f64::from(rows)).contains(&k), "{heard} of {rows} rows");
    let expected = sample(k as u32);
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value
            .as_array()
            .unwrap()
            .iter()
            .map(|number| number.as_f64().unwrap())
            .collect()
    };
    assert_eq!(
        numbers(&quadrotor["position"]),
        expected.quadrotor.unwrap().position
    );
    assert_eq!(
        numbers(&quadrotor["attitude"]),
        expected.quadrotor.unwrap().attitude
    );
    assert_eq!(quadrotor["stamp_ns"], 1_700_000_000_123_456_789_u64 + k as u64);
    assert_eq!(quadrotor["frame"], "world");
    assert_eq!(
        numbers(&heard["/flyvine/end_effector/pose"]["position"]),
        [0.1, 0.2, 0.8]
    );
    assert_eq!(numbers(&heard["/flyvine/setpoint/pose"]["position"])[0], 0.3);
    assert_eq!(heard["/flyvine/arm/pressure_kpa"], 0.1);
    assert!(
        heard["/flyvine/arm/length_m"].as_f64().unwrap() >= 0.719,
        "{heard}"
    );

    let seen = seen.expect("a pose of the node");
    assert_eq!(seen.pose.position, [1.0, 2.0, 1.5]);
    assert_eq!(seen.pose.attitude, [0.8, 0.0, 0.0, 0.6]);
}
