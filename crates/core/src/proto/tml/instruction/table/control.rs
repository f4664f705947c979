//! Power, start and stop, configuration of the drive.

use super::super::form::FormPiece::{Axis, Count, Groups, Number, Sign, Var16, Var32, Word};
use super::{Category, CodingSource, Form, FormPiece, form, plain as plain_in, whole};
use CodingSource::{Decompiler, Labels, Library, Manual, Nowhere};

const fn plain(
    opcode: u16,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    plain_in(Category::Control, opcode, text, source, about)
}

const fn with(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Control, whole(opcode, words), text, source, about)
}

/// A name without an opcode.
const fn unknown(text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Control, (1, 0, 0), text, Nowhere, about)
}

/// The manual (chapter 3) prints 56600 for 57600.
const SCIBR_RATES: &str = "sets the serial rate: 0 to 4 are 9600, 19200, 38400, 57600 (56600 in the \
                           manual is a misprint), 115200";

pub(super) const FORMS: &[Form] = &[
    plain(0x0000, &[Word("NOP")], Labels, "does nothing"),
    plain(0x0001, &[Word("END")], Labels, "ends the program"),
    plain(0x649C, &[Word("BEGIN")], Labels, "begins the program"),
    plain(0x0002, &[Word("AXISOFF")], Library, "takes power off the motor"),
    plain(0x0102, &[Word("AXISON")], Library, "powers the motor"),
    plain(0x0020, &[Word("ENDINIT")], Library, "ends the initialisation"),
    plain(0x0402, &[Word("RESET")], Library, "resets the drive"),
    plain(0x0010, &[Word("BREAK")], Decompiler, "halts the program"),
    plain(0x0110, &[Word("CONTINUE")], Decompiler, "goes on with the program"),
    plain(0x0440, &[Word("DISPWM")], Decompiler, "turns the power stage off"),
    plain(0x0540, &[Word("ENPWM")], Decompiler, "turns the power stage on"),
    plain(0x0008, &[Word("UPD"), Sign("!")], Labels, "starts the motion at the event"),
    plain(0x0108, &[Word("UPD")], Library, "starts the motion, or takes its new parameters"),
    plain(0x00C4, &[Word("STOP"), Sign("!")], Labels, "stops at the event"),
    plain(0x01C4, &[Word("STOP")], Library, "stops with the deceleration that is set"),
    plain(0x01C4, &[Word("STOP3")], Library, "stops with the deceleration that is set").alias(),
    plain(0x0004, &[Word("STOP0"), Sign("!")], Decompiler, "stops at the event, kind 0"),
    plain(0x0044, &[Word("STOP1"), Sign("!")], Decompiler, "stops at the event, kind 1"),
    plain(0x0084, &[Word("STOP2"), Sign("!")], Decompiler, "stops at the event, kind 2"),
    plain(0x0104, &[Word("STOP0")], Decompiler, "stops, kind 0"),
    plain(0x0144, &[Word("STOP1")], Decompiler, "stops, kind 1"),
    plain(0x0184, &[Word("STOP2")], Decompiler, "stops, kind 2"),
    plain(0x0401, &[Word("ENCAPI0")], Labels, "captures at the index's falling edge"),
    plain(0x0501, &[Word("ENCAPI1")], Labels, "captures at the index's rising edge"),
    plain(0x0481, &[Word("DISCAPI")], Labels, "captures no more"),
    plain(0x0420, &[Word("EN2CAPI0")], Labels, "captures at the second index's falling edge"),
    plain(0x0520, &[Word("EN2CAPI1")], Labels, "captures at the second index's rising edge"),
    plain(0x04A0, &[Word("DIS2CAPI")], Labels, "captures at the second index no more"),
    plain(0x0601, &[Word("ENLSN0")], Labels, "watches the negative limit switch's falling edge"),
    plain(0x0701, &[Word("ENLSN1")], Labels, "watches the negative limit switch's rising edge"),
    plain(0x0681, &[Word("DISLSN")], Labels, "watches the negative limit switch no more"),
    plain(0x0620, &[Word("ENLSP0")], Labels, "watches the positive limit switch's falling edge"),
    plain(0x0720, &[Word("ENLSP1")], Labels, "watches the positive limit switch's rising edge"),
    plain(0x06A0, &[Word("DISLSP")], Labels, "watches the positive limit switch no more"),
    with(0x0801, 1, &[Word("AXISID"), Number(0)], Labels, "sets the axis ID"),
    with(0x0901, 1, &[Word("AXISID"), Var16(0)], Labels, "sets the axis ID from a variable"),
    with(0x0802, 1, &[Word("GROUPID"), Sign(" "), Groups(0)], Decompiler, "sets the groups"),
    with(0x0902, 1, &[Word("GROUPID"), Var16(0)], Decompiler, "sets the groups from a variable"),
    with(0x0840, 1, &[Word("ADDGRID"), Sign(" "), Groups(0)], Labels, "joins groups"),
    with(0x0940, 1, &[Word("ADDGRID"), Var16(0)], Labels, "joins groups of a variable"),
    with(0x0880, 1, &[Word("REMGRID"), Sign(" "), Groups(0)], Labels, "leaves groups"),
    with(0x0980, 1, &[Word("REMGRID"), Var16(0)], Labels, "leaves groups of a variable"),
    with(0x0820, 1, &[Word("SCIBR"), Number(0)], Labels, SCIBR_RATES),
    with(0x0920, 1, &[Word("SCIBR"), Var16(0)], Labels, "sets the serial rate from a variable"),
    with(0x0810, 1, &[Word("SPIBR"), Number(0)], Labels, "sets the EEPROM's rate"),
    with(0x0910, 1, &[Word("SPIBR"), Var16(0)], Labels, "sets the EEPROM's rate from a variable"),
    with(0x0804, 1, &[Word("CANBR"), Number(0)], Library, "sets the CAN bit rate"),
    with(0x0904, 1, &[Word("CANBR"), Var16(0)], Labels, "sets the CAN bit rate from a variable"),
    with(0x0808, 1, &[Word("CANOC"), Number(0)], Decompiler, "sets the CAN output control"),
    with(0x0908, 1, &[Word("CANOC"), Var16(0)], Decompiler, "the same from a variable"),
    with(0x1C04, 0, &[Word("FAULTR")], Library, "clears the fault"),
    with(0x1C08, 0, &[Word("SAVE")], Library, "keeps the set-up in the EEPROM"),
    with(0x9500, 0, &[Word("ENEEPROM")], Labels, "allows writes to the EEPROM"),
    form(
        Category::Control,
        (0x9600, 0xFFFC, 0),
        &[Word("LOCKEEPROM"), Count(2, 3)],
        Labels,
        "forbids writes to so much of the EEPROM",
    ),
    with(0x1000, 0, &[Word("SYNCHRONISATION")], Manual, "has everybody latch its time"),
    with(0x1000, 0, &[Word("SYNC")], Manual, "has everybody latch its time").alias(),
    form(
        Category::Control,
        whole(0x1401, 2),
        &[Word("MASTERTIME"), FormPiece::Long(0)],
        Manual,
        "tells the master's time at the last synchronisation",
    ),
    form(
        Category::Control,
        whole(0x1404, 2),
        &[Word("SETSYNC"), FormPiece::Long(0)],
        Library,
        "synchronises the others so often; 0 ends it",
    ),
    with(0xF010, 1, &[Word("GETERROR"), Var32(0)], Decompiler, "reads the last stored error"),
    with(
        0xF013,
        2,
        &[Word("GETERROR"), Number(0), Sign(", "), Var32(1)],
        Decompiler,
        "reads a stored error",
    ),
    with(0xF011, 1, &[Word("SAVEERROR"), Var32(0)], Decompiler, "stores an error"),
    with(0xF012, 0, &[Word("CLEARERROR")], Decompiler, "forgets the stored errors"),
    with(0xF080, 0, &[Word("INITSLAVES")], Decompiler, "starts the slaves of a controller"),
    with(0xF100, 1, &[Word("SETMODE"), Number(0)], Decompiler, "sets the slaves' mode"),
    with(0xF600, 2, &[Word("TIMEOUT"), FormPiece::Long(0)], Decompiler, "sets a time-out"),
    with(0xD802, 1, &[Word("SETWS"), Number(0)], Decompiler, "sets wait states"),
    with(0x5965, 2, &[Word("STOPLOG")], Decompiler, "stops the data logger")
        .with(&[0xFFFC, 0x0000]),
    with(0x5965, 2, &[Word("STARTLOG"), Sign(" 1")], Decompiler, "logs in the slow loop")
        .with(&[0xFFFC, 0x0001]),
    with(0x5965, 2, &[Word("STARTLOG"), Sign(" 2")], Decompiler, "logs in the fast loop")
        .with(&[0xFFFC, 0x0002]),
    unknown(&[Word("ENIO"), Sign("#"), Number(0)], "makes a line an input or output"),
    unknown(&[Word("DISIO"), Sign("#"), Number(0)], "gives a line its second function"),
    unknown(&[Word("ROUT"), Sign("#"), Number(0)], "clears one output"),
    unknown(&[Word("SOUT"), Sign("#"), Number(0)], "sets one output"),
    unknown(&[Word("OUTPORT"), Axis(0)], "writes a port"),
];
