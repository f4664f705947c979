//! A server for each test, on a free port, and clients that send exactly the given bytes.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use polepair::Connector;
use polepair_serve::message::telemetry::{HEADER_LEN, SAMPLE_LEN};
use polepair_serve::{GatewayServer, ServerOptions};
use polepair_test_support::{WAIT_MAX, wait_for};
use serde_json::Value;
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

/// A server with simulated drives.
pub struct Site {
    pub server: Option<GatewayServer>,
    pub folder: PathBuf,
    pub address: SocketAddr,
}

/// An answer.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub body: String,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|e| panic!("{e}: {self:?}"))
    }

    pub fn code(&self) -> String {
        self.json()["error"]["code"].as_str().unwrap_or_default().to_owned()
    }
}

pub fn folder() -> PathBuf {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let n = NEXT.fetch_add(1, Ordering::Relaxed);
    let folder = std::env::temp_dir().join(format!("polepair-serve-{}-{n}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

pub fn options(folder: PathBuf) -> ServerOptions {
    let bind = "127.0.0.1:0".parse().unwrap();
    ServerOptions { bind, ..ServerOptions::in_folder(folder) }
}

impl Site {
    pub fn new() -> Self {
        Self::with(options(folder()))
    }

    pub fn with(options: ServerOptions) -> Self {
        Self::of(options, &["sim:tmcl?axes=2"])
    }

    /// A server of these links.
    pub fn of(options: ServerOptions, urls: &[&str]) -> Self {
        let urls: Vec<String> = urls.iter().map(|url| (*url).to_owned()).collect();
        let server = GatewayServer::start(&options, &urls, Connector::default()).unwrap();
        let address = SocketAddr::from(([127, 0, 0, 1], server.address().port()));
        Self { server: Some(server), folder: options.folder, address }
    }

    /// The token of that name in the server's file.
    pub fn token(&self, name: &str) -> String {
        let text = std::fs::read_to_string(self.folder.join("tokens")).unwrap();
        let line = text.lines().find(|line| line.ends_with(&format!(" {name}"))).unwrap();
        line.split(' ').next().unwrap().to_owned()
    }

    pub fn bearer(&self, name: &str) -> String {
        format!("Authorization: Bearer {}\r\n", self.token(name))
    }

    /// Sends a request line as it is, with `Host` after it; the connection is closed at the end.
    pub fn send(&self, line: &str, heads: &str, body: &str) -> Answer {
        let host = format!("Host: {}\r\n", self.address);
        self.say(&format!(
            "{line} HTTP/1.1\r\n{host}{heads}Connection: close\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        ))
    }

    pub fn get(&self, path: &str, heads: &str) -> Answer {
        self.send(&format!("GET {path}"), heads, "")
    }

    /// A request that changes something, as a program sends it.
    pub fn post(&self, line: &str, who: &str, body: &str) -> Answer {
        let heads =
            format!("{}Content-Type: application/json\r\nX-Polepair: 1\r\n", self.bearer(who));
        self.send(line, &heads, body)
    }

    pub fn say(&self, text: &str) -> Answer {
        let mut stream = self.connect();
        // The server may refuse it before it is sent completely.
        let _ = stream.write_all(text.as_bytes());
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Answer { status, head: head.to_ascii_lowercase(), body: unchunked(head, body) }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
        stream
    }

    /// Opens the WebSocket; the status where that is refused.
    pub fn live(&self, heads: &[(&'static str, String)]) -> Result<WebSocket<TcpStream>, u16> {
        let url = format!("ws://{}/api/v1/live", self.address);
        let mut request = url.into_client_request().unwrap();
        let mut all = vec![("Sec-WebSocket-Protocol", "polepair.v1".to_owned())];
        all.extend(heads.iter().cloned());
        for (name, value) in all {
            request.headers_mut().insert(name, value.parse().unwrap());
        }
        match tungstenite::client(request, self.connect()) {
            Ok((socket, _)) => Ok(socket),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(other) => panic!("{other}"),
        }
    }

    /// A WebSocket with this client's token.
    pub fn live_as(&self, name: &str) -> WebSocket<TcpStream> {
        self.live(&[("Authorization", format!("Bearer {}", self.token(name)))]).unwrap()
    }

    /// A browser's cookie, got by the URL that is good once.
    pub fn cookie(&self) -> String {
        let url = self.server.as_ref().unwrap().url();
        let path = &url[url.rfind('/').unwrap()..];
        let answer = self.get(path, "");
        assert_eq!(answer.status, 303, "{answer:?}");
        let cookie = answer.head.split("set-cookie: ").nth(1).unwrap();
        cookie.split(';').next().unwrap().to_owned()
    }

    pub fn journal(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.folder.join("journal.jsonl")).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    /// State of the bench without ages and without the values that the simulation changes by itself.
    pub fn state(&self) -> Value {
        let bench = self.server.as_ref().unwrap().bench();
        let snapshot = serde_json::to_value(bench.snapshot()).unwrap();
        let axes = (0..2).map(|id| {
            // Whether it is powered counts as unknown while its last reading is old.
            let axis = wait_for("a fresh reading", || {
                let axis = bench.axis_state(id).unwrap();
                if axis.enabled.is_some() { Ok(axis) } else { Err(format!("{axis:?}")) }
            });
            serde_json::json!([axis.armed, axis.enabled, axis.lease, axis.faults])
        });
        serde_json::json!([snapshot["axes"], snapshot["lock"], axes.collect::<Vec<_>>()])
    }

    pub fn end(mut self) {
        drop(self.server.take());
        std::fs::remove_dir_all(&self.folder).unwrap();
    }
}

fn unchunked(head: &str, body: &str) -> String {
    if !head.to_ascii_lowercase().contains("transfer-encoding: chunked") {
        return body.to_owned();
    }
    let mut whole = String::new();
    let mut rest = body;
    while let Some((length, after)) = rest.split_once("\r\n") {
        let Ok(length) = usize::from_str_radix(length, 16) else { break };
        if length == 0 || after.len() < length {
            break;
        }
        whole.push_str(&after[..length]);
        rest = after[length..].trim_start_matches("\r\n");
    }
    whole
}

/// The next text of that type.
pub fn next(socket: &mut WebSocket<TcpStream>, kind: &str) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            let value: Value = serde_json::from_str(&text).unwrap();
            if value["type"] == kind {
                return value;
            }
        }
    }
}

pub fn send_message(socket: &mut WebSocket<TcpStream>, message: &Value) {
    socket.send(Message::text(message.to_string())).unwrap();
}

/// A binary message: its channel, and µs since the server's start with values.
pub fn samples(bytes: &[u8]) -> (u16, Vec<(u64, f64)>) {
    assert_eq!(bytes[..2], [1, 1]);
    let channel = u16::from_le_bytes(bytes[2..4].try_into().unwrap());
    let count = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
    let t0 = u64::from_le_bytes(bytes[8..16].try_into().unwrap());
    let rows = bytes[HEADER_LEN..].chunks_exact(SAMPLE_LEN).map(|row| {
        let after = u32::from_le_bytes(row[..4].try_into().unwrap());
        (t0 + u64::from(after), f64::from_le_bytes(row[4..].try_into().unwrap()))
    });
    let rows: Vec<_> = rows.collect();
    assert_eq!(rows.len(), count as usize);
    (channel, rows)
}

/// Returns whether the test has the process to itself, for measurements of a process. If not, the test is
/// run again in a process of its own, whose result counts.
pub fn is_alone(test: &str) -> bool {
    const MARK: &str = "POLEPAIR_ALONE";
    if std::env::var_os(MARK).is_some() {
        return true;
    }
    let mut again = Command::new(std::env::current_exe().unwrap());
    let ended = again.args(["--exact", test, "--nocapture"]).env(MARK, "1").output().unwrap();
    let out = String::from_utf8_lossy(&ended.stdout);
    println!("{out}{}", String::from_utf8_lossy(&ended.stderr));
    assert!(ended.status.success() && out.contains(" 1 passed"), "{test}, alone");
    false
}

/// Bytes of this process that lie in memory.
pub fn memory() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let resident = pages.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok());
    resident.unwrap_or(0) * 4096
}

/// The present time in the form of commands, ms.
pub fn now_ms() -> f64 {
    polepair_link::clock::wall_ns(polepair_link::clock::now()) as f64 / 1e6
}
