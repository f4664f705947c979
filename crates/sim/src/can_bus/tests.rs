//! The bus with stations that do nothing but talk and listen.

use std::sync::{Arc, Mutex};

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;

use super::CanFaults;
use super::bits::{bits_until_difference, wire_bits as bits_on_wire};
use crate::node::CanStationNode;
use crate::random::{Ppm, Random};
use crate::world::{NodeId, WireId, World};

const BUS: CanLine = CanLine { bit_rate: 500_000 };

/// A station that sends its frames one by one and keeps all that it receives.
#[derive(Debug)]
struct ScriptedStation {
    to_send: Vec<Frame>,
    received: ReceptionRecord,
}

#[derive(Clone, Debug, Default)]
struct ReceptionRecord(Arc<Mutex<(Vec<Frame>, Vec<LineEvent>)>>);

impl ReceptionRecord {
    fn ids(&self) -> Vec<u32> {
        self.0.lock().expect("one thread").0.iter().map(|frame| frame.id).collect()
    }

    fn events(&self) -> Vec<LineEvent> {
        self.0.lock().expect("one thread").1.clone()
    }
}

impl Timed for ScriptedStation {
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

impl Station<Can> for ScriptedStation {
    fn handle_input(&mut self, _: Instant, frame: &Frame) {
        self.received.0.lock().expect("one thread").0.push(*frame);
    }
    fn handle_line(&mut self, _: Instant, event: LineEvent) {
        self.received.0.lock().expect("one thread").1.push(event);
    }
    fn poll_transmit(&mut self, _: Instant, out: &mut Frame) -> Option<usize> {
        *out = self.to_send.pop()?;
        Some(1)
    }
    fn line(&self) -> CanLine {
        BUS
    }
}

/// Plugs in who sends these frames, the last one first.
fn plug(world: &mut World, bus: WireId, to_send: Vec<Frame>) -> (NodeId, ReceptionRecord) {
    let seen = ReceptionRecord::default();
    let node = world
        .add_node(Box::new(CanStationNode(ScriptedStation { to_send, received: seen.clone() })));
    world.plug_drive(bus, node, 0);
    (node, seen)
}

fn data(id: u16, byte: u8) -> Frame {
    Frame::standard(id, &[byte, 2])
}

#[test]
fn the_lowest_identifier_of_frames_ready_at_one_instant_goes_first() {
    let mut world = World::new(1);
    let bus = world.add_can(BUS);
    plug(&mut world, bus, vec![data(0x300, 1), data(0x100, 1)]);
    plug(&mut world, bus, vec![data(0x200, 1), data(0x050, 1)]);
    let (_, seen) = plug(&mut world, bus, vec![]);
    world.run_until(Instant::ZERO.plus_ms(10));
    assert_eq!(seen.ids(), [0x050, 0x100, 0x200, 0x300]);
    let bits: u32 = [0x050, 0x100, 0x200, 0x300].map(|id| bits_on_wire(&data(id, 1))).iter().sum();
    let load = f64::from(bits) / 5_000.0;
    assert!((world.can_load(bus) - load).abs() < 1e-9, "{} of {load}", world.can_load(bus));
}

#[test]
fn equal_frames_at_once_are_one_frame() {
    let mut world = World::new(1);
    let bus = world.add_can(BUS);
    let (_, first) = plug(&mut world, bus, vec![data(0x101, 7)]);
    plug(&mut world, bus, vec![data(0x101, 7)]);
    let (_, seen) = plug(&mut world, bus, vec![]);
    world.run_until(Instant::ZERO.plus_ms(10));
    assert_eq!((seen.ids(), first.ids()), (vec![0x101], vec![]));
}

#[test]
fn one_identifier_with_different_data_at_once_puts_both_senders_off_the_bus() {
    let mut world = World::new(1);
    let bus = world.add_can(BUS);
    let (_, first) = plug(&mut world, bus, vec![data(0x101, 1)]);
    let (_, second) = plug(&mut world, bus, vec![data(0x101, 2)]);
    let (_, other) = plug(&mut world, bus, vec![data(0x700, 1)]);
    let (_, seen) = plug(&mut world, bus, vec![]);
    world.run_until(Instant::ZERO.plus_ms(100));
    // 32 failures of 8 each are more than 255; then the others get a word in.
    assert_eq!(
        (world.injected_can_faults(bus).collided, world.injected_can_faults(bus).bus_off),
        (32, 2)
    );
    assert_eq!((seen.ids(), other.ids()), (vec![0x700], vec![]));
    for talker in [first, second] {
        assert_eq!(talker.events(), [LineEvent::BusOff, LineEvent::Up]);
    }
}

/// An excuse for a program whose link is lost: another had the same identifier at each of its attempts
/// (swarm seed can:216699).
#[test]
fn two_hosts_that_cause_each_others_bus_off_are_identified() {
    let mut world = World::new(1);
    let bus = world.add_can(BUS);
    let talker = |world: &mut World, byte| {
        let to_send = vec![data(0, byte)];
        world.add_node(Box::new(CanStationNode(ScriptedStation {
            to_send,
            received: ReceptionRecord::default(),
        })))
    };
    let hosts = [1, 3].map(|byte| talker(&mut world, byte));
    hosts.iter().for_each(|host| world.plug_host(bus, *host, 0));
    let drives = [1, 2].map(|byte| plug(&mut world, bus, vec![data(0x101, byte)]).0);
    world.run_until(Instant::ZERO.plus_ms(200));
    let standing = |node| world.can_status(bus, node).expect("on the bus");
    for (node, clashed) in hosts
        .map(|host| (host, Some((0, false))))
        .into_iter()
        .chain(drives.map(|drive| (drive, None)))
    {
        assert_eq!(
            (standing(node).bus_off_count, standing(node).clash_id),
            (1, clashed),
            "{node:?}"
        );
    }
    let host = hosts[0];
    world.force_bus_off(bus, host);
    assert_eq!(world.can_status(bus, host).and_then(|standing| standing.clash_id), None);
}

#[test]
fn a_disturbed_frame_is_repeated_until_it_arrives() {
    let mut world = World::new(3);
    let bus = world.add_can(BUS);
    let frames: Vec<Frame> = (0..100).rev().map(|n| data(0x100 + n, 1)).collect();
    plug(&mut world, bus, frames);
    let (_, seen) = plug(&mut world, bus, vec![]);
    world.can_faults(bus).expect("a bus").error = Ppm(300_000);
    world.run_until(Instant::ZERO.plus_ms(1_000));
    assert_eq!(seen.ids(), (0x100..0x164).collect::<Vec<_>>());
    assert!(world.injected_can_faults(bus).errors > 20);
}

#[test]
fn a_frame_disturbed_in_its_last_bit_is_taken_twice() {
    let mut world = World::new(3);
    let bus = world.add_can(BUS);
    *world.can_faults(bus).expect("a bus") =
        CanFaults { last_bit: Ppm(200_000), ..CanFaults::default() };
    plug(&mut world, bus, (0..50).map(|n| data(0x100 + n, 1)).collect());
    let (_, seen) = plug(&mut world, bus, vec![]);
    world.run_until(Instant::ZERO.plus_ms(1_000));
    let (ids, twice) = (seen.ids(), world.injected_can_faults(bus).taken_twice);
    assert!(twice > 2 && ids.len() as u64 == 50 + twice, "{} and {twice}", ids.len());
    assert!(ids.is_sorted_by(|a, b| a >= b), "a repetition follows at once");
}

#[test]
fn a_controller_that_is_switched_off_hears_nothing_and_comes_back() {
    let mut world = World::new(3);
    let bus = world.add_can(BUS);
    let end = world.open_end(bus);
    let (node, seen) = plug(&mut world, bus, vec![]);
    world.force_bus_off(bus, node);
    world.send_frame(end, Instant::ZERO, &data(0x100, 1));
    world.run_until(Instant::ZERO.plus_ms(1));
    assert_eq!((seen.ids(), seen.events()), (vec![], vec![LineEvent::BusOff]));
    // 1408 bits.
    world.run_until(Instant::ZERO.plus_ms(3));
    world.send_frame(end, world.now(), &data(0x101, 1));
    world.run_until(Instant::ZERO.plus_ms(4));
    assert_eq!((seen.ids(), seen.events()), (vec![0x101], vec![LineEvent::BusOff, LineEvent::Up]));
}

#[test]
fn outside_ends_send_and_receive() {
    let mut world = World::new(1);
    let bus = world.add_can(BUS);
    let (_, seen) = plug(&mut world, bus, vec![data(0x300, 1), data(0x300, 2)]);
    let ends = [world.open_end(bus), world.open_end(bus)];
    for id in [0x500, 0x400] {
        world.send_frame(ends[0], Instant::ZERO, &data(id, 3));
    }
    world.run_until(Instant::ZERO.plus_ms(10));
    // Bytes of an outside end keep their order.
    assert_eq!(seen.ids(), [0x500, 0x400]);
    let mut received = |end| {
        std::iter::from_fn(|| world.receive_frame(end)).map(|(_, f)| f.id).collect::<Vec<_>>()
    };
    assert_eq!(
        [received(ends[0]), received(ends[1])],
        [vec![0x300, 0x300], vec![0x300, 0x300, 0x500, 0x400]]
    );
}

/// Counts bits as the standard describes it.
fn count_bits(frame: &Frame) -> u32 {
    let mut bits = vec![];
    let mut put = |value: u32, width: u32| bits.extend((0..width).rev().map(|at| value >> at & 1));
    put(0, 1);
    if frame.extended {
        put(frame.id >> 18, 11);
        put(3, 2);
        put(frame.id & 0x3_FFFF, 18);
    } else {
        put(frame.id, 11);
    }
    put(u32::from(frame.remote), 1);
    put(0, 2);
    put(u32::from(frame.len), 4);
    frame.bytes().iter().filter(|_| !frame.remote).for_each(|byte| put((*byte).into(), 8));
    let mut crc = 0_u32;
    for bit in &bits {
        let next = bit ^ (crc >> 14 & 1);
        crc = (crc << 1 & 0x7FFF) ^ if next == 1 { 0x4599 } else { 0 };
    }
    bits.extend((0..15).rev().map(|at| crc >> at & 1));
    let (mut count, mut run, mut last) = (0, 0, 2);
    for bit in bits {
        count += 1;
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        if run == 5 {
            (count, run, last) = (count + 1, 1, 1 - bit);
        }
    }
    count + 13
}

#[test]
fn a_frame_takes_its_bits() {
    // 47 bits without data and without stuffing; 0x555 alternates, its CRC may stuff. The longest
    // frame has 135.
    assert!((47..=50).contains(&bits_on_wire(&Frame::standard(0x555, &[]))));
    assert!((125..=135).contains(&bits_on_wire(&Frame::standard(0, &[0; 8]))));
    let mut random = Random::new(5);
    for _ in 0..2_000 {
        let dense = random.pick(&[0, u64::MAX, 0x1F_1F1F, random.clone().next_u64()]);
        let mut frame =
            Frame::standard(0, &random.next_u64().to_le_bytes().map(|b| b & dense as u8));
        frame.len = random.below(9) as u8;
        frame.extended = random.chance(Ppm(500_000));
        frame.remote = random.chance(Ppm(100_000));
        frame.id =
            (random.next_u64() & dense) as u32 & if frame.extended { 0x1FFF_FFFF } else { 0x7FF };
        assert_eq!(bits_on_wire(&frame), count_bits(&frame), "{frame:?}");
    }
}

#[test]
fn two_frames_differ_in_the_first_bit_that_is_not_alike() {
    // Start, 11 bits of identifier, RTR, IDE, r0, 4 bits of length, then the data: the 20th bit,
    // and a stuff bit for each five alike before it.
    let (one, other) = (Frame::standard(0x555, &[0x80]), Frame::standard(0x555, &[0x00]));
    assert_eq!(bits_until_difference(&one, &other), 21);
}
