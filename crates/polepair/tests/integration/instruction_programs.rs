//! Programs of TMCL modules, from their text to what the simulated module does.

use polepair::instruction_program::language_of;
use polepair::{Connector, InstructionProgram, LocalAxis, connect_local};
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::profile::Signal;
use polepair_core::program::InstructionBytes;
use polepair_core::proto::tmcl::Opcode;
use polepair_core::proto::tmcl::module::program::{is_direct, is_program_only};
use polepair_core::time::Instant;
use polepair_link::{Tap, TapDirection};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const STEP: Duration = Duration::from_millis(5);

fn assemble(text: &str) -> InstructionProgram {
    let language = language_of("test.tmc".as_ref()).unwrap();
    InstructionProgram::assemble(language, "test.tmc", text, None).unwrap()
}

/// Runs the loaded program to its end.
fn run(axis: &LocalAxis) {
    axis.run_instructions(Some(0)).unwrap();
    for _ in 0..10_000 {
        if !axis.program_status().unwrap().running {
            return;
        }
        axis.sleep(STEP);
    }
    panic!("the program did not end");
}

fn variable(axis: &LocalAxis, number: u16) -> i64 {
    axis.get_raw(&format!("GP {number}.2")).unwrap()
}

/// Returns the value of user variable 1 after a program.
fn result(text: &str) -> i64 {
    let link = connect_local("sim:tmcm-6110?time=virtual#1").unwrap();
    let axis = link.axis(1).unwrap();
    let armed = axis.armed().unwrap();
    armed.download_instructions(&assemble(text), |_| ()).unwrap();
    run(&armed);
    variable(&armed, 1)
}

#[test]
fn programs_calculate_as_the_reference_says() {
    for (text, expected) in [
        ("CALC LOAD, 7\nCALC MUL, 6\nAGP 1, 2\nSTOP", 42),
        ("CALC LOAD, 7\nCALCX LOAD\nCALC LOAD, 3\nCALCX SUB\nAGP 1, 2\nSTOP", -4),
        ("CALCV LOAD, 1, 5\nCALCV LOAD, 2, 8\nCALCVV ADD, 1, 2\nSTOP", 13),
        ("CALC LOAD, 9\nCALCV LOAD, 1, 5\nCALCVA SUB, 1\nSTOP", -4),
        ("CALC LOAD, 9\nCALCV LOAD, 2, 5\nCALCAV MOD, 2\nAGP 1, 2\nSTOP", 4),
        ("CALCV LOAD, 2, 5\nCALCXV LOAD, 2\nCALCV LOAD, 1, 1\nCALCVX ADD, 1\nSTOP", 6),
        ("CALC LOAD, 3\nPUSHA\nCALC LOAD, 4\nPUSHA\nPOPX\nPOPA\nCALCX SUB\nAGP 1, 2\nSTOP", -1),
        ("CALC LOAD, 1\nCALCX LOAD\nSIV 77\nSTOP", 77),
        (
            "CALC LOAD, 1\nCALCX LOAD\nCALC LOAD, 12\nAIV\nCALC LOAD, 0\nGIV\nCALC ADD, 1\nAIV\nSTOP",
            13,
        ),
        ("CALCV LOAD, 2, 4\nLoop: CALCV ADD, 1, 10\nDJNZ 2, Loop\nSTOP", 40),
        // What was compared is that of COMP, though the accumulator changed.
        ("CALC LOAD, 5\nCOMP 5\nCALC LOAD, 6\nJC EQ, Same\nSTOP\nSame: SGP 1, 2, 1\nSTOP", 1),
        ("CALCV LOAD, 1, 3\nCALCV COMP, 1, 2\nCALL GT, More\nSTOP\nMore: SGP 1, 2, 9\nRSUB", 9),
        ("WAIT REFSW, 0, 2\nJC ETO, Late\nSTOP\nLate: SGP 1, 2, 2\nSTOP", 2),
        ("SCO 3, 4, 250\nGCO 3, 4\nAGP 1, 2\nSTOP", 250),
        ("CALC LOAD, 4\nCALCX LOAD\nSAPX 4, 321\nGAP 4, 4\nAGP 1, 2\nSTOP", 321),
        ("GGP 1, 2\nCOMP 3\nJC EQ, End\nCALC ADD, 1\nAGP 1, 2\nRST 0\nEnd: STOP", 3),
    ] {
        assert_eq!(result(text), expected, "{text}");
    }
}

#[test]
fn timers_arrivals_and_inputs_interrupt_a_program() {
    let timer = "VECT 0, Tick\nSGP 0, 3, 20\nEI 0\nEI 255\nWAIT TICKS, 0, 30\nDI 255\nSTOP\n\
                 Tick: GGP 1, 2\nCALC ADD, 1\nAGP 1, 2\nRETI";
    let ticks = result(timer);
    assert!((12..=16).contains(&ticks), "{ticks} in 300 ms of 20 ms each");
    let arrival = "VECT 5, There\nEI 5\nEI 255\nMVP ABS, 2, 3200\nLoop: GGP 1, 2\nJC ZE, Loop\nSTOP\n\
                   There: SGP 1, 2, 4\nRETI";
    assert_eq!(result(arrival), 4);
    // Registers are those of before behind an interrupt.
    let kept = "VECT 1, Tick\nSGP 1, 3, 10\nEI 1\nCALC LOAD, 8\nEI 255\nWAIT TICKS, 0, 5\nAGP 1, 2\nSTOP\n\
                Tick: CALC LOAD, 0\nRETI";
    assert_eq!(result(kept), 8);
}

#[test]
fn a_program_is_stored_read_back_and_stepped_through() {
    for url in [
        "sim:tmcm-1140?time=virtual",
        "sim:tmcm-1140+can?time=virtual",
        "sim:tmcm-171?time=virtual",
    ] {
        let link = connect_local(url).unwrap();
        let axis = link.axis(1).unwrap();
        // The type of CALC SUB is 1, as the status for a wrong checksum.
        let text = "Loop: CALC SUB, 2\nSAP 4, 0, 500\nCALC ADD, 1\nJA Loop\nSTOP\nSTOP";
        let program = assemble(text);
        let unarmed = axis.download_instructions(&program, |_| ()).unwrap_err();
        assert_eq!(unarmed.code(), "E219", "{unarmed}");
        let armed = axis.armed().unwrap();
        let stored = armed.download_instructions(&program, |_| ()).unwrap();
        assert_eq!((stored.done, stored.total), (6, 6));
        let read = armed.upload_instructions(None, |_| ()).unwrap();
        assert_eq!(read.instructions(), &program.instructions()[..4], "{url}");
        let differs = armed.verify_instructions(&assemble("CALC SUB, 2\nSTOP")).unwrap_err();
        assert!(
            differs.code() == "E103" && differs.to_string().contains("at address 1"),
            "{differs}"
        );
        armed.reset_program().unwrap();
        let counters: Vec<u16> = (0..5)
            .map(|_| {
                let mut status = armed.step_instruction().unwrap();
                while status.running {
                    armed.sleep(STEP);
                    status = armed.program_status().unwrap();
                }
                status.counter
            })
            .collect();
        assert_eq!(counters, [1, 2, 3, 0, 1], "{url}");
        armed.run_instructions(Some(0)).unwrap();
        let busy = armed.download_instructions(&program, |_| ()).unwrap_err();
        assert!(busy.code() == "E222" && busy.to_string().contains("a program runs"), "{busy}");
        armed.stop().unwrap();
        assert!(!armed.program_status().unwrap().running);
    }
}

#[test]
fn no_program_is_stored_while_a_motor_of_the_module_turns() {
    let link = connect_local("sim:tmcm-6110?time=virtual").unwrap();
    let other = link.axis_named("1.4").unwrap();
    let turning = other.armed().unwrap();
    turning.velocity("30 rpm").unwrap();
    turning.sleep(Duration::from_millis(200));
    let axis = link.axis(1).unwrap();
    let armed = axis.armed().unwrap();
    let refused = armed.download_instructions(&assemble("STOP"), |_| ()).unwrap_err();
    assert!(refused.code() == "E222" && refused.to_string().contains("turns"), "{refused}");
    turning.stop().unwrap();
}

/// A module that another host has set to store instructions executes nothing, not even a stop.
#[test]
fn a_module_that_stores_instructions_is_not_reported_to_have_executed_any() {
    let link = connect_local("sim:tmcm-1140?time=virtual").unwrap();
    let axis = link.axis(1).unwrap();
    let armed = axis.armed().unwrap();
    armed.raw("START DOWNLOAD 0, 0, 0").unwrap();
    let stored = armed.raw("MVP ABS, 0, 1000").unwrap_err();
    assert!(
        stored.code() == "E601" && stored.to_string().contains("loaded into program memory"),
        "{stored}"
    );
    armed.raw("QUIT DOWNLOAD 0, 0, 0").unwrap();
    assert_eq!(armed.get_raw("target position").unwrap(), 0);
}

/// Bytes to the drives: what a serial host sent, or the frames of a CAN host.
#[derive(Clone, Default)]
struct Sent(Arc<Mutex<Vec<Vec<u8>>>>);

impl Sent {
    /// The requests, as opcode, type, motor and value.
    fn requests(&self, serial: bool) -> Vec<Vec<u8>> {
        let sent = self.0.lock().unwrap();
        if !serial {
            return sent.clone();
        }
        sent.concat().chunks(9).map(|request| request[1..8].to_vec()).collect()
    }
}

impl Tap<Stream> for Sent {
    fn record_unit(&mut self, _: Instant, direction: TapDirection, bytes: &[u8]) {
        if direction == TapDirection::ToDrive {
            self.0.lock().unwrap().push(bytes.to_vec());
        }
    }
}

impl Tap<Can> for Sent {
    fn record_unit(&mut self, _: Instant, direction: TapDirection, frame: &Frame) {
        if direction == TapDirection::ToDrive {
            self.0.lock().unwrap().push(frame.bytes()[..7].to_vec());
        }
    }
}

/// Each instruction that a module has, twice in a row and for several motors, also those that a session treats
/// specially as requests: MST, ROR with speed 0, GAP.
fn every_instruction() -> Vec<InstructionBytes> {
    let known = |opcode: &&Opcode| is_direct(**opcode) || is_program_only(**opcode);
    let opcodes = Opcode::NAMED.iter().filter(known).map(|opcode| opcode.number());
    let mut all: Vec<_> = opcodes
        .flat_map(|opcode| [[opcode, 0, 0, 0, 0, 0, 0], [opcode, 2, 1, 0xFF, 0xFE, 3, 4]])
        .flat_map(|instruction| [instruction; 2])
        .collect();
    let mst = |motor| [Opcode::Mst.number(), 0, motor, 0, 0, 0, 0];
    all.extend([0, 1, 2, 3, 4, 5, 0, 0, 5].map(mst));
    all
}

#[test]
fn nothing_but_the_program_is_sent_in_download_mode_and_it_is_stored_byte_for_byte() {
    for (url, serial) in [
        ("sim:tmcm-6110?time=virtual", true),
        ("sim:tmcm-6110+can?time=virtual", false),
        ("sim:tmcm-171?time=virtual", true),
        ("sim:tmcm-171+can?time=virtual", false),
    ] {
        let sent = Sent::default();
        let link = Connector::default().with_tap(sent.clone()).connect_local(url).unwrap();
        let axis = link.axis(1).unwrap();
        let program = InstructionProgram::from_instructions(
            axis.instruction_language().unwrap(),
            every_instruction(),
        );
        let armed = axis.armed().unwrap();
        // What another part of the host asks for meanwhile is not sent.
        let mut refusals = Vec::new();
        armed
            .download_instructions(&program, |progress| {
                if progress.done == 40 {
                    refusals.extend(axis.signals(&[Signal::Position]).err());
                    refusals.extend(axis.set_raw("max current", 1).err());
                }
            })
            .unwrap();
        assert_eq!(refusals.len(), 2, "{url}: {refusals:?}");
        assert!(
            refusals.iter().all(|error| error.to_string().contains("loaded into")),
            "{refusals:?}"
        );
        axis.signals(&[Signal::Position]).unwrap();
        let stored = armed.upload_instructions(Some(program.instructions().len()), |_| ()).unwrap();
        assert_eq!(stored.instructions(), program.instructions(), "{url}");
        let sent = sent.requests(serial);
        let at = |opcode| sent.iter().position(|request| request[0] == opcode).unwrap();
        let between = &sent[at(132) + 1..at(133)];
        assert_eq!(between, program.instructions(), "{url}");
    }
}
