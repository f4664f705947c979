//! Stops armed axes if the process ends without ending their blocks: by a signal without a handler, or by
//! an interpreter with daemon threads.

use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair::axis::{STOP_RETRY_MAX, StopNotice, StopOptions, StopResult, stop_axes};
use polepair::{Error, LocalAxis, LocalLink};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use pyo3::prelude::*;

use crate::errors::to_py_error;

/// Armed axes, in the order of the arming.
static ARMED: Mutex<Vec<LocalAxis>> = Mutex::new(Vec::new());

fn lock_armed() -> MutexGuard<'static, Vec<LocalAxis>> {
    ARMED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Lock of a shutdown: a second one waits for the first.
fn lock_shutdown() -> MutexGuard<'static, ()> {
    static SHUTDOWN: Mutex<()> = Mutex::new(());
    SHUTDOWN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn is_same_axis(one: &LocalAxis, other: &LocalAxis) -> bool {
    one.number() == other.number() && one.connection().is_same(other.connection())
}

/// Has an axis stopped when the process ends while it is armed.
pub fn register_armed(py: Python<'_>, axis: &LocalAxis) {
    lock_armed().push(axis.clone());
    system::install_handlers(py);
}

/// Leaves an axis alone that its block has stopped.
pub fn unregister_armed(axis: &LocalAxis) {
    let mut armed = lock_armed();
    let at = armed.iter().position(|one| is_same_axis(one, axis));
    let left = at.map(|at| armed.swap_remove(at));
    system::set_idle(armed.is_empty());
    drop(armed);
    drop(left);
}

/// Forgets in a fork's child the axes that its parent has armed (PY-5).
pub fn forked() {
    // The thread that held the lock does not exist in the child.
    if let Ok(mut armed) = ARMED.try_lock() {
        std::mem::forget(std::mem::take(&mut *armed));
    }
    system::forked();
}

/// Stops, disables and disarms all armed axes, and prints those that may turn on stderr. If a signal handler already
/// does that, and ends the process, this waits for it.
#[pyfunction]
pub fn stop_armed(py: Python<'_>) {
    py.detach(|| {
        let _one = lock_shutdown();
        stop_all_armed();
    });
}

/// Stops, disables and disarms the armed axes of a link that is about to be closed.
///
/// # Errors
/// The first, after every axis was tried.
pub fn stop_link(link: &LocalLink) -> Result<(), polepair::Error> {
    let axes: Vec<LocalAxis> =
        lock_armed().iter().filter(|axis| is_axis_of_link(axis, link)).cloned().collect();
    let ended = stop_and_disable(&axes).into_iter().try_for_each(StopResult::into_result);
    // A signal that comes meanwhile finds them, and waits for its own stops of them.
    axes.iter().for_each(unregister_armed);
    ended
}

fn is_axis_of_link(axis: &LocalAxis, link: &LocalLink) -> bool {
    link.axes().iter().any(|one| one.connection().is_same(axis.connection()))
}

/// Stops axes, and repeats the stop of those that did not confirm it. Returns the first error, after all were tried. A
/// first Ctrl-C meanwhile asks for a stop that is running already: it is raised after that. A second one ends it.
#[pyfunction]
#[pyo3(name = "stop_axes")]
pub fn stop_each(py: Python<'_>, axes: Vec<Py<crate::axis::PyAxis>>) -> PyResult<()> {
    let axes = axes.iter().map(|axis| {
        let local = axis.get().inner(py)?.require_local("stops of this program", "");
        local.cloned().map_err(|error| to_py_error(py, &error))
    });
    let axes: Vec<LocalAxis> = axes.collect::<PyResult<_>>()?;
    let mut interrupts = Vec::new();
    let options = StopOptions::default();
    let ended = py.detach(|| {
        stop_axes(&axes, options, STOP_RETRY_MAX, |_: &LocalAxis, _: &StopNotice| {
            interrupts.extend(Python::attach(|py| py.check_signals().err()));
            interrupts.len() < 2
        })
    });
    let ended: Result<(), Error> = ended.into_iter().try_for_each(StopResult::into_result);
    match (interrupts.into_iter().next(), ended) {
        (Some(interrupt), Err(error)) => {
            let note = format!("And an axis was not stopped: {error}");
            // As `not_stopped` of the package does.
            interrupt.value(py).setattr("__notes__", vec![note])?;
            Err(interrupt)
        }
        (Some(interrupt), Ok(())) => Err(interrupt),
        (None, ended) => ended.map_err(|error| to_py_error(py, &error)),
    }
}

/// Stops axes, and takes their power off.
fn stop_and_disable(axes: &[LocalAxis]) -> Vec<StopResult> {
    // Motion commands of other threads are refused from here on.
    axes.iter().for_each(|axis| axis.arm(false));
    let options = StopOptions { power_off: true, ..StopOptions::default() };
    stop_axes(axes, options, STOP_RETRY_MAX, |_, _| true)
}

fn stop_all_armed() {
    // The end of a block, or of a link, does the same meanwhile: each repeats its stop until standstill.
    let axes = lock_armed().clone();
    let started: Vec<_> = axes.iter().map(|axis| axis.connection().now()).collect();
    for ((axis, started_at), ended) in axes.iter().zip(started).zip(stop_and_disable(&axes)) {
        match (ended.to_motion_end(), ended.power_off) {
            (Ok(()), None | Some(Ok(()))) => {}
            // Its block stopped it, took the power and closed the link before this could.
            _ if has_no_power(axis, started_at) => {}
            (Err(error), _) => print_error(&format!("{error}. It may still turn: cut its supply.")),
            (Ok(()), Some(Err(error))) => {
                print_error(&format!("{error}. It may still be powered."));
            }
        }
    }
    axes.iter().for_each(unregister_armed);
    // Dropping the last handle of a connection waits for its background thread, which is not needed now.
    std::mem::forget(axes);
}

/// Returns whether an axis has reported since then that its motor has no power.
fn has_no_power(axis: &LocalAxis, since: Instant) -> bool {
    let enabled = axis.state().reading(Signal::Enabled);
    enabled.at.is_some_and(|at| at >= since) && enabled.raw == 0
}

fn print_error(what: &str) {
    use std::io::Write as _;
    // A terminal that is gone must not keep the next axis turning.
    let _ = writeln!(std::io::stderr(), "polepair: {what}");
}

#[cfg(unix)]
mod system {
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
    use std::sync::{Arc, LazyLock};

    use pyo3::prelude::*;
    use signal_hook::consts::signal::{
        SIGABRT, SIGALRM, SIGHUP, SIGINT, SIGIO, SIGPROF, SIGQUIT, SIGSYS, SIGTERM, SIGTRAP,
        SIGTSTP, SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU,
    };
    use signal_hook::iterator::Signals;

    /// Signals that end, or suspend, a process without a handler.
    const ENDING_SIGNALS: [i32; 15] = [
        SIGTERM, SIGHUP, SIGQUIT, SIGINT, SIGALRM, SIGUSR1, SIGUSR2, SIGVTALRM, SIGPROF, SIGXCPU,
        SIGABRT, SIGIO, SIGSYS, SIGTRAP, SIGTSTP,
    ];

    /// Nothing is armed: signals have their usual effect.
    static IDLE: LazyLock<Arc<AtomicBool>> = LazyLock::new(|| Arc::new(AtomicBool::new(true)));
    /// Process whose thread receives signals.
    static HANDLER_PROCESS: AtomicU32 = AtomicU32::new(0);

    pub fn set_idle(idle: bool) {
        IDLE.store(idle, Ordering::SeqCst);
    }

    pub fn forked() {
        set_idle(true);
    }

    /// Handles from now on, on a thread of its own, the signals that the program left at their defaults.
    pub fn install_handlers(py: Python<'_>) {
        set_idle(false);
        let process = std::process::id();
        let before = HANDLER_PROCESS.swap(process, Ordering::SeqCst);
        if before == process {
            return;
        }
        // A fork's child has the handlers of its parent, which are ours.
        let caught = if before == 0 { caught_signals() } else { 0 };
        let unheard: Vec<i32> = ENDING_SIGNALS
            .into_iter()
            .filter(|signal| {
                caught >> (signal - 1) & 1 == 0 && is_default(py, *signal).unwrap_or(false)
            })
            .collect();
        // Its handler comes before the one below, which lets signals pass while something is armed: one
        // that arrived between the two would be lost.
        let Ok(mut signals) = Signals::new(&unheard) else { return };
        for signal in &unheard {
            // If nothing is armed, this ends the process at once.
            let _ = signal_hook::flag::register_conditional_default(*signal, Arc::clone(&IDLE));
        }
        let on_event = move || {
            for signal in &mut signals {
                let _one = super::lock_shutdown();
                // With nothing armed the process was suspended at once, and goes on here. Every other
                // signal ends it, even if the armed block has ended since.
                if signal == SIGTSTP && IDLE.load(Ordering::SeqCst) {
                    continue;
                }
                super::stop_all_armed();
                let _ = signal_hook::low_level::emulate_default_handler(signal);
            }
        };
        let _ = std::thread::Builder::new().name("polepair-signals".to_owned()).spawn(on_event);
    }

    /// The signals that a library of the process catches, the first in bit 0, where the system reports them.
    fn caught_signals() -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
    }

    /// Returns whether a signal has its default action, as far as the interpreter knows.
    fn is_default(py: Python<'_>, signal: i32) -> PyResult<bool> {
        let known = py.import("_signal")?;
        known.call_method1("getsignal", (signal,))?.eq(known.getattr("SIG_DFL")?)
    }
}

#[cfg(windows)]
mod system {
    use std::sync::atomic::{AtomicBool, Ordering};

    use polepair_link::console::{ConsoleEvent, handle_console_events};
    use pyo3::prelude::*;

    /// Nothing is armed: events have their usual effect.
    static IDLE: AtomicBool = AtomicBool::new(true);
    /// The program has a handler of its own for Ctrl-Break.
    static BREAK_IS_HANDLED: AtomicBool = AtomicBool::new(false);

    pub fn set_idle(idle: bool) {
        IDLE.store(idle, Ordering::SeqCst);
    }

    pub fn forked() {}

    /// Stops the armed axes when the console ends the process: by Ctrl-Break, a closed window, log-off or
    /// shutdown. Ctrl-C is the interpreter's: `KeyboardInterrupt` ends the blocks, which stop their axes.
    pub fn install_handlers(py: Python<'_>) {
        set_idle(false);
        BREAK_IS_HANDLED.store(has_break_handler(py).unwrap_or(false), Ordering::SeqCst);
        handle_console_events(|event| {
            let is_left_alone = match event {
                ConsoleEvent::Interrupt => true,
                ConsoleEvent::Break => BREAK_IS_HANDLED.load(Ordering::SeqCst),
                ConsoleEvent::Close | ConsoleEvent::LogOff => false,
            };
            if !is_left_alone && !IDLE.load(Ordering::SeqCst) {
                let _one = super::lock_shutdown();
                super::stop_all_armed();
            }
            // The system ends the process.
            false
        });
    }

    fn has_break_handler(py: Python<'_>) -> PyResult<bool> {
        let known = py.import("_signal")?;
        let handler = known.call_method1("getsignal", (known.getattr("SIGBREAK")?,))?;
        Ok(!handler.eq(known.getattr("SIG_DFL")?)?)
    }
}

#[cfg(not(any(unix, windows)))]
mod system {
    use pyo3::prelude::*;

    pub fn set_idle(_idle: bool) {}

    pub fn forked() {}

    pub fn install_handlers(_py: Python<'_>) {}
}
