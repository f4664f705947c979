//! A `polepair serve` of its own for a test, as a process, and clients of its WebSocket.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use polepair_test_support::{Deadline, WAIT_MAX};
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

use crate::run;

/// A folder that is removed at the end, and that servers after one another may use.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let n = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("polepair-gateway-{}-{n}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    pub fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    pub fn journal(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.0.join("state/journal.jsonl")).unwrap();
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The server's process.
pub struct Site {
    child: Child,
    pub address: SocketAddr,
    token: String,
    folder: String,
    /// Text that the server printed on stderr so far.
    said: Arc<Mutex<String>>,
    reads: Option<std::thread::JoinHandle<()>>,
}

impl Site {
    /// Serves these links, with its files in `state` of the folder.
    pub fn new(folder: &Folder, urls: &[&str]) -> Self {
        let state = folder.path("state");
        let own = ["serve", "--bind", "127.0.0.1:0", "--state", &state];
        Self::of(folder, run::command(&[&own[..], urls].concat()))
    }

    /// A server in a process with a limit of the shell's `ulimit`: `-n 64`.
    pub fn limited(folder: &Folder, urls: &[&str], limit: &str) -> Self {
        let state = folder.path("state");
        let own = ["serve", "--bind", "127.0.0.1:0", "--state", &state];
        let serve = run::command(&[&own[..], urls].concat());
        let mut command = Command::new("sh");
        command.args(["-c", &format!("ulimit {limit}; exec \"$0\" \"$@\"")]);
        command.arg(serve.get_program()).args(serve.get_args());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        Self::of(folder, command)
    }

    fn of(folder: &Folder, mut command: Command) -> Self {
        let state = folder.path("state");
        command.env("HOME", &folder.0).env("XDG_CONFIG_HOME", &folder.0);
        let mut child = command.stdin(Stdio::null()).spawn().expect("polepair serve");
        let errors = BufReader::new(child.stderr.take().expect("a pipe"));
        let text = Arc::new(Mutex::new(String::new()));
        let says = Arc::clone(&text);
        let reads = std::thread::spawn(move || {
            for line in errors.lines().map_while(Result::ok) {
                let mut text = says.lock().unwrap();
                text.push_str(&line);
                text.push('\n');
            }
        });
        let mut line = String::new();
        let out = child.stdout.take().expect("a pipe");
        BufReader::new(out).read_line(&mut line).expect("a line");
        let url = line.strip_prefix("ready http://").unwrap_or_else(|| panic!("{line:?}"));
        let address = url.split('/').next().unwrap().parse().unwrap();
        let token = operator(Path::new(&state));
        Self { child, address, token, folder: state, said: text, reads: Some(reads) }
    }

    /// All text that the server printed on stderr, once it has ended.
    pub fn output(&mut self) -> String {
        self.reads.take().into_iter().for_each(|reads| reads.join().unwrap());
        self.said.lock().unwrap().clone()
    }

    /// Runs the command line against this server.
    pub fn run(&self, arguments: &[&str]) -> run::Ran {
        let (url, tokens) = (format!("http://{}", self.address), format!("{}/tokens", self.folder));
        let own = ["--server", &url, "--token-file", &tokens];
        run::polepair(&[&own[..], arguments].concat())
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends the signal, and waits until the server has ended.
    pub fn signal(&mut self, name: &str) -> Option<i32> {
        run::signal(name, self.child.id());
        self.child.wait().unwrap().code()
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(WAIT_MAX)).unwrap();
        stream.set_nodelay(true).unwrap();
        stream
    }

    /// A viewer, let in as the operator.
    pub fn live(&self) -> Live {
        let url = format!("ws://{}/api/v1/live", self.address);
        let mut request = url.into_client_request().unwrap();
        let bearer = format!("Bearer {}", self.token);
        for (name, value) in
            [("Sec-WebSocket-Protocol", "polepair.v1"), ("Authorization", bearer.as_str())]
        {
            request.headers_mut().insert(name, value.parse().unwrap());
        }
        let (socket, _) = tungstenite::client(request, self.connect()).unwrap();
        let mut live = Live { socket, ids: 0, epoch: 0, ahead_ms: 0.0, bench: Value::Null };
        let welcome = live.next("welcome");
        live.ahead_ms = welcome["server_ms"].as_f64().unwrap() - own_ms();
        live.bench = live.next("bench");
        live
    }

    /// Returns the response to a GET.
    pub fn get(&self, path: &str) -> String {
        let mut stream = self.connect();
        let heads = format!(
            "GET {path} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {}\r\nConnection: close\r\n\r\n",
            self.address, self.token
        );
        stream.write_all(heads.as_bytes()).unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        text.split_once("\r\n\r\n").map_or(String::new(), |(_, body)| body.to_owned())
    }

    /// A line of its `/proc/PID/status`, in kB.
    pub fn memory_kb(&self, line: &str) -> u64 {
        let path = format!("/proc/{}/status", self.child.id());
        let status = std::fs::read_to_string(path).unwrap_or_default();
        let found = status.lines().find_map(|text| text.strip_prefix(line)?.strip_prefix(':'));
        let number = found.and_then(|text| text.split_whitespace().next()?.parse().ok());
        number.unwrap_or(0)
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        // It may have ended by itself; one that was stopped is to hear of its end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn operator(state: &Path) -> String {
    let text = std::fs::read_to_string(state.join("tokens")).unwrap();
    let line = text.lines().find(|line| line.ends_with(" operator")).expect("the operator's");
    line.split(' ').next().unwrap().to_owned()
}

fn own_ms() -> f64 {
    polepair_link::clock::wall_ns(polepair_link::clock::now()) as f64 / 1e6
}

/// A viewer who may command.
pub struct Live {
    pub socket: WebSocket<TcpStream>,
    ids: u32,
    pub epoch: u64,
    ahead_ms: f64,
    /// The bench's list, as it was when the viewer came.
    pub bench: Value,
}

impl Live {
    pub fn send(&mut self, message: &Value) {
        self.write(message);
        self.socket.flush().unwrap();
    }

    /// Queues a message, which is sent together with the next one.
    pub fn write(&mut self, message: &Value) {
        self.socket.write(Message::text(message.to_string())).unwrap();
    }

    /// The next text of that type.
    pub fn next(&mut self, kind: &str) -> Value {
        self.until(kind, |_| true)
    }

    /// The next text of that type that is so.
    pub fn until(&mut self, kind: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        let deadline = Deadline::new(kind);
        let mut newest = "none".to_owned();
        loop {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    let value: Value = serde_json::from_str(&text).unwrap();
                    if value["type"] != kind {
                    } else if is_so(&value) {
                        return value;
                    } else {
                        newest = value.to_string();
                    }
                }
                Ok(_) => {}
                Err(error) => deadline.fail(&format!("{error}; the newest before: {newest}")),
            }
            deadline.check(|| format!("the newest is another: {newest}"));
        }
    }

    /// Takes the lease of an axis.
    pub fn lease(&mut self, axis: u16, act: &str) {
        let epoch = self.epoch;
        self.send(&json!({ "type": "lease", "axis": axis, "act": act, "epoch": epoch }));
        self.epoch = self.next("leased")["epoch"].as_u64().unwrap();
    }

    /// Builds a command with a new id and the present time.
    pub fn order(&mut self, axis: u16, verb: &str, velocity: Option<f64>) -> Value {
        self.ids += 1;
        let arguments = velocity.map_or(json!({}), |velocity| json!({ "velocity": velocity }));
        let issued_ms = own_ms() + self.ahead_ms;
        let id = format!("{}-{}", self.socket.get_ref().local_addr().unwrap(), self.ids);
        json!({ "type": "command", "axis": axis, "id": id,
                "issued_ms": issued_ms, "ttl_ms": 2000, "epoch": self.epoch, "verb": verb,
                "arguments": arguments })
    }

    pub fn command(&mut self, axis: u16, verb: &str, velocity: Option<f64>) -> Value {
        let value = self.order(axis, verb, velocity);
        self.send(&value);
        let id = value["id"].clone();
        self.until("outcome", |outcome| outcome["id"] == id)
    }

    /// Takes, arms, powers and turns an axis, and waits until it is seen to turn.
    pub fn spin(&mut self, axis: u16, velocity: f64) {
        self.lease(axis, "take");
        for (verb, velocity) in [("arm", None), ("enable", None), ("velocity", Some(velocity))] {
            let outcome = self.command(axis, verb, velocity);
            let known =
                outcome["error"]["code"] != "gateway.request" && outcome["error"]["code"] != "E213";
            assert!(
                outcome["outcome"] == "done" || !known || verb == "enable",
                "{verb}: {outcome}"
            );
            self.lease(axis, "renew");
        }
        let epoch = self.epoch;
        let deadline = Deadline::new("the motor turns");
        loop {
            self.send(&json!({ "type": "lease", "axis": axis, "act": "renew", "epoch": epoch }));
            let state = self.until("axis", |state| state["id"] == axis);
            if speed(&state).is_some_and(|speed| speed.abs() > velocity.abs() / 2.0) {
                return;
            }
            deadline.check(|| state.to_string());
        }
    }
}

/// The velocity in a state, rad/s.
pub fn speed(state: &Value) -> Option<f64> {
    let signals = state["signals"].as_array()?;
    signals.iter().find(|signal| signal["signal"] == "velocity")?["value"].as_f64()
}
