//! A serial port that may go away and come back, and that never takes half a packet.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::path::PathBuf;

use super::{OnboardError, OnboardEvent};
use crate::arm::open_serial;

/// How long after a failure the port is tried again, s.
const RETRY_S: f64 = 1.0;
/// Most bytes that wait for a slow port: a packet that does not fit is dropped whole.
const MOST_WAITING: usize = 4096;

/// A serial port and what waits to be written to it.
#[derive(Debug)]
pub(super) struct SerialPort {
    path: PathBuf,
    baud: u32,
    file: Option<File>,
    retry_s: f64,
    waiting: VecDeque<u8>,
    /// Packets dropped because the port was slow or away.
    pub(super) dropped: u64,
}

impl SerialPort {
    pub(super) fn open(path: PathBuf, baud: u32) -> Result<SerialPort, OnboardError> {
        let file = open_serial(&path, baud).map_err(|error| OnboardError::Serial {
            path: path.clone(),
            error,
        })?;
        Ok(SerialPort {
            path,
            baud,
            file: Some(file),
            retry_s: 0.0,
            waiting: VecDeque::new(),
            dropped: 0,
        })
    }

    /// The open port, to wait for.
    pub(super) fn file(&self) -> Option<&File> {
        self.file.as_ref()
    }

    /// Opens the port again if it is away and it is time to try.
    pub(super) fn reopen(&mut self, now_s: f64, tell: &mut dyn FnMut(OnboardEvent)) {
        if self.file.is_none() && now_s >= self.retry_s {
            self.retry_s = now_s + RETRY_S;
            if let Ok(file) = open_serial(&self.path, self.baud) {
                self.file = Some(file);
                tell(OnboardEvent::SerialBack {
                    path: self.path.clone(),
                });
            }
        }
    }

    /// What has arrived; empty if nothing has, or the port is away.
    pub(super) fn read<'a>(
        &mut self,
        now_s: f64,
        buffer: &'a mut [u8],
        tell: &mut dyn FnMut(OnboardEvent),
    ) -> &'a [u8] {
        let Some(file) = &mut self.file else { return &[] };
        match file.read(buffer) {
            Ok(0) => self.lose(now_s, ErrorKind::UnexpectedEof.into(), tell),
            Ok(count) => return &buffer[..count],
            Err(error) if is_temporary(&error) => {}
            Err(error) => self.lose(now_s, error, tell),
        }
        &[]
    }

    /// Queues one whole packet.
    pub(super) fn send(&mut self, packet: &[u8]) {
        if self.file.is_none() || self.waiting.len() + packet.len() > MOST_WAITING {
            self.dropped += 1;
        } else {
            self.waiting.extend(packet);
        }
    }

    /// Writes as much as the port takes now.
    pub(super) fn flush(&mut self, now_s: f64, tell: &mut dyn FnMut(OnboardEvent)) {
        while let Some(file) = &mut self.file
            && !self.waiting.is_empty()
        {
            match file.write(self.waiting.as_slices().0) {
                Ok(0) => return,
                Ok(count) => drop(self.waiting.drain(..count)),
                Err(error) if is_temporary(&error) => return,
                Err(error) => self.lose(now_s, error, tell),
            }
        }
    }

    fn lose(&mut self, now_s: f64, error: io::Error, tell: &mut dyn FnMut(OnboardEvent)) {
        self.file = None;
        self.waiting.clear();
        self.retry_s = now_s + RETRY_S;
        tell(OnboardEvent::SerialLost {
            path: self.path.clone(),
            error: error.to_string(),
        });
    }
}

fn is_temporary(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
