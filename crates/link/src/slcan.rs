//! Serial CAN adapters that speak Lawicel's ASCII language (CANUSB, CANable, USBtin and many
//! others), on serial ports, pseudo-terminals and TCP.

use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair_core::medium::{Can, CanLine, Frame, SerialLine, Stream};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use crate::error::{Cause, LinkError};
use crate::inbox::Inbox;
use crate::link::{Link, Losses, Received};
use crate::tcp::TcpLink;
use crate::wake::Waker;

#[cfg(unix)]
mod adapter;
pub mod codec;
#[cfg(test)]
mod tests;

#[cfg(unix)]
pub use adapter::{Adapter, listen, on_pty};
use codec::{Answer, End, Flags, LINE_MAX, Lines, State};

/// How long an adapter may take to answer a command; some never do.
const ANSWER_MS: u32 = 150;
/// How long an adapter that was closed has to be quiet before its answers are taken for ours, and how
/// long that is waited for: an earlier program's may still be on their way.
const QUIET_MS: u32 = 20;
const QUIET_MAX_MS: u32 = 300;
/// How often, while frames are sent, the adapter is asked for its status flags.
const FLAGS_EVERY_NS: u64 = 1_000_000_000;
/// Such questions without an answer before it is asked no more.
const FLAGS_OWED_MAX: u8 = 2;
/// Baud rate of adapters with a real serial line; those on USB take any.
pub const BAUD: u32 = 115_200;

/// A CAN bus behind a serial adapter, from the computer's end.
pub struct SlcanLink {
    inner: Box<dyn Link<Stream>>,
    line: Mutex<CanLine>,
    unread: Mutex<Unread>,
    /// The link is lost: nobody is left to be told that we go.
    lost: AtomicBool,
    malformed: AtomicU64,
    errors: AtomicU64,
    overrun: AtomicU64,
    refused: AtomicU64,
    /// When the flags are asked for next, ns, and how many such questions were not answered.
    ask_at: AtomicU64,
    flags_owed: AtomicU8,
}

/// What came and was not yet looked at.
struct Unread {
    inbox: Inbox,
    lines: Lines,
    bus_off: bool,
}

/// Opens the adapter on a serial port or pseudo-terminal. `baud` is that of the port, [`BAUD`]
/// unless the adapter needs another; `line` that of the bus, 0 to leave the adapter's.
///
/// # Errors
/// As [`serial::open`](crate::serial::open) and [`SlcanLink::open`].
pub fn open_serial(path: &str, baud: u32, line: CanLine) -> Result<SlcanLink, LinkError> {
    SlcanLink::open(Box::new(crate::serial::open(path, SerialLine::n81(baud))?), line)
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
    pub fn open(inner: Box<dyn Link<Stream>>, line: CanLine) -> Result<Self, LinkError> {
        let link = Self {
            line: line.into(),
            unread: Mutex::new(Unread {
                inbox: Inbox::default(),
                lines: Lines::default(),
                bus_off: false,
            }),
            inner,
            lost: AtomicBool::new(false),
            malformed: AtomicU64::new(0),
            errors: AtomicU64::new(0),
            overrun: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            ask_at: AtomicU64::new(0),
            flags_owed: AtomicU8::new(0),
        };
        link.begin(line)?;
        Ok(link)
    }

    /// Closes the channel if an earlier program left it open, sets the bit rate and opens it.
    fn begin(&self, line: CanLine) -> Result<(), LinkError> {
        let name = self.inner.describe();
        let mut text = [0; LINE_MAX];
        let rate = rate_command(line, &name, &mut text)?;
        // Twice: the first refusal may be a late answer to what was asked before.
        let mut refused = self.set_up(rate, QUIET_MS)?;
        if refused.is_some() {
            refused = self.set_up(rate, ANSWER_MS)?;
        }
        match refused {
            None => Ok(()),
            Some(Step::BitRate) => {
                let rate = line.bit_rate;
                let hint = format!("The adapter refuses {rate} bit/s; choose one that it can do.");
                Err(LinkError::new(&name, Cause::Unsuitable).hinting(&hint))
            }
            Some(Step::Open) => {
                let hint = "The adapter does not go on the bus: switch it off and on, and check \
                            that it speaks slcan (Lawicel's ASCII commands).";
                Err(LinkError::new(&name, Cause::Refused).hinting(hint))
            }
        }
    }

    /// Tells what the adapter refused.
    fn set_up(&self, rate: Option<&[u8]>, quiet_ms: u32) -> Result<Option<Step>, LinkError> {
        // An adapter may refuse to close what is not open.
        self.command(b"\rC\r")?;
        self.quiet(quiet_ms)?;
        if let Some(rate) = rate
            && self.command(rate)? == Some(false)
        {
            return Ok(Some(Step::BitRate));
        }
        Ok((self.command(b"O\r")? == Some(false)).then_some(Step::Open))
    }

    /// Reads on until nothing comes any more: answers to what was said before are nobody's.
    fn quiet(&self, quiet_ms: u32) -> Result<(), LinkError> {
        let end = self.inner.now().plus_ms(QUIET_MAX_MS);
        let mut unread = self.unread();
        loop {
            while unread.end().is_some() {}
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

    /// Sends a command; true when it was done, false when refused, `None` when nothing was said.
    fn command(&self, command: &[u8]) -> Result<Option<bool>, LinkError> {
        // Each carriage return is answered, by most adapters.
        let mut answers = command.iter().filter(|&&byte| byte == b'\r').count();
        self.inner.send(command)?;
        let until = self.inner.now().plus_ms(ANSWER_MS);
        let mut unread = self.unread();
        let mut done = None;
        while answers > 0 {
            match unread.end() {
                None => match unread.inbox.receive(&*self.inner, until)? {
                    Received::Bytes { .. } => continue,
                    _ => break,
                },
                Some(End::Bell) => done = Some(false),
                Some(End::Line) if unread.lines.line().is_empty() => done = Some(true),
                // Frames of before, and what a terminal server greets with.
                _ => continue,
            }
            answers -= 1;
        }
        Ok(done)
    }

    fn unread(&self) -> MutexGuard<'_, Unread> {
        self.unread.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next thing of interest among the bytes that were read.
    fn next(&self, unread: &mut Unread, frame: &mut Frame) -> Option<Received> {
        loop {
            let at = unread.inbox.at;
            let answer = match unread.end()? {
                End::Line => Answer::of(unread.lines.line()),
                End::Bell => {
                    self.refuse();
                    continue;
                }
                End::Spoilt => Answer::Unknown,
            };
            match answer {
                Answer::Frame(arrived) => {
                    *frame = arrived;
                    return Some(Received::Bytes { len: 1, at });
                }
                Answer::State(state) => {
                    if let Some(event) = unread.change(state) {
                        return Some(Received::Line { event, at });
                    }
                }
                Answer::Flags(flags) => self.note(flags),
                Answer::Trouble => drop(self.errors.fetch_add(1, Ordering::Relaxed)),
                Answer::Unknown => drop(self.malformed.fetch_add(1, Ordering::Relaxed)),
                Answer::Done | Answer::Told => {}
            }
        }
    }

    /// Behind a frame, lest two threads write at once: asks what else the controller has seen.
    /// Not all adapters know the question.
    fn ask_for_flags(&self) -> Result<(), LinkError> {
        let (now, owed) = (self.inner.now(), self.flags_owed.load(Ordering::Relaxed));
        if owed >= FLAGS_OWED_MAX || now.0 < self.ask_at.load(Ordering::Relaxed) {
            return Ok(());
        }
        self.ask_at.store(now.plus_ns(FLAGS_EVERY_NS).0, Ordering::Relaxed);
        self.flags_owed.store(owed + 1, Ordering::Relaxed);
        self.inner.send(b"F\r")
    }

    fn note(&self, flags: Flags) {
        self.flags_owed.store(0, Ordering::Relaxed);
        self.errors.fetch_add(flags.any(Flags::ERRORS).into(), Ordering::Relaxed);
        self.overrun.fetch_add(flags.any(Flags::OVERRUN).into(), Ordering::Relaxed);
    }

    /// The adapter has refused a frame, or does not know of flags.
    fn refuse(&self) {
        match self.flags_owed.load(Ordering::Relaxed) {
            1..FLAGS_OWED_MAX => self.flags_owed.store(FLAGS_OWED_MAX, Ordering::Relaxed),
            _ => drop(self.refused.fetch_add(1, Ordering::Relaxed)),
        }
    }

    fn judged<T>(&self, result: Result<T, LinkError>) -> Result<T, LinkError> {
        if result.as_ref().is_err_and(LinkError::is_gone) {
            self.lost.store(true, Ordering::Relaxed);
        }
        result
    }
}

/// What an adapter can refuse on the way to the bus.
#[derive(Clone, Copy)]
enum Step {
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
            Err(LinkError::new(name, Cause::Unsuitable).hinting(hint))
        }
    }
}

impl Unread {
    /// What the next bytes that were read end, if anything.
    fn end(&mut self) -> Option<End> {
        while let Some(byte) = self.inbox.next() {
            if let Some(end) = self.lines.push(byte) {
                return Some(end);
            }
        }
        None
    }

    /// What a controller's new state means to the bus's users, if anything.
    fn change(&mut self, state: State) -> Option<LineEvent> {
        let off = state == State::BusOff;
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
            // Otherwise the adapter goes on writing to whoever opens the port next.
            let _ = self.inner.send(b"C\r");
        }
    }
}

impl Link<Can> for SlcanLink {
    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        let mut text = [0; LINE_MAX];
        let len = codec::write_frame(frame, None, &mut text);
        self.judged(self.inner.send(&text[..len]).and_then(|()| self.ask_for_flags()))
    }

    fn ready(&self, until: Instant) -> Result<bool, LinkError> {
        self.inner.ready(until)
    }

    fn receive(&self, frame: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        let mut unread = self.unread();
        loop {
            if let Some(received) = self.next(&mut unread, frame) {
                return Ok(received);
            }
            match self.judged(unread.inbox.receive(&*self.inner, until))? {
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

    fn waker(&self) -> Waker {
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

    fn reopen(&self) -> Result<Box<dyn Link<Can>>, LinkError> {
        let line = *self.line.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Box::new(Self::open(self.inner.reopen()?, line)?))
    }
}
