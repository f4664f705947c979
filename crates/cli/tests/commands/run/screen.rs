//! A terminal on which a program draws, and its contents.

use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use polepair_link::pty::Pty;
use polepair_link::{LinkIo as _, Received, clock};
use polepair_test_support::Deadline;

/// Size of the terminal.
const ROWS: usize = 30;
const COLUMNS: usize = 110;

/// A terminal with its program, which ends with it.
pub struct Screen {
    pty: Pty,
    child: Child,
    cells: Vec<Vec<char>>,
    /// Row and column of what comes next.
    at: (usize, usize),
    /// The beginning of what was cut off.
    rest: Vec<u8>,
}

impl Screen {
    /// Has the program draw.
    pub fn of(arguments: &[&str]) -> Self {
        let pty = Pty::open(None).expect("a pseudo-terminal");
        let (rows, columns) = (ROWS.to_string(), COLUMNS.to_string());
        let sized =
            Command::new("stty").args(["-F", pty.path(), "rows", &rows, "cols", &columns]).status();
        assert!(sized.expect("stty").success());
        let end = || {
            let file = File::options().read(true).write(true).open(pty.path()).expect("its end");
            Stdio::from(file)
        };
        // Without the terminal that the tests may run on.
        let child = Command::new("setsid")
            .arg(super::program())
            .args(arguments)
            .envs(super::environment())
            .env("TERM", "xterm")
            .stdin(end())
            .stdout(end())
            .stderr(end())
            .spawn();
        let cells = vec![vec![' '; COLUMNS]; ROWS];
        Self { pty, child: child.expect("starts"), cells, at: (0, 0), rest: Vec::new() }
    }

    /// Text on the screen.
    pub fn text(&self) -> String {
        let line = |row: &Vec<char>| row.iter().collect::<String>().trim_end().to_owned() + "\n";
        self.cells.iter().map(line).collect()
    }

    /// Waits until this text is on the screen.
    pub fn until(&mut self, wanted: &str) {
        let deadline = Deadline::new(wanted);
        while !self.text().contains(wanted) {
            deadline.check(|| self.text());
            self.refresh();
        }
    }

    /// Presses keys.
    pub fn press(&self, keys: &[u8]) {
        self.pty.send(keys).expect("a terminal");
    }

    /// Waits for the program's end, and returns its exit code.
    pub fn ended(mut self) -> Option<i32> {
        let deadline = Deadline::new("the program's end");
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                return status.code();
            }
            deadline.check(|| self.text());
            self.refresh();
        }
    }

    fn refresh(&mut self) {
        let mut bytes = [0; 4096];
        let until = clock::now() + Duration::from_millis(20);
        if let Ok(Received::Bytes { len, .. }) = self.pty.receive(&mut bytes, until) {
            self.rest.extend_from_slice(&bytes[..len]);
            while let Some(used) = self.parse_escape() {
                self.rest.drain(..used);
            }
        }
    }

    /// Takes a letter, or what moves or clears; `None` when there is nothing whole.
    fn parse_escape(&mut self) -> Option<usize> {
        let rest = &self.rest[..];
        match *rest.first()? {
            0x1B if *rest.get(1)? != b'[' => return Some(2),
            0x1B => {
                let at = rest[2..].iter().position(|byte| (0x40..=0x7E).contains(byte))? + 2;
                let words = String::from_utf8_lossy(&rest[2..at]).into_owned();
                let mut numbers = words.split(';').map(|n| n.parse().unwrap_or(1_usize));
                match rest[at] {
                    b'H' => {
                        let row = numbers.next().unwrap_or(1).clamp(1, ROWS);
                        self.at = (row - 1, numbers.next().unwrap_or(1).clamp(1, COLUMNS) - 1);
                    }
                    b'J' => self.cells.iter_mut().for_each(|row| row.fill(' ')),
                    _ => {}
                }
                return Some(at + 1);
            }
            b'\r' | b'\n' => return Some(1),
            _ => {}
        }
        let length = match rest[0] {
            0..0x80 => 1,
            0x80..0xE0 => 2,
            0xE0..0xF0 => 3,
            _ => 4,
        };
        let letter = std::str::from_utf8(rest.get(..length)?).ok().and_then(|t| t.chars().next());
        let (row, column) = self.at;
        if let (Some(letter), Some(cell)) = (letter, self.cells[row].get_mut(column)) {
            *cell = letter;
            self.at.1 += 1;
        }
        Some(length)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
