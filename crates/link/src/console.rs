//! Signals of the Windows console: Ctrl-C, Ctrl-Break, a console that is closed, log-off, shutdown.

use windows_sys::Win32::System::Console::{
    CTRL_BREAK_EVENT, CTRL_C_EVENT, CTRL_CLOSE_EVENT, CTRL_LOGOFF_EVENT, CTRL_SHUTDOWN_EVENT,
};

/// Event by which a console program is asked to end.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ConsoleEvent {
    /// Ctrl-C.
    Interrupt,
    /// Ctrl-Break.
    Break,
    /// The console window is closed. The system ends the process 5 s later.
    Close,
    /// The user logs off, or the system shuts down.
    LogOff,
}

impl ConsoleEvent {
    /// Returns whether the system ends the process as soon as its handler returns: the handler must wait for the end.
    #[must_use]
    pub const fn ends_process(self) -> bool {
        matches!(self, Self::Close | Self::LogOff)
    }
}

/// Has `handler` called, on a thread of the system, for each such event from now on. The first handler stays.
///
/// The event goes to the next handler of the process if `handler` returns false; the last one is the system's,
/// which ends the process. After true, the thread of an event that
/// [ends the process](ConsoleEvent::ends_process) waits until the program has ended by itself, or the system
/// ends it.
pub fn handle_console_events(handler: fn(ConsoleEvent) -> bool) {
    static HANDLER: std::sync::OnceLock<fn(ConsoleEvent) -> bool> = std::sync::OnceLock::new();
    let _ = HANDLER.set(handler);
    crate::sys::set_console_handler(|code| {
        let event = match code {
            CTRL_C_EVENT => ConsoleEvent::Interrupt,
            CTRL_BREAK_EVENT => ConsoleEvent::Break,
            CTRL_CLOSE_EVENT => ConsoleEvent::Close,
            CTRL_LOGOFF_EVENT | CTRL_SHUTDOWN_EVENT => ConsoleEvent::LogOff,
            _ => return false,
        };
        let is_handled = HANDLER.get().is_some_and(|handler| handler(event));
        while is_handled && event.ends_process() {
            std::thread::park();
        }
        is_handled
    });
}
