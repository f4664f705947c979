//! A CAN bus: the lowest identifier wins, and each frame takes exactly its bits.
//!
//! Each plug is a controller with a send queue and the transmit error counter of ISO 11898-1. Two
//! controllers that send the same identifier at once fail at the first different bit. Both retry, so both
//! end in bus-off. Frames with equal bits are one frame for all receivers.
//!
//! Each frame has a [`CanFrameLabel`] that stations cannot see: its sender, and the request that it
//! answers. Checks compare the beliefs of hosts with the labels.

mod fault;

use polepair_core::medium::bits::bit_time_ns;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

use polepair_core::medium::{CanLine, Frame};
use polepair_core::time::Instant;

use crate::random::{HistoryHash, Ppm, Random};
pub use fault::{CanFaults, InjectedCanFaults};
pub use polepair_core::medium::bits;
use polepair_core::medium::bits::{arbitration_key, bits_until_difference};

#[cfg(test)]
mod tests;

/// An error flag with those of the others behind it, and its delimiter.
const ERROR_BITS: u32 = 12 + 8;
/// Increase of the transmit error counter by a failed transmission, and the count beyond which the controller is
/// bus-off.
const ERROR_WEIGHT: u16 = 8;
const ERRORS_MAX: u16 = 255;
/// Recessive bits that a controller waits before it leaves bus-off.
const RECOVERY_BITS: u64 = 128 * 11;
/// Frames that a host's controller holds, and a drive's: a frame there cannot be called back.
const HOST_FRAMES_MAX: usize = 1;
const DRIVE_FRAMES_MAX: usize = 3;
/// Frames that an adapter holds back at most; beyond them they are lost.
pub(crate) const DELAYED_MAX: usize = 256;

/// Role of a controller on the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum PlugRole {
    /// The commanding end.
    #[default]
    Host,
    /// A drive: frames that it sends while it takes a frame answer that frame.
    Drive,
    /// A sender that belongs to no host and no drive.
    Intruder,
}

/// Facts on a frame that the world knows and no station sees.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CanFrameLabel {
    /// Number of the frame; 0 for none.
    pub tag: u32,
    /// Hash of identifier and payload as they were meant.
    pub content_hash: u64,
    /// CAN identifier, and whether it has 29 bits.
    pub id: (u32, bool),
    /// Place of its sender on the bus.
    pub sender: usize,
    /// Number and content of the frame that it answers; `None` for unsolicited frames, and where the world cannot
    /// determine it.
    pub answers: Option<(u32, u64)>,
    /// An intruder sent it, or it answers an intruder.
    pub from_intruder: bool,
    /// True if it is received a second time, or answers a copy.
    pub is_copy: bool,
    /// True if the answered frame is unknown: its sender's controller was full.
    pub cause_unknown: bool,
    /// Bits that it takes at least.
    pub bits_min: u32,
}

/// Facts on one node's place on a CAN bus that the world knows and the node does not.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CanPlugStatus {
    /// Place on the bus, as in [`CanFrameLabel::sender`].
    pub plug: usize,
    /// Label of the last received frame.
    pub last_received: CanFrameLabel,
    /// Number of received frames.
    pub received_count: u64,
    /// Label and time of the last frame that it gave to its controller.
    pub last_sent: CanFrameLabel,
    /// See [`last_sent`](Self::last_sent).
    pub sent_at: Instant,
    /// Something waits in its controller.
    pub is_waiting: bool,
    /// Frames of its own that others took twice.
    pub taken_twice: u64,
    /// Frames of hosts that it did not get, or not whole.
    pub missed: u64,
    /// Number of times its controller went bus-off.
    pub bus_off_count: u64,
    /// Identifier of the last bus-off whose cause was another host with a frame of this identifier and other data at
    /// the same instants, from the first try to the last.
    pub clash_id: Option<(u32, bool)>,
    /// Intruders' frames that it took and that may have been meant for it.
    pub intruder_frames: u64,
}

/// A CAN bus with its nodes' frames waiting.
#[derive(Debug)]
pub(crate) struct CanBus {
    pub(crate) line: CanLine,
    pub(crate) faults: CanFaults,
    pub(crate) injected: InjectedCanFaults,
    pub(crate) down: bool,
    random: Random,
    plugs: Vec<CanPlug>,
    on_wire: Option<ActiveFrame>,
    /// True if a start is scheduled: until then further senders join the arbitration.
    start_pending: bool,
    /// Bits that were on the wire so far.
    busy_bits: u64,
    /// The drives that answered frames of an identifier, and the identifiers that drives send.
    responders: BTreeMap<(u32, bool), Vec<usize>>,
    drive_ids: BTreeSet<(u32, bool)>,
}

/// One controller.
#[derive(Debug, Default)]
struct CanPlug {
    role: PlugRole,
    queue: VecDeque<QueuedFrame>,
    sending: bool,
    error_count: u16,
    /// Number of consecutive transmissions that collided with a frame of another host.
    clash_count: u16,
    bus_off: bool,
    /// True while its connector is pulled.
    unplugged: bool,
    /// Label of the frame that it is receiving: it sends its replies meanwhile.
    answering: Option<CanFrameLabel>,
    /// True if its station may hold frames back whose cause is no longer known.
    cause_unknown: bool,
    delayed: VecDeque<(Instant, Frame, CanFrameLabel)>,
    status: CanPlugStatus,
}

/// A frame in a controller.
#[derive(Clone, Copy, Debug)]
struct QueuedFrame {
    frame: Frame,
    label: CanFrameLabel,
    /// Others took it already.
    received: bool,
}

/// The frame on the wire.
#[derive(Clone, Copy, Debug)]
struct ActiveFrame {
    frame: Frame,
    label: CanFrameLabel,
    end: TransmissionEnd,
    /// Two hosts sent it, and other data.
    clash: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum TransmissionEnd {
    Arrived,
    TakenTwice,
    Destroyed,
}

/// Result of a frame at one plug.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Delivery {
    Missed,
    Immediate(Frame),
    Delayed(Instant),
}

impl CanBus {
    pub(crate) fn new(line: CanLine, random: Random) -> Self {
        Self {
            line,
            faults: CanFaults::default(),
            injected: InjectedCanFaults::default(),
            down: false,
            random,
            plugs: Vec::new(),
            on_wire: None,
            start_pending: false,
            busy_bits: 0,
            responders: BTreeMap::new(),
            drive_ids: BTreeSet::new(),
        }
    }

    pub(crate) fn add_plug(&mut self, role: PlugRole) -> usize {
        let plug = self.plugs.len();
        let standing = CanPlugStatus { plug, ..CanPlugStatus::default() };
        self.plugs.push(CanPlug { role, status: standing, ..CanPlug::default() });
        plug
    }

    pub(crate) fn plug_status(&self, plug: usize) -> CanPlugStatus {
        self.plugs[plug].status
    }

    /// Returns whether a plug's controller can take a frame.
    pub(crate) fn has_room(&self, plug: usize) -> bool {
        let CanPlug { role, queue, bus_off, unplugged, .. } = &self.plugs[plug];
        let max = if *role == PlugRole::Drive { DRIVE_FRAMES_MAX } else { HOST_FRAMES_MAX };
        queue.len() < max && !bus_off && !unplugged
    }

    /// Marks frames that a plug sends from here on as replies to its last received frame.
    pub(crate) fn begin_answering(&mut self, plug: usize) {
        let plug = &mut self.plugs[plug];
        plug.answering = Some(plug.status.last_received);
    }

    /// Marks frames that a plug sends from here on as replies to none. `empty` is true if its station has no more to
    /// send now.
    pub(crate) fn end_answering(&mut self, plug: usize, empty: bool) {
        let plug = &mut self.plugs[plug];
        plug.cause_unknown = !empty && (plug.cause_unknown || plug.answering.is_some());
        plug.answering = None;
    }

    /// Puts a frame into a plug's controller. Returns whether to [`start_frame`](Self::start_frame) is now to
    /// be arranged for, at the end of this instant: frames that are ready by then arbitrate.
    pub(crate) fn enqueue(&mut self, plug: usize, now: Instant, tag: u32, frame: Frame) -> bool {
        let mark = self.label_frame(plug, tag, &frame);
        let plug = &mut self.plugs[plug];
        (plug.status.last_sent, plug.status.sent_at, plug.status.is_waiting) = (mark, now, true);
        plug.queue.push_back(QueuedFrame { frame, label: mark, received: false });
        let arrange = !self.start_pending && self.on_wire.is_none();
        self.start_pending |= arrange;
        arrange
    }

    fn label_frame(&mut self, from: usize, tag: u32, frame: &Frame) -> CanFrameLabel {
        let CanPlug { role, answering, cause_unknown: unsure, .. } = &self.plugs[from];
        let cause = answering.filter(|_| *role == PlugRole::Drive && !unsure);
        let id = (frame.id, frame.extended);
        if *role == PlugRole::Drive {
            self.drive_ids.insert(id);
            if let Some(can_frame_label) = cause {
                let who = self.responders.entry(can_frame_label.id).or_default();
                who.extend((!who.contains(&from)).then_some(from));
            }
        }
        CanFrameLabel {
            tag,
            content_hash: hash_frame(frame),
            id,
            sender: from,
            answers: cause.map(|mark| (mark.tag, mark.content_hash)),
            from_intruder: *role == PlugRole::Intruder
                || cause.is_some_and(|mark| mark.from_intruder),
            is_copy: cause.is_some_and(|mark| mark.is_copy),
            cause_unknown: *unsure,
            bits_min: bits::unstuffed_bits(frame.extended, frame.bytes().len() as u32),
        }
    }

    /// Starts the frame that wins. Returns when it will have ended.
    pub(crate) fn start_frame(&mut self, now: Instant) -> Option<Instant> {
        self.start_pending = false;
        let won =
            self.plugs.iter().filter_map(first_posted).min_by_key(|p| arbitration_key(&p.frame))?;
        let QueuedFrame { frame, label, .. } = won;
        let (mut bits, mut end) = (bits::wire_bits(&frame), TransmissionEnd::Arrived);
        for plug in &mut self.plugs {
            let rival = first_posted(plug).map(|posted| posted.frame);
            let rival = rival.filter(|other| arbitration_key(other) == arbitration_key(&frame));
            plug.sending = rival.is_some();
            if let Some(rival) = rival.filter(|rival| *rival != frame) {
                end = TransmissionEnd::Destroyed;
                bits = bits.min(
                    bits_until_difference(&frame, &rival) + ERROR_BITS + bits::INTERFRAME_BITS,
                );
            }
        }
        let hosts = self.plugs.iter().filter(|plug| plug.sending && plug.role == PlugRole::Host);
        let clash = end == TransmissionEnd::Destroyed && hosts.count() > 1;
        if end == TransmissionEnd::Destroyed {
            self.injected.collided += 1;
        } else if self.random.chance(self.faults.error) {
            end = TransmissionEnd::Destroyed;
            bits = 1 + self.random.below(bits.into()) as u32 + ERROR_BITS + bits::INTERFRAME_BITS;
        } else if self.random.chance(self.faults.last_bit) {
            (end, bits) = (TransmissionEnd::TakenTwice, bits + ERROR_BITS);
        }
        self.on_wire = Some(ActiveFrame { frame, label, end, clash });
        self.busy_bits += u64::from(bits);
        Some(now.plus_ns(self.bits_ns(bits.into())))
    }

    /// Ends the transmission on the wire: the frame if it arrived. After its delivery to all plugs,
    /// [`start_frame`](Self::start_frame) the next.
    pub(crate) fn finish_frame(&mut self) -> Option<(Frame, CanFrameLabel)> {
        let ActiveFrame { frame, label, end, clash } = self.on_wire.take()?;
        self.start_pending = true;
        for plug in self.plugs.iter_mut().filter(|plug| plug.sending) {
            let again = plug.queue.front().is_some_and(|posted| posted.received);
            let clashed = clash && plug.role == PlugRole::Host;
            plug.clash_count = if clashed { plug.clash_count + 1 } else { 0 };
            plug.status.taken_twice += u64::from(again && end != TransmissionEnd::Destroyed);
            if end == TransmissionEnd::Arrived {
                plug.queue.pop_front();
                plug.error_count = plug.error_count.saturating_sub(1);
                plug.status.is_waiting = !plug.queue.is_empty();
                continue;
            }
            plug.error_count += ERROR_WEIGHT;
            if end == TransmissionEnd::TakenTwice
                && let Some(posted) = plug.queue.front_mut()
            {
                (posted.received, posted.label.is_copy) = (true, true);
            }
        }
        match end {
            TransmissionEnd::Arrived => {}
            TransmissionEnd::TakenTwice => self.injected.taken_twice += 1,
            TransmissionEnd::Destroyed => self.injected.errors += 1,
        }
        let strange = self.plugs[label.sender].role == PlugRole::Intruder
            && end != TransmissionEnd::Destroyed;
        self.injected.intruder_frames += u64::from(strange);
        (end != TransmissionEnd::Destroyed).then_some((frame, label))
    }

    /// The copy of the just ended frame that a plug receives, and its time.
    pub(crate) fn deliver_to(
        &mut self,
        to: usize,
        now: Instant,
        frame: &Frame,
        mark: &CanFrameLabel,
    ) -> Delivery {
        let plug = &self.plugs[to];
        let host = plug.role == PlugRole::Host;
        let own = plug.sending && !(host && self.faults.echo && mark.sender == to);
        if own {
            return Delivery::Missed;
        }
        let deaf = self.down || plug.bus_off || plug.unplugged;
        let lost = !deaf && self.random.chance(self.faults.lose);
        self.injected.lost += u64::from(lost);
        let whole = self.shorten_payload(to, *frame, mark);
        let missed = deaf || lost || whole.len < frame.len;
        let of_host = self.plugs[mark.sender].role == PlugRole::Host;
        self.plugs[to].status.missed += u64::from(missed && of_host);
        if deaf || lost { Delivery::Missed } else { self.delay_frame(to, now, whole, mark) }
    }

    /// Keeps a frame back, if the fault hits it or another waits already.
    fn delay_frame(
        &mut self,
        to: usize,
        now: Instant,
        frame: Frame,
        mark: &CanFrameLabel,
    ) -> Delivery {
        let roles = (self.plugs[mark.sender].role, self.plugs[to].role);
        let late =
            roles == (PlugRole::Drive, PlugRole::Host) && self.random.chance(self.faults.late);
        self.injected.late += u64::from(late);
        let lateness = u64::from(self.faults.late_max_ms) * 1_000_000 * u64::from(late);
        let waiting = &mut self.plugs[to].delayed;
        let at = now.plus_ns(self.random.below(lateness));
        let at = waiting.back().map_or(at, |(before, ..)| at.max(*before));
        if at == now {
            return Delivery::Immediate(frame);
        }
        if waiting.len() == DELAYED_MAX {
            self.injected.lost += 1;
            return Delivery::Missed;
        }
        waiting.push_back((at, frame, *mark));
        Delivery::Delayed(at)
    }

    /// The frame that a plug's adapter has held back until now.
    pub(crate) fn pop_delayed(&mut self, plug: usize) -> Option<(Frame, CanFrameLabel)> {
        let (_, frame, mark) = self.plugs[plug].delayed.pop_front()?;
        Some((frame, mark)).filter(|_| !self.down && !self.plugs[plug].unplugged)
    }

    /// The frame, shortened if it is addressed to that plug and the fault applies.
    fn shorten_payload(&mut self, to: usize, mut frame: Frame, mark: &CanFrameLabel) -> Frame {
        if self.faults.cut == Ppm::NEVER {
            return frame;
        }
        let matches = match self.plugs[to].role {
            PlugRole::Host => self.plugs[mark.sender].role == PlugRole::Drive,
            PlugRole::Drive => self.responders.get(&mark.id).is_some_and(|who| who.contains(&to)),
            PlugRole::Intruder => false,
        };
        if matches && frame.len > 0 && self.random.chance(self.faults.cut) {
            frame.len = self.random.below(frame.len.into()) as u8;
            frame.data[usize::from(frame.len)..].fill(0);
            self.injected.cut += 1;
        }
        frame
    }

    /// Notes what a plug takes now.
    pub(crate) fn record_received(&mut self, to: usize, mark: CanFrameLabel) {
        let plug = &mut self.plugs[to];
        plug.status.last_received = mark;
        plug.status.received_count += 1;
        if mark.from_intruder && plug.role == PlugRole::Drive {
            let unknown = !self.drive_ids.contains(&mark.id);
            let matches = self.responders.get(&mark.id).map_or(unknown, |who| who.contains(&to));
            plug.status.intruder_frames += u64::from(matches);
        }
    }

    /// Takes the next plug off the bus whose errors are too many.
    pub(crate) fn next_bus_off(&mut self) -> Option<usize> {
        let at = self.plugs.iter().position(|plug| plug.error_count > ERRORS_MAX)?;
        let plug = &self.plugs[at];
        let clashed = plug.clash_count * ERROR_WEIGHT > ERRORS_MAX;
        let clashed = plug.queue.front().filter(|_| clashed).map(|posted| posted.label.id);
        self.set_bus_off(at);
        self.plugs[at].status.clash_id = clashed;
        Some(at)
    }

    pub(crate) fn set_bus_off(&mut self, plug: usize) {
        let plug = &mut self.plugs[plug];
        (plug.bus_off, plug.error_count, plug.sending) = (true, 0, false);
        plug.queue.clear();
        plug.clash_count = 0;
        (plug.status.is_waiting, plug.status.clash_id) = (false, None);
        plug.status.bus_off_count += 1;
        self.injected.bus_off += 1;
    }

    /// Pulls a plug's connector, or puts it in again.
    pub(crate) fn set_unplugged(&mut self, plug: usize, away: bool) {
        let plug = &mut self.plugs[plug];
        if plug.unplugged == away {
            return;
        }
        (plug.unplugged, plug.sending) = (away, false);
        plug.queue.clear();
        plug.status.is_waiting = false;
    }

    /// Time that a controller stays disconnected after it went bus-off.
    pub(crate) fn recovery_ns(&self) -> u64 {
        self.bits_ns(RECOVERY_BITS)
    }

    pub(crate) fn recover(&mut self, plug: usize) {
        self.plugs[plug].bus_off = false;
    }

    /// Share of `now` in which the bus was busy, 0 to 1.
    pub(crate) fn load(&self, now: Instant) -> f64 {
        let busy = self.bits_ns(self.busy_bits) as f64;
        if now == Instant::ZERO { 0.0 } else { busy / now.0 as f64 }
    }

    /// Time of `bits` bits, ns; 0 on a bus without bit timing.
    fn bits_ns(&self, bits: u64) -> u64 {
        bit_time_ns(bits, self.line.bit_rate)
    }
}

fn first_posted(plug: &CanPlug) -> Option<QueuedFrame> {
    plug.queue.front().copied()
}

fn hash_frame(frame: &Frame) -> u64 {
    let mut history = HistoryHash::default();
    history
        .add(u64::from(frame.id) << 2 | u64::from(frame.extended) << 1 | u64::from(frame.remote));
    history.add_bytes(frame.bytes());
    history.value()
}
