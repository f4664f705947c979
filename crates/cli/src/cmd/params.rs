//! `polepair params [FAMILY] [NAME]`

use clap::Args;
use polepair_capture::Explanation;
use polepair_core::profile::{
    Access, Certainty, Encoding, Parameter, ParameterId, Persistence, Profile,
};

use crate::data_output::DataOutput;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{TextTable, colour_out, print_note};
use crate::value::{format_amount, format_number, in_own_unit};

/// Lists the parameters of a drive: names, units, ranges, defaults, manual sections.
///
/// Without FAMILY, the command lists the known drives.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair params
  polepair params tmcm-171
  polepair params tmcm-171 \"max current\"
  polepair params syntron-ts Fn_33
  polepair params canopen                   objects of every CANopen device
  polepair params technosoft-f514l KPP      address, type and opcodes of one variable")]
pub struct Params {
    /// Drive, family or protocol: tmcm-171, syntron-ts, canopen, …
    family: Option<String>,
    /// Parameter name, manual symbol, or a part of either
    name: Option<String>,
    /// Write the memory of a TML drive as a set-up archive, NAME.t.zip
    #[arg(long, value_name = "FILE", requires = "family", conflicts_with = "name")]
    write_setup: Option<std::path::PathBuf>,
    #[command(flatten)]
    profiles: crate::profile_args::ProfileFile,
}

impl Params {
    pub fn run(self) -> Result {
        let known = self.profiles.known_profiles()?;
        if let (Some(family), Some(file)) = (&self.family, &self.write_setup) {
            let written = polepair::profile::write_setup(find_drive(&known, family)?, file);
            written.map_err(|error| crate::outcome::to_problem(error.into()))?;
            return Ok(Exit::Ok);
        }
        let text = match (&self.family, &self.name) {
            (None, _) => drives_table(&known),
            (Some(family), None) => parameters_table(find_drive(&known, family)?, |_| true),
            (Some(family), Some(name)) => parameter_text(find_drive(&known, family)?, name)?,
        };
        let mut out = DataOutput::stdout();
        out.buffer().extend_from_slice(text.as_bytes());
        out.flush()?;
        if let Some(word) = &self.family
            && find_drive(&known, word)?.parameters.is_empty()
        {
            print_note(&format!(
                "no parameter is common to all drives of {word}: each drive numbers its own"
            ));
        }
        Ok(Exit::Ok)
    }
}

/// A drive by the word users type: its name, its family, or a protocol's word for what all its drives have.
pub fn find_drive(known: &[&'static Profile], word: &str) -> Result<&'static Profile> {
    let named = known.iter().find(|profile| profile.name.eq_ignore_ascii_case(word));
    named
        .or_else(|| known.iter().find(|profile| profile.family.eq_ignore_ascii_case(word)))
        .copied()
        .or_else(|| polepair::profile::generic_profile(&word.to_ascii_lowercase()))
        .ok_or_else(|| {
            let names: Vec<&str> = known.iter().map(|profile| profile.name).collect();
            let nearest = polepair_capture::nearest_word(word, names.iter().copied());
            Problem::usage("E204", format!("{word:?} is not a drive that polepair knows."))
                .why(format!("It knows {}.", crate::problem::join_list(&names)))
                .hint_if(nearest.map(|name| format!("{name} (the nearest)")))
                .hint("--profile FILE describes a drive of your own")
        })
}

fn drives_table(known: &[&'static Profile]) -> String {
    let mut table =
        TextTable::with_heads(&["drive", "protocol", "parameters", "faults", "product"]);
    for profile in known {
        table.add_row([
            profile.name.to_owned(),
            profile.protocol.to_owned(),
            profile.parameters.len().to_string(),
            profile.faults.len().to_string(),
            profile.title.to_owned(),
        ]);
    }
    table.render(colour_out())
}

fn parameters_table(profile: &Profile, wanted: impl Fn(&Parameter) -> bool) -> String {
    let heads = ["name", "symbol", "range", "default", "access", "kept", "section"];
    let mut table = TextTable::with_heads(&heads);
    for parameter in profile.parameters.iter().filter(|parameter| wanted(parameter)) {
        let sure = match parameter.certainty {
            Certainty::Documented => "",
            Certainty::Inferred => " (inferred)",
            Certainty::Undocumented => " (undocumented)",
        };
        table.add_row([
            parameter.name.to_owned(),
            parameter.symbol.to_owned(),
            range_text(parameter),
            parameter.default.map_or_else(String::new, |raw| value_text(parameter, raw)),
            access_text(parameter).to_owned(),
            persistence_text(parameter).to_owned(),
            format!("{}{sure}", parameter.section),
        ]);
    }
    table.render(colour_out())
}

/// One parameter in full; or all whose names contain the word.
fn parameter_text(profile: &'static Profile, name: &str) -> Result<String> {
    if let Some(parameter) = profile.find_parameter(name).and_then(|id| profile.parameter(id)) {
        return Ok(parameter_details(profile, parameter));
    }
    let part = name.to_ascii_lowercase();
    let contains = |p: &Parameter| {
        p.name.to_ascii_lowercase().contains(&part) || p.symbol.to_ascii_lowercase().contains(&part)
    };
    if profile.parameters.iter().any(contains) {
        return Ok(parameters_table(profile, contains));
    }
    Err(no_such_parameter(profile, name))
}

/// A name that the drive does not have.
fn no_such_parameter(profile: &Profile, name: &str) -> Problem {
    let names = profile.parameters.iter().flat_map(|p| [p.name, p.symbol]);
    let nearest = polepair_capture::nearest_word(name, names);
    Problem::usage("E205", format!("{} has no parameter {name:?}.", profile.name))
        .hint_if(nearest.map(|name| format!("{name:?} (the nearest)")))
        .hint(format!("`polepair params {}` lists them all", profile.name))
}

fn parameter_details(profile: &Profile, parameter: &Parameter) -> String {
    let mut text = format!("{} ({}, {})\n", parameter.name, parameter.symbol, profile.name);
    if !parameter.about.is_empty() {
        text.push_str(&format!("{}\n", parameter.about));
    }
    let mut table = TextTable::default();
    let mut fact = |word: &str, value: String| {
        if !value.is_empty() {
            table.add_row([format!("  {word}"), value]);
        }
    };
    fact("range", range_text(parameter));
    fact("default", parameter.default.map_or_else(String::new, |raw| value_text(parameter, raw)));
    fact("unit", parameter.unit.symbol().to_owned());
    fact("scale", scale_text(profile, parameter));
    let raw = if parameter.encoding.is_number() {
        format!(
            "{} to {}, ",
            raw_text(parameter.min, parameter.encoding),
            raw_text(parameter.max, parameter.encoding)
        )
    } else {
        String::new()
    };
    fact("raw", format!("{raw}{}", encoding_text(parameter)));
    fact("access", access_text(parameter).to_owned());
    fact("kept", persistence_text(parameter).to_owned());
    if parameter.moves {
        fact("moves", "writing it may start or change motion: the axis must be armed".to_owned());
    }
    for item in wire_access(profile, parameter).fields() {
        let value = super::explain::item_text(&item);
        let note =
            if item.meaning.is_empty() { String::new() } else { format!(", {}", item.meaning) };
        fact(item.name, value + &note);
    }
    fact("source", source_text(profile, parameter));
    for field in parameter.digits {
        let words = field.values.iter().map(|(value, word)| format!("{value} {word}"));
        let words: Vec<String> = words.collect();
        let places = if field.places == 1 { "1 digit" } else { "2 digits" };
        fact(field.name, format!("0 to {}, {places}: {}", field.max, words.join(", ")));
    }
    for known in parameter.bits {
        let bits = known.bit().map_or_else(
            || format!("0x{:X} of 0x{:X}", known.value, known.mask),
            |bit| format!("bit {bit}"),
        );
        fact(&bits, known.name.to_owned());
    }
    for (raw, name) in parameter.values {
        fact(&format!("{raw}"), (*name).to_owned());
    }
    text.push_str(&table.render(false));
    text
}

fn raw_text(raw: i64, parameter_encoding: Encoding) -> String {
    polepair::format_raw(parameter_encoding, raw)
}

/// Access to the parameter on the wire, by its protocol.
fn wire_access(profile: &Profile, parameter: &Parameter) -> Explanation {
    let mut found = Explanation::default();
    if let Some(dissector) = polepair_core::proto::dissectors()
        .iter()
        .find(|dissector| dissector.language() == profile.protocol)
    {
        dissector.explain_parameter(parameter, &mut found);
    }
    found
}

fn source_text(profile: &Profile, parameter: &Parameter) -> String {
    let section = match parameter.section {
        "" => String::new(),
        section => format!(", {section}"),
    };
    let sure = match parameter.certainty {
        Certainty::Documented => "",
        Certainty::Inferred => " (inferred from sibling products)",
        Certainty::Undocumented => " (undocumented)",
    };
    format!("{}{section}{sure}", profile.source)
}

fn scale_text(profile: &Profile, parameter: &Parameter) -> String {
    let scale = parameter.scale;
    let times =
        scale.times.map_or_else(String::new, |id| format!(" x {:?}", parameter_name(id, profile)));
    let over =
        scale.over.map_or_else(String::new, |id| format!(" / {:?}", parameter_name(id, profile)));
    if scale.is_constant() && scale.factor == 1.0 {
        return String::new();
    }
    if let Some(rule) = scale.rule {
        let known = rule.objects.iter().filter_map(|object| profile.find_object(*object));
        let symbols: Vec<&str> =
            known.filter_map(|id| Some(profile.parameter(id)?.symbol)).collect();
        return format!("computed from {}", symbols.join(", "));
    }
    let sign = scale.negative.map_or_else(String::new, |(id, _)| {
        format!(", with the sign that {:?} gives", parameter_name(id, profile))
    });
    format!("raw x {}{times}{over}{sign}", format_number(scale.factor))
}

fn parameter_name(id: ParameterId, profile: &Profile) -> &str {
    profile.parameter(id).map_or("?", |other| other.name)
}

fn range_text(parameter: &Parameter) -> String {
    if !parameter.encoding.is_number() {
        return String::new();
    }
    match (in_own_unit(parameter, parameter.min), in_own_unit(parameter, parameter.max)) {
        (Some(min), Some(max)) => {
            format!("{} .. {}", format_number(min), format_amount(max, parameter.unit.symbol()))
        }
        _ => format!("{} .. {} raw, in {}", parameter.min, parameter.max, parameter.unit.symbol()),
    }
}

fn value_text(parameter: &Parameter, raw: i64) -> String {
    let value = match in_own_unit(parameter, raw) {
        Some(value) => format_amount(value, parameter.unit.symbol()),
        None => format!("{raw} raw"),
    };
    match crate::value::value_name(parameter, raw) {
        Some(name) => format!("{value} ({name})"),
        None => value,
    }
}

const fn access_text(parameter: &Parameter) -> &'static str {
    match parameter.access {
        Access::Read => "read",
        Access::Write => "write",
        Access::ReadWrite => "read, write",
    }
}

const fn persistence_text(parameter: &Parameter) -> &'static str {
    match parameter.persistence {
        Persistence::Volatile => "",
        Persistence::Storable => "when stored",
        Persistence::Always => "at every write",
        Persistence::UnlessRam => "at every write, unless in RAM mode",
    }
}

const fn encoding_text(parameter: &Parameter) -> &'static str {
    match parameter.encoding {
        Encoding::Bit => "one bit",
        Encoding::U8 => "8 bits",
        Encoding::I8 => "8 bits, signed",
        Encoding::U16 => "16 bits",
        Encoding::I16 => "16 bits, signed",
        Encoding::U32 => "32 bits",
        Encoding::I32 => "32 bits, signed",
        Encoding::U48 => "48 bits",
        Encoding::I48 => "48 bits, signed",
        Encoding::U64 => "64 bits",
        Encoding::I64 => "64 bits, signed",
        Encoding::F32 => "floating-point, 32 bits",
        Encoding::F64 => "floating-point, 64 bits",
        Encoding::U32LowFirst => "32 bits, low word first",
        Encoding::I32LowFirst => "32 bits, signed, low word first",
        Encoding::U48LowFirst => "48 bits, low word first",
        Encoding::I48LowFirst => "48 bits, signed, low word first",
        Encoding::U64LowFirst => "64 bits, low word first",
        Encoding::I64LowFirst => "64 bits, signed, low word first",
        Encoding::F32LowFirst => "floating-point, 32 bits, low word first",
        Encoding::F64LowFirst => "floating-point, 64 bits, low word first",
        Encoding::Fixed => "32 bits, signed, the lower 16 a fraction",
        Encoding::TensAndThousandths => "tens in one register, thousandths in the next",
        Encoding::AnyLength => "as many bits as the drive sends",
        Encoding::Text => "text",
        Encoding::Bytes => "bytes",
    }
}
