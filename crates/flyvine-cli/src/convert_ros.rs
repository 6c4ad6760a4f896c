//! Flights out of ROS 2 bags in MCAP, the storage that ROS 2 writes since Iron.
//!
//! The messages are `geometry_msgs/msg/PoseStamped` or `TransformStamped`, serialized as CDR (OMG DDSI-RTPS 2.5, chapter 10);
//! world and body axes are REP 103's, which are flyvine's.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use flyvine::flight::{
    Configuration, Flight, Pose, Reading, Recording, RecordingRow, quaternion, resample, sound_mcap,
};
use mcap::{Message, MessageStream};
use serde::Deserialize;

/// Which topics hold what; a TOML file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Topics {
    /// The quadrotor's pose.
    quadrotor: String,
    /// The end effector's.
    end_effector: String,
    /// The commanded pose, of which the position counts.
    command: String,
    /// Length of the arm, m.
    length_m: f64,
    /// Pressure in it, kPa.
    pressure_kpa: f64,
    /// Longest time between two poses that is interpolated, s.
    #[serde(default = "max_gap_s")]
    max_gap_s: f64,
}

fn max_gap_s() -> f64 {
    0.1
}

/// Reads a bag as a flight at 20 Hz, from the first command on. Times are those in the messages' headers.
pub fn read_ros2_bag(path: &Path, topics: &Path) -> Result<Flight> {
    let shown = topics.display().to_string();
    let text = std::fs::read_to_string(topics).with_context(|| shown.clone())?;
    let topics: Topics = toml::from_str(&text).with_context(|| shown.clone())?;
    let arm = [topics.length_m, topics.pressure_kpa, topics.max_gap_s];
    ensure!(
        arm.iter().all(|number| number.is_finite()) && topics.length_m > 0.0 && topics.max_gap_s > 0.0,
        "{shown}: expected a length and a gap above 0 and a finite pressure"
    );
    let shown = path.display().to_string();
    let bytes = std::fs::read(path).with_context(|| shown.clone())?;
    let rows = rows(&bytes, &topics).with_context(|| shown.clone())?;
    let recording = Recording { name: shown, rows };
    Ok(resample(&recording, topics.max_gap_s)?)
}

/// The messages of all topics in the order of their stamps; those of one instant are one row.
fn rows(bytes: &[u8], topics: &Topics) -> Result<Vec<RecordingRow>> {
    let empty = RecordingRow {
        t_s: 0.0,
        configuration: Configuration {
            length_m: topics.length_m,
            pressure_kpa: topics.pressure_kpa,
        },
        command: None,
        command_velocity: None,
        quadrotor: Reading::Absent,
        end_effector: Reading::Absent,
    };
    let mut rows: BTreeMap<i64, RecordingRow> = BTreeMap::new();
    let mut counts = [0; 3];
    for message in MessageStream::new(sound_mcap(bytes))? {
        let message = message?;
        let topic = &message.channel.topic;
        let all = [&topics.quadrotor, &topics.end_effector, &topics.command];
        let Some(which) = all.into_iter().position(|wanted| wanted == topic) else {
            continue;
        };
        counts[which] += 1;
        let (stamp_ns, pose) =
            stamped_pose(&message).with_context(|| format!("{topic}, message {}", counts[which]))?;
        let row = rows.entry(stamp_ns).or_insert(empty);
        match which {
            0 => row.quadrotor = Reading::Measured(pose),
            1 => row.end_effector = Reading::Measured(pose.position),
            _ => row.command = Some(pose.position),
        }
    }
    for (topic, count) in [&topics.quadrotor, &topics.end_effector, &topics.command]
        .into_iter()
        .zip(counts)
    {
        ensure!(count > 0, "no messages of topic {topic}");
    }
    let first_ns = *rows.keys().next().expect("there are messages");
    let row = |(stamp_ns, row): (i64, RecordingRow)| RecordingRow {
        t_s: 1e-9 * (stamp_ns - first_ns) as f64,
        ..row
    };
    Ok(rows.into_iter().map(row).collect())
}

/// A message's stamp, ns, and pose.
fn stamped_pose(message: &Message) -> Result<(i64, Pose)> {
    let schema = message
        .channel
        .schema
        .as_ref()
        .map_or("none", |schema| schema.name.as_str());
    let has_child = match schema {
        "geometry_msgs/msg/PoseStamped" => false,
        "geometry_msgs/msg/TransformStamped" => true,
        other => bail!("found {other}, expected geometry_msgs/msg/PoseStamped or TransformStamped"),
    };
    let mut cdr = Cdr::new(&message.data)?;
    let (seconds, nanoseconds) = (cdr.word()?.cast_signed(), cdr.word()?);
    cdr.skip_string()?;
    if has_child {
        cdr.skip_string()?;
    }
    let mut numbers = [0.0; 7];
    for number in &mut numbers {
        *number = cdr.double()?;
        ensure!(number.is_finite(), "found {number}, expected a finite number");
    }
    let [x, y, z, qx, qy, qz, qw] = numbers;
    let attitude = quaternion::unit([qw, qx, qy, qz])
        .map_err(|norm| anyhow::anyhow!("found a quaternion of norm {norm:.4}, expected 1"))?;
    let stamp_ns = i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds);
    Ok((
        stamp_ns,
        Pose {
            position: [x, y, z],
            attitude,
        },
    ))
}

/// A reader of plain CDR: numbers are aligned to their size, counted from behind the encapsulation's four bytes.
struct Cdr<'a> {
    body: &'a [u8],
    at: usize,
    is_little: bool,
}

impl<'a> Cdr<'a> {
    fn new(bytes: &'a [u8]) -> Result<Self> {
        let is_little = match bytes {
            [0, 0, _, _, ..] => false,
            [0, 1, _, _, ..] => true,
            _ => bail!("not plain CDR"),
        };
        Ok(Self {
            body: &bytes[4..],
            at: 0,
            is_little,
        })
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        self.at = self.at.next_multiple_of(N);
        let bytes = self
            .body
            .get(self.at..self.at + N)
            .context("the message is too short")?;
        self.at += N;
        Ok(bytes.try_into().expect("N bytes"))
    }

    fn word(&mut self) -> Result<u32> {
        let bytes = self.take()?;
        Ok(if self.is_little {
            u32::from_le_bytes(bytes)
        } else {
            u32::from_be_bytes(bytes)
        })
    }

    fn double(&mut self) -> Result<f64> {
        let bytes = self.take()?;
        Ok(if self.is_little {
            f64::from_le_bytes(bytes)
        } else {
            f64::from_be_bytes(bytes)
        })
    }

    fn skip_string(&mut self) -> Result<()> {
        let length = self.word()? as usize;
        ensure!(length <= self.body.len() - self.at, "the message is too short");
        self.at += length;
        Ok(())
    }
}
