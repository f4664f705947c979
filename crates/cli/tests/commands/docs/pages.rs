//! The commands of a page are run: `sh` blocks as scripts, `console` blocks command by command.
//!
//! The output behind a `$` command must be the command's, and a `text` block behind a block that was run must be
//! in its output. Numbers are masked, because a motor does not stop at the same count twice; `…` replaces the
//! rest of a line or, alone, for any lines.
//!
//! Simulated drives stand ready, fresh for each page: what the page calls `/dev/ttyUSB0` or `/tmp/motor` is a
//! pseudo-terminal in a folder of the test's.

use super::{Block, blocks, pages, root, text};
use crate::run;

use polepair_test_support::{Deadline, WAIT_MAX, machine_load};
use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// The port as a page writes it, the name of the simulated one, and the drives on it.
const PORTS: [(&str, &str, &str); 6] = [
    ("/tmp/motor", "motor", "tmcl:1"),
    ("/tmp/servo", "servo", "modbus-rtu:1"),
    ("tmcl+serial:///dev/ttyUSB0", "motor", "tmcl:1"),
    ("modbus-rtu+serial:///dev/ttyUSB0", "servo", "modbus-rtu:1"),
    ("tml+serial:///dev/ttyUSB0", "tml", "tml:1"),
    ("tmcl+serial:///dev/ttyACM0", "stepper", "tmcm-6110:1"),
];

/// Pages whose motor is another one.
const OTHER_MOTORS: [(&str, &str); 2] =
    [("tmcl-programs", "tmcm-1140:1"), ("first-bldc-module", "tmcm-1640:1")];

/// Commands that are not run, by what they contain.
const NOT_RUN: [(&str, &str); 16] = [
    ("good.jsonl", "a capture of the reader's"),
    (" program run tmcl+serial:///dev/ttyUSB0:9600#1 \0", "a program without an end"),
    (" --for 10s", "ten seconds of the test's"),
    ("can0", "no test has such an interface"),
    ("s3://", "no test has such a bucket"),
    ("through=255", "the relay of another test"),
    (" demo", "it serves until Ctrl-C"),
    (" serve", "it serves until Ctrl-C"),
    (" monitor ", "it draws until Ctrl-C"),
    (" record ", "it records until Ctrl-C"),
    (" fleet ", "the Python package"),
    (" completions ", "writes into the user's shell"),
    ("good.log", "a capture of the reader's"),
    ("answers.log", "a capture of the reader's"),
    ("#1,2", "the second of two motors that the page does not need"),
    ("#2 ", "an address that does not answer"),
];

/// Line that a command prints which runs until Ctrl-C.
const WAITS: &str = "running; Ctrl-C stops it";

#[test]
fn pages_show_what_commands_print() {
    let pages = pages();
    let (next, ran, wrong) = (AtomicUsize::new(0), AtomicUsize::new(0), Mutex::new(String::new()));
    let work = || {
        while let Some(page) = pages.get(next.fetch_add(1, Ordering::Relaxed)) {
            let Some(mut bench) = PageBench::new(page) else { continue };
            bench.run_blocks();
            ran.fetch_add(bench.ran, Ordering::Relaxed);
            wrong.lock().expect("no panic").push_str(&bench.wrong);
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(work);
        work();
    });
    let wrong = wrong.into_inner().expect("no panic");
    assert!(wrong.is_empty(), "{wrong}");
    let ran = ran.into_inner();
    assert!(ran > 60, "only {ran} commands and scripts were found");
}

/// A simulated drive that ends with its owner.
struct Drive {
    child: Child,
    ready: String,
}

impl Drive {
    fn start(arguments: &[&str]) -> Result<Self, String> {
        let mut child = run::command(arguments).spawn().expect("polepair sim");
        let mut ready = String::new();
        let out = child.stdout.take().expect("a pipe");
        BufReader::new(out).read_line(&mut ready).expect("a line");
        let started = Self { child, ready };
        if started.ready.starts_with("ready ") { Ok(started) } else { Err(started.ready.clone()) }
    }
}

impl Drop for Drive {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A page, and the drives that it talks to.
struct PageBench {
    page: PathBuf,
    blocks: Vec<Block>,
    folder: PathBuf,
    /// Names in the page, each with its replacement in commands and output.
    names: Vec<(String, String)>,
    drives: Vec<Drive>,
    ran: usize,
    wrong: String,
}

impl Drop for PageBench {
    fn drop(&mut self) {
        self.drives.clear();
        // What is left over lies in the system's temporary folder.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

impl PageBench {
    fn new(page: &Path) -> Option<Self> {
        let blocks = blocks(&text(page));
        let is_run = |block: &Block| matches!(&*block.mark, "sh" | "console");
        if !blocks.iter().any(is_run) {
            return None;
        }
        let stem = page.file_stem().expect("a name").to_string_lossy().into_owned();
        // Several folders have a README.
        let name = page.strip_prefix(root()).unwrap_or(page).with_extension("");
        let name = name.display().to_string().replace('/', "-");
        let folder = std::env::temp_dir().join(format!("pp-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        for entry in ["docs", "vectors", "examples", "crates"] {
            let _ = std::os::unix::fs::symlink(root().join(entry), folder.join(entry));
        }
        let mut bench = Self {
            page: page.to_owned(),
            folder,
            names: Vec::new(),
            drives: Vec::new(),
            ran: 0,
            wrong: String::new(),
            blocks,
        };
        bench.start_drives(&stem);
        Some(bench)
    }

    /// The drives that the page names and does not start itself.
    fn start_drives(&mut self, stem: &str) {
        let all: String = self.blocks.iter().map(|block| block.text.as_str()).collect();
        let mut started: Vec<&str> = Vec::new();
        for (shown, port, drives) in PORTS {
            let path = self.folder.join(port).display().to_string();
            let url = shown.rsplit_once("/dev/").map_or("", |(protocol, _)| protocol);
            if all.contains(shown) {
                self.names.push((shown.to_owned(), format!("{url}{path}")));
                // What is printed of a port alone.
                self.names.push((shown[url.len()..].to_owned(), path.clone()));
            }
            let is_own = all.contains(&format!("--pty {shown}"));
            if is_own || started.contains(&port) || !all.contains(shown) {
                continue;
            }
            started.push(port);
            let other = OTHER_MOTORS.iter().find(|(page, _)| *page == stem && port == "motor");
            let drives = other.map_or(drives, |(_, drives)| drives);
            let drive = Drive::start(&["sim", drives, "--pty", &path]);
            self.drives.push(drive.expect("a simulated drive"));
        }
        self.names.push(("/tmp/".to_owned(), format!("{}/", self.folder.display())));
    }

    fn run_blocks(&mut self) {
        let blocks = std::mem::take(&mut self.blocks);
        // The examples of the command line's reference name files and drives of the reader's.
        let is_reference = self.page.parent().is_some_and(|it| it.ends_with("command-line"));
        // The output of the block before, where it was run.
        let mut before = None;
        for block in &blocks {
            let output = before.take();
            match &*block.mark {
                "sh" => before = self.run_script(block),
                "console" if !is_reference => before = self.run_session(block),
                "text" if !is_reference => {
                    if let Some(output) = output {
                        self.compare_excerpt(block, &output);
                    }
                }
                _ => {}
            }
        }
    }

    fn fail(&mut self, line: usize, what: &str) {
        let _ = writeln!(self.wrong, "{}:{line}: {what}\n", self.page.display());
    }

    fn run_script(&mut self, block: &Block) -> Option<String> {
        self.ran += 1;
        match self.shell(&block.text) {
            Ok(output) => Some(output),
            Err(error) => {
                self.fail(block.line, &format!("\n{}{error}", block.text));
                None
            }
        }
    }

    /// Runs the commands of a block, and compares the output that is shown behind each.
    fn run_session(&mut self, block: &Block) -> Option<String> {
        let mut all = None;
        for (line, command, expected) in commands(block) {
            let words = command.split(" #").next().unwrap_or_default();
            let skip = |(part, _why): &&(&str, &str)| format!("{command} \0").contains(part);
            // A search of all ports opens those of this machine.
            let searches = words.starts_with("polepair scan") && !command.contains("://");
            let is_ours = words.starts_with("polepair ") || words == "polepair";
            if !is_ours || searches || NOT_RUN.iter().any(|entry| skip(&entry)) {
                continue;
            }
            self.ran += 1;
            let ran = if words.starts_with("polepair sim ") {
                self.start_simulation(&command, &expected)
            } else if words.contains(['|', '&', ';', '>']) {
                self.shell(&command)
            } else if words.starts_with("polepair scan ") && !words.contains("--id") {
                // All addresses take a minute; the drives have the first.
                self.shell(&format!("exec {words} --ids 1-4"))
            } else {
                // Instead of the shell, so that it gets the signals.
                self.shell(&format!("exec {command}"))
            };
            match ran {
                Ok(output) => {
                    if let Some(expected) = &expected
                        && let Err(what) = compare(expected, &self.unname(&output))
                    {
                        self.fail(line, &format!("{command}\n{what}"));
                    }
                    all.get_or_insert_with(String::new).push_str(&output);
                }
                Err(error) => self.fail(line, &format!("{command}\n{error}")),
            }
        }
        all
    }

    /// Starts a simulation that the page starts, and names its port as the page does.
    fn start_simulation(
        &mut self,
        command: &str,
        expected: &Option<Vec<String>>,
    ) -> Result<String, String> {
        let command = self.name(command);
        let words = command.split_whitespace().take_while(|word| !word.starts_with('#'));
        let words: Vec<&str> = words.skip(1).collect();
        let drive = Drive::start(&words)?;
        let output = drive.ready.clone();
        self.drives.push(drive);
        let terminal = |line: &str| {
            let at = line.find("/dev/pts/")?;
            let path: String =
                line[at..].chars().take_while(|c| c.is_alphanumeric() || *c == '/').collect();
            Some(path)
        };
        let shown = expected.iter().flatten().find_map(|line| terminal(line));
        self.names.extend(shown.zip(terminal(&output)));
        Ok(output)
    }

    fn compare_excerpt(&mut self, block: &Block, output: &str) {
        let output = self.unname(output);
        let mut lines = output.lines().map(mask);
        for line in block.text.lines().filter(|line| line.trim() != "…") {
            let wanted = mask(line);
            if !lines.by_ref().any(|line| matches(&wanted, &line)) {
                let output: String = output.chars().take(2000).collect();
                self.fail(block.line, &format!("not in the output: {line}\n{output}"));
                return;
            }
        }
    }

    /// The text with the ports of this bench.
    fn name(&self, text: &str) -> String {
        let names: Vec<_> = self.names.iter().map(|(shown, its)| (&**shown, &**its)).collect();
        replace_all(text, &names)
    }

    /// The output with the ports of the page.
    fn unname(&self, output: &str) -> String {
        let names: Vec<_> = self.names.iter().map(|(shown, its)| (&**its, &**shown)).collect();
        replace_all(output, &names)
    }

    /// Runs a script, and returns what it printed. One that waits for Ctrl-C gets it.
    fn shell(&self, script: &str) -> Result<String, String> {
        let script = format!("exec 2>&1\n{}", self.name(script));
        let binary = Path::new(env!("CARGO_BIN_EXE_polepair")).parent().expect("a folder");
        let path = format!("{}:{}", binary.display(), std::env::var("PATH").unwrap_or_default());
        let mut child = Command::new("sh")
            .args(["-e", "-c", &script])
            .current_dir(&self.folder)
            .env("PATH", path)
            .envs(run::environment())
            .env("HOME", &self.folder)
            .env("XDG_CONFIG_HOME", &self.folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("sh starts");
        let mut out = child.stdout.take().expect("a pipe");
        let (sender, printed) = std::sync::mpsc::channel();
        let reader = std::thread::spawn(move || {
            let (mut bytes, mut chunk) = (Vec::new(), [0; 4096]);
            while let Ok(count @ 1..) = out.read(&mut chunk) {
                bytes.extend_from_slice(&chunk[..count]);
                let _ = sender.send(String::from_utf8_lossy(&bytes).contains(WAITS));
            }
            String::from_utf8_lossy(&bytes).into_owned()
        });
        let (deadline, mut is_interrupted) = (Deadline::new("the end of a block"), false);
        while !deadline.has_passed() {
            if let Some(status) = child.try_wait().expect("a status") {
                let output = reader.join().expect("its output");
                let is_right = status.success() || is_interrupted && status.code() == Some(130);
                return if is_right { Ok(output) } else { Err(output) };
            }
            if !is_interrupted && printed.try_iter().any(|waits| waits) {
                run::signal("INT", child.id());
                is_interrupted = true;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = child.kill();
        let _ = child.wait();
        Err(format!("it does not end within {WAIT_MAX:?}; {}", machine_load()))
    }
}

/// The text with the first of these that fits replaced at each place. What was put in is not replaced again.
fn replace_all(text: &str, names: &[(&str, &str)]) -> String {
    let (mut replaced, mut rest) = (String::new(), text);
    while let Some(next) = rest.chars().next() {
        match names.iter().find(|(from, _)| rest.starts_with(from)) {
            Some((from, to)) => {
                replaced.push_str(to);
                rest = &rest[from.len()..];
            }
            None => {
                replaced.push(next);
                rest = &rest[next.len_utf8()..];
            }
        }
    }
    replaced
}

/// The commands of a block with their lines, and what is shown behind each. Without a `$` each line is a command.
fn commands(block: &Block) -> Vec<(usize, String, Option<Vec<String>>)> {
    let has_prompts = block.text.lines().any(|line| line.starts_with("$ "));
    let mut commands: Vec<(usize, String, Option<Vec<String>>)> = Vec::new();
    for (n, line) in block.text.lines().enumerate() {
        let number = block.line + n + 1;
        match (line.strip_prefix("$ "), has_prompts, commands.last_mut()) {
            (Some(command), ..) => commands.push((number, command.to_owned(), None)),
            (None, true, Some((.., shown))) => {
                shown.get_or_insert_with(Vec::new).push(line.to_owned());
            }
            _ => commands.push((number, line.to_owned(), None)),
        }
    }
    commands
}

/// Compares the output with the lines of the page.
fn compare(expected: &[String], output: &str) -> Result<(), String> {
    let shown = expected.join("\n");
    let differs = || Err(format!("shown:\n{shown}\nprinted:\n{output}"));
    let mut lines = output.lines().map(mask).peekable();
    let mut wanted = expected.iter().map(|line| mask(line)).peekable();
    while let Some(line) = wanted.next() {
        if line == "…" {
            let Some(next) = wanted.peek() else { return Ok(()) };
            while lines.next_if(|line| !matches(next, line)).is_some() {}
        } else if !lines.next().is_some_and(|printed| matches(&line, &printed)) {
            return differs();
        }
    }
    if lines.next().is_some() { differs() } else { Ok(()) }
}

/// Returns whether a line matches, where `…` is any text.
fn matches(wanted: &str, printed: &str) -> bool {
    let Some((start, rest)) = wanted.split_once('…') else { return wanted == printed };
    let Some(mut left) = printed.strip_prefix(start.trim_end()) else { return false };
    let mut parts = rest.split('…').map(str::trim).peekable();
    while let Some(part) = parts.next() {
        match left.find(part) {
            Some(_) if parts.peek().is_none() => return left.ends_with(part),
            Some(at) => left = &left[at + part.len()..],
            None => return false,
        }
    }
    true
}

/// A line with `0` for each number, and one space where there are several.
fn mask(line: &str) -> String {
    let mut masked = String::new();
    for word in line.split_whitespace() {
        if !masked.is_empty() {
            masked.push(' ');
        }
        let mut chars = word.chars().peekable();
        while let Some(c) = chars.next() {
            let is_sign = c == '-' && chars.peek().is_some_and(char::is_ascii_digit);
            if !c.is_ascii_digit() && !is_sign {
                masked.push(c);
                continue;
            }
            while chars.next_if(|c| c.is_ascii_digit() || *c == '.').is_some() {}
            masked.push('0');
        }
    }
    masked
}

#[test]
fn numbers_are_masked_and_words_are_not() {
    let is_same = |shown: &str, printed: &str| compare(&[shown.to_owned()], printed).is_ok();
    assert!(is_same("velocity = 59.8 rpm  (60)", "velocity = -60 rpm (1.5)\n"));
    assert!(!is_same("velocity = 60 rpm", "velocity = 60 deg\n"));
    assert!(!is_same("velocity = 60 rpm", "velocity = 60 rpm\nmore\n"));
    assert!(is_same("remedy  Measure the …", "  remedy Measure the supply\n"));
    assert!(is_same("tpdo1 (… = 55, …)", "tpdo1 (if mapped: word = 56, on)\n"));
    assert!(!is_same("tpdo1 (… = 55, …)", "tpdo1 (if mapped: word = 56, on) odd\n"));
    assert!(compare(&["a".into(), "…".into(), "c".into()], "a\nb\nb\nc\n").is_ok());
    assert!(compare(&["a".into(), "…".into(), "c".into()], "a\nb\n").is_err());
}
