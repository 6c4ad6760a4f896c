//! A VRPN client: threads that keep a connection to one server and pass its reports on.

use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, TcpListener, TcpStream, UdpSocket};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use super::lob::format_lob;
use super::{Endpoint, Event, PORT, Report};
use crate::mocap::address::{host_and_port, resolve};
use crate::mocap::clock::unix_s;
use crate::mocap::{BodyPose, Frame, Incoming, LinkState, MocapError, Sink};
use crate::worker::Worker;

/// How long a thread sleeps in a socket before it looks whether it shall stop.
const TICK: Duration = Duration::from_millis(50);
/// Between requests to be called back, between attempts to connect, and between pings.
const RETRY: Duration = Duration::from_secs(1);
/// How long a server may take to accept a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// A server that answers neither with reports nor with a pong for so long is gone.
const SILENCE: Duration = Duration::from_secs(10);

/// Where a VRPN server is, and how it is reached.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VrpnAddress {
    /// Host name or IPv4 address.
    pub host: String,
    /// UDP and TCP port.
    pub port: u16,
    /// Whether everything goes over one TCP connection that the client opens.
    pub tcp_only: bool,
}

impl FromStr for VrpnAddress {
    type Err = MocapError;

    /// Reads `host`, `host:port`, `tcp://host` or `tcp://host:port`.
    fn from_str(address: &str) -> Result<Self, MocapError> {
        let (tcp_only, rest) = match address.strip_prefix("tcp://") {
            Some(rest) => (true, rest),
            None => (false, address),
        };
        let expected = "expected `host`, `host:port` or `tcp://host:port` (IPv4)";
        let (host, port) = host_and_port(address, rest, PORT, expected)?;
        Ok(VrpnAddress { host, port, tcp_only })
    }
}

/// A connection to a VRPN server, kept up by a thread of its own until this value is dropped.
#[derive(Debug)]
pub struct VrpnClient {
    _worker: Worker,
}

impl VrpnClient {
    /// Starts to connect to the server at `address` and to pass on to `sink` what it reports of sensor 0 of its
    /// devices. `wanted` devices are asked for by name; servers that create devices on demand need that.
    ///
    /// # Errors
    /// The host is unknown or has no IPv4 address. A server that does not answer is no error: the client goes on
    /// trying.
    pub fn start(address: &VrpnAddress, wanted: &[String], sink: Sink) -> Result<Self, MocapError> {
        let server = resolve(&address.host, address.port)?;
        let (tcp_only, wanted) = (address.tcp_only, wanted.to_vec());
        let worker = Worker::start("vrpn client", move |stop| {
            Session {
                server,
                tcp_only,
                wanted,
                sink,
                stop,
            }
            .run();
        });
        Ok(VrpnClient {
            _worker: worker.map_err(MocapError::Thread)?,
        })
    }
}

/// What the client's threads share.
struct Session {
    server: SocketAddrV4,
    tcp_only: bool,
    wanted: Vec<String>,
    sink: Sink,
    stop: Arc<AtomicBool>,
}

/// Why a connection ended.
type Ended = Result<(), String>;

impl Session {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn link(&self, state: LinkState) {
        (self.sink)(Incoming::Link(state));
    }

    /// Connects, again and again.
    fn run(&self) {
        while !self.stopped() {
            self.link(LinkState::Connecting);
            let began = Instant::now();
            let ended = if self.tcp_only {
                self.connect().and_then(|stream| self.serve(stream, None))
            } else {
                self.be_called()
            };
            if let Err(reason) = ended {
                self.link(LinkState::Lost(reason));
            }
            while !self.stopped() && began.elapsed() < RETRY {
                thread::sleep(TICK);
            }
        }
    }

    fn connect(&self) -> Result<TcpStream, String> {
        TcpStream::connect_timeout(&self.server.into(), CONNECT_TIMEOUT)
            .map_err(|error| format!("cannot connect to {}: {error}", self.server))
    }

    /// Asks by datagrams to be called back, and serves the call.
    fn be_called(&self) -> Ended {
        let because = |what: &str, error| format!("{what} for {}: {error}", self.server);
        // Its route to the server decides which of this machine's addresses the server shall call.
        let asking = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))
            .and_then(|socket| socket.connect(self.server).map(|()| socket))
            .map_err(|error| because("no route", error))?;
        let local = match asking.local_addr().map(|address| address.ip()) {
            Ok(IpAddr::V4(local)) => local,
            _ => return Err("no local IPv4 address".into()),
        };
        let listener = TcpListener::bind((local, 0)).map_err(|error| because("cannot listen", error))?;
        listener
            .set_nonblocking(true)
            .map_err(|error| because("cannot listen", error))?;
        let reports = UdpSocket::bind((local, 0)).map_err(|error| because("cannot listen", error))?;
        let port = |address: std::io::Result<SocketAddr>| address.map_or(0, |address| address.port());
        let lob = format_lob(SocketAddrV4::new(local, port(listener.local_addr())));
        let reports_to = SocketAddrV4::new(local, port(reports.local_addr()));

        let mut asked: Option<Instant> = None;
        while !self.stopped() {
            if asked.is_none_or(|asked| asked.elapsed() >= RETRY) {
                if asked.is_some() {
                    self.link(LinkState::Connecting);
                }
                // An earlier request may have been refused at once (nobody listens yet): that is told by this one.
                let _ = asking.send(&lob);
                asked = Some(Instant::now());
            }
            match listener.accept() {
                Ok((stream, SocketAddr::V4(caller))) if caller.ip() == self.server.ip() => {
                    return stream
                        .set_nonblocking(false)
                        .map_err(|error| because("cannot use the connection", error))
                        .and_then(|()| self.serve(stream, Some((reports, reports_to))));
                }
                // Somebody else.
                Ok(_) => (),
                Err(_) => thread::sleep(Duration::from_millis(5)),
            }
        }
        Ok(())
    }

    /// Lives on one connection until it ends.
    fn serve(&self, mut stream: TcpStream, reports: Option<(UdpSocket, SocketAddrV4)>) -> Ended {
        let setup = stream
            .set_nodelay(true)
            .and_then(|()| stream.set_read_timeout(Some(TICK)))
            .and_then(|()| stream.set_write_timeout(Some(CONNECT_TIMEOUT)));
        setup.map_err(|error| format!("cannot use the connection: {error}"))?;
        let reports_to = reports.as_ref().map(|(_, address)| *address);
        let state = Mutex::new(State {
            endpoint: Endpoint::new(&self.wanted, reports_to),
            devices: Vec::new(),
            heard: Instant::now(),
            pinged: None,
        });
        let over = AtomicBool::new(false);
        thread::scope(|scope| {
            if let Some((socket, _)) = &reports {
                scope.spawn(|| self.receive_reports(socket, &state, &over));
            }
            let ended = self.receive_stream(&mut stream, &state);
            over.store(true, Ordering::Relaxed);
            ended
        })
    }

    fn receive_stream(&self, stream: &mut TcpStream, state: &Mutex<State>) -> Ended {
        let mut buffer = [0; 16 * 1024];
        while !self.stopped() {
            let output = state.lock().expect("no thread panics with it").output()?;
            stream
                .write_all(&output)
                .map_err(|error| format!("cannot send: {error}"))?;
            let count = match stream.read(&mut buffer) {
                Ok(0) => return Err("closed by the server".into()),
                Ok(count) => count,
                Err(error) if is_timeout(&error) => continue,
                Err(error) => return Err(error.to_string()),
            };
            let arrived = Instant::now();
            let mut state = state.lock().expect("no thread panics with it");
            let events = state
                .endpoint
                .receive(&buffer[..count], unix_s())
                .map_err(|error| error.to_string())?;
            self.handle(events, arrived, &mut state);
        }
        Ok(())
    }

    fn receive_reports(&self, socket: &UdpSocket, state: &Mutex<State>, over: &AtomicBool) {
        let mut buffer = [0; 64 * 1024];
        // If it cannot be set, the thread would not notice the end.
        if socket.set_read_timeout(Some(TICK)).is_err() {
            return;
        }
        while !over.load(Ordering::Relaxed) {
            let Ok((count, from)) = socket.recv_from(&mut buffer) else {
                continue;
            };
            if from.ip() != IpAddr::V4(*self.server.ip()) {
                continue;
            }
            let arrived = Instant::now();
            let mut state = state.lock().expect("no thread panics with it");
            // A damaged datagram is lost like one that did not arrive.
            if let Ok(events) = state.endpoint.receive_datagram(&buffer[..count]) {
                self.handle(events, arrived, &mut state);
            }
        }
    }

    fn handle(&self, events: Vec<Event>, arrived: Instant, state: &mut State) {
        for event in events {
            match event {
                Event::Connected(version) => {
                    self.link(LinkState::Connected(format!("VRPN {version} at {}", self.server)));
                }
                Event::Device(name) => state.devices.push(name),
                Event::Report(report) => {
                    state.alive(arrived);
                    if report.sensor == 0 {
                        (self.sink)(Incoming::Frame(frame(report), arrived));
                    }
                }
                Event::Pong(_) => state.alive(arrived),
                Event::Ping(_) | Event::ReportsTo(_) => (),
            }
        }
    }
}

/// One connection's state, shared by the threads that read its two sockets.
struct State {
    endpoint: Endpoint,
    devices: Vec<String>,
    /// When a report or a pong came last.
    heard: Instant,
    /// When the server was asked last whether it is alive.
    pinged: Option<Instant>,
}

impl State {
    fn alive(&mut self, when: Instant) {
        (self.heard, self.pinged) = (when, None);
    }

    /// What is to be sent now: among it, a ping every second while nothing is heard.
    fn output(&mut self) -> Result<Vec<u8>, String> {
        let silence = self.heard.elapsed();
        if !self.endpoint.is_connected() && silence > SILENCE {
            return Err("no cookie from the server".into());
        }
        let due = self.pinged.unwrap_or(self.heard).elapsed() >= RETRY;
        if let Some(device) = self.devices.first().filter(|_| due) {
            if silence > SILENCE {
                return Err(format!("the server has been silent for {} s", silence.as_secs()));
            }
            self.endpoint.ping(&device.clone(), unix_s());
            self.pinged = Some(Instant::now());
        }
        Ok(self.endpoint.take_output())
    }
}

fn frame(report: Report) -> Frame {
    Frame {
        captured_s: report.time_s,
        sent_s: report.time_s,
        bodies: vec![BodyPose {
            name: report.name,
            position: report.position,
            attitude: report.attitude,
            tracked: true,
        }],
    }
}

/// Whether a socket's read ended because nothing came in time.
pub(in crate::mocap) fn is_timeout(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_vrpn_writes_them() {
        let read = |text: &str| text.parse::<VrpnAddress>().ok();
        let address = |host: &str, port, tcp_only| {
            Some(VrpnAddress {
                host: host.into(),
                port,
                tcp_only,
            })
        };
        assert_eq!(read("vicon"), address("vicon", 3883, false));
        assert_eq!(read("10.0.0.7:3884"), address("10.0.0.7", 3884, false));
        assert_eq!(read("tcp://vicon"), address("vicon", 3883, true));
        assert_eq!(read("tcp://vicon:1"), address("vicon", 1, true));
        for wrong in ["", "tcp://", "http://vicon", "vicon:port", "Drone1@vicon", "::1"] {
            assert_eq!(read(wrong), None, "{wrong}");
        }
    }
}
