//! Serial CAN adapters with Lawicel's ASCII protocol (CANUSB, CANable, USBtin and others), on serial ports,
//! pseudo-terminals and TCP.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair_core::medium::{Can, CanLine, Frame, SerialLine, Stream};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use crate::clock;
use crate::error::{Cause, LinkError};
use crate::inbox::Inbox;
use crate::link::{LinkIo, Losses, Received};
use crate::tcp::TcpLink;
use crate::waker::LinkWaker;

pub mod codec;
mod server;
#[cfg(test)]
mod tests;

use codec::{AdapterReply, ErrorState, LINE_MAX, LineEnd, LineSplitter, StatusFlags};
#[cfg(unix)]
pub use server::serve_pty;
pub use server::{SlcanSession, listen};

/// Time limit of an adapter's reply to a command; some never reply.
const ANSWER_MS: u32 = 150;
/// Silence that a closed adapter must keep before its replies are taken for ours, and the limit of that wait: replies
/// to an earlier program may still arrive.
const QUIET_MS: u32 = 20;
const QUIET_MAX_MS: u32 = 300;
/// Interval at which the adapter is asked for its status flags while frames are sent.
const FLAGS_INTERVAL_NS: u64 = 1_000_000_000;
/// Such questions without an answer before it is asked no more.
const FLAGS_PENDING_MAX: u8 = 2;
/// Baud rate of adapters with a real serial line; those on USB take any.
pub const BAUD: u32 = 115_200;

/// A CAN bus behind a serial adapter, from the computer's end.
pub struct SlcanLink {
    inner: Box<dyn LinkIo<Stream>>,
    line: Mutex<CanLine>,
    input: Mutex<SlcanInput>,
    /// True if the link is lost: no close command can reach the adapter.
    lost: AtomicBool,
    malformed: AtomicU64,
    errors: AtomicU64,
    overrun: AtomicU64,
    refused: AtomicU64,
    /// When the flags are asked for next, ns, and how many such questions were not answered.
    next_flags_query: AtomicU64,
    flags_pending: AtomicU8,
}

/// Received bytes that were not processed yet.
struct SlcanInput {
    inbox: Inbox,
    lines: LineSplitter,
    bus_off: bool,
}

/// Opens the adapter on a serial port or pseudo-terminal. `baud` is that of the port, [`BAUD`]
/// unless the adapter needs another; `line` that of the bus, 0 to leave the adapter's.
///
/// # Errors
/// As [`serial::open`](crate::serial::open) and [`SlcanLink::open`].
pub fn open_serial(path: &str, baud: u32, line: CanLine) -> Result<SlcanLink, LinkError> {
    SlcanLink::open(Box::new(crate::serial::open(path, SerialLine::new_8n1(baud))?), line)
}

/// Opens the adapter behind `address` (`10.0.0.5:4001`).
///
/// # Errors
/// As [`TcpLink::connect`] and [`SlcanLink::open`].
pub fn open_tcp(address: &str, line: CanLine) -> Result<SlcanLink, LinkError> {
    SlcanLink::open(Box::new(TcpLink::connect(address)?), line)
}

impl SlcanLink {
    /// Sets up the adapter behind `inner` and goes on the bus.
    ///
    /// # Errors
    /// [`Cause::Unsuitable`] when the adapter cannot do the bit rate, [`Cause::Refused`] when it
    /// does not open the bus, else as `inner`.
    pub fn open(inner: Box<dyn LinkIo<Stream>>, line: CanLine) -> Result<Self, LinkError> {
        let link = Self {
            line: line.into(),
            input: Mutex::new(SlcanInput {
                inbox: Inbox::default(),
                lines: LineSplitter::default(),
                bus_off: false,
            }),
            inner,
            lost: AtomicBool::new(false),
            malformed: AtomicU64::new(0),
            errors: AtomicU64::new(0),
            overrun: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            next_flags_query: AtomicU64::new(0),
            flags_pending: AtomicU8::new(0),
        };
        link.set_up_channel(line)?;
        Ok(link)
    }

    /// Closes the channel if an earlier program left it open, sets the bit rate and opens it.
    fn set_up_channel(&self, line: CanLine) -> Result<(), LinkError> {
        let name = self.inner.describe();
        let mut text = [0; LINE_MAX];
        let rate = rate_command(line, &name, &mut text)?;
        // Twice: the first refusal may be a late answer to what was asked before.
        let mut refused = self.try_set_up(rate, QUIET_MS)?;
        if refused.is_some() {
            refused = self.try_set_up(rate, clock::scaled_ms(ANSWER_MS))?;
        }
        match refused {
            None => Ok(()),
            Some(SetupStep::BitRate) => {
                let rate = line.bit_rate;
                let hint = format!("The adapter refuses {rate} bit/s; choose one that it can do.");
                Err(LinkError::new(&name, Cause::Unsuitable).with_hint(&hint))
            }
            Some(SetupStep::Open) => {
                let hint = "The adapter does not connect to the bus: switch it off and on, and check that \
                            it has slcan (Lawicel's ASCII commands).";
                Err(LinkError::new(&name, Cause::Refused).with_hint(hint))
            }
        }
    }

    /// Sets up the adapter; returns the command that it refused, if any.
    fn try_set_up(
        &self,
        rate: Option<&[u8]>,
        quiet_ms: u32,
    ) -> Result<Option<SetupStep>, LinkError> {
        // An adapter may refuse to close what is not open.
        self.run_command(b"\rC\r")?;
        self.read_until_quiet(quiet_ms)?;
        if let Some(rate) = rate
            && self.run_command(rate)? == Some(false)
        {
            return Ok(Some(SetupStep::BitRate));
        }
        Ok((self.run_command(b"O\r")? == Some(false)).then_some(SetupStep::Open))
    }

    /// Reads until the line is quiet, to discard replies to earlier commands.
    fn read_until_quiet(&self, quiet_ms: u32) -> Result<(), LinkError> {
        let end = self.inner.now().plus_ms(QUIET_MAX_MS);
        let mut unread = self.lock_input();
        loop {
            while unread.next_end().is_some() {}
            let now = self.inner.now();
            if now >= end {
                return Ok(());
            }
            let until = now.plus_ms(quiet_ms);
            if !matches!(unread.inbox.receive(&*self.inner, until)?, Received::Bytes { .. }) {
                return Ok(());
            }
        }
    }

    /// Sends a command; true when done, false when refused, `None` without a reply.
    fn run_command(&self, command: &[u8]) -> Result<Option<bool>, LinkError> {
        // Each carriage return is answered, by most adapters.
        let mut answers = command.iter().filter(|&&byte| byte == b'\r').count();
        self.inner.send(command)?;
        let until = self.inner.now().plus_ms(clock::scaled_ms(ANSWER_MS));
        let mut unread = self.lock_input();
        let mut done = None;
        while answers > 0 {
            match unread.next_end() {
                None => match unread.inbox.receive(&*self.inner, until)? {
                    Received::Bytes { .. } => continue,
                    _ => break,
                },
                Some(LineEnd::Bell) => done = Some(false),
                Some(LineEnd::Line) if unread.lines.line().is_empty() => done = Some(true),
                // Frames of before, and what a terminal server greets with.
                _ => continue,
            }
            answers -= 1;
        }
        Ok(done)
    }

    fn lock_input(&self) -> MutexGuard<'_, SlcanInput> {
        self.input.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next thing of interest among the bytes that were read.
    fn next_received(&self, unread: &mut SlcanInput, frame: &mut Frame) -> Option<Received> {
        loop {
            let at = unread.inbox.received_at;
            let answer = match unread.next_end()? {
                LineEnd::Line => AdapterReply::parse(unread.lines.line()),
                LineEnd::Bell => {
                    self.handle_refusal();
                    continue;
                }
                LineEnd::Malformed => AdapterReply::Unknown,
            };
            match answer {
                AdapterReply::Frame(arrived) => {
                    *frame = arrived;
                    return Some(Received::Bytes { len: 1, at });
                }
                AdapterReply::State(state) => {
                    if let Some(event) = unread.state_event(state) {
                        return Some(Received::Line { event, at });
                    }
                }
                AdapterReply::Flags(flags) => self.count_flags(flags),
                AdapterReply::BusError => drop(self.errors.fetch_add(1, Ordering::Relaxed)),
                AdapterReply::Unknown => drop(self.malformed.fetch_add(1, Ordering::Relaxed)),
                AdapterReply::Done | AdapterReply::Info => {}
            }
        }
    }

    /// Asks for the controller's status flags after a frame, so that two threads do not write at once.
    /// Not all adapters have the command.
    fn request_flags(&self) -> Result<(), LinkError> {
        let (now, outstanding) = (self.inner.now(), self.flags_pending.load(Ordering::Relaxed));
        if outstanding >= FLAGS_PENDING_MAX || now.0 < self.next_flags_query.load(Ordering::Relaxed)
        {
            return Ok(());
        }
        self.next_flags_query.store(now.plus_ns(FLAGS_INTERVAL_NS).0, Ordering::Relaxed);
        self.flags_pending.store(outstanding + 1, Ordering::Relaxed);
        self.inner.send(b"F\r")
    }

    fn count_flags(&self, flags: StatusFlags) {
        self.flags_pending.store(0, Ordering::Relaxed);
        self.errors.fetch_add(flags.any(StatusFlags::ERRORS).into(), Ordering::Relaxed);
        self.overrun.fetch_add(flags.any(StatusFlags::OVERRUN).into(), Ordering::Relaxed);
    }

    /// Handles a refusal: the adapter refused a frame, or does not have the command for flags.
    fn handle_refusal(&self) {
        match self.flags_pending.load(Ordering::Relaxed) {
            1..FLAGS_PENDING_MAX => self.flags_pending.store(FLAGS_PENDING_MAX, Ordering::Relaxed),
            _ => drop(self.refused.fetch_add(1, Ordering::Relaxed)),
        }
    }

    fn track_loss<T>(&self, result: Result<T, LinkError>) -> Result<T, LinkError> {
        if result.as_ref().is_err_and(LinkError::is_gone) {
            self.lost.store(true, Ordering::Relaxed);
        }
        result
    }
}

/// Step of the set-up that an adapter can refuse.
#[derive(Clone, Copy)]
enum SetupStep {
    BitRate,
    Open,
}

/// The command for a bit rate; `None` to leave the adapter's.
fn rate_command<'a>(
    line: CanLine,
    name: &str,
    text: &'a mut [u8; LINE_MAX],
) -> Result<Option<&'a [u8]>, LinkError> {
    if line.bit_rate == 0 {
        return Ok(None);
    }
    match codec::write_bit_rate(line.bit_rate, text) {
        Some(len) => Ok(Some(&text[..len])),
        None => {
            let hint = "Serial CAN adapters do 10, 20, 50, 100, 125, 250, 500, 800 and 1000 \
                        kbit/s, and what divides 8 MHz by 8 to 1600.";
            Err(LinkError::new(name, Cause::Unsuitable).with_hint(hint))
        }
    }
}

impl SlcanInput {
    /// The end of the next line in the received bytes, if any.
    fn next_end(&mut self) -> Option<LineEnd> {
        while let Some(byte) = self.inbox.next_byte() {
            if let Some(end) = self.lines.push(byte) {
                return Some(end);
            }
        }
        None
    }

    /// The event for users of the bus that follows from a controller's new state, if any.
    fn state_event(&mut self, state: ErrorState) -> Option<LineEvent> {
        let off = state == ErrorState::BusOff;
        let changed = std::mem::replace(&mut self.bus_off, off) != off;
        changed.then_some(if off { LineEvent::BusOff } else { LineEvent::Up })
    }
}

impl std::fmt::Debug for SlcanLink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("SlcanLink").field(&self.inner.describe()).finish()
    }
}

impl Drop for SlcanLink {
    fn drop(&mut self) {
        if !self.lost.load(Ordering::Relaxed) {
            // Otherwise the adapter goes on writing to the next program that opens the port.
            let _ = self.inner.send(b"C\r");
        }
    }
}

impl LinkIo<Can> for SlcanLink {
    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        let mut text = [0; LINE_MAX];
        let len = codec::write_frame(frame, None, &mut text);
        self.track_loss(self.inner.send(&text[..len]).and_then(|()| self.request_flags()))
    }

    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.inner.wait_writable(until)
    }

    fn receive(&self, frame: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        let mut unread = self.lock_input();
        loop {
            if let Some(received) = self.next_received(&mut unread, frame) {
                return Ok(received);
            }
            match self.track_loss(unread.inbox.receive(&*self.inner, until))? {
                Received::Bytes { .. } => {}
                other => return Ok(other),
            }
        }
    }

    fn set_line(&self, line: CanLine) -> Result<(), LinkError> {
        let mut set = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        if *set == line {
            return Ok(());
        }
        let (name, mut text) = (self.inner.describe(), [0; LINE_MAX]);
        let Some(rate) = rate_command(line, &name, &mut text)? else { return Ok(()) };
        // Another thread may be reading: a refusal is counted, not waited for.
        [b"C\r", rate, b"O\r"].iter().try_for_each(|word| self.inner.send(word))?;
        *set = line;
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.inner.waker()
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }

    fn losses(&self) -> Losses {
        Losses {
            malformed: self.malformed.load(Ordering::Relaxed),
            errors: self.errors.load(Ordering::Relaxed),
            refused: self.refused.load(Ordering::Relaxed),
            overrun: self.overrun.load(Ordering::Relaxed),
        }
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<Can>>, LinkError> {
        let line = *self.line.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Box::new(Self::open(self.inner.reopen()?, line)?))
    }
}
