//! Motion modes: masks on MCR that have names, and points, segments and cams.

use super::super::form::FormPiece::{
    Counter, Fixed, Long, Near16, Number, Point, Sign, Var16, Var32, Word,
};
use super::{Category, CodingSource, Form, FormPiece, form, short, whole};
use CodingSource::{Decompiler, Labels, Library, Manual};

/// `SRB MCR` with two masks.
macro_rules! mode {
    ($name:literal, $and:literal, $or:literal, $source:expr, $about:literal) => {
        form(Category::Mode, whole(0x5909, 2), &[Word($name)], $source, $about).with(&[$and, $or])
    };
}

const fn with(
    opcode: u16,
    words: u8,
    text: &'static [FormPiece],
    source: CodingSource,
    about: &'static str,
) -> Form {
    form(Category::Mode, whole(opcode, words), text, source, about)
}

/// A point of a path, whose counter is in the opcode.
const fn point(opcode: u16, words: u8, text: &'static [FormPiece], source: CodingSource) -> Form {
    form(Category::Mode, (opcode, 0xFF80, words), text, source, "the next point of a path")
}

const COMMA: FormPiece = Sign(", ");

pub(super) const FORMS: &[Form] = &[
    mode!("MODE PP", 0xBFC1, 0x8701, Library, "position profile"),
    mode!("MODE SP", 0xBBC1, 0x8301, Library, "speed profile"),
    mode!("MODE PSC", 0xFFC1, 0x8707, Library, "S-curve profile"),
    mode!("MODE PVT", 0xFFC1, 0x8709, Labels, "points with position, velocity and time"),
    mode!("MODE PT", 0xFFC0, 0x870A, Labels, "points with position and time"),
    mode!("MODE PC", 0xBFC2, 0x8702, Labels, "position contour"),
    mode!("MODE SC", 0xBBC2, 0x8302, Labels, "speed contour"),
    mode!("MODE TC", 0xB1C3, 0x8103, Labels, "torque contour"),
    mode!("MODE VC", 0xB0C3, 0x8003, Labels, "voltage contour"),
    mode!("MODE PE", 0xBFC0, 0x8700, Library, "position from outside"),
    mode!("MODE SE", 0xB3C0, 0x8300, Library, "speed from outside"),
    mode!("MODE TES", 0xB1C0, 0x8100, Library, "torque from outside, in the slow loop"),
    mode!("MODE TEF", 0xB1E0, 0x8120, Library, "torque from outside, in the fast loop"),
    mode!("MODE VES", 0xB0C0, 0x8000, Labels, "voltage from outside, in the slow loop"),
    mode!("MODE VEF", 0xB0E0, 0x8020, Decompiler, "voltage from outside, in the fast loop"),
    mode!("MODE GS", 0xB7C5, 0x8705, Library, "follows another axis through a gear"),
    mode!("MODE CS", 0xB7C6, 0x8706, Labels, "follows another axis through a cam"),
    mode!("MODE TT", 0xB1C8, 0x8108, Labels, "torque test"),
    mode!("MODE VT", 0xB0C8, 0x8008, Labels, "voltage test"),
    mode!("MODE PPD", 0xBFC4, 0x8704, Decompiler, "position by pulse and direction"),
    mode!("MODE SPD", 0xBBC4, 0x8304, Decompiler, "speed by pulse and direction"),
    mode!("MODE VM", 0xBFCC, 0x870C, Decompiler, "vector mode of several axes"),
    mode!("MODE PSIN", 0xBFCB, 0x870B, Decompiler, "position as a sine"),
    mode!("MODE SSIN", 0xBBCB, 0x830B, Decompiler, "speed as a sine"),
    mode!("MODE TSIN", 0xB1CB, 0x810B, Decompiler, "torque as a sine"),
    mode!("MODE VSIN", 0xB0CB, 0x800B, Decompiler, "voltage as a sine"),
    mode!("MODE PP0", 0xBCC1, 0x8401, Decompiler, "position loop alone"),
    mode!("MODE PP1", 0xBDC1, 0x8501, Decompiler, "position and torque loops"),
    mode!("MODE PP2", 0xBEC1, 0x8601, Decompiler, "position and speed loops"),
    mode!("MODE SP0", 0xBAC1, 0x8201, Decompiler, "speed loop alone"),
    mode!("MODE PC0", 0xBCC2, 0x8402, Decompiler, "position loop alone"),
    mode!("MODE PC1", 0xBDC2, 0x8502, Decompiler, "position and torque loops"),
    mode!("MODE PC2", 0xBEC2, 0x8602, Decompiler, "position and speed loops"),
    mode!("MODE SC0", 0xBAC2, 0x8202, Decompiler, "speed loop alone"),
    mode!("MODE PPD0", 0xBCC4, 0x8404, Decompiler, "position loop alone"),
    mode!("MODE PPD1", 0xBDC4, 0x8504, Decompiler, "position and torque loops"),
    mode!("MODE PPD2", 0xBEC4, 0x8604, Decompiler, "position and speed loops"),
    mode!("MODE SPD0", 0xBAC4, 0x8204, Decompiler, "speed loop alone"),
    mode!("MODE PE0", 0xBCC0, 0x8400, Decompiler, "position loop alone"),
    mode!("MODE PE1", 0xBDC0, 0x8500, Decompiler, "position and torque loops"),
    mode!("MODE PE2", 0xBEC0, 0x8600, Decompiler, "position and speed loops"),
    mode!("MODE SE0", 0xB2C0, 0x8200, Decompiler, "speed loop alone"),
    mode!("MODE GS0", 0xB4C5, 0x8405, Decompiler, "position loop alone"),
    mode!("MODE GS1", 0xB5C5, 0x8505, Decompiler, "position and torque loops"),
    mode!("MODE GS2", 0xB6C5, 0x8605, Decompiler, "position and speed loops"),
    mode!("MODE CS0", 0xB4C6, 0x8406, Decompiler, "position loop alone"),
    mode!("MODE CS1", 0xB5C6, 0x8506, Decompiler, "position and torque loops"),
    mode!("MODE CS2", 0xB6C6, 0x8606, Decompiler, "position and speed loops"),
    mode!("CPA", 0xFFFF, 0x2000, Library, "position commands are absolute"),
    mode!("CPR", 0xDFFF, 0x0000, Library, "position commands are relative"),
    mode!("TUM0", 0xBFFF, 0x0000, Decompiler, "the next motion begins at the actual position"),
    mode!("TUM1", 0xFFFF, 0x4000, Library, "the next motion begins at the target position"),
    mode!("EXTREF 0", 0xFF3F, 0x0000, Library, "the reference comes over the line"),
    mode!("EXTREF 1", 0xFF7F, 0x0040, Library, "the reference is analogue"),
    mode!("EXTREF 2", 0xFFBF, 0x0080, Library, "the reference is digital"),
    mode!("EXTREF 3", 0xFFFF, 0x00C0, Decompiler, "the fourth kind of reference"),
    mode!("REG_ON", 0xFFFF, 0x1000, Labels, "superposes a second motion"),
    mode!("REG_OFF", 0xEFFF, 0x0000, Labels, "superposes no second motion"),
    mode!("SGM", 0xFFFF, 0x0800, Labels, "is master of gear and cam"),
    mode!("SGN", 0xFFFF, 0x0800, Labels, "is master of gear and cam").alias(),
    mode!("RGM", 0xF7FF, 0x0000, Labels, "is master of gear and cam no more"),
    with(0x1880, 1, &[Word("SETPVT"), Number(0)], Labels, "sets up PVT and PT"),
    with(0x1880, 1, &[Word("SETPT"), Number(0)], Labels, "sets up PVT and PT").alias(),
    point(0x1800, 4, &[Word("PVTP"), Point, COMMA, Counter], Manual),
    point(
        0x1900,
        3,
        &[Word("PVTP"), Var32(0), COMMA, Var32(1), COMMA, Var16(2), COMMA, Counter],
        Labels,
    ),
    point(0xC800, 3, &[Word("PTP"), Long(0), COMMA, Number(2), COMMA, Counter], Labels),
    point(0xC900, 2, &[Word("PTP"), Var32(0), COMMA, Var16(1), COMMA, Counter], Labels),
    with(
        0x7800,
        3,
        &[Word("SEG"), Number(0), COMMA, Fixed(1)],
        Labels,
        "a segment of a contour: time and step",
    ),
    form(
        Category::Mode,
        short(0x7C00, 1),
        &[Word("SEG"), Near16, COMMA, Var32(0)],
        Labels,
        "a segment by variables",
    ),
    with(
        0xD840,
        2,
        &[Word("INITCAM"), Number(0), COMMA, Number(1)],
        Decompiler,
        "copies a cam table: from, to",
    ),
    with(
        0xD8C0,
        2,
        &[Word("INITCAM"), Var16(0), COMMA, Var16(1)],
        Labels,
        "copies a cam table by variables",
    ),
];
