//! Terminal of the monitor: set up, drawn, polled for keys, and restored in any case.

use std::io::{self, BufWriter, Stdout, Write as _};
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;
use ratatui_core::layout::Rect;
use ratatui_core::terminal::{Terminal, TerminalOptions, Viewport};
use ratatui_crossterm::CrosstermBackend;
use ratatui_crossterm::crossterm::cursor::{Hide, Show};
use ratatui_crossterm::crossterm::event::{self, Event};
use ratatui_crossterm::crossterm::execute;
use ratatui_crossterm::crossterm::terminal::{
    Clear, ClearType, EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode,
    enable_raw_mode, size,
};

use super::draw::{self, Theme};
use super::model::Monitor;
use super::view::{KeyOutcome, View};
use crate::interrupt;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, print_note};

/// Length of a wait for keys.
const KEY_WAIT: Duration = Duration::from_millis(10);
/// Interval of drawing without a key, ms.
const DRAW_MS: u32 = 50;
/// Keys that are taken before the link is looked after again.
const KEYS_MAX: usize = 64;

/// Shows it until the person leaves, or the time is over.
pub fn run(monitor: &mut Monitor, span: Option<Duration>) -> Result {
    let mut screen = TerminalScreen::open().map_err(|error| terminal_problem(&error))?;
    let ended = run_loop(&mut screen, monitor, span);
    drop(screen);
    monitor.source.exit_notes().iter().for_each(|line| print_note(line));
    ended
}

fn run_loop(screen: &mut TerminalScreen, monitor: &mut Monitor, span: Option<Duration>) -> Result {
    let theme = Theme { colour: terminal::colour_out() };
    let mut view = View::default();
    let mut drawn = Instant::ZERO;
    loop {
        let mut pressed = false;
        for _ in 0..KEYS_MAX {
            let wait = if pressed { Duration::ZERO } else { KEY_WAIT };
            if !event::poll(wait).map_err(|error| terminal_problem(&error))? {
                break;
            }
            pressed = true;
            let Event::Key(key) = event::read().map_err(|error| terminal_problem(&error))? else {
                continue;
            };
            match view.handle_key(key, monitor) {
                KeyOutcome::Continue => {}
                KeyOutcome::Leave => return Ok(Exit::Ok),
                KeyOutcome::Interrupted => return Err(Problem::interrupted()),
            }
        }
        monitor.poll(&mut |_| ())?;
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        if span.is_some_and(|span| monitor.age() >= span) {
            return Ok(Exit::Ok);
        }
        let now = clock::now();
        if pressed || now >= drawn.plus_ms(DRAW_MS) || drawn == Instant::ZERO {
            drawn = now;
            screen.draw(monitor, &view, theme).map_err(|error| terminal_problem(&error))?;
        }
    }
}

fn terminal_problem(error: &io::Error) -> Problem {
    Problem::new(Exit::Adapter, "E304", "cannot draw on the terminal.")
        .why(format!("The system says: {error}."))
        .hint("`polepair monitor URL --format text` prints lines instead")
}

/// A terminal whose state is restored when this is dropped, and before a panic prints its message.
struct TerminalScreen {
    terminal: ScreenTerminal,
    size: (u16, u16),
}

type ScreenTerminal = Terminal<CrosstermBackend<BufWriter<Stdout>>>;

impl TerminalScreen {
    fn open() -> io::Result<Self> {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            restore_terminal();
            before(panic);
        }));
        let size = size()?;
        // From here on it is given back, also where the next step fails.
        let mut terminal_screen = Self { terminal: terminal_of_size(size)?, size };
        enable_raw_mode()?;
        execute!(
            terminal_screen.terminal.backend_mut(),
            EnterAlternateScreen,
            Hide,
            Clear(ClearType::All)
        )?;
        Ok(terminal_screen)
    }

    fn draw(&mut self, monitor: &Monitor, view: &View, theme: Theme) -> io::Result<()> {
        let size = size()?;
        if size != self.size {
            (self.terminal, self.size) = (terminal_of_size(size)?, size);
            execute!(self.terminal.backend_mut(), Clear(ClearType::All))?;
        }
        self.terminal.draw(|frame| draw::draw_monitor(monitor, view, theme, frame.buffer_mut()))?;
        Ok(())
    }
}

/// A fixed area: one that follows the terminal's size would ask it where its cursor is, and wait for
/// an answer that some never give.
fn terminal_of_size(size: (u16, u16)) -> io::Result<ScreenTerminal> {
    let (width, height) = size;

    let viewport = Viewport::Fixed(Rect::new(0, 0, width, height));
    let backend = CrosstermBackend::new(BufWriter::new(io::stdout()));
    Terminal::with_options(backend, TerminalOptions { viewport })
}

impl Drop for TerminalScreen {
    fn drop(&mut self) {
        restore_terminal();
    }
}

/// Nothing can be done where the terminal is gone.
fn restore_terminal() {
    let _ = disable_raw_mode();
    let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
    let _ = io::stdout().flush();
}
