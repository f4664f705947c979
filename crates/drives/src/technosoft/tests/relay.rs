//! A host on RS-232, a relay, and drives behind it on CAN.

use super::Vec;
use super::{DriveFixture, frame, messages};
use polepair_core::medium::{Can, Frame};
use polepair_core::proto::tml::online::{Cell, OnlineMessage};
use polepair_core::proto::tml::wire::{IdCode, Instruction};
use polepair_core::station::Station;

/// Drives on one bus, the first with the host on its serial port.
struct RelayFixture {
    desks: Vec<DriveFixture>,
    /// All that went over the bus.
    log: Vec<Frame>,
}

impl RelayFixture {
    fn new(axes: &[u32], can: &str) -> Self {
        let desks =
            axes.iter().map(|axis| DriveFixture::at(Some(*axis), &[("can", can)])).collect();
        Self { desks, log: Vec::new() }
    }

    /// Carries frames until the bus is silent, the lowest identifier first.
    fn settle(&mut self) {
        for _ in 0..100 {
            let mut ready: Vec<(u32, usize, Frame)> = Vec::new();
            for (n, fixture) in self.desks.iter_mut().enumerate() {
                let mut frame = Frame::default();
                let now = fixture.now;
                while Station::<Can>::poll_transmit(&mut fixture.device, now, &mut frame).is_some()
                {
                    ready.push((frame.id, n, frame));
                }
            }
            if ready.is_empty() {
                return;
            }
            ready.sort_by_key(|(id, ..)| *id);
            for (_, from, frame) in ready {
                self.log.push(frame);
                for (n, fixture) in self.desks.iter_mut().enumerate() {
                    if n != from {
                        Station::<Can>::handle_input(&mut fixture.device, fixture.now, &frame);
                    }
                }
            }
        }
        panic!("the bus never rests");
    }

    /// Bytes that the host receives after it has sent these.
    fn host(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut received = self.desks[0].bytes(bytes);
        self.settle();
        received.extend(self.desks[0].sent());
        received
    }
}

/// TML communication manual, chapter 3, examples 1 and 2, remarks a.
#[test]
fn a_host_sets_and_reads_kpp_of_an_axis_behind_the_relay() {
    let mut bus = RelayFixture::new(&[255, 1], "tmlcan");
    assert_eq!(bus.host(&[0x06, 0x00, 0x10, 0x20, 0x5E, 0x00, 0x05, 0x99]), [0x4F]);
    let request = frame(IdCode::axis(1), Instruction::of(0xB004, [0x0FF1, 0x025E]));
    let received = bus.host(&request);
    let answer = [0x0A, 0x0F, 0xF1, 0xB4, 0x04, 0x00, 0x10, 0x02, 0x5E, 0x00, 0x05];
    assert_eq!(received[0], 0x4F);
    assert_eq!(received[1..12], answer);
    let ids: Vec<u32> = bus.log.iter().map(|frame| frame.id).collect();
    assert_eq!(ids, [0x0400_205E, 0x1600_2004, 0x169F_E204]);
    let relay = &bus.desks[0].device.drive;
    assert_eq!(relay.memory.word(0x025E), 288, "the relay's own stays");
}

/// Chapter 4, example 2, with the host behind a relay.
#[test]
fn a_group_answers_in_the_order_of_axis_ids() {
    let mut bus = RelayFixture::new(&[3, 7, 5], "tmlcan");
    let request =
        OnlineMessage::GiveMeData2 { sender: IdCode::host_at(3), cell: Cell::short(0x030C) };
    let received = bus.host(&frame(IdCode::groups(1), request.emit()));
    let answers: Vec<_> = messages(&received[1..])
        .iter()
        .map(|message| OnlineMessage::parse(&message.instruction).unwrap())
        .collect();
    let expected: Vec<_> = [(3, 0x0103), (5, 0x0105), (7, 0x0107)]
        .map(|(sender, value)| OnlineMessage::TakeData2 {
            sender,
            address: 0x030C,
            long: false,
            value,
        })
        .into();
    assert_eq!(answers, expected);
}

#[test]
fn behind_technocan_an_axis_is_read_but_no_group() {
    let mut bus = RelayFixture::new(&[255, 1, 2], "technocan");
    let cell = Cell::short(0x025E);
    let sender = IdCode::host_at(255);
    let received =
        bus.host(&frame(IdCode::axis(2), OnlineMessage::GiveMeData { sender, cell }.emit()));
    let answer = messages(&received[1..])[0];
    assert_eq!(answer.to, IdCode::host_at(255), "the ID is whole again");
    let sender = IdCode::axis(2);
    let expected = OnlineMessage::TakeData { sender, cell, value: 288 };
    assert_eq!(OnlineMessage::parse(&answer.instruction), Some(expected));
    assert_eq!(bus.log[1].id, 0x17F, "TakeData to 255, which acts as 31");
    let sender = IdCode::host_at(255);
    let received =
        bus.host(&frame(IdCode::groups(1), OnlineMessage::GiveMeData2 { sender, cell }.emit()));
    assert_eq!(messages(&received[1..]).len(), 1, "the relay's own; no drive receives TakeData2");
}

#[test]
fn an_axis_behind_the_relay_speaks_unasked() {
    let mut bus = RelayFixture::new(&[255, 1], "tmlcan");
    for (opcode, words) in [
        (0x2327, &[0x0FF1][..]),
        (0x2362, &[0x0400]),
        (0x0020, &[]),
        (0x0102, &[]),
        (0x249E, &[1000, 0]),
        (0x5909, &[0xBFC1, 0x8701]),
    ] {
        let instruction = Instruction::new(opcode, words).unwrap();
        assert_eq!(bus.host(&frame(IdCode::axis(1), instruction)), [0x4F]);
    }
    let received = bus.host(&frame(IdCode::axis(1), Instruction::of(0x0108, [])));
    assert_eq!(messages(&received[1..]).len(), 1, "the motion begins");
    bus.desks[1].wait(1000);
    bus.settle();
    let reports = messages(&bus.desks[0].sent());
    assert_eq!(
        OnlineMessage::parse(&reports[0].instruction),
        Some(OnlineMessage::TakeData2 {
            sender: 1,
            address: 0x090E,
            long: true,
            value: 0x0201_8400
        })
    );
    assert_eq!(bus.log.last().unwrap().id, 0x1A9F_E301, "chapter 4, example 3");
}

#[test]
fn a_full_queue_drops_and_counts() {
    let mut fixture = DriveFixture::at(Some(255), &[]);
    let order = frame(IdCode::axis(1), Instruction::of(0x205E, [1]));
    for _ in 0..40 {
        assert_eq!(fixture.bytes(&order), [0x4F], "an acknowledgement says only that it was heard");
    }
    assert_eq!(fixture.device.wires.dropped(), 8);
    assert_eq!(fixture.read(0x0301), 1 << 5, "CAN transmit overrun");
    let mut out = Frame::default();
    let mut sent = 0;
    while Station::<Can>::poll_transmit(&mut fixture.device, fixture.now, &mut out).is_some() {
        sent += 1;
    }
    assert_eq!(sent, 32);
}
