//! The simulated vehicle as a whole.

use flyvine::flight::Configuration;
use flyvine::link::{Setpoint, Vehicle};
use flyvine::sim::autopilot::Law;
use flyvine::sim::contact::BallParameters;
use flyvine::sim::{ParameterError, SimulatedVehicle, VehicleParameters, free};

const CORNERS: [(f64, f64); 4] = [(0.7, 0.0), (0.7, 0.4), (1.0, 0.0), (1.0, 0.4)];

fn corner(index: usize) -> Configuration {
    let (length_m, pressure_kpa) = CORNERS[index];
    Configuration {
        length_m,
        pressure_kpa,
    }
}

#[test]
fn hover_is_an_equilibrium() {
    for index in 0..4 {
        let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
        vehicle.reset(corner(index), 1).expect("a corner is in range");
        for _ in 0..400 {
            vehicle
                .step([0.0, 0.0, 1.5].into(), corner(index))
                .expect("flies");
        }
        let truth = vehicle.truth();
        let [x, y, z] = truth.quadrotor.position;
        assert!(
            x.abs().max(y.abs()).max((z - 1.5).abs()) < 1e-3,
            "corner {index}: {truth:?}"
        );
    }
}

#[test]
fn a_step_settles_in_every_corner() {
    for index in 0..4 {
        let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
        vehicle.reset(corner(index), 1).expect("a corner is in range");
        let mut late = 0.0_f64;
        for k in 0..400 {
            vehicle
                .step([0.5, 0.0, 1.5].into(), corner(index))
                .expect("flies");
            if k > 300 {
                late = late.max((vehicle.truth().end_effector[0] - 0.5).abs());
            }
        }
        assert!(
            late < 0.1,
            "corner {index}: the tip still swings by {late:.3} m after 15 s"
        );
    }
}

#[test]
fn same_seed_same_bits() {
    let fly = |seed| {
        let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
        let mut rows = vec![vehicle.reset(corner(3), seed).expect("a corner is in range")];
        for k in 0..100 {
            rows.push(
                vehicle
                    .step([0.01 * f64::from(k), 0.0, 1.5].into(), corner(3))
                    .expect("flies"),
            );
        }
        rows
    };
    assert_eq!(fly(7), fly(7));
    assert_ne!(fly(7), fly(8));
}

#[test]
fn rest_is_exact_in_any_configuration() {
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
    for (length_m, pressure_kpa) in [(0.5, 0.0), (0.83, 0.21), (1.1, 0.4), (1.2, 1.0)] {
        let configuration = Configuration {
            length_m,
            pressure_kpa,
        };
        vehicle.reset(configuration, 3).expect("in range");
        let truth = vehicle.truth();
        assert_eq!(truth.quadrotor.position, [0.0, 0.0, 1.5]);
        assert!(
            (truth.end_effector[2] - (1.5 - length_m)).abs() < 1e-12,
            "{truth:?}"
        );
        assert_eq!(truth.configuration, configuration);
    }
}

#[test]
fn deploys_from_short_and_empty_to_long_and_inflated() {
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    let mut last = 0.7;
    for k in 0..500 {
        let share = (f64::from(k) / 399.0).min(1.0);
        let wanted = Configuration {
            length_m: 0.7 + 0.3 * share,
            pressure_kpa: 0.4 * share,
        };
        vehicle
            .step([0.0, 0.0, 1.5 + 0.3 * share].into(), wanted)
            .expect("flies");
        let now = vehicle.truth().configuration;
        assert!(
            now.length_m - last <= 0.02 * 0.05 + 1e-9,
            "grows faster than 2 cm/s at {k}"
        );
        last = now.length_m;
    }
    let truth = vehicle.truth();
    assert!((truth.configuration.length_m - 1.0).abs() < 2e-3, "{truth:?}");
    assert!((truth.configuration.pressure_kpa - 0.4).abs() < 0.05, "{truth:?}");
    let distance = truth.quadrotor.position[2] - truth.end_effector[2];
    assert!((distance - 1.0).abs() < 0.02, "{truth:?}");
}

/// A jump of the length setpoint is answered at the motor's rate, not at once.
#[test]
fn growth_rate_is_limited() {
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    for _ in 0..100 {
        vehicle.step([0.0, 0.0, 1.5].into(), corner(2)).expect("flies");
    }
    let length = vehicle.truth().configuration.length_m;
    assert!((0.79..=0.80).contains(&length), "after 5 s at 2 cm/s: {length}");
}

#[test]
fn missed_poses_are_counted() {
    let mut parameters = VehicleParameters::default();
    parameters.mocap.dropout_probability = 0.1;
    parameters.mocap.freeze_probability = 0.02;
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    let before = vehicle.truth().mocap_faults;
    let (mut missed, mut repeated, mut last) = (0, 0, None);
    for _ in 0..1000 {
        let seen = vehicle.step([0.0, 0.0, 1.5].into(), corner(0)).expect("flies");
        missed += usize::from(seen.quadrotor.is_none()) + usize::from(seen.end_effector.is_none());
        repeated += usize::from(seen.end_effector.is_some() && seen.end_effector == last);
        last = seen.end_effector.or(last);
    }
    let faults = vehicle.truth().mocap_faults;
    assert_eq!(faults.dropped - before.dropped, missed);
    assert!((120..280).contains(&missed), "{missed}");
    assert!(repeated > 20, "{repeated}");
}

#[test]
fn wind_and_payload_are_trimmed_at_the_start_and_felt_afterwards() {
    let mut parameters = VehicleParameters::default();
    parameters.payload.tip_mass_kg = 0.05;
    parameters.wind.mean_m_s = [2.0, 0.0, 0.0];
    parameters.wind.gust_m_s = 0.7;
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(corner(3), 1).expect("a corner is in range");
    let truth = vehicle.truth();
    let offset = truth.quadrotor.position[0].hypot(truth.quadrotor.position[2] - 1.5);
    assert!(offset < 0.15, "{truth:?}");
    // The arm hangs downwind.
    assert!(
        truth.end_effector[0] - truth.quadrotor.position[0] > 0.005,
        "{truth:?}"
    );
}

/// The guide's table of PX4's parameters says what the built-in vehicle has.
#[test]
fn the_guide_lists_the_autopilots_parameters() {
    let guide = std::fs::read_to_string(
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guide/src/own-vehicle.md"),
    )
    .expect("the guide is in the repository");
    let defaults = toml::Table::try_from(VehicleParameters::default()).expect("serializes");
    let autopilot = defaults["autopilot"].as_table().expect("a table");
    let mut listed = vec![];
    for row in guide
        .lines()
        .filter(|line| line.starts_with("| `") && !line.contains('{'))
    {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let path = cells[1].trim_matches('`');
        let value = match path.split_once('.') {
            Some((table, key)) => &autopilot[table][key],
            None => &autopilot[path],
        };
        let found: f64 = cells[4].parse().expect("a number");
        assert_eq!(value.as_float(), Some(found), "{path}");
        listed.push(path);
    }
    for table in ["position", "attitude", "rate"] {
        for key in autopilot[table].as_table().expect("a table").keys() {
            assert!(
                listed.contains(&format!("{table}.{key}").as_str()),
                "{table}.{key}"
            );
        }
    }
}

#[test]
fn toml_round_trip_and_partial_files() {
    let defaults = VehicleParameters::default();
    let text = toml::to_string(&defaults).expect("serializes");
    assert_eq!(VehicleParameters::from_toml(&text), Ok(defaults));
    let partial = VehicleParameters::from_toml("[payload]\ntip_mass_kg = 0.05\n").expect("valid");
    assert_eq!(partial.payload.tip_mass_kg, 0.05);
    assert_eq!(partial.arm, VehicleParameters::default().arm);
}

#[test]
fn bad_parameters_are_refused_by_name() {
    for (toml, expected) in [
        ("[quadrotor]\ntotal_mass_kg = -1.0", "quadrotor.total_mass_kg"),
        ("[quadrotor]\ntotal_mass_kg = nan", "quadrotor.total_mass_kg"),
        ("[quadrotor]\nmax_thrust_n = 10.0", "quadrotor.max_thrust_n"),
        (
            "[quadrotor]\ninertia_kg_m2 = [0.01, inf, 0.01]",
            "quadrotor.inertia_kg_m2",
        ),
        ("[simulation]\nmax_step_s = 0.1", "simulation.max_step_s"),
        ("[simulation]\nlinks = 0", "simulation.links"),
        ("[arm]\nlength_range_m = [0.1, 1.0]", "arm.length_range_m"),
        ("[arm]\nlength_range_m = [0.9, 0.8]", "arm.length_range_m"),
        ("[arm]\nlinear_density_kg_m = 0.5", "arm.tip_mass_kg"),
        ("[arm]\nmax_growth_rate_m_s = 3.0", "arm.max_growth_rate_m_s"),
        ("[autopilot]\nrate_period_s = 0.0033", "autopilot.rate_period_s"),
        ("[autopilot]\nposition_divider = 0", "autopilot.position_divider"),
        (
            "[autopilot.position]\ntilt_max_deg = 90.0",
            "autopilot.position.tilt_max_deg",
        ),
        ("[mocap]\ndropout_probability = 1.5", "mocap.dropout_probability"),
        ("[wind]\ngust_m_s = -0.1", "wind.gust_m_s"),
        ("[pneumatics]\nleak_m3_s_kpa = nan", "pneumatics.leak_m3_s_kpa"),
        ("[payload]\ntip_mass = 0.1", "tip_mass"),
        ("[payload\n", "vehicle TOML"),
    ] {
        let error = VehicleParameters::from_toml(toml).expect_err(toml);
        assert!(error.to_string().contains(expected), "{toml}: {error}");
    }
    let mut parameters = VehicleParameters::default();
    parameters.arm.corners.empty_long.stiffness_n_m2 = f64::NAN;
    let error = SimulatedVehicle::new(parameters).expect_err("NaN");
    assert!(matches!(error, ParameterError::NotFinite { .. }), "{error}");
}

/// A tied beam's parameters change both lengths' beams, and nothing of the other pressure's.
#[test]
fn tied_beams_change_both_lengths() {
    let defaults = VehicleParameters::default();
    for tied in free::tied_beams() {
        let mut changed = defaults.clone();
        (tied.set)(&mut changed, 1.1 * (tied.get)(&defaults));
        let (old, new) = (&defaults.arm.corners, &changed.arm.corners);
        let pairs = [
            (old.empty_short, new.empty_short),
            (old.empty_long, new.empty_long),
            (old.inflated_short, new.inflated_short),
            (old.inflated_long, new.inflated_long),
        ];
        let empty = tied.name.starts_with("arm.corners.empty");
        assert_eq!(
            pairs.map(|(a, b)| a != b),
            [empty, empty, !empty, !empty],
            "{}",
            tied.name
        );
    }
}

#[test]
fn bad_commands_are_refused() {
    let mut vehicle = SimulatedVehicle::new(VehicleParameters::default()).expect("defaults are valid");
    assert!(
        vehicle
            .reset(
                Configuration {
                    length_m: 5.0,
                    pressure_kpa: 0.0
                },
                0
            )
            .is_err()
    );
    assert!(
        vehicle
            .reset(
                Configuration {
                    length_m: 0.7,
                    pressure_kpa: f64::NAN
                },
                0
            )
            .is_err()
    );
    vehicle.reset(corner(0), 0).expect("a corner is in range");
    assert!(vehicle.step([f64::NAN, 0.0, 1.5].into(), corner(0)).is_err());
    assert!(vehicle.step([0.0, 0.0, 1.5].into(), corner(0)).is_ok());
}

/// The second flight controller has another structure, but the same job.
#[test]
fn geometric_law_hovers_and_follows() {
    for index in 0..4 {
        let mut parameters = VehicleParameters::default();
        parameters.autopilot.law = Law::Geometric;
        let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
        vehicle.reset(corner(index), 1).expect("a corner is in range");
        for _ in 0..300 {
            vehicle
                .step([0.5, 0.2, 1.6].into(), corner(index))
                .expect("flies");
        }
        let [x, y, z] = vehicle.truth().quadrotor.position;
        let miss = (x - 0.5).abs().max((y - 0.2).abs()).max((z - 1.6).abs());
        assert!(miss < 0.08, "corner {index}: {miss:.3} m off after 15 s");
    }
}

#[test]
fn heading_drifts_with_its_estimate() {
    let mut parameters = VehicleParameters::default();
    parameters.autopilot.yaw_drift_deg_s = 0.5;
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    for _ in 0..400 {
        vehicle.step([0.0, 0.0, 1.5].into(), corner(0)).expect("flies");
    }
    let yaw = (2.0 * vehicle.truth().quadrotor.attitude[3]).to_degrees();
    assert!(
        (yaw + 10.0).abs() < 1.0,
        "20 s at 0.5 degrees/s: {yaw:.2} degrees"
    );
}

#[test]
fn sagging_battery_is_made_up_for() {
    let mut parameters = VehicleParameters::default();
    parameters.quadrotor.battery_sag_per_minute = 0.2;
    parameters.quadrotor.ground_effect_radius_m = 0.2;
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    for _ in 0..600 {
        vehicle.step([0.0, 0.0, 1.5].into(), corner(0)).expect("flies");
    }
    let height = vehicle.truth().quadrotor.position[2];
    assert!(
        (height - 1.5).abs() < 0.05 && (height - 1.5).abs() > 1e-5,
        "{height}"
    );
}

/// Flying at the ball kicks it; nothing is kicked that is not touched.
#[test]
fn kicks_a_ball() {
    let mut parameters = VehicleParameters::default();
    parameters.contact.ball = Some(BallParameters {
        position_m: [1.0, 0.0, 0.8],
        radius_m: 0.2,
        mass_kg: 0.06,
    });
    parameters.contact.floor_m = Some(0.0);
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    for _ in 0..20 {
        vehicle.step([0.0, 0.0, 1.5].into(), corner(0)).expect("flies");
    }
    assert_eq!(vehicle.truth().ball, Some([1.0, 0.0, 0.8]));
    for _ in 0..60 {
        vehicle.step([1.5, 0.0, 1.5].into(), corner(0)).expect("flies");
    }
    let [x, _, z] = vehicle.truth().ball.expect("there is a ball");
    assert!(
        x > 1.3 && (0.2..0.8).contains(&z),
        "the ball is at {x:.2}, {z:.2}"
    );
}

/// A floor holds the tip.
#[test]
fn tip_stands_on_the_floor() {
    let mut parameters = VehicleParameters::default();
    parameters.contact.floor_m = Some(0.7);
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    for k in 0..100 {
        vehicle
            .step([0.0, 0.0, 1.5 - 0.001 * f64::from(k)].into(), corner(0))
            .expect("flies");
    }
    let truth = vehicle.truth();
    assert!((truth.end_effector[2] - 0.75).abs() < 0.01, "{truth:?}");
    assert!(truth.quadrotor.position[2] < 1.45, "{truth:?}");
}

#[test]
fn late_and_mistaken_poses() {
    let fly = |latency_s: f64, swap_probability: f64| {
        let mut parameters = VehicleParameters::default();
        parameters.mocap.latency_s = latency_s;
        parameters.mocap.swap_probability = swap_probability;
        parameters.mocap.position_noise_m = 0.0;
        let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
        vehicle.reset(corner(0), 1).expect("a corner is in range");
        let mut seen = vec![];
        for _ in 0..40 {
            let observation = vehicle.step([1.0, 0.0, 1.5].into(), corner(0)).expect("flies");
            seen.push(observation.quadrotor.expect("no dropouts").position);
        }
        (seen, vehicle.truth().mocap_faults.swapped)
    };
    let (now, _) = fly(0.0, 0.0);
    let (late, _) = fly(0.1, 0.0);
    assert_eq!(now[..38], late[2..]);
    let (mistaken, swapped) = fly(0.0, 0.2);
    assert_eq!(swapped, now.iter().zip(&mistaken).filter(|(a, b)| a != b).count());
    assert!(swapped > 0);
}

/// Cameras of 4 Hz, asked at 20 Hz, show every pose five times.
#[test]
fn poses_come_at_the_cameras_rate() {
    let mut parameters = VehicleParameters::default();
    parameters.mocap.rate_hz = Some(4.0);
    parameters.mocap.position_noise_m = 0.0;
    let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
    vehicle.reset(corner(0), 1).expect("a corner is in range");
    let mut seen = vec![];
    for _ in 0..40 {
        let observation = vehicle.step([1.0, 0.0, 1.5].into(), corner(0)).expect("flies");
        seen.push(observation.end_effector);
    }
    seen.dedup();
    assert!((8..=9).contains(&seen.len()), "{} different poses", seen.len());
}

#[test]
fn lost_commands_are_counted_and_change_nothing_else() {
    let fly = |command_dropout_probability| {
        let mut parameters = VehicleParameters::default();
        parameters.autopilot.command_dropout_probability = command_dropout_probability;
        let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
        vehicle.reset(corner(0), 1).expect("a corner is in range");
        for k in 0..200 {
            vehicle
                .step([0.002 * f64::from(k), 0.0, 1.5].into(), corner(0))
                .expect("flies");
        }
        let truth = vehicle.truth();
        (truth.lost_commands, truth.quadrotor.position[0])
    };
    let (none, all_heard) = fly(0.0);
    let (some, mostly_heard) = fly(0.3);
    let (all, unmoved) = fly(1.0);
    assert_eq!((none, all), (0, 200));
    assert!((35..=85).contains(&some), "{some} of 200 lost at 30 %");
    assert!((mostly_heard - all_heard).abs() < 0.02 && mostly_heard != all_heard);
    assert!(unmoved.abs() < 1e-6, "{unmoved}");
}

/// A position that moves at a constant speed is followed late by v / P; sent its velocity, too, hardly at all.
#[test]
fn velocity_feed_forward_makes_up_for_the_lag() {
    let speed = 0.5;
    for law in [Law::Cascade, Law::Geometric] {
        let lag = |fed_forward: f64| {
            let mut parameters = VehicleParameters::default();
            parameters.autopilot.law = law;
            let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
            vehicle.reset(corner(3), 1).expect("a corner is in range");
            let mut command = 0.0;
            for k in 0..160 {
                command = speed * flyvine::DT * f64::from(k);
                let setpoint = Setpoint {
                    position: [command, 0.0, 1.5],
                    velocity: Some([fed_forward, 0.0, 0.0]),
                };
                vehicle.step(setpoint, corner(3)).expect("flies");
            }
            command - vehicle.truth().quadrotor.position[0]
        };
        let (without, with) = (lag(0.0), lag(speed));
        assert!(
            with.abs() < 0.4 * without && without > 0.1,
            "{law:?}: {without:.3} m without, {with:.3} m with"
        );
    }
}

/// The default step's error is far below what anybody could measure in flight.
#[test]
fn default_step_is_converged() {
    let fly = |max_step_s: f64, slip_moment_n_m: f64, index: usize| {
        let mut parameters = VehicleParameters::default();
        parameters.simulation.max_step_s = max_step_s;
        parameters.arm.slip_moment_n_m = slip_moment_n_m;
        let mut vehicle = SimulatedVehicle::new(parameters).expect("valid");
        vehicle.reset(corner(index), 1).expect("a corner is in range");
        (0..100)
            .map(|k| {
                let x = if k % 50 < 15 { 1.0 } else { 0.0 };
                vehicle
                    .step([x, 0.3 * x, 1.5].into(), corner(index))
                    .expect("flies");
                vehicle.truth().end_effector
            })
            .collect::<Vec<_>>()
    };
    // With and without hysteresis.
    for (index, slip) in [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0), (1, 0.02), (2, 0.02)] {
        let (default, fine) = (fly(2.5e-3, slip, index), fly(2.5e-3 / 16.0, slip, index));
        let squares: f64 = default
            .iter()
            .zip(&fine)
            .map(|(a, b)| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>())
            .sum();
        let rms = (squares / default.len() as f64).sqrt();
        assert!(
            rms < 2e-3,
            "corner {index}, slip {slip}: tip off by {:.3} mm",
            1e3 * rms
        );
    }
}
