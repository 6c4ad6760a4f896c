//! Between the autopilot's serial port and datagrams.

use std::fs::File;
use std::net::{SocketAddr, UdpSocket};

use super::mavlink_packets::PacketSplitter;
use super::serial_port::SerialPort;
use super::{FcuPort, OnboardError, OnboardEvent, Traffic, open_sides, receive};

/// One autopilot and whoever talks to it.
pub(super) struct FcuBridge {
    port: SerialPort,
    socket: UdpSocket,
    peer: SocketAddr,
    from_serial: PacketSplitter,
    traffic: Traffic,
}

impl FcuBridge {
    pub(super) fn open(
        options: &FcuPort,
        tell: &mut dyn FnMut(OnboardEvent),
    ) -> Result<FcuBridge, OnboardError> {
        let (port, socket) = open_sides("autopilot", &options.path, options.baud, options.listen, tell)?;
        Ok(FcuBridge {
            port,
            socket,
            peer: options.peer,
            from_serial: PacketSplitter::default(),
            traffic: Traffic::default(),
        })
    }

    /// What to wait for.
    pub(super) fn lines(&self) -> (Option<&File>, &UdpSocket) {
        (self.port.file(), &self.socket)
    }

    /// What was carried; bytes that belonged to no packet count as rejected.
    pub(super) fn traffic(&self) -> Traffic {
        Traffic {
            rejected: self.traffic.rejected + self.from_serial.skipped,
            dropped: self.port.dropped,
            ..self.traffic
        }
    }

    /// Carries what has arrived on either side.
    pub(super) fn turn(&mut self, now_s: f64, tell: &mut dyn FnMut(OnboardEvent)) {
        self.port.reopen(now_s, tell);
        let FcuBridge {
            port,
            socket,
            peer,
            traffic,
            ..
        } = self;
        receive(socket, |datagram, from| {
            // A datagram holds whole packets; what it cuts short is not carried.
            let (mut splitter, mut packets) = (PacketSplitter::default(), 0);
            splitter.extend(datagram, |packet| {
                packets += 1;
                port.send(packet);
            });
            traffic.to_serial += packets;
            traffic.rejected += splitter.skipped + u64::from(splitter.is_cut());
            if packets > 0 && *peer != from {
                *peer = from;
                tell(OnboardEvent::Peer {
                    what: "autopilot",
                    address: from,
                });
            }
        });

        let mut buffer = [0; 4096];
        let bytes = self.port.read(now_s, &mut buffer, tell);
        let (socket, peer, traffic) = (&self.socket, self.peer, &mut self.traffic);
        self.from_serial.extend(bytes, |packet| {
            traffic.from_serial += 1;
            // That a datagram may be lost is the network's nature.
            let _ = socket.send_to(packet, peer);
        });
        self.port.flush(now_s, tell);
    }
}
