//! Frames that mean nothing, at times that mean nothing: they may be called odd, and nothing breaks.

use super::*;

/// Numbers by a seed (Steele, Lea and Flood's SplitMix64).
struct SplitMix64(u64);

impl SplitMix64 {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ mixed >> 31
    }

    fn below(&mut self, count: u64) -> u64 {
        self.word() % count
    }
}

/// One node's services, its configuration above all.
fn random_frame(dice: &mut SplitMix64) -> Frame {
    const HEADS: [u8; 24] = [
        0x40, 0x42, 0x43, 0x4B, 0x4F, 0x41, 0x60, 0x70, 0x20, 0x21, 0x22, 0x23, 0x2B, 0x2F, 0x00,
        0x10, 0x80, 0xA0, 0xA1, 0xA2, 0xA3, 0xC0, 0xC1, 0xC6,
    ];
    const OBJECTS: [u16; 14] = [
        0x1000, 0x1005, 0x1014, 0x1016, 0x1017, 0x1019, 0x1200, 0x1280, 0x1400, 0x1600, 0x1800,
        0x1A00, 0x6041, 0x2000,
    ];
    let ids = [0x605, 0x585, 0x605, 0x585, 0x705, 0x085, 0x080, 0x185, 0x205, 0x000];
    let id = match dice.below(20) {
        0 => dice.below(0x800) as u16,
        n => ids[n as usize % ids.len()],
    };
    let mut data = dice.word().to_le_bytes();
    if matches!(id, 0x605 | 0x585) && dice.below(4) > 0 {
        data[0] = HEADS[dice.below(24) as usize];
        let [low, high] = OBJECTS[dice.below(14) as usize].to_le_bytes();
        (data[1], data[2], data[3]) = (low, high, dice.below(3) as u8);
    }
    let len = if dice.below(8) == 0 { dice.below(9) as usize } else { 8 };
    let len = if id == 0x705 { 1 } else { len };
    let remote = dice.below(50) == 0;
    Frame { remote, ..Frame::standard(id, &data[..len]) }
}

#[test]
fn garbage_breaks_nothing() {
    for seed in 0..8 {
        let (mut dice, mut bus) = (SplitMix64(seed), CanopenLog::default());
        for _ in 0..5_000 {
            let next = random_frame(&mut dice);
            bus.now = match dice.below(200) {
                0 => dice.word() >> 1,
                1 => bus.now.saturating_sub(dice.below(10_000_000_000)),
                _ => bus.now.saturating_add(dice.below(3_000_000)),
            };
            bus.now = bus.now.min(u64::MAX >> 2);
            bus.frame(next);
        }
        let report = bus.report();
        assert!(!report.notices.is_empty());
    }
}
