//! Signals that end a verb: Ctrl-C, Ctrl-\, Ctrl-Z, `kill`, a closed terminal.
//!
//! The first signal ends the wait, so the verb can stop its motors. A second Ctrl-C or Ctrl-\ ends the
//! process at once, and prints which motors may turn.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair_core::time::Instant;
use polepair_link::clock;

use crate::problem::Exit;
use crate::terminal::print_warning;

/// Keys that come sooner after the first are the same press: they bounce, and `timeout` sends its
/// signal to a process and to its group.
const SAME_PRESS_MS: u32 = 300;

static COUNT: AtomicU32 = AtomicU32::new(0);
static WAKERS: Mutex<Vec<Box<dyn Fn() + Send>>> = Mutex::new(Vec::new());
/// Connection string that stops the motors that this process may have left turning.
static HELD_URL: Mutex<Option<String>> = Mutex::new(None);
static FIRST_AT: Mutex<Option<Instant>> = Mutex::new(None);

/// Listens for every signal that would end this process, from now on; `wake` is called, on another
/// thread, when one comes.
pub fn listen(wake: impl Fn() + Send + 'static) {
    lock(&WAKERS).push(Box::new(wake));
    start_listening();
}

fn start_listening() {
    static LISTENING: AtomicBool = AtomicBool::new(false);
    if !cfg!(test) && !LISTENING.swap(true, Ordering::SeqCst) {
        system::listen_for(system::ENDING);
    }
}

/// Has a signal that ends this process remove the files that are not complete.
pub fn remove_files_at_end() {
    start_listening();
}

/// Has a write at a limit of a file's size fail, and not end the process.
pub fn outlive_file_limit() {
    system::outlive_file_limit();
}

/// Declares motors that may turn because of this process until the guard is dropped. Meanwhile it is not suspended:
/// Ctrl-Z ends the wait, too, because a suspended process would not watch the motor.
pub fn hold_motion(url: &str) -> HoldGuard {
    static UNSUSPENDED: AtomicBool = AtomicBool::new(false);
    *lock(&HELD_URL) = Some(url.to_owned());
    if !cfg!(test) && !UNSUSPENDED.swap(true, Ordering::SeqCst) {
        system::listen_for(system::SUSPENDING);
    }
    HoldGuard(())
}

/// Something may be turning because of this process.
pub struct HoldGuard(());

impl Drop for HoldGuard {
    fn drop(&mut self) {
        *lock(&HELD_URL) = None;
    }
}

/// True once such a signal came.
pub fn was_interrupted() -> bool {
    count() > 0
}

/// Number of received interrupt signals.
pub fn count() -> u32 {
    COUNT.load(Ordering::SeqCst)
}

/// Takes a signal; `key` for one of the keyboard's that asks for an end at once when it comes again.
fn handle_signal(key: bool) {
    if COUNT.fetch_add(1, Ordering::SeqCst) == 0 {
        *lock(&FIRST_AT) = Some(clock::now());
        if lock(&WAKERS).is_empty() {
            // Nothing waits for a signal: the verb only reads and writes files.
            exit_interrupted();
        }
        lock(&WAKERS).iter().for_each(|wake| wake());
        return;
    }
    // A closing terminal, and the end of a service, send several signals.
    let same = lock(&FIRST_AT).is_none_or(|first| clock::now() < first.plus_ms(SAME_PRESS_MS));
    let held = lock(&HELD_URL).clone();
    if same || !(key || held.is_none()) {
        return;
    }
    if let Some(url) = held {
        print_warning(&format!(
            "exit without a stop: a motor may still turn; to stop it: polepair stop {url}"
        ));
    }
    exit_interrupted();
}

fn exit_interrupted() -> ! {
    if polepair_files::remove_unfinished() > 0 {
        print_warning(
            "interrupted: nothing was written; a file that was there before is unchanged",
        );
    }
    std::process::exit(Exit::Interrupted as i32);
}

fn lock<T>(what: &Mutex<T>) -> MutexGuard<'_, T> {
    what.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(unix)]
mod system {
    use signal_hook::consts::signal::{
        SIGABRT, SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGSYS, SIGTERM, SIGTRAP,
        SIGTSTP, SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU, SIGXFSZ,
    };
    use signal_hook::iterator::Signals;
    use std::sync::Arc;

    /// Signals that end a process without a handler. (SIGPIPE is ignored from the beginning.)
    pub const ENDING: &[i32] = &[
        SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGALRM, SIGVTALRM, SIGPROF, SIGUSR1, SIGUSR2, SIGXCPU,
        SIGABRT, SIGIO, SIGSYS, SIGTRAP,
    ];
    /// Ctrl-Z.
    pub const SUSPENDING: &[i32] = &[SIGTSTP];

    /// Has a write at the limit of a file's size (`ulimit -f`) fail as any other, where SIGXFSZ would
    /// end the process: who only keeps records goes on.
    pub fn outlive_file_limit() {
        // Refused for lack of memory alone.
        let _ = signal_hook::flag::register(SIGXFSZ, Arc::default());
    }

    /// Handles these signals on a thread of its own.
    pub fn listen_for(signals: &[i32]) {
        // Refused for lack of descriptors or threads alone, which no user could mend here.
        let Ok(mut signals) = Signals::new(signals) else { return };
        let _ = std::thread::Builder::new().name("signals".to_owned()).spawn(move || {
            signals
                .forever()
                .for_each(|signal| super::handle_signal(matches!(signal, SIGINT | SIGQUIT)));
        });
    }
}

#[cfg(not(unix))]
mod system {
    /// No such signal.
    pub fn outlive_file_limit() {}

    pub const ENDING: &[i32] = &[0];
    pub const SUSPENDING: &[i32] = &[];

    /// Handles Ctrl-C, Ctrl-Break, a closing console, log-off and shutdown.
    pub fn listen_for(signals: &[i32]) {
        if !signals.is_empty() {
            polepair_link::console::handle_console_events(|event| {
                super::handle_signal(!event.ends_process());
                true
            });
        }
    }
}
