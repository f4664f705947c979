//! Keys of connection strings: those of every link, and those that a protocol declares.

use polepair_core::medium::MediumKind;
use polepair_core::proto::{HostOptions, OptionKey, OptionKind};

use super::{LinkTarget, Url, url_error};
use crate::error::Error;
use crate::{quantity, registry, simulate, spelling, toml_file};

/// The longest time that a key may give, in seconds.
const SECONDS_MAX: f64 = 3600.0;

const PROFILE: OptionKey = OptionKey::for_link(
    "profile",
    OptionKind::Text,
    "product by its profile, shipped or your own [default: the drive is asked]",
);
const TIMING: OptionKey = OptionKey::for_link(
    "timing",
    OptionKind::Word(&["off", "uart"]),
    "off: replies may arrive sooner than the baud rate allows, as behind USB CDC and COM-port emulators; \
     uart: they do not, whatever the driver",
);
const ECHO: OptionKey =
    OptionKey::for_link("echo", OptionKind::Flag, "the adapter returns the bytes that it sends");

/// Keys of serial links.
const SERIAL: &[OptionKey] = &[
    PROFILE,
    TIMING,
    ECHO,
    OptionKey::for_link("parity", OptionKind::Word(&["none", "even", "odd"]), "parity"),
    OptionKey::for_link("stop", OptionKind::Number(1, 2), "stop bits"),
    OptionKey::for_link("bits", OptionKind::Number(7, 8), "data bits; 7 for Modbus ASCII only"),
];
/// Keys of CAN links.
const CAN: &[OptionKey] = &[
    PROFILE,
    OptionKey::for_link(
        "bitrate",
        OptionKind::Number(0, u32::MAX),
        "bit rate that an adapter is set to [default: the protocol's from the factory]; an interface of \
         Linux must have it already",
    ),
];
/// Keys of simulated drives.
const SIMULATED: &[OptionKey] = &[
    PROFILE,
    OptionKey::for_link(
        "axes",
        OptionKind::Number(1, 32),
        "number of drives on the line, from address 1 up, without the host's own address",
    ),
    OptionKey::for_link("seed", OptionKind::Text, "seed of all that is random"),
    OptionKey::for_link(
        "time",
        OptionKind::Word(&["real", "virtual"]),
        "virtual: time passes as fast as the processor allows, and a wait is over at once",
    ),
    OptionKey::for_link("timing", OptionKind::Text, "timing of the simulated port"),
    ECHO,
    OptionKey::for_link(
        "baud",
        OptionKind::Number(0, u32::MAX),
        "baud rate of serial lines; 0 for lines without timing",
    ),
    OptionKey::for_link(
        "bitrate",
        OptionKind::Number(0, u32::MAX),
        "bit rate of CAN buses; 0 for buses without timing",
    ),
];
/// Keys of a rack file's links.
const RACK: &[OptionKey] = &[
    PROFILE,
    OptionKey::for_link(
        "link",
        OptionKind::Text,
        "one link of the file by its name [default: all]",
    ),
    OptionKey::for_link(
        "timeout",
        OptionKind::Milliseconds,
        "time limit of a reply [default: that of the drive's profile]",
    ),
    OptionKey::for_link("seed", OptionKind::Text, "seed of all that is random, if it is simulated"),
    OptionKey::for_link(
        "time",
        OptionKind::Word(&["real", "virtual"]),
        "virtual: time passes as fast as the processor allows, if it is simulated",
    ),
];
/// Options of simulated families that are spelled nearly as one of these.
const FAMILY_KEYS: [&str; 1] = ["ends"];

/// The keys of every link that carries bytes or CAN frames.
#[must_use]
pub const fn link_keys(medium: MediumKind) -> &'static [OptionKey] {
    match medium {
        MediumKind::Serial => SERIAL,
        MediumKind::Can => CAN,
    }
}

/// The keys that a protocol has beside those of its link.
#[must_use]
pub fn protocol_keys(protocol: &str, medium: MediumKind) -> &'static [OptionKey] {
    registry::find_protocol(protocol, medium).map_or(&[], |protocol| protocol.keys)
}

/// The keys of simulated drives beside those of their protocol.
#[must_use]
pub const fn simulation_keys() -> &'static [OptionKey] {
    SIMULATED
}

/// The keys of the links of a rack file.
#[must_use]
pub const fn rack_keys() -> &'static [OptionKey] {
    RACK
}

impl LinkTarget {
    const fn link_keys(&self) -> &'static [OptionKey] {
        match self.medium() {
            None if matches!(self, Self::Rack { .. }) => RACK,
            None => SIMULATED,
            Some(medium) => link_keys(medium),
        }
    }
}

impl Url {
    /// The protocols whose keys this string may have.
    fn protocols(&self) -> Vec<registry::ProtocolInfo> {
        match (&self.target, self.target.medium()) {
            (_, Some(medium)) => {
                registry::find_protocol(&self.protocol, medium).into_iter().collect()
            }
            (LinkTarget::Sim { what }, None) => {
                let word = what.split_once(':').map_or(&**what, |(word, _)| word);
                match simulate::find_drive(word) {
                    Ok((_, protocol)) => vec![protocol],
                    // A rack file may have drives of any protocol.
                    Err(_) => registry::protocols(),
                }
            }
            (_, None) => Vec::new(),
        }
    }

    /// The keys that a string of this link and protocol may have.
    #[must_use]
    pub fn known_keys(&self) -> Vec<&'static OptionKey> {
        let mut known: Vec<&OptionKey> = self.target.link_keys().iter().collect();
        for key in self.protocols().iter().flat_map(|protocol| protocol.keys) {
            if known.iter().all(|other| other.name != key.name) {
                known.push(key);
            }
        }
        known
    }

    /// Checks that each key belongs to the link or the protocol, and that its value is of its kind.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub(crate) fn check_keys(&self) -> Result<(), Error> {
        let own = self.known_keys();
        let is_simulated = matches!(self.target, LinkTarget::Sim { .. });
        for (name, text) in &self.keys {
            if let Some(key) = own.iter().find(|key| key.name == name) {
                parse_value(key, text)?;
                continue;
            }
            if is_simulated && FAMILY_KEYS.contains(&name.as_str()) {
                continue;
            }
            let known: Vec<&str> = own.iter().map(|key| key.name).collect();
            let owners = owners(name);
            // A simulated family has options of its own, and refuses the others itself.
            let near = spelling::nearest(name, known.iter().copied());
            let is_elsewhere = !owners.is_empty() || owning_kind(name).is_some();
            if is_simulated && !is_elsewhere && near.is_none() && !name.is_empty() {
                continue;
            }
            return Err(self.foreign_key_error(name, known, &owners));
        }
        Ok(())
    }

    fn foreign_key_error(&self, name: &str, mut known: Vec<&str>, owners: &[String]) -> Error {
        let this = match &self.protocols()[..] {
            [one] => one.unique_word(),
            _ => "this link".to_owned(),
        };
        let what = match (owners, owning_kind(name)) {
            ([], None) => {
                let near = spelling::suggestion(name, known.iter().copied());
                format!("unknown key `{name}`{near}")
            }
            ([], Some(kind)) => format!("`{name}` is a key of {kind}, not of this link"),
            (owners, _) => format!("`{name}` is a key of {}, not of {this}", owners.join(", ")),
        };
        known.sort_unstable();
        url_error(what, &format!("keys of {this} are {}", known.join(", ")))
    }

    /// Applies the keys of a protocol.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub(crate) fn apply_keys(
        &self,
        protocol: &registry::ProtocolInfo,
        options: &mut HostOptions,
    ) -> Result<(), Error> {
        for key in protocol.keys {
            if let Some(text) = self.key(key.name)
                && let Some(value) = parse_value(key, text)?
            {
                key.apply(options, value);
            }
        }
        Ok(())
    }

    /// Options by the keys of its protocols.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub(crate) fn stated_options(&self) -> Result<HostOptions, Error> {
        let mut options = HostOptions::new(0);
        self.protocols().iter().try_for_each(|protocol| self.apply_keys(protocol, &mut options))?;
        Ok(options)
    }

    /// Removes keys that belong to other protocols of the same bus.
    pub(super) fn drop_keys_of(&mut self, protocols: &[&str]) {
        let Some(medium) = self.target.medium() else { return };
        let own = self.protocol.clone();
        self.keys.retain(|(name, _)| {
            has_key(&own, name, medium)
                || !protocols.iter().any(|other| has_key(other, name, medium))
        });
    }

    /// Keys that are options of the simulated family.
    pub(crate) fn family_options(&self) -> Vec<(String, String)> {
        let protocols = self.protocols();
        let of_protocols = || protocols.iter().flat_map(|protocol| protocol.keys);
        let is_own = |name: &str| {
            let mut known = SIMULATED.iter().chain(of_protocols());
            known.any(|key| key.name == name && !key.is_of_drive)
        };
        self.keys.iter().filter(|(name, _)| !is_own(name)).cloned().collect()
    }
}

fn has_key(protocol: &str, name: &str, medium: MediumKind) -> bool {
    protocol_keys(protocol, medium).iter().any(|key| key.name == name)
}

/// The protocols that have a key, by their words.
fn owners(name: &str) -> Vec<String> {
    let owners = registry::protocols()
        .into_iter()
        .filter(|protocol| protocol.keys.iter().any(|key| key.name == name));
    owners.map(|protocol| protocol.unique_word()).collect()
}

/// The kind of link that has a key.
fn owning_kind(name: &str) -> Option<&'static str> {
    let kinds = [
        (SERIAL, "serial links"),
        (CAN, "CAN links"),
        (SIMULATED, "simulated drives"),
        (RACK, "rack files"),
    ];
    let found = kinds.iter().find(|(keys, _)| keys.iter().any(|key| key.name == name));
    found.map(|(_, kind)| *kind)
}

/// The value of a key for [`OptionKey::apply`]; `None` for text.
fn parse_value(key: &OptionKey, text: &str) -> Result<Option<u32>, Error> {
    let name = key.name;
    match key.kind {
        OptionKind::Text => Ok(None),
        // Upwards: a limit that is rounded down to zero would be none.
        OptionKind::Milliseconds => Ok(Some(parse_seconds(name, text, |s| (s * 1e3).ceil())?)),
        OptionKind::Gap if text == "3.5c" => Ok(Some(HostOptions::GAP_CHARACTERS)),
        OptionKind::Gap => Ok(Some(parse_seconds(name, text, |s| (s * 1e6).round())?)),
        OptionKind::Number(min, max) => {
            let number = toml_file::parse_number(text)
                .ok_or_else(|| key_error("a whole number", name, text, key.help))?;
            let number = u32::try_from(number).ok().filter(|number| (min..=max).contains(number));
            number.map(Some).ok_or_else(|| match max {
                u32::MAX => key_error(&format!("{min} or more"), name, text, key.help),
                _ => key_error(&format!("{min} to {max}"), name, text, key.help),
            })
        }
        OptionKind::Flag => match text {
            "0" | "no" | "off" | "false" => Ok(Some(0)),
            "1" | "yes" | "on" | "true" | "" => Ok(Some(1)),
            _ => Err(key_error("`yes` or `no`", name, text, key.help)),
        },
        OptionKind::Word(words) => {
            let index = words.iter().position(|word| *word == text);
            let index = index.and_then(|index| u32::try_from(index).ok());
            index.map(Some).ok_or_else(|| {
                let words: Vec<String> = words.iter().map(|word| format!("`{word}`")).collect();
                key_error(&words.join(" or "), name, text, key.help)
            })
        }
    }
}

fn key_error(what: &str, name: &str, text: &str, key_help: &str) -> Error {
    url_error(format!("`{name}={text}` is not {what}"), key_help)
}

fn parse_seconds(name: &str, text: &str, scale: fn(f64) -> f64) -> Result<u32, Error> {
    Ok(scale(seconds(name, text)?) as u32)
}

/// A time in seconds; without a unit it is in milliseconds.
pub(super) fn seconds(name: &str, text: &str) -> Result<f64, Error> {
    let seconds = quantity::parse(text)?.in_unit(polepair_core::units::Unit::Millisecond)?;
    if !(0.0..=SECONDS_MAX).contains(&seconds) {
        return Err(url_error(format!("`{name}={text}` is not between 0 and an hour"), ""));
    }
    // Every request would fail before its reply, also a stop.
    if name == "timeout" && seconds <= 0.0 {
        let what = format!("`{name}={text}` leaves drives no time to answer");
        return Err(url_error(what, "without it each drive has the time limit of its profile"));
    }
    Ok(seconds)
}
