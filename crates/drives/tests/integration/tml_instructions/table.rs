//! The table itself.

use polepair_core::proto::tml::instruction::{
    CodingCertainty, Form, data_word_count, forms, registers,
};

#[test]
fn no_row_has_bits_outside_its_mask_or_hides_a_later_one() {
    let rows: Vec<_> = forms().filter(|form| form.certainty != CodingCertainty::Unknown).collect();
    for (n, form) in rows.iter().enumerate() {
        assert_eq!(form.opcode & !form.mask, 0, "{form:?}");
        let hidden = |other: &&&Form| {
            !other.alias
                && form.mask & other.mask == other.mask
                && form.opcode & other.mask == other.opcode
                && form.word_count == other.word_count
                && form.fixed_words.starts_with(other.fixed_words)
        };
        if !form.alias {
            let hides = rows[..n].iter().find(hidden);
            assert!(hides.is_none(), "{form:?}\nstands behind {hides:?}");
        }
    }
}

#[test]
fn a_program_can_be_walked() {
    assert_eq!(data_word_count(0x249E), Some(2));
    assert_eq!(data_word_count(0x5909), Some(2));
    assert_eq!(data_word_count(0x9402), Some(4));
    assert_eq!(data_word_count(0x7092), Some(3));
    assert_eq!(data_word_count(0x7777), None);
}

#[test]
fn bits_of_registers_stand_once_and_in_order() {
    for register in registers() {
        let mut above = 32;
        for bits in register.bits {
            assert!(bits.low <= bits.high && bits.high < above, "{}: {bits:?}", register.name);
            assert!(bits.values.len() <= 1 << (bits.high - bits.low + 1), "{bits:?}");
            above = bits.low;
        }
    }
}
