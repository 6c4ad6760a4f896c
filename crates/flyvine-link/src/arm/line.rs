//! Serial ports and pseudo-terminals, raw and never blocking.

use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// Opens a serial port: raw, 8 data bits, no parity, one stop bit, at `baud`. Reading where nothing has arrived gives
/// [`io::ErrorKind::WouldBlock`].
pub fn open_serial(path: &Path, baud: u32) -> io::Result<File> {
    let flags = OFlags::NOCTTY | OFlags::NONBLOCK;
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags(flags.bits() as i32)
        .open(path)?;
    make_raw(&file, baud)?;
    Ok(file)
}

fn make_raw(terminal: impl AsFd, baud: u32) -> io::Result<()> {
    let mut settings = tcgetattr(&terminal)?;
    settings.make_raw();
    settings.set_speed(baud)?;
    Ok(tcsetattr(&terminal, OptionalActions::Now, &settings)?)
}

/// A pseudo-terminal: a serial line without wires. What is at [`path`](Pty::path) is a serial port to whoever opens it.
#[derive(Debug)]
pub struct Pty {
    /// The near end.
    pub file: File,
    /// The far end's name.
    pub path: PathBuf,
    /// Keeps the line up while nobody has the far end open.
    _far: File,
}

impl Pty {
    /// A new pseudo-terminal, raw on both ends.
    pub fn open() -> io::Result<Pty> {
        let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&near)?;
        unlockpt(&near)?;
        let name = ptsname(&near, Vec::new())?;
        let path = PathBuf::from(OsStr::from_bytes(name.as_bytes()));
        let far = open_serial(&path, super::DEFAULT_BAUD)?;
        fcntl_setfl(&near, fcntl_getfl(&near)? | OFlags::NONBLOCK)?;
        Ok(Pty {
            file: near.into(),
            path,
            _far: far,
        })
    }
}
