//! An arm in software on a pseudo-terminal: the firmware's own device with a simulated spool and tube.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use vine_arm::plant::{Plant, PlantParameters};
use vine_arm::{Device, Limits};

use super::line::Pty;

/// Control period, as on the board.
const PERIOD: Duration = Duration::from_millis(5);

/// A running software arm; dropping it ends it.
#[derive(Debug)]
pub struct SoftwareArm {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
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
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("software arm".into())
            .spawn(move || serve(pty, device, Plant::at(plant, length_m), &stopped))?;
        Ok(SoftwareArm {
            path,
            stop,
            thread: Some(thread),
        })
    }

    /// The serial port to open.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for SoftwareArm {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of its own has been reported already.
            let _ = thread.join();
        }
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
