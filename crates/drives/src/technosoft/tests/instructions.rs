//! Every instruction of the table has an effect or sets an error bit.

extern crate std;

use std::fmt::Write;
use std::hash::{DefaultHasher, Hasher};
use std::string::String;
use std::vec::Vec;

use super::DriveFixture;
use crate::technosoft::drive::Drive;
use polepair_core::proto::tml::instruction::{Category, CodingCertainty, Form, forms};
use polepair_core::proto::tml::wire::Instruction;

/// A free 16-bit variable, and a pointer to RAM.
const VARIABLE: u16 = 0x0366;
const POINTER: u16 = 0x032B;

/// Register of STARTLOG, STOPLOG and PROD.
const LOGGER: u16 = 0x0365;
const PRODUCT: u16 = 0x030E;

/// Does nothing by definition.
const WITHOUT_EFFECT: [u16; 2] = [0x0000, 0x649C];

struct Digest(DefaultHasher);

impl Write for Digest {
    fn write_str(&mut self, piece: &str) -> core::fmt::Result {
        self.0.write(piece.as_bytes());
        Ok(())
    }
}

/// All that a drive is.
fn digest(drive: &mut Drive) -> u64 {
    drive.publish();
    let mut digest = Digest(DefaultHasher::new());
    write!(digest, "{drive:?}").unwrap();
    digest.0.finish()
}

/// Data words that mean something to one kind of instruction or another.
const WORDS: [[u16; 5]; 7] = [
    [VARIABLE; 5],
    [1, 2, 3, 4, 5],
    [0x0102, VARIABLE, VARIABLE, VARIABLE, VARIABLE],
    [0x8310, VARIABLE, 0x8310, 0, 0],
    [POINTER, VARIABLE, VARIABLE, 0, 0],
    [VARIABLE, POINTER, 0x8310, 0x8311, 0],
    [0x0020, 0x0002, 0, 0, 0],
];

/// Drives in which one instruction or another can have an effect.
fn drives() -> Vec<(&'static str, DriveFixture)> {
    let mut off = DriveFixture::new();
    off.word(VARIABLE, 3);
    off.word(VARIABLE + 1, 1);
    off.word(POINTER, 0x8300);
    off.word(LOGGER, 3);
    off.long(PRODUCT, 1000);
    let mut on = DriveFixture::new();
    on.axis_on();
    on.word(VARIABLE, 3);
    on.word(POINTER, 0x8300);
    let mut program = DriveFixture::new();
    program.axis_on();
    program.word(VARIABLE, 1);
    // An event far away; CALLS of a function that loops.
    program.load(0x8300, &[0x7400, 0x8300]);
    program.send_instruction(0x7092, &[0x0228, 0, 0x4000]);
    program.send_instruction(0x0401, &[]);
    program.send_instruction(0x0420, &[]);
    program.send_instruction(0x0510, &[]);
    program.send_instruction(0x0601, &[]);
    program.send_instruction(0x0620, &[]);
    program.send_instruction(0x0840, &[4]);
    program.send_instruction(0x1C01, &[0x8300]);
    let mut halted = DriveFixture::new();
    halted.axis_on();
    halted.send_instruction(0x0010, &[]);
    halted.send_instruction(0x0440, &[]);
    halted.send_instruction(0xEE00, &[0xFFFF]);
    halted.send_instruction(0x9603, &[]);
    halted.send_instruction(0x5909, &[0, 0xFFFF]);
    let fault = {
        let mut fixture = DriveFixture::new();
        fixture.axis_on();
        fixture.long(0x029E, 20_000);
        fixture.mode_pp();
        fixture.update();
        fixture.wait(50);
        fixture.act(crate::surroundings::Act::Fault(1 << 8));
        fixture
    };
    let drives =
        [("off", off), ("on", on), ("program", program), ("halted", halted), ("fault", fault)];
    drives.into_iter().collect()
}

fn samples(form: &Form) -> Vec<Instruction> {
    let operand = if form.mask == 0xFC00 { VARIABLE & 0x1FF } else { !form.mask & 1 };
    let opcode = form.opcode | operand;
    let count = usize::from(form.words_for(opcode));
    let fixed = form.fixed_words.len();
    let words = |pattern: &[u16; 5]| {
        let mut words: Vec<u16> = form.fixed_words.to_vec();
        words.extend(pattern.iter().cycle().take(count - fixed));
        words
    };
    WORDS.iter().filter_map(|pattern| Instruction::new(opcode, &words(pattern))).collect()
}

#[test]
fn every_instruction_has_an_effect_or_sets_an_error_bit() {
    let known = |form: &&Form| {
        form.certainty != CodingCertainty::Unknown && form.category != Category::Online
    };
    let (mut tried, mut ignored) = (0, Vec::new());
    for form in forms().filter(known) {
        tried += 1;
        let has_effect = samples(form).iter().any(|instruction| {
            drives().into_iter().any(|(_, fixture)| {
                let mut drive = fixture.device.drive;
                let before = digest(&mut drive);
                drive.execute(instruction);
                digest(&mut drive) != before
            })
        });
        if has_effect == WITHOUT_EFFECT.contains(&form.opcode) {
            let mut line = String::new();
            write!(line, "{:04X} {} {:?}", form.opcode, form.about, form.pieces).unwrap();
            ignored.push(line);
        }
    }
    assert!(ignored.is_empty(), "{} of {tried}: {ignored:#?}", ignored.len());
    assert!(tried > 242, "{tried}");
}
