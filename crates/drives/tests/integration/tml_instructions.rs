//! Round trips over every opcode, the labelled frames, the language as people write it, the table.

mod labels;
mod language;
mod table;

use polepair_core::proto::tml::instruction::{
    LanguageScope, assemble, data_word_count, disassemble,
};
use polepair_core::proto::tml::wire::{IdCode, Instruction};
use polepair_drives::technosoft::profile::{TECHNOSOFT_F514L, TECHNOSOFT_FA00G};

const BARE: LanguageScope<'_> =
    LanguageScope { profile: None, sender: IdCode::host_at(255), labels: &[] };
const F514L: LanguageScope<'_> = LanguageScope { profile: Some(&TECHNOSOFT_F514L), ..BARE };
const FA00G: LanguageScope<'_> = LanguageScope { profile: Some(&TECHNOSOFT_FA00G), ..BARE };

fn text(instruction: &Instruction, scope: &LanguageScope<'_>) -> String {
    let mut text = String::new();
    disassemble(instruction, scope, &mut |piece| text.push_str(piece));
    text
}

/// Numbers that repeat: xorshift.
fn random(state: &mut u64) -> u16 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 24) as u16
}

/// Data words as programs have them: addresses of variables as often as anything else.
fn word(state: &mut u64) -> u16 {
    match random(state) % 4 {
        0 => random(state),
        1 => 0x0200 | random(state) & 0x1FF,
        2 => 0x0800 | random(state) & 0x1FF,
        _ => random(state) & 0x11F1,
    }
}

#[test]
fn whatever_is_disassembled_assembles_to_the_same() {
    for scope in [BARE, F514L, FA00G] {
        let mut state = 0x9E37_79B9_7F4A_7C15;
        for opcode in 0..=u16::MAX {
            let count = usize::from(random(&mut state) % 5);
            let words = [(); 4].map(|()| word(&mut state));
            check(&Instruction::new(opcode, &words[..count]).unwrap(), &scope);
            if let Some(count) = data_word_count(opcode) {
                check(&Instruction::new(opcode, &words[..count.min(4)]).unwrap(), &scope);
            }
        }
    }
}

fn check(instruction: &Instruction, scope: &LanguageScope<'_>) {
    let text = text(instruction, scope);
    match assemble(&text, scope) {
        Ok(again) => assert_eq!(again, *instruction, "{text}"),
        Err(error) => panic!("{instruction:?}: {text}: {error:?}"),
    }
}
