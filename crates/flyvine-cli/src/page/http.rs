//! As much of HTTP/1.1 as one page on loopback needs: a request's head, a response with a length, one exchange per
//! connection.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// Longest request head, bytes.
const HEAD_MAX: usize = 16 * 1024;
/// Most header fields of a request.
const FIELDS_MAX: usize = 64;
/// Time for a request's head to arrive.
const READ_TIMEOUT: Duration = Duration::from_secs(5);

/// A request's head.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// For example `GET`.
    pub method: String,
    /// Path and query as they were sent.
    pub path: String,
    /// Field names and values, in order.
    pub fields: Vec<(String, Vec<u8>)>,
}

impl Request {
    /// Reads a head. `None`: there came none, or none that could be read.
    pub fn read(stream: &mut TcpStream) -> Option<Self> {
        stream.set_read_timeout(Some(READ_TIMEOUT)).ok()?;
        let mut head = Vec::with_capacity(1024);
        let mut byte = [0; 1];
        // Byte by byte: what follows the head belongs to somebody else. It is short, and on loopback.
        while !head.ends_with(b"\r\n\r\n") {
            if head.len() == HEAD_MAX || stream.read(&mut byte).ok()? == 0 {
                return None;
            }
            head.push(byte[0]);
        }
        Self::parse(&head)
    }

    fn parse(head: &[u8]) -> Option<Self> {
        let mut fields = [httparse::EMPTY_HEADER; FIELDS_MAX];
        let mut request = httparse::Request::new(&mut fields);
        request.parse(head).ok()?.is_complete().then_some(())?;
        Some(Self {
            method: request.method?.to_owned(),
            path: request.path?.to_owned(),
            fields: request
                .headers
                .iter()
                .map(|field| (field.name.to_owned(), field.value.to_owned()))
                .collect(),
        })
    }

    /// A field's value as text.
    pub fn field(&self, name: &str) -> Option<&str> {
        let (_, value) = self
            .fields
            .iter()
            .find(|(found, _)| found.eq_ignore_ascii_case(name))?;
        std::str::from_utf8(value).ok()
    }

    /// Whether it wants to go on as a WebSocket.
    pub fn is_websocket(&self) -> bool {
        self.field("upgrade")
            .is_some_and(|value| value.eq_ignore_ascii_case("websocket"))
    }
}

/// Writes a response, after which the connection ends.
pub fn respond(stream: &mut TcpStream, status: &str, content_type: &str, body: &[u8]) -> io::Result<()> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\nContent-Length: {}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Content-Security-Policy: default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; \
         connect-src 'self' ws:; frame-ancestors 'none'; base-uri 'none'; form-action 'self'\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)?;
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_is_read_and_nonsense_is_not() {
        let head = b"GET /secret/live?x=1 HTTP/1.1\r\nHost: 127.0.0.1:9\r\nUpgrade: WebSocket\r\n\r\n";
        let request = Request::parse(head).unwrap();
        assert_eq!(
            (request.method.as_str(), request.path.as_str()),
            ("GET", "/secret/live?x=1")
        );
        assert_eq!(request.field("HOST"), Some("127.0.0.1:9"));
        assert!(request.is_websocket());
        assert_eq!(Request::parse(b"\x00\x01\r\n\r\n"), None);
        assert_eq!(Request::parse(b"GET / HTTP/1.1\r\nHost: x\r\n"), None);
    }
}
