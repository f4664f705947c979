//! The CAN buses of a world.

use polepair_core::medium::Frame;
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use super::{
    EndId, NodeId, PlugOwner, PlugRole, Reception, ReceptionData, ScheduledEvent, StepResult,
    WireId, WireMedium, World,
};
use crate::can_bus::{
    CanBus, CanFaults, CanFrameLabel, CanPlugStatus, Delivery, InjectedCanFaults,
};

impl World {
    /// The faults of a CAN bus, to be changed at any time. `None` for a serial wire.
    pub fn can_faults(&mut self, wire: WireId) -> Option<&mut CanFaults> {
        self.can_bus(wire.0).map(|bus| &mut bus.faults)
    }

    /// The faults made so far on a CAN bus.
    #[must_use]
    pub fn injected_can_faults(&self, wire: WireId) -> InjectedCanFaults {
        match &self.wires[wire.0].medium {
            WireMedium::Can(bus) => bus.injected,
            WireMedium::Serial(_) => InjectedCanFaults::default(),
        }
    }

    /// The bit rate of a CAN bus; 0 for one without timing, and for a serial wire.
    #[must_use]
    pub fn bit_rate(&self, wire: WireId) -> u32 {
        match &self.wires[wire.0].medium {
            WireMedium::Can(bus) => bus.line.bit_rate,
            WireMedium::Serial(_) => 0,
        }
    }

    /// Load of a CAN bus since the beginning, 0 to 1; 0 for a serial wire.
    #[must_use]
    pub fn can_load(&self, wire: WireId) -> f64 {
        match &self.wires[wire.0].medium {
            WireMedium::Can(bus) => bus.load(self.now),
            WireMedium::Serial(_) => 0.0,
        }
    }

    /// Takes a node's controller off a CAN bus, as too many errors do. It comes back by itself
    /// after 128 times 11 bits.
    pub fn force_bus_off(&mut self, wire: WireId, node: NodeId) {
        let plug = self.plug_index(wire, node);
        if let (Some(plug), Some(bus)) = (plug, self.can_bus(wire.0)) {
            bus.set_bus_off(plug);
            self.begin_bus_off(wire.0, plug);
        }
    }

    /// Pulls a node's connector from a CAN bus, or puts it in again. The node itself gets no notice: it has power and a
    /// controller that receives nothing.
    pub fn set_unplugged(&mut self, wire: WireId, node: NodeId, away: bool) {
        let plug = self.plug_index(wire, node);
        if let (Some(plug), Some(bus)) = (plug, self.can_bus(wire.0)) {
            bus.set_unplugged(plug, away);
            self.poll_node(node.0);
        }
    }

    /// Plugs an intruder into a CAN bus, which belongs to no host and no drive: results of its frames are marked.
    pub fn plug_intruder(&mut self, wire: WireId, node: NodeId) {
        self.plug(wire, PlugOwner::Node(node.0, 0), PlugRole::Intruder);
    }

    /// State of a node's place on a CAN bus; `None` without one.
    #[must_use]
    pub fn can_status(&self, wire: WireId, node: NodeId) -> Option<CanPlugStatus> {
        let plug = self.plug_index(wire, node)?;
        match &self.wires[wire.0].medium {
            WireMedium::Can(bus) => Some(bus.plug_status(plug)),
            WireMedium::Serial(_) => None,
        }
    }

    /// Sends a frame from an outside end at `now`, or at the world's time if that is later. It
    /// waits for those before it.
    pub fn send_frame(&mut self, end: EndId, now: Instant, frame: &Frame) {
        self.run_until(now);
        let end = end.0;
        if !self.ends[end].queue_frame(frame) {
            self.ends[end].dropped += 1;
        }
        self.poll_outside(end);
    }

    /// Takes the next frame that arrived at an outside end, and when it did.
    pub fn receive_frame(&mut self, end: EndId) -> Option<(Instant, Frame)> {
        self.ends[end.0].pop_frame()
    }

    pub(super) fn finish_frame(&mut self, wire: usize) -> StepResult {
        let now = self.now;
        let WireMedium::Can(bus) = &mut self.wires[wire].medium else { return StepResult::Nothing };
        if let Some((frame, mark)) = bus.finish_frame() {
            self.history.add(u64::from(frame.id));
            self.history.add_bytes(frame.bytes());
            for to in 0..self.wires[wire].plugs.len() {
                let Some(bus) = self.can_bus(wire) else { continue };
                match bus.deliver_to(to, now, &frame, &mark) {
                    Delivery::Missed => {}
                    Delivery::Immediate(frame) => self.deliver_frame(wire, to, &frame, mark),
                    Delivery::Delayed(at) => {
                        self.queue.push(at, ScheduledEvent::DelayedFrame(wire, to))
                    }
                }
            }
        } else {
            while let Some(plug) = self.can_bus(wire).and_then(CanBus::next_bus_off) {
                self.begin_bus_off(wire, plug);
            }
        }
        self.poll_plugs(wire);
        self.start_frame(wire);
        StepResult::Arrival(WireId(wire))
    }

    /// An adapter hands over what it held back.
    pub(super) fn deliver_delayed(&mut self, wire: usize, plug: usize) -> StepResult {
        if let Some((frame, mark)) = self.can_bus(wire).and_then(|bus| bus.pop_delayed(plug)) {
            self.deliver_frame(wire, plug, &frame, mark);
        }
        StepResult::Arrival(WireId(wire))
    }

    fn deliver_frame(&mut self, wire: usize, plug: usize, frame: &Frame, mark: CanFrameLabel) {
        if let WireMedium::Can(bus) = &mut self.wires[wire].medium {
            bus.record_received(plug, mark);
        }
        let (node, port) = match self.wires[wire].plugs[plug] {
            PlugOwner::Outside(end) => return self.ends[end].push_frame(self.now, frame),
            PlugOwner::Node(node, port) => (node, port),
        };
        if let Some(log) = &mut self.log {
            let (at, wire, by) = (self.now, WireId(wire), Some(NodeId(node)));
            let carried = ReceptionData::Frame(*frame, mark);
            log.push(Reception { at, wire, node: by, data: carried });
        }
        if let Some(station) = self.nodes[node].node.can(port) {
            station.handle_input(self.now, frame);
        }
        if let WireMedium::Can(bus) = &mut self.wires[wire].medium {
            bus.begin_answering(plug);
        }
        self.poll_node(node);
    }

    /// Lets everybody on a CAN bus speak.
    fn poll_plugs(&mut self, wire: usize) {
        for at in 0..self.wires[wire].plugs.len() {
            match self.wires[wire].plugs[at] {
                PlugOwner::Node(node, _) => self.poll_node(node),
                PlugOwner::Outside(end) => self.poll_outside(end),
            }
        }
    }

    pub(super) fn start_frame(&mut self, wire: usize) -> StepResult {
        let WireMedium::Can(bus) = &mut self.wires[wire].medium else { return StepResult::Nothing };
        if let Some(end) = bus.start_frame(self.now) {
            self.queue.push(end, ScheduledEvent::FrameEnd(wire));
        }
        StepResult::Nothing
    }

    /// Notifies a station that its controller left the bus, and schedules its return.
    fn begin_bus_off(&mut self, wire: usize, plug: usize) {
        let WireMedium::Can(bus) = &mut self.wires[wire].medium else { return };
        self.queue
            .push(self.now.plus_ns(bus.recovery_ns()), ScheduledEvent::BusOffRecovery(wire, plug));
        self.notify_plug(wire, plug, LineEvent::BusOff);
    }

    pub(super) fn end_bus_off(&mut self, wire: usize, plug: usize) -> StepResult {
        let WireMedium::Can(bus) = &mut self.wires[wire].medium else { return StepResult::Nothing };
        bus.recover(plug);
        self.notify_plug(wire, plug, LineEvent::Up);
        if let PlugOwner::Outside(end) = self.wires[wire].plugs[plug] {
            self.poll_outside(end);
        }
        StepResult::Arrival(WireId(wire))
    }

    fn can_bus(&mut self, wire: usize) -> Option<&mut CanBus> {
        match &mut self.wires[wire].medium {
            WireMedium::Can(bus) => Some(bus),
            WireMedium::Serial(_) => None,
        }
    }

    /// Lets a node fill its controller.
    pub(super) fn poll_can(&mut self, node: usize, port: u8, wire: usize, plug: usize) {
        let WireMedium::Can(bus) = &mut self.wires[wire].medium else { return };
        let mut frame = Frame::default();
        let mut empty = false;
        while bus.has_room(plug) && !empty {
            let Some(station) = self.nodes[node].node.can(port) else { return };
            empty = station.poll_transmit(self.now, &mut frame).is_none();
            if empty {
                break;
            }
            self.last_tag = self.last_tag.wrapping_add(1);
            if bus.enqueue(plug, self.now, self.last_tag, frame) {
                self.queue.push(self.now, ScheduledEvent::FrameStart(wire));
            }
        }
        bus.end_answering(plug, empty);
    }

    /// Returns whether a node has a controller that takes nothing more.
    pub(super) fn has_full_controller(&self, node: usize) -> bool {
        self.nodes[node].plugs.iter().any(|&(wire, plug, _)| match &self.wires[wire].medium {
            WireMedium::Can(bus) => !bus.has_room(plug),
            WireMedium::Serial(_) => false,
        })
    }

    fn poll_outside(&mut self, end: usize) {
        let (wire, plug) = self.ends[end].plug;
        let WireMedium::Can(bus) = &mut self.wires[wire].medium else { return };
        if !bus.has_room(plug) {
            return;
        }
        let Some(frame) = self.ends[end].pop_to_send() else { return };
        self.last_tag = self.last_tag.wrapping_add(1);
        if bus.enqueue(plug, self.now, self.last_tag, frame) {
            self.queue.push(self.now, ScheduledEvent::FrameStart(wire));
        }
    }
}
