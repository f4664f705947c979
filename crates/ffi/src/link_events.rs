//! The event queue of a link, and the thread of its handler.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use polepair::events::Events;

/// Received events of a link.
#[derive(Debug)]
pub struct LinkEvents {
    pub(crate) events: Arc<Events>,
    pub(crate) handler: Option<CallbackThread>,
}

/// Thread that calls the program's handler.
#[derive(Debug)]
pub(crate) struct CallbackThread {
    pub(crate) ended: Arc<AtomicBool>,
    pub(crate) thread: Option<JoinHandle<()>>,
}

impl Drop for LinkEvents {
    fn drop(&mut self) {
        let Some(handler) = &mut self.handler else { return };
        handler.ended.store(true, Ordering::SeqCst);
        self.events.interrupt();
        if let Some(thread) = handler.thread.take() {
            // A handler that closes its own link would wait for itself.
            if thread.thread().id() != std::thread::current().id() {
                let _ = thread.join();
            }
        }
    }
}
