//! Programs, events, calls.

use super::Vec;
use super::{DriveFixture, messages};
use crate::surroundings::{Act, SurroundingsControl};
use polepair_core::medium::{Can, Frame};
use polepair_core::proto::tml::tmlcan;
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message};
use polepair_core::station::Station;

impl DriveFixture {
    /// Downloads words as the vendor's tools do: a pointer in a variable, then word by word.
    pub(super) fn load(&mut self, at: u16, words: &[u16]) {
        self.word(0x032B, at);
        for word in words {
            self.send_instruction(0x9020, &[0x032B, *word]);
        }
        assert_eq!(self.read(0x032B), at + words.len() as u16);
    }
}

#[test]
fn a_program_in_ram_moves_waits_and_ends() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    let program = [
        0x249E, 4000, 0, // CPOS = 4000
        0x5909, 0xBFC1, 0x8701, // MODE PP
        0x5909, 0xFFFF, 0x2000, // CPA
        0x0108, // UPD
        0x700F, 0x0408, // !MC; WAIT!
        0x2166, 77,     // VAR_I1 = 77
        0x0001, // END
    ];
    fixture.load(0x8300, &program);
    fixture.send_instruction(0x7400, &[0x8300]);
    fixture.wait(100);
    assert_eq!(fixture.read(0x0366), 0, "it waits");
    fixture.wait(1000);
    assert_eq!((fixture.read(0x0366), fixture.read_long(0x0228)), (77, 4000));
    assert_eq!(fixture.read(0x090E) & 0x4000, 0x4000, "the event has come");
}

#[test]
fn the_eeprom_is_written_through_a_pointer_and_summed_up() {
    let mut fixture = DriveFixture::new();
    fixture.word(0x032B, 0x4100);
    for word in [0x1234, 0xFFFF, 0x0001] {
        fixture.send_instruction(0x9028, &[0x032B, word]);
    }
    assert_eq!(fixture.read(0x032B), 0x4103);
    fixture.send_instruction(0xDB50, &[0x0366, 0x4100, 0x4102]);
    assert_eq!(fixture.read(0x0366), 0x1234);
    assert_eq!(fixture.request(0xB008, 0x4101), 0xFFFF);
    assert_eq!(fixture.device.ground_truth(fixture.now).flash_writes, 3);
    fixture.act(Act::PowerCycle);
    assert_eq!(fixture.request(0xB008, 0x4100), 0x1234);
    fixture.send_instruction(0x9603, &[]);
    fixture.word(0x032B, 0x4100);
    fixture.send_instruction(0x9028, &[0x032B, 0]);
    assert_eq!((fixture.read(0x03AD), fixture.request(0xB008, 0x4100)), (0x8000, 0x1234));
}

#[test]
fn the_eeprom_takes_its_time_and_the_drive_answers_then() {
    let mut fixture = DriveFixture::new();
    fixture.word(0x032B, 0x4100);
    fixture.send_instruction(0x9029, &[0x032B, 0x1234, 0x5678]);
    fixture.send_instruction(0x9028, &[0x032B, 0x9ABC]);
    let host = IdCode::host_at(255).word();
    let request = [host, 0x032B];
    assert_eq!(
        fixture.send(IdCode::axis(255), 0xB004, &request),
        [0x4F],
        "heard, not answered yet"
    );
    fixture.wait(9);
    assert!(fixture.sent().is_empty(), "two writes of 5 ms");
    fixture.wait(1);
    assert_eq!(messages(&fixture.sent())[0].instruction.word(2), 0x4103);
    assert_eq!(fixture.device.ground_truth(fixture.now).flash_writes, 3, "words");
    // RAM is written at once.
    fixture.word(0x032B, 0x8300);
    fixture.send_instruction(0x9020, &[0x032B, 0x1234]);
    assert_eq!(messages(&fixture.send(IdCode::axis(255), 0xB004, &request)[1..]).len(), 1);
}

#[test]
fn a_program_in_the_eeprom_starts_with_the_drive_and_ram_is_empty_then() {
    let mut fixture = DriveFixture::new();
    let program = [0x649C, 0x2166, 77, 0x0001]; // BEGIN; VAR_I1 = 77; END
    for (n, word) in (0..).zip(program) {
        fixture.word(0x032B, 0x4000 + n);
        fixture.send_instruction(0x9028, &[0x032B, word]);
    }
    fixture.load(0x8300, &program);
    assert_eq!(fixture.read(0x0366), 0, "written is not run");
    fixture.act(Act::PowerCycle);
    fixture.wait(2);
    assert_eq!((fixture.read(0x0366), fixture.request(0xB000, 0x8301)), (77, 0));
    fixture.word(0x0366, 0);
    fixture.send_instruction(0x0402, &[]); // RESET
    fixture.wait(2);
    assert_eq!((fixture.read(0x0366), fixture.request(0xB008, 0x4003)), (77, 1));
}

#[test]
fn loops_conditions_and_calls() {
    let mut fixture = DriveFixture::new();
    let program = [
        0x2166, 5, // VAR_I1 = 5
        0x7401, 0x8310, // loop: CALL add
        0x4966, 1, // VAR_I1 -= 1
        0x7484, 0x0366, 0x8302, // GOTO loop, VAR_I1, GT
        0x0001,
    ];
    fixture.load(0x8300, &program);
    fixture.load(0x8310, &[0x3967, 3, 0x0404]); // VAR_I2 += 3; RET
    fixture.send_instruction(0x7400, &[0x8300]);
    fixture.wait(10);
    assert_eq!((fixture.read(0x0366), fixture.read(0x0367)), (0, 15));
    fixture.send_instruction(0x0404, &[]);
    assert_eq!(fixture.read(0x03AD), 1 << 1, "RET without a call");
}

#[test]
fn cancelable_calls_one_at_a_time() {
    let mut fixture = DriveFixture::new();
    fixture.load(0x8300, &[0x7400, 0x8300]); // for ever
    fixture.send_instruction(0x1C01, &[0x8300]);
    fixture.wait(5);
    assert_eq!(fixture.read(0x090E) & 0x0180, 0x0100);
    fixture.send_instruction(0x1C01, &[0x8300]);
    assert_eq!(fixture.read(0x090E) & 0x0180, 0x0180);
    assert_eq!(fixture.read(0x03AD), 1 << 5);
    fixture.send_instruction(0x1C02, &[]);
    assert_eq!(fixture.read(0x090E) & 0x0100, 0);
    assert!(!fixture.device.drive.program.is_active());
    fixture.send_instruction(0x1C81, &[]);
    assert_eq!(fixture.read(0x03AD), 1 << 5 | 1 << 3, "there is no function table");
}

#[test]
fn messages_wait_behind_wait_but_a_stop_does_not() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.move_to(20_000);
    fixture.send_instruction(0x700F, &[]);
    fixture.send_instruction(0x0408, &[]);
    fixture.word(0x0366, 9);
    fixture.wait(10);
    assert_eq!(fixture.read(0x0366), 0, "held; the reading went before it");
    fixture.send_instruction(0x01C4, &[]);
    fixture.wait(500);
    assert!(fixture.read_long(0x0228) < 10_000);
    assert_eq!(fixture.read(0x0366), 9, "STOP completed the motion");
}

#[test]
fn an_update_at_a_position() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.move_to(20_000);
    fixture.send_instruction(0x7092, &[0x0228, 4000, 0]); // !APO 4000
    fixture.long(0x029E, 0);
    fixture.mode_pp();
    fixture.send_instruction(0x5909, &[0xFFFF, 0x6000]);
    fixture.send_instruction(0x0008, &[]); // UPD!
    fixture.wait(4000);
    assert_eq!((fixture.read_long(0x0228), fixture.read(0x090E)), (0, 0xC400));
}

#[test]
fn a_program_runs_at_power_up_if_it_begins_with_begin() {
    let mut fixture = DriveFixture::new();
    fixture.word(0x032B, 0x4000);
    for word in [0x649C, 0x0020, 0x2166, 55, 0x0001] {
        fixture.send_instruction(0x9028, &[0x032B, word]);
    }
    fixture.act(Act::PowerCycle);
    fixture.wait(5);
    assert_eq!((fixture.read(0x0366), fixture.read(0x090F)), (55, 1));
}

#[test]
fn an_interrupt_runs_its_routine_once_per_flag() {
    let mut fixture = DriveFixture::new();
    fixture.axis_on();
    fixture.load(0x8400, &[0; 12]);
    fixture.load(0x8409, &[0x8420]); // interrupt 9: motion complete
    fixture.load(0x8420, &[0x3966, 1, 0x0504]); // VAR_I1 += 1; RETI
    fixture.word(0x0307, 0x8400);
    fixture.word(0x0304, 1 << 9);
    fixture.send_instruction(0x0510, &[]);
    for target in [1000, 0] {
        fixture.move_to(target);
        fixture.wait(1000);
    }
    assert_eq!(fixture.read(0x0366), 2);
}

#[test]
fn drives_order_drives_and_read_them() {
    let mut fixture = DriveFixture::at(Some(1), &[]);
    // [7]{CPOS = 5}; [G1] VAR_I1 = VAR_I2; VAR_LF = [7] APOS; END
    let program = [
        0x9402, 0x0070, 0x249E, 5, 0, 0xB966, 0x1010, 0x0367, 0xE428, 0x0070, 0x0368, 0x2166, 1,
        0x0001,
    ];
    fixture.word(0x0367, 3);
    fixture.load(0x8300, &program);
    fixture.send_instruction(0x7400, &[0x8300]);
    fixture.wait(2);
    let mut sent = Vec::new();
    let mut frame = Frame::default();
    while Station::<Can>::poll_transmit(&mut fixture.device, fixture.now, &mut frame).is_some() {
        sent.push(tmlcan::decode(&frame).unwrap());
    }
    let to = IdCode::axis(7);
    assert_eq!(sent[0], Message { to, instruction: Instruction::of(0x249E, [5, 0]) });
    let to = IdCode::groups(1);
    assert_eq!(sent[1], Message { to, instruction: Instruction::of(0x2166, [3]) });
    let to = IdCode::axis(7);
    assert_eq!(sent[2], Message { to, instruction: Instruction::of(0xA428, [0x0010]) });
    let answer = Instruction::of(0xAC28, [0x0070, 0x1234, 0x0001]);
    let answer = tmlcan::encode(&Message { to: IdCode::axis(1), instruction: answer });
    Station::<Can>::handle_input(&mut fixture.device, fixture.now, &answer);
    fixture.wait(2);
    assert_eq!((fixture.read_long(0x0368), fixture.read(0x0366)), (0x0001_1234, 1));
    assert!(messages(&fixture.sent()).is_empty());
}

#[test]
fn arithmetic_as_the_forms_say() {
    let mut fixture = DriveFixture::new();
    fixture.word(0x0366, (-300_i16).cast_unsigned());
    fixture.send_instruction(0x8C00, &[0x0366, 200]); // PROD = VAR_I1 * 200
    assert_eq!(fixture.read_long(0x030E), -60_000);
    fixture.send_instruction(0x8884, &[]); // PROD >>= 4
    assert_eq!(fixture.read_long(0x030E), -3750);
    fixture.long(0x0368, 1000);
    fixture.send_instruction(0xDC01, &[0x0368, 0x0366]); // VAR_LF /= VAR_I1
    assert_eq!(fixture.read_long(0x0368), -3);
    fixture.send_instruction(0x3566, &[0x0368]); // VAR 0366 (32 bits) = -VAR_LF
    assert_eq!(fixture.read_long(0x0366), 3);
    fixture.send_instruction(0x8970, &[0x0368, 0x0366]); // VAR_LF = VAR_I1 << 16
    assert_eq!(fixture.read_long(0x0368), 3 << 16);
    fixture.send_instruction(0x5966, &[0x0001, 0x0080]); // SRB
    assert_eq!(fixture.read(0x0366), 0x0081);
}
