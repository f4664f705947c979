//! A CAN bus: the lowest identifier wins, and every frame takes exactly its bits.
//!
//! Each plug is a controller with its frames in line and the transmit error counter of ISO 11898-1.
//! Two controllers that send the same identifier at once differ later, in a bit that one of them
//! finds overwritten: both fail, and as both try again, both end bus-off. Frames alike in every bit
//! are one frame to everybody.
//!
//! Every frame carries a [`Mark`] that no station sees: who sent it, and what it answers. Checks
//! compare what hosts believe with the marks.

mod fault;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use polepair_core::medium::{CanLine, Frame};
use polepair_core::time::Instant;

use crate::random::{History, Ppm, Random};
pub use fault::{CanFaults, CanMade};
pub use polepair_core::medium::bits;
use polepair_core::medium::bits::{arbitration, until_they_differ};

#[cfg(test)]
mod tests;

/// An error flag with those of the others behind it, and its delimiter.
const ERROR_BITS: u32 = 12 + 8;
/// What a failed transmission adds to the transmit error counter, and beyond what it is bus-off.
const ERROR_WEIGHT: u16 = 8;
const ERRORS_MAX: u16 = 255;
/// Recessive bits that a controller waits before it takes part again.
const RECOVERY_BITS: u64 = 128 * 11;
/// Frames that a host's controller holds, and a drive's: what is in line there cannot be called back.
const HOST_FRAMES_MAX: usize = 1;
const DRIVE_FRAMES_MAX: usize = 3;
/// Frames that an adapter holds back at most; beyond them they are lost.
pub(crate) const LATE_MAX: usize = 256;

/// Who has a controller on the bus.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum Role {
    /// The commanding end.
    #[default]
    Host,
    /// A drive: what it sends while it takes a frame answers that frame.
    Drive,
    /// Who belongs to nobody here.
    Stranger,
}

/// What the world knows of a frame and no station sees.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Mark {
    /// Number of the frame; 0 for none.
    pub tag: u32,
    /// Hash of identifier and payload as they were meant.
    pub content: u64,
    /// Its identifier, and whether that has 29 bits.
    pub id: (u32, bool),
    /// Place of its sender on the bus.
    pub from: usize,
    /// The frame that it answers, and the content of that; `None` for what is said unasked, and where
    /// the world cannot tell.
    pub answers: Option<(u32, u64)>,
    /// A stranger sent it, or what it answers.
    pub strange: bool,
    /// It is taken a second time, or answers what was.
    pub copy: bool,
    /// What it answers is not known: its sender's controller was full.
    pub unsure: bool,
    /// Bits that it takes at least.
    pub bits: u32,
}

/// What the world knows about one node's place on a CAN bus and the node does not.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Standing {
    /// Place on the bus, as in [`Mark::from`].
    pub plug: usize,
    /// What it heard last.
    pub heard: Mark,
    /// How many frames it heard.
    pub count: u64,
    /// What it handed to its controller last, and when.
    pub sent: Mark,
    /// See [`sent`](Self::sent).
    pub since: Instant,
    /// Something waits in its controller.
    pub waits: bool,
    /// Frames of its own that others took twice.
    pub doubled: u64,
    /// Frames of hosts that it did not get, or not whole.
    pub missed: u64,
    /// How often its controller went bus-off.
    pub off: u64,
    /// It last did because another host had a frame of this identifier and other data in the very same
    /// instants, from the first try to the last.
    pub clashed: Option<(u32, bool)>,
    /// Strangers' frames that it took and that may have been meant for it.
    pub misled: u64,
}

/// A CAN bus with its nodes' frames waiting.
#[derive(Debug)]
pub(crate) struct CanBus {
    pub(crate) line: CanLine,
    pub(crate) faults: CanFaults,
    pub(crate) made: CanMade,
    pub(crate) down: bool,
    random: Random,
    plugs: Vec<Plug>,
    sending: Option<Sending>,
    /// An appointment to start is made: until then whoever has something to say joins in.
    starting: bool,
    /// Bits that were on the wire so far.
    busy_bits: u64,
    /// The drives that answered frames of an identifier, and the identifiers that drives send.
    obeyed: BTreeMap<(u32, bool), Vec<usize>>,
    spoken: BTreeSet<(u32, bool)>,
}

/// One controller.
#[derive(Debug, Default)]
struct Plug {
    role: Role,
    waiting: VecDeque<Posted>,
    sending: bool,
    errors: u16,
    /// How many of its last transmissions, running, ended in that of another host.
    clashes: u16,
    off: bool,
    /// Its connector is pulled.
    away: bool,
    /// What it is taking now: what it sends meanwhile answers that.
    hearing: Option<Mark>,
    /// Its station may hold frames back whose cause is no longer known.
    unsure: bool,
    late: VecDeque<(Instant, Frame, Mark)>,
    standing: Standing,
}

/// A frame in a controller.
#[derive(Clone, Copy, Debug)]
struct Posted {
    frame: Frame,
    mark: Mark,
    /// Others took it already.
    taken: bool,
}

/// What is on the wire.
#[derive(Clone, Copy, Debug)]
struct Sending {
    frame: Frame,
    mark: Mark,
    end: End,
    /// Two hosts sent it, and other data.
    clash: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum End {
    Good,
    Twice,
    Destroyed,
}

/// What becomes of a frame at one plug.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Reach {
    Not,
    Now(Frame),
    Later(Instant),
}

impl CanBus {
    pub(crate) fn new(line: CanLine, random: Random) -> Self {
        Self {
            line,
            faults: CanFaults::default(),
            made: CanMade::default(),
            down: false,
            random,
            plugs: Vec::new(),
            sending: None,
            starting: false,
            busy_bits: 0,
            obeyed: BTreeMap::new(),
            spoken: BTreeSet::new(),
        }
    }

    pub(crate) fn plug(&mut self, role: Role) -> usize {
        let plug = self.plugs.len();
        let standing = Standing { plug, ..Standing::default() };
        self.plugs.push(Plug { role, standing, ..Plug::default() });
        plug
    }

    pub(crate) fn standing(&self, plug: usize) -> Standing {
        self.plugs[plug].standing
    }

    /// Whether a plug's controller can take a frame.
    pub(crate) fn has_room(&self, plug: usize) -> bool {
        let Plug { role, waiting, off, away, .. } = &self.plugs[plug];
        let most = if *role == Role::Drive { DRIVE_FRAMES_MAX } else { HOST_FRAMES_MAX };
        waiting.len() < most && !off && !away
    }

    /// What a plug sends from here on answers the frame that it heard last.
    pub(crate) fn listens(&mut self, plug: usize) {
        let plug = &mut self.plugs[plug];
        plug.hearing = Some(plug.standing.heard);
    }

    /// What a plug sends from here on answers nothing. `empty` says that its station has no more to
    /// say now.
    pub(crate) fn spoke(&mut self, plug: usize, empty: bool) {
        let plug = &mut self.plugs[plug];
        plug.unsure = !empty && (plug.unsure || plug.hearing.is_some());
        plug.hearing = None;
    }

    /// Puts a frame into a plug's controller. Returns whether to [`start`](Self::start) is now to
    /// be arranged for, at the end of this instant: what is ready by then arbitrates.
    pub(crate) fn offer(&mut self, plug: usize, now: Instant, tag: u32, frame: Frame) -> bool {
        let mark = self.mark(plug, tag, &frame);
        let plug = &mut self.plugs[plug];
        (plug.standing.sent, plug.standing.since, plug.standing.waits) = (mark, now, true);
        plug.waiting.push_back(Posted { frame, mark, taken: false });
        let arrange = !self.starting && self.sending.is_none();
        self.starting |= arrange;
        arrange
    }

    fn mark(&mut self, from: usize, tag: u32, frame: &Frame) -> Mark {
        let Plug { role, hearing, unsure, .. } = &self.plugs[from];
        let cause = hearing.filter(|_| *role == Role::Drive && !unsure);
        let id = (frame.id, frame.extended);
        if *role == Role::Drive {
            self.spoken.insert(id);
            if let Some(asked) = cause {
                let who = self.obeyed.entry(asked.id).or_default();
                who.extend((!who.contains(&from)).then_some(from));
            }
        }
        Mark {
            tag,
            content: hash(frame),
            id,
            from,
            answers: cause.map(|mark| (mark.tag, mark.content)),
            strange: *role == Role::Stranger || cause.is_some_and(|mark| mark.strange),
            copy: cause.is_some_and(|mark| mark.copy),
            unsure: *unsure,
            bits: bits::nominal(frame.extended, frame.bytes().len() as u32),
        }
    }

    /// Starts the frame that wins. Returns when it will have ended.
    pub(crate) fn start(&mut self, now: Instant) -> Option<Instant> {
        self.starting = false;
        let first = |plug: &Plug| plug.waiting.front().copied();
        let won = self.plugs.iter().filter_map(first).min_by_key(|p| arbitration(&p.frame))?;
        let Posted { frame, mark, .. } = won;
        let (mut bits, mut end) = (bits::on_wire(&frame), End::Good);
        for plug in &mut self.plugs {
            let rival = first(plug).map(|posted| posted.frame);
            let rival = rival.filter(|other| arbitration(other) == arbitration(&frame));
            plug.sending = rival.is_some();
            if let Some(rival) = rival.filter(|rival| *rival != frame) {
                end = End::Destroyed;
                bits = bits.min(until_they_differ(&frame, &rival) + ERROR_BITS + bits::INTERFRAME);
            }
        }
        let hosts = self.plugs.iter().filter(|plug| plug.sending && plug.role == Role::Host);
        let clash = end == End::Destroyed && hosts.count() > 1;
        if end == End::Destroyed {
            self.made.collided += 1;
        } else if self.random.chance(self.faults.error) {
            end = End::Destroyed;
            bits = 1 + self.random.below(bits.into()) as u32 + ERROR_BITS + bits::INTERFRAME;
        } else if self.random.chance(self.faults.twice) {
            (end, bits) = (End::Twice, bits + ERROR_BITS);
        }
        self.sending = Some(Sending { frame, mark, end, clash });
        self.busy_bits += u64::from(bits);
        Some(now.plus_ns(self.bits_ns(bits.into())))
    }

    /// Ends what is on the wire: the frame if it arrived. When all have heard it,
    /// [`start`](Self::start) the next.
    pub(crate) fn finish(&mut self) -> Option<(Frame, Mark)> {
        let Sending { frame, mark, end, clash } = self.sending.take()?;
        self.starting = true;
        for plug in self.plugs.iter_mut().filter(|plug| plug.sending) {
            let again = plug.waiting.front().is_some_and(|posted| posted.taken);
            let clashed = clash && plug.role == Role::Host;
            plug.clashes = if clashed { plug.clashes + 1 } else { 0 };
            plug.standing.doubled += u64::from(again && end != End::Destroyed);
            if end == End::Good {
                plug.waiting.pop_front();
                plug.errors = plug.errors.saturating_sub(1);
                plug.standing.waits = !plug.waiting.is_empty();
                continue;
            }
            plug.errors += ERROR_WEIGHT;
            if end == End::Twice
                && let Some(posted) = plug.waiting.front_mut()
            {
                (posted.taken, posted.mark.copy) = (true, true);
            }
        }
        match end {
            End::Good => {}
            End::Twice => self.made.twice += 1,
            End::Destroyed => self.made.errors += 1,
        }
        let strange = self.plugs[mark.from].role == Role::Stranger && end != End::Destroyed;
        self.made.strange += u64::from(strange);
        (end != End::Destroyed).then_some((frame, mark))
    }

    /// What a plug hears of the frame that has just ended, and when.
    pub(crate) fn reaches(&mut self, to: usize, now: Instant, frame: &Frame, mark: &Mark) -> Reach {
        let plug = &self.plugs[to];
        let host = plug.role == Role::Host;
        let own = plug.sending && !(host && self.faults.echo && mark.from == to);
        if own {
            return Reach::Not;
        }
        let deaf = self.down || plug.off || plug.away;
        let lost = !deaf && self.random.chance(self.faults.lose);
        self.made.lost += u64::from(lost);
        let whole = self.cut(to, *frame, mark);
        let missed = deaf || lost || whole.len < frame.len;
        let of_host = self.plugs[mark.from].role == Role::Host;
        self.plugs[to].standing.missed += u64::from(missed && of_host);
        if deaf || lost { Reach::Not } else { self.hold_back(to, now, whole, mark) }
    }

    /// Keeps a frame back, if the fault hits it or another waits already.
    fn hold_back(&mut self, to: usize, now: Instant, frame: Frame, mark: &Mark) -> Reach {
        let roles = (self.plugs[mark.from].role, self.plugs[to].role);
        let late = roles == (Role::Drive, Role::Host) && self.random.chance(self.faults.late);
        self.made.late += u64::from(late);
        let lateness = u64::from(self.faults.latest_ms) * 1_000_000 * u64::from(late);
        let waiting = &mut self.plugs[to].late;
        let at = now.plus_ns(self.random.below(lateness));
        let at = waiting.back().map_or(at, |(before, ..)| at.max(*before));
        if at == now {
            return Reach::Now(frame);
        }
        if waiting.len() == LATE_MAX {
            self.made.lost += 1;
            return Reach::Not;
        }
        waiting.push_back((at, frame, *mark));
        Reach::Later(at)
    }

    /// The frame that a plug's adapter has held back until now.
    pub(crate) fn held_back(&mut self, plug: usize) -> Option<(Frame, Mark)> {
        let (_, frame, mark) = self.plugs[plug].late.pop_front()?;
        Some((frame, mark)).filter(|_| !self.down && !self.plugs[plug].away)
    }

    /// The same frame, or a shorter one where it is meant for that plug and the fault hits it.
    fn cut(&mut self, to: usize, mut frame: Frame, mark: &Mark) -> Frame {
        if self.faults.cut == Ppm::NEVER {
            return frame;
        }
        let meant = match self.plugs[to].role {
            Role::Host => self.plugs[mark.from].role == Role::Drive,
            Role::Drive => self.obeyed.get(&mark.id).is_some_and(|who| who.contains(&to)),
            Role::Stranger => false,
        };
        if meant && frame.len > 0 && self.random.chance(self.faults.cut) {
            frame.len = self.random.below(frame.len.into()) as u8;
            frame.data[usize::from(frame.len)..].fill(0);
            self.made.cut += 1;
        }
        frame
    }

    /// Notes what a plug takes now.
    pub(crate) fn take(&mut self, to: usize, mark: Mark) {
        let plug = &mut self.plugs[to];
        plug.standing.heard = mark;
        plug.standing.count += 1;
        if mark.strange && plug.role == Role::Drive {
            let unknown = !self.spoken.contains(&mark.id);
            let meant = self.obeyed.get(&mark.id).map_or(unknown, |who| who.contains(&to));
            plug.standing.misled += u64::from(meant);
        }
    }

    /// Takes the next plug off the bus whose errors are too many.
    pub(crate) fn next_off(&mut self) -> Option<usize> {
        let at = self.plugs.iter().position(|plug| plug.errors > ERRORS_MAX)?;
        let plug = &self.plugs[at];
        let clashed = plug.clashes * ERROR_WEIGHT > ERRORS_MAX;
        let clashed = plug.waiting.front().filter(|_| clashed).map(|posted| posted.mark.id);
        self.switch_off(at);
        self.plugs[at].standing.clashed = clashed;
        Some(at)
    }

    pub(crate) fn switch_off(&mut self, plug: usize) {
        let plug = &mut self.plugs[plug];
        (plug.off, plug.errors, plug.sending) = (true, 0, false);
        plug.waiting.clear();
        plug.clashes = 0;
        (plug.standing.waits, plug.standing.clashed) = (false, None);
        plug.standing.off += 1;
        self.made.off += 1;
    }

    /// Pulls a plug's connector, or puts it in again.
    pub(crate) fn pull(&mut self, plug: usize, away: bool) {
        let plug = &mut self.plugs[plug];
        if plug.away == away {
            return;
        }
        (plug.away, plug.sending) = (away, false);
        plug.waiting.clear();
        plug.standing.waits = false;
    }

    /// How long a controller stays away after it went bus-off.
    pub(crate) fn recovery_ns(&self) -> u64 {
        self.bits_ns(RECOVERY_BITS)
    }

    pub(crate) fn switch_on(&mut self, plug: usize) {
        self.plugs[plug].off = false;
    }

    /// How much of `now` the bus was busy, 0 to 1.
    pub(crate) fn load(&self, now: Instant) -> f64 {
        let busy = self.bits_ns(self.busy_bits) as f64;
        if now == Instant::ZERO { 0.0 } else { busy / now.0 as f64 }
    }

    /// Nanoseconds that so many bits take; 0 on a bus without bit timing.
    fn bits_ns(&self, bits: u64) -> u64 {
        (bits * 1_000_000_000).checked_div(self.line.bit_rate.into()).unwrap_or(0)
    }
}

fn hash(frame: &Frame) -> u64 {
    let mut history = History::default();
    history
        .note(u64::from(frame.id) << 2 | u64::from(frame.extended) << 1 | u64::from(frame.remote));
    history.note_bytes(frame.bytes());
    history.value()
}
