//! The two ends of a wire, and their common interface.

use crate::error::Failure;
use crate::medium::Medium;
use crate::time::Instant;

/// Time, once per object, whatever the number of its wires.
pub trait Timed {
    /// To be called at or after the instant that [`poll_timeout`](Self::poll_timeout) gave.
    /// Calling it early or twice does no harm.
    fn handle_timeout(&mut self, now: Instant);
    /// When this object next wants [`handle_timeout`](Self::handle_timeout), if ever.
    fn poll_timeout(&self) -> Option<Instant>;
}

/// What happens to a wire, apart from data.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum LineEvent {
    /// The cable, port or socket is gone.
    Down,
    /// It is there again. Nothing may be assumed of what the other end went through.
    Up,
    /// A framing or parity error, or a break.
    Break,
    /// The CAN controller went bus-off. As with [`Down`](Self::Down), a host ends every request.
    BusOff,
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
    /// How this station now drives the wire.
    fn line(&self) -> M::Line;
}

/// A caller's name for a request, chosen by the caller.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Ticket(pub u32);

/// Position of an axis in its lane.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct AxisIndex(pub u8);

/// Whom an event of a host concerns.
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

/// Something that happened, as a host tells it.
pub type HostEvent<A> = (EventSubject, Result<A, Failure>);

/// Whether a request may be sent again by itself when no answer came.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RequestClass {
    /// A read: sending it twice is sending it once.
    Idempotent,
    /// A write of a setting: first read back whether it arrived.
    ReadBack,
    /// A start of motion, a relative move, a write to flash: never again.
    NoRetry,
    /// Takes motion out of a drive: may be sent twice, overtakes everything, is let into a
    /// quarantined line (STOP-1).
    Stop,
}

/// A protocol's request, as a small value.
pub trait Request: Copy + Send + 'static {
    /// Whether it may be resent. A driver gives a write the class that the lane names; other
    /// requests know theirs.
    fn class(&self) -> RequestClass;

    /// Whether the caller has to take or give bytes while it runs, as [`Host::poll_bytes`] and
    /// [`Host::feed_bytes`] do.
    fn moves_bytes(&self) -> bool {
        false
    }
    /// True for a request that takes motion out of a drive.
    fn is_stop(&self) -> bool {
        self.class() == RequestClass::Stop
    }
}

/// What a host counted. A gap in the evidence is never a silent loss.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counters {
    /// Requests put on the wire, resends included.
    pub sent: u64,
    /// Requests sent again after silence.
    pub resent: u64,
    /// Replies that answered what was asked.
    pub answered: u64,
    /// Whole, valid replies that came when nothing waited for them, or too soon.
    pub late: u64,
    /// Those among them that fitted what waited, but came sooner than the line's rate lets them.
    pub early: u64,
    /// Valid frames of another address, opcode or length than the one asked.
    pub foreign: u64,
    /// Those among them that answered what was asked, but from another address than the one asked.
    pub misaddressed: u64,
    /// To whom the drive that was asked answered instead of this host: its host address, or the CAN id of
    /// its replies.
    pub other_host: Option<u32>,
    /// Our own frames, or bytes that went alone, heard back (RS-485 echo).
    pub echoed: u64,
    /// Bytes thrown away while looking for a frame.
    pub skipped: u64,
    /// Frames whose check failed, here or by what the drive says of a request.
    pub corrupt: u64,
    /// Acknowledgements of what waited for one, by the drive that was asked.
    pub acknowledged: u64,
    /// The same for a drive behind the one that acknowledged.
    pub relayed: u64,
    /// Answers as lines of text, where frames were asked for.
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

    /// What was counted since then.
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
            foreign: both(self.foreign, other.foreign),
            misaddressed: both(self.misaddressed, other.misaddressed),
            other_host: self.other_host.or(other.other_host),
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

/// The commanding end. Every ticket submitted ends in exactly one event.
pub trait Host<M: Medium>: Station<M> {
    /// What it can ask.
    type Request: Request;
    /// What a drive answers.
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

    /// Takes back a request of which nothing is on the wire yet, because `stop` is to have its place:
    /// no event tells of its end, it is as if [`submit`](Self::submit) had not taken it. `None` where
    /// nothing stands in the stop's way, or what does is on the wire (STOP-3).
    fn recall(&mut self, stop: &Self::Request) -> Option<Ticket> {
        let _ = stop;
        None
    }

    /// Puts the request that was just submitted with this ticket on the wire once, whatever its class:
    /// who asks a drive that has long been silent does not keep the others' wire for as long as one that
    /// answers is given. Hosts whose drives do not wait for one another need not.
    fn disable_retries(&mut self, ticket: Ticket) {
        let _ = ticket;
    }

    /// The next thing that happened: a request's end, or a drive that spoke unasked. It is lent, not
    /// copied.
    fn poll_event(&mut self) -> Option<&HostEvent<Self::Answer>>;

    /// The bytes of `request`, for rehearsals; nothing is sent.
    fn encode_request(&self, request: &Self::Request, out: &mut M::Out) -> usize;

    /// What happened on the wire so far.
    fn counters(&self) -> Counters;

    /// Bytes that came and of which no frame was made yet, nor were they thrown away.
    fn unparsed_len(&self) -> usize {
        0
    }

    /// Puts a request that nobody answers on the wire ahead of everything else; no event tells of
    /// it. The application is alive for whoever watches it.
    fn transmit_now(&mut self, now: Instant, request: &Self::Request, out: &mut M::Out) -> usize {
        let _ = now;
        self.encode_request(request, out)
    }

    /// The host's own address on the wire, where drives answer one and none may have it.
    fn own_address(&self) -> Option<u32> {
        None
    }

    /// Bits a second of the wire; zero without timing.
    fn bit_rate(&self) -> u32 {
        0
    }

    /// Whether one more drive, of that address, can be asked from now on.
    fn can_add_drive(&self, address: u32) -> bool {
        let _ = address;
        true
    }

    /// One more drive, of that address, is asked from now on.
    fn add_drive(&mut self, address: u32) {
        let _ = address;
    }

    /// Whether it has to speak though nobody asks, lest a drive stops: then its wire cannot be lent.
    fn sends_keepalive(&self) -> bool {
        false
    }

    /// What the drive at this address said last cannot be, so that it may answer another question: nothing
    /// but stops is asked of it before nothing older can come. For hosts of protocols whose answers do not
    /// say what they answer.
    fn quarantine_drive(&mut self, now: Instant, address: u32) {
        let _ = (now, address);
    }

    /// Somebody else had the wire until now: what has to be silent before a frame begins anew.
    fn handle_resume(&mut self, now: Instant) {
        let _ = now;
    }

    /// Takes bytes of a long value that is being read under `ticket`, and tells how many. The drive
    /// is paced by it. `None` when nothing of that kind is under way.
    fn poll_bytes(&mut self, ticket: Ticket, out: &mut [u8]) -> Option<usize> {
        let _ = (ticket, out);
        None
    }

    /// Gives bytes of a long value that is being written under `ticket`, and tells how many were
    /// taken. `None` when nothing of that kind is under way.
    fn feed_bytes(&mut self, ticket: Ticket, bytes: &[u8]) -> Option<usize> {
        let _ = (ticket, bytes);
        None
    }
}
