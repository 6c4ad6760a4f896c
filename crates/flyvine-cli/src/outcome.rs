//! How a command ends, and the exit code that says so.

use std::process::ExitCode;

/// How a command that ran to its end went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Exit code 0.
    Done,
    /// Exit code 3: finished and written, but the result is not to be trusted; stderr says why.
    Untrusted,
}

/// Why a command did not run to its end.
#[derive(Debug)]
pub enum Failure {
    /// Exit code 2: bad usage or bad input.
    Input(anyhow::Error),
    /// Exit code 1: the tool's own failure, or the machine's (disk full, no permission).
    Internal(anyhow::Error),
}

/// What every command returns.
pub type CommandResult = Result<Outcome, Failure>;

/// Marks an error as the input's or as the tool's.
pub trait Blame<T> {
    /// The user's input is wrong.
    fn or_input(self) -> Result<T, Failure>;
    /// The tool or the machine failed.
    fn or_internal(self) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> Blame<T> for Result<T, E> {
    fn or_input(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::Input(error.into()))
    }
    fn or_internal(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::Internal(error.into()))
    }
}

/// An input failure with a message.
pub fn bad_input<T>(message: String) -> Result<T, Failure> {
    Err(Failure::Input(anyhow::Error::msg(message)))
}

/// Prints a failure to stderr and gives the process's exit code.
pub fn exit_code(result: CommandResult) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Untrusted) => ExitCode::from(3),
        Err(Failure::Input(error)) => {
            crate::console::say(&format!("error: {}", message(&error)));
            ExitCode::from(2)
        }
        Err(Failure::Internal(error)) => {
            crate::console::say(&format!("internal error: {}", message(&error)));
            ExitCode::from(1)
        }
    }
}

/// Characters of a line at most: errors quote the line where they were found, which may be a whole file.
const LINE: usize = 300;

/// The error and its causes, each said once: the library's errors already carry theirs.
fn message(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text += &format!(": {cause}");
        }
    }
    text.lines().map(shortened).collect::<Vec<_>>().join("\n")
}

fn shortened(line: &str) -> String {
    match line.char_indices().nth(LINE) {
        Some((end, _)) => format!("{} …", &line[..end]),
        None => line.to_owned(),
    }
}
