//! The datagram by which a client asks a server to call it back: `"<IPv4> <port>\0"`.

use std::net::{Ipv4Addr, SocketAddrV4};

/// Lowest port that a server calls.
const FIRST_USER_PORT: u16 = 1024;

/// The datagram that asks to be called at `address`.
pub fn format_lob(address: SocketAddrV4) -> Vec<u8> {
    format!("{} {}\0", address.ip(), address.port()).into_bytes()
}

/// Where the sender of a datagram wants to be called; `None` if it does not say so, or names a privileged port.
pub fn parse_lob(datagram: &[u8]) -> Option<SocketAddrV4> {
    let text = datagram.split(|&byte| byte == 0).next()?;
    let mut fields = std::str::from_utf8(text).ok()?.split_ascii_whitespace();
    let host: Ipv4Addr = fields.next()?.parse().ok()?;
    let port: u16 = fields.next()?.parse().ok()?;
    (fields.next().is_none() && port >= FIRST_USER_PORT).then(|| SocketAddrV4::new(host, port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lobs_are_read_as_they_are_written() {
        let address = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 46317);
        assert_eq!(format_lob(address), b"127.0.0.1 46317\0");
        assert_eq!(parse_lob(b"127.0.0.1 46317\0"), Some(address));
        assert_eq!(parse_lob(b"127.0.0.1 46317"), Some(address));
        for wrong in [
            &b""[..],
            b"\0",
            b"127.0.0.1\0",
            b"127.0.0.1 80\0",
            b"127.0.0.1 99999\0",
            b"127.0.0.1 46317 1\0",
            b"evil-host 46317\0",
            b"::1 46317\0",
            b"\xff\xfe 46317\0",
        ] {
            assert_eq!(parse_lob(wrong), None, "{wrong:?}");
        }
    }
}
