//! Programs as text and as words.

use polepair_core::program::{
    AssemblySize, ListingSink, MemoryKind, ProgramLabel, ProgramLanguage, SourceError,
};
use polepair_core::proto::tml::program::{RULES, TmlLanguage};
use polepair_drives::technosoft::profile::TECHNOSOFT_F514L;

const ROOM: usize = 256;

type Labels = Vec<(String, u16)>;

fn assemble(text: &str) -> Result<(Vec<u16>, Labels), SourceError> {
    let mut words = [0; ROOM];
    let mut labels = [ProgramLabel::default(); 8];
    let profile = Some(&TECHNOSOFT_F514L);
    let made = TmlLanguage.assemble(text, 0x4000, profile, &mut words, &mut labels)?;
    let named = labels[..made.labels].iter().map(|l| (l.name.into(), l.address)).collect();
    Ok((words[..made.words].to_vec(), named))
}

/// A listing as text.
struct ListingText(String);

impl ListingSink for ListingText {
    fn instruction(&mut self, _: u16, _: &[u16]) {
        self.0.push('\n');
    }

    fn text(&mut self, piece: &str) {
        self.0.push_str(piece);
    }
}

fn listing(words: &[u16]) -> String {
    let mut text = ListingText(String::new());
    TmlLanguage.disassemble(0x4000, words, Some(&TECHNOSOFT_F514L), &mut text);
    text.0
}

const MOVES: &str = "\
BEGIN;            // where the drive begins by itself
    ENDINIT; AXISON
again:
    CPOS = 4000;
    CALL Move
    CPOS = 0; call move
    VAR_I1 -= 1; GOTO again, VAR_I1, GT
    [5]{STOP;};   // another drive
    END;
move: MODE PP; CPA; UPD; !MC; WAIT!; RET
table: .word again, MOVE, 0
";

#[test]
fn labels_stand_for_where_they_are() {
    let (words, labels) = assemble(MOVES).unwrap();
    let moves = 0x4000 + 3 + 3 + 2 + 3 + 2 + 2 + 3 + 3 + 1;
    let again = 0x4003;
    let table = moves + 3 + 3 + 4;
    let named = |name: &str, address| (String::from(name), address);
    assert_eq!(labels, [named("again", again), named("move", moves), named("table", table)]);
    assert_eq!(words[..6], [0x649C, 0x0020, 0x0102, 0x249E, 4000, 0]);
    assert_eq!(words[6..8], [0x7401, moves], "a call, whatever the case of its label");
    assert_eq!(words[13..18], [0x4966, 1, 0x7484, 0x0366, again]);
    assert_eq!(words[18..22], [0x9400, 0x0050, 0x01C4, 0x0001], "a `;` in braces parts nothing");
    assert_eq!(words[words.len() - 3..], [again, moves, 0]);
}

#[test]
fn a_listing_assembles_to_the_same_words() {
    let (words, _) = assemble(MOVES).unwrap();
    let text = listing(&words);
    assert!(text.contains("\nCALL 0x4016\n") && text.contains("\n[5] {STOP}\n"), "{text}");
    assert_eq!(assemble(&text).unwrap().0, words);
    // Erased, cut short, requests, six words, and whatever else lies in a memory.
    let odd_words = [0xFFFF, 0xB004, 0x9403, 1, 2, 3, 4, 5, 0x7777, 0x249E, 0x0001, 0x249E];
    assert_eq!(assemble(&listing(&odd_words)).unwrap().0, odd_words);
    for seed in 0..40_000_u32 {
        let random = |n: u32| (seed.wrapping_mul(0x9E37_79B1).wrapping_add(n) >> 7) as u16;
        let words: Vec<u16> = (0..4).map(|n| random(n * 0x0123_4567)).collect();
        assert_eq!(assemble(&listing(&words)).unwrap().0, words, "{words:04X?}");
    }
}

#[test]
fn errors_name_line_place_and_what_should_stand_there() {
    let refused = |text: &str| {
        let SourceError { line, at, expected } = assemble(text).unwrap_err();
        (line, at, expected)
    };
    let (line, at, expected) = refused("NOP\nAXISON; CPOSS = 5");
    assert_eq!((line, at), (2, 8));
    assert!(expected.contains("variable that the profile names"), "{expected}");
    let (line, at, expected) = refused("NOP\n\n  GOTO nowhere");
    assert_eq!((line, at), (3, 7));
    assert!(expected.contains("label of the program"), "{expected}");
    assert_eq!(refused("a: NOP\nA: NOP"), (2, 0, "another name: this label is there twice"));
    assert!(refused("kpp: NOP").2.contains("a variable is called so"));
    assert!(refused("  ?KPP").2.contains("go on-line"));
    assert_eq!(
        refused("SOUT#3").2,
        "an instruction whose opcode is known: no source gives this one's"
    );
    assert!(refused("a: b: c: d: e: f: g: h: i: NOP").2.contains("fewer labels"));
    assert!(refused(&"CPOS = 1;".repeat(ROOM)).2.contains("a shorter program"));
    let mut words = [0; ROOM];
    let end = TmlLanguage.assemble("NOP; NOP", 0xFFFF, None, &mut words, &mut []).unwrap_err();
    assert!(end.expected.contains("a shorter program"), "{end:?}");
    let nothing = TmlLanguage.assemble("// nothing\n\n", 0, None, &mut [], &mut []);
    assert_eq!(nothing, Ok(AssemblySize::default()));
}

#[test]
fn memory_is_recognised_by_its_addresses() {
    assert_eq!(RULES.memory_at(0x4000, 0x4000), Some(MemoryKind::Permanent));
    assert_eq!(RULES.memory_at(0x4000, 0x4001), None, "it begins in one and ends in another");
    assert_eq!(RULES.memory_at(0x8270, 1), Some(MemoryKind::Volatile));
    assert_eq!(RULES.memory_at(0x826F, 1), None, "the firmware's own");
    assert_eq!(RULES.memory_at(0xFFFF, 2), None);
    assert_eq!(RULES.memory_at(0x0200, 1), None, "variables are no program");
}
