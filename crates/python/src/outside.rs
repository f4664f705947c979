//! What is let go while other Python threads can go on.

use std::ops::Deref;

use pyo3::prelude::*;

/// A value whose end may wait for a thread that itself waits for the interpreter: the last handle of
/// a connection ends its keeper, and that one may just be telling an event loop something.
#[derive(Debug)]
pub struct Outside<T: Send>(Option<T>);

impl<T: Send> From<T> for Outside<T> {
    fn from(value: T) -> Self {
        Self(Some(value))
    }
}

impl<T: Send> Deref for Outside<T> {
    type Target = T;

    fn deref(&self) -> &T {
        // It is there until it is dropped.
        self.0.as_ref().expect("only dropping takes it")
    }
}

impl<T: Send> Drop for Outside<T> {
    fn drop(&mut self) {
        let value = self.0.take();
        Python::attach(|py| py.detach(|| drop(value)));
    }
}
