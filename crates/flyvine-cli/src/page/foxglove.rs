//! A flight under way for Foxglove: the public WebSocket protocol `foxglove.websocket.v1`
//! (<https://github.com/foxglove/ws-protocol>), as much of it as a source of messages needs: serverInfo, advertise,
//! subscribe, unsubscribe, message data. The messages are those of flyvine's MCAP files.
//!
//! Read-only. It has no token, since Foxglove asks for none, so it answers only programs on this machine and pages of
//! Foxglove's own.

use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use data_encoding::BASE64;
use flyvine::flight::messages::{ENCODING, TOPICS, row_messages, schemas};
use serde::Deserialize;
use serde_json::json;
use tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tungstenite::http::{HeaderValue, StatusCode};
use tungstenite::{Message, WebSocket, accept_hdr};

use super::broadcast::{Broadcast, LiveRow};
use super::server::is_timeout;
use crate::outcome::{Blame, Failure};

/// The protocol's name in the handshake.
const SUBPROTOCOL: &str = "foxglove.websocket.v1";
/// How long a connection waits for rows before it listens for subscriptions again.
const WAIT: Duration = Duration::from_millis(50);
/// Binary message: data of a subscription.
const MESSAGE_DATA: u8 = 1;

/// Serves the rows of a flight on a port until the process ends; returns the address.
pub fn serve(port: u16, broadcast: Arc<Broadcast>) -> Result<String, Failure> {
    let listener = TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).or_input()?;
    let address = listener.local_addr().or_internal()?;
    let session = Arc::new(Session {
        started_ns: nanoseconds(SystemTime::now()),
    });
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (broadcast, session) = (Arc::clone(&broadcast), Arc::clone(&session));
            std::thread::spawn(move || {
                if let Some(socket) = handshake(stream) {
                    // The peer went away: nothing to do about it.
                    let _ = session.feed(socket, &broadcast);
                }
            });
        }
    });
    Ok(format!("ws://{address}"))
}

fn handshake(stream: TcpStream) -> Option<WebSocket<TcpStream>> {
    stream.set_nodelay(true).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
    let socket = accept_hdr(stream, choose_protocol).ok()?;
    socket
        .get_ref()
        .set_read_timeout(Some(Duration::from_millis(1)))
        .ok()?;
    Some(socket)
}

#[allow(clippy::result_large_err)] // tungstenite's signature
fn choose_protocol(request: &Request, mut response: Response) -> Result<Response, ErrorResponse> {
    let field = |name| request.headers().get(name).and_then(|value| value.to_str().ok());
    let refuse = |status| {
        let mut refusal = ErrorResponse::new(None);
        *refusal.status_mut() = status;
        Err(refusal)
    };
    if !field("origin").is_none_or(is_trusted) {
        return refuse(StatusCode::FORBIDDEN);
    }
    let offered = field("sec-websocket-protocol").unwrap_or_default();
    if !offered.split(',').any(|protocol| protocol.trim() == SUBPROTOCOL) {
        return refuse(StatusCode::BAD_REQUEST);
    }
    let name = HeaderValue::from_static(SUBPROTOCOL);
    response.headers_mut().insert("sec-websocket-protocol", name);
    Ok(response)
}

/// Pages that may read: Foxglove's own, its desktop program, and what this machine itself serves.
fn is_trusted(origin: &str) -> bool {
    let host = origin.split_once("://").map_or("", |(_, host)| host);
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    origin == "https://app.foxglove.dev"
        || origin.starts_with("file://")
        || matches!(name, "localhost" | "127.0.0.1")
}

/// What a client sends.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Operation {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

struct Session {
    /// Time of the flight's first row, ns since 1970.
    started_ns: u64,
}

impl Session {
    fn feed(&self, mut socket: WebSocket<TcpStream>, broadcast: &Broadcast) -> tungstenite::Result<()> {
        let hello = json!({
            "op": "serverInfo", "name": "flyvine", "capabilities": [], "supportedEncodings": [], "metadata": {},
            "sessionId": self.started_ns.to_string(),
        });
        let schema = BASE64.encode(&schemas());
        let channels: Vec<_> = TOPICS
            .iter()
            .enumerate()
            .map(|(id, topic)| {
                json!({
                    "id": id, "topic": topic.name, "encoding": ENCODING,
                    "schemaName": topic.schema_name, "schema": schema, "schemaEncoding": ENCODING,
                })
            })
            .collect();
        socket.send(Message::text(hello.to_string()))?;
        socket.send(Message::text(
            json!({ "op": "advertise", "channels": channels }).to_string(),
        ))?;
        let mut subscriptions = HashMap::new();
        let mut seen = 0;
        loop {
            let (rows, end) = broadcast.wait(seen, WAIT);
            seen += rows.len();
            for row in &rows {
                self.send(&mut socket, row, &subscriptions)?;
            }
            if end.is_some() {
                socket.close(None)?;
                return socket.flush();
            }
            self.listen(&mut socket, &mut subscriptions)?;
        }
    }

    /// Takes in what the client said until it says nothing more.
    fn listen(
        &self,
        socket: &mut WebSocket<TcpStream>,
        subscriptions: &mut HashMap<usize, Vec<u32>>,
    ) -> tungstenite::Result<()> {
        loop {
            let text = match socket.read() {
                Ok(Message::Text(text)) => text,
                Ok(_) => continue,
                Err(tungstenite::Error::Io(error)) if is_timeout(&error) => return Ok(()),
                Err(error) => return Err(error),
            };
            match serde_json::from_str(&text) {
                Ok(Operation::Subscribe { subscriptions: added }) => {
                    for Subscription { id, channel_id } in added {
                        subscriptions.entry(channel_id).or_default().push(id);
                    }
                }
                Ok(Operation::Unsubscribe { subscription_ids }) => {
                    for ids in subscriptions.values_mut() {
                        ids.retain(|id| !subscription_ids.contains(id));
                    }
                }
                // What it does not serve it ignores, as the protocol wants.
                Ok(Operation::Other) | Err(_) => {}
            }
        }
    }

    fn send(
        &self,
        socket: &mut WebSocket<TcpStream>,
        row: &LiveRow,
        subscriptions: &HashMap<usize, Vec<u32>>,
    ) -> tungstenite::Result<()> {
        let time_ns = self.started_ns + (row.sample.t_s * 1e9).round().max(0.0) as u64;
        for message in row_messages(&row.sample, row.step.as_ref(), time_ns) {
            for id in subscriptions.get(&message.topic).into_iter().flatten() {
                let mut frame = vec![MESSAGE_DATA];
                frame.extend(id.to_le_bytes());
                frame.extend(time_ns.to_le_bytes());
                frame.extend(&message.bytes);
                socket.write(Message::binary(frame))?;
            }
        }
        socket.flush()
    }
}

fn nanoseconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH)
        .map_or(0, |elapsed| elapsed.as_nanos() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_foxglove_and_this_machine_may_read() {
        for origin in [
            "https://app.foxglove.dev",
            "file://",
            "http://localhost:8080",
            "http://127.0.0.1",
        ] {
            assert!(is_trusted(origin), "{origin}");
        }
        for origin in [
            "https://example.org",
            "https://app.foxglove.dev.example.org",
            "http://localhost.example.org",
        ] {
            assert!(!is_trusted(origin), "{origin}");
        }
    }

    #[test]
    fn a_client_subscribes() {
        let text = r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":3}]}"#;
        match serde_json::from_str(text).unwrap() {
            Operation::Subscribe { subscriptions } => {
                assert_eq!((subscriptions[0].id, subscriptions[0].channel_id), (7, 3));
            }
            _ => panic!("expected a subscription"),
        }
        let text = r#"{"op":"unsubscribe","subscriptionIds":[7]}"#;
        assert!(matches!(
            serde_json::from_str(text).unwrap(),
            Operation::Unsubscribe { subscription_ids } if subscription_ids == [7]
        ));
        assert!(matches!(
            serde_json::from_str(r#"{"op":"getParameters","id":"x"}"#).unwrap(),
            Operation::Other
        ));
    }
}
