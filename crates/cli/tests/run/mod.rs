//! Runs the real binary.
#![allow(dead_code, reason = "each test file uses its part")]

use std::io::Write as _;
use std::process::{Command, Output, Stdio};

/// What a run printed, and how it ended.
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
    ran(child.wait_with_output().expect("the binary ends"))
}

/// Runs `polepair` with arguments.
pub fn polepair(arguments: &[&str]) -> Ran {
    polepair_with(arguments, "")
}

/// A command that prints plain text into pipes.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_polepair"));
    command.args(arguments).env("NO_COLOR", "1").stdout(Stdio::piped()).stderr(Stdio::piped());
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
