//! A register's value, bit by bit.

use core::fmt::Write as _;

use super::message::SinkWriter;
use crate::explain::{ExplainSink, Field, FieldValue};
use crate::profile::{Fault, Profile, Signal};
use crate::proto::tml::instruction::{self, Register};

/// Explains a register's value. `false` when no register has that name.
pub(super) fn explain_register(
    name: &str,
    value: u32,
    profile: Option<&'static Profile>,
    sink: &mut dyn ExplainSink,
) -> bool {
    let mut before = "";
    for (register, value, first) in register_parts(name, value) {
        sink.kind(register.name);
        let _ = write!(SinkWriter(sink), "{before}0x{value:04X}, {}", register.about);
        for bits in register.shown_fields(value) {
            let (start, end) = (first + bits.low, first + bits.high + 1);
            let (number, meaning) =
                (FieldValue::Int(bits.value_in(value).into()), bits.meaning(value));
            let (start, end) = (start.into(), end.into());
            sink.field(Field { name: bits.name, start, end, value: number, meaning });
        }
        shown_faults(register, value, profile).for_each(|fault| explain_fault(fault, sink));
        before = "; ";
    }
    !before.is_empty()
}

/// The register of that name, its value and where its bits begin; of SR32 both halves.
fn register_parts(name: &str, value: u32) -> impl Iterator<Item = (&'static Register, u32, u8)> {
    let both = name.eq_ignore_ascii_case("SR32");
    let named = [
        (instruction::find_register(if both { "SRL" } else { name }), value, 0),
        (instruction::find_register("SRH").filter(|_| both), value >> 16, 16),
    ];
    named.into_iter().filter_map(move |(register, value, first)| {
        register.map(|register| (register, limited_value(value, both), first))
    })
}

fn limited_value(value: u32, both: bool) -> u32 {
    if both { value & 0xFFFF } else { value }
}

/// The profile's faults that the value shows, when this is the register that it has them from.
fn shown_faults(
    register: &Register,
    value: u32,
    profile: Option<&'static Profile>,
) -> impl Iterator<Item = &'static Fault> {
    let source = profile.and_then(|profile| {
        let parameter = profile.parameter(profile.signal(Signal::Fault)?.parameter)?;
        let same = parameter.symbol == register.name;
        same.then_some(profile.faults)
    });
    source.into_iter().flatten().filter(move |fault| fault.code & value != 0)
}

fn explain_fault(fault: &Fault, sink: &mut dyn ExplainSink) {
    let Fault { name, text, cause, remedy, .. } = fault;
    let _ = write!(SinkWriter(sink), "\n{name}: {text}\n  cause   {cause}\n  remedy  {remedy}");
}

/// Meaning of a register's value, for a line: `axis on, motion complete`.
pub(super) fn write_register_text(
    name: &str,
    value: u32,
    mut report_line: impl FnMut(&'static str),
) {
    for (register, value, _) in register_parts(name, value) {
        let meanings = register.shown_fields(value).map(|bits| bits.meaning(value));
        meanings.filter(|meaning| !meaning.is_empty()).for_each(&mut report_line);
    }
}
