//! The two ends of a wire, and their common interface.

use crate::error::Failure;
use crate::explain::Effect;
use crate::medium::Medium;
use crate::profile::Profile;
use crate::time::Instant;

/// Time-driven behaviour, once per object, whatever the number of its wires.
pub trait Timed {
    /// To be called at or after the instant that [`poll_timeout`](Self::poll_timeout) gave.
    /// Calling it early or twice does no harm.
    fn handle_timeout(&mut self, now: Instant);
    /// Time of the next call of [`handle_timeout`](Self::handle_timeout), if any.
    fn poll_timeout(&self) -> Option<Instant>;
}

/// An event of a wire, other than data.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum LineEvent {
    /// The cable, port or socket is gone.
    Down,
    /// The wire is back. The state of the other end is unknown.
    Up,
    /// A framing or parity error, or a break.
    Break,
    /// The CAN controller went bus-off. As with [`Down`](Self::Down), a host ends every request.
    BusOff,
    /// The client of a pseudo-terminal has set it to this baud rate; 0 if it never did.
    Rate(u32),
}

/// One end of one wire. It owns no socket, thread or clock.
///
/// After any `handle_*`, drain every wire of the object with
/// [`poll_transmit`](Self::poll_transmit) until it gives `None`, then sleep until
/// [`poll_timeout`](Timed::poll_timeout).
pub trait Station<M: Medium>: Timed {
    /// Takes what arrived. For a stream, `now` is when the last of these bytes arrived; how the
    /// bytes are cut into calls means nothing.
    fn handle_input(&mut self, now: Instant, unit: &M::Unit);
    /// Takes what happened to the wire.
    fn handle_line(&mut self, now: Instant, event: LineEvent);
    /// Writes the next thing to send into `out` and returns its length (1 for a frame).
    fn poll_transmit(&mut self, now: Instant, out: &mut M::Out) -> Option<usize>;
    /// The present line settings of this station.
    fn line(&self) -> M::Line;
}

/// A caller's name for a request, chosen by the caller.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Ticket(pub u32);

/// Position of an axis in its lane.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct AxisIndex(pub u8);

/// Subject of a host's event.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum EventSubject {
    /// The request submitted with this ticket. It has now ended.
    Request(Ticket),
    /// One of several drives that answer the request submitted with this ticket, by its address on
    /// the wire. The request goes on.
    GroupMember(Ticket, u32),
    /// A drive that spoke unasked, by its address on the wire.
    Unsolicited(u32),
}

/// An event from a host.
pub type HostEvent<A> = (EventSubject, Result<A, Failure>);

/// True if a request may be sent again without a reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RequestClass {
    /// A read: sending it twice is sending it once.
    Idempotent,
    /// A write of a setting: first read back whether it arrived.
    ReadBack,
    /// A start of motion, a relative move, a write to flash: never again.
    NoRetry,
    /// Ends motion: may be sent twice, overtakes everything, is allowed on a quarantined line (STOP-1).
    Stop,
}

/// Change of a drive's place on its wire, by a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LineChange {
    /// From now on this baud rate; `None` if that depends on what the drive contains.
    Baud(Option<u32>),
    /// From now on another bit rate.
    BitRate,
    /// Another address, or other groups.
    Address,
}

/// A protocol's request, as a small value.
pub trait Request: Copy + Send + 'static {
    /// Class of the request. A driver gives a write the class of the lane; other requests have a fixed class.
    fn class(&self) -> RequestClass;

    /// The effect that it may have on a drive with this profile.
    fn effect(&self, _profile: &'static Profile) -> Effect {
        Effect::from_class(self.class())
    }

    /// Change of the drive's place on its wire.
    fn line_change(&self) -> Option<LineChange> {
        None
    }

    /// Returns whether the caller has to read or feed bytes while it runs, with [`HostData::poll_bytes`] and
    /// [`HostData::feed_bytes`].
    fn moves_bytes(&self) -> bool {
        false
    }
    /// True for a request that takes motion out of a drive.
    fn is_stop(&self) -> bool {
        self.class() == RequestClass::Stop
    }
}

/// Counters of a host. Missing replies are counted, never lost silently.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counters {
    /// Requests put on the wire, resends included.
    pub sent: u64,
    /// Requests sent again after silence.
    pub resent: u64,
    /// Replies to our requests.
    pub answered: u64,
    /// Valid replies that arrived too late or too early.
    pub late: u64,
    /// Frames that matched the request, but arrived sooner than the line's rate permits.
    pub early: u64,
    /// Acknowledgements among them: the reply to the same request may still come.
    pub late_acknowledged: u64,
    /// Valid frames of another address, opcode or length than requested.
    pub foreign: u64,
    /// Frames with a matching reply, but from another address than requested.
    pub misaddressed: u64,
    /// The host that the addressed drive replied to instead of this one: its host address, or the CAN ID of
    /// the replies.
    pub other_host: Option<u32>,
    /// Address of a drive that replied to a request for another address.
    pub other_address: Option<u32>,
    /// Our own frames, or single bytes, received back (RS-485 echo).
    pub echoed: u64,
    /// Bytes thrown away while looking for a frame.
    pub skipped: u64,
    /// Frames with a wrong check sum, here or as reported by the drive.
    pub corrupt: u64,
    /// Acknowledgements from the addressed drive.
    pub acknowledged: u64,
    /// Frames that another drive acknowledged for the drive behind it.
    pub relayed: u64,
    /// Replies in text mode, where frames were expected.
    pub texts: u64,
    /// Requests that ended in silence.
    pub silent: u64,
}

impl Counters {
    /// Answers that nothing waited for: those of others, damaged ones, and late ones. A drive that is
    /// slower than its host's patience gives late ones too.
    #[must_use]
    pub const fn unaccounted(&self) -> u64 {
        self.late + self.foreign + self.corrupt
    }

    /// Both counts together.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        self.combine(other, u64::saturating_add)
    }

    /// The counts since then.
    #[must_use]
    pub fn since(self, then: Self) -> Self {
        self.combine(then, u64::saturating_sub)
    }

    fn combine(self, other: Self, both: fn(u64, u64) -> u64) -> Self {
        Self {
            sent: both(self.sent, other.sent),
            resent: both(self.resent, other.resent),
            answered: both(self.answered, other.answered),
            late: both(self.late, other.late),
            early: both(self.early, other.early),
            late_acknowledged: both(self.late_acknowledged, other.late_acknowledged),
            foreign: both(self.foreign, other.foreign),
            misaddressed: both(self.misaddressed, other.misaddressed),
            other_host: self.other_host.or(other.other_host),
            other_address: self.other_address.or(other.other_address),
            echoed: both(self.echoed, other.echoed),
            skipped: both(self.skipped, other.skipped),
            corrupt: both(self.corrupt, other.corrupt),
            acknowledged: both(self.acknowledged, other.acknowledged),
            relayed: both(self.relayed, other.relayed),
            texts: both(self.texts, other.texts),
            silent: both(self.silent, other.silent),
        }
    }
}

/// The wire of a host: what waits on it, and which drives it has.
pub trait HostWire {
    /// Received bytes that are neither part of a frame yet nor discarded.
    fn unparsed_len(&self) -> usize {
        0
    }

    /// Returns whether it has to send without requests to keep a drive running: its wire cannot be lent then.
    fn sends_keepalive(&self) -> bool {
        false
    }

    /// Ends a loan of the wire: the silent time before the next frame starts anew.
    fn handle_resume(&mut self, now: Instant) {
        let _ = now;
    }

    /// The host's own address on the wire, where drives answer one and none may have it.
    fn own_address(&self) -> Option<u32> {
        None
    }

    /// Returns whether a drive of that address can be added.
    fn can_add_drive(&self, address: u32) -> bool {
        let _ = address;
        true
    }

    /// Adds a drive of that address.
    fn add_drive(&mut self, address: u32) {
        let _ = address;
    }
}

/// Bytes of long values, as they are transferred.
pub trait HostData {
    /// Reads bytes of a long value that is being read under `ticket`, and returns how many. It paces the
    /// drive. `None` when there is no such transfer.
    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        let _ = (ticket, out);
        None
    }

    /// Feeds bytes of a long value that is being written under `ticket`, and returns how many were taken.
    /// `None` when there is no such transfer.
    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        let _ = (ticket, bytes);
        None
    }
}

/// The commanding end. Every ticket submitted ends in exactly one event.
pub trait Host<M: Medium>: Station<M> + HostWire + HostData {
    /// Type of requests.
    type Request: Request;

    /// Type of a drive's answers.
    type Answer: Copy + 'static;

    /// A request that is given back concerns its drive alone: others may be asked meanwhile.
    const PARALLEL: bool = false;

    /// A drive answers each request that changes something. Where it does not, such a request is done
    /// when it has left, and may have been lost on its way (STOP-8).
    const CONFIRMED: bool = true;

    /// Takes a request, or gives it back when it cannot take one now (half-duplex: one outstanding;
    /// quarantine after silence admits a stop only).
    ///
    /// # Errors
    /// The request itself, unsent.
    fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: Self::Request,
    ) -> Result<(), Self::Request>;

    /// Withdraws a request of which nothing is on the wire yet, to make room for `stop`. No event reports
    /// its end; it is as if [`submit`](Self::submit) had refused it. `None` where no request blocks the
    /// stop, or the one that does is on the wire (STOP-3).
    fn recall(&mut self, stop: &Self::Request) -> Option<Ticket> {
        let _ = stop;
        None
    }

    /// Sends the request of this ticket, which was submitted just now, only once, whatever its class. A
    /// drive that has been silent for long then blocks the wire for a shorter time. Not needed for hosts
    /// whose drives do not wait for one another.
    fn disable_retries(&mut self, ticket: Ticket) {
        let _ = ticket;
    }

    /// The next thing that happened: a request's end, or a drive that spoke unasked. It is lent, not
    /// copied.
    fn poll_event(&mut self) -> Option<&HostEvent<Self::Answer>>;

    /// The bytes of `request`, for rehearsals; nothing is sent.
    fn encode_request(&self, request: &Self::Request, out: &mut M::Out) -> usize;

    /// Counters of the wire so far.
    fn counters(&self) -> Counters;

    /// Sends a request without a reply ahead of everything else; no event reports its end. It shows a
    /// watchdog that the application is alive.
    fn transmit_now(&mut self, now: Instant, request: &Self::Request, out: &mut M::Out) -> usize {
        let _ = now;
        self.encode_request(request, out)
    }

    /// Bits a second of the wire; zero without timing.
    fn bit_rate(&self) -> u32 {
        0
    }

    /// Quarantines a drive after an implausible value, which may belong to another request: only stops are
    /// sent to it until no older reply can arrive. For protocols whose replies do not repeat their request.
    fn quarantine_drive(&mut self, now: Instant, address: u32) {
        let _ = (now, address);
    }
}
