//! Messages that are exchanged on-line, as the manual's examples and captures have it.

use crate::proto::tml::online::{Cell, MemorySpace, OnlineMessage, PtPoint, PvtPoint};
use crate::proto::tml::wire::{IdCode, Instruction, operand_address, short_operand};

const HOST: IdCode = IdCode::host_at(255);

/// The instruction's words, and their meaning, in both directions.
const EXCHANGES: &[(&[u16], OnlineMessage)] = &[
    (
        &[0xB004, 0x0FF1, 0x025E],
        OnlineMessage::GiveMeData { sender: HOST, cell: Cell::short(0x025E) },
    ),
    (
        &[0xB405, 0x0030, 0x0228, 0x5678, 0x1234],
        OnlineMessage::TakeData {
            sender: IdCode::axis(3),
            cell: Cell::long(0x0228),
            value: 0x1234_5678,
        },
    ),
    (
        &[0xB404, 0x0FF0, 0x025E, 0x0120],
        OnlineMessage::TakeData {
            sender: IdCode::axis(255),
            cell: Cell::short(0x025E),
            value: 288,
        },
    ),
    (
        &[0xB204, 0x0030, 0x022A],
        OnlineMessage::GiveMeData2 { sender: IdCode::axis(3), cell: Cell::short(0x022A) },
    ),
    (
        &[0xB009, 0x0FF1, 0x4000],
        OnlineMessage::GiveMeData {
            sender: HOST,
            cell: Cell { memory: MemorySpace::Spi, address: 0x4000, long: true },
        },
    ),
    (
        &[0xD405, 0x022A, 0x0002],
        OnlineMessage::TakeData2 { sender: 5, address: 0x022A, long: false, value: 2 },
    ),
    (
        &[0xD5FF, 0x090E, 0x8400, 0x0201],
        OnlineMessage::TakeData2 { sender: 255, address: 0x090E, long: true, value: 0x0201_8400 },
    ),
    (&[0xA25E, 0x0FF1], OnlineMessage::GetData { sender: HOST, address: 0x085E, long: false }),
    (
        &[0xAD68, 0x0020, 0x5678, 0x1234],
        OnlineMessage::GotData {
            sender: IdCode::axis(2),
            address: 0x0368,
            long: true,
            value: 0x1234_5678,
        },
    ),
    (&[0xD801, 0x0FF1], OnlineMessage::GetVersion { sender: HOST }),
    (&[0xD801, 0x3531, 0x344C], OnlineMessage::TakeVersion { version: *b"514L" }),
    (&[0xD600, 0x0FF1, 0x07D0], OnlineMessage::Ping { sender: HOST, word: 2000 }),
    (&[0xD607, 0x3531, 0x344C], OnlineMessage::Pong { sender: 7, version: *b"514L" }),
    (
        &[0xDA50, 0x0FF1, 0x4000, 0x4010],
        OnlineMessage::GetChecksum {
            sender: HOST,
            memory: MemorySpace::Spi,
            start: 0x4000,
            end: 0x4010,
        },
    ),
    (&[0xDA10, 0xBEEF], OnlineMessage::TakeChecksum { memory: MemorySpace::Program, sum: 0xBEEF }),
    (&[0x1000], OnlineMessage::Synchronisation),
    (&[0x1401, 0xC46F, 0x0246], OnlineMessage::MasterTime(0x0246_C46F)),
    (&[0x1404, 20, 0], OnlineMessage::SetSync(20)),
    (
        &[0x1800, 0xFC18, 0xFF00, 0xFFF6, 0x01F4],
        OnlineMessage::Pvt(PvtPoint {
            position: -1000,
            velocity: -10 << 16,
            time: 500,
            counter: 0,
        }),
    ),
    (
        &[0xC864, 0xFC18, 0xFFFF, 20],
        OnlineMessage::Pt(PtPoint { position: -1000, time: 20, counter: 100 }),
    ),
];

fn instruction(words: &[u16]) -> Instruction {
    Instruction::new(words[0], &words[1..]).expect("five words at most")
}

#[test]
fn exchanged_messages_are_read_and_written() {
    for (words, online) in EXCHANGES {
        let instruction = instruction(words);
        assert_eq!(OnlineMessage::parse(&instruction), Some(*online), "{instruction:?}");
        assert_eq!(online.emit(), instruction, "{online:?}");
    }
}

#[test]
fn whatever_reads_writes_the_same() {
    // Every opcode with every number of words, whose bits that must be zero are.
    for opcode in 0..=u16::MAX {
        for words in 0..=4 {
            let data = [0x0FF1, 0x0228, 0x0102, 0x0034];
            let instruction = Instruction::new(opcode, &data[..words]).expect("four words");
            if let Some(online) = OnlineMessage::parse(&instruction) {
                assert_eq!(online.emit(), instruction, "{online:?}");
            }
        }
    }
}

#[test]
fn an_answer_is_for_its_request() {
    let message = OnlineMessage::GiveMeData { sender: HOST, cell: Cell::short(0x025E) };
    let take = |id: u8, address: u16| OnlineMessage::TakeData {
        sender: IdCode::axis(id),
        cell: Cell::short(address),
        value: 5,
    };
    assert!(take(1, 0x025E).answers(&message, IdCode::axis(1)));
    assert!(!take(2, 0x025E).answers(&message, IdCode::axis(1)), "another axis");
    assert!(!take(1, 0x025F).answers(&message, IdCode::axis(1)), "another variable");
    let group = OnlineMessage::GiveMeData2 { sender: HOST, cell: Cell::short(0x022A) };
    let from_7 = OnlineMessage::TakeData2 { sender: 7, address: 0x022A, long: false, value: 1 };
    assert!(
        from_7.answers(&group, IdCode::groups(1)) && !from_7.answers(&message, IdCode::axis(7))
    );
    assert!(message.is_request() && !from_7.is_request());
    assert_eq!((message.reply_to(), from_7.answered_by()), (Some(HOST), Some(7)));
}

#[test]
fn points_that_do_not_fit_are_reported() {
    let velocity = 0x1234_5600;
    let point = PvtPoint { position: -0x7E_DCBA, velocity, time: 511, counter: 127 };
    assert!(point.fits());
    assert_eq!(
        OnlineMessage::parse(&OnlineMessage::Pvt(point).emit()),
        Some(OnlineMessage::Pvt(point))
    );
    for wrong in [
        PvtPoint { position: 0x80_0000, ..point },
        PvtPoint { position: -0x80_0000, ..point },
        PvtPoint { time: 512, ..point },
        PvtPoint { time: 0, ..point },
        PvtPoint { counter: 128, ..point },
    ] {
        assert!(!wrong.fits(), "{wrong:?}");
    }
}

#[test]
fn short_addresses_of_both_pages() {
    for address in 0..=u16::MAX {
        match short_operand(address) {
            Some(operand) => assert_eq!(operand_address(0x2000 | operand), address),
            None => assert!(!matches!(address, 0x0200..=0x03FF | 0x0800..=0x09FF)),
        }
    }
}
