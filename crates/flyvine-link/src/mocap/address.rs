//! Where a server is: host and port, IPv4 only.

use std::net::{SocketAddr, SocketAddrV4, ToSocketAddrs};

use super::MocapError;

/// Reads `host` or `host:port` off `rest`, the end of the user's `address`; `expected` says what would be accepted.
pub(super) fn host_and_port(
    address: &str,
    rest: &str,
    default_port: u16,
    expected: &str,
) -> Result<(String, u16), MocapError> {
    let error = |problem: &str| MocapError::Address {
        address: address.to_owned(),
        problem: problem.to_owned(),
    };
    let (host, port) = match rest.rsplit_once(':') {
        Some((host, port)) => (
            host,
            port.parse()
                .map_err(|_| error("expected a port 0 … 65535 after the colon"))?,
        ),
        None => (rest, default_port),
    };
    if host.is_empty() || host.contains(['/', ':', '@', ' ']) {
        return Err(error(expected));
    }
    Ok((host.to_owned(), port))
}

/// The host's first IPv4 address.
pub(super) fn resolve(host: &str, port: u16) -> Result<SocketAddrV4, MocapError> {
    let error = |problem: String| MocapError::Address {
        address: format!("{host}:{port}"),
        problem,
    };
    let addresses = (host, port)
        .to_socket_addrs()
        .map_err(|problem| error(problem.to_string()))?;
    addresses
        .filter_map(|address| match address {
            SocketAddr::V4(address) => Some(address),
            SocketAddr::V6(_) => None,
        })
        .next()
        .ok_or_else(|| error("has no IPv4 address, which the protocol needs".into()))
}
