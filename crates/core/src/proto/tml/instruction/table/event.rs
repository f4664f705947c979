//! Events for UPD!, STOP! and WAIT!. The first data word is the monitored variable.

use super::super::form::FormPiece::{Fixed, High, Line, Long, Sign, Var32, Word};
use super::{Category, CodingSource, Form, FormPiece, form, whole};
use CodingSource::Labels;

/// The watched variable against a number: opcode 70nn; and against another variable: 71nn.
macro_rules! event {
    ($name:literal, $code:literal, $watched:literal, $number:expr, $about:literal) => {
        [
            form(
                Category::Event,
                whole(0x7000 | $code, 3),
                &[Sign("!"), Word($name), $number],
                Labels,
                $about,
            )
            .with(&[$watched]),
            form(
                Category::Event,
                whole(0x7100 | $code, 2),
                &[Sign("!"), Word($name), Var32(1)],
                Labels,
                $about,
            )
            .with(&[$watched]),
        ]
    };
}

const fn alias([number, variable]: [Form; 2]) -> [Form; 2] {
    [number.alias(), variable.alias()]
}

const fn plain(opcode: u16, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Event, whole(opcode, 0), text, Labels, about)
}

const fn with(opcode: u16, words: u8, text: &'static [FormPiece], about: &'static str) -> Form {
    form(Category::Event, whole(opcode, words), text, Labels, about)
}

const PAIRS: [[Form; 2]; 22] = [
    event!("ALPO", 0x92, 0x0228, Long(1), "load position over"),
    event!("ALPU", 0x83, 0x0228, Long(1), "load position under"),
    event!("AMPO", 0x92, 0x0988, Long(1), "motor position over"),
    event!("AMPU", 0x83, 0x0988, Long(1), "motor position under"),
    event!("RPO", 0x94, 0x02BA, Long(1), "relative load position over"),
    alias(event!("RLPO", 0x94, 0x02BA, Long(1), "relative load position over")),
    event!("RPU", 0x85, 0x02BA, Long(1), "relative load position under"),
    alias(event!("RLPU", 0x85, 0x02BA, Long(1), "relative load position under")),
    event!("RMPO", 0x94, 0x0988, Long(1), "relative motor position over"),
    event!("RMPU", 0x85, 0x0988, Long(1), "relative motor position under"),
    event!("LSO", 0x96, 0x098A, Fixed(1), "load speed over"),
    event!("LSU", 0x87, 0x098A, Fixed(1), "load speed under"),
    event!("MSO", 0x96, 0x022C, Fixed(1), "motor speed over"),
    event!("MSU", 0x87, 0x022C, Fixed(1), "motor speed under"),
    event!("RO", 0x90, 0x02AE, Long(1), "reference over"),
    event!("RU", 0x81, 0x02AE, Long(1), "reference under"),
    alias(event!("PRO", 0x90, 0x02AE, Long(1), "position reference over")),
    alias(event!("PRU", 0x81, 0x02AE, Long(1), "position reference under")),
    alias(event!("SRO", 0x90, 0x02AE, Fixed(1), "speed reference over")),
    alias(event!("SRU", 0x81, 0x02AE, Fixed(1), "speed reference under")),
    alias(event!("TRO", 0x90, 0x02AE, High(1), "torque reference over")),
    alias(event!("TRU", 0x81, 0x02AE, High(1), "torque reference under")),
];

const TIMES: [[Form; 2]; 2] = [
    event!("AT", 0x98, 0x02C0, Long(1), "absolute time reached"),
    event!("RT", 0xB9, 0x02C2, Long(1), "relative time reached"),
];

const COMMA: FormPiece = Sign(", ");

const OTHERS: [Form; 10] = [
    plain(0x700F, &[Sign("!"), Word("MC")], "motion complete"),
    plain(0x700C, &[Sign("!"), Word("LSN")], "negative limit switch"),
    plain(0x700D, &[Sign("!"), Word("LSP")], "positive limit switch"),
    plain(0x700E, &[Sign("!"), Word("CAP")], "position captured"),
    with(0x70DA, 1, &[Sign("!"), Word("IN"), Sign("#"), Line(0), Sign(" 1")], "input goes high"),
    with(0x70DB, 1, &[Sign("!"), Word("IN"), Sign("#"), Line(0), Sign(" 0")], "input goes low"),
    with(0x7090, 3, &[Sign("!"), Word("VO"), Var32(0), COMMA, Long(1)], "a variable over"),
    with(0x7190, 2, &[Sign("!"), Word("VO"), Var32(0), COMMA, Var32(1)], "a variable over"),
    with(0x7081, 3, &[Sign("!"), Word("VU"), Var32(0), COMMA, Long(1)], "a variable under"),
    with(0x7181, 2, &[Sign("!"), Word("VU"), Var32(0), COMMA, Var32(1)], "a variable under"),
];

pub(super) const FORMS: &[Form] = &flat();

/// All of them in one row, special ones first.
const fn flat() -> [Form; 58] {
    let mut all = [OTHERS[0]; 58];
    let mut n = 0;
    while n < 24 {
        let pair = if n < 22 { PAIRS[n] } else { TIMES[n - 22] };
        (all[2 * n], all[2 * n + 1]) = (pair[0], pair[1]);
        n += 1;
    }
    n = 0;
    while n < 10 {
        all[48 + n] = OTHERS[n];
        n += 1;
    }
    all
}
