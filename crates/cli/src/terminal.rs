//! Output: results on stdout, notes on stderr, colours only on a terminal without `NO_COLOR`.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::problem::{self, Exit, Problem, Result};

/// Bytes that are gathered before they are written.
const BUFFER_SIZE: usize = 1 << 16;

/// Whether stdout takes colours.
pub fn colour_out() -> bool {
    io::stdout().is_terminal() && colours_wanted()
}

/// Whether stdout is a terminal that a screen can be drawn on.
pub fn is_screen() -> bool {
    io::stdout().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Columns of the terminal; what a page has where there is none.
pub fn width() -> usize {
    const PAGE: usize = 100;
    let stated = std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok());
    let found = || ratatui_crossterm::crossterm::terminal::size().ok().map(|size| size.0.into());
    stated.or_else(|| found().filter(|_| io::stdout().is_terminal())).unwrap_or(PAGE)
}

/// Whether stderr takes colours.
pub fn colour_err() -> bool {
    io::stderr().is_terminal() && colours_wanted()
}

fn colours_wanted() -> bool {
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    !set("NO_COLOR")
        && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
        && understands_escapes()
}

#[cfg(unix)]
const fn understands_escapes() -> bool {
    true
}

/// Has a console of Windows understand escape sequences; those before Windows 10 do not.
#[cfg(windows)]
fn understands_escapes() -> bool {
    ratatui_crossterm::crossterm::ansi_support::supports_ansi()
}

/// Where data goes: stdout or a file.
pub struct DataOutput {
    sink: Box<dyn io::Write + Send>,
    name: String,
    buffer: Vec<u8>,
}

impl DataOutput {
    /// stdout.
    pub fn stdout() -> Self {
        let sink: Box<dyn io::Write + Send> =
            if cfg!(test) { Box::new(io::sink()) } else { Box::new(io::stdout()) };
        Self { sink, name: "stdout".to_owned(), buffer: Vec::new() }
    }

    /// A new file.
    pub fn file(path: &Path) -> Result<Self> {
        let file = std::fs::File::create(path)
            .map_err(|error| problem::file_problem(path, "write", &error))?;
        let name = path.display().to_string();
        Ok(Self { sink: Box::new(file), name, buffer: Vec::new() })
    }

    /// stdout, or the file if there is one; `-` is stdout, as for other programs.
    pub fn to_path(path: Option<&Path>) -> Result<Self> {
        path.filter(|path| *path != "-").map_or_else(|| Ok(Self::stdout()), Self::file)
    }

    /// What is to be written next.
    pub fn buffer(&mut self) -> &mut Vec<u8> {
        &mut self.buffer
    }

    /// Adds a line.
    pub fn write_line(&mut self, text: &str) {
        self.buffer.extend_from_slice(text.as_bytes());
        self.buffer.push(b'\n');
    }

    /// Writes if enough was gathered.
    pub fn flush_if_full(&mut self) -> Result<()> {
        if self.buffer.len() < BUFFER_SIZE { Ok(()) } else { self.flush() }
    }

    /// Writes everything now.
    pub fn flush(&mut self) -> Result<()> {
        let written = self.sink.write_all(&self.buffer).and_then(|()| self.sink.flush());
        self.buffer.clear();
        written.map_err(|error| self.write_problem(&error))
    }

    /// A reader that went away (`| head`) wants no message.
    fn write_problem(&self, error: &io::Error) -> Problem {
        if error.kind() == io::ErrorKind::BrokenPipe {
            return Problem::new(Exit::Ok, "", "");
        }
        Problem::new(Exit::Adapter, "E304", format!("cannot write to {}.", self.name))
            .why(format!("The system says: {error}."))
    }
}

static QUIET: AtomicBool = AtomicBool::new(false);

/// Leaves notes and progress out from now on.
pub fn be_quiet() {
    QUIET.store(true, Ordering::Relaxed);
}

/// Whether notes and progress are left out.
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// A note on stderr: a line that a script can do without. `--quiet` leaves it out.
pub fn print_note(text: &str) {
    if !is_quiet() {
        print_warning(text);
    }
}

/// A line on stderr that is printed in any case: a motor may turn, or something is missing.
pub fn print_warning(text: &str) {
    draw(&format!("{text}\n"));
}

/// Where prose goes: tests read what was said.
fn stderr() -> Box<dyn io::Write> {
    if cfg!(test) { Box::new(io::sink()) } else { Box::new(io::stderr()) }
}

/// What a thread that tries a verb has said.
#[cfg(test)]
pub mod tried {
    use std::cell::RefCell;

    thread_local! {
        static SAID: RefCell<String> = const { RefCell::new(String::new()) };
    }

    pub fn record(text: &str) {
        SAID.with_borrow_mut(|output| output.push_str(text));
    }

    /// Takes it.
    pub fn take_recorded() -> String {
        SAID.take()
    }
}

/// Something that is drawn over on stderr. A terminal that went away ends nothing: a motor may be
/// turning, and whoever draws has to stop it.
pub fn draw(text: &str) {
    #[cfg(test)]
    tried::record(text);
    let mut err = stderr();
    let _ = err.write_all(text.as_bytes()).and_then(|()| err.flush());
}

/// A table with aligned columns; the last one may be as wide as it likes.
#[derive(Default)]
pub struct TextTable {
    rows: Vec<Vec<String>>,
    heads: usize,
}

impl TextTable {
    /// A table with column heads.
    pub fn with_heads(heads: &[&str]) -> Self {
        Self { rows: vec![heads.iter().map(|head| (*head).to_owned()).collect()], heads: 1 }
    }

    /// Adds a row.
    pub fn add_row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// True without rows below the heads.
    pub fn is_empty(&self) -> bool {
        self.rows.len() <= self.heads
    }

    /// The lines.
    pub fn render(&self, colour: bool) -> String {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |at: usize| {
            self.rows.iter().filter_map(|row| row.get(at)).map(|cell| cell.chars().count()).max()
        };
        let widths: Vec<usize> = (0..columns).map(|at| width(at).unwrap_or(0)).collect();
        let mut text = String::new();
        for (at, row) in self.rows.iter().enumerate() {
            let mut line = String::new();
            for (cell, width) in row.iter().zip(&widths) {
                line.push_str(cell);
                line.extend(std::iter::repeat_n(' ', width - cell.chars().count() + 2));
            }
            let line = line.trim_end();
            if colour && at < self.heads {
                text.push_str(&format!("\x1b[2m{line}\x1b[0m\n"));
            } else {
                text.push_str(line);
                text.push('\n');
            }
        }
        text
    }
}

/// A line of comma-separated values.
pub fn csv_line<'a>(fields: impl IntoIterator<Item = &'a str>) -> String {
    let quoted = |field: &str| match field.contains([',', '"', '\n']) {
        true => format!("\"{}\"", field.replace('"', "\"\"")),
        false => field.to_owned(),
    };
    fields.into_iter().map(quoted).collect::<Vec<_>>().join(",")
}
