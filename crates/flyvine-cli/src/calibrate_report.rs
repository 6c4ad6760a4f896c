//! What a calibration found: parameters with their intervals, replays, hover; as tables and for machines.

use flyvine::sim::calibrate::Estimate;
use serde::Serialize;

use crate::console::{centimetres, table};

/// What a calibration found, for machines.
#[derive(Serialize)]
pub struct Report {
    pub parameters: Vec<ParameterLine>,
    pub flights: Vec<FlightLine>,
    /// Of the calibrated vehicle, in every configuration that was fitted.
    pub hover: Vec<HoverLine>,
    pub cost: f64,
    pub iterations: usize,
}

/// One fitted parameter.
#[derive(Serialize)]
pub struct ParameterLine {
    pub name: &'static str,
    pub start: f64,
    pub value: f64,
    /// Confidence interval of 95 %, linearized; absent where the flights do not identify the parameter.
    pub interval: Option<[f64; 2]>,
    pub at_bound: bool,
}

/// One recording: replay minus recording, m (RMS; for the paper's lemniscates the mean distance of the paths).
#[derive(Serialize)]
pub struct FlightLine {
    pub name: String,
    pub configuration: String,
    /// Whether it was fitted, only compared, or compared with a calibration without its configuration.
    pub role: Role,
    pub start: Distances,
    pub calibrated: Distances,
}

/// The least damped oscillation about hover.
#[derive(Serialize)]
pub struct HoverLine {
    pub configuration: String,
    pub frequency_hz: f64,
    /// Negative for one that grows.
    pub damping_ratio: f64,
}

#[derive(Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    Fitted,
    HeldOut,
    ConfigurationLeftOut,
}

#[derive(Serialize)]
pub struct Distances {
    pub quadrotor_m: f64,
    pub end_effector_m: f64,
    /// Of end-effector height minus quadrotor height, where the recording has it (the paper's swings).
    pub height_m: Option<f64>,
}

impl ParameterLine {
    pub fn new(start: f64, estimate: &Estimate) -> Self {
        let half_width = 1.96 * estimate.standard_error;
        let interval = [estimate.value - half_width, estimate.value + half_width];
        Self {
            name: estimate.name,
            start,
            value: estimate.value,
            interval: half_width.is_finite().then_some(interval),
            at_bound: estimate.at_bound,
        }
    }
}

impl Report {
    /// What the flights identify as a table; the others by name.
    pub fn parameter_table(&self) -> String {
        let rows = self.parameters.iter().filter_map(|line| {
            let [low, high] = line.interval?;
            let remark = if line.at_bound { "at its bound" } else { "" };
            Some(vec![
                line.name.to_owned(),
                significant(line.start),
                significant(line.value),
                format!("{} … {}", significant(low), significant(high)),
                remark.to_owned(),
            ])
        });
        let mut text = table(&["parameter", "start", "calibrated", "95 % interval", ""], rows);
        let unidentified: Vec<&str> = self
            .parameters
            .iter()
            .filter(|line| line.interval.is_none())
            .map(|line| line.name)
            .collect();
        if !unidentified.is_empty() {
            text += &format!("\nnot identified by these flights: {}", unidentified.join(", "));
        }
        text
    }

    pub fn flight_table(&self) -> String {
        let rows = self.flights.iter().map(|line| {
            let role = match line.role {
                Role::Fitted => "fitted",
                Role::HeldOut => "held out",
                Role::ConfigurationLeftOut => "configuration left out",
            };
            vec![
                line.name.clone(),
                line.configuration.clone(),
                role.to_owned(),
                centimetres(line.start.quadrotor_m),
                centimetres(line.calibrated.quadrotor_m),
                centimetres(line.start.end_effector_m),
                centimetres(line.calibrated.end_effector_m),
                line.calibrated.height_m.map_or_else(String::new, centimetres),
            ]
        });
        let header = [
            "replay against recording, cm",
            "configuration",
            "",
            "quadrotor, start",
            "calibrated",
            "end effector, start",
            "calibrated",
            "heights",
        ];
        table(&header, rows)
    }

    pub fn hover_table(&self) -> String {
        let rows = self.hover.iter().map(|line| {
            vec![
                line.configuration.clone(),
                format!("{:.2}", line.frequency_hz),
                format!("{:.3}", line.damping_ratio),
            ]
        });
        table(&["least damped about hover", "Hz", "damping ratio"], rows)
    }
}

/// Four significant digits.
fn significant(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude >= 1e-3 || magnitude == 0.0 {
        let digits = 3 - magnitude.max(1e-3).log10().floor() as i32;
        format!("{value:.*}", digits.max(0) as usize)
    } else {
        format!("{value:.3e}")
    }
}
