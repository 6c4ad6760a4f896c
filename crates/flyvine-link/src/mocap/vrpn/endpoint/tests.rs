use std::net::Ipv4Addr;

use proptest::prelude::*;

use super::*;

const NOW_S: f64 = 1_700_000_000.0;

fn report(name: &str) -> Report {
    Report {
        name: name.to_owned(),
        sensor: 0,
        time_s: NOW_S + 0.5,
        position: [1.0, -2.0, 0.1],
        attitude: [0.5, -0.5, 0.5, 0.5],
    }
}

/// A client and a server that have introduced themselves to each other.
fn pair(devices: &[&str]) -> (Endpoint, Endpoint, Vec<Event>) {
    let devices: Vec<String> = devices.iter().map(|&name| name.to_owned()).collect();
    let address = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 40110);
    let mut client = Endpoint::new(&[], Some(address));
    let mut server = Endpoint::new(&devices, None);
    let heard_by_server = exchange(&mut client, &mut server);
    let mut heard = exchange(&mut server, &mut client);
    heard.extend(heard_by_server);
    exchange(&mut client, &mut server);
    (client, server, heard)
}

/// Carries over what `from` has to say.
fn exchange(from: &mut Endpoint, to: &mut Endpoint) -> Vec<Event> {
    to.receive(&from.take_output(), NOW_S).unwrap()
}

#[test]
fn both_sides_introduce_themselves() {
    let (client, mut server, heard) = pair(&["drone", "tip"]);
    assert!(client.is_connected() && server.is_connected());
    assert_eq!(
        heard,
        [
            Event::Connected("07.38".into()),
            Event::Device("drone".into()),
            Event::Device("tip".into()),
            Event::Connected("07.38".into()),
        ]
    );
    let mut client = Endpoint::new(&[], Some(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 40110)));
    client.receive(&cookie(), NOW_S).unwrap();
    let output = client.take_output();
    let events = server.receive(&output[COOKIE_LENGTH..], NOW_S).unwrap();
    assert_eq!(events, [Event::ReportsTo("127.0.0.1:40110".parse().unwrap())]);
    assert_eq!(output[COOKIE_LENGTH + 24..][..10], *b"127.0.0.1\0");
}

#[test]
fn reports_arrive_bit_for_bit_by_datagram_and_by_stream() {
    let (mut client, mut server, _) = pair(&["drone"]);
    let mut bytes = Vec::new();
    server.write_report(&report("drone"), &mut bytes);
    assert_eq!(bytes.len(), 88);
    assert_eq!(bytes[..4], [0, 0, 0, 88]);
    assert_eq!(
        bytes[32..40],
        1.0_f64.to_be_bytes(),
        "x comes after sensor and filler"
    );
    assert_eq!(bytes[80..88], 0.5_f64.to_be_bytes(), "the scalar part comes last");
    let expected = [Event::Report(report("drone"))];
    assert_eq!(client.receive_datagram(&bytes).unwrap(), expected);
    assert_eq!(client.receive(&bytes, NOW_S).unwrap(), expected);
}

#[test]
fn a_new_device_is_described_before_it_reports() {
    let (mut client, mut server, _) = pair(&["drone"]);
    let mut bytes = Vec::new();
    server.write_report(&report("tip"), &mut bytes);
    assert_eq!(
        client.receive_datagram(&bytes).unwrap(),
        [],
        "overtook its description"
    );
    assert_eq!(exchange(&mut server, &mut client), [Event::Device("tip".into())]);
    assert_eq!(
        client.receive_datagram(&bytes).unwrap(),
        [Event::Report(report("tip"))]
    );
}

#[test]
fn pings_are_answered_by_name() {
    let (mut client, mut server, _) = pair(&["drone", "tip"]);
    // On the client's side, "tip" has another number than on the server's.
    client.ping("tip", NOW_S);
    let events = exchange(&mut client, &mut server);
    assert_eq!(events, [Event::Device("tip".into()), Event::Ping("tip".into())]);
    assert_eq!(exchange(&mut server, &mut client), [Event::Pong("tip".into())]);
    client.ping("nobody", NOW_S);
    exchange(&mut client, &mut server);
    assert_eq!(exchange(&mut server, &mut client), []);
}

#[test]
fn what_is_not_vrpn_is_refused() {
    let refused = |bytes: &[u8]| Endpoint::new(&[], None).receive(bytes, NOW_S).unwrap_err();
    assert!(matches!(
        refused(b"SSH-2.0-OpenSSH_9.2p1 Debian-2"),
        VrpnError::Cookie { .. }
    ));
    let mut long_name = cookie().to_vec();
    let message = |sender, payload| Message {
        time_s: 0.0,
        sender,
        kind: SENDER_DESCRIPTION,
        sequence: 0,
        payload,
    };
    message(1, [&200_u32.to_be_bytes()[..], &[b'x'; 200]].concat()).write(&mut long_name);
    assert!(matches!(refused(&long_name), VrpnError::Length { .. }));
    let mut many = cookie().to_vec();
    message(2000, name_payload("x")).write(&mut many);
    assert!(matches!(refused(&many), VrpnError::Identifier { .. }));
}

/// Everything that a server says in a short session.
fn session() -> Vec<u8> {
    let mut server = Endpoint::new(&["drone".to_owned(), "tip".to_owned()], None);
    server.receive(&cookie(), NOW_S).unwrap();
    let mut bytes = server.take_output();
    for k in 0..5 {
        let name = ["drone", "tip", "wand"][k % 3];
        let mut reports = Vec::new();
        server.write_report(&report(name), &mut reports);
        bytes.extend(server.take_output());
        bytes.extend(reports);
    }
    bytes
}

proptest! {
    #[test]
    fn a_stream_cut_anywhere_says_the_same(cuts in prop::collection::vec(any::<prop::sample::Index>(), 0..12)) {
        let bytes = session();
        let whole = Endpoint::new(&[], None).receive(&bytes, NOW_S).unwrap();
        let mut cuts: Vec<usize> = cuts.iter().map(|cut| cut.index(bytes.len())).collect();
        cuts.extend([0, bytes.len()]);
        cuts.sort_unstable();
        let mut client = Endpoint::new(&[], None);
        let mut pieces = Vec::new();
        for cut in cuts.windows(2) {
            pieces.extend(client.receive(&bytes[cut[0]..cut[1]], NOW_S).unwrap());
        }
        prop_assert_eq!(pieces, whole);
    }

    #[test]
    fn damaged_streams_never_panic(
        position in any::<prop::sample::Index>(),
        damage in prop::collection::vec(any::<u8>(), 0..40),
        removed in 0..40_usize,
    ) {
        let mut bytes = session();
        let start = position.index(bytes.len());
        let end = (start + removed).min(bytes.len());
        bytes.splice(start..end, damage);
        let mut client = Endpoint::new(&[], None);
        let _ = client.receive(&bytes, NOW_S);
        let _ = client.receive_datagram(&bytes[24..]);
    }
}

#[test]
fn every_single_cut_says_the_same() {
    let bytes = session();
    let whole = Endpoint::new(&[], None).receive(&bytes, NOW_S).unwrap();
    for cut in 0..bytes.len() {
        let mut client = Endpoint::new(&[], None);
        let mut events = client.receive(&bytes[..cut], NOW_S).unwrap();
        events.extend(client.receive(&bytes[cut..], NOW_S).unwrap());
        assert_eq!(events, whole, "cut at {cut}");
    }
}
