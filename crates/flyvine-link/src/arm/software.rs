//! An arm in software on a pseudo-terminal: the firmware's own device with a simulated spool and tube.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use vine_arm::plant::{Plant, PlantParameters};
use vine_arm::{Device, Limits};

use super::line::Pty;
use crate::worker::Worker;

/// Control period, as on the board.
const PERIOD: Duration = Duration::from_millis(5);

/// A running software arm; dropping it ends it.
#[derive(Debug)]
pub struct SoftwareArm {
    path: PathBuf,
    _worker: Worker,
}

impl SoftwareArm {
    /// Starts an arm of `length_m` with `limits`, on a new pseudo-terminal and in its own thread.
    ///
    /// # Errors
    /// The system has no pseudo-terminal left, or the limits are impossible.
    pub fn start(limits: Limits, plant: PlantParameters, length_m: f32) -> io::Result<SoftwareArm> {
        let device =
            Device::new(limits).map_err(|error| io::Error::new(io::ErrorKind::InvalidInput, error))?;
        let pty = Pty::open()?;
        let path = pty.path.clone();
        let worker = Worker::start("software arm", move |stop| {
            serve(pty, device, Plant::at(plant, length_m), &stop);
        })?;
        Ok(SoftwareArm {
            path,
            _worker: worker,
        })
    }

    /// The serial port to open.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// The firmware's main loop: bytes in, one control step every 5 ms, bytes out.
fn serve(mut pty: Pty, mut device: Device, mut plant: Plant, stop: &AtomicBool) {
    let mut last = Instant::now();
    let mut outbox = Vec::new();
    while !stop.load(Ordering::Relaxed) {
        let wait = PERIOD.saturating_sub(last.elapsed());
        let wait = Timespec::try_from(wait).expect("a few milliseconds");
        let _ = poll(&mut [PollFd::new(&pty.file, PollFlags::IN)], Some(&wait));

        let mut bytes = [0; 512];
        if let Ok(count) = pty.file.read(&mut bytes) {
            device.receive(&bytes[..count], |frame| outbox.extend_from_slice(frame));
        }
        let elapsed = last.elapsed();
        if elapsed >= PERIOD {
            last += elapsed;
            let elapsed_us = elapsed.as_micros().min(u128::from(u32::MAX)) as u32;
            let actuators = device.step(elapsed_us, plant.sensors(), |frame| {
                outbox.extend_from_slice(frame)
            });
            plant.step(elapsed.as_secs_f32(), actuators);
        }
        // Where nobody reads, the line is full and the bytes are lost, as on a real one.
        let _ = pty.file.write(&outbox);
        outbox.clear();
    }
}
