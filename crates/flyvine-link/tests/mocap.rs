//! Motion-capture clients and servers over loopback.

mod common;

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use common::{ANY_PORT, MovingBodies, free_udp_port, wait_until};
use flyvine_link::mocap::vrpn::message::{COOKIE_LENGTH, cookie};
use flyvine_link::mocap::vrpn::{VrpnServer, format_lob};
use flyvine_link::mocap::{Address, Bodies, BodyPose, HygieneLimits, MocapServer, MocapSource};

fn source(address: &str) -> MocapSource {
    let address: Address = address.parse().unwrap();
    let bodies = Bodies::named("drone", "tip");
    MocapSource::start(&address, Some(bodies), HygieneLimits::default(), None).unwrap()
}

fn server(address: SocketAddr) -> MocapServer {
    MocapServer::vrpn(address).unwrap()
}

/// Both bodies come, where they are, and fresh.
fn check_flow(source: &MocapSource, tolerance: f64) {
    wait_until("both bodies", || {
        let latest = source.latest(Instant::now());
        latest.quadrotor.is_some() && latest.end_effector.is_some()
    });
    wait_until("fifty poses of each", || {
        let status = source.status(Instant::now());
        status.bodies.iter().all(|body| body.received > 50)
    });
    let latest = source.latest(Instant::now());
    let (quadrotor, tip) = (latest.quadrotor.unwrap(), latest.end_effector.unwrap());
    assert!((quadrotor.pose.position[2] - 1.5).abs() < tolerance);
    assert!((tip.pose.position[2] - 0.8).abs() < tolerance);
    let [x, y, _] = quadrotor.pose.position;
    assert!((x.hypot(y) - 1.0).abs() < tolerance);
    assert!((quadrotor.pose.attitude[3] - 0.5_f64.sqrt()).abs() < tolerance);
    // Seen not long ago, however busy the machine is.
    assert!((0.0..5.0).contains(&quadrotor.age_s), "{}", quadrotor.age_s);
    let status = source.status(Instant::now());
    assert!(status.connected, "{status:?}");
    for body in &status.bodies {
        let faults = body.faults;
        assert_eq!(
            faults.jump + faults.swapped + faults.turn + faults.not_unit,
            0,
            "{body:?}"
        );
    }
}

#[test]
fn vrpn_with_reports_by_datagram() {
    let bodies = MovingBodies::publish_on(server(ANY_PORT));
    check_flow(&source(&format!("vrpn:{}", bodies.server.address())), 1e-9);
}

#[test]
fn vrpn_over_one_tcp_connection() {
    let bodies = MovingBodies::publish_on(server(ANY_PORT));
    check_flow(&source(&format!("vrpn:tcp://{}", bodies.server.address())), 1e-9);
}

#[test]
fn natnet_unicast() {
    let names = ["drone".to_owned(), "tip".to_owned()];
    let server = MocapServer::natnet(ANY_PORT, free_udp_port(), &names).unwrap();
    let bodies = MovingBodies::publish_on(server);
    check_flow(&source(&format!("natnet:{}", bodies.server.address())), 1e-6);
}

#[test]
fn a_vrpn_server_that_comes_back_is_found_again() {
    for prefix in ["vrpn:", "vrpn:tcp://"] {
        let bodies = MovingBodies::publish_on(server(ANY_PORT));
        let address = bodies.server.address();
        let source = source(&format!("{prefix}{address}"));
        check_flow(&source, 1e-9);
        drop(bodies);
        wait_until("the loss", || !source.status(Instant::now()).connected);
        let before = source.latest(Instant::now()).quadrotor.unwrap();
        // The port may be held for a moment by what is left of the old connections.
        let mut again = None;
        wait_until("the old port", || {
            again = MocapServer::vrpn(address).ok();
            again.is_some()
        });
        let _bodies = MovingBodies::publish_on(again.unwrap());
        wait_until("new poses", || {
            source.latest(Instant::now()).quadrotor.unwrap().captured > before.captured
        });
    }
}

#[test]
fn a_client_may_be_there_before_the_server() {
    let port = free_udp_port();
    let source = source(&format!("vrpn:127.0.0.1:{port}"));
    wait_until("the first attempt", || !source.status(Instant::now()).connected);
    let _bodies = MovingBodies::publish_on(server(SocketAddr::new(ANY_PORT.ip(), port)));
    check_flow(&source, 1e-9);
}

/// The next bytes, or what the connection says instead.
fn read_some(stream: &mut TcpStream) -> Result<usize, ErrorKind> {
    let mut buffer = [0; 4096];
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    stream.read(&mut buffer).map_err(|error| error.kind())
}

#[test]
fn bad_clients_disturb_nobody() {
    let bodies = MovingBodies::publish_on(server(ANY_PORT));
    let address = bodies.server.address();
    let good = source(&format!("vrpn:tcp://{address}"));
    check_flow(&good, 1e-9);

    // Someone who asks for a log, and someone who speaks another protocol.
    let mut logging = cookie();
    logging[18] = b'2';
    for hello in [&logging[..], b"GET / HTTP/1.1\r\nHost: mocap\r\n\r\n"] {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.write_all(hello).unwrap();
        let mut heard = 0;
        // Our cookie comes, then the end: nothing is described to them.
        while let Ok(count) = read_some(&mut stream)
            && count > 0
        {
            heard += count;
        }
        assert!(heard <= COOKIE_LENGTH, "{heard}");
    }
    // Calls to nowhere, and for someone else.
    let asking = UdpSocket::bind(ANY_PORT).unwrap();
    let nowhere = format!("127.0.0.1:{}", free_udp_port()).parse().unwrap();
    asking.send_to(&format_lob(nowhere), address).unwrap();
    asking.send_to(b"192.0.2.1 5000\0", address).unwrap();
    asking.send_to(&[0xff; 200], address).unwrap();
    // One that resets the connection: it closes with unread bytes.
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(&cookie()).unwrap();
    read_some(&mut stream).unwrap();
    drop(stream);

    let received = good.status(Instant::now()).bodies[0].received;
    wait_until("poses after the trouble", || {
        good.status(Instant::now()).bodies[0].received > received + 50
    });
    wait_until("the bad ones to be forgotten", || bodies.server.clients() == 1);
}

#[test]
fn a_slow_reader_loses_reports_and_holds_up_nobody() {
    let server = VrpnServer::bind(ANY_PORT).unwrap();
    let mut slow = TcpStream::connect(server.address()).unwrap();
    slow.write_all(&cookie()).unwrap();
    wait_until("the slow client", || server.clients() == 1);
    let body = |k: usize| BodyPose {
        name: format!("body {}", k % 50),
        position: [0.0; 3],
        attitude: [1.0, 0.0, 0.0, 0.0],
        tracked: true,
    };
    let bodies: Vec<BodyPose> = (0..50).map(body).collect();
    // It never reads: what the system's buffers do not take is dropped, and at last the connection.
    wait_until("dropped reports", || {
        for _ in 0..200 {
            server.publish(1.7e9, &bodies);
        }
        server.dropped_reports() > 0 || server.clients() == 0
    });
    wait_until("the end of the slow client", || {
        server.publish(1.7e9, &bodies);
        server.clients() == 0
    });
}

#[test]
fn capture_times_that_no_protocol_carries_are_refused() {
    let server = server(ANY_PORT);
    for time_s in [f64::NAN, -1.0, 1e10] {
        assert!(server.publish(time_s, &[]).is_err());
    }
}
