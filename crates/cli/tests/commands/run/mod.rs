//! Runs the real binary.

pub mod screen;
#[cfg(unix)]
mod server;

use std::cell::Cell;
use std::ffi::OsString;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::process::{Child, ChildStderr, Command, Output, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::JoinHandle;

use polepair_test_support::{Deadline, WAIT_MAX};
#[cfg(unix)]
pub use server::Server;

/// The factor on all time-outs of a program that is expected to get its replies.
const REPLY_TIMEOUT_SCALE: u32 = 10;

thread_local! {
    static TIMEOUT_SCALE: Cell<u32> = const { Cell::new(REPLY_TIMEOUT_SCALE) };
}

/// Environment of programs under test: they print plain text, and their time-outs are long enough
/// for a machine that is busy with other things.
pub fn environment() -> [(&'static str, String); 2] {
    let scale = TIMEOUT_SCALE.get().to_string();
    [("NO_COLOR", "1".to_owned()), ("POLEPAIR_TIMEOUT_SCALE", scale)]
}

/// Shortens the time-outs of the programs that this test starts from now on: it waits for a drive that is
/// silent on purpose.
pub fn expect_silence() {
    TIMEOUT_SCALE.set(2);
}

/// Runs programs that get their replies, also in a test that expects silence otherwise.
pub fn expecting_replies<R>(run: impl FnOnce() -> R) -> R {
    let scale = TIMEOUT_SCALE.replace(REPLY_TIMEOUT_SCALE);
    let result = run();
    TIMEOUT_SCALE.set(scale);
    result
}

/// Output and exit code of a run.
#[derive(Debug)]
pub struct Ran {
    pub out: String,
    pub err: String,
    pub code: i32,
}

/// Runs `polepair` with arguments and stdin.
pub fn polepair_with(arguments: &[&str], input: &str) -> Ran {
    let mut child = command(arguments).stdin(Stdio::piped()).spawn().expect("the binary starts");
    let mut stdin = child.stdin.take().expect("a pipe");
    // A child that ends before it has read everything is judged by what it printed.
    let _ = stdin.write_all(input.as_bytes());
    drop(stdin);
    ended(child, arguments)
}

/// Waits for a program's end; one that goes on for too long is ended, and the test fails.
pub fn ended(child: Child, arguments: &[&str]) -> Ran {
    let (over, is_over) = mpsc::channel::<()>();
    let id = child.id();
    let watch = std::thread::spawn(move || {
        let is_late = is_over.recv_timeout(WAIT_MAX) == Err(RecvTimeoutError::Timeout);
        if is_late {
            signal("KILL", id);
        }
        is_late
    });
    let ran = ran(child.wait_with_output().expect("the binary ends"));
    drop(over);
    if watch.join().expect("it only waits") {
        Deadline::new("a program's end").fail(&format!("{arguments:?} goes on: {ran:?}"));
    }
    ran
}

/// Runs `polepair` with arguments.
pub fn polepair(arguments: &[&str]) -> Ran {
    polepair_with(arguments, "")
}

/// The program under test: the workspace's own, or that of `POLEPAIR_COMMAND`, such as an installed wheel's.
pub fn program() -> OsString {
    std::env::var_os("POLEPAIR_COMMAND").unwrap_or_else(|| env!("CARGO_BIN_EXE_polepair").into())
}

/// A command that prints plain text into pipes.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    command.args(arguments).envs(environment()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub fn ran(output: Output) -> Ran {
    let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
    Ran {
        out: text(output.stdout),
        err: text(output.stderr),
        code: output.status.code().unwrap_or(-1),
    }
}

/// A file of golden vectors.
pub fn vectors(name: &str) -> Vec<serde_json::Value> {
    let path = format!("{}/../../vectors/{name}.json", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).expect("vectors");
    serde_json::from_str(&text).expect("JSON")
}

/// A vector's text.
pub fn text<'a>(vector: &'a serde_json::Value, key: &str) -> &'a str {
    vector[key].as_str().unwrap_or("")
}

/// A vector's bytes as capital hexadecimal digits without spaces.
pub fn hex(vector: &serde_json::Value) -> String {
    text(vector, "bytes").replace(' ', "").to_uppercase()
}

/// Output of a run that must succeed.
pub fn ok(arguments: &[&str]) -> String {
    let ran = polepair(arguments);
    assert_eq!(ran.code, 0, "{arguments:?}: {}{}", ran.out, ran.err);
    ran.out
}

/// A process that does not outlive its test, however that ends.
struct Ours(Child);

impl Drop for Ours {
    fn drop(&mut self) {
        // One that was waited for is gone already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A served drive, ended with SIGTERM as a supervisor would.
pub struct Served {
    child: Ours,
    pub url: String,
}

impl Served {
    pub fn new(drive: &str) -> Self {
        Self::with(&[drive])
    }

    /// Serves drives with these arguments.
    pub fn with(arguments: &[&str]) -> Self {
        let mut child = command(&[&["sim"], arguments].concat()).spawn().expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
        let line = lines.next().expect("a line").expect("text");
        let url = line.strip_prefix("ready ").expect("ready").to_owned();
        Self { child: Ours(child), url }
    }

    pub fn id(&self) -> u32 {
        self.child.0.id()
    }

    /// URL of the link, without axes.
    pub fn link(&self) -> &str {
        self.url.split(['?', '#']).next().expect("a link")
    }

    pub fn end(mut self) {
        signal("TERM", self.child.0.id());
        assert_eq!(self.child.0.wait().expect("ends").code(), Some(0));
    }
}

/// Sends a signal to a process. After SIGSTOP it waits until the process is suspended.
pub fn signal(name: &str, pid: u32) {
    let text = pid.to_string();
    Command::new("kill").args([&format!("-{name}"), text.as_str()]).status().expect("kill");
    let tasks = format!("/proc/{pid}/task");
    let threads = || std::fs::read_dir(&tasks).into_iter().flatten().flatten();
    let stands = |task: std::fs::DirEntry| {
        let stat = std::fs::read_to_string(task.path().join("stat")).unwrap_or_default();
        stat.rsplit_once(") ").is_none_or(|(_, rest)| rest.starts_with('T'))
    };
    while name == "STOP" && !threads().all(stands) {
        std::thread::yield_now();
    }
}

/// A run that lasts until it is interrupted.
pub struct Held {
    child: Ours,
    /// Output, which is read while the program runs: a full pipe would block it.
    stdout: JoinHandle<Vec<u8>>,
    stderr: BufReader<ChildStderr>,
    said: String,
}

impl Held {
    /// Starts a program, and waits until it has printed this line.
    pub fn new(arguments: &[&str], line: &str) -> Self {
        let mut child = command(arguments).spawn().expect("starts");
        let mut stderr = BufReader::new(child.stderr.take().expect("a pipe"));
        let mut output = String::new();
        while output.lines().last() != Some(line) {
            assert!(stderr.read_line(&mut output).expect("text") > 0, "{arguments:?}: {output}");
        }
        let mut pipe = child.stdout.take().expect("a pipe");
        let stdout = std::thread::spawn(move || {
            let mut printed = Vec::new();
            pipe.read_to_end(&mut printed).expect("bytes");
            printed
        });
        Self { child: Ours(child), stdout, stderr, said: output }
    }

    pub fn id(&self) -> u32 {
        self.child.0.id()
    }

    /// Ctrl-C.
    pub fn interrupt(self) -> Ran {
        self.signalled(&["INT"])
    }

    /// Sends it signals, one right after the other.
    pub fn signalled(self, names: &[&str]) -> Ran {
        names.iter().for_each(|name| signal(name, self.child.0.id()));
        self.ended()
    }

    /// Waits for its own end.
    pub fn ended(mut self) -> Ran {
        self.stderr.read_to_string(&mut self.said).expect("text");
        let status = self.child.0.wait().expect("ends");
        let stdout = self.stdout.join().expect("what it printed");
        ran(Output { status, stdout, stderr: self.said.into_bytes() })
    }
}
