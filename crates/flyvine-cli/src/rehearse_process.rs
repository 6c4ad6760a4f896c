//! The processes of a rehearsal: they end with whoever started them, and suffer what the script has for them.

use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use anyhow::Context;
use flyvine_link::rehearsal::{FaultKind, STALL_S};
use rustix::process::{Pid, Resource, Rlimit, Signal, kill_process, prlimit};

use crate::outcome::{Blame, Failure};

/// How long a process may take to end in good order.
const END_PATIENCE: Duration = Duration::from_secs(2);

/// A child process that does not outlive its owner.
pub struct Process {
    /// The child.
    pub child: Child,
}

impl Process {
    /// Starts `command`; `what` is what error messages call it.
    pub fn spawn(what: &str, command: &mut Command) -> Result<Self, Failure> {
        // Ctrl-C is for this process alone to hear: it decides who is told.
        let child = command
            .process_group(0)
            .spawn()
            .with_context(|| format!("cannot start {what}"))
            .or_internal()?;
        Ok(Self { child })
    }

    /// The lines of its stdout, as they come.
    pub fn lines(&mut self) -> Receiver<String> {
        let (sender, receiver) = channel();
        if let Some(stdout) = self.child.stdout.take() {
            std::thread::spawn(move || {
                for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
        }
        receiver
    }

    /// What the script does to this process.
    pub fn suffer(&mut self, kind: FaultKind) -> Result<(), Failure> {
        let pid = Pid::from_child(&self.child);
        match kind {
            FaultKind::BaseKilled => self.kill(),
            FaultKind::BaseStalls => {
                kill_process(pid, Signal::STOP).or_internal()?;
                std::thread::sleep(Duration::from_secs_f64(STALL_S));
                kill_process(pid, Signal::CONT).or_internal()?;
            }
            // Its files may not grow any more.
            FaultKind::DiskFull => {
                let full = Rlimit {
                    current: Some(0),
                    maximum: None,
                };
                prlimit(Some(pid), Resource::Fsize, full).or_internal()?;
            }
            _ => (),
        }
        Ok(())
    }

    /// Ends it at once.
    pub fn kill(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let pid = Pid::from_child(&self.child);
            let _ = kill_process(pid, Signal::TERM);
            // It may have an emulator to end, too.
            let begun = Instant::now();
            while let Ok(None) = self.child.try_wait()
                && begun.elapsed() < END_PATIENCE
            {
                std::thread::sleep(Duration::from_millis(10));
            }
            self.kill();
        }
        let _ = self.child.wait();
    }
}
