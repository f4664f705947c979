//! The CAN buses of a world.

use polepair_core::medium::Frame;
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use super::{Carried, Due, EndId, Happening, Heard, Kind, NodeId, Party, Role, WireId, World};
use crate::can_bus::{CanBus, CanFaults, CanMade, Mark, Reach, Standing};

impl World {
    /// The faults of a CAN bus, to be changed at any time. `None` for a serial wire.
    pub fn can_faults(&mut self, wire: WireId) -> Option<&mut CanFaults> {
        self.can_bus(wire.0).map(|bus| &mut bus.faults)
    }

    /// The faults made so far on a CAN bus.
    #[must_use]
    pub fn can_made(&self, wire: WireId) -> CanMade {
        match &self.wires[wire.0].kind {
            Kind::Can(bus) => bus.made,
            Kind::Serial(_) => CanMade::default(),
        }
    }

    /// The bit rate of a CAN bus; 0 for one without timing, and for a serial wire.
    #[must_use]
    pub fn bit_rate(&self, wire: WireId) -> u32 {
        match &self.wires[wire.0].kind {
            Kind::Can(bus) => bus.line.bit_rate,
            Kind::Serial(_) => 0,
        }
    }

    /// How busy a CAN bus was since the beginning, 0 to 1; 0 for a serial wire.
    #[must_use]
    pub fn can_load(&self, wire: WireId) -> f64 {
        match &self.wires[wire.0].kind {
            Kind::Can(bus) => bus.load(self.now),
            Kind::Serial(_) => 0.0,
        }
    }

    /// Takes a node's controller off a CAN bus, as too many errors do. It comes back by itself
    /// after 128 times 11 bits.
    pub fn switch_off(&mut self, wire: WireId, node: NodeId) {
        let plug = self.place_of(wire, node);
        if let (Some(plug), Some(bus)) = (plug, self.can_bus(wire.0)) {
            bus.switch_off(plug);
            self.bus_off(wire.0, plug);
        }
    }

    /// Pulls a node's connector from a CAN bus, or puts it in again. The node itself is not told:
    /// it has power and a controller that hears nothing.
    pub fn pull(&mut self, wire: WireId, node: NodeId, away: bool) {
        let plug = self.place_of(wire, node);
        if let (Some(plug), Some(bus)) = (plug, self.can_bus(wire.0)) {
            bus.pull(plug, away);
            self.drain(node.0);
        }
    }

    /// Plugs somebody into a CAN bus who belongs to nobody here: what comes of his frames is marked.
    pub fn plug_stranger(&mut self, wire: WireId, node: NodeId) {
        self.plug(wire, Party::Node(node.0, 0), Role::Stranger);
    }

    /// What the world knows about a node's place on a CAN bus; `None` where it has none.
    #[must_use]
    pub fn standing(&self, wire: WireId, node: NodeId) -> Option<Standing> {
        let plug = self.place_of(wire, node)?;
        match &self.wires[wire.0].kind {
            Kind::Can(bus) => Some(bus.standing(plug)),
            Kind::Serial(_) => None,
        }
    }

    /// Sends a frame from an outside end at `now`, or at the world's time if that is later. It
    /// waits for those before it.
    pub fn send_frame(&mut self, end: EndId, now: Instant, frame: &Frame) {
        self.run_until(now);
        let end = end.0;
        if !self.ends[end].post(frame) {
            self.ends[end].dropped += 1;
        }
        self.drain_outside(end);
    }

    /// Takes the next frame that arrived at an outside end, and when it did.
    pub fn receive_frame(&mut self, end: EndId) -> Option<(Instant, Frame)> {
        self.ends[end.0].take_frame()
    }

    pub(super) fn frame_arrives(&mut self, wire: usize) -> Happening {
        let now = self.now;
        let Kind::Can(bus) = &mut self.wires[wire].kind else { return Happening::Nothing };
        if let Some((frame, mark)) = bus.finish() {
            self.history.note(u64::from(frame.id));
            self.history.note_bytes(frame.bytes());
            for to in 0..self.wires[wire].plugs.len() {
                let Some(bus) = self.can_bus(wire) else { continue };
                match bus.reaches(to, now, &frame, &mark) {
                    Reach::Not => {}
                    Reach::Now(frame) => self.hand_frame(wire, to, &frame, mark),
                    Reach::Later(at) => self.queue.push(at, Due::Late(wire, to)),
                }
            }
        } else {
            while let Some(plug) = self.can_bus(wire).and_then(CanBus::next_off) {
                self.bus_off(wire, plug);
            }
        }
        self.drain_plugs(wire);
        self.start_frame(wire);
        Happening::Arrival(WireId(wire))
    }

    /// An adapter hands over what it held back.
    pub(super) fn late_arrives(&mut self, wire: usize, plug: usize) -> Happening {
        if let Some((frame, mark)) = self.can_bus(wire).and_then(|bus| bus.held_back(plug)) {
            self.hand_frame(wire, plug, &frame, mark);
        }
        Happening::Arrival(WireId(wire))
    }

    fn hand_frame(&mut self, wire: usize, plug: usize, frame: &Frame, mark: Mark) {
        if let Kind::Can(bus) = &mut self.wires[wire].kind {
            bus.take(plug, mark);
        }
        let (node, port) = match self.wires[wire].plugs[plug] {
            Party::Outside(end) => return self.ends[end].put_frame(self.now, frame),
            Party::Node(node, port) => (node, port),
        };
        if let Some(log) = &mut self.log {
            let (at, wire, by) = (self.now, WireId(wire), Some(NodeId(node)));
            let carried = Carried::Frame(*frame, mark);
            log.push(Heard { at, wire, by, carried });
        }
        if let Some(station) = self.nodes[node].node.can(port) {
            station.handle_input(self.now, frame);
        }
        if let Kind::Can(bus) = &mut self.wires[wire].kind {
            bus.listens(plug);
        }
        self.drain(node);
    }

    /// Lets everybody on a CAN bus speak.
    fn drain_plugs(&mut self, wire: usize) {
        for at in 0..self.wires[wire].plugs.len() {
            match self.wires[wire].plugs[at] {
                Party::Node(node, _) => self.drain(node),
                Party::Outside(end) => self.drain_outside(end),
            }
        }
    }

    pub(super) fn start_frame(&mut self, wire: usize) -> Happening {
        let Kind::Can(bus) = &mut self.wires[wire].kind else { return Happening::Nothing };
        if let Some(end) = bus.start(self.now) {
            self.queue.push(end, Due::Frame(wire));
        }
        Happening::Nothing
    }

    /// Tells a station that its controller left the bus, and notes when it comes back.
    fn bus_off(&mut self, wire: usize, plug: usize) {
        let Kind::Can(bus) = &mut self.wires[wire].kind else { return };
        self.queue.push(self.now.plus_ns(bus.recovery_ns()), Due::Recovery(wire, plug));
        self.tell_one(wire, plug, LineEvent::BusOff);
    }

    pub(super) fn recover(&mut self, wire: usize, plug: usize) -> Happening {
        let Kind::Can(bus) = &mut self.wires[wire].kind else { return Happening::Nothing };
        bus.switch_on(plug);
        self.tell_one(wire, plug, LineEvent::Up);
        if let Party::Outside(end) = self.wires[wire].plugs[plug] {
            self.drain_outside(end);
        }
        Happening::Arrival(WireId(wire))
    }

    fn can_bus(&mut self, wire: usize) -> Option<&mut CanBus> {
        match &mut self.wires[wire].kind {
            Kind::Can(bus) => Some(bus),
            Kind::Serial(_) => None,
        }
    }

    /// Lets a node fill its controller.
    pub(super) fn drain_can(&mut self, node: usize, port: u8, (wire, plug): (usize, usize)) {
        let Kind::Can(bus) = &mut self.wires[wire].kind else { return };
        let mut frame = Frame::default();
        let mut empty = false;
        while bus.has_room(plug) && !empty {
            let Some(station) = self.nodes[node].node.can(port) else { return };
            empty = station.poll_transmit(self.now, &mut frame).is_none();
            if empty {
                break;
            }
            self.tags = self.tags.wrapping_add(1);
            if bus.offer(plug, self.now, self.tags, frame) {
                self.queue.push(self.now, Due::Start(wire));
            }
        }
        bus.spoke(plug, empty);
    }

    /// Whether a node has a controller that takes nothing more.
    pub(super) fn is_held_up(&self, node: usize) -> bool {
        self.nodes[node].plugs.iter().any(|&(wire, plug, _)| match &self.wires[wire].kind {
            Kind::Can(bus) => !bus.has_room(plug),
            Kind::Serial(_) => false,
        })
    }

    fn drain_outside(&mut self, end: usize) {
        let (wire, plug) = self.ends[end].place;
        let Kind::Can(bus) = &mut self.wires[wire].kind else { return };
        if !bus.has_room(plug) {
            return;
        }
        let Some(frame) = self.ends[end].next_to_send() else { return };
        self.tags = self.tags.wrapping_add(1);
        if bus.offer(plug, self.now, self.tags, frame) {
            self.queue.push(self.now, Due::Start(wire));
        }
    }
}
