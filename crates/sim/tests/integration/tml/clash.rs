//! Two drives with one axis ID on one line: their acknowledgements and answers collide.

use super::{Bench, device};
use polepair_core::axis::Verb;
use polepair_core::error::{Failure, Outcome};
use polepair_core::medium::SerialLine;
use polepair_core::proto::HostOptions;
use polepair_core::proto::tml::online::{Cell, OnlineMessage};
use polepair_core::proto::tml::serial::{self, FRAME_MAX, SerialPiece};
use polepair_core::proto::tml::wire::{IdCode, Message};
use polepair_sim::node::SERIAL_PORT;
use polepair_sim::serial_line::SerialWireConfig;
use polepair_sim::sim_link::SimLink;
use polepair_sim::world::World;

#[test]
fn two_drives_with_one_id_on_rs485_are_not_believed_and_not_moved() {
    let mut bench = Bench::rs485(HostOptions::new(9600), &[5], &[5, 5]);
    for _ in 0..8 {
        assert_eq!(bench.read(0, "KPP"), Outcome::NotDone(Failure::Silent));
    }
    assert_eq!(bench.write(0, "KPP", 300), Outcome::Unknown(Failure::Silent));
    assert_eq!(bench.verb(0, Verb::Enable), Outcome::NotDone(Failure::Silent));
    let counters = bench.counters();
    assert_eq!(counters.answered, 0);
    assert!(counters.corrupt > 0, "somebody is there: {counters:?}");
    for drive in 0..2 {
        assert_eq!((bench.truth(drive).starts, bench.truth(drive).enabled), (0, false));
    }
}

/// TML communication manual, chapter 3: the answers of a group would collide on RS-485. They do.
#[test]
fn two_answers_of_a_group_collide_on_rs485() {
    let question = |to| {
        let sender = IdCode::axis(200);
        let cell = Cell::short(0x030C);
        let instruction = OnlineMessage::GiveMeData2 { sender, cell }.emit();
        let mut frame = [0; FRAME_MAX];
        let len = serial::encode(&Message { to, instruction }, &mut frame);
        frame[..len].to_vec()
    };
    for (to, drives, answers) in [
        (IdCode::groups(1), &[5, 7][..], 0),
        (IdCode::axis(5), &[5, 7], 1),
        (IdCode::groups(1), &[5], 1),
    ] {
        let mut world = World::new(1);
        let wire = world.add_serial(SerialWireConfig::RS485);
        for axis in drives {
            let drive = world.add_node(device(*axis, &[("wire", "rs485")]));
            world.plug_drive(wire, drive, SERIAL_PORT);
        }
        let mut link = SimLink::new(world, wire);
        link.set_line(SerialLine { stop_bits: 2, ..SerialLine::new_8n1(9600) });
        let now = link.now();
        link.send(now, &question(to));
        let (end, mut bytes, mut buffer) = (now.plus_ms(500), Vec::new(), [0; 64]);
        while link.advance_to(end) < end {
            while let Some((_, count)) = link.receive(&mut buffer) {
                bytes.extend_from_slice(&buffer[..count]);
            }
        }
        let mut deframer = serial::Deframer::new(serial::RecoveryPolicy::Drop);
        let mut whole = 0;
        for byte in &bytes {
            deframer.push(*byte);
            while let Some(piece) = deframer.next_piece() {
                whole += usize::from(matches!(piece, SerialPiece::Message(_)));
            }
        }
        assert!(!bytes.is_empty() && whole == answers, "{to:?} {drives:?}: {bytes:02X?}");
    }
}
