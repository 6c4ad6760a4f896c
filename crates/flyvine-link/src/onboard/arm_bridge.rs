//! Between the arm's serial port and datagrams.

use std::fs::File;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use vine_arm::{Decoder, Frame, Message, Request, Setpoint, State};

use super::serial_port::SerialPort;
use super::{ArmPort, ArmProtocol, OnboardError, OnboardEvent, Traffic, open_sides, receive};
use crate::arm::{ArmClient, LegacyDevice};

/// How long the daemon waits for the arm to acknowledge its stop.
const STOP_LIMIT: Duration = Duration::from_secs(1);
/// Period of a legacy arm's commands, s.
const LEGACY_PERIOD_S: f64 = 0.05;

/// What is behind the serial port.
enum Arm {
    Framed,
    Legacy {
        device: Box<LegacyDevice>,
        stepped_s: f64,
        sent_s: f64,
        commands: String,
    },
}

/// One arm and whoever talks to it.
pub(super) struct ArmBridge {
    port: SerialPort,
    socket: UdpSocket,
    peer: Option<SocketAddr>,
    arm: Arm,
    from_serial: Decoder,
    traffic: Traffic,
}

impl ArmBridge {
    pub(super) fn open(
        options: &ArmPort,
        tell: &mut dyn FnMut(OnboardEvent),
    ) -> Result<ArmBridge, OnboardError> {
        let arm = match options.protocol {
            ArmProtocol::Framed => Arm::Framed,
            ArmProtocol::Legacy(options) => Arm::Legacy {
                device: Box::new(LegacyDevice::new(options)?),
                stepped_s: 0.0,
                sent_s: 0.0,
                commands: String::new(),
            },
        };
        let (port, socket) = open_sides("arm", &options.path, options.baud, options.listen, tell)?;
        Ok(ArmBridge {
            port,
            socket,
            peer: None,
            arm,
            from_serial: Decoder::new(),
            traffic: Traffic::default(),
        })
    }

    /// What to wait for.
    pub(super) fn lines(&self) -> (Option<&File>, &UdpSocket) {
        (self.port.file(), &self.socket)
    }

    /// What was carried.
    pub(super) fn traffic(&self) -> Traffic {
        Traffic {
            dropped: self.port.dropped,
            ..self.traffic
        }
    }

    /// Carries what has arrived on either side.
    pub(super) fn turn(&mut self, now_s: f64, tell: &mut dyn FnMut(OnboardEvent)) {
        self.port.reopen(now_s, tell);
        let requests = self.requests(tell);
        match &mut self.arm {
            Arm::Framed => {
                for request in &requests {
                    self.port.send(&request.encode());
                }
                self.carry_answers(now_s, tell);
            }
            Arm::Legacy { .. } => self.drive_legacy(now_s, &requests, tell),
        }
        self.port.flush(now_s, tell);
    }

    /// The whole requests among the datagrams that have arrived.
    fn requests(&mut self, tell: &mut dyn FnMut(OnboardEvent)) -> Vec<Frame> {
        let ArmBridge {
            socket,
            peer,
            traffic,
            ..
        } = self;
        let mut requests = Vec::new();
        receive(socket, |datagram, from| {
            // Each datagram stands for itself: a frame never continues in the next.
            let mut decoder = Decoder::new();
            let before = requests.len();
            decoder.extend(datagram, |frame| match frame {
                Ok(frame) if matches!(frame.message, Message::Request(_)) => requests.push(frame),
                Ok(_) | Err(_) => traffic.rejected += 1,
            });
            if requests.len() > before && *peer != Some(from) {
                *peer = Some(from);
                tell(OnboardEvent::Peer {
                    what: "arm",
                    address: from,
                });
            }
        });
        traffic.to_serial += requests.len() as u64;
        requests
    }

    fn carry_answers(&mut self, now_s: f64, tell: &mut dyn FnMut(OnboardEvent)) {
        let mut buffer = [0; 2048];
        let bytes = self.port.read(now_s, &mut buffer, tell);
        let (socket, peer, traffic) = (&self.socket, self.peer, &mut self.traffic);
        self.from_serial.extend(bytes, |frame| match frame {
            Ok(frame) if !matches!(frame.message, Message::Request(_)) => {
                traffic.from_serial += 1;
                answer(socket, peer, &frame.encode());
            }
            Ok(_) | Err(_) => traffic.rejected += 1,
        });
    }

    fn drive_legacy(&mut self, now_s: f64, requests: &[Frame], tell: &mut dyn FnMut(OnboardEvent)) {
        // The old arm says nothing; what arrives all the same is read away.
        self.port.read(now_s, &mut [0; 2048], tell);
        let Arm::Legacy {
            device,
            stepped_s,
            sent_s,
            commands,
        } = &mut self.arm
        else {
            return;
        };
        let (socket, peer, traffic) = (&self.socket, self.peer, &mut self.traffic);
        let mut send = |frame: &[u8]| {
            traffic.from_serial += 1;
            answer(socket, peer, frame);
        };
        for request in requests {
            device.receive(&request.encode(), &mut send);
        }
        let elapsed_us = ((now_s - *stepped_s) * 1e6) as u32;
        if elapsed_us == 0 {
            return;
        }
        *stepped_s = now_s;
        let now_commands = device.step(elapsed_us, &mut send);
        // Twenty times a second, and at once when they stop or change direction.
        if now_s - *sent_s >= LEGACY_PERIOD_S || now_commands != *commands {
            *sent_s = now_s;
            self.port.send(now_commands.as_bytes());
            *commands = now_commands;
        }
    }

    /// Tells the arm to stop until it agrees, for a second at most; returns whether it did.
    pub(super) fn stop(&mut self, start: Instant) -> bool {
        let until = Instant::now() + STOP_LIMIT;
        let now_s = || start.elapsed().as_secs_f64();
        let mut client = ArmClient::new(now_s());
        client.ask(Request::Stop);
        while client.status(now_s()).asked.is_some() && Instant::now() < until {
            let frame = client.tick(now_s(), Setpoint::default());
            match &mut self.arm {
                Arm::Framed => self.port.send(&frame),
                Arm::Legacy { device, .. } => {
                    device.receive(&frame, |answer| client.receive(now_s(), answer));
                    // A millisecond, so that the stop is in the commands.
                    let commands = device.step(1_000, |_| {});
                    debug_assert_eq!(device.state(), State::Stopped);
                    self.port.send(commands.as_bytes());
                }
            }
            self.port.flush(now_s(), &mut |_| {});
            std::thread::sleep(Duration::from_millis(20));
            let mut buffer = [0; 2048];
            let bytes = self.port.read(now_s(), &mut buffer, &mut |_| {});
            if matches!(self.arm, Arm::Framed) {
                client.receive(now_s(), bytes);
            }
        }
        client.status(now_s()).asked.is_none()
    }
}

/// Sends a datagram to the peer, if there is one; that it may be lost is the network's nature.
fn answer(socket: &UdpSocket, peer: Option<SocketAddr>, frame: &[u8]) {
    if let Some(peer) = peer {
        let _ = socket.send_to(frame, peer);
    }
}
