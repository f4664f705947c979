//! Whatever comes over the wires, nothing breaks, and nothing moves that was not ordered.

use super::{DriveFixture, OPTIONS, Technosoft, Vec, frame};
use crate::surroundings::SurroundingsControl;
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::proto::tml::wire::{IdCode, Instruction};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;

/// Xorshift: the test's own source of noise.
struct NoiseSource(u64);

impl NoiseSource {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

#[test]
fn frames_whose_sum_fails_move_nothing() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    let mut noise = NoiseSource(7);
    let motions = [
        frame(IdCode::axis(255), Instruction::of(0x249E, [0x4E20, 0])),
        frame(IdCode::axis(255), Instruction::of(0x5909, [0xBFC1, 0x8701])),
        frame(IdCode::axis(255), Instruction::of(0x0108, [])),
    ];
    for _ in 0..3000 {
        let mut bad = motions[noise.next() as usize % motions.len()].clone();
        let at = 1 + noise.next() as usize % (bad.len() - 1);
        bad[at] ^= 1 << (noise.next() % 8);
        assert_eq!(fixture.bytes(&bad), super::NOTHING);
        fixture.wait(1);
    }
    assert_eq!((fixture.read_long(0x0228), fixture.read_long(0x029E)), (0, 0));
    assert_eq!(fixture.device.ground_truth(fixture.now).position, 0.0);
}

/// Well-formed messages of random words, and bytes and frames of none: the drive may do anything but
/// panic, and does the same each time.
fn run_noise(seed: u64) -> (Vec<u8>, [u64; 3]) {
    let options = DeviceOptions { address: Some(1), ..OPTIONS };
    let mut device = Technosoft::create_device(Technosoft::profiles()[0], &options).unwrap();
    let (mut noise, mut now, mut sent) = (NoiseSource(seed), Instant::ZERO, Vec::new());
    for _ in 0..4000 {
        now = now.plus_ns(noise.next() % 5_000_000);
        let words = [(); 4].map(|()| noise.next() as u16);
        let opcode = noise.next() as u16;
        match noise.next() % 5 {
            0 => {
                let bytes = noise.next().to_le_bytes();
                Station::<Stream>::handle_input(&mut device, now, &bytes);
            }
            1 => {
                let mut unit = Frame::standard(opcode, &noise.next().to_le_bytes());
                unit.extended = opcode & 1 == 0;
                unit.id = noise.next() as u32 & 0x1FFF_FFFF;
                Station::<Can>::handle_input(&mut device, now, &unit);
            }
            2 => Station::<Stream>::handle_line(&mut device, now, LineEvent::Break),
            _ => {
                let count = polepair_core::proto::tml::instruction::data_word_count(opcode)
                    .unwrap_or(2)
                    .min(4);
                let order = Instruction::new(opcode, &words[..count]).unwrap();
                let axis = device.drive.axis;
                let bytes = frame(IdCode::axis(axis), order);
                Station::<Stream>::handle_input(&mut device, now, &bytes);
            }
        }
        device.handle_timeout(now);
        let mut out = [0; 520];
        while let Some(n) = Station::<Stream>::poll_transmit(&mut device, now, &mut out) {
            sent.extend_from_slice(&out[..n]);
        }
        let mut unit = Frame::default();
        while Station::<Can>::poll_transmit(&mut device, now, &mut unit).is_some() {
            sent.extend_from_slice(unit.bytes());
        }
    }
    let truth = device.ground_truth(now);
    (sent, [truth.position.to_bits(), truth.velocity.to_bits(), truth.flash_writes])
}

#[test]
fn a_storm_of_instructions_ends_the_same_each_time() {
    for seed in 1..=20 {
        let (sent, truth) = run_noise(seed);
        assert!(!sent.is_empty());
        assert_eq!((sent, truth), run_noise(seed), "{seed}");
        assert!(f64::from_bits(truth[0]).is_finite());
    }
}
