//! A motion-capture server with two moving bodies, for the tests of clients.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use flyvine_link::mocap::{BodyPose, MocapServer};

/// Loopback, at a port that the system chooses.
pub const ANY_PORT: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// Publishes at 100 Hz until it is dropped: `drone` on a circle of 1 m at 1.5 m, `tip` 0.7 m below, both turned by
/// 90° about z.
pub struct MovingBodies {
    pub server: Arc<MocapServer>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl MovingBodies {
    pub fn publish_on(server: MocapServer) -> Self {
        let (server, stop) = (Arc::new(server), Arc::new(AtomicBool::new(false)));
        let (publisher, stopped) = (server.clone(), stop.clone());
        let thread = thread::spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                let now_s = SystemTime::now()
                    .duration_since(UNIX_EPOCH)
                    .unwrap()
                    .as_secs_f64();
                let angle = now_s % 1000.0;
                let body = |name: &str, height_m| BodyPose {
                    name: name.into(),
                    position: [angle.cos(), angle.sin(), height_m],
                    attitude: [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()],
                    tracked: true,
                };
                publisher
                    .publish(now_s, &[body("drone", 1.5), body("tip", 0.8)])
                    .unwrap();
                thread::sleep(Duration::from_millis(10));
            }
        });
        MovingBodies {
            server,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for MovingBodies {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// A UDP port that is free now.
pub fn free_udp_port() -> u16 {
    UdpSocket::bind(ANY_PORT).unwrap().local_addr().unwrap().port()
}

/// Waits until `condition` holds; fails after 20 s.
#[allow(dead_code, reason = "not every test binary waits")]
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(
            began.elapsed() < Duration::from_secs(20),
            "waited in vain: {what}"
        );
        thread::sleep(Duration::from_millis(5));
    }
}
