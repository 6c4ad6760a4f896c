//! A VRPN server: sends the poses of rigid bodies to every client that asks.

use std::io::{Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, SocketAddrV4, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use super::client::is_timeout;
use super::lob::parse_lob;
use super::message::LONGEST_DATAGRAM;
use super::{Endpoint, Event, Report};
use crate::mocap::clock::unix_s;
use crate::mocap::{BodyPose, MocapError};

/// How long a thread sleeps in a socket before it looks whether it shall stop.
const TICK: Duration = Duration::from_millis(50);
/// How long a client may take to accept the call it asked for, or a write.
const PATIENCE: Duration = Duration::from_secs(2);
/// Clients served, or being called, at the same time.
const MOST_CLIENTS: usize = 32;
/// Writes that wait for a slow client. Reports beyond are dropped: a late pose is worse than none.
const QUEUE: usize = 64;

/// A VRPN server for rigid bodies. Dropping it closes all connections.
#[derive(Debug)]
pub struct VrpnServer {
    shared: Arc<Shared>,
    address: SocketAddr,
    threads: Vec<JoinHandle<()>>,
}

/// What the server's threads share.
#[derive(Debug)]
struct Shared {
    stop: AtomicBool,
    clients: Mutex<Vec<Arc<Client>>>,
    /// Clients, and those who are being called.
    places: AtomicUsize,
    /// Names of the bodies so far: what a new client is told.
    devices: Mutex<Vec<String>>,
    datagrams: UdpSocket,
    dropped: AtomicUsize,
}

/// One client.
#[derive(Debug)]
struct Client {
    stream: TcpStream,
    peer: IpAddr,
    endpoint: Mutex<Endpoint>,
    /// Where it wants reports as datagrams.
    reports_to: Mutex<Option<SocketAddrV4>>,
    queue: SyncSender<Vec<u8>>,
    over: AtomicBool,
}

impl VrpnServer {
    /// Listens at `address`, UDP and TCP. With port 0 the system chooses a port that is free for both.
    ///
    /// # Errors
    /// The address cannot be listened at.
    pub fn bind(address: SocketAddr) -> Result<Self, MocapError> {
        let (listener, datagrams) = bind_both(address).map_err(MocapError::socket(format!(
            "cannot listen at {address}, UDP and TCP"
        )))?;
        let setup = MocapError::socket("cannot set up the sockets");
        let address = listener
            .set_nonblocking(true)
            .and_then(|()| datagrams.set_read_timeout(Some(TICK)))
            .and_then(|()| listener.local_addr())
            .map_err(setup)?;
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            clients: Mutex::new(Vec::new()),
            places: AtomicUsize::new(0),
            devices: Mutex::new(Vec::new()),
            datagrams,
            dropped: AtomicUsize::new(0),
        });
        let mut server = VrpnServer {
            shared: shared.clone(),
            address,
            threads: Vec::new(),
        };
        let calls = shared.clone();
        let spawn = |name: &str, work: Box<dyn FnOnce() + Send>| {
            thread::Builder::new()
                .name(name.into())
                .spawn(work)
                .map_err(MocapError::Thread)
        };
        server
            .threads
            .push(spawn("vrpn calls", Box::new(move || answer_lobs(&calls)))?);
        server.threads.push(spawn(
            "vrpn accept",
            Box::new(move || accept(&shared, &listener)),
        )?);
        Ok(server)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// How many clients are connected.
    pub fn clients(&self) -> usize {
        self.shared.live_clients().len()
    }

    /// How many reports were dropped because a client did not take them in time.
    pub fn dropped_reports(&self) -> usize {
        self.shared.dropped.load(Ordering::Relaxed)
    }

    /// Sends the tracked ones of `bodies`, seen at `captured_s` (Unix time, s), to all clients. It never waits for a
    /// client.
    pub fn publish(&self, captured_s: f64, bodies: &[BodyPose]) {
        let reports: Vec<Report> = bodies
            .iter()
            .filter(|body| body.tracked)
            .map(|body| Report {
                name: body.name.clone(),
                sensor: 0,
                time_s: captured_s,
                position: body.position,
                attitude: body.attitude,
            })
            .collect();
        let mut devices = lock(&self.shared.devices);
        for report in &reports {
            if !devices.contains(&report.name) {
                devices.push(report.name.clone());
            }
        }
        drop(devices);
        for client in self.shared.live_clients() {
            let dropped = client.report(&reports, &self.shared.datagrams);
            self.shared.dropped.fetch_add(dropped, Ordering::Relaxed);
        }
    }
}

impl Drop for VrpnServer {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for client in lock(&self.shared.clients).drain(..) {
            client.close();
        }
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// The clients whose connections are up; the others are forgotten.
    fn live_clients(&self) -> Vec<Arc<Client>> {
        let mut clients = lock(&self.clients);
        clients.retain(|client| !client.over.load(Ordering::Relaxed));
        clients.clone()
    }

    /// Takes one of the places for clients; false if none is left.
    fn take_place(&self) -> bool {
        self.places
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |taken| {
                (taken < MOST_CLIENTS).then_some(taken + 1)
            })
            .is_ok()
    }

    fn leave_place(&self) {
        self.places.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A lock on state that no thread leaves half-changed.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("no thread panics with it")
}

/// Binds TCP and UDP to the same port.
fn bind_both(address: SocketAddr) -> std::io::Result<(TcpListener, UdpSocket)> {
    const ATTEMPTS: usize = 20;
    let mut attempt = 0;
    loop {
        let listener = TcpListener::bind(address)?;
        match UdpSocket::bind(listener.local_addr()?) {
            // Someone else has the UDP port that goes with a TCP port of the system's choice.
            Err(_) if address.port() == 0 && attempt < ATTEMPTS => attempt += 1,
            socket => return Ok((listener, socket?)),
        }
    }
}

/// Calls the clients that ask for it. Each call has a thread of its own: a bad address stalls nobody else.
fn answer_lobs(shared: &Arc<Shared>) {
    let mut buffer = [0; 256];
    while !shared.stopped() {
        let Ok((count, from)) = shared.datagrams.recv_from(&mut buffer) else {
            continue;
        };
        let Some(address) = parse_lob(&buffer[..count]) else {
            continue;
        };
        // Nobody shall make this server call a third party.
        let own = IpAddr::V4(*address.ip()) == from.ip();
        let both_local = address.ip().is_loopback() && from.ip().is_loopback();
        if (own || both_local) && shared.take_place() {
            spawn(shared, move |shared| {
                if let Ok(stream) = TcpStream::connect_timeout(&address.into(), PATIENCE) {
                    serve(shared, stream);
                }
            });
        }
    }
}

/// Accepts the clients that call.
fn accept(shared: &Arc<Shared>, listener: &TcpListener) {
    while !shared.stopped() {
        match listener.accept() {
            Ok((stream, _)) if shared.take_place() => {
                spawn(shared, move |shared| {
                    if stream.set_nonblocking(false).is_ok() {
                        serve(shared, stream);
                    }
                });
            }
            // No place left: it is closed.
            Ok(_) => (),
            Err(_) => thread::sleep(Duration::from_millis(5)),
        }
    }
}

/// Starts the thread of a client that has taken a place, and gives the place back at its end.
fn spawn(shared: &Arc<Shared>, work: impl FnOnce(&Arc<Shared>) + Send + 'static) {
    let theirs = shared.clone();
    let spawned = thread::Builder::new()
        .name("vrpn connection".into())
        .spawn(move || {
            work(&theirs);
            theirs.leave_place();
        });
    if spawned.is_err() {
        shared.leave_place();
    }
}

/// Lives on one connection until it ends.
fn serve(shared: &Arc<Shared>, mut stream: TcpStream) {
    let setup = stream
        .set_nodelay(true)
        .and_then(|()| stream.set_read_timeout(Some(TICK)))
        .and_then(|()| stream.set_write_timeout(Some(PATIENCE)));
    let (Ok(()), Ok(writing), Ok(closing), Ok(peer)) =
        (setup, stream.try_clone(), stream.try_clone(), stream.peer_addr())
    else {
        return;
    };
    let (queue, waiting) = sync_channel(QUEUE);
    let devices = lock(&shared.devices).clone();
    let client = Arc::new(Client {
        stream: closing,
        peer: peer.ip(),
        endpoint: Mutex::new(Endpoint::new(&devices, None)),
        reports_to: Mutex::new(None),
        queue,
        over: AtomicBool::new(false),
    });
    client.send_output();
    lock(&shared.clients).push(client.clone());
    thread::scope(|scope| {
        let writer = &client;
        scope.spawn(move || write_queue(writer, writing, &waiting));
        let mut buffer = [0; 4096];
        while !shared.stopped() && !client.over.load(Ordering::Relaxed) {
            match stream.read(&mut buffer) {
                Ok(count) if count > 0 && client.receive(&buffer[..count]) => (),
                Err(error) if is_timeout(&error) => (),
                // Closed, reset, or not VRPN.
                _ => break,
            }
        }
        client.close();
    });
}

/// Writes what waits for a client, until the connection is over.
fn write_queue(client: &Client, mut stream: TcpStream, waiting: &Receiver<Vec<u8>>) {
    while !client.over.load(Ordering::Relaxed) {
        if let Ok(bytes) = waiting.recv_timeout(TICK)
            && stream.write_all(&bytes).is_err()
        {
            client.close();
        }
    }
}

impl Client {
    fn close(&self) {
        self.over.store(true, Ordering::Relaxed);
        // The peer may have closed it already.
        let _ = self.stream.shutdown(Shutdown::Both);
    }

    /// Takes bytes from the client; false if the connection is of no more use.
    fn receive(&self, bytes: &[u8]) -> bool {
        let Ok(events) = lock(&self.endpoint).receive(bytes, unix_s()) else {
            return false;
        };
        for event in events {
            if let Event::ReportsTo(address) = event {
                // Nobody shall make this server send to a third party; such a client gets its reports by TCP.
                let own = IpAddr::V4(*address.ip()) == self.peer;
                *lock(&self.reports_to) = own.then_some(address);
            }
        }
        self.send_output()
    }

    /// Sends what the endpoint has to say over the connection; false if the client does not take it.
    fn send_output(&self) -> bool {
        // The lock keeps two threads from sending what they took in the other order.
        let mut endpoint = lock(&self.endpoint);
        let output = endpoint.take_output();
        output.is_empty() || self.queue.try_send(output).is_ok()
    }

    /// Sends reports, by datagram if the client wants them so; returns how many it could not take.
    fn report(&self, reports: &[Report], datagrams: &UdpSocket) -> usize {
        let mut endpoint = lock(&self.endpoint);
        if !endpoint.is_connected() {
            return 0;
        }
        let reports_to = *lock(&self.reports_to);
        let mut packets = Packets::default();
        for report in reports {
            let mut bytes = Vec::with_capacity(88);
            endpoint.write_report(report, &mut bytes);
            packets.push(&bytes);
        }
        // What describes a new body goes ahead of its first report.
        let descriptions = endpoint.take_output();
        if !descriptions.is_empty() && self.queue.try_send(descriptions).is_err() {
            self.close();
            return reports.len();
        }
        drop(endpoint);
        let mut dropped = 0;
        for (packet, count) in packets.0 {
            let sent = match reports_to {
                Some(address) => datagrams.send_to(&packet, address).is_ok(),
                None => self.queue.try_send(packet).is_ok(),
            };
            if !sent {
                dropped += count;
            }
        }
        dropped
    }
}

/// Reports in as few datagrams as hold them whole, with the number in each.
#[derive(Default)]
struct Packets(Vec<(Vec<u8>, usize)>);

impl Packets {
    fn push(&mut self, report: &[u8]) {
        match self.0.last_mut() {
            Some((packet, count)) if packet.len() + report.len() <= LONGEST_DATAGRAM => {
                packet.extend(report);
                *count += 1;
            }
            _ => self.0.push((report.to_vec(), 1)),
        }
    }
}
