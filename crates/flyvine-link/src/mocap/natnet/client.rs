//! A NatNet client: threads that keep asking one server and pass its frames on.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddrV4, UdpSocket};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use ::natnet::serverinfo::ConnectionInfo;
use ::natnet::{NAT_CONNECT, NAT_KEEPALIVE, NAT_REQUEST_MODELDEF};

use super::{Assembler, COMMAND_PORT, Heard};
use crate::mocap::address::{host_and_port, resolve};
use crate::mocap::{Incoming, LinkState, MocapError, Sink};
use crate::worker::Worker;

/// How long a thread sleeps in a socket before it looks whether it shall stop.
const TICK: Duration = Duration::from_millis(50);
/// Between repetitions of an unanswered request, and between signs of life.
const REPEAT: Duration = Duration::from_secs(1);
/// A server of which nothing is heard for so long is asked from the beginning.
const SILENCE: Duration = Duration::from_secs(3);

/// Where a NatNet server is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NatNetAddress {
    /// Host name or IPv4 address.
    pub host: String,
    /// Its port for commands.
    pub port: u16,
}

impl FromStr for NatNetAddress {
    type Err = MocapError;

    /// Reads `host` or `host:port`.
    fn from_str(address: &str) -> Result<Self, MocapError> {
        let (host, port) = host_and_port(
            address,
            address,
            COMMAND_PORT,
            "expected `host` or `host:port` (IPv4)",
        )?;
        Ok(NatNetAddress { host, port })
    }
}

/// A connection to a NatNet server, kept up by a thread of its own until this value is dropped.
#[derive(Debug)]
pub struct NatNetClient {
    _worker: Worker,
}

impl NatNetClient {
    /// Starts to ask the server at `address` and to pass on its frames to `sink`.
    ///
    /// # Errors
    /// The host is unknown or has no IPv4 address. A server that does not answer is no error: the client goes on
    /// asking.
    pub fn start(address: &NatNetAddress, sink: Sink) -> Result<Self, MocapError> {
        let server = resolve(&address.host, address.port)?;
        let worker = Worker::start("natnet client", move |stop| {
            Session { server, sink, stop }.run();
        });
        Ok(NatNetClient {
            _worker: worker.map_err(MocapError::Thread)?,
        })
    }
}

/// What the client's threads share.
struct Session {
    server: SocketAddrV4,
    sink: Sink,
    stop: Arc<AtomicBool>,
}

/// One conversation with the server.
struct Conversation {
    assembler: Assembler,
    named: bool,
    heard: Instant,
}

/// Why a conversation ended.
type Ended = Result<(), String>;

impl Session {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn link(&self, state: LinkState) {
        (self.sink)(Incoming::Link(state));
    }

    /// Converses, again and again.
    fn run(&self) {
        while !self.stopped() {
            self.link(LinkState::Connecting);
            let began = Instant::now();
            if let Err(reason) = self.converse() {
                self.link(LinkState::Lost(reason));
            }
            while !self.stopped() && began.elapsed() < REPEAT {
                thread::sleep(TICK);
            }
        }
    }

    /// Introduces itself, learns where the data comes, and listens until the server falls silent.
    fn converse(&self) -> Ended {
        let because = |what: &str, error: io::Error| format!("{what} for {}: {error}", self.server);
        let commands = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))
            .and_then(|socket| socket.connect(self.server).map(|()| socket))
            .map_err(|error| because("no route", error))?;
        commands
            .set_read_timeout(Some(TICK))
            .map_err(|error| because("cannot listen", error))?;
        let local = match commands.local_addr().map(|address| address.ip()) {
            Ok(IpAddr::V4(local)) => local,
            _ => return Err("no local IPv4 address".into()),
        };
        let state = Mutex::new(Conversation {
            assembler: Assembler::default(),
            named: false,
            heard: Instant::now(),
        });
        let Some(connection) = self.introduce(&commands, &state)? else {
            return Ok(());
        };
        let data = bind_data(local, connection)
            .map_err(|error| because(&format!("cannot listen at port {}", connection.data_port), error))?;
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    self.receive(&data, &state);
                }
            });
            let ended = self.keep_asking(&commands, &state);
            over.store(true, Ordering::Relaxed);
            ended
        })
    }

    /// Asks until the server introduces itself; `None` if the client is stopped before.
    fn introduce(
        &self,
        commands: &UdpSocket,
        state: &Mutex<Conversation>,
    ) -> Result<Option<ConnectionInfo>, String> {
        let mut asked: Option<Instant> = None;
        while !self.stopped() {
            if asked.is_none_or(|asked| asked.elapsed() >= REPEAT) {
                // Nobody may be listening yet.
                let _ = commands.send(&request(NAT_CONNECT));
                asked = Some(Instant::now());
            }
            if let Some(connection) = self.receive(commands, state) {
                return Ok(Some(connection));
            }
            // Refused at once: do not spin.
            thread::sleep(Duration::from_millis(2));
        }
        Ok(None)
    }

    /// Asks for names while they are missing, and shows the server that someone listens.
    fn keep_asking(&self, commands: &UdpSocket, state: &Mutex<Conversation>) -> Ended {
        let mut asked: Option<Instant> = None;
        while !self.stopped() {
            let (named, silence) = {
                let state = state.lock().expect("no thread panics with it");
                (state.named, state.heard.elapsed())
            };
            if silence > SILENCE {
                return Err(format!("the server has been silent for {} s", silence.as_secs()));
            }
            if asked.is_none_or(|asked| asked.elapsed() >= REPEAT) {
                let what = if named {
                    NAT_KEEPALIVE
                } else {
                    NAT_REQUEST_MODELDEF
                };
                // A server that is gone is noticed by its silence.
                let _ = commands.send(&request(what));
                asked = Some(Instant::now());
            }
            self.receive(commands, state);
            thread::sleep(Duration::from_millis(2));
        }
        Ok(())
    }

    /// Takes one datagram, if one comes in time; returns the connection that a server offers in it.
    fn receive(&self, socket: &UdpSocket, state: &Mutex<Conversation>) -> Option<ConnectionInfo> {
        let mut buffer = [0; 64 * 1024];
        let (count, from) = socket.recv_from(&mut buffer).ok()?;
        if from.ip() != IpAddr::V4(*self.server.ip()) {
            return None;
        }
        let arrived = Instant::now();
        let mut state = state.lock().expect("no thread panics with it");
        // A damaged packet is lost like one that did not arrive.
        let heard = state.assembler.receive(&buffer[..count]).ok()?;
        state.heard = arrived;
        match heard {
            Heard::Server(name, connection) => {
                self.link(LinkState::Connected(format!("{name} at {}", self.server)));
                return Some(connection);
            }
            Heard::Names => state.named = true,
            Heard::Frame { frame, names_missing } => {
                state.named &= !names_missing;
                (self.sink)(Incoming::Frame(frame, arrived));
            }
            Heard::Nothing => (),
        }
        None
    }
}

/// The socket that data comes to: from the group, or to the server's data port at this machine.
fn bind_data(local: Ipv4Addr, connection: ConnectionInfo) -> io::Result<UdpSocket> {
    let socket = if connection.multicast {
        // Bound to the group, the socket hears nothing else.
        let group = Ipv4Addr::from(connection.multicast_group);
        let socket = UdpSocket::bind((group, connection.data_port))?;
        socket.join_multicast_v4(&group, &local)?;
        socket
    } else {
        UdpSocket::bind((local, connection.data_port))?
    };
    socket.set_read_timeout(Some(TICK))?;
    Ok(socket)
}

/// A request without content: its number, and a length of 0.
fn request(id: u16) -> [u8; 4] {
    let [low, high] = id.to_le_bytes();
    [low, high, 0, 0]
}
