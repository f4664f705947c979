//! Random and damaged frames through the codecs: nothing panics, what is read is written the same,
//! and what the sum cannot see is counted.

extern crate std;

use std::println;
use std::vec::Vec;

use crate::medium::Frame;
use crate::proto::tml::online::{Cell, OnlineMessage};
use crate::proto::tml::serial::{self, Deframer, FRAME_MAX, RecoveryPolicy, SerialPiece};
use crate::proto::tml::technocan::{self, MessageClass};
use crate::proto::tml::tmlcan;
use crate::proto::tml::wire::{IdCode, Message};

const FRAMES: u32 = 200_000;

/// Marsaglia's xorshift.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 16
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
}

fn answer() -> ([u8; FRAME_MAX], usize) {
    let online = OnlineMessage::TakeData {
        sender: IdCode::axis(5),
        cell: Cell::long(0x0228),
        value: 0x1234_5678,
    };
    let message = Message { to: IdCode::host_at(255), instruction: online.emit() };
    let mut frame = [0; FRAME_MAX];
    let len = serial::encode(&message, &mut frame);
    (frame, len)
}

#[test]
fn what_the_sum_cannot_see() {
    let (frame, len) = answer();
    let bits = len * 8;
    let (mut tried, mut passed, mut believed) = (0, 0, 0);
    let good = serial::decode(&frame[..len]).expect("a frame");
    for first in 0..bits {
        let mut one = frame;
        one[first / 8] ^= 1 << (first % 8);
        assert!(serial::decode(&one[..len]).is_err(), "one wrong bit is always seen");
        for second in first + 1..bits {
            let mut two = one;
            two[second / 8] ^= 1 << (second % 8);
            tried += 1;
            let Ok(message) = serial::decode(&two[..len]) else { continue };
            passed += 1;
            let request = OnlineMessage::GiveMeData {
                sender: IdCode::host_at(255),
                cell: Cell::long(0x0228),
            };
            let read = OnlineMessage::parse(&message.instruction);
            let answers = read.is_some_and(|read| read.answers(&request, IdCode::axis(5)));
            believed += u32::from(answers && message.to == good.to);
        }
    }
    let (mut random, mut noise) = (Random(1), 0);
    for _ in 0..FRAMES {
        let bytes: Vec<u8> = (0..len).map(|_| random.next() as u8).collect();
        noise += u32::from(serial::decode(&bytes).is_ok());
    }
    println!("two wrong bits: {tried} tried, {passed} pass the sum, {believed} answer as asked");
    println!("noise: {FRAMES} runs of {len} bytes, {noise} are a frame");
    assert!(passed * 100 < tried * 7 && believed < passed, "{passed} and {believed} of {tried}");
    assert!(noise < FRAMES / 10_000, "{noise}");
}

#[test]
fn can_frames_that_are_read_are_written_the_same() {
    let mut random = Random(2);
    let (mut long, mut short) = (0, 0);
    for _ in 0..FRAMES {
        let data = random.next().to_le_bytes();
        let mut frame =
            Frame::standard(random.below(0x800) as u16, &data[..random.below(9) as usize]);
        if let Ok(content) = technocan::decode(&frame) {
            let message = Message {
                to: content.to.unwrap_or(IdCode::host_at(1)),
                instruction: content.instruction,
            };
            // Impossible messages are refused: TakeData from axis 0, requests to groups.
            if let Ok(again) = technocan::encode(&message) {
                // In PONG the VT bit has no meaning.
                let other = content.misprinted() || content.class == MessageClass::Pong;
                let same = again == frame || other || content.class != class(&message);
                assert!(same, "{frame:02X?} becomes {again:02X?}");
                short += 1;
            }
        }
        (frame.id, frame.extended) = (random.below(1 << 29) as u32, true);
        if let Ok(message) = tmlcan::decode(&frame) {
            assert_eq!(tmlcan::encode(&message), frame);
            long += 1;
        }
    }
    assert!(short > 1000 && long > 1000, "{short} and {long}");
}

fn class(message: &Message) -> MessageClass {
    technocan::class_of(message).expect("it was encoded")
}

#[test]
fn a_deframer_gives_back_every_byte_it_is_given() {
    let (frame, len) = answer();
    for recovery in [RecoveryPolicy::Drop, RecoveryPolicy::Search] {
        let (mut random, mut deframer) = (Random(3), Deframer::new(recovery));
        let mut found = 0;
        for _ in 0..FRAMES {
            let mut bytes: Vec<u8> = frame[..len].to_vec();
            let at = random.below(len as u64) as usize;
            match random.below(4) {
                0 => bytes[at] = random.next() as u8,
                1 => drop(bytes.remove(at)),
                2 => bytes.insert(at, random.next() as u8),
                _ => {}
            }
            for byte in bytes {
                deframer.push(byte);
                while let Some(piece) = deframer.next_piece() {
                    found += u32::from(matches!(piece, SerialPiece::Message(_)));
                }
                assert!(deframer.pending().len() < FRAME_MAX);
            }
        }
        // A host loses the damaged frames alone; a drive those behind them too.
        let min = if recovery == RecoveryPolicy::Search { FRAMES / 4 } else { FRAMES / 100 };
        assert!(found > min, "{recovery:?}: {found} of {FRAMES}");
    }
}
