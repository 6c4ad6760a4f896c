//! Poses and the arm between two processes of one machine, a datagram each: what a rehearsal uses where a laboratory has
//! cameras and a serial line. Little-endian; times are seconds since 1970, NaN stays NaN.

use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};

use flyvine::flight::Pose;

use crate::autopilot::{ArmLink, ArmTelemetry, LatestPoses, MonotonicClock, PoseSource, Stamped};

const POSES: [u8; 4] = *b"FVP1";
const ARM_COMMAND: [u8; 4] = *b"FVC1";
const ARM_TELEMETRY: [u8; 4] = *b"FVT1";

/// A datagram: its kind, a byte and some numbers.
fn encode(kind: [u8; 4], byte: u8, numbers: &[f64]) -> Vec<u8> {
    let mut datagram = kind.to_vec();
    datagram.push(byte);
    datagram.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    datagram
}

/// The byte and the numbers of a datagram of this kind and size.
fn decode<const N: usize>(kind: [u8; 4], datagram: &[u8]) -> Option<(u8, [f64; N])> {
    let rest = datagram.strip_prefix(&kind)?;
    let (&byte, rest) = rest.split_first()?;
    if rest.len() != 8 * N {
        return None;
    }
    let mut numbers = [0.0; N];
    for (number, bytes) in numbers.iter_mut().zip(rest.chunks_exact(8)) {
        *number = f64::from_le_bytes(bytes.try_into().ok()?);
    }
    Some((byte, numbers))
}

fn bind(address: impl ToSocketAddrs) -> std::io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

/// Calls `each` with every datagram that waits.
fn drain(socket: &UdpSocket, mut each: impl FnMut(&[u8], SocketAddr)) {
    let mut datagram = [0; 256];
    loop {
        match socket.recv_from(&mut datagram) {
            Ok((length, from)) => each(&datagram[..length], from),
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionRefused => (),
            Err(_) => return,
        }
    }
}

/// Sends the newest poses to a listener.
pub struct PoseFeed {
    socket: UdpSocket,
    to: SocketAddr,
    sent_s: f64,
}

impl PoseFeed {
    /// A feed to the listener at `to`.
    pub fn to(to: SocketAddr) -> std::io::Result<Self> {
        let socket = bind((to.ip(), 0))?;
        let sent_s = f64::NEG_INFINITY;
        Ok(Self { socket, to, sent_s })
    }

    /// Sends `latest` if it is new.
    pub fn publish(&mut self, clock: &MonotonicClock, latest: &LatestPoses) {
        let stamps = [
            latest.quadrotor.map(|pose| pose.captured_s),
            latest.end_effector.map(|tip| tip.captured_s),
        ];
        let newest_s = stamps.into_iter().flatten().fold(f64::NEG_INFINITY, f64::max);
        if newest_s <= self.sent_s {
            return;
        }
        self.sent_s = newest_s;
        let present = stamps.map(|stamp| stamp == Some(newest_s));
        let nowhere = Pose {
            position: [f64::NAN; 3],
            attitude: [f64::NAN; 4],
        };
        let Pose { position, attitude } = latest.quadrotor.map_or(nowhere, |pose| pose.value);
        let tip = latest.end_effector.map_or([f64::NAN; 3], |tip| tip.value);
        let mut numbers = vec![clock.unix_s(newest_s)];
        numbers.extend(position.into_iter().chain(attitude).chain(tip));
        let flags = u8::from(present[0]) | u8::from(present[1]) << 1;
        let _ = self.socket.send_to(&encode(POSES, flags, &numbers), self.to);
    }
}

/// Listens to a [`PoseFeed`].
pub struct PoseListener {
    socket: UdpSocket,
    clock: MonotonicClock,
    latest: LatestPoses,
}

impl PoseListener {
    /// Listens on `address`; times are put on `clock`.
    pub fn bind(address: impl ToSocketAddrs, clock: MonotonicClock) -> std::io::Result<Self> {
        let socket = bind(address)?;
        let latest = LatestPoses::default();
        Ok(Self {
            socket,
            clock,
            latest,
        })
    }
}

impl PoseSource for PoseListener {
    fn latest(&mut self, _now_s: f64) -> LatestPoses {
        let Self {
            socket,
            clock,
            latest,
        } = self;
        drain(socket, |datagram, _| {
            let Some((flags, [unix_s, x, y, z, qw, qx, qy, qz, tip @ ..])) = decode::<11>(POSES, datagram)
            else {
                return;
            };
            let captured_s = clock.from_unix_s(unix_s);
            if flags & 1 != 0 {
                let value = Pose {
                    position: [x, y, z],
                    attitude: [qw, qx, qy, qz],
                };
                latest.quadrotor = Some(Stamped { value, captured_s });
            }
            if flags & 2 != 0 {
                latest.end_effector = Some(Stamped {
                    value: tip,
                    captured_s,
                });
            }
        });
        *latest
    }
}

/// The arm's end of its line.
pub struct ArmServer {
    socket: UdpSocket,
    base: Option<SocketAddr>,
}

impl ArmServer {
    /// Waits on `address` for a base station.
    pub fn bind(address: impl ToSocketAddrs) -> std::io::Result<Self> {
        let socket = bind(address)?;
        Ok(Self { socket, base: None })
    }

    /// The newest growth rate, m/s, and pressure, kPa, since the last call.
    pub fn receive(&mut self) -> Option<(f64, f64)> {
        let Self { socket, base } = self;
        let mut newest = None;
        drain(socket, |datagram, from| {
            if let Some((_, [growth_m_s, pressure_kpa])) = decode::<2>(ARM_COMMAND, datagram) {
                *base = Some(from);
                newest = Some((growth_m_s, pressure_kpa));
            }
        });
        newest
    }

    /// Tells the base station, if there is one, how the arm is.
    pub fn publish(&mut self, telemetry: &ArmTelemetry) {
        if let Some(base) = self.base {
            let numbers = [telemetry.length_m.unwrap_or(f64::NAN)];
            let datagram = encode(ARM_TELEMETRY, telemetry.fault.unwrap_or(0), &numbers);
            let _ = self.socket.send_to(&datagram, base);
        }
    }
}

/// The base station's end of the line to an [`ArmServer`].
pub struct ArmClient {
    socket: UdpSocket,
    arm: SocketAddr,
    telemetry: Option<ArmTelemetry>,
    asked_s: f64,
}

/// Time between two words to an arm that has not answered yet, s.
const ARM_CALL_S: f64 = 0.1;

impl ArmClient {
    /// A line to the arm at `arm`.
    pub fn to(arm: SocketAddr) -> std::io::Result<Self> {
        Ok(Self {
            socket: bind((arm.ip(), 0))?,
            arm,
            telemetry: None,
            asked_s: f64::NEG_INFINITY,
        })
    }
}

impl ArmLink for ArmClient {
    fn command(&mut self, _now_s: f64, growth_m_s: f64, pressure_kpa: f64) {
        let datagram = encode(ARM_COMMAND, 0, &[growth_m_s, pressure_kpa]);
        let _ = self.socket.send_to(&datagram, self.arm);
    }

    fn telemetry(&mut self, now_s: f64) -> Option<ArmTelemetry> {
        let Self {
            socket, telemetry, ..
        } = self;
        drain(socket, |datagram, _| {
            if let Some((fault, [length_m])) = decode::<1>(ARM_TELEMETRY, datagram) {
                *telemetry = Some(ArmTelemetry {
                    heard_s: now_s,
                    length_m: length_m.is_finite().then_some(length_m),
                    fault: (fault != 0).then_some(fault),
                });
            }
        });
        // Standing still is what it is told until there is a flight.
        if self.telemetry.is_none() && now_s >= self.asked_s + ARM_CALL_S {
            self.asked_s = now_s;
            self.command(now_s, 0.0, f64::NAN);
        }
        Some(self.telemetry.unwrap_or(ArmTelemetry {
            heard_s: f64::NEG_INFINITY,
            length_m: None,
            fault: None,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::Clock;
    use std::time::Duration;

    /// Calls `ask` until it answers.
    fn until<T>(mut ask: impl FnMut() -> Option<T>) -> T {
        for _ in 0..2000 {
            if let Some(answer) = ask() {
                return answer;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("no answer")
    }

    #[test]
    fn poses_arrive_with_their_time_and_their_nans() {
        let clock = MonotonicClock::start();
        let mut listener = PoseListener::bind("127.0.0.1:0", clock).unwrap();
        let mut feed = PoseFeed::to(listener.socket.local_addr().unwrap()).unwrap();
        let value = Pose {
            position: [1.0, 2.0, f64::NAN],
            attitude: [1.0, 0.0, 0.0, 0.0],
        };
        let captured_s = clock.now_s();
        let sent = LatestPoses {
            quadrotor: Some(Stamped { value, captured_s }),
            end_effector: None,
        };
        let seen = until(|| {
            feed.publish(&clock, &sent);
            listener.latest(0.0).quadrotor
        });
        assert!((seen.captured_s - captured_s).abs() < 1e-5);
        assert_eq!(seen.value.position[..2], [1.0, 2.0]);
        assert!(seen.value.position[2].is_nan() && listener.latest(0.0).end_effector.is_none());
    }

    #[test]
    fn the_arm_is_commanded_and_answers() {
        let mut server = ArmServer::bind("127.0.0.1:0").unwrap();
        let mut client = ArmClient::to(server.socket.local_addr().unwrap()).unwrap();
        assert_eq!(client.telemetry(5.0).unwrap().heard_s, f64::NEG_INFINITY);
        client.command(5.0, 0.01, 0.2);
        until(|| server.receive().filter(|command| *command == (0.01, 0.2)));
        let told = ArmTelemetry {
            heard_s: 0.0,
            length_m: Some(0.8),
            fault: Some(3),
        };
        let heard = until(|| {
            server.publish(&told);
            client
                .telemetry(6.0)
                .filter(|telemetry| telemetry.fault.is_some())
        });
        assert_eq!(heard, ArmTelemetry { heard_s: 6.0, ..told });
    }

    #[test]
    fn other_datagrams_are_not_read() {
        assert_eq!(decode::<2>(ARM_COMMAND, &encode(ARM_COMMAND, 0, &[1.0])), None);
        assert_eq!(decode::<1>(ARM_COMMAND, &encode(POSES, 0, &[1.0])), None);
        assert_eq!(decode::<1>(ARM_COMMAND, b"FV"), None);
    }
}
