//! A serial wire: bytes take time, transmissions collide, and duplex decides which ends receive them.
//!
//! The bytes that a station sends at once are a *transmission*. It arrives as one chunk after its last
//! byte, or as several if a fault cuts it. Each chunk has a [`TransmissionLabel`] that stations cannot see:
//! its transmission, the request that it answers, and whether the wire changed it. Checks compare the
//! beliefs of hosts with the labels.

use polepair_core::medium::SerialLine;
use polepair_core::time::Instant;

use crate::fault::{InjectedSerialFaults, SerialFaults};
use crate::random::{HistoryHash, Random};
use crate::uart;

/// Received bytes that are kept of a station.
const MEMORY_MAX: usize = 1200;

/// Duplex of a serial wire: the receivers of each station.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Duplex {
    /// RS-232, RS-422: one pair of wires for each direction. Drives hear the host only.
    #[default]
    Full,
    /// RS-485: one pair for all. Who talks does not hear the others.
    Half,
}

/// A network hands a packet on this late at most, ns.
const NETWORK_NS: u64 = 20_000_000;
/// An adapter of FTDI hands bytes on at multiples of this, from the factory, ns.
const FTDI_NS: u64 = 16_000_000;

/// Device between the host and a serial wire, which decides the time at which bytes are handed on.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Timing {
    /// A serial port: the baud rate decides the time of bytes.
    #[default]
    Uart,
    /// An adapter that hands bytes on to the host every 16 ms.
    Ftdi,
    /// USB CDC, an emulator of serial ports: bytes take no time, and the baud rate is fiction.
    Cdc,
    /// A pseudo-terminal: bytes take no time, but each end is set to a rate, at which it has to be received.
    Pty,
    /// A serial server: bytes take their time on the wire, and packets of them that of a network, up to
    /// 20 ms each way, drawn for each.
    Tcp,
}

impl Timing {
    /// Longest time of a packet on the network, ms.
    pub const NETWORK_MS: u32 = (NETWORK_NS / 1_000_000) as u32;

    /// Returns whether the baud rate decides the time of bytes.
    #[must_use]
    pub const fn has_byte_timing(self) -> bool {
        !matches!(self, Self::Cdc | Self::Pty)
    }
}

/// Configuration of a serial wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct SerialWireConfig {
    /// Duplex of the line, which decides the receivers of each sender.
    pub duplex: Duplex,
    /// Time at which bytes are handed on.
    pub timing: Timing,
    /// True if the host's adapter returns its own bytes (half duplex).
    pub echo: bool,
    /// Every station is as good as set to this baud rate; each to its own if `None`.
    pub baud: Option<u32>,
}

impl SerialWireConfig {
    /// RS-232 with byte timing.
    pub const RS232: Self =
        Self { duplex: Duplex::Full, timing: Timing::Uart, echo: false, baud: None };
    /// RS-485 with byte timing, without echo.
    pub const RS485: Self =
        Self { duplex: Duplex::Half, timing: Timing::Uart, echo: false, baud: None };
    /// No timing, no baud rate.
    pub const UNTIMED: Self =
        Self { duplex: Duplex::Full, timing: Timing::Cdc, echo: false, baud: None };
}

/// Facts on a transmission that the world knows and no station sees.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct TransmissionLabel {
    /// Number of the transmission; 0 for none.
    pub tag: u32,
    /// The last transmission that its sender had received, 0 for none. For a drive's reply: the request that it
    /// answers.
    pub answers: u32,
    /// Hash of the bytes that the sender meant.
    pub content_hash: u64,
    /// Hash of the bytes that the sender of `answers` meant.
    pub question_hash: u64,
    /// The wire changed it, or changed what it answers.
    pub tainted: bool,
    /// True if it is the second copy that a fault made of a reply.
    pub is_copy: bool,
    /// When its last byte can have left at the earliest, clocks being a twentieth apart.
    pub left_at: Instant,
    /// When its first byte began at the latest, by when how many bytes were handed over.
    pub begun_by: Instant,
    pub(crate) byte_count: usize,
}

/// One end of a serial wire as the world sees it.
#[derive(Clone, Debug)]
pub(crate) struct SerialPlug {
    /// The commanding end: drives answer it, and its adapter may echo.
    pub(crate) is_host: bool,
    /// End of its own transmissions, which queue behind each other.
    busy_until: Instant,
    /// Begin and end of its last transmission, during which it drove the wire.
    drove_from_until: (Instant, Instant),
    /// Label of the last sent transmission.
    pub(crate) last_sent: TransmissionLabel,
    /// Label of the last received transmission; tainted if any was since it last sent.
    pub(crate) last_received: TransmissionLabel,
    /// The last received transmission of other stations.
    pub(crate) last_from_others: TransmissionLabel,
    tainted: bool,
    pub(crate) history: ReceiveHistory,
}

/// The last bytes that a station received, and the positions of its own transmissions among them.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReceiveHistory {
    pub(crate) bytes: Vec<u8>,
    sent_offsets: [usize; 2],
    /// Start of each transmission among them, and the hash of its intended content.
    intended: Vec<(usize, u64)>,
}

impl ReceiveHistory {
    /// Records received bytes; `begins` is the content of a transmission that begins with them.
    fn record(&mut self, received: &[u8], begins: Option<u64>) {
        if self.bytes.len() + received.len() > MEMORY_MAX {
            // Half is dropped at once, so that the bytes behind are not moved with each reception.
            let old = self.bytes.len().saturating_sub(MEMORY_MAX / 2);
            self.bytes.drain(..old);
            self.sent_offsets = self.sent_offsets.map(|at| at.saturating_sub(old));
            self.intended.retain(|(at, _)| *at >= old);
            self.intended.iter_mut().for_each(|(at, _)| *at -= old);
        }
        debug_assert!(self.intended.is_sorted_by_key(|(at, _)| *at));
        self.intended.extend(begins.map(|content| (self.bytes.len(), content)));
        self.bytes.extend_from_slice(received);
    }

    fn mark_sent(&mut self) {
        self.sent_offsets = [self.sent_offsets[1], self.bytes.len()];
    }

    /// Returns whether these of the bytes are what the transmission they came in was meant to be.
    pub(crate) fn is_as_sent(&self, range: std::ops::Range<usize>) -> bool {
        let within = self.intended.iter().rfind(|(at, _)| *at <= range.start);
        within.is_some_and(|(_, content)| *content == hash_bytes(&self.bytes[range]))
    }

    /// Start of the bytes received between its last two transmissions, or since the last.
    pub(crate) const fn fresh_from(&self) -> usize {
        self.sent_offsets[0]
    }
}

/// The hash of what a transmission asks. A TMCL stop that is sent once for every place of a module's
/// count asks what one of them asks.
fn content_hash(bytes: &[u8]) -> u64 {
    const DATAGRAM: usize = 9;
    let (places, rest) = bytes.as_chunks::<{ DATAGRAM + 1 }>();
    match places {
        [first, others @ ..] if others.len() == DATAGRAM - 1 => {
            let same = others.iter().all(|slot| slot == first) && rest.iter().all(|b| *b == 0);
            if same { hash_bytes(&first[..DATAGRAM]) } else { hash_bytes(bytes) }
        }
        _ => hash_bytes(bytes),
    }
}

fn hash_bytes(bytes: &[u8]) -> u64 {
    let mut history = HistoryHash::default();
    history.add_bytes(bytes);
    history.value()
}

/// Clocks of a sender and a receiver may differ by a twentieth.
const fn clock_tolerance(ns: u64) -> u64 {
    ns - ns / 20
}

/// Which receivers a chunk reaches at an instant: the host's adapter may keep bytes for a while, the
/// drives hear them as they come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Receivers {
    All,
    Drives,
    Host,
}

impl Receivers {
    pub(crate) const fn includes(self, head: bool) -> bool {
        match self {
            Self::All => true,
            Self::Drives => !head,
            Self::Host => head,
        }
    }

    /// Returns whether no station is left to receive it afterwards.
    pub(crate) const fn is_final(self) -> bool {
        !matches!(self, Self::Drives)
    }
}

/// Bytes under way.
#[derive(Clone, Debug)]
pub(crate) struct WireChunk {
    pub(crate) wire: usize,
    pub(crate) from: usize,
    start: Instant,
    character_ns: u64,
    line: SerialLine,
    pub(crate) label: TransmissionLabel,
    pub(crate) bytes: Vec<u8>,
}

impl WireChunk {
    fn end(&self) -> Instant {
        self.start.plus_ns(self.bytes.len() as u64 * self.character_ns)
    }

    /// The bytes that were on the wire at some time within `from..until`.
    fn range_during(&self, from: Instant, until: Instant) -> std::ops::Range<usize> {
        if self.character_ns == 0 || until <= self.start || from >= self.end() {
            return 0..0;
        }
        let first = from.since(self.start).as_nanos() as u64 / self.character_ns;
        let last = (until.since(self.start).as_nanos() as u64).div_ceil(self.character_ns);
        (first as usize).min(self.bytes.len())..(last as usize).min(self.bytes.len())
    }
}

/// Chunks under way on all wires; the buffers are used again and again.
#[derive(Debug, Default)]
pub(crate) struct ChunkPool {
    chunks: Vec<WireChunk>,
    free: Vec<usize>,
}

impl ChunkPool {
    fn insert(&mut self, template: &WireChunk, bytes: &[u8]) -> usize {
        let at = self.free.pop().unwrap_or_else(|| {
            let bytes = Vec::with_capacity(bytes.len().max(16));
            self.chunks.push(WireChunk { bytes, ..template.clone() });
            self.chunks.len() - 1
        });
        let chunk = &mut self.chunks[at];
        let mut buffer = std::mem::take(&mut chunk.bytes);
        buffer.clear();
        buffer.extend_from_slice(bytes);
        *chunk = WireChunk { bytes: buffer, ..*template };
        at
    }

    /// Puts the bytes back for those who hear them later.
    pub(crate) fn restore_bytes(&mut self, at: usize, chunk: WireChunk) {
        self.chunks[at].bytes = chunk.bytes;
    }

    /// Takes a chunk's bytes out while it is being delivered.
    pub(crate) fn take_chunk(&mut self, at: usize) -> WireChunk {
        let chunk = &mut self.chunks[at];
        let bytes = std::mem::take(&mut chunk.bytes);
        WireChunk { bytes, ..*chunk }
    }

    /// Gives the buffer back.
    pub(crate) fn release(&mut self, at: usize, chunk: WireChunk) {
        self.chunks[at].bytes = chunk.bytes;
        self.free.push(at);
    }
}

/// A serial wire.
#[derive(Debug)]
pub(crate) struct SerialWire {
    pub(crate) config: SerialWireConfig,
    pub(crate) plugs: Vec<SerialPlug>,
    pub(crate) faults: SerialFaults,
    pub(crate) injected: InjectedSerialFaults,
    pub(crate) down: bool,
    /// Time at which the host's adapter hands on the bytes it has.
    host_handover: Instant,
    random: Random,
    in_flight: Vec<usize>,
    scratch: Vec<u8>,
}

impl SerialWire {
    pub(crate) fn new(config: SerialWireConfig, random: Random) -> Self {
        Self {
            config,
            plugs: Vec::new(),
            faults: SerialFaults::NONE,
            injected: InjectedSerialFaults::default(),
            down: false,
            host_handover: Instant::ZERO,
            random,
            in_flight: Vec::new(),
            scratch: Vec::new(),
        }
    }

    pub(crate) fn add_plug(&mut self, head: bool) -> usize {
        let never = (Instant::ZERO, Instant::ZERO);
        self.plugs.push(SerialPlug {
            is_host: head,
            busy_until: Instant::ZERO,
            drove_from_until: never,
            last_sent: TransmissionLabel::default(),
            last_received: TransmissionLabel::default(),
            last_from_others: TransmissionLabel::default(),
            tainted: false,
            history: ReceiveHistory::default(),
        });
        self.plugs.len() - 1
    }

    /// Puts a transmission on the wire. `schedule` takes the instant and place of each chunk.
    #[allow(clippy::too_many_arguments, reason = "the world's parts are lent one by one")]
    pub(crate) fn transmit(
        &mut self,
        air: &mut ChunkPool,
        now: Instant,
        position: (usize, usize),
        tag: u32,
        line: SerialLine,
        bytes: &[u8],
        mut schedule: impl FnMut(Instant, usize, Receivers),
    ) {
        let (wire, from) = position;
        let label = self.label_transmission(from, tag, bytes);
        let line = SerialLine { baud: self.config.baud.unwrap_or(line.baud), ..line };
        let character_ns =
            if self.config.timing.has_byte_timing() { line.characters_ns(1) } else { 0 };
        let reply = !self.plugs[from].is_host;
        // Late replies wait side by side: none is later than the latest, but for the others' bytes.
        // A reply crosses the network when it is handed over, see `arrival_time`.
        let late = self.lateness_ns(reply) + if reply { 0 } else { self.network_ns() };
        let begin = now.plus_ns(late).max(self.plugs[from].busy_until);
        let mut chunk =
            WireChunk { wire, from, start: begin, character_ns, line, label, bytes: Vec::new() };
        // Copied: the sender's bytes stay as they are, for the label is made from them.
        let mut intended = std::mem::take(&mut self.scratch);
        intended.clear();
        intended.extend_from_slice(bytes);
        chunk.label.tainted |= self.corrupt(&mut intended);
        let lost = self.draw_loss(reply);
        let until = begin.plus_ns(bytes.len() as u64 * character_ns);
        // Also when the transmission is lost: its driver was busy all the same.
        self.record_driving(from, begin, until, line);
        // A host sees no more of its bytes than that the network took them.
        self.plugs[from].last_sent.left_at = match self.config.timing {
            Timing::Tcp => now,
            _ => begin.plus_ns(clock_tolerance(until.0 - begin.0)),
        };
        if !lost {
            self.send_pieces(air, &mut chunk, &intended, &mut schedule);
            if reply && self.random.chance(self.faults.duplicate) {
                self.injected.duplicated += 1;
                chunk.label.is_copy = true;
                // Up to three characters later, so that a receiver sees it with and without a gap.
                chunk.start = chunk.start.plus_ns(self.random.below(3 * character_ns + 1));
                self.send_pieces(air, &mut chunk, &intended, &mut schedule);
            }
            self.plugs[from].busy_until = chunk.start.max(until);
        }
        self.scratch = intended;
    }

    /// Takes a chunk off the wire to deliver it.
    pub(crate) fn remove_in_flight(&mut self, at: usize) {
        self.in_flight.retain(|&flying| flying != at);
    }

    /// Returns whether plug `to` receives transmissions of plug `from`.
    pub(crate) fn can_hear(&self, to: usize, from: usize) -> bool {
        if to == from {
            return self.config.echo && self.plugs[to].is_host;
        }
        self.config.duplex == Duplex::Half || self.plugs[to].is_host != self.plugs[from].is_host
    }

    /// Appends the bytes of `chunk` that the station at plug `to`, set to `line`, receives to the output. Returns
    /// whether there was a framing error.
    pub(crate) fn receive_chunk(
        &mut self,
        to: usize,
        now: Instant,
        chunk: &WireChunk,
        line: SerialLine,
        received: &mut Vec<u8>,
    ) -> bool {
        received.clear();
        let plug = &self.plugs[to];
        let line = SerialLine { baud: self.config.baud.unwrap_or(line.baud), ..line };
        // A host that was opened at another rate than the drives talk at.
        let line = match self.faults.host_baud {
            0 => line,
            baud if plug.is_host => SerialLine { baud, ..line },
            _ => line,
        };
        let deaf = if self.config.duplex == Duplex::Half && to != chunk.from && !self.config.echo {
            chunk.range_during(plug.drove_from_until.0, plug.drove_from_until.1)
        } else {
            0..0
        };
        let is_fiction = self.config.timing == Timing::Cdc;
        let broken = if is_fiction || uart::is_compatible(chunk.line, line) {
            received.extend_from_slice(&chunk.bytes[..deaf.start]);
            received.extend_from_slice(&chunk.bytes[deaf.end..]);
            !deaf.is_empty()
        } else {
            uart::resample(&chunk.bytes, chunk.line, line, received)
        };
        let changed = *received != chunk.bytes;
        let plug = &mut self.plugs[to];
        let before = plug.last_received;
        let goes_on = before.tag == chunk.label.tag && before.is_copy == chunk.label.is_copy;
        plug.history.record(received, (!goes_on).then_some(chunk.label.content_hash));
        // It stays until the plug sends: a reply to damaged bytes is not proof of anything.
        plug.tainted |= changed || chunk.label.tainted;
        let bytes = received.len() + if goes_on { before.byte_count } else { 0 };
        let took = match self.config.timing {
            Timing::Tcp => 0,
            _ => bytes as u64 * clock_tolerance(chunk.character_ns),
        };
        let started_at = Instant(now.0.saturating_sub(took));
        let started_at = if goes_on { started_at.min(before.begun_by) } else { started_at };
        plug.last_received = TransmissionLabel {
            tainted: plug.tainted,
            begun_by: started_at,
            byte_count: bytes,
            ..chunk.label
        };
        // An echo is the host's own transmission and answers nothing.
        if to != chunk.from {
            plug.last_from_others = plug.last_received;
        }
        broken
    }

    fn label_transmission(&mut self, from: usize, tag: u32, bytes: &[u8]) -> TransmissionLabel {
        let plug = &mut self.plugs[from];
        let label = TransmissionLabel {
            tag,
            answers: plug.last_received.tag,
            content_hash: content_hash(bytes),
            question_hash: plug.last_received.content_hash,
            tainted: !plug.is_host && plug.tainted,
            is_copy: false,
            left_at: Instant::ZERO,
            begun_by: Instant::ZERO,
            byte_count: 0,
        };
        plug.tainted = false;
        plug.last_sent = label;
        plug.history.mark_sent();
        label
    }

    fn lateness_ns(&mut self, reply: bool) -> u64 {
        if !reply || !self.random.chance(self.faults.late) {
            return 0;
        }
        self.injected.late += 1;
        self.faults.lateness_ns(&mut self.random)
    }

    /// Time of a packet on the network, if there is one.
    fn network_ns(&mut self) -> u64 {
        if self.config.timing == Timing::Tcp { self.random.below(NETWORK_NS) } else { 0 }
    }

    fn draw_loss(&mut self, reply: bool) -> bool {
        let chance = if reply { self.faults.lose_reply } else { self.faults.lose_request };
        let lost = self.random.chance(chance);
        let count =
            if reply { &mut self.injected.replies_lost } else { &mut self.injected.requests_lost };
        *count += u64::from(lost);
        lost || self.down
    }

    /// Changes, truncates or overlays the bytes as the faults will. Returns whether it did.
    fn corrupt(&mut self, bytes: &mut Vec<u8>) -> bool {
        let made = self.faults.corrupt(&mut self.random, bytes);
        self.injected.bytes += made;
        let mut changed = made > 0;
        if self.random.chance(self.faults.truncate) {
            bytes.truncate(self.random.below(bytes.len() as u64) as usize);
            self.injected.truncated += 1;
            changed = true;
        }
        if self.random.chance(self.faults.collide) {
            let first = self.random.below(bytes.len() as u64) as usize;
            bytes[first..].iter_mut().for_each(|byte| *byte &= self.random.next_byte());
            self.injected.collided += 1;
            changed = true;
        }
        changed
    }

    fn record_driving(&mut self, from: usize, begin: Instant, until: Instant, line: SerialLine) {
        debug_assert!(line.bits_per_character() > 0);
        let bit_ns = line.characters_ns(1) / u64::from(line.bits_per_character());
        let plug = &mut self.plugs[from];
        let late = if plug.is_host { u64::from(self.faults.release_late_bits) * bit_ns } else { 0 };
        plug.drove_from_until = (begin, until.plus_ns(late));
        plug.busy_until = until;
    }

    /// Sends `bytes` as chunks from `chunk.start` on, and leaves there when the last one ends.
    fn send_pieces(
        &mut self,
        air: &mut ChunkPool,
        chunk: &mut WireChunk,
        bytes: &[u8],
        schedule: &mut impl FnMut(Instant, usize, Receivers),
    ) {
        let cutting = self.random.chance(self.faults.chunk);
        self.injected.chunked += u64::from(cutting);
        let mut rest = bytes;
        while !rest.is_empty() {
            let len = if cutting {
                1 + self.random.below(rest.len() as u64) as usize
            } else {
                rest.len()
            };
            let (piece, after) = rest.split_at(len);
            self.send_chunk(air, chunk, piece, schedule);
            rest = after;
            chunk.start = chunk.start.plus_ns(len as u64 * chunk.character_ns);
            if cutting && !rest.is_empty() {
                let gap = u64::from(self.faults.chunk_gap_us) * 1_000;
                chunk.start = chunk.start.plus_ns(self.random.below(gap + 1));
            }
        }
    }

    fn send_chunk(
        &mut self,
        air: &mut ChunkPool,
        template: &WireChunk,
        bytes: &[u8],
        schedule: &mut impl FnMut(Instant, usize, Receivers),
    ) {
        let at = air.insert(template, bytes);
        // Each pair is looked at once, when the later of the two begins.
        for other in 0..self.in_flight.len() {
            self.collide(air, at, self.in_flight[other]);
        }
        self.in_flight.push(at);
        let end = air.chunks[at].end();
        match self.arrival_time(end, template.from) {
            later if later > end && self.config.duplex == Duplex::Half => {
                // Drives sit on the line itself; only the host waits for its adapter's latency timer.
                schedule(end, at, Receivers::Drives);
                schedule(later, at, Receivers::Host);
            }
            later if later > end => schedule(later, at, Receivers::Host),
            _ => schedule(end, at, Receivers::All),
        }
    }

    /// When a chunk that ends at `end` reaches the host: at once, or when its adapter next looks.
    /// An adapter hands bytes on in the order in which they came, whatever becomes of its latency.
    fn arrival_time(&mut self, end: Instant, from: usize) -> Instant {
        if self.plugs[from].is_host {
            return end;
        }
        let own = if self.config.timing == Timing::Ftdi { FTDI_NS } else { 0 };
        let period = own.max(u64::from(self.faults.latency_ms) * 1_000_000);
        let end = end.plus_ns(self.network_ns());
        // The timer runs by itself: bytes wait for its next tick, not for a full period.
        let looks = if period == 0 { end } else { Instant(end.0.div_ceil(period) * period) };
        // Bytes of a stream do not overtake each other, whatever the network draws.
        self.host_handover = self.host_handover.max(looks);
        self.host_handover
    }

    /// Garbles what two chunks have in common, if they share a pair of wires at the same time.
    fn collide(&mut self, air: &mut ChunkPool, a: usize, b: usize) {
        let (one, two) = (&air.chunks[a], &air.chunks[b]);
        // With two pairs of wires a host and a drive may talk at the same time.
        let same_pair = self.config.duplex == Duplex::Half
            || self.plugs[one.from].is_host == self.plugs[two.from].is_host;
        let overlap = (one.start.max(two.start), one.end().min(two.end()));
        if one.from == two.from || !same_pair || overlap.0 >= overlap.1 {
            return;
        }
        self.injected.collided += 1;
        for at in [a, b] {
            let chunk = &mut air.chunks[at];
            let range = chunk.range_during(overlap.0, overlap.1);
            // Which of two drivers wins a bit is not defined: some bits fall to zero.
            chunk.bytes[range].iter_mut().for_each(|byte| *byte &= self.random.next_byte());
            chunk.label.tainted = true;
        }
    }
}
