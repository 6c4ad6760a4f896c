//! A NatNet 3.1 server: sends the poses of rigid bodies to every client that asked, unicast.

use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use ::natnet::serverinfo::ConnectionInfo;
use ::natnet::{
    DataSet, MessageHeader, ModelDef, NAT_CONNECT, NAT_REQUEST_MODELDEF, PlannedBody, RigidBodyDef,
    ServerInfo, SyntheticServer, Version,
};

use crate::mocap::clock::unix_s;
use crate::mocap::{BodyPose, MocapError};

const VERSION: Version = Version::new(3, 1, 0, 0);
/// Ticks of the server's clock per second; it counts Unix time.
const CLOCK_HZ: u64 = 1_000_000;
/// How long the thread sleeps in its socket before it looks whether it shall stop.
const TICK: Duration = Duration::from_millis(50);
/// Clients served at the same time; one more takes the place of the one that came first.
const MOST_CLIENTS: usize = 16;

/// A NatNet server for rigid bodies whose names it knows from the start.
#[derive(Debug)]
pub struct NatNetServer {
    shared: Arc<Shared>,
    address: SocketAddr,
    thread: Option<JoinHandle<()>>,
    frame_number: AtomicI32,
}

#[derive(Debug)]
struct Shared {
    stop: AtomicBool,
    socket: UdpSocket,
    data_port: u16,
    /// Bodies in the order of their numbers, which count from 1.
    names: Vec<String>,
    clients: Mutex<Vec<IpAddr>>,
}

impl NatNetServer {
    /// Listens for commands at `address` (port 0: the system chooses) and sends frames to `data_port` of the
    /// clients' machines.
    ///
    /// # Errors
    /// The address cannot be listened at; a name that the protocol cannot carry.
    pub fn bind(address: SocketAddr, data_port: u16, names: &[String]) -> Result<Self, MocapError> {
        let socket = UdpSocket::bind(address)
            .map_err(MocapError::socket(format!("cannot listen at {address}, UDP")))?;
        let address = socket
            .set_read_timeout(Some(TICK))
            .and_then(|()| socket.local_addr())
            .map_err(MocapError::socket("cannot set up the socket"))?;
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            socket,
            data_port,
            names: names.to_vec(),
            clients: Mutex::new(Vec::new()),
        });
        let (info, model) = (shared.introduction()?, shared.model()?);
        let answering = shared.clone();
        let thread = thread::Builder::new()
            .name("natnet server".into())
            .spawn(move || answering.answer(&info, &model))
            .map_err(MocapError::Thread)?;
        Ok(NatNetServer {
            shared,
            address,
            thread: Some(thread),
            frame_number: AtomicI32::new(0),
        })
    }

    /// Where it listens for commands.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// How many clients have asked for data.
    pub fn clients(&self) -> usize {
        self.shared.clients().len()
    }

    /// Sends those of `bodies` that have a number, seen at `captured_s` (Unix time, s), to all clients. It never waits
    /// for a client.
    ///
    /// # Errors
    /// The frame cannot be encoded.
    pub fn publish(&self, captured_s: f64, bodies: &[BodyPose]) -> Result<(), MocapError> {
        let planned: Vec<PlannedBody> = bodies
            .iter()
            .filter_map(|body| Some(planned(body, self.shared.number(&body.name)?)))
            .collect();
        let number = self.frame_number.fetch_add(1, Ordering::Relaxed);
        let mut frame = SyntheticServer::new(VERSION, CLOCK_HZ).frame(number, captured_s, &planned);
        frame.timing.transmit = (unix_s().max(captured_s) * CLOCK_HZ as f64) as u64;
        let datagram = frame.to_datagram(VERSION)?;
        for client in self.shared.clients() {
            // A client that is gone is not told apart from one that listens.
            let _ = self
                .shared
                .socket
                .send_to(&datagram, (client, self.shared.data_port));
        }
        Ok(())
    }
}

impl Drop for NatNetServer {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A body as the protocol carries it; its quaternion's scalar part is last.
fn planned(body: &BodyPose, number: i32) -> PlannedBody {
    let [qw, qx, qy, qz] = body.attitude;
    PlannedBody {
        id: number,
        position: body.position.map(|x| x as f32),
        orientation: [qx, qy, qz, qw].map(|x| x as f32),
        mean_marker_error: 0.0,
        tracking_valid: body.tracked,
    }
}

impl Shared {
    fn clients(&self) -> Vec<IpAddr> {
        self.clients.lock().expect("no thread panics with it").clone()
    }

    fn number(&self, name: &str) -> Option<i32> {
        let index = self.names.iter().position(|own| own == name)?;
        Some(index as i32 + 1)
    }

    fn introduction(&self) -> Result<Vec<u8>, MocapError> {
        let info = ServerInfo {
            application_name: "flyvine".into(),
            server_version: Version::new(0, 1, 0, 0),
            protocol_version: VERSION,
            high_res_clock_frequency: CLOCK_HZ,
            connection: ConnectionInfo {
                data_port: self.data_port,
                multicast: false,
                multicast_group: [0; 4],
            },
        };
        Ok(info.to_datagram()?)
    }

    fn model(&self) -> Result<Vec<u8>, MocapError> {
        let bodies = self.names.iter().zip(1..).map(|(name, id)| {
            DataSet::RigidBody(RigidBodyDef {
                name: name.clone(),
                id,
                parent_id: -1,
                offset: [0.0; 3],
                // The number of markers: none.
                tail: vec![0; 4],
            })
        });
        let model = ModelDef {
            datasets: bodies.collect(),
        };
        Ok(model.to_datagram(VERSION)?)
    }

    fn answer(&self, info: &[u8], model: &[u8]) {
        let mut buffer = [0; 2048];
        while !self.stop.load(Ordering::Relaxed) {
            let Ok((count, from)) = self.socket.recv_from(&mut buffer) else {
                continue;
            };
            let Ok(header) = MessageHeader::parse(&buffer[..count]) else {
                continue;
            };
            let answer = match header.message_id {
                NAT_CONNECT => {
                    self.remember(from.ip());
                    info
                }
                NAT_REQUEST_MODELDEF => model,
                // Signs of life need no answer.
                _ => continue,
            };
            // A client that does not get it asks again.
            let _ = self.socket.send_to(answer, from);
        }
    }

    fn remember(&self, client: IpAddr) {
        let mut clients = self.clients.lock().expect("no thread panics with it");
        if !clients.contains(&client) {
            if clients.len() == MOST_CLIENTS {
                clients.remove(0);
            }
            clients.push(client);
        }
    }
}
