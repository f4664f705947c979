//! A gateway that a test starts, and commands on its axes.

use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::Child;
use std::sync::atomic::{AtomicU32, Ordering};

use super::{Held, Ran, command, polepair};

/// A server of its own for each test, on a free port.
pub struct Server {
    pub child: Child,
    pub folder: PathBuf,
    pub url: String,
}

impl Server {
    pub fn new(links: &[&str]) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let n = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("polepair-joined-{}-{n}", std::process::id());
        Self::within(std::env::temp_dir().join(name), links)
    }

    pub fn within(folder: PathBuf, links: &[&str]) -> Self {
        let state = folder.to_str().expect("a path");
        let options = ["--bind", "127.0.0.1:0", "--log", "off", "--state", state];
        let arguments = [&["serve"], links, &options].concat();
        let mut child = command(&arguments).spawn().expect("starts");
        let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
        let line = lines.next().expect("a line").expect("text");
        let url = line.strip_prefix("ready ").and_then(|url| url.split('?').next());
        Self { url: url.expect("ready").to_owned(), child, folder }
    }

    pub fn tokens(&self) -> String {
        self.folder.join("tokens").display().to_string()
    }

    pub fn words<'a>(&'a self, tokens: &'a str, verb: &[&'a str]) -> Vec<&'a str> {
        [&["--server", &self.url, "--token-file", tokens], verb].concat()
    }

    pub fn run(&self, verb: &[&str]) -> Ran {
        let ran = polepair(&self.words(&self.tokens(), verb));
        let text = std::fs::read_to_string(self.tokens()).expect("tokens");
        for token in text.lines().filter(|line| !line.starts_with('#')) {
            assert!(!format!("{ran:?}").contains(&token[..64]), "a token is shown");
        }
        ran
    }

    pub fn ok(&self, verb: &[&str]) -> String {
        let ran = self.run(verb);
        assert_eq!(ran.code, 0, "{verb:?}: {}{}", ran.out, ran.err);
        ran.out
    }

    /// Starts a verb that runs until Ctrl-C, and waits for its first line.
    pub fn held(&self, verb: &[&str]) -> Held {
        Held::new(&self.words(&self.tokens(), verb), "running; Ctrl-C stops it")
    }

    /// Output of `info` for axis 1, with columns separated by one space.
    pub fn info(&self) -> String {
        self.ok(&["info", "1"]).split_whitespace().collect::<Vec<_>>().join(" ")
    }

    pub fn velocity(&self, axes: &str) -> f64 {
        let text = self.ok(&["get", axes, "actual velocity", "--raw"]);
        text.trim().rsplit(' ').next().and_then(|v| v.parse().ok()).expect("a number")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
