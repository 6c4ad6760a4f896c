//! Thin transports: UDP and serial lines, never blocking.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::os::unix::fs::OpenOptionsExt;

use rustix::fs::OFlags;
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// Largest datagram that is read, bytes.
const DATAGRAM_MAX: usize = 2048;

/// Something that carries bytes to the autopilot and back. A wire that fails is silent, and silence is for the supervisor
/// to judge; so sending and receiving have no errors.
pub trait Wire {
    /// Sends one frame, or loses it.
    fn send(&mut self, frame: &[u8]);

    /// Appends what has come in since the last call, without waiting.
    fn receive(&mut self, bytes: &mut Vec<u8>);
}

/// An address that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// Not an address.
    #[error("`{found}`: expected udpin:HOST:PORT (listen), udpout:HOST:PORT (call) or serial:DEVICE:BAUD")]
    Address {
        /// What was found.
        found: String,
    },
    /// The system refuses it.
    #[error("{address}: {error}")]
    Open {
        /// The address.
        address: String,
        /// What the system says.
        error: std::io::Error,
    },
}

/// Opens `udpin:HOST:PORT`, `udpout:HOST:PORT` or `serial:DEVICE:BAUD`. Nothing but the host that is named is listened on.
pub fn open(address: &str) -> Result<Box<dyn Wire>, WireError> {
    let malformed = || WireError::Address {
        found: address.to_owned(),
    };
    let failed = |error| WireError::Open {
        address: address.to_owned(),
        error,
    };
    let (kind, rest) = address.split_once(':').ok_or_else(malformed)?;
    match kind {
        "udpin" => Ok(Box::new(UdpWire::listen(rest).map_err(failed)?)),
        "udpout" => Ok(Box::new(UdpWire::call(rest).map_err(failed)?)),
        "serial" => {
            let (device, baud) = rest.rsplit_once(':').ok_or_else(malformed)?;
            let baud = baud.parse().map_err(|_| malformed())?;
            Ok(Box::new(SerialWire::open(device, baud).map_err(failed)?))
        }
        _ => Err(malformed()),
    }
}

/// One UDP socket and one peer: the one that is called, or the first that calls.
pub struct UdpWire {
    socket: UdpSocket,
    peer: Option<SocketAddr>,
}

impl UdpWire {
    /// Waits on `address` for a peer.
    pub fn listen(address: impl ToSocketAddrs) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(address)?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, peer: None })
    }

    /// Calls the peer at `address` from any free port of the interface that leads there.
    pub fn call(address: impl ToSocketAddrs) -> std::io::Result<Self> {
        let peer = address
            .to_socket_addrs()?
            .next()
            .ok_or_else(|| std::io::Error::new(ErrorKind::NotFound, "no such host"))?;
        let any = match peer {
            _ if peer.ip().is_loopback() => SocketAddr::new(peer.ip(), 0),
            SocketAddr::V4(_) => SocketAddr::from(([0, 0, 0, 0], 0)),
            SocketAddr::V6(_) => SocketAddr::from(([0_u16; 8], 0)),
        };
        let socket = UdpSocket::bind(any)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            peer: Some(peer),
        })
    }

    /// Where it listens.
    pub fn local_address(&self) -> std::io::Result<SocketAddr> {
        self.socket.local_addr()
    }
}

impl Wire for UdpWire {
    fn send(&mut self, frame: &[u8]) {
        if let Some(peer) = self.peer {
            let _ = self.socket.send_to(frame, peer);
        }
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) {
        let mut datagram = [0; DATAGRAM_MAX];
        loop {
            match self.socket.recv_from(&mut datagram) {
                Ok((length, from)) => {
                    let peer = *self.peer.get_or_insert(from);
                    // An autopilot that starts anew may come from another port of the same host.
                    if from.ip() == peer.ip() {
                        self.peer = Some(from);
                        bytes.extend_from_slice(&datagram[..length]);
                    }
                }
                // A peer that is not there yet, or any more, answers with a refusal.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => (),
                Err(_) => return,
            }
        }
    }
}

/// A serial line, raw, eight bits, no parity.
pub struct SerialWire {
    port: File,
}

impl SerialWire {
    /// Opens `device` at `baud`.
    pub fn open(device: &str, baud: u32) -> std::io::Result<Self> {
        let flags = OFlags::NOCTTY | OFlags::NONBLOCK;
        let port = File::options()
            .read(true)
            .write(true)
            .custom_flags(flags.bits().cast_signed())
            .open(device)?;
        let mut settings = tcgetattr(&port)?;
        settings.make_raw();
        settings.set_speed(baud)?;
        tcsetattr(&port, OptionalActions::Now, &settings)?;
        Ok(Self { port })
    }
}

impl Wire for SerialWire {
    fn send(&mut self, frame: &[u8]) {
        // A line whose buffer is full loses the frame: an old set-point helps nobody.
        let _ = self.port.write(frame);
    }

    fn receive(&mut self, bytes: &mut Vec<u8>) {
        let mut part = [0; DATAGRAM_MAX];
        while let Ok(length @ 1..) = self.port.read(&mut part) {
            bytes.extend_from_slice(&part[..length]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_checked() {
        for bad in [
            "udpin",
            "tcp:127.0.0.1:1",
            "serial:/dev/null",
            "serial:/dev/null:fast",
        ] {
            assert!(matches!(open(bad), Err(WireError::Address { .. })), "{bad}");
        }
        assert!(matches!(
            open("serial:/nowhere:57600"),
            Err(WireError::Open { .. })
        ));
        assert!(matches!(open("udpin:127.0.0.1"), Err(WireError::Open { .. })));
    }

    #[test]
    fn datagrams_go_both_ways_and_strangers_are_not_answered() {
        let mut listener = UdpWire::listen("127.0.0.1:0").unwrap();
        let mut caller = UdpWire::call(listener.local_address().unwrap()).unwrap();
        listener.send(b"nobody there yet");
        let heard = |wire: &mut UdpWire| {
            let mut bytes = Vec::new();
            for _ in 0..1000 {
                wire.receive(&mut bytes);
                if !bytes.is_empty() {
                    break;
                }
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            bytes
        };
        caller.send(b"ping");
        assert_eq!(heard(&mut listener), b"ping");
        listener.send(b"pong");
        assert_eq!(heard(&mut caller), b"pong");
    }
}
