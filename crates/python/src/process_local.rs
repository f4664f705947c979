//! Objects that are dropped without the GIL, and only in the process that created them.

use std::mem;
use std::ops::Deref;
use std::sync::atomic::{AtomicU64, Ordering};

use pyo3::prelude::*;

use crate::errors::usage_error;

/// Number of forks of this process and its ancestors since this module was imported.
static FORKS: AtomicU64 = AtomicU64::new(0);

/// A value whose end may wait for a thread that itself waits for the interpreter: the last handle of
/// a connection ends its background thread, and that thread may just be telling an event loop something.
///
/// A fork's child has none of its parent's threads, and their locks stay locked. There the
/// value is neither used nor dropped.
#[derive(Debug)]
pub struct ProcessLocal<T: Send> {
    value: Option<T>,
    forks: u64,
}

/// Records in the child of a fork that it is one.
#[pyfunction]
pub fn forked() {
    FORKS.fetch_add(1, Ordering::Relaxed);
    crate::guard::forked();
}

impl<T: Send> ProcessLocal<T> {
    fn is_own_process(&self) -> bool {
        self.forks == FORKS.load(Ordering::Relaxed)
    }

    /// The value, unless another process made it.
    pub fn in_own_process(&self, py: Python<'_>) -> PyResult<&T> {
        if self.is_own_process() {
            return Ok(self);
        }
        let what = "the process was forked after this link was opened";
        Err(usage_error(
            py,
            "E224",
            what,
            "open a link of its own in the child, or start it by spawning",
        ))
    }
}

impl<T: Send> From<T> for ProcessLocal<T> {
    fn from(value: T) -> Self {
        Self { value: Some(value), forks: FORKS.load(Ordering::Relaxed) }
    }
}

impl<T: Send> Deref for ProcessLocal<T> {
    type Target = T;

    fn deref(&self) -> &T {
        // It is there until it is dropped.
        self.value.as_ref().expect("only dropping takes it")
    }
}

impl<T: Send> Drop for ProcessLocal<T> {
    fn drop(&mut self) {
        let value = self.value.take();
        if self.is_own_process() {
            Python::attach(|py| py.detach(|| drop(value)));
        } else {
            mem::forget(value);
        }
    }
}
