//! EMCY: sent, remembered and held back.

use super::*;

fn emergency(code: u16) -> Emergency {
    Emergency { code, register: 0, vendor: [1, 2, 3, 4, 5] }
}

#[test]
fn an_emergency_has_eight_bytes_and_is_remembered() {
    let mut fixture = NodeFixture::new();
    fixture.toy.register = 0x21;
    fixture.toy.emergencies.push(emergency(0x8611));
    assert_eq!(fixture.advance(1), [frame(0x085, &[0x11, 0x86, 0x21, 1, 2, 3, 4, 5])]);
    for code in 1..=5 {
        fixture.toy.emergencies.push(emergency(code));
        fixture.advance(1);
    }
    let stored: Vec<_> = (0..=4).map(|sub| fixture.read(0x1003, sub).unwrap()).collect();
    assert_eq!(stored, [4, 5, 4, 3, 2], "the latest four, the latest first");
    assert_eq!(fixture.write(0x1003, 0, 1, 1), Err(AbortCode::VALUE));
    fixture.write(0x1003, 0, 0, 1).unwrap();
    assert_eq!(fixture.read(0x1003, 1), Err(AbortCode::NO_DATA));
}

#[test]
fn two_bytes_tell_no_end() {
    let mut fixture = NodeFixture::with(Quirks { short_emcy: true, ..Quirks::STRICT });
    fixture.toy.emergencies = [emergency(0), emergency(0x160C)].to_vec();
    assert_eq!(fixture.advance(1), [frame(0x085, &[0x0C, 0x16])]);
}

#[test]
fn the_inhibit_time_holds_them_back_and_a_storm_is_bounded() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x1015, 0, 100, 2).unwrap();
    fixture.toy.emergencies = (0..100).rev().map(|n| emergency(1 + n)).collect();
    let codes: Vec<_> = fixture.advance(500).iter().map(|frame| frame.data[0]).collect();
    assert_eq!(codes, [1, 2, 3, 4, 5, 6, 7, 8], "one each 10 ms, the first eight");
    assert_eq!(fixture.read(0x1003, 1), Ok(100));
    fixture.write(0x1014, 0, 1 << 31 | 0x85, 4).unwrap();
    fixture.toy.emergencies.push(emergency(9));
    assert_eq!(fixture.advance(500), [], "switched off");
}
