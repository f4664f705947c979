//! Rack files.
//!
//! ```toml
//! [[link]]
//! name = "left"
//! protocol = "tmcl"               # optional where the drives' profiles say it
//! baud = 9600                     # optional: the factory's; 0 for a wire without byte timing
//! duplex = "half"                 # half (RS-485) or full (RS-232)
//! echo = false                    # the host's adapter hears itself
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
//! options = { variant = "position" }   # what the family knows beyond these
//! ```

use super::{DRIVES_MAX, Description, Wire, drive_of};
use crate::error::Error;
use crate::file::{FileError, Node, Text};
use crate::profile::text_of;
use crate::registry;
use polepair_core::drives::bench::Act;
use polepair_sim::fault::Faults;
use polepair_sim::rack::{RackDrive, RackLink, RackWire};
use polepair_sim::random::{Ppm, Random};
use polepair_sim::serial_line::{Duplex, Serial};
use std::path::Path;

const LINK_KEYS: [&str; 7] = ["name", "protocol", "baud", "duplex", "echo", "faults", "drive"];
const DRIVE_KEYS: [&str; 7] = ["name", "profile", "address", "load", "supply", "home", "options"];
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
pub fn rack_of_file(path: &Path, seed: u64) -> Result<Description, Error> {
    rack_of_text(&path.display().to_string(), &text_of(path)?, seed)
}

/// Reads a rack from text; `file` is its name in complaints.
///
/// # Errors
/// [`Error::File`] with line, column and reason.
pub fn rack_of_text(file: &str, text: &str, seed: u64) -> Result<Description, Error> {
    let description = Text::new(file, text).read(&["link", "seed"], |node| {
        let seed = node.between("seed", 0, i64::MAX)?.map_or(seed, i64::cast_unsigned);
        let mut description = Description::default();
        for (n, link) in node.tables("link", &LINK_KEYS)?.iter().enumerate() {
            let (rack, wire) = link_of(link, n, seed.wrapping_add(n as u64 * 1000))?;
            description.rack.links.push(rack);
            description.wires.push(wire);
            description.settle_host(n);
        }
        if description.wires.is_empty() {
            return Err(FileError::whole(file, "a rack needs a [[link]] with a [[link.drive]]"));
        }
        Ok(description)
    });
    Ok(description?)
}

fn link_of(node: &Node<'_, '_>, n: usize, seed: u64) -> Result<(RackLink, Wire), FileError> {
    let name = node.text("name")?.map_or_else(|| format!("link{}", n + 1), |found| found.value);
    let asked = node.text("protocol")?;
    let mut protocol = match asked {
        Some(word) => Some(word.check(|word| {
            registry::protocol(&word).ok_or_else(|| {
                let known = registry::names();
                let near = crate::words::hint(&word, known.iter().copied());
                format!("`{word}` is no protocol{near}")
            })
        })?),
        None => None,
    };
    let (mut drives, mut names) = (Vec::new(), Vec::new());
    for (at, drive) in node.tables("drive", &DRIVE_KEYS)?.iter().enumerate() {
        if at == DRIVES_MAX {
            return Err(drive.place().error(format!("more than {DRIVES_MAX} drives on a link")));
        }
        let seed = seed.wrapping_add(at as u64);
        drives.push(drive_of_table(drive, &mut protocol, seed)?);
        names.push(drive.text("name")?.map(|found| found.value).unwrap_or_default());
    }
    let Some(protocol) = protocol.filter(|_| !drives.is_empty()) else {
        return Err(node.place().error("a link needs a [[link.drive]]"));
    };
    let baud = node.between("baud", 0, 4_000_000)?.and_then(|baud| u32::try_from(baud).ok());
    let asked = baud.filter(|baud| *baud > 0);
    let baud = baud.unwrap_or(protocol.baud);
    let echo = node.flag("echo")?;
    let duplex = match node.text("duplex")? {
        None => Duplex::Half,
        Some(found) => found.check(|word| match word.as_str() {
            "half" => Ok(Duplex::Half),
            "full" => Ok(Duplex::Full),
            other => Err(format!("`{other}` is neither half nor full")),
        })?,
    };
    let serial = Serial { duplex, timed: baud > 0, echo, baud: asked };
    let wire = Wire { protocol: protocol.name, faults: faults(node)?, baud, names };
    Ok((RackLink { name, wire: RackWire::Serial(serial), drives }, wire))
}

fn drive_of_table(
    node: &Node<'_, '_>,
    protocol: &mut Option<registry::Spoken>,
    seed: u64,
) -> Result<RackDrive, FileError> {
    let word = node.needed_text("profile")?;
    let place = word.place.clone();
    let (profile, spoken) = word.check(|word| drive_of(&word).map_err(|e| e.to_string()))?;
    let wire = protocol.get_or_insert(spoken);
    if wire.profile != profile.protocol {
        let reason = format!("`{}` does not speak {}", profile.name, wire.name);
        return Err(place.error(reason));
    }
    let mut drive = RackDrive::new(profile, wire.name);
    let every = &wire.every;
    let address = node.between("address", (*every.start()).into(), (*every.end()).into())?;
    drive.address = address.and_then(|n| u32::try_from(n).ok());
    drive.seed = seed;
    let real = |key| node.real(key).map(|found| found.map(|found| found.value));
    drive.acts.extend(real("supply")?.map(Act::Supply));
    drive.acts.extend(real("load")?.map(Act::Load));
    drive.acts.extend(real("home")?.map(|at| Act::Switch { which: 0, at }));
    if let Some(options) = node.table("options", &[])? {
        for key in options.keys() {
            if let Some(value) = options.plain(key.value)? {
                drive.extra.push((key.value.to_owned(), value.value));
            }
        }
    }
    Ok(drive)
}

fn faults(node: &Node<'_, '_>) -> Result<Faults, FileError> {
    let Some(table) = node.table("faults", &FAULT_KEYS)? else { return Ok(Faults::NONE) };
    let small = |key, most| table.between(key, 0, most);
    let patience = small("patience_ms", 60_000)?.unwrap_or(100) as u32;
    let latest = small("latest_ms", 60_000)?.unwrap_or(300) as u32;
    if let Some(seed) = small("seed", i64::MAX)? {
        return Ok(Faults::random(&mut Random::new(seed.cast_unsigned()), patience, latest));
    }
    let chance = |key| {
        let found = table.real(key)?;
        found.map_or(Ok(Ppm(0)), |found| {
            found.check(|chance| {
                if !(0.0..=1.0).contains(&chance) {
                    return Err(format!("`{key}` is {chance}; it must be 0 to 1"));
                }
                Ok(Ppm((chance * 1e6).round() as u32))
            })
        })
    };
    Ok(Faults {
        flip: chance("flip")?,
        burst: chance("burst")?,
        burst_max: 8,
        lose: chance("lose")?,
        insert: chance("insert")?,
        truncate: chance("truncate")?,
        chunk: chance("chunk")?,
        chunk_gap_us: 2_000,
        duplicate: chance("duplicate")?,
        late: chance("late")?,
        patience_ms: patience,
        latest_ms: latest,
        lose_request: chance("lose_request")?,
        lose_reply: chance("lose_reply")?,
        collide: chance("collide")?,
        latency_ms: small("latency_ms", 255)?.unwrap_or(0) as u8,
        ..Faults::NONE
    })
}
