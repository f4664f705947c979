//! Ctrl-C: the first one ends what waits, so that the verb can stop what it started; the second one
//! ends the process.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::problem::Exit;

static COUNT: AtomicU32 = AtomicU32::new(0);
static WAKE: Mutex<Vec<Box<dyn Fn() + Send>>> = Mutex::new(Vec::new());

/// Listens for Ctrl-C, SIGTERM and SIGHUP from now on; `wake` is called, on another thread, when one comes.
pub fn listen(wake: impl Fn() + Send + 'static) {
    let mut wakes = WAKE.lock().unwrap_or_else(PoisonError::into_inner);
    let first = wakes.is_empty();
    wakes.push(Box::new(wake));
    if first {
        // A second handler cannot be refused for a reason that the user could mend.
        let _ = ctrlc::set_handler(heard);
    }
}

/// True once Ctrl-C was pressed.
pub fn came() -> bool {
    COUNT.load(Ordering::SeqCst) > 0
}

fn heard() {
    if COUNT.fetch_add(1, Ordering::SeqCst) > 0 {
        std::process::exit(Exit::Interrupted as i32);
    }
    for wake in WAKE.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        wake();
    }
}
