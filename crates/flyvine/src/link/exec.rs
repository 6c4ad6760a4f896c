//! `exec:PROGRAM ARGS`: a vehicle in a child process, one JSON object per line, in lockstep.
//!
//! ```text
//! → {"reset": {"length_m": 0.7, "pressure_kpa": 0.0, "seed": 1}}      ← the pose at t_s = 0
//! → {"cmd": [x, y, z], "length_m": l, "pressure_kpa": p}              ← the newest pose, 50 ms later
//! → {"cmd": [x, y, z], "cmd_velocity": [vx, vy, vz], …}               the same, where velocities are sent
//! → {"close": true}                                                   ← exit 0 within 2 s
//!
//! ← {"t_s": t, "qr": [x, y, z], "q": [w, x, y, z], "ee": [x, y, z]}
//! ```
//!
//! World frame ENU, metres, metres per second; `q` is Hamilton, world_from_body. `qr` and `q` are both null where motion capture
//! missed the quadrotor, `ee` where it missed the end effector; further keys are ignored. `t_s` is the
//! vehicle's own time, not the capture time of its newest pose: after k commands it must be within 25 ms of k
//! · 50 ms, so a reply that is lost, doubled or integrated over another step is caught at once and a clock
//! cannot drift away.
//!
//! The child is never trusted: replies are bounded in length and in wall time, and every way of failing has a
//! name in [`ExecFault`]. After a fault the child is killed and reaped, and the vehicle answers no more.

mod child;
mod reply;

use std::fmt;
use std::io::Write;
use std::time::Duration;

use serde::Serialize;

use super::{Observation, Setpoint, Vehicle, VehicleError};
use crate::DT;
use crate::flight::Configuration;
use child::Child;

/// How far `t_s` may be from k · 50 ms, s.
const CLOCK_TOLERANCE_S: f64 = 0.5 * DT;

/// Limits of wall time, and where the child's stderr goes.
pub struct ExecOptions {
    /// A reply later than this is a stall.
    pub reply_limit: Duration,
    /// Time to exit after `{"close": true}`.
    pub close_limit: Duration,
    /// Receives the child's stderr as it comes; its end is kept for error messages in any case.
    pub stderr_sink: Option<Box<dyn Write + Send>>,
}

impl Default for ExecOptions {
    fn default() -> Self {
        Self {
            reply_limit: Duration::from_secs(10),
            close_limit: Duration::from_secs(2),
            stderr_sink: None,
        }
    }
}

/// A fault of a vehicle in a child process.
#[derive(Debug, thiserror::Error)]
pub struct ExecError {
    /// The command line, without `exec:`.
    pub program: String,
    /// Commands answered since the last reset.
    pub steps: u64,
    /// What went wrong.
    pub fault: ExecFault,
    /// The end of what the child wrote to stderr.
    pub stderr: String,
}

impl fmt::Display for ExecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "vehicle `{}`, after {} commands: {}",
            self.program, self.steps, self.fault
        )?;
        if !self.stderr.is_empty() {
            write!(f, "\nits stderr ended:\n{}", self.stderr)?;
        }
        Ok(())
    }
}

/// What went wrong with the child process.
#[derive(Debug, thiserror::Error)]
pub enum ExecFault {
    /// The command line cannot be split into words.
    #[error("the command line is not one: {0}; expected PROGRAM ARGS, quoted as for a shell")]
    CommandLine(String),
    /// The program cannot be started.
    #[error("cannot start it: {0}")]
    Spawn(std::io::Error),
    /// The child ended, or closed its stdin or stdout, while a reply was due.
    #[error("it died when a reply was due ({status})")]
    Died {
        /// Its exit status, or that it was still running and had to be killed.
        status: String,
    },
    /// No reply in time.
    #[error("it stalled: no reply for {limit_s} s of wall time")]
    Stalled {
        /// The limit, s.
        limit_s: f64,
    },
    /// A reply without an end.
    #[error("its reply is longer than {limit} bytes; it begins `{received}`")]
    TooLong {
        /// The limit, bytes.
        limit: usize,
        /// Its beginning.
        received: String,
    },
    /// A reply that is not the object of the protocol, or has impossible values.
    #[error("its reply is not one: {problem}; received `{received}`")]
    Nonsense {
        /// What is wrong with it.
        problem: String,
        /// The reply, cut short if long.
        received: String,
    },
    /// A line nobody asked for.
    #[error("it wrote a line that nobody asked for: `{received}`")]
    Unasked {
        /// The line, cut short if long.
        received: String,
    },
    /// The vehicle's time does not follow the commands.
    #[error("its time is t_s = {found}; expected {expected:.3} ± {CLOCK_TOLERANCE_S} s")]
    Clock {
        /// Time in the reply, s.
        found: f64,
        /// Number of commands times 50 ms, s.
        expected: f64,
    },
    /// A command or configuration that JSON cannot carry was to be sent.
    #[error("a command that is not finite was to be sent: {0}")]
    NotFinite(String),
    /// `{"close": true}` was not answered by exit 0 in time.
    #[error("asked to close, it did not exit with 0 within {limit_s} s ({status})")]
    Close {
        /// Its exit status, or that it was still running and had to be killed.
        status: String,
        /// The limit, s.
        limit_s: f64,
    },
    /// A call after the child has gone.
    #[error("it has been closed, or stopped after an earlier fault")]
    Gone,
}

/// A vehicle in a child process; see the [protocol](self).
pub struct ExecVehicle {
    program: String,
    child: Option<Child>,
    steps: u64,
    reply_limit: Duration,
    close_limit: Duration,
}

#[derive(Serialize)]
#[serde(rename_all = "lowercase")]
enum Request {
    Reset {
        length_m: f64,
        pressure_kpa: f64,
        seed: u64,
    },
    Close(bool),
    #[serde(untagged)]
    Step {
        cmd: [f64; 3],
        #[serde(skip_serializing_if = "Option::is_none")]
        cmd_velocity: Option<[f64; 3]>,
        length_m: f64,
        pressure_kpa: f64,
    },
}

impl ExecVehicle {
    /// Starts `command_line` (what follows `exec:`), split into words as a shell would, without a shell.
    pub fn spawn(command_line: &str, options: ExecOptions) -> Result<Self, ExecError> {
        let failed = |fault| ExecError {
            program: command_line.into(),
            steps: 0,
            fault,
            stderr: String::new(),
        };
        let words = shell_words::split(command_line)
            .map_err(|error| failed(ExecFault::CommandLine(error.to_string())))?;
        let Some((program, arguments)) = words.split_first() else {
            return Err(failed(ExecFault::CommandLine("it is empty".into())));
        };
        let child =
            Child::spawn(program, arguments, options.stderr_sink).map_err(|e| failed(ExecFault::Spawn(e)))?;
        Ok(Self {
            program: command_line.into(),
            child: Some(child),
            steps: 0,
            reply_limit: options.reply_limit,
            close_limit: options.close_limit,
        })
    }

    /// Sends `request` and reads the observation that answers it, which is due at `steps` · 50 ms.
    fn ask(&mut self, request: &Request, steps: u64) -> Result<Observation, VehicleError> {
        let observation = self.exchange(request, steps).map_err(|fault| self.fail(fault))?;
        self.steps = steps;
        Ok(observation)
    }

    fn exchange(&mut self, request: &Request, steps: u64) -> Result<Observation, ExecFault> {
        let child = self.child.as_mut().ok_or(ExecFault::Gone)?;
        child.send(&line(request))?;
        let reply = child.receive(self.reply_limit)?;
        let observation = reply::parse(&reply)?;
        let expected = steps as f64 * DT;
        if (observation.t_s - expected).abs() > CLOCK_TOLERANCE_S {
            return Err(ExecFault::Clock {
                found: observation.t_s,
                expected,
            });
        }
        Ok(observation)
    }

    /// Stops the child and puts its last words beside the fault.
    fn fail(&mut self, fault: ExecFault) -> VehicleError {
        let stderr = self.child.take().map(Child::last_words).unwrap_or_default();
        ExecError {
            program: self.program.clone(),
            steps: self.steps,
            fault,
            stderr,
        }
        .into()
    }
}

impl Vehicle for ExecVehicle {
    fn reset(&mut self, configuration: Configuration, seed: u64) -> Result<Observation, VehicleError> {
        let Configuration {
            length_m,
            pressure_kpa,
        } = configuration;
        check_finite(&[length_m, pressure_kpa]).map_err(|fault| self.fail(fault))?;
        self.ask(
            &Request::Reset {
                length_m,
                pressure_kpa,
                seed,
            },
            0,
        )
    }

    fn step(
        &mut self,
        setpoint: Setpoint,
        configuration: Configuration,
    ) -> Result<Observation, VehicleError> {
        let Configuration {
            length_m,
            pressure_kpa,
        } = configuration;
        let Setpoint { position, velocity } = setpoint;
        let numbers = [
            &position[..],
            velocity.as_ref().map_or(&[], |v| &v[..]),
            &[length_m, pressure_kpa],
        ];
        check_finite(&numbers.concat()).map_err(|fault| self.fail(fault))?;
        self.ask(
            &Request::Step {
                cmd: position,
                cmd_velocity: velocity,
                length_m,
                pressure_kpa,
            },
            self.steps + 1,
        )
    }

    /// Asks the child to exit and waits for it; the second call has nothing to do.
    fn close(&mut self) -> Result<(), VehicleError> {
        let Some(child) = self.child.as_mut() else {
            return Ok(());
        };
        match child.close(&line(&Request::Close(true)), self.close_limit) {
            Ok(()) => {
                self.child = None;
                Ok(())
            }
            Err(fault) => Err(self.fail(fault)),
        }
    }
}

fn line(request: &Request) -> Vec<u8> {
    let mut line = serde_json::to_vec(request).expect("a request is plain numbers with text keys");
    line.push(b'\n');
    line
}

/// JSON has no NaN: it would travel as null.
fn check_finite(numbers: &[f64]) -> Result<(), ExecFault> {
    if numbers.iter().all(|number| number.is_finite()) {
        return Ok(());
    }
    Err(ExecFault::NotFinite(format!("{numbers:?}")))
}

#[cfg(test)]
mod tests;
