//! Taps of links of any medium.

use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::time::Instant;
use polepair_link::{Tap, TapDirection};

/// Taps of any link: runs of bytes on serial lines, frames on CAN.
pub trait AnyTap: Tap<Stream> + Tap<Can> {}

impl<T: Tap<Stream> + Tap<Can>> AnyTap for T {}

#[derive(Clone)]
pub(crate) struct SharedTap(Arc<Mutex<dyn AnyTap>>);

impl SharedTap {
    pub(crate) fn new(tap: impl AnyTap + 'static) -> Self {
        Self(Arc::new(Mutex::new(tap)))
    }
}

impl Tap<Stream> for SharedTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, unit: &[u8]) {
        let mut tap = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Tap::<Stream>::record_unit(&mut *tap, at, direction, unit);
    }
}

impl Tap<Can> for SharedTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, unit: &Frame) {
        let mut tap = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Tap::<Can>::record_unit(&mut *tap, at, direction, unit);
    }
}
