//! Vehicles drawn around the default one, flown for 20 s: nothing may leave the finite numbers, and whatever does not come
//! to rest again must have a reason in the drawn vehicle's own hover, not in the integration.
//!
//! ```text
//! cargo test --release --workspace --test randomized -- --ignored --nocapture
//! ```

#![allow(clippy::print_stdout)] // the campaign's table is for people

use flyvine::DT;
use flyvine::flight::Configuration;
use flyvine::link::Vehicle;
use flyvine::sim::{SimulatedVehicle, VehicleParameters, randomized};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Commands of a flight, at 20 Hz: 14 s of motion, then a hover of 6 s in which the arm must come to rest.
const ROWS: usize = 400;
const HOVER_FROM: usize = 280;
/// The tip counts as at rest if it stays this near its mean over the last 2 s, m. Gusts alone move it by some 0.1 m.
const REST_M: f64 = 0.25;
/// Nothing sensible leaves this distance from the start, m.
const ROOM_M: f64 = 5.0;

/// One drawn vehicle and what it shall fly.
struct Case {
    index: u64,
    parameters: VehicleParameters,
}

/// How a flight ended.
#[derive(Debug, Clone, Copy, PartialEq)]
enum End {
    /// At rest again.
    Settled,
    /// Still swinging by so much, m.
    Swings(f64),
    /// Out of the room.
    Lost,
    /// Not finite.
    Diverged,
}

/// Why a flight did not come to rest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Reason {
    /// Flown with half the step, it comes to rest, and its hover is well damped: a fault of the integration.
    Step,
    /// Undisturbed, with the drawn gains, delays and masses, a small swing about hover grows.
    HoverUnstable,
    /// A small swing about hover dies, but takes more than 2 s to halve.
    HoverLightlyDamped,
    /// In calm air the flight comes to rest.
    Wind,
    /// Flown half as far, it comes to rest: the swing's amplitude is what the gains cannot hold.
    LargeMotion,
    /// With half the step it settles, but commands that are a tenth of a millimetre off decide as well.
    Hair,
    /// It takes both, calm air and half the distance or a fifth of it.
    WindAndLargeMotion,
    /// None of these.
    Unknown,
}

impl Case {
    /// Vehicle number `index`: everything that is calibrated ±30 %, a payload of up to 50 g, wind of up to 1.4 m/s with
    /// gusts of up to 0.5 m/s.
    fn draw(index: u64) -> Case {
        let mut random = ChaCha8Rng::seed_from_u64(17);
        random.set_stream(index);
        let mut parameters = randomized(&VehicleParameters::default(), 0.3, &mut random);
        parameters.payload.tip_mass_kg = 0.05 * random.random::<f64>();
        parameters.wind.mean_m_s = [
            2.0 * random.random::<f64>() - 1.0,
            2.0 * random.random::<f64>() - 1.0,
            0.0,
        ];
        parameters.wind.gust_m_s = 0.5 * random.random::<f64>();
        Case { index, parameters }
    }

    /// One of the four corners, or deployment from ES to IL within 15 s.
    fn configuration(&self, row: usize) -> Configuration {
        let (length_m, pressure_kpa) = match self.index % 5 {
            0 => (0.7, 0.0),
            1 => (0.7, 0.4),
            2 => (1.0, 0.0),
            3 => (1.0, 0.4),
            _ => {
                let share = (row as f64 / 300.0).min(1.0);
                (0.7 + 0.3 * share, 0.4 * share)
            }
        };
        Configuration {
            length_m,
            pressure_kpa,
        }
    }

    /// The horizontal part of the command `size` times as far.
    fn command(&self, row: usize, size: f64) -> [f64; 3] {
        let [x, y, z] = self.full_command(row);
        [size * x, size * y, z]
    }

    /// Steps of ±1 m, a lemniscate of 5 s, or the swing's trapezoid again and again.
    fn full_command(&self, row: usize) -> [f64; 3] {
        let t = row as f64 * DT;
        if row >= HOVER_FROM {
            return [0.0, 0.0, 1.5];
        }
        match self.index / 5 % 3 {
            0 => [if row % 80 < 40 { 1.0 } else { -1.0 }, 0.0, 1.5],
            1 => {
                let s = std::f64::consts::TAU * t / 5.0;
                [s.sin(), s.cos() * s.sin(), 1.5 + 0.1 * (0.5 * s).sin()]
            }
            _ => {
                let k = (row % 50) as f64;
                let x = (-0.1 * k).max(-0.8) + 0.2 * (k - 14.0).clamp(0.0, 8.0)
                    - 0.08 * (k - 30.0).clamp(0.0, 10.0);
                [x, 0.0, 1.5]
            }
        }
    }

    fn fly(&self, parameters: &VehicleParameters, size: f64) -> End {
        let mut vehicle = SimulatedVehicle::new(parameters.clone()).expect("30 % stays within the ranges");
        vehicle
            .reset(self.configuration(0), self.index)
            .expect("the configuration is in range");
        let mut late = vec![];
        for row in 0..ROWS {
            if vehicle
                .step(self.command(row, size).into(), self.configuration(row))
                .is_err()
            {
                return End::Diverged;
            }
            let (quadrotor, tip) = vehicle.positions();
            if !(quadrotor.norm() < ROOM_M && tip.norm() < ROOM_M) {
                return End::Lost;
            }
            if row >= ROWS - 40 {
                late.push(tip);
            }
        }
        let mean = late.iter().sum::<Vector3<f64>>() / late.len() as f64;
        let swing = late.iter().map(|tip| (tip - mean).norm()).fold(0.0, f64::max);
        if swing < REST_M {
            End::Settled
        } else {
            End::Swings(swing)
        }
    }

    fn explain(&self) -> Reason {
        let mut fine = self.parameters.clone();
        fine.simulation.max_step_s /= 2.0;
        // The deployment hovers in several configurations on its way. The step has a say in how fast a swing grows: in 3 of
        // 5,000 vehicles half of it changed what was left after 6 s by more than a quarter.
        let remaining = [0, HOVER_FROM / 2, ROWS - 1]
            .map(|row| remaining_swing(&fine, self.configuration(row)))
            .into_iter()
            .fold(0.0, f64::max);
        if remaining > 1.0 {
            return Reason::HoverUnstable;
        }
        if remaining > 0.125 {
            return Reason::HoverLightlyDamped;
        }
        if self.fly(&fine, 1.0) == End::Settled {
            let hair = [1e-4, -1e-4, 1e-5, -1e-5].into_iter().any(|hair| {
                self.fly(&self.parameters, 1.0 + hair) == End::Settled
                    || self.fly(&fine, 1.0 + hair) != End::Settled
            });
            return if hair { Reason::Hair } else { Reason::Step };
        }
        let mut calm = self.parameters.clone();
        calm.wind = VehicleParameters::default().wind;
        let settles = |parameters: &VehicleParameters, size| self.fly(parameters, size) == End::Settled;
        if settles(&calm, 1.0) {
            Reason::Wind
        } else if settles(&self.parameters, 0.5) {
            Reason::LargeMotion
        } else if [0.5, 0.2].iter().any(|size| settles(&calm, *size)) {
            Reason::WindAndLargeMotion
        } else {
            Reason::Unknown
        }
    }
}

/// A nudge at hover in calm air: how much of the tip's swing is left after 6 s (above 1 it has grown).
fn remaining_swing(parameters: &VehicleParameters, configuration: Configuration) -> f64 {
    let mut parameters = parameters.clone();
    parameters.wind = VehicleParameters::default().wind;
    let mut vehicle = SimulatedVehicle::new(parameters).expect("flown before");
    vehicle.reset(configuration, 0).expect("in range");
    let mut tips = vec![];
    for row in 0..200 {
        let x = if row < 4 { 0.05 } else { 0.0 };
        if vehicle.step([x, 0.0, 1.5].into(), configuration).is_err() {
            return f64::INFINITY;
        }
        tips.push(vehicle.positions().1.x);
    }
    let range = |tips: &[f64]| {
        tips.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b))
            - tips.iter().fold(f64::INFINITY, |a, b| a.min(*b))
    };
    range(&tips[160..]) / range(&tips[40..80])
}

/// Flies these vehicles and prints how they ended. None may leave the finite numbers, and none may fail for the sake
/// of the integration's step or without a known reason.
fn campaign(vehicles: Range<u64>) {
    let ends: Vec<(End, Option<Reason>)> = vehicles
        .clone()
        .into_par_iter()
        .map(|index| {
            let case = Case::draw(index);
            let end = case.fly(&case.parameters, 1.0);
            (end, (end != End::Settled).then(|| case.explain()))
        })
        .collect();
    let mut table: BTreeMap<Option<Reason>, [usize; 4]> = BTreeMap::new();
    for (end, reason) in &ends {
        let column = match end {
            End::Settled => 0,
            End::Swings(_) => 1,
            End::Lost => 2,
            End::Diverged => 3,
        };
        table.entry(*reason).or_default()[column] += 1;
    }
    println!("vehicles {vehicles:?}: settled, still swinging, out of the room, not finite");
    for (reason, counts) in &table {
        println!("{counts:6?} {reason:?}");
    }
    let unexplained: Vec<_> = vehicles
        .zip(&ends)
        .filter(|(_, (end, reason))| {
            *end == End::Diverged || matches!(reason, Some(Reason::Step | Reason::Unknown))
        })
        .collect();
    assert!(unexplained.is_empty(), "{unexplained:?}");
}

#[test]
fn sixty_vehicles_fly_for_twenty_seconds() {
    campaign(0..60);
}

/// The default vehicle itself: a small swing dies in every configuration, and every flight stays in the room. Not all come
/// to rest within 6 s: the short inflated arm, whose mode of 0.8 Hz is damped by less than a fiftieth (`tests/hover.rs`), holds
/// a swing of more than a metre when it is excited again and again.
#[test]
fn the_default_vehicle_is_stable_about_hover() {
    for length_m in [0.6, 0.7, 0.85, 1.0, 1.1] {
        for pressure_kpa in [0.0, 0.2, 0.4] {
            let configuration = Configuration {
                length_m,
                pressure_kpa,
            };
            let remaining = remaining_swing(&VehicleParameters::default(), configuration);
            assert!(remaining < 0.8, "{configuration:?}: {remaining:.2} after 6 s");
        }
    }
    for index in 0..15 {
        let case = Case {
            index,
            parameters: VehicleParameters::default(),
        };
        let end = case.fly(&case.parameters, 1.0);
        assert!(
            !matches!(end, End::Lost | End::Diverged),
            "flight {index}: {end:?}"
        );
    }
}

/// The whole campaign, or the part of it that `FLYVINE_VEHICLES` names, as in `1606..1607`.
#[test]
#[ignore = "takes 25 minutes of one core"]
fn ten_thousand_vehicles_fly_for_twenty_seconds() {
    let text = std::env::var("FLYVINE_VEHICLES").unwrap_or("0..10000".to_owned());
    let (first, end) = text.split_once("..").expect("FLYVINE_VEHICLES: FIRST..END");
    campaign(first.parse().expect("a number")..end.parse().expect("a number"));
}
