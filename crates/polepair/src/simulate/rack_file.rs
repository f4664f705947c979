//! Rack files.
//!
//! ```toml
//! [[link]]
//! name = "left"
//! kind = "serial"                 # or can; optional where the protocol has one kind only
//! protocol = "tmcl"               # optional if the drives' profiles have it
//! connect = "serial:///dev/ttyUSB0"   # where the real link is; `sim:` does not look at it
//! baud = 9600                     # optional: the factory's; 0 for a wire without byte timing
//! duplex = "half"                 # half (RS-485) or full (RS-232)
//! timing = "uart"                 # or cdc, ftdi-16ms, tcp: the adapter between host and wire
//! echo = false                    # the host's adapter returns its own bytes
//! faults = { seed = 7 }           # drawn by a seed; or chances from 0 to 1, such as
//! # faults = { flip = 1e-5, lose = 1e-5, insert = 0, late = 0.01, latest_ms = 300 }
//!
//! [[link.drive]]
//! name = "x"
//! profile = "tmcm-171"
//! address = 1                     # optional: the factory's
//! load = 0.02                     # N·m, positive drives the shaft forward
//! supply = 24.0                   # V
//! home = 3.1                      # rad: where a reference switch closes
//! home_until = 4.0                # rad: where it opens again, of a cam on the way; cia402
//! limit_low = -6.3                # rad: where the limit switches close
//! limit_high = 6.3
//! eds = "motor.eds"               # profile = "canopen": what its data sheet lists; beside this file
//! protocol = "technocan"          # on a CAN bus of several protocols, where the profile has two
//! cycle = 100                     # on CAN: how often a second it is commanded, for the load
//! frames = [8, 8]                 # bytes of each frame of a cycle; without it one there, one back
//! on = ["left", "bus"]            # a drive on two links: this one and another of the other kind
//! options = { variant = "position" }   # what the family knows beyond these
//! # and how it is built into its machine, see `mounting`: lead, gear, counts, direction, limits
//!
//! [[link]]
//! name = "bus"
//! kind = "can"
//! bitrate = 500000                # optional: the factory's; 0 for a bus without bit timing
//! faults = { error = 1e-3, twice = 0, lose = 0, late = 0, latest_ms = 100, cut = 0 }   # a frame
//! ```

use super::act::parse_act;
use super::{DRIVES_MAX, RackAxis, RackDescription, WireDescription, find_drive};
use crate::bus::{self, BusLoadRange};
use crate::error::Error;
use crate::mounting::Mounting;
use crate::profile::read_text;
use crate::registry;
use crate::toml_file::{FileError, SourceText, TomlTable};
use crate::url::{self, Url};
use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;
use polepair_sim::can_bus::CanFaults;
use polepair_sim::fault::SerialFaults;
use polepair_sim::node::ScheduledAct;
use polepair_sim::rack::{RackDrive, RackLink, RackWire};
use polepair_sim::random::{Ppm, Random};
use polepair_sim::serial_line::{Duplex, SerialWireConfig, Timing};
use std::path::Path;

/// Keys of a file with a rack, also the names of a `polepair.toml`.
pub(crate) const FILE_KEYS: [&str; 4] = ["link", "seed", "name", "links"];
const LINK_KEYS: [&str; 11] = [
    "name", "kind", "protocol", "connect", "baud", "bitrate", "duplex", "timing", "echo", "faults",
    "drive",
];
const DRIVE_KEYS: [&str; 23] = [
    "steps",
    "act",
    "axis",
    "name",
    "profile",
    "eds",
    "protocol",
    "cycle",
    "frames",
    "address",
    "on",
    "load",
    "supply",
    "home",
    "limit_high",
    "home_until",
    "limit_low",
    "options",
    "lead",
    "gear",
    "counts",
    "direction",
    "limits",
];
/// Keys of another axis of a drive.
const AXIS_KEYS: [&str; 14] = [
    "steps",
    "act",
    "number",
    "name",
    "load",
    "home",
    "limit_high",
    "home_until",
    "limit_low",
    "lead",
    "gear",
    "counts",
    "direction",
    "limits",
];
/// Keys of acts on a simulated drive at a certain time.
const ACT_KEYS: [&str; 2] = ["at", "do"];
/// Keys that are places of switches, in the order of [`Act::Switch`].
const SWITCH_KEYS: [&str; 4] = ["home", "limit_high", "limit_low", "home_until"];
const CAN_FAULT_KEYS: [&str; 6] = ["error", "twice", "lose", "late", "latest_ms", "cut"];
/// Default of the maximum delay of a late frame, in ms.
const CAN_DELAY_MAX_MS: i64 = 100;
const FAULT_KEYS: [&str; 15] = [
    "seed",
    "flip",
    "burst",
    "lose",
    "insert",
    "truncate",
    "chunk",
    "duplicate",
    "late",
    "lose_request",
    "lose_reply",
    "collide",
    "patience_ms",
    "latest_ms",
    "latency_ms",
];

/// Reads a rack file.
///
/// # Errors
/// [`Error::File`] with file, line, column and reason.
pub fn rack_of_file(path: &Path, seed: u64) -> Result<RackDescription, Error> {
    let text = read_text(path)?;
    let file = path.display().to_string();
    if is_profile(&text) {
        return super::rack_of_words(&[&file], seed);
    }
    rack_of_text(&file, &text, seed)
}

/// Returns whether a file is a drive's profile instead of a rack: it means a rack with that drive alone.
fn is_profile(text: &str) -> bool {
    let table = toml::de::DeTable::parse(text);
    let is_key = |key: &str| key == "plans" || key == "parameter";
    table.is_ok_and(|table| table.get_ref().keys().any(|key| is_key(key.get_ref())))
}

/// Reads a rack from text; `file` is its name in complaints.
///
/// # Errors
/// [`Error::File`] with line, column and reason.
pub fn rack_of_text(file: &str, text: &str, seed: u64) -> Result<RackDescription, Error> {
    let description = SourceText::new(file, text).parse(&FILE_KEYS, |node| {
        let seed = node.integer_between("seed", 0, i64::MAX)?.map_or(seed, i64::cast_unsigned);
        let mut description = RackDescription::default();
        let links = node.tables("link", &LINK_KEYS)?;
        for (n, link) in links.iter().enumerate() {
            let (rack, wire) = read_link(link, n, seed.wrapping_add(n as u64 * 1000))?;
            let mut before = description.rack.links.iter();
            if let Some(name) = link.text("name")?.filter(|_| before.any(|l| l.name == rack.name)) {
                return Err(name
                    .location
                    .error(format!("another link is called `{}`", name.value)));
            }
            description.rack.links.push(rack);
            description.wires.push(wire);
        }
        for (n, link) in links.iter().enumerate() {
            connect_second_links(link, n, &mut description)?;
            check_shared_bus(link, n, &mut description)?;
            description.assign_host(n);
        }
        if description.wires.is_empty() {
            return Err(FileError::for_file(file, "a rack needs a [[link]] with a [[link.drive]]"));
        }
        Ok(description)
    });
    Ok(description?)
}

/// Refuses a CAN bus on which two have one identifier, or that has no time for its drives.
fn check_shared_bus(
    node: &TomlTable<'_, '_>,
    n: usize,
    description: &mut RackDescription,
) -> Result<(), FileError> {
    let RackWire::Can(line) = description.rack.links[n].wire else { return Ok(()) };
    if description.protocols_on(n).len() > 1 && !node.has("bitrate") {
        return Err(node.location().error("drives of several protocols: say the bus' `bitrate`"));
    }
    let seats = description.bus_addresses(n);
    if let Some(why) = bus::find_clash(&seats) {
        return Err(node.location().error(why));
    }
    let mut load = BusLoadRange::default();
    for (drive, bus_address) in node.tables("drive", &DRIVE_KEYS)?.iter().zip(&seats) {
        let Some(rate) = drive.float("cycle")? else { continue };
        let lengths: Vec<u32> = drive.whole_numbers("frames", 8)?;
        let extended = (bus_address.protocol.uses_identifier)(bus_address.address, 0, true);
        load.add(line.bit_rate, extended, rate.value, &lengths);
    }
    if let Some(why) = load.overload_reason().filter(|_| line.bit_rate > 0) {
        return Err(node.location().error(why));
    }
    description.wires[n].load = load;
    Ok(())
}

fn read_link(
    node: &TomlTable<'_, '_>,
    n: usize,
    seed: u64,
) -> Result<(RackLink, WireDescription), FileError> {
    let name = node.text("name")?.map_or_else(|| format!("link{}", n + 1), |found| found.value);
    let kind = match node.text("kind")? {
        None => None,
        Some(found) => Some(found.try_map(|word| match word.as_str() {
            "serial" => Ok(MediumKind::Serial),
            "can" => Ok(MediumKind::Can),
            other => Err(format!("`{other}` is neither serial nor can")),
        })?),
    };
    let mut protocol = match node.text("protocol")? {
        Some(word) => Some(word.try_map(|word| parse_protocol(&word, kind))?),
        None => None,
    };
    let (mut drives, mut names): (Vec<RackDrive>, Vec<String>) = (Vec::new(), Vec::new());
    let (mut mountings, mut axes, mut steps) = (Vec::new(), Vec::new(), Vec::new());
    for (at, drive) in node.tables("drive", &DRIVE_KEYS)?.iter().enumerate() {
        if at == DRIVES_MAX {
            return Err(drive.location().error(format!("more than {DRIVES_MAX} drives on a link")));
        }
        let seed = seed.wrapping_add(at as u64);
        let mut made = read_drive(drive, &mut protocol, kind, seed)?;
        mountings.push(Mounting::from_table(drive, made.profile)?);
        names.push(read_name(drive, &names)?);
        steps.push(read_steps(drive, "steps", &mut made)?);
        axes.push(read_axes(drive, &mut made, &names, &axes)?);
        drives.push(made);
    }
    // A bus on which a relay alone sits has its drives on the other link.
    let Some(protocol) = protocol else {
        return Err(node.location().error("a link needs a [[link.drive]], or a protocol"));
    };
    let (requested, wire, shared) = match protocol.medium {
        MediumKind::Serial => {
            let factory = drives.iter().find_map(|drive| drive.profile.line).map(|line| line.baud);
            let baud = baud_setting("baud", node)?.or(factory);
            let (serial, shared) = read_serial(node, baud, &protocol, drives.len())?;
            (baud, RackWire::Serial(serial), shared)
        }
        MediumKind::Can => {
            let bit_rate = baud_setting("bitrate", node)?;
            let line = CanLine { bit_rate: bit_rate.unwrap_or(protocol.baud) };
            (bit_rate, RackWire::Can(line), false)
        }
    };
    let foreign: &[&str] = match protocol.medium {
        MediumKind::Serial if protocol.network_port.is_some() => {
            &["bitrate", "baud", "duplex", "timing", "echo"]
        }
        MediumKind::Serial => &["bitrate"],
        MediumKind::Can => &["baud", "duplex", "timing", "echo"],
    };
    if let Some(key) = foreign.iter().find(|key| node.has(key)) {
        return Err(node
            .location()
            .error(format!("`{key}` is not supported on this type of link")));
    }
    let standard = wire.standard().filter(|_| protocol.has_standards);
    drives.iter_mut().for_each(|drive| drive.standard = standard);
    let (faults, can_faults) = match protocol.medium {
        MediumKind::Serial => (read_faults(node)?, CanFaults::default()),
        MediumKind::Can => (SerialFaults::NONE, read_can_faults(node)?),
    };
    let baud = requested.unwrap_or(protocol.baud);
    let connect = node.text("connect")?;
    if let Some(found) = connect.clone() {
        found.try_map(|place_text| check_connect(&place_text, &protocol))?;
    }
    let wire_of = WireDescription {
        protocol: protocol.name,
        faults,
        can_faults,
        baud,
        shared,
        timed: node.has("timing"),
        names,
        load: BusLoadRange::default(),
        mountings,
        steps,
        axes,
        connect,
        location: Some(node.location()),
    };
    Ok((RackLink { name, wire, drives }, wire_of))
}

fn baud_setting(key: &str, node: &TomlTable<'_, '_>) -> Result<Option<u32>, FileError> {
    node.integer_between(key, 0, 4_000_000).map(|n| n.and_then(|n| u32::try_from(n).ok()))
}

/// Refuses what no link of that protocol can be opened at.
fn check_connect(location: &str, protocol: &registry::ProtocolInfo) -> Result<(), String> {
    let url = protocol.url_at(location).parse::<Url>().map_err(|e| e.to_string())?;
    if url.axes.is_empty() {
        Ok(())
    } else {
        Err("the drives below name the axes: leave `#` out".to_owned())
    }
}

/// Full steps of a turn of a stepper motor; the simulated one has them too, as that option.
fn read_steps(
    node: &TomlTable<'_, '_>,
    option: &str,
    drive: &mut RackDrive,
) -> Result<Option<u32>, FileError> {
    let steps = node.integer_between("steps", 4, 10_000)?;
    let steps = steps.and_then(|steps| u32::try_from(steps).ok());
    drive.extra.extend(steps.map(|steps| (option.to_owned(), steps.to_string())));
    Ok(steps)
}

/// The further axes of a drive: `[[link.drive.axis]]` with `number = 2` is `#5.2`.
fn read_axes(
    node: &TomlTable<'_, '_>,
    drive: &mut RackDrive,
    names: &[String],
    others: &[Vec<RackAxis>],
) -> Result<Vec<RackAxis>, FileError> {
    let mut axes: Vec<RackAxis> = Vec::new();
    let mut known = names.to_vec();
    known.extend(others.iter().flatten().map(|axis| axis.name.clone()));
    for table in node.tables("axis", &AXIS_KEYS)? {
        let location = table.location();
        let sub_axes = registry::sub_axes(drive.wires.first().map_or("", String::as_str));
        let last = match drive.profile.motors {
            0 => *sub_axes.end(),
            motors => sub_axes.start() + motors - 1,
        };
        let first = sub_axes.start() + 1;
        if first > last {
            return Err(location.error(format!("`{}` has one axis", drive.profile.name)));
        }
        let number = table.integer_between("number", first.into(), last.into())?;
        let number = number.and_then(|number| u8::try_from(number).ok());
        let number = number.ok_or_else(|| location.error("an axis needs its `number`"))?;
        if axes.iter().any(|axis| axis.number == number) {
            return Err(location.error(format!("axis {number} of the drive is defined twice")));
        }
        let motor = number - sub_axes.start();
        read_bench(&table, motor, drive)?;
        let name = read_name(&table, &known)?;
        known.push(name.clone());
        let mounting = Mounting::from_table(&table, drive.profile)?;
        let steps = read_steps(&table, &format!("steps.{motor}"), drive)?;
        axes.push(RackAxis { number, name, mounting, steps });
    }
    Ok(axes)
}

/// Name of a drive, which must be valid in connection strings.
fn read_name(node: &TomlTable<'_, '_>, others: &[String]) -> Result<String, FileError> {
    let Some(name) = node.text("name")? else { return Ok(String::new()) };
    name.try_map(|name| {
        let letters = name.chars().all(|c| c.is_alphanumeric() || matches!(c, '-' | '_' | ' '));
        if !letters || url::split_names(&name).0 != [name.as_str()] {
            return Err(format!(
                "`{name}` cannot stand behind `#`: a name begins with a letter, is not like g1, \
                 and \
                 has letters, digits, - and _"
            ));
        }
        if others.contains(&name) {
            return Err(format!("another drive of this link is called `{name}`"));
        }
        Ok(name)
    })
}

/// Settings of a serial wire, and whether its drives receive each other's bytes.
fn read_serial(
    node: &TomlTable<'_, '_>,
    baud: Option<u32>,
    protocol: &registry::ProtocolInfo,
    drives: usize,
) -> Result<(SerialWireConfig, bool), FileError> {
    let request = match node.text("duplex")? {
        None => None,
        Some(found) => Some(found.try_map(|word| match word.as_str() {
            "half" => Ok(Duplex::Half),
            "full" => Ok(Duplex::Full),
            other => Err(format!("`{other}` is neither half nor full")),
        })?),
    };
    let usual = match protocol.default_wire(drives) {
        RackWire::Serial(serial) => serial.duplex,
        RackWire::Can(_) => Duplex::Half,
    };
    let duplex = request.unwrap_or(usual);
    let untimed = baud == Some(0) || protocol.network_port.is_some();
    let timing = match node.text("timing")? {
        None if untimed => Timing::Cdc,
        None => Timing::Uart,
        Some(found) => found.try_map(|word| match parse_timing(&word)? {
            Timing::Uart | Timing::Ftdi | Timing::Tcp if untimed => {
                Err(format!("`{word}` has a baud rate"))
            }
            timing => Ok(timing),
        })?,
    };
    let mut serial = SerialWireConfig { duplex, timing, echo: node.boolean("echo")?, baud };
    set_timing(&mut serial, timing, baud.unwrap_or(protocol.baud));
    Ok((serial, request == Some(Duplex::Half)))
}

/// Timing between the host and a serial wire, by its word in racks and connection strings.
pub(super) fn parse_timing(word: &str) -> Result<Timing, String> {
    match word {
        "uart" => Ok(Timing::Uart),
        "ftdi-16ms" => Ok(Timing::Ftdi),
        "cdc" => Ok(Timing::Cdc),
        "tcp" => Ok(Timing::Tcp),
        other => Err(format!("`{other}` is none of uart, cdc, ftdi-16ms, tcp")),
    }
}

pub(super) const fn set_timing(serial: &mut SerialWireConfig, timing: Timing, baud: u32) {
    serial.timing = timing;
    match timing {
        Timing::Cdc => serial.baud = None,
        // The port of a serial server is set there, not by the host.
        Timing::Tcp => serial.baud = Some(baud),
        Timing::Uart | Timing::Ftdi | Timing::Pty => {}
    }
}

fn parse_protocol(word: &str, kind: Option<MediumKind>) -> Result<registry::ProtocolInfo, String> {
    let found = match kind {
        None => registry::protocol_by_word(word),
        Some(kind) => registry::find_protocol(word, kind),
    };
    found.ok_or_else(|| {
        let known = registry::protocol_names();
        match kind {
            Some(MediumKind::Can) if known.contains(&word) => {
                format!("`{word}` is not used on CAN")
            }
            Some(_) if known.contains(&word) => format!("`{word}` is not used on serial lines"),
            _ => format!(
                "`{word}` is no protocol{}",
                crate::spelling::suggestion(word, known.iter().copied())
            ),
        }
    })
}

/// Finds the links that drives of link `n` are plugged into besides.
fn connect_second_links(
    node: &TomlTable<'_, '_>,
    n: usize,
    description: &mut RackDescription,
) -> Result<(), FileError> {
    for (at, drive) in node.tables("drive", &DRIVE_KEYS)?.iter().enumerate() {
        for name in drive.texts("on")? {
            let location = name.location.clone();
            let links = &description.rack.links;
            let Some(other) = links.iter().position(|link| link.name == name.value) else {
                let near =
                    crate::spelling::suggestion(&name.value, links.iter().map(|l| l.name.as_str()));
                return Err(
                    location.error(format!("`{}` is no link of this rack{near}", name.value))
                );
            };
            if other == n {
                continue;
            }
            let of_this_kind = links[other].wire.medium() == links[n].wire.medium();
            if of_this_kind || links[n].drives[at].second_link.is_some() {
                return Err(location.error("a drive is on one serial link and one CAN bus at most"));
            }
            let word = description.wires[other].protocol.to_owned();
            let drive = &mut description.rack.links[n].drives[at];
            drive.second_link = Some(other);
            drive.wires.push(word);
        }
    }
    Ok(())
}

fn read_drive(
    node: &TomlTable<'_, '_>,
    protocol: &mut Option<registry::ProtocolInfo>,
    kind: Option<MediumKind>,
    seed: u64,
) -> Result<RackDrive, FileError> {
    let word = node.required_text("profile")?;
    let location = word.location.clone();
    let kind = protocol.as_ref().map(|protocol| protocol.medium).or(kind);
    let folder = Path::new(node.location().file()).parent().map(Path::to_path_buf);
    let (profile, info) = word.try_map(|word| {
        if word.ends_with(".toml") {
            let file = folder.unwrap_or_default().join(word);
            return find_drive(&file.display().to_string()).map_err(|e| e.to_string());
        }
        let on = match kind.filter(|_| !word.contains('+')) {
            None => "",
            Some(MediumKind::Serial) => "+serial",
            Some(MediumKind::Can) => "+can",
        };
        let found = find_drive(&format!("{word}{on}"));
        found.or_else(|_| find_drive(&word)).map_err(|e| e.to_string())
    })?;
    if kind.is_some_and(|kind| kind != info.medium) {
        return Err(location.error(format!("`{}` has no connector for this link", profile.name)));
    }
    let own = match node.text("protocol")? {
        Some(word) => Some(word.try_map(|word| parse_protocol(&word, Some(info.medium)))?),
        None => None,
    };
    let first = protocol.get_or_insert_with(|| own.clone().unwrap_or_else(|| info.clone()));
    // A bus carries several protocols, a serial line one.
    let wire = match own {
        Some(own) if first.medium == MediumKind::Can => own,
        None if first.medium == MediumKind::Can && first.profile != profile.protocol => info,
        _ => first.clone(),
    };
    if wire.profile != profile.protocol {
        let reason = format!("`{}` does not speak {}", profile.name, wire.name);
        return Err(location.error(reason));
    }
    let mut drive = RackDrive::new(profile, wire.name);
    let every = &wire.all_addresses;
    let first = if wire.switch_address.is_some() { 0 } else { *every.start() };
    let address = node.integer_between("address", first.into(), (*every.end()).into())?;
    drive.address = address.and_then(|n| u32::try_from(n).ok());
    read_sheet(node, &mut drive)?;
    drive.seed = seed;
    let supply = node.float("supply")?.map(|volts| (0, Act::Supply(volts.value)));
    drive.acts.extend(supply);
    read_bench(node, 0, &mut drive)?;
    if let Some(options) = node.table("options", &[])? {
        for key in options.keys() {
            if let Some(value) = options.scalar_text(key.value)? {
                drive.extra.push((key.value.to_owned(), value.value));
            }
        }
    }
    if drive.address == Some(0) {
        read_switches(&mut drive, wire.switch_address);
    }
    Ok(drive)
}

/// Surroundings of a motor, and later acts on it.
fn read_bench(node: &TomlTable<'_, '_>, motor: u8, drive: &mut RackDrive) -> Result<(), FileError> {
    drive.acts.extend(real_setting("load", node)?.map(|torque| (motor, Act::Load(torque))));
    for (which, key) in (0..).zip(SWITCH_KEYS) {
        drive.acts.extend(real_setting(key, node)?.map(|at| (motor, Act::Switch { which, at })));
    }
    drive.scheduled_acts.extend(read_acts(node, motor)?);
    Ok(())
}

fn real_setting(key: &str, node: &TomlTable<'_, '_>) -> Result<Option<f64>, FileError> {
    node.float(key).map(|found| found.map(|found| found.value))
}

/// Acts on a motor while it runs: `[[link.drive.act]]` with `at = "5 s"` and `do = "jam"`.
fn read_acts(node: &TomlTable<'_, '_>, motor: u8) -> Result<Vec<ScheduledAct>, FileError> {
    let mut acts = Vec::new();
    for table in node.tables("act", &ACT_KEYS)? {
        let at =
            table.text("at")?.ok_or_else(|| missing_setting("at", &table))?.try_map(|text| {
                parse_time_ns(&text)
                    .ok_or_else(|| format!("`{text}` is no time: write \"5 s\" or \"200 ms\""))
            })?;
        let act = table.text("do")?.ok_or_else(|| missing_setting("do", &table))?;
        let act = act.try_map(|text| parse_act(&text).map_err(|error| error.to_string()))?;
        acts.push(ScheduledAct { at: Instant(at), motor, act });
    }
    Ok(acts)
}

fn missing_setting(key: &str, table: &TomlTable<'_, '_>) -> FileError {
    table.location().error(format!("an act needs `{key}`"))
}

/// `5 s`, `200 ms` or `2 min` in ns.
fn parse_time_ns(text: &str) -> Option<u64> {
    let split = text.find(|c: char| c.is_alphabetic())?;
    let (number, unit) = text.split_at(split);
    let factor = match unit.trim() {
        "ms" => 1e6,
        "s" => 1e9,
        "min" => 60e9,
        _ => return None,
    };
    let ns = number.trim().parse::<f64>().ok()? * factor;
    (0.0..1e18).contains(&ns).then_some(ns as u64)
}

/// The address of a drive whose set-up leaves it to its switches: the option `switches`, or what a
/// drive without switches has.
fn read_switches(drive: &mut RackDrive, without: Option<u32>) {
    let switches = drive.extra.iter().find(|(key, _)| key == "switches");
    drive.address = switches.and_then(|(_, value)| value.parse().ok()).or(without);
    drive.extra.push(("address-from".to_owned(), "switches".to_owned()));
}

/// The data sheet that a drive names, in the folder of the rack file; its node-ID where the rack has
/// none.
fn read_sheet(node: &TomlTable<'_, '_>, drive: &mut RackDrive) -> Result<(), FileError> {
    let Some(found) = node.text("eds")? else { return Ok(()) };
    let folder = Path::new(node.location().file()).parent().map(Path::to_path_buf);
    found.try_map(|name| {
        if !crate::eds::accepts_sheet(drive.profile) {
            return Err(format!("`{}` is no device of a data sheet", drive.profile.name));
        }
        let path = folder.unwrap_or_default().join(name);
        let (sheet, eds) = crate::eds::load_sheet(&path).map_err(|error| error.to_string())?;
        drive.data_sheet = Some(sheet);
        drive.address = drive.address.or(eds.node_id().map(u32::from));
        Ok(())
    })
}

fn read_can_faults(node: &TomlTable<'_, '_>) -> Result<CanFaults, FileError> {
    let Some(table) = node.table("faults", &CAN_FAULT_KEYS)? else {
        return Ok(CanFaults::default());
    };
    let latest = table.integer_between("latest_ms", 0, 10_000)?.unwrap_or(CAN_DELAY_MAX_MS);
    Ok(CanFaults {
        error: probability_of("error", &table)?,
        last_bit: probability_of("twice", &table)?,
        lose: probability_of("lose", &table)?,
        late: probability_of("late", &table)?,
        late_max_ms: latest as u32,
        cut: probability_of("cut", &table)?,
        echo: false,
    })
}

fn probability_of(key: &str, table: &TomlTable<'_, '_>) -> Result<Ppm, FileError> {
    read_probability(table, key)
}

fn read_probability(table: &TomlTable<'_, '_>, key: &str) -> Result<Ppm, FileError> {
    table.float(key)?.map_or(Ok(Ppm::NEVER), |found| {
        found.try_map(|chance| {
            if !(0.0..=1.0).contains(&chance) {
                return Err(format!("`{key}` is {chance}; it must be 0 to 1"));
            }
            Ok(Ppm((chance * 1e6).round() as u32))
        })
    })
}

fn read_faults(node: &TomlTable<'_, '_>) -> Result<SerialFaults, FileError> {
    let Some(table) = node.table("faults", &FAULT_KEYS)? else { return Ok(SerialFaults::NONE) };
    let patience = bounded_setting("patience_ms", 60_000, &table)?.unwrap_or(100) as u32;
    let latest = bounded_setting("latest_ms", 60_000, &table)?.unwrap_or(300) as u32;
    if let Some(seed) = bounded_setting("seed", i64::MAX, &table)? {
        return Ok(SerialFaults::random(&mut Random::new(seed.cast_unsigned()), patience, latest));
    }
    Ok(SerialFaults {
        flip: probability_of("flip", &table)?,
        burst: probability_of("burst", &table)?,
        burst_max: 8,
        lose: probability_of("lose", &table)?,
        insert: probability_of("insert", &table)?,
        truncate: probability_of("truncate", &table)?,
        chunk: probability_of("chunk", &table)?,
        chunk_gap_us: 2_000,
        duplicate: probability_of("duplicate", &table)?,
        late: probability_of("late", &table)?,
        host_timeout_ms: patience,
        late_max_ms: latest,
        lose_request: probability_of("lose_request", &table)?,
        lose_reply: probability_of("lose_reply", &table)?,
        collide: probability_of("collide", &table)?,
        latency_ms: bounded_setting("latency_ms", 255, &table)?.unwrap_or(0) as u8,
        ..SerialFaults::NONE
    })
}

fn bounded_setting(
    key: &str,
    max: i64,
    table: &TomlTable<'_, '_>,
) -> Result<Option<i64>, FileError> {
    table.integer_between(key, 0, max)
}
