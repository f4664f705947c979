//! The reference of the keys of connection strings, made from what links and protocols declare.

use std::fmt::Write as _;

use polepair::url::{link_keys, protocol_keys, protocols, rack_keys, simulation_keys};
use polepair_core::medium::MediumKind;
use polepair_core::proto::{OptionKey, OptionKind};

const HEAD: &str = "# Keys of connection strings

<!-- Made from what links and protocols declare by `cargo xtask codegen`. Do not edit. -->

`PROTOCOL+LINK://ADDRESS?key=value&key=value#AXES`: a link has the keys of its kind and those of its protocol; \
`sim:` has those of simulated drives and of the drive's protocol. Other keys and invalid values are errors \
(E210). [Connection strings](connection-strings.md) describes the other parts.

A time is in milliseconds, or has a unit: `timeout=50`, `timeout=0.2s`.
";

/// The page.
pub fn page() -> String {
    let mut text = HEAD.to_owned();
    write_table(&mut text, "Serial links", link_keys(MediumKind::Serial));
    write_table(&mut text, "CAN links", link_keys(MediumKind::Can));
    for (name, medium) in protocols() {
        let medium_name = match medium {
            MediumKind::Serial => "serial lines",
            MediumKind::Can => "CAN",
        };
        let heading = format!("`{name}` on {medium_name}");
        write_table(&mut text, &heading, protocol_keys(name, medium));
    }
    write_table(&mut text, "Simulated drives", simulation_keys());
    write_table(&mut text, "Rack files", rack_keys());
    text
}

fn write_table(text: &mut String, heading: &str, keys: &[OptionKey]) {
    let _ = write!(text, "\n## {heading}\n\n| key | value | meaning |\n|---|---|---|\n");
    for key in keys {
        let _ = writeln!(text, "| `{}` | {} | {} |", key.name, value(key.kind), key.help);
    }
}

fn value(kind: OptionKind) -> String {
    match kind {
        OptionKind::Milliseconds => "time".to_owned(),
        OptionKind::Gap => "time, or `3.5c`: so many characters".to_owned(),
        OptionKind::Number(0, u32::MAX) => "number".to_owned(),
        OptionKind::Number(min, max) => format!("{min} to {max}"),
        OptionKind::Flag => "`yes`, `no`".to_owned(),
        OptionKind::Word(words) => {
            words.iter().map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", ")
        }
        OptionKind::Text => "text".to_owned(),
    }
}
