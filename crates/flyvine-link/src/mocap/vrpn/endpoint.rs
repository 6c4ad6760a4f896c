//! One side of a VRPN connection without its sockets: bytes in, events out.

use std::collections::BTreeMap;
use std::net::SocketAddrV4;

use super::message::{
    COOKIE_LENGTH, LONGEST_NAME, Message, Reader, SENDER_DESCRIPTION, TYPE_DESCRIPTION, UDP_DESCRIPTION,
    VrpnError, cookie, read_cookie,
};

/// The name under which each side speaks of the connection itself; no device.
const CONTROL: &str = "VRPN Control";
/// Senders and types are numbered from 0 to this; the reference implementation stops at 2000.
const LAST_IDENTIFIER: i32 = 1999;

/// The message types that this side has, in the order of their numbers.
const OWN_TYPES: [(Kind, &str); 3] = [
    (Kind::Pose, "vrpn_Tracker Pos_Quat"),
    (Kind::Ping, "vrpn_Base ping_message"),
    (Kind::Pong, "vrpn_Base pong_message"),
];

/// A message type that means something here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Pose = 0,
    Ping = 1,
    Pong = 2,
}

/// A tracker's report of one sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// The tracker's name: a rigid body's, on motion-capture servers.
    pub name: String,
    /// Which of its sensors; motion-capture servers have only 0.
    pub sensor: i32,
    /// Time stamp, server clock, s.
    pub time_s: f64,
    /// Position, m.
    pub position: [f64; 3],
    /// Hamilton quaternion `world_from_body`, `[w, x, y, z]`; on the wire, the scalar part is last.
    pub attitude: [f64; 4],
}

/// What the peer said.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// Its cookie, with its version: the connection is up.
    Connected(String),
    /// It has a device of this name.
    Device(String),
    /// It wants reports as datagrams to this address.
    ReportsTo(SocketAddrV4),
    /// A tracker's report.
    Report(Report),
    /// It asks whether this device is alive. [`Endpoint`] has answered if this side has the device.
    Ping(String),
    /// The device is alive.
    Pong(String),
}

/// One side of a connection. Client and server differ only in what they do with the events.
#[derive(Debug)]
pub struct Endpoint {
    /// This side's senders, in the order of their numbers.
    senders: Vec<String>,
    /// Where this side wants reports, if by datagram.
    reports_to: Option<SocketAddrV4>,
    peer_senders: BTreeMap<i32, String>,
    peer_types: BTreeMap<i32, Kind>,
    connected: bool,
    input: Vec<u8>,
    output: Vec<u8>,
    sequence: u32,
}

impl Endpoint {
    /// A side that has, or wants to hear of, these devices, and wants reports as datagrams to `reports_to`, or over
    /// the connection.
    pub fn new(devices: &[String], reports_to: Option<SocketAddrV4>) -> Self {
        let mut endpoint = Endpoint {
            senders: vec![CONTROL.to_owned()],
            reports_to,
            peer_senders: BTreeMap::new(),
            peer_types: BTreeMap::new(),
            connected: false,
            input: Vec::new(),
            output: cookie().to_vec(),
            sequence: 0,
        };
        for name in devices {
            endpoint.sender(name, 0.0);
        }
        endpoint
    }

    /// Whether the peer's cookie has come.
    pub fn is_connected(&self) -> bool {
        self.connected
    }

    /// What is to be sent over the connection, in order. Until the peer's cookie has come, that is this side's.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    /// Takes bytes from the connection, however they were cut. `now_s` (Unix time) stamps the answers.
    ///
    /// # Errors
    /// The peer does not speak VRPN 07, asks for a log, or sent an impossible length: the connection is of no more
    /// use.
    pub fn receive(&mut self, bytes: &[u8], now_s: f64) -> Result<Vec<Event>, VrpnError> {
        let mut input = std::mem::take(&mut self.input);
        input.extend(bytes);
        let mut events = Vec::new();
        let mut read = 0;
        if !self.connected {
            let Some(cookie) = input.first_chunk::<COOKIE_LENGTH>() else {
                self.input = input;
                return Ok(events);
            };
            events.push(Event::Connected(read_cookie(cookie)?));
            read = COOKIE_LENGTH;
            self.connected = true;
            self.describe_all(now_s);
        }
        while let Some((message, size)) = Message::read(&input[read..])? {
            read += size;
            events.extend(self.message(&message, now_s)?);
        }
        input.drain(..read);
        self.input = input;
        Ok(events)
    }

    /// Takes a datagram of reports. Those of senders or types that were not described yet are dropped: the first
    /// reports may overtake the descriptions.
    ///
    /// # Errors
    /// The datagram is damaged; the connection is not.
    pub fn receive_datagram(&mut self, mut datagram: &[u8]) -> Result<Vec<Event>, VrpnError> {
        let mut events = Vec::new();
        while let Some((message, size)) = Message::read(datagram)? {
            datagram = &datagram[size..];
            if message.kind >= 0 {
                // A datagram carries reports; nothing in it needs an answer.
                events.extend(self.report_of(&message));
            }
        }
        Ok(events)
    }

    /// Appends a report to `out`. A device that the peer does not know yet is described to it over the connection.
    pub fn write_report(&mut self, report: &Report, out: &mut Vec<u8>) {
        let sender = self.sender(&report.name, report.time_s);
        let [x, y, z] = report.position;
        let [qw, qx, qy, qz] = report.attitude;
        let mut payload = Vec::with_capacity(64);
        // The second is filler; the reference server repeats the sensor there.
        payload.extend(report.sensor.to_be_bytes());
        payload.extend(report.sensor.to_be_bytes());
        for number in [x, y, z, qx, qy, qz, qw] {
            payload.extend(number.to_be_bytes());
        }
        let message = self.next_message(report.time_s, sender, Kind::Pose as i32, payload);
        message.write(out);
    }

    /// Asks the peer whether one of its devices is alive.
    pub fn ping(&mut self, device: &str, now_s: f64) {
        let sender = self.sender(device, now_s);
        self.send(now_s, sender, Kind::Ping as i32, Vec::new());
    }

    /// This side's number of the sender `name`; a new one is described to the peer.
    fn sender(&mut self, name: &str, now_s: f64) -> i32 {
        if let Some(index) = self.senders.iter().position(|sender| sender == name) {
            return index as i32;
        }
        let index = self.senders.len() as i32;
        self.senders.push(name.to_owned());
        if self.connected {
            self.send(now_s, index, SENDER_DESCRIPTION, name_payload(name));
        }
        index
    }

    /// What each side sends once both cookies were exchanged.
    fn describe_all(&mut self, now_s: f64) {
        if let Some(address) = self.reports_to {
            let mut ip = address.ip().to_string().into_bytes();
            ip.push(0);
            self.send(now_s, i32::from(address.port()), UDP_DESCRIPTION, ip);
        }
        for index in 0..self.senders.len() {
            let payload = name_payload(&self.senders[index]);
            self.send(now_s, index as i32, SENDER_DESCRIPTION, payload);
        }
        for (kind, name) in OWN_TYPES {
            self.send(now_s, kind as i32, TYPE_DESCRIPTION, name_payload(name));
        }
    }

    fn send(&mut self, time_s: f64, sender: i32, kind: i32, payload: Vec<u8>) {
        let message = self.next_message(time_s, sender, kind, payload);
        message.write(&mut self.output);
    }

    fn next_message(&mut self, time_s: f64, sender: i32, kind: i32, payload: Vec<u8>) -> Message {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        Message {
            time_s,
            sender,
            kind,
            sequence,
            payload,
        }
    }

    fn message(&mut self, message: &Message, now_s: f64) -> Result<Option<Event>, VrpnError> {
        match message.kind {
            SENDER_DESCRIPTION => {
                let name = described_name(message, "a sender")?;
                self.peer_senders.insert(message.sender, name.clone());
                Ok((name != CONTROL).then_some(Event::Device(name)))
            }
            TYPE_DESCRIPTION => {
                let name = described_name(message, "a type")?;
                let known = OWN_TYPES.into_iter().find(|(_, own)| *own == name);
                match known {
                    Some((kind, _)) => self.peer_types.insert(message.sender, kind),
                    None => self.peer_types.remove(&message.sender),
                };
                Ok(None)
            }
            UDP_DESCRIPTION => Ok(udp_address(message).map(Event::ReportsTo)),
            kind if kind < 0 => Ok(None),
            _ => Ok(self.device_message(message, now_s)),
        }
    }

    /// A message of a device, if it is of a kind that means something here.
    fn device_message(&mut self, message: &Message, now_s: f64) -> Option<Event> {
        let name = self.peer_senders.get(&message.sender)?.clone();
        match self.peer_types.get(&message.kind)? {
            Kind::Pose => self.report_of(message),
            Kind::Ping => {
                // Answered under this side's own number of the device.
                if let Some(own) = self.senders.iter().position(|sender| *sender == name) {
                    self.send(now_s, own as i32, Kind::Pong as i32, Vec::new());
                }
                Some(Event::Ping(name))
            }
            Kind::Pong => Some(Event::Pong(name)),
        }
    }

    fn report_of(&self, message: &Message) -> Option<Event> {
        let name = self.peer_senders.get(&message.sender)?;
        if self.peer_types.get(&message.kind)? != &Kind::Pose {
            return None;
        }
        let mut reader = Reader(&message.payload);
        let (sensor, _filler) = (reader.i32()?, reader.i32()?);
        let position = reader.f64s()?;
        let [qx, qy, qz, qw] = reader.f64s()?;
        Some(Event::Report(Report {
            name: name.clone(),
            sensor,
            time_s: message.time_s,
            position,
            attitude: [qw, qx, qy, qz],
        }))
    }
}

/// Length with the NUL, characters, NUL. Names beyond the protocol's longest are cut.
fn name_payload(name: &str) -> Vec<u8> {
    let end = name.floor_char_boundary(LONGEST_NAME - 1);
    let length = (end + 1) as u32;
    [&length.to_be_bytes()[..], &name.as_bytes()[..end], b"\0"].concat()
}

/// The name in a description of a sender or a type.
fn described_name(message: &Message, what: &'static str) -> Result<String, VrpnError> {
    if !(0..=LAST_IDENTIFIER).contains(&message.sender) {
        return Err(VrpnError::Identifier {
            what,
            found: message.sender,
            last: LAST_IDENTIFIER,
        });
    }
    let mut reader = Reader(&message.payload);
    let name = reader
        .u32()
        .and_then(|length| reader.0.get(..length as usize))
        .filter(|name| name.len() <= LONGEST_NAME);
    let Some(name) = name else {
        return Err(VrpnError::Length {
            what: "a name",
            found: message.payload.len() as u64,
            expected: "at most 100, as long as it says",
        });
    };
    let text = name.split(|&byte| byte == 0).next().unwrap_or_default();
    Ok(String::from_utf8_lossy(text).into_owned())
}

/// Where the peer wants its reports; `None` if that is no IPv4 address and port.
fn udp_address(message: &Message) -> Option<SocketAddrV4> {
    let ip = message.payload.split(|&byte| byte == 0).next()?;
    let ip = std::str::from_utf8(ip).ok()?.parse().ok()?;
    let port = u16::try_from(message.sender).ok().filter(|port| *port > 0)?;
    Some(SocketAddrV4::new(ip, port))
}

#[cfg(test)]
mod tests;
