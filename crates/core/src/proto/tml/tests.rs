//! Messages of the wire, and their encapsulations.

mod codec;
mod garbage;
mod online;
mod pair;

use super::wire::{IdCode, Instruction, low_first};

#[test]
fn id_codes_as_the_manual_prints_them() {
    assert_eq!(IdCode::axis(255).word(), 0x0FF0);
    assert_eq!(IdCode::host_at(255).word(), 0x0FF1);
    assert_eq!(IdCode::groups(1).word(), 0x1010);
    for word in 0..=u16::MAX {
        if let Some(code) = IdCode::from_word(word) {
            assert_eq!(code.word(), word);
        }
    }
    assert_eq!(IdCode::from_word(0x2010), None);
}

#[test]
fn a_group_concerns_whoever_shares_one() {
    assert!(IdCode::groups(0b11).concerns(7, 0b10));
    assert!(!IdCode::groups(0b100).concerns(7, 0b11));
    assert!(IdCode::BROADCAST.concerns(7, 0));
    assert!(IdCode::axis(7).concerns(7, 0) && IdCode::axis(0).concerns(7, 0));
    assert!(!IdCode::axis(6).concerns(7, 0xFF));
}

#[test]
fn long_values_have_the_low_word_first() {
    let cpos = Instruction::of(0x249E, low_first((-1000_i32).cast_unsigned()));
    assert_eq!(cpos.data(), [0xFC18, 0xFFFF]);
    assert_eq!(cpos.long(0).cast_signed(), -1000);
    assert_eq!(Instruction::new(0, &[0; 5]), None);
}
