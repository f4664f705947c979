//! EMCY: what is told, remembered and held back.

use super::*;

fn emergency(code: u16) -> Emergency {
    Emergency { code, register: 0, vendor: [1, 2, 3, 4, 5] }
}

#[test]
fn an_emergency_has_eight_bytes_and_is_remembered() {
    let mut desk = NodeFixture::new();
    desk.toy.register = 0x21;
    desk.toy.emergencies.push(emergency(0x8611));
    assert_eq!(desk.advance(1), [frame(0x085, &[0x11, 0x86, 0x21, 1, 2, 3, 4, 5])]);
    for code in 1..=5 {
        desk.toy.emergencies.push(emergency(code));
        desk.advance(1);
    }
    let kept: Vec<_> = (0..=4).map(|sub| desk.read(0x1003, sub).unwrap()).collect();
    assert_eq!(kept, [4, 5, 4, 3, 2], "the latest four, the latest first");
    assert_eq!(desk.write(0x1003, 0, 1, 1), Err(AbortCode::VALUE));
    desk.write(0x1003, 0, 0, 1).unwrap();
    assert_eq!(desk.read(0x1003, 1), Err(AbortCode::NO_DATA));
}

#[test]
fn two_bytes_tell_no_end() {
    let mut desk = NodeFixture::with(Quirks { short_emcy: true, ..Quirks::STRICT });
    desk.toy.emergencies = [emergency(0), emergency(0x160C)].to_vec();
    assert_eq!(desk.advance(1), [frame(0x085, &[0x0C, 0x16])]);
}

#[test]
fn the_inhibit_time_holds_them_back_and_a_storm_is_bounded() {
    let mut desk = NodeFixture::new();
    desk.write(0x1015, 0, 100, 2).unwrap();
    desk.toy.emergencies = (0..100).rev().map(|n| emergency(1 + n)).collect();
    let codes: Vec<_> = desk.advance(500).iter().map(|frame| frame.data[0]).collect();
    assert_eq!(codes, [1, 2, 3, 4, 5, 6, 7, 8], "one each 10 ms, the first eight");
    assert_eq!(desk.read(0x1003, 1), Ok(100));
    desk.write(0x1014, 0, 1 << 31 | 0x85, 4).unwrap();
    desk.toy.emergencies.push(emergency(9));
    assert_eq!(desk.advance(500), [], "switched off");
}
