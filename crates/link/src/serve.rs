//! A simulated drive on a real wire, in real time.

use std::borrow::{Borrow, BorrowMut};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use polepair_core::medium::{Medium, Stream};
use polepair_core::station::{LineEvent, Station};
use polepair_core::time::Instant;

use crate::error::LinkError;
use crate::link::{LinkIo, Received};
use crate::waker::LinkWaker;

/// Units sent for one thing that arrived; a station that has more goes on after the next read.
const BURST_MAX: usize = 256;
/// Least pause between two expiries, lest a station that always wants time eats a core.
const TICK_MIN_NS: u64 = 20_000;

/// Access to the station on the wire. An owner that shares it (a dashboard, the front panel of a drive)
/// locks in `lend`.
pub trait StationAccess<M: Medium = Stream>: Send {
    /// Calls `visit` with the station, once.
    fn with_station(&mut self, visit: &mut dyn FnMut(&mut dyn Station<M>));
}

/// A station of one's own.
impl<M: Medium, S: Station<M> + Send> StationAccess<M> for Box<S> {
    fn with_station(&mut self, visit: &mut dyn FnMut(&mut dyn Station<M>)) {
        visit(&mut **self);
    }
}

/// A station shared with others.
impl<M: Medium, S: Station<M> + Send> StationAccess<M> for Arc<Mutex<S>> {
    fn with_station(&mut self, visit: &mut dyn FnMut(&mut dyn Station<M>)) {
        visit(&mut *self.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// Ends [`serve`] from elsewhere.
#[derive(Clone, Debug)]
pub struct ServeHandle {
    stopped: Arc<AtomicBool>,
    waker: LinkWaker,
}

impl ServeHandle {
    /// For a server of this link.
    #[must_use]
    pub fn for_link<M: Medium>(link: &dyn LinkIo<M>) -> Self {
        Self { stopped: Arc::default(), waker: link.waker() }
    }

    /// Makes [`serve`] return.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Release);
        self.waker.wake();
    }

    /// Makes [`serve`] poll its station again after a change from outside.
    pub fn wake(&self) {
        self.waker.wake();
    }

    fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }
}

/// A drive that is served on a thread of its own. Dropped, it is stopped.
#[derive(Debug)]
pub struct ServeThread {
    handle: ServeHandle,
    thread: Option<JoinHandle<Result<(), LinkError>>>,
}

impl ServeThread {
    /// Begins to serve `wire` on `link`.
    pub fn new<M: Medium>(
        link: Box<dyn LinkIo<M>>,
        mut wire: impl StationAccess<M> + 'static,
    ) -> Self {
        let handle = ServeHandle::for_link(&*link);
        let ended = handle.clone();
        let thread = std::thread::spawn(move || serve(&*link, &mut wire, &ended));
        Self { handle, thread: Some(thread) }
    }

    /// A handle that ends it, or makes it poll its station.
    #[must_use]
    pub fn handle(&self) -> ServeHandle {
        self.handle.clone()
    }

    /// True once it has ended; [`join`](Self::join) then returns the reason at once.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Waits until it ends.
    ///
    /// # Errors
    /// [`LinkError`] that ended it.
    ///
    /// # Panics
    /// When the station did.
    pub fn join(mut self) -> Result<(), LinkError> {
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(ended)) => ended,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(()),
        }
    }
}

impl Drop for ServeThread {
    fn drop(&mut self) {
        self.handle.stop();
        if let Some(thread) = self.thread.take() {
            // A station that panicked has printed so on stderr.
            let _ = thread.join();
        }
    }
}

/// Pumps a drive until it is stopped or the link is lost: units in, units out, time when it is due.
///
/// # Errors
/// [`LinkError`] that ended it; a far end that takes nothing does not.
pub fn serve<M: Medium>(
    link: &dyn LinkIo<M>,
    wire: &mut dyn StationAccess<M>,
    stop: &ServeHandle,
) -> Result<(), LinkError> {
    let mut buffer = M::buffer();
    wire.with_station(&mut |station| station.handle_line(link.now(), LineEvent::Up));
    while !stop.is_stopped() {
        let until = run_station(link, wire)?;
        let received = link.receive(buffer.borrow_mut(), until)?;
        wire.with_station(&mut |station| match received {
            Received::Bytes { len, at } => {
                station.handle_input(at, M::unit(buffer.borrow(), len));
            }
            Received::Line { event, at } => station.handle_line(at, event),
            Received::TimedOut | Received::Woken => {}
        });
    }
    Ok(())
}

/// Advances the time, sends the station's output, and returns the time of the next call.
fn run_station<M: Medium>(
    link: &dyn LinkIo<M>,
    wire: &mut dyn StationAccess<M>,
) -> Result<Instant, LinkError> {
    let mut until = Instant::FAR_FUTURE;
    let mut result = Ok(());
    wire.with_station(&mut |station| {
        let now = link.now();
        if station.poll_timeout().is_some_and(|due| due <= now) {
            station.handle_timeout(now);
        }
        let sent = transmit(link, station, now);
        let due = station.poll_timeout().unwrap_or(Instant::FAR_FUTURE);
        // A station with more to send goes on at once.
        let due = if matches!(sent, Ok(false)) { now } else { due };
        until = due.max(now.plus_ns(TICK_MIN_NS));
        result = sent.map(|_| ());
    });
    result.map(|()| until)
}

/// Sends the station's output; false if there may be more.
fn transmit<M: Medium>(
    link: &dyn LinkIo<M>,
    station: &mut dyn Station<M>,
    now: Instant,
) -> Result<bool, LinkError> {
    let mut out = M::buffer();
    for _ in 0..BURST_MAX {
        let Some(len) = station.poll_transmit(now, out.borrow_mut()) else {
            return Ok(true);
        };
        match link.send(M::unit(out.borrow(), len)) {
            // Without a reader these bytes are lost, as on a real line.
            Err(error) if !error.is_gone() => break,
            sent => sent?,
        }
    }
    Ok(false)
}
