//! The page's server: bundled files, the flights' data, the live feed, the abort request.
//!
//! It listens on loopback, and every address begins with a token that only the printed URL carries: another user or
//! another page in the same browser that guesses the port gets nothing. A foreign `Host` (DNS rebinding) or `Origin` is
//! refused.

use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use tungstenite::handshake::server::{create_response, write_response};
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};

use super::assets::ASSETS;
use super::broadcast::{Broadcast, rows_json};
use super::http::{Request, respond};
use crate::console::say;
use crate::outcome::{Blame, Failure};

/// How often a connection looks whether its page still listens.
const WAIT: Duration = Duration::from_millis(100);
const TEXT: &str = "text/plain; charset=utf-8";

/// A running page; it ends with the process.
pub struct PageServer {
    url: String,
}

/// What the connections share.
struct Shared {
    /// `/TOKEN/`
    prefix: String,
    /// What `Host` may say.
    hosts: [String; 2],
    /// data.json
    content: Vec<u8>,
    live: Option<Arc<Broadcast>>,
}

impl PageServer {
    /// Serves the page with this data.json on a port (0: any that is free), with a live feed if there is one.
    pub fn start(content: Vec<u8>, port: u16, live: Option<Arc<Broadcast>>) -> Result<Self, Failure> {
        let listener = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).or_input()?;
        let port = listener.local_addr().or_internal()?.port();
        let prefix = format!("/{}/", token()?);
        let url = format!("http://127.0.0.1:{port}{prefix}");
        let shared = Arc::new(Shared {
            prefix,
            hosts: [format!("127.0.0.1:{port}"), format!("localhost:{port}")],
            content,
            live,
        });
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let shared = Arc::clone(&shared);
                std::thread::spawn(move || answer(stream, &shared));
            }
        });
        Ok(Self { url })
    }

    /// The page's address, token included.
    pub fn url(&self) -> &str {
        &self.url
    }
}

/// Opens the user's browser; where there is none, says so.
pub fn open_browser(url: &str) {
    if let Err(error) = open::that_detached(url) {
        say(&format!(
            "no browser could be opened ({error}); open {url} in one"
        ));
    }
}

/// 128 random bits as hexadecimal digits.
fn token() -> Result<String, Failure> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes)
        .map_err(anyhow::Error::msg)
        .or_internal()?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// One connection. A peer that went away is nobody's error.
fn answer(mut stream: TcpStream, shared: &Shared) {
    let _ = stream.set_nodelay(true);
    let Some(request) = Request::read(&mut stream) else {
        return;
    };
    let host = request.field("host").unwrap_or_default();
    let is_ours = |host: &str| shared.hosts.iter().any(|ours| ours == host);
    let origin = request
        .field("origin")
        .map(|origin| origin.strip_prefix("http://"));
    let path = request.path.split('?').next().unwrap_or_default();
    let _ = match path.strip_prefix(&shared.prefix) {
        Some(path) if is_ours(host) && origin.is_none_or(|origin| origin.is_some_and(is_ours)) => {
            route(&mut stream, &request, path, shared)
        }
        _ => respond(
            &mut stream,
            "403 Forbidden",
            TEXT,
            b"Open the address as it was printed, token included.\n",
        ),
    };
}

fn route(stream: &mut TcpStream, request: &Request, path: &str, shared: &Shared) -> std::io::Result<()> {
    match (request.method.as_str(), path, &shared.live) {
        ("GET", "live", Some(live)) if request.is_websocket() => {
            if let Some(socket) = stream
                .try_clone()
                .ok()
                .and_then(|stream| upgrade(stream, request))
            {
                feed(socket, live);
            }
            Ok(())
        }
        ("POST", "abort", Some(live)) => {
            live.request_abort();
            respond(stream, "204 No Content", TEXT, b"")
        }
        ("GET", "data.json", _) => respond(stream, "200 OK", "application/json", &shared.content),
        ("GET", path, _) => match ASSETS.iter().find(|asset| asset.path == path) {
            Some(asset) => respond(stream, "200 OK", asset.content_type, asset.bytes),
            None => respond(stream, "404 Not Found", TEXT, b"There is no such file.\n"),
        },
        _ => respond(stream, "405 Method Not Allowed", TEXT, b"Only GET.\n"),
    }
}

/// Turns a connection into a WebSocket; `None` if the request is not one that can be.
fn upgrade(mut stream: TcpStream, request: &Request) -> Option<WebSocket<TcpStream>> {
    let mut builder = tungstenite::http::Request::builder().uri(&request.path);
    for (name, value) in &request.fields {
        builder = builder.header(name, value.as_slice());
    }
    let response = create_response(&builder.body(()).ok()?).ok()?;
    write_response(&mut stream, &response).ok()?;
    stream.set_read_timeout(Some(Duration::from_millis(1))).ok()?;
    Some(WebSocket::from_raw_socket(stream, Role::Server, None))
}

/// Sends rows as they come, from the first one, until the flight or the page ends. A page that is slow gets what it
/// missed in one message; it holds up nobody.
fn feed(mut socket: WebSocket<TcpStream>, live: &Broadcast) {
    let _viewer = live.viewer();
    let mut sent = 0;
    loop {
        let (rows, end) = live.wait(sent, WAIT);
        if !rows.is_empty() || end.is_some() {
            sent += rows.len();
            if socket
                .send(Message::text(rows_json(&rows, end.as_ref())))
                .is_err()
            {
                return;
            }
        }
        if end.is_some() {
            let _ = socket.close(None);
            let _ = socket.flush();
            return;
        }
        // Answers pings and notices that the page was closed.
        match socket.read() {
            Err(tungstenite::Error::Io(error)) if is_timeout(&error) => {}
            Err(_) => return,
            Ok(_) => {}
        }
    }
}

/// Whether a read only found nothing yet.
pub fn is_timeout(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut
    )
}
