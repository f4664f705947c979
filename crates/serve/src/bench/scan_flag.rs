//! True if a scan runs on a wire.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::message::GatewayError;

/// True during a scan of a wire, which a stop there ends.
#[derive(Default)]
pub(super) struct ScanFlag {
    active: AtomicBool,
    cancelled: AtomicBool,
}

impl ScanFlag {
    /// From now on: no axis of the wire is given to anybody until the end.
    pub fn begin(&self) {
        self.cancelled.store(false, Ordering::SeqCst);
        self.active.store(true, Ordering::SeqCst);
    }

    pub fn end(&self) {
        self.active.store(false, Ordering::SeqCst);
    }

    pub fn is_active(&self) -> bool {
        self.active.load(Ordering::SeqCst)
    }

    /// Ends it as soon as the last query is answered, or its time is over.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::SeqCst);
    }

    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::SeqCst)
    }
}

/// The error of a scan that cannot run, or that runs already.
pub(super) fn scan_error(what: impl Into<String>) -> GatewayError {
    GatewayError::new("gateway.look", what)
}
