//! Drives, hosts and wires under one virtual clock.
//!
//! A world advances from event to event: bytes arrive, a station's time has come. It never waits
//! and never asks for the time, so that it goes as fast as the processor does, or, with a caller
//! who sleeps until [`World::next_event`], as fast as real motors. Equal seeds give equal histories,
//! which [`World::history`] proves.
//!
//! ```
//! use polepair_core::time::Instant;
//! use polepair_sim::{serial_line::SerialWireConfig, world::World};
//! let mut world = World::new(1);
//! let wire = world.add_serial(SerialWireConfig::RS485);
//! let end = world.open_end(wire);
//! world.send(end, Instant::ZERO, &[1, 2, 3]);
//! world.run_until(Instant::ZERO.plus_ms(10));
//! assert_eq!(world.now(), Instant::ZERO.plus_ms(10));
//! ```

mod can;
mod outside_end;

use polepair_core::medium::{CanLine, Frame, MediumKind, STREAM_UNIT_MAX, SerialLine};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use crate::can_bus::{CanBus, CanFrameLabel, PlugRole};
use crate::fault::{InjectedSerialFaults, SerialFaults};
use crate::node::SimNode;
use crate::random::{HistoryHash, Random};
use crate::serial_line::{
    ChunkPool, ReceiveHistory, Receivers, SerialWire, SerialWireConfig, TransmissionLabel,
};
use crate::timed_queue::TimedQueue;
use outside_end::OutsideEnd;

/// Transmissions that one station may make in answer to one event.
const TRANSMISSIONS_MAX: usize = 64;
/// Events at one instant before a node that wants more time must wait.
const SAME_INSTANT_MAX: u32 = 1_000;
/// Pause of such a node, ns.
const BUSY_LOOP_PAUSE_NS: u64 = 1_000_000;
/// Pause of a node that wants to send while its CAN controller is full; shorter if that has room before.
const CONTROLLER_FULL_NS: u64 = 1_000_000;

/// A node of a world.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct NodeId(usize);

/// A wire of a world.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct WireId(usize);

/// An end of a wire that is held outside of the world: by a link, a pty, a test.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct EndId(usize);

/// Result of the last step.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StepResult {
    /// A node's time came.
    NodeTimeout(NodeId),
    /// Something arrived at the other ends of a wire.
    Arrival(WireId),
    /// Nothing: an appointment that was moved meanwhile.
    Nothing,
}

/// Facts on one end of a serial wire that the world knows and its station does not: see [`TransmissionLabel`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SerialPlugStatus {
    /// Label of the last sent transmission.
    pub last_sent: TransmissionLabel,
    /// Label of the last received transmission.
    pub last_received: TransmissionLabel,
    /// The last received transmission of others: not its own bytes, which an adapter may return.
    pub last_from_others: TransmissionLabel,
}

/// A reception of a station.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Reception {
    /// Time of arrival.
    pub at: Instant,
    /// On which wire.
    pub wire: WireId,
    /// The receiver; `None` for an outside end.
    pub node: Option<NodeId>,
    /// The received data.
    pub data: ReceptionData,
}

/// Bytes or a frame, and what the world knows of them.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum ReceptionData {
    /// Bytes on a serial wire.
    Bytes(Vec<u8>, TransmissionLabel),
    /// A frame on a CAN bus.
    Frame(Frame, CanFrameLabel),
}

impl std::fmt::Display for ReceptionData {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Bytes(bytes, TransmissionLabel { tag, answers, tainted, .. }) => {
                let changed = if *tainted { " changed" } else { "" };
                write!(f, "{bytes:02X?} = {tag} to {answers}{changed}")
            }
            Self::Frame(frame, mark) => {
                let strange = if mark.from_intruder { " strange" } else { "" };
                let copy = if mark.is_copy { " again" } else { "" };
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
    queue: TimedQueue<ScheduledEvent>,
    nodes: Vec<NodeSlot>,
    wires: Vec<WorldWire>,
    ends: Vec<OutsideEnd>,
    chunks: ChunkPool,
    random: Random,
    history: HistoryHash,
    events: u64,
    same_instant: u32,
    busy_loops: u64,
    last_tag: u32,
    log: Option<Vec<Reception>>,
    send_buffer: Vec<u8>,
    receive_buffer: Vec<u8>,
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
            queue: TimedQueue::new(),
            nodes: Vec::new(),
            wires: Vec::new(),
            ends: Vec::new(),
            chunks: ChunkPool::default(),
            random: Random::new(seed),
            history: HistoryHash::default(),
            events: 0,
            same_instant: 0,
            busy_loops: 0,
            last_tag: 0,
            log: None,
            send_buffer: vec![0; STREAM_UNIT_MAX],
            receive_buffer: Vec::with_capacity(STREAM_UNIT_MAX),
        }
    }

    /// The world's time.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Number of events so far.
    #[must_use]
    pub const fn events(&self) -> u64 {
        self.events
    }

    /// A hash over everything that happened: equal for equal seeds, on every platform.
    #[must_use]
    pub const fn history(&self) -> u64 {
        self.history.value()
    }

    /// Number of times a node had to wait because it wanted time again and again at one instant. Anything but zero is a
    /// fault of that node: on a real link it would keep a processor busy.
    #[must_use]
    pub const fn busy_loops(&self) -> u64 {
        self.busy_loops
    }

    /// Begins to record receptions, for [`World::take_log`].
    pub fn enable_log(&mut self) {
        self.log = Some(Vec::new());
    }

    /// Takes the receptions since the last call.
    pub fn take_log(&mut self) -> Vec<Reception> {
        self.log.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Adds a serial wire.
    pub fn add_serial(&mut self, set: SerialWireConfig) -> WireId {
        // A source of its own: what one wire draws does not change what the next one draws, so a seed keeps
        // its meaning when a wire is added behind it.
        let random = self.random.fork();
        self.wires.push(WorldWire {
            plugs: Vec::new(),
            medium: WireMedium::Serial(Box::new(SerialWire::new(set, random))),
        });
        WireId(self.wires.len() - 1)
    }

    /// Adds a CAN bus.
    pub fn add_can(&mut self, line: CanLine) -> WireId {
        self.wires.push(WorldWire {
            plugs: Vec::new(),
            medium: WireMedium::Can(Box::new(CanBus::new(line, self.random.fork()))),
        });
        WireId(self.wires.len() - 1)
    }

    /// Medium of a wire.
    #[must_use]
    pub fn medium(&self, wire: WireId) -> MediumKind {
        match self.wires[wire.0].medium {
            WireMedium::Serial(_) => MediumKind::Serial,
            WireMedium::Can(_) => MediumKind::Can,
        }
    }

    /// Adds a node, on no wire yet.
    pub fn add_node(&mut self, node: Box<dyn SimNode>) -> NodeId {
        self.nodes.push(NodeSlot { node, plugs: Vec::new(), timer_at: Instant::FAR_FUTURE });
        let id = NodeId(self.nodes.len() - 1);
        self.schedule_timeout(id.0);
        id
    }

    /// Plugs the host's end of `wire` into a node's port. On RS-232 all others receive from the host only; an echoing
    /// adapter is the host's.
    pub fn plug_host(&mut self, wire: WireId, node: NodeId, port: u8) {
        self.plug(wire, PlugOwner::Node(node.0, port), PlugRole::Host);
    }

    /// Plugs a drive's port into `wire`.
    pub fn plug_drive(&mut self, wire: WireId, node: NodeId, port: u8) {
        self.plug(wire, PlugOwner::Node(node.0, port), PlugRole::Drive);
    }

    /// Takes the host's end of `wire` out of the world.
    pub fn open_end(&mut self, wire: WireId) -> EndId {
        self.ends.push(OutsideEnd::default());
        let end = self.ends.len() - 1;
        let plug = self.plug(wire, PlugOwner::Outside(end), PlugRole::Host);
        self.ends[end].plug = (wire.0, plug);
        EndId(end)
    }

    /// The faults of a serial wire, to be changed at any time. `None` for a CAN bus.
    pub fn serial_faults(&mut self, wire: WireId) -> Option<&mut SerialFaults> {
        self.serial_wire(wire).map(|serial| &mut serial.faults)
    }

    /// The faults made so far on a serial wire.
    #[must_use]
    pub fn injected_faults(&self, wire: WireId) -> InjectedSerialFaults {
        match &self.wires[wire.0].medium {
            WireMedium::Serial(serial) => serial.injected,
            WireMedium::Can(_) => InjectedSerialFaults::default(),
        }
    }

    /// State of a node's place on a serial wire.
    #[must_use]
    pub fn serial_status(&self, wire: WireId, node: NodeId) -> SerialPlugStatus {
        let (at, wire) = (self.plug_index(wire, node), &self.wires[wire.0]);
        match (&wire.medium, at) {
            (WireMedium::Serial(serial), Some(at)) => {
                let plug = &serial.plugs[at];
                SerialPlugStatus {
                    last_sent: plug.last_sent,
                    last_received: plug.last_received,
                    last_from_others: plug.last_from_others,
                }
            }
            _ => SerialPlugStatus::default(),
        }
    }

    /// The last bytes that a node received on a serial wire, and the number of them, from the first on, that it had
    /// received before its last transmission but one.
    #[must_use]
    pub fn received_bytes(&self, wire: WireId, node: NodeId) -> (&[u8], usize) {
        self.receive_history(wire, node)
            .map_or((&[], 0), |memory| (&memory.bytes, memory.fresh_from()))
    }

    /// Returns whether these of the [received bytes](World::received_bytes) are what the transmission they came in was
    /// meant to be.
    #[must_use]
    pub fn is_as_sent(&self, wire: WireId, node: NodeId, range: std::ops::Range<usize>) -> bool {
        self.receive_history(wire, node).is_some_and(|memory| memory.is_as_sent(range))
    }

    /// Cuts a wire or joins it again, and notifies every station on it of a change. Returns whether it changed.
    pub fn set_wire_down(&mut self, wire: WireId, down: bool) -> bool {
        let is_down = match &mut self.wires[wire.0].medium {
            WireMedium::Serial(serial) => &mut serial.down,
            WireMedium::Can(bus) => &mut bus.down,
        };
        let changes = std::mem::replace(is_down, down) != down;
        if changes {
            self.notify_wire(wire.0, if down { LineEvent::Down } else { LineEvent::Up });
        }
        changes
    }

    /// Lends a node to `f`, for commands, acts and looks, and then lets the node speak.
    pub fn with_node<R>(
        &mut self,
        node: NodeId,
        f: impl FnOnce(&mut dyn SimNode, Instant) -> R,
    ) -> R {
        // The node is polled afterwards: the caller may have given it something to send.
        let result = f(&mut *self.nodes[node.0].node, self.now);
        self.poll_node(node.0);
        result
    }

    /// Lends a node to `f`, for access that makes it send nothing.
    pub fn inspect<R>(
        &mut self,
        node: NodeId,
        f: impl FnOnce(&mut dyn SimNode, Instant) -> R,
    ) -> R {
        f(&mut *self.nodes[node.0].node, self.now)
    }

    /// Time of the next event.
    #[must_use]
    pub fn next_event(&self) -> Option<Instant> {
        self.queue.next_time()
    }

    /// Goes on to the next event. `None` when nothing will ever happen again.
    pub fn step(&mut self) -> Option<StepResult> {
        let (at, due) = self.queue.pop()?;
        self.advance_to(at);
        Some(self.process_event(due))
    }

    /// Goes on to `until`, through every event up to and including that instant.
    pub fn run_until(&mut self, until: Instant) {
        while self.next_event().is_some_and(|at| at <= until) {
            self.step();
        }
        self.now = self.now.max(until);
    }

    /// Sets the line of an outside end.
    pub fn set_line(&mut self, end: EndId, line: SerialLine) {
        self.ends[end.0].line = line;
    }

    /// Sends from an outside end at `now`, or at the world's time if that is later.
    pub fn send(&mut self, end: EndId, now: Instant, bytes: &[u8]) {
        self.run_until(now);
        let (position, line) = (self.ends[end.0].plug, self.ends[end.0].line);
        for unit in bytes.chunks(STREAM_UNIT_MAX) {
            self.transmit(position, line, unit);
        }
    }

    /// Takes what arrived at an outside end into `buffer`: the number of bytes and when the last of
    /// them arrived. What one call returns arrived at one instant; `None` when nothing waits.
    pub fn receive(&mut self, end: EndId, buffer: &mut [u8]) -> Option<(Instant, usize)> {
        self.ends[end.0].read_bytes(buffer)
    }

    /// Returns whether something waits at an outside end.
    #[must_use]
    pub fn has_pending(&self, end: EndId) -> bool {
        self.ends[end.0].has_pending()
    }

    /// Number of bytes and frames that were dropped because an outside end was not read.
    #[must_use]
    pub fn dropped(&self, end: EndId) -> u64 {
        self.ends[end.0].dropped
    }
}

/// A scheduled event.
#[derive(Clone, Copy, Debug)]
enum ScheduledEvent {
    NodeTimeout(usize),
    ChunkEnd(usize, Receivers),
    FrameStart(usize),
    FrameEnd(usize),
    DelayedFrame(usize, usize),
    BusOffRecovery(usize, usize),
}

struct NodeSlot {
    node: Box<dyn SimNode>,
    plugs: Vec<(usize, usize, u8)>,
    /// The earliest appointment in the queue; those that it overtook are void.
    timer_at: Instant,
}

struct WorldWire {
    plugs: Vec<PlugOwner>,
    medium: WireMedium,
}

enum WireMedium {
    Serial(Box<SerialWire>),
    Can(Box<CanBus>),
}

#[derive(Clone, Copy, Debug)]
enum PlugOwner {
    Node(usize, u8),
    Outside(usize),
}

impl World {
    /// A node's place on a wire.
    fn plug_index(&self, wire: WireId, node: NodeId) -> Option<usize> {
        let plugs = &self.wires[wire.0].plugs;
        plugs.iter().position(|p| matches!(p, PlugOwner::Node(n, _) if *n == node.0))
    }

    fn receive_history(&self, wire: WireId, node: NodeId) -> Option<&ReceiveHistory> {
        let at = self.plug_index(wire, node)?;
        match &self.wires[wire.0].medium {
            WireMedium::Serial(serial) => Some(&serial.plugs[at].history),
            WireMedium::Can(_) => None,
        }
    }

    fn serial_wire(&mut self, wire: WireId) -> Option<&mut SerialWire> {
        match &mut self.wires[wire.0].medium {
            WireMedium::Serial(serial) => Some(serial),
            WireMedium::Can(_) => None,
        }
    }

    fn plug(&mut self, wire: WireId, party: PlugOwner, role: PlugRole) -> usize {
        let at = match &mut self.wires[wire.0].medium {
            WireMedium::Serial(serial) => serial.add_plug(role == PlugRole::Host),
            WireMedium::Can(bus) => bus.add_plug(role),
        };
        self.wires[wire.0].plugs.push(party);
        if let PlugOwner::Node(node, port) = party {
            self.nodes[node].plugs.push((wire.0, at, port));
            self.poll_node(node);
        }
        at
    }

    fn advance_to(&mut self, at: Instant) {
        debug_assert!(at >= self.now, "time runs backwards");
        self.same_instant = if at > self.now { 0 } else { self.same_instant + 1 };
        self.now = self.now.max(at);
        self.events += 1;
        self.history.add(self.now.0);
    }

    fn process_event(&mut self, due: ScheduledEvent) -> StepResult {
        match due {
            ScheduledEvent::NodeTimeout(node) => self.handle_timeout(node),
            ScheduledEvent::ChunkEnd(at, receivers) => self.deliver_chunk(at, receivers),
            ScheduledEvent::FrameStart(wire) => self.start_frame(wire),
            ScheduledEvent::FrameEnd(wire) => self.finish_frame(wire),
            ScheduledEvent::DelayedFrame(wire, plug) => self.deliver_delayed(wire, plug),
            ScheduledEvent::BusOffRecovery(wire, plug) => self.end_bus_off(wire, plug),
        }
    }

    fn handle_timeout(&mut self, node: usize) -> StepResult {
        let slot = &mut self.nodes[node];
        // The queue has no removal: a timer that was set anew leaves its old entry behind.
        if slot.timer_at != self.now {
            return StepResult::Nothing;
        }
        slot.timer_at = Instant::FAR_FUTURE;
        if slot.node.poll_timeout().is_some_and(|at| at <= self.now) {
            slot.node.handle_timeout(self.now);
            self.poll_node(node);
        } else {
            self.schedule_timeout(node);
        }
        StepResult::NodeTimeout(NodeId(node))
    }

    fn deliver_chunk(&mut self, at: usize, receivers: Receivers) -> StepResult {
        let chunk = self.chunks.take_chunk(at);
        self.history.add_bytes(&chunk.bytes);
        for to in 0..self.wires[chunk.wire].plugs.len() {
            let party = self.wires[chunk.wire].plugs[to];
            let WireMedium::Serial(serial) = &mut self.wires[chunk.wire].medium else { continue };
            // Out of flight first: later bytes cannot collide with it any more.
            serial.remove_in_flight(at);
            let concerned =
                serial.can_hear(to, chunk.from) && receivers.includes(serial.plugs[to].is_host);
            if serial.down || !concerned {
                continue;
            }
            let line = match party {
                PlugOwner::Outside(end) => self.ends[end].line,
                PlugOwner::Node(node, port) => match self.nodes[node].node.stream(port) {
                    Some(station) => station.line(),
                    // A node without this port is deaf on it.
                    None => continue,
                },
            };
            let broken = serial.receive_chunk(to, self.now, &chunk, line, &mut self.receive_buffer);
            let label = serial.plugs[to].last_received;
            if let Some(log) = &mut self.log {
                let by = match party {
                    PlugOwner::Node(node, _) => Some(NodeId(node)),
                    PlugOwner::Outside(_) => None,
                };
                let (at, wire) = (self.now, WireId(chunk.wire));
                let carried = ReceptionData::Bytes(self.receive_buffer.clone(), label);
                log.push(Reception { at, wire, node: by, data: carried });
            }
            self.deliver_bytes(party, broken);
        }
        let wire = chunk.wire;
        if receivers.is_final() {
            self.chunks.release(at, chunk);
        } else {
            self.chunks.restore_bytes(at, chunk);
        }
        StepResult::Arrival(WireId(wire))
    }

    /// Gives received bytes to their station.
    fn deliver_bytes(&mut self, party: PlugOwner, broken: bool) {
        let (node, port) = match party {
            PlugOwner::Outside(end) => {
                return self.ends[end].push_bytes(self.now, &self.receive_buffer);
            }
            PlugOwner::Node(node, port) => (node, port),
        };
        if let Some(station) = self.nodes[node].node.stream(port) {
            // The break comes first: it spoils what a receiver had collected of the frame before.
            if broken {
                station.handle_line(self.now, LineEvent::Break);
            }
            if !self.receive_buffer.is_empty() {
                station.handle_input(self.now, &self.receive_buffer);
            }
        }
        self.poll_node(node);
    }

    fn notify_wire(&mut self, wire: usize, event: LineEvent) {
        for plug in 0..self.wires[wire].plugs.len() {
            self.notify_plug(wire, plug, event);
        }
    }

    fn notify_plug(&mut self, wire: usize, plug: usize, event: LineEvent) {
        let PlugOwner::Node(node, port) = self.wires[wire].plugs[plug] else { return };
        let (slot, now) = (&mut self.nodes[node].node, self.now);
        match &self.wires[wire].medium {
            WireMedium::Serial(_) => {
                slot.stream(port).into_iter().for_each(|s| s.handle_line(now, event))
            }
            WireMedium::Can(_) => {
                slot.can(port).into_iter().for_each(|s| s.handle_line(now, event))
            }
        }
        self.poll_node(node);
    }

    /// Lets a node speak on all its wires, then notes when it next wants time.
    fn poll_node(&mut self, node: usize) {
        for at in 0..self.nodes[node].plugs.len() {
            let (wire, plug, port) = self.nodes[node].plugs[at];
            match self.wires[wire].medium {
                WireMedium::Serial(_) => self.poll_serial(node, port, (wire, plug)),
                WireMedium::Can(_) => self.poll_can(node, port, wire, plug),
            }
        }
        self.schedule_timeout(node);
    }

    fn poll_serial(&mut self, node: usize, port: u8, position: (usize, usize)) {
        // Taken out of `self` for the time of the loop, to spare an allocation for each transmission.
        let mut buffer = std::mem::take(&mut self.send_buffer);
        for _ in 0..TRANSMISSIONS_MAX {
            let Some(station) = self.nodes[node].node.stream(port) else { break };
            let Some(len) = station.poll_transmit(self.now, &mut buffer) else { break };
            let line = station.line();
            self.transmit(position, line, &buffer[..len]);
        }
        self.send_buffer = buffer;
    }

    fn transmit(&mut self, position: (usize, usize), line: SerialLine, bytes: &[u8]) {
        let WireMedium::Serial(serial) = &mut self.wires[position.0].medium else { return };
        self.last_tag = self.last_tag.wrapping_add(1);
        let (tag, queue) = (self.last_tag, &mut self.queue);
        let schedule =
            |at, chunk, receivers| queue.push(at, ScheduledEvent::ChunkEnd(chunk, receivers));
        serial.transmit(&mut self.chunks, self.now, position, tag, line, bytes, schedule);
    }

    fn schedule_timeout(&mut self, node: usize) {
        let Some(wanted) = self.nodes[node].node.poll_timeout() else { return };
        let mut at = wanted.max(self.now);
        if at == self.now && self.same_instant > 0 && self.has_full_controller(node) {
            // It wants to send and cannot: asked again at this instant it would give the same answer.
            at = self.now.plus_ns(CONTROLLER_FULL_NS);
        }
        let slot = &mut self.nodes[node];
        if self.same_instant >= SAME_INSTANT_MAX && at == self.now {
            // A node that asks for the same instant for ever would stop the time of the whole world.
            at = self.now.plus_ns(BUSY_LOOP_PAUSE_NS);
            self.busy_loops += 1;
        }
        // A later wish needs no entry: the earlier one asks the node again.
        if at < slot.timer_at {
            slot.timer_at = at;
            self.queue.push(at, ScheduledEvent::NodeTimeout(node));
        }
    }
}
