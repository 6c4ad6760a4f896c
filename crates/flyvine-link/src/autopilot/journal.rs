//! A recording that is on the disk row by row: what a killed process leaves behind is readable to its last whole row.

use std::io::Write;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use flyvine::flight::Configuration;
use flyvine::link::{Health, Mode, Observation, Vehicle, VehicleError};

use super::vehicle::Flags;

/// Rows that may wait for the disk: 10 s.
const QUEUE: usize = 200;

const HEADER: &str = "t_s,length_m,pressure_kpa,cmd_x,cmd_y,cmd_z,qr_x,qr_y,qr_z,qr_qw,qr_qx,qr_qy,qr_qz,ee_x,ee_y,ee_z,\
                      quadrotor_age_s,end_effector_age_s,autopilot_age_s,mode,armed\n";

/// A vehicle that writes down every step, from before arming until after landing, as a flight in CSV with the state of the
/// wires in further columns. A disk that fails raises [`Flags::recording_failed`]; the flight is never kept waiting for it.
pub struct Journaled<'a, V: Vehicle> {
    vehicle: &'a mut V,
    flags: Flags,
    rows: Option<SyncSender<String>>,
    writer: Option<JoinHandle<()>>,
    origin_s: Option<f64>,
    seen: Option<Observation>,
    mode: Mode,
}

impl<'a, V: Vehicle> Journaled<'a, V> {
    /// Creates the file at `path`.
    pub fn create(path: &Path, vehicle: &'a mut V, flags: &Flags) -> std::io::Result<Self> {
        let mut file = std::fs::File::create(path)?;
        let (rows, queue): (_, Receiver<String>) = sync_channel(QUEUE);
        let failed = flags.recording_failed.clone();
        let writer = std::thread::spawn(move || {
            let header = std::iter::once(HEADER.to_owned());
            for row in header.chain(queue) {
                // One write for a row, so that a kill cuts between rows.
                if file.write_all(row.as_bytes()).is_err() {
                    failed.store(true, Ordering::Relaxed);
                    return;
                }
            }
        });
        Ok(Self {
            vehicle,
            flags: flags.clone(),
            rows: Some(rows),
            writer: Some(writer),
            origin_s: None,
            seen: None,
            mode: Mode::Standby,
        })
    }

    fn write(&mut self, command: [f64; 3], configuration: Configuration) {
        let (Some(seen), Some(health), Some(rows)) = (self.seen, self.vehicle.health(), &self.rows) else {
            return;
        };
        let origin_s = *self.origin_s.get_or_insert(health.now_s);
        let row = row(&seen, &health, origin_s, command, configuration, self.mode);
        // A disk that is behind by that much is as bad as a full one.
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) = rows.try_send(row) {
            self.flags.recording_failed.store(true, Ordering::Relaxed);
        }
    }
}

fn row(
    seen: &Observation,
    health: &Health,
    origin_s: f64,
    command: [f64; 3],
    configuration: Configuration,
    mode: Mode,
) -> String {
    let mut cells = vec![
        format!("{:.4}", health.now_s - origin_s),
        configuration.length_m.to_string(),
        configuration.pressure_kpa.to_string(),
    ];
    cells.extend(command.iter().map(f64::to_string));
    match seen.quadrotor {
        Some(pose) => cells.extend(pose.position.iter().chain(&pose.attitude).map(f64::to_string)),
        None => cells.extend(std::iter::repeat_n(String::new(), 7)),
    }
    match seen.end_effector {
        Some(tip) => cells.extend(tip.iter().map(f64::to_string)),
        None => cells.extend(std::iter::repeat_n(String::new(), 3)),
    }
    for heard_s in [
        health.captured.quadrotor_s,
        health.captured.end_effector_s,
        health.autopilot_heard_s,
    ] {
        cells.push(format!("{:.4}", health.now_s - heard_s));
    }
    cells.push(format!("{mode:?}").to_lowercase());
    cells.push(health.armed.to_string());
    cells.join(",") + "\n"
}

impl<V: Vehicle> Vehicle for Journaled<'_, V> {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        let seen = self.vehicle.reset(configuration, seed)?;
        self.seen = Some(seen);
        Ok(seen)
    }

    fn step(&mut self, command: [f64; 3], configuration: Configuration) -> Result<Observation, VehicleError> {
        self.write(command, configuration);
        let seen = self.vehicle.step(command, configuration)?;
        self.seen = Some(seen);
        Ok(seen)
    }

    fn health(&self) -> Option<Health> {
        self.vehicle.health()
    }

    fn set_mode(&mut self, mode: Mode) {
        self.mode = mode;
        self.vehicle.set_mode(mode);
    }

    /// Waits for the disk.
    fn close(&mut self) -> Result<(), VehicleError> {
        self.rows = None;
        if let Some(writer) = self.writer.take() {
            // A writer that panicked has failed as one that could not write.
            if writer.join().is_err() {
                self.flags.recording_failed.store(true, Ordering::Relaxed);
            }
        }
        self.vehicle.close()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flyvine::flight::read_flight;
    use flyvine::link::Captured;

    /// A vehicle at rest with wires.
    struct Still(f64);

    const SEEN: Observation = Observation {
        t_s: 0.0,
        quadrotor: Some(flyvine::flight::Pose {
            position: [0.0, 0.0, 1.5],
            attitude: [1.0, 0.0, 0.0, 0.0],
        }),
        end_effector: None,
    };
    const ARM: Configuration = Configuration {
        length_m: 0.7,
        pressure_kpa: 0.0,
    };

    impl Vehicle for Still {
        fn reset(&mut self, _: Configuration, _: u64) -> Result<Observation, VehicleError> {
            Ok(SEEN)
        }

        fn step(&mut self, _: [f64; 3], _: Configuration) -> Result<Observation, VehicleError> {
            self.0 += flyvine::DT;
            Ok(SEEN)
        }

        fn health(&self) -> Option<Health> {
            Some(Health {
                now_s: self.0,
                captured: Captured {
                    quadrotor_s: self.0,
                    end_effector_s: f64::NEG_INFINITY,
                },
                autopilot_heard_s: self.0,
                arm_heard_s: None,
                missed_ticks: 0,
                armed: true,
                standing: false,
                mode: Some(Mode::Offboard),
                fault: None,
            })
        }
    }

    fn fly(path: &Path) -> (Flags, bool) {
        let flags = Flags::default();
        let mut vehicle = Still(0.0);
        let mut journaled = Journaled::create(path, &mut vehicle, &flags).unwrap();
        journaled.reset(ARM, 1).unwrap();
        for _ in 0..100 {
            journaled.step([0.0, 0.0, 1.5], ARM).unwrap();
        }
        journaled.close().unwrap();
        let failed = flags.recording_failed.load(Ordering::Relaxed);
        (flags, failed)
    }

    #[test]
    fn the_journal_is_a_flight() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.csv");
        assert!(!fly(&path).1);
        let flight = read_flight(&path).unwrap();
        assert_eq!(flight.samples.len(), 100);
        assert_eq!(flight.samples[3].quadrotor, SEEN.quadrotor);
        assert_eq!(flight.samples[3].end_effector, None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_told() {
        assert!(fly(Path::new("/dev/full")).1);
    }
}
