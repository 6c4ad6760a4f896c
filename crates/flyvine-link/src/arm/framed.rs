//! The arm's protocol over a line of bytes: a serial port, or datagrams to the companion computer.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, ToSocketAddrs, UdpSocket};

use super::client::{ArmClient, ArmStatus};
use super::{Arm, ArmError, check_finite};
use vine_arm::{Request, Setpoint};

/// Most bytes taken in one [`Arm::poll`]: a second's worth of the fastest line.
const MOST_BYTES: usize = 1 << 16;

/// An arm that speaks [`vine_arm`]'s protocol on `L`, a line that never blocks.
#[derive(Debug)]
pub struct FramedArm<L> {
    line: L,
    client: ArmClient,
    setpoint: Setpoint,
}

impl<L: Read + Write> FramedArm<L> {
    /// An arm on a line that is open already.
    pub fn new(line: L, now_s: f64) -> FramedArm<L> {
        FramedArm {
            line,
            client: ArmClient::new(now_s),
            setpoint: Setpoint::default(),
        }
    }

    fn write(&mut self, frame: &[u8]) -> Result<(), ArmError> {
        match self.line.write(frame) {
            // A frame cut short is rejected by its checksum, as one that a full line never took is missed: both show
            // as unanswered, and the next comes in 50 ms.
            Ok(_) => Ok(()),
            Err(error) if is_temporary(&error) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

impl<L: Read + Write> Arm for FramedArm<L> {
    fn send(&mut self, now_s: f64, setpoint: Setpoint) -> Result<(), ArmError> {
        check_finite(&Request::Setpoint(setpoint))?;
        self.setpoint = setpoint;
        let frame = self.client.tick(now_s, setpoint);
        self.write(&frame)
    }

    fn ask(&mut self, now_s: f64, request: Request) -> Result<(), ArmError> {
        check_finite(&request)?;
        self.client.ask(request);
        let frame = self.client.tick(now_s, self.setpoint);
        self.write(&frame)
    }

    fn poll(&mut self, now_s: f64) -> Result<(), ArmError> {
        let mut bytes = [0; 2048];
        let mut taken = 0;
        while taken < MOST_BYTES {
            match self.line.read(&mut bytes) {
                Ok(0) => return Err(ArmError::Closed),
                Ok(count) => {
                    taken += count;
                    self.client.receive(now_s, &bytes[..count]);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if is_temporary(&error) => return Ok(()),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    fn status(&self, now_s: f64) -> ArmStatus {
        self.client.status(now_s)
    }
}

/// Nothing there now, or (for datagrams) nobody there yet: the arm's silence tells.
fn is_temporary(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionRefused
    )
}

/// Datagrams to and from one address as a line.
#[derive(Debug)]
pub struct UdpLine(UdpSocket);

impl UdpLine {
    /// A line to `address`, from a port that the system chooses.
    pub fn connect(address: impl ToSocketAddrs) -> io::Result<UdpLine> {
        let nowhere = || io::Error::new(ErrorKind::NotFound, "the name has no address");
        let peer = address.to_socket_addrs()?.next().ok_or_else(nowhere)?;
        let local = match peer.ip() {
            // A loopback peer is reached from loopback alone.
            loopback if loopback.is_loopback() => loopback,
            IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = UdpSocket::bind((local, 0))?;
        socket.connect(peer)?;
        socket.set_nonblocking(true)?;
        Ok(UdpLine(socket))
    }
}

impl Read for UdpLine {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            // An empty datagram is not the end of the line.
            match self.0.recv(buffer) {
                Ok(0) => {}
                other => return other,
            }
        }
    }
}

impl Write for UdpLine {
    fn write(&mut self, datagram: &[u8]) -> io::Result<usize> {
        self.0.send(datagram)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
