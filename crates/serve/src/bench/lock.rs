//! Locks of the bench.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex, also after a panic of another thread that held it.
pub(super) fn lock_unpoisoned<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A thread that panicked must not keep stops from being sent. What it left is complete: locks are held
    // for single steps.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
