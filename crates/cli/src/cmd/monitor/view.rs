//! Key handling of the monitor. No key blocks, and only Esc sends a command.

use ratatui_crossterm::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::model::Monitor;
use super::traffic::{FrameGroup, FrameRow};

/// Letters that a filter may have.
const FILTER_MAX: usize = 64;
/// Rows that a page of frames moves by.
const PAGE_ROWS: usize = 10;

/// View settings of the user.
#[derive(Clone, Debug, Default)]
pub struct View {
    /// One row a kind of frame instead of every frame.
    pub by_kind: bool,
    /// Only frames that contain this, in small letters.
    pub filter: String,
    /// The filter is being typed.
    pub typing: bool,
    /// Number of frames when it was halted, and the kinds at that time.
    pub halted: Option<(u64, Vec<FrameGroup>)>,
    /// Frames scrolled back from the last, or kinds on from the first.
    pub scrolled: usize,
    /// The help is shown.
    pub help: bool,
    /// A stop was asked for.
    pub stopped: bool,
}

/// Outcome of a key.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum KeyOutcome {
    /// The monitor continues.
    Continue,
    /// The person leaves.
    Leave,
    /// Ctrl-C.
    Interrupted,
}

impl View {
    /// Does what a key means.
    pub fn handle_key(&mut self, key: KeyEvent, monitor: &mut Monitor) -> KeyOutcome {
        if key.kind == KeyEventKind::Release {
            return KeyOutcome::Continue;
        }
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            KeyCode::Char('c') if control => return KeyOutcome::Interrupted,
            // Whatever is on the screen: a stop gets through.
            KeyCode::Esc => self.stop(monitor),
            code if self.typing => self.type_filter(code, control),
            KeyCode::Char('q') if self.help => self.help = false,
            KeyCode::Char('q') => return KeyOutcome::Leave,
            KeyCode::Char('?') | KeyCode::F(1) => self.help = !self.help,
            code => self.handle_command_key(code, monitor),
        }
        KeyOutcome::Continue
    }

    fn stop(&mut self, monitor: &mut Monitor) {
        if self.typing {
            self.filter.clear();
        }
        (self.typing, self.help) = (false, false);
        self.stopped = true;
        monitor.source.stop();
    }

    fn type_filter(&mut self, code: KeyCode, control: bool) {
        match code {
            KeyCode::Enter => self.typing = false,
            KeyCode::Backspace => drop(self.filter.pop()),
            KeyCode::Char('u') if control => self.filter.clear(),
            KeyCode::Char(letter) if !control && self.filter.len() < FILTER_MAX => {
                self.filter.extend(letter.to_lowercase());
            }
            _ => {}
        }
    }

    fn handle_command_key(&mut self, code: KeyCode, monitor: &mut Monitor) {
        let last = monitor.axes().len().saturating_sub(1);
        match code {
            KeyCode::Char('/') => {
                self.filter.clear();
                self.typing = true;
            }
            KeyCode::Char(' ') => self.toggle_halt(monitor),
            KeyCode::Char('t') => (self.by_kind, self.scrolled) = (!self.by_kind, 0),
            KeyCode::Char('c') => {
                monitor.traffic.clear();
                (self.halted, self.scrolled) = (None, 0);
            }
            KeyCode::Up => monitor.chosen = monitor.chosen.saturating_sub(1),
            KeyCode::Down => monitor.chosen = (monitor.chosen + 1).min(last),
            KeyCode::PageUp => self.scroll(PAGE_ROWS as isize, monitor),
            KeyCode::PageDown => self.scroll(-(PAGE_ROWS as isize), monitor),
            KeyCode::Home => self.scroll(isize::MAX, monitor),
            KeyCode::End => self.resume(),
            _ => {}
        }
    }

    fn toggle_halt(&mut self, monitor: &Monitor) {
        match self.halted {
            Some(_) => self.resume(),
            None => self.halt(monitor),
        }
    }

    fn resume(&mut self) {
        self.halted = None;
        self.scrolled = if self.by_kind { self.scrolled } else { 0 };
    }

    fn halt(&mut self, monitor: &Monitor) {
        self.halted.get_or_insert_with(|| {
            (monitor.traffic.counts().0, monitor.traffic.kinds().cloned().collect())
        });
    }

    /// Scrolls up, or down by less than nothing. Frames that one scrolls in stand still.
    fn scroll(&mut self, up: isize, monitor: &Monitor) {
        if self.by_kind {
            let max = monitor.traffic.kinds().count().saturating_sub(1);
            self.scrolled = self.scrolled.saturating_add_signed(up.saturating_neg()).min(max);
        } else {
            self.halt(monitor);
            let max = monitor.traffic.rows().len().saturating_sub(1);
            self.scrolled = self.scrolled.saturating_add_signed(up).min(max);
        }
    }

    /// Returns whether a frame is one that the person wants to see.
    fn shows_row(&self, row: &FrameRow) -> bool {
        let passed = self.halted.as_ref().is_none_or(|(count, _)| row.number < *count);
        passed && self.matches_filter(row)
    }

    fn matches_filter(&self, row: &FrameRow) -> bool {
        self.filter.is_empty() || row.search_text.contains(&self.filter)
    }

    /// The last visible frames, at most `max`, oldest first.
    pub fn frames<'a>(&self, monitor: &'a Monitor, max: usize) -> Vec<&'a FrameRow> {
        let rows = monitor.traffic.rows().iter().rev().filter(|row| self.shows_row(row));
        let mut rows: Vec<&FrameRow> = rows.skip(self.scrolled).take(max).collect();
        rows.reverse();
        rows
    }

    /// The kinds of frames that are to be seen, from the one scrolled to.
    pub fn kinds<'a>(&'a self, monitor: &'a Monitor, max: usize) -> Vec<&'a FrameGroup> {
        let all: Vec<&FrameGroup> = match &self.halted {
            Some((_, kinds)) => kinds.iter().collect(),
            None => monitor.traffic.kinds().collect(),
        };
        let found: Vec<&FrameGroup> =
            all.into_iter().filter(|kind| self.matches_filter(&kind.last)).collect();
        let first = self.scrolled.min(found.len().saturating_sub(max));
        found.into_iter().skip(first).take(max).collect()
    }
}
