//! Drives, hosts and wires under one virtual clock.
//!
//! A world advances from event to event: bytes arrive, a station's time has come. It never waits
//! and never asks for the time, so that it goes as fast as the processor does, or, with a caller
//! who sleeps until [`World::next_event`], as fast as real motors. Equal seeds give equal histories,
//! which [`World::history`] proves.
//!
//! ```
//! use polepair_core::time::Instant;
//! use polepair_sim::{serial_line::Serial, world::World};
//! let mut world = World::new(1);
//! let wire = world.serial(Serial::RS485);
//! let end = world.open(wire);
//! world.send(end, Instant::ZERO, &[1, 2, 3]);
//! world.run_until(Instant::ZERO.plus_ms(10));
//! assert_eq!(world.now(), Instant::ZERO.plus_ms(10));
//! ```

mod can;
mod outside;

use polepair_core::medium::{CanLine, Frame, MediumKind, STREAM_UNIT_MAX, SerialLine};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use crate::can_bus::{CanBus, Mark, Role};
use crate::fault::{Faults, Made};
use crate::node::Node;
use crate::queue::Queue;
use crate::random::{History, Random};
use crate::serial_line::{Air, Ears, Label, Memory, Serial, SerialWire};
use outside::Outside;

/// Transmissions that one station may make in answer to one event.
const TRANSMISSIONS_MAX: usize = 64;
/// Events that may happen at one instant before whoever wants more time is made to wait.
const SAME_INSTANT_MAX: u32 = 1_000;
/// How long such a node waits.
const SPIN_PAUSE_NS: u64 = 1_000_000;
/// How long a node waits that wants to send, while its CAN controller takes nothing more; unless
/// that has room before.
const HELD_UP_NS: u64 = 1_000_000;

/// A node of a world.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct NodeId(usize);

/// A wire of a world.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct WireId(usize);

/// An end of a wire that is held outside of the world: by a link, a pty, a test.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct EndId(usize);

/// What the last step did.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Happening {
    /// A node's time came.
    Time(NodeId),
    /// Something arrived at the other ends of a wire.
    Arrival(WireId),
    /// Nothing: an appointment that was moved meanwhile.
    Nothing,
}

/// What the world knows about one end of a serial wire and its station does not: see [`Label`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Knowledge {
    /// What it sent last.
    pub sent: Label,
    /// What it heard last.
    pub heard: Label,
    /// What it heard last of others: not its own bytes, which an adapter may hand back.
    pub heard_others: Label,
}

/// What somebody heard.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Heard {
    /// When it had arrived.
    pub at: Instant,
    /// On which wire.
    pub wire: WireId,
    /// Who; `None` for an outside end.
    pub by: Option<NodeId>,
    /// What it was.
    pub carried: Carried,
}

/// Bytes or a frame, and what the world knows of them.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Carried {
    /// Bytes on a serial wire.
    Bytes(Vec<u8>, Label),
    /// A frame on a CAN bus.
    Frame(Frame, Mark),
}

impl std::fmt::Display for Carried {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Bytes(bytes, Label { tag, answers, tainted, .. }) => {
                let changed = if *tainted { " changed" } else { "" };
                write!(f, "{bytes:02X?} = {tag} to {answers}{changed}")
            }
            Self::Frame(frame, mark) => {
                let strange = if mark.strange { " strange" } else { "" };
                let copy = if mark.copy { " again" } else { "" };
                write!(f, "{frame} = {}", mark.tag)?;
                mark.answers.map_or(Ok(()), |(tag, _)| write!(f, " to {tag}"))?;
                write!(f, "{strange}{copy}")
            }
        }
    }
}

/// Drives, hosts and wires under one virtual clock.
pub struct World {
    now: Instant,
    queue: Queue<Due>,
    nodes: Vec<Slot>,
    wires: Vec<Wire>,
    ends: Vec<Outside>,
    air: Air,
    random: Random,
    history: History,
    events: u64,
    same_instant: u32,
    spins: u64,
    tags: u32,
    log: Option<Vec<Heard>>,
    buffer: Vec<u8>,
    heard: Vec<u8>,
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (nodes, wires) = (self.nodes.len(), self.wires.len());
        write!(f, "World {{ now: {:?}, nodes: {nodes}, wires: {wires} }}", self.now)
    }
}

impl World {
    /// An empty world. Whatever is random in it comes from `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            now: Instant::ZERO,
            queue: Queue::new(),
            nodes: Vec::new(),
            wires: Vec::new(),
            ends: Vec::new(),
            air: Air::default(),
            random: Random::new(seed),
            history: History::default(),
            events: 0,
            same_instant: 0,
            spins: 0,
            tags: 0,
            log: None,
            buffer: vec![0; STREAM_UNIT_MAX],
            heard: Vec::with_capacity(STREAM_UNIT_MAX),
        }
    }

    /// The world's time.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Events so far.
    #[must_use]
    pub const fn events(&self) -> u64 {
        self.events
    }

    /// A hash over everything that happened: equal for equal seeds, on every platform.
    #[must_use]
    pub const fn history(&self) -> u64 {
        self.history.value()
    }

    /// How often a node was made to wait because it wanted time again and again at one instant.
    /// Anything but zero is a fault of that node: on a real link it would keep a processor busy.
    #[must_use]
    pub const fn spins(&self) -> u64 {
        self.spins
    }

    /// Begins to keep what everybody hears, for [`World::take_log`].
    pub fn keep_log(&mut self) {
        self.log = Some(Vec::new());
    }

    /// What everybody heard since this was last called.
    pub fn take_log(&mut self) -> Vec<Heard> {
        self.log.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Adds a serial wire.
    pub fn serial(&mut self, set: Serial) -> WireId {
        let random = self.random.fork();
        self.wires.push(Wire {
            plugs: Vec::new(),
            kind: Kind::Serial(Box::new(SerialWire::new(set, random))),
        });
        WireId(self.wires.len() - 1)
    }

    /// Adds a CAN bus.
    pub fn can(&mut self, line: CanLine) -> WireId {
        self.wires.push(Wire {
            plugs: Vec::new(),
            kind: Kind::Can(Box::new(CanBus::new(line, self.random.fork()))),
        });
        WireId(self.wires.len() - 1)
    }

    /// What a wire carries.
    #[must_use]
    pub fn medium(&self, wire: WireId) -> MediumKind {
        match self.wires[wire.0].kind {
            Kind::Serial(_) => MediumKind::Serial,
            Kind::Can(_) => MediumKind::Can,
        }
    }

    /// Adds a node, on no wire yet.
    pub fn add(&mut self, node: Box<dyn Node>) -> NodeId {
        self.nodes.push(Slot { node, plugs: Vec::new(), armed: Instant::FAR });
        let id = NodeId(self.nodes.len() - 1);
        self.arm(id.0);
        id
    }

    /// Plugs the host's end of `wire` into a node's port. On RS-232 everybody else hears the host
    /// only; an echoing adapter is the host's.
    pub fn plug_host(&mut self, wire: WireId, node: NodeId, port: u8) {
        self.plug(wire, Party::Node(node.0, port), Role::Host);
    }

    /// Plugs a drive's port into `wire`.
    pub fn plug_drive(&mut self, wire: WireId, node: NodeId, port: u8) {
        self.plug(wire, Party::Node(node.0, port), Role::Drive);
    }

    /// Takes the host's end of `wire` out of the world.
    pub fn open(&mut self, wire: WireId) -> EndId {
        self.ends.push(Outside::default());
        let end = self.ends.len() - 1;
        let plug = self.plug(wire, Party::Outside(end), Role::Host);
        self.ends[end].place = (wire.0, plug);
        EndId(end)
    }

    /// The faults of a serial wire, to be changed at any time. `None` for a CAN bus.
    pub fn faults(&mut self, wire: WireId) -> Option<&mut Faults> {
        self.serial_wire(wire).map(|serial| &mut serial.faults)
    }

    /// The faults made so far on a serial wire.
    #[must_use]
    pub fn made(&self, wire: WireId) -> Made {
        match &self.wires[wire.0].kind {
            Kind::Serial(serial) => serial.made,
            Kind::Can(_) => Made::default(),
        }
    }

    /// What the world knows about a node's place on a serial wire.
    #[must_use]
    pub fn knowledge(&self, wire: WireId, node: NodeId) -> Knowledge {
        let (at, wire) = (self.place_of(wire, node), &self.wires[wire.0]);
        match (&wire.kind, at) {
            (Kind::Serial(serial), Some(at)) => {
                let plug = &serial.plugs[at];
                Knowledge { sent: plug.sent, heard: plug.heard, heard_others: plug.heard_others }
            }
            _ => Knowledge::default(),
        }
    }

    /// The last bytes that a node heard on a serial wire, and how many of them, from the first on,
    /// it had heard before the last but one time it spoke.
    #[must_use]
    pub fn heard(&self, wire: WireId, node: NodeId) -> (&[u8], usize) {
        self.memory(wire, node).map_or((&[], 0), |memory| (&memory.bytes, memory.fresh()))
    }

    /// Whether these of the [bytes that a node heard](World::heard) are what the transmission they
    /// came in was meant to be.
    #[must_use]
    pub fn was_meant(&self, wire: WireId, node: NodeId, range: std::ops::Range<usize>) -> bool {
        self.memory(wire, node).is_some_and(|memory| memory.was_meant(range))
    }

    /// Cuts a wire or joins it again, and tells every station on it, if that changes anything.
    /// Returns whether it does.
    pub fn cut(&mut self, wire: WireId, down: bool) -> bool {
        let is_down = match &mut self.wires[wire.0].kind {
            Kind::Serial(serial) => &mut serial.down,
            Kind::Can(bus) => &mut bus.down,
        };
        let changes = std::mem::replace(is_down, down) != down;
        if changes {
            self.tell(wire.0, if down { LineEvent::Down } else { LineEvent::Up });
        }
        changes
    }

    /// Lends a node to `f`, for commands, acts and looks, and then lets the node speak.
    pub fn with<R>(&mut self, node: NodeId, f: impl FnOnce(&mut dyn Node, Instant) -> R) -> R {
        let result = f(&mut *self.nodes[node.0].node, self.now);
        self.drain(node.0);
        result
    }

    /// Lends a node to `f`, for what gives it nothing to say.
    pub fn look<R>(&mut self, node: NodeId, f: impl FnOnce(&mut dyn Node, Instant) -> R) -> R {
        f(&mut *self.nodes[node.0].node, self.now)
    }

    /// When something happens next.
    #[must_use]
    pub fn next_event(&self) -> Option<Instant> {
        self.queue.next_at()
    }

    /// Goes on to the next event. `None` when nothing will ever happen again.
    pub fn step(&mut self) -> Option<Happening> {
        let (at, due) = self.queue.pop()?;
        self.pass(at);
        Some(self.happen(due))
    }

    /// Goes on to `until`, through every event up to and including that instant.
    pub fn run_until(&mut self, until: Instant) {
        while self.next_event().is_some_and(|at| at <= until) {
            self.step();
        }
        self.now = self.now.max(until);
    }

    /// How the holder of an outside end drives the wire.
    pub fn set_line(&mut self, end: EndId, line: SerialLine) {
        self.ends[end.0].line = line;
    }

    /// Sends from an outside end at `now`, or at the world's time if that is later.
    pub fn send(&mut self, end: EndId, now: Instant, bytes: &[u8]) {
        self.run_until(now);
        let (place, line) = (self.ends[end.0].place, self.ends[end.0].line);
        for unit in bytes.chunks(STREAM_UNIT_MAX) {
            self.transmit(place, line, unit);
        }
    }

    /// Takes what arrived at an outside end into `buffer`: the number of bytes and when the last of
    /// them arrived. What one call returns arrived at one instant; `None` when nothing waits.
    pub fn receive(&mut self, end: EndId, buffer: &mut [u8]) -> Option<(Instant, usize)> {
        self.ends[end.0].take(buffer)
    }

    /// Whether something waits at an outside end.
    #[must_use]
    pub fn has_mail(&self, end: EndId) -> bool {
        self.ends[end.0].has_mail()
    }

    /// Bytes and frames that were dropped because nobody took them from an outside end.
    #[must_use]
    pub fn dropped(&self, end: EndId) -> u64 {
        self.ends[end.0].dropped
    }
}

/// What is scheduled.
#[derive(Clone, Copy, Debug)]
enum Due {
    Time(usize),
    Chunk(usize, Ears),
    Start(usize),
    Frame(usize),
    Late(usize, usize),
    Recovery(usize, usize),
}

struct Slot {
    node: Box<dyn Node>,
    plugs: Vec<(usize, usize, u8)>,
    /// The earliest appointment in the queue; those that it overtook are void.
    armed: Instant,
}

struct Wire {
    plugs: Vec<Party>,
    kind: Kind,
}

enum Kind {
    Serial(Box<SerialWire>),
    Can(Box<CanBus>),
}

#[derive(Clone, Copy, Debug)]
enum Party {
    Node(usize, u8),
    Outside(usize),
}

impl World {
    /// A node's place on a wire.
    fn place_of(&self, wire: WireId, node: NodeId) -> Option<usize> {
        let plugs = &self.wires[wire.0].plugs;
        plugs.iter().position(|p| matches!(p, Party::Node(n, _) if *n == node.0))
    }

    fn memory(&self, wire: WireId, node: NodeId) -> Option<&Memory> {
        let at = self.place_of(wire, node)?;
        match &self.wires[wire.0].kind {
            Kind::Serial(serial) => Some(&serial.plugs[at].memory),
            Kind::Can(_) => None,
        }
    }

    fn serial_wire(&mut self, wire: WireId) -> Option<&mut SerialWire> {
        match &mut self.wires[wire.0].kind {
            Kind::Serial(serial) => Some(serial),
            Kind::Can(_) => None,
        }
    }

    fn plug(&mut self, wire: WireId, party: Party, role: Role) -> usize {
        let at = match &mut self.wires[wire.0].kind {
            Kind::Serial(serial) => serial.plug(role == Role::Host),
            Kind::Can(bus) => bus.plug(role),
        };
        self.wires[wire.0].plugs.push(party);
        if let Party::Node(node, port) = party {
            self.nodes[node].plugs.push((wire.0, at, port));
            self.drain(node);
        }
        at
    }

    fn pass(&mut self, at: Instant) {
        self.same_instant = if at > self.now { 0 } else { self.same_instant + 1 };
        self.now = self.now.max(at);
        self.events += 1;
        self.history.note(self.now.0);
    }

    fn happen(&mut self, due: Due) -> Happening {
        match due {
            Due::Time(node) => self.time_came(node),
            Due::Chunk(at, ears) => self.chunk_arrives(at, ears),
            Due::Start(wire) => self.start_frame(wire),
            Due::Frame(wire) => self.frame_arrives(wire),
            Due::Late(wire, plug) => self.late_arrives(wire, plug),
            Due::Recovery(wire, plug) => self.recover(wire, plug),
        }
    }

    fn time_came(&mut self, node: usize) -> Happening {
        let slot = &mut self.nodes[node];
        if slot.armed != self.now {
            return Happening::Nothing;
        }
        slot.armed = Instant::FAR;
        if slot.node.poll_timeout().is_some_and(|at| at <= self.now) {
            slot.node.handle_timeout(self.now);
            self.drain(node);
        } else {
            self.arm(node);
        }
        Happening::Time(NodeId(node))
    }

    fn chunk_arrives(&mut self, at: usize, ears: Ears) -> Happening {
        let chunk = self.air.take(at);
        self.history.note_bytes(&chunk.bytes);
        for to in 0..self.wires[chunk.wire].plugs.len() {
            let party = self.wires[chunk.wire].plugs[to];
            let Kind::Serial(serial) = &mut self.wires[chunk.wire].kind else { continue };
            serial.land(at);
            let concerned = serial.hears(to, chunk.from) && ears.has(serial.plugs[to].head);
            if serial.down || !concerned {
                continue;
            }
            let line = match party {
                Party::Outside(end) => self.ends[end].line,
                Party::Node(node, port) => match self.nodes[node].node.stream(port) {
                    Some(station) => station.line(),
                    None => continue,
                },
            };
            let broken = serial.hear(to, self.now, &chunk, line, &mut self.heard);
            let label = serial.plugs[to].heard;
            if let Some(log) = &mut self.log {
                let by = match party {
                    Party::Node(node, _) => Some(NodeId(node)),
                    Party::Outside(_) => None,
                };
                let (at, wire) = (self.now, WireId(chunk.wire));
                let carried = Carried::Bytes(self.heard.clone(), label);
                log.push(Heard { at, wire, by, carried });
            }
            self.hand_over(party, broken);
        }
        let wire = chunk.wire;
        if ears.last() {
            self.air.give_back(at, chunk);
        } else {
            self.air.keep(at, chunk);
        }
        Happening::Arrival(WireId(wire))
    }

    /// Gives what was heard to whom it concerns.
    fn hand_over(&mut self, party: Party, broken: bool) {
        let (node, port) = match party {
            Party::Outside(end) => return self.ends[end].put(self.now, &self.heard),
            Party::Node(node, port) => (node, port),
        };
        if let Some(station) = self.nodes[node].node.stream(port) {
            if broken {
                station.handle_line(self.now, LineEvent::Break);
            }
            if !self.heard.is_empty() {
                station.handle_input(self.now, &self.heard);
            }
        }
        self.drain(node);
    }

    fn tell(&mut self, wire: usize, event: LineEvent) {
        for plug in 0..self.wires[wire].plugs.len() {
            self.tell_one(wire, plug, event);
        }
    }

    fn tell_one(&mut self, wire: usize, plug: usize, event: LineEvent) {
        let Party::Node(node, port) = self.wires[wire].plugs[plug] else { return };
        let (slot, now) = (&mut self.nodes[node].node, self.now);
        match &self.wires[wire].kind {
            Kind::Serial(_) => {
                slot.stream(port).into_iter().for_each(|s| s.handle_line(now, event))
            }
            Kind::Can(_) => slot.can(port).into_iter().for_each(|s| s.handle_line(now, event)),
        }
        self.drain(node);
    }

    /// Lets a node speak on all its wires, then notes when it next wants time.
    fn drain(&mut self, node: usize) {
        for at in 0..self.nodes[node].plugs.len() {
            let (wire, plug, port) = self.nodes[node].plugs[at];
            match self.wires[wire].kind {
                Kind::Serial(_) => self.drain_serial(node, port, (wire, plug)),
                Kind::Can(_) => self.drain_can(node, port, (wire, plug)),
            }
        }
        self.arm(node);
    }

    fn drain_serial(&mut self, node: usize, port: u8, place: (usize, usize)) {
        let mut buffer = std::mem::take(&mut self.buffer);
        for _ in 0..TRANSMISSIONS_MAX {
            let Some(station) = self.nodes[node].node.stream(port) else { break };
            let Some(len) = station.poll_transmit(self.now, &mut buffer) else { break };
            let line = station.line();
            self.transmit(place, line, &buffer[..len]);
        }
        self.buffer = buffer;
    }

    fn transmit(&mut self, place: (usize, usize), line: SerialLine, bytes: &[u8]) {
        let Kind::Serial(serial) = &mut self.wires[place.0].kind else { return };
        self.tags = self.tags.wrapping_add(1);
        let (tag, queue) = (self.tags, &mut self.queue);
        let schedule = |at, chunk, ears| queue.push(at, Due::Chunk(chunk, ears));
        serial.transmit(&mut self.air, self.now, place, tag, line, bytes, schedule);
    }

    fn arm(&mut self, node: usize) {
        let Some(wanted) = self.nodes[node].node.poll_timeout() else { return };
        let mut at = wanted.max(self.now);
        if at == self.now && self.same_instant > 0 && self.is_held_up(node) {
            at = self.now.plus_ns(HELD_UP_NS);
        }
        let slot = &mut self.nodes[node];
        if self.same_instant >= SAME_INSTANT_MAX && at == self.now {
            at = self.now.plus_ns(SPIN_PAUSE_NS);
            self.spins += 1;
        }
        if at < slot.armed {
            slot.armed = at;
            self.queue.push(at, Due::Time(node));
        }
    }
}
