//! The arm's firmware on an emulated board, for rehearsals and tests.

use super::{DEFAULT_BAUD, open_serial};
use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// qemu's micro:bit (Cortex-M0) with the firmware on it; it ends with its owner.
pub struct EmulatedBoard {
    qemu: Child,
    /// Its serial line.
    pub line: File,
}

impl EmulatedBoard {
    /// Powers up the board with the firmware `image`.
    ///
    /// # Errors
    /// qemu-system-arm cannot be started ([`io::ErrorKind::NotFound`] if it is not installed), or names no line.
    pub fn start(image: &Path) -> io::Result<Self> {
        let mut qemu = Command::new("qemu-system-arm")
            .args(["-M", "microbit", "-nographic", "-monitor", "none"])
            .args(["-serial", "pty", "-kernel"])
            .arg(image)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()?;
        let line = line_of(&mut qemu).inspect_err(|_| end(&mut qemu));
        line.map(|line| Self { qemu, line })
    }
}

impl Drop for EmulatedBoard {
    fn drop(&mut self) {
        end(&mut self.qemu);
    }
}

fn end(qemu: &mut Child) {
    // It may have ended by itself.
    let _ = qemu.kill();
    let _ = qemu.wait();
}

/// Opens the line that qemu names: "char device redirected to /dev/pts/7 (label serial0)".
fn line_of(qemu: &mut Child) -> io::Result<File> {
    let mut said = String::new();
    if let Some(stdout) = qemu.stdout.take() {
        BufReader::new(stdout).read_line(&mut said)?;
    }
    let path = said.split_whitespace().find(|word| word.starts_with("/dev/"));
    let path = path.ok_or_else(|| io::Error::other(format!("qemu-system-arm names no line: {said}")))?;
    open_serial(path.as_ref(), DEFAULT_BAUD)
}
