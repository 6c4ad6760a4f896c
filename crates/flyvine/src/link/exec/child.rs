//! A child process whose stdout is read as lines of bounded length in bounded time.

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child as Process, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use super::ExecFault;
use super::reply::shown;

/// Longest line that is read, bytes; a reply takes about 200.
const LINE_LIMIT: usize = 64 * 1024;
/// Lines that wait unread before the child is held back: in lockstep there is one at most.
const LINES_AHEAD: usize = 4;
/// How much of the end of stderr is kept, bytes.
const STDERR_KEPT: usize = 4 * 1024;
/// Grace for a child that closed its pipes to be seen exiting, and for the rest of its stderr to arrive.
const GRACE: Duration = Duration::from_secs(1);
/// Pause between two looks at whether the child has exited.
const POLL: Duration = Duration::from_millis(2);

enum Line {
    Whole(Vec<u8>),
    TooLong(Vec<u8>),
}

/// A running child; dropped, it is killed and reaped.
pub(super) struct Child {
    process: Process,
    stdin: Option<ChildStdin>,
    lines: Receiver<Line>,
    stderr: Arc<Mutex<Vec<u8>>>,
    stderr_end: Receiver<()>,
}

impl Child {
    pub(super) fn spawn(
        program: &str,
        arguments: &[String],
        sink: Option<Box<dyn Write + Send>>,
    ) -> std::io::Result<Self> {
        let mut process = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let stdin = process.stdin.take();
        let stdout = process.stdout.take().expect("stdout is piped");
        let stderr = process.stderr.take().expect("stderr is piped");
        // The threads end with their pipe. They are not joined: a grandchild may hold the pipe open for ever.
        let (to_lines, lines) = sync_channel(LINES_AHEAD);
        thread::spawn(move || read_lines(stdout, &to_lines));
        let kept = Arc::new(Mutex::new(Vec::new()));
        let (at_end, stderr_end) = sync_channel(1);
        let keep = Arc::clone(&kept);
        thread::spawn(move || {
            read_tail(stderr, &keep, sink);
            let _ = at_end.send(());
        });
        Ok(Self {
            process,
            stdin,
            lines,
            stderr: kept,
            stderr_end,
        })
    }

    /// Writes one line. Never blocks for long: in lockstep the pipe holds no other.
    pub(super) fn send(&mut self, line: &[u8]) -> Result<(), ExecFault> {
        match self.lines.try_recv() {
            Ok(Line::Whole(line) | Line::TooLong(line)) => {
                return Err(ExecFault::Unasked {
                    received: shown(&line),
                });
            }
            Err(TryRecvError::Empty) => (),
            Err(TryRecvError::Disconnected) => return Err(self.died()),
        }
        match self.write(line) {
            Ok(()) => Ok(()),
            Err(_) => Err(self.died()),
        }
    }

    fn write(&mut self, line: &[u8]) -> std::io::Result<()> {
        let stdin = self.stdin.as_mut().ok_or(std::io::ErrorKind::BrokenPipe)?;
        stdin.write_all(line)?;
        stdin.flush()
    }

    /// Reads one line.
    pub(super) fn receive(&mut self, limit: Duration) -> Result<Vec<u8>, ExecFault> {
        match self.lines.recv_timeout(limit) {
            Ok(Line::Whole(line)) => Ok(line),
            Ok(Line::TooLong(line)) => Err(ExecFault::TooLong {
                limit: LINE_LIMIT,
                received: shown(&line),
            }),
            Err(RecvTimeoutError::Timeout) => Err(ExecFault::Stalled {
                limit_s: limit.as_secs_f64(),
            }),
            Err(RecvTimeoutError::Disconnected) => Err(self.died()),
        }
    }

    /// Sends the last line and waits for exit 0.
    pub(super) fn close(&mut self, line: &[u8], limit: Duration) -> Result<(), ExecFault> {
        // If it is gone already, its status says more than a broken pipe.
        let _ = self.write(line);
        self.stdin = None;
        match self.wait(limit) {
            Some(status) if status.success() => Ok(()),
            status => Err(ExecFault::Close {
                status: describe(status),
                limit_s: limit.as_secs_f64(),
            }),
        }
    }

    fn died(&mut self) -> ExecFault {
        ExecFault::Died {
            status: describe(self.wait(GRACE)),
        }
    }

    /// Waits for the exit; what the child still writes is thrown away, so that a full pipe does not hold it.
    fn wait(&mut self, limit: Duration) -> Option<ExitStatus> {
        let deadline = Instant::now() + limit;
        loop {
            while self.lines.try_recv().is_ok() {}
            if let Ok(Some(status)) = self.process.try_wait() {
                return Some(status);
            }
            if Instant::now() >= deadline {
                return None;
            }
            thread::sleep(POLL);
        }
    }

    /// Stops the child and returns the end of its stderr.
    pub(super) fn last_words(mut self) -> String {
        self.stop();
        let _ = self.stderr_end.recv_timeout(GRACE);
        let kept = self.stderr.lock().unwrap_or_else(PoisonError::into_inner);
        String::from_utf8_lossy(&kept).trim_end().to_string()
    }

    fn stop(&mut self) {
        // Both are harmless after the exit; `wait` reaps.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }

    #[cfg(test)]
    pub(super) fn id(&self) -> u32 {
        self.process.id()
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        self.stop();
    }
}

fn describe(status: Option<ExitStatus>) -> String {
    status.map_or("still running".into(), |status| status.to_string())
}

/// Reads lines until the pipe or the receiver ends, or a line is too long; an unfinished last line is
/// dropped.
fn read_lines(pipe: impl Read, lines: &SyncSender<Line>) {
    let mut reader = BufReader::new(pipe);
    loop {
        let mut line = Vec::new();
        let read = reader
            .by_ref()
            .take(LINE_LIMIT as u64 + 1)
            .read_until(b'\n', &mut line);
        if !matches!(read, Ok(length) if length > 0) {
            return;
        }
        let line = match line.pop_if(|byte| *byte == b'\n') {
            Some(_) => Line::Whole(line),
            None if line.len() > LINE_LIMIT => Line::TooLong(line),
            None => return,
        };
        let last = matches!(line, Line::TooLong(_));
        if lines.send(line).is_err() || last {
            return;
        }
    }
}

/// Passes `pipe` on to `sink` and keeps its end.
fn read_tail(mut pipe: impl Read, kept: &Mutex<Vec<u8>>, mut sink: Option<Box<dyn Write + Send>>) {
    let mut buffer = [0; 1024];
    while let Ok(length) = pipe.read(&mut buffer) {
        if length == 0 {
            return;
        }
        if let Some(sink) = &mut sink {
            // A sink that fails must not cost the flight.
            let _ = sink.write_all(&buffer[..length]);
        }
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.extend_from_slice(&buffer[..length]);
        let surplus = kept.len().saturating_sub(STDERR_KEPT);
        kept.drain(..surplus);
    }
}
