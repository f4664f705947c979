//! Connection strings: `PROTO[+LINK]://ADDRESS[:BAUD or :PORT][?key=value&…][#AXES]`.
//!
//! ```
//! use polepair::url::{Target, Url};
//! let url: Url = "tmcl+serial:///dev/ttyUSB0:9600?timeout=50#1,2".parse()?;
//! assert_eq!(url.target, Target::Serial { path: "/dev/ttyUSB0".into(), baud: Some(9600) });
//! assert_eq!(url.axes, [1, 2]);
//! assert_eq!(url.to_string(), "tmcl+serial:///dev/ttyUSB0:9600?timeout=50#1,2");
//!
//! let error = "tmlc+serial:///dev/ttyUSB0".parse::<Url>().unwrap_err();
//! assert!(error.to_string().contains("did you mean `tmcl`?"));
//! # Ok::<(), polepair::Error>(())
//! ```

use crate::error::Error;
use crate::registry;
use crate::words;
use std::fmt;
use std::str::FromStr;

/// Axes that one connection string names at most.
pub const AXES_MAX: usize = 256;
/// Keys that one connection string has at most.
const KEYS_MAX: usize = 32;

const LINKS: [&str; 2] = ["serial", "tcp"];
const KEYS: [&str; 7] = ["profile", "timeout", "gap", "host", "echo", "parity", "stop"];
const SIM_KEYS: [&str; 9] =
    ["axes", "seed", "time", "profile", "timeout", "gap", "host", "echo", "baud"];

/// A connection string, taken apart.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Url {
    /// The protocol's word; empty for simulated drives, whose rack says it.
    pub protocol: String,
    /// What to open.
    pub target: Target,
    /// Keys and their values, in order.
    pub keys: Vec<(String, String)>,
    /// The axes named, in order; empty when none is.
    pub axes: Vec<u32>,
}

/// What to open.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Target {
    /// A serial port or pseudo-terminal.
    Serial {
        /// `/dev/ttyUSB0`, `COM3`.
        path: String,
        /// Bits per second; the protocol's from the factory if `None`.
        baud: Option<u32>,
    },
    /// A serial server.
    Tcp {
        /// Host name and port: `10.0.0.5:4001`, `[::1]:502`.
        address: String,
    },
    /// Simulated drives in this process: a protocol's or product's word, or a rack file.
    Sim {
        /// `tmcl`, `tmcm-171`, `rack.toml`.
        what: String,
    },
}

impl Url {
    /// The value of a key.
    #[must_use]
    pub fn key(&self, name: &str) -> Option<&str> {
        self.keys.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// The value of a key as a whole number.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub fn number(&self, name: &str) -> Result<Option<u64>, Error> {
        let Some(text) = self.key(name) else { return Ok(None) };
        let number = crate::file::number(text).and_then(|n| u64::try_from(n).ok());
        number.map(Some).ok_or_else(|| wrong(format!("`{name}={text}` is no whole number"), ""))
    }

    /// The value of a key as milliseconds: a plain number, or one with a unit of time.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub fn milliseconds(&self, name: &str) -> Result<Option<f64>, Error> {
        let Some(text) = self.key(name) else { return Ok(None) };
        let measure = crate::quantity::parse(text)?;
        let seconds = measure.in_unit(polepair_core::units::Unit::Millisecond)?;
        if !(0.0..=3600.0).contains(&seconds) {
            return Err(wrong(format!("`{name}={text}` is not between 0 and an hour"), ""));
        }
        Ok(Some(seconds * 1000.0))
    }

    /// The value of a key as yes or no.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub fn flag(&self, name: &str) -> Result<bool, Error> {
        match self.key(name) {
            None | Some("0" | "no" | "off" | "false") => Ok(false),
            Some("1" | "yes" | "on" | "true" | "") => Ok(true),
            Some(other) => Err(wrong(format!("`{name}={other}` is neither yes nor no"), "")),
        }
    }
}

fn wrong(what: String, hint: &str) -> Error {
    Error::usage("E210", what, hint)
}

impl FromStr for Url {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let (rest, fragment) = cut(text, '#');
        let (head, query) = cut(rest, '?');
        let axes = axes(fragment.unwrap_or_default())?;
        let keys = keys(query.unwrap_or_default())?;
        let url = match head.strip_prefix("sim:") {
            Some(what) => sim(what.strip_prefix("//").unwrap_or(what), keys, axes)?,
            None => wire(head, keys, axes)?,
        };
        url.check_keys()?;
        Ok(url)
    }
}

fn cut(text: &str, at: char) -> (&str, Option<&str>) {
    text.split_once(at).map_or((text, None), |(head, rest)| (head, Some(rest)))
}

fn sim(what: &str, keys: Vec<(String, String)>, axes: Vec<u32>) -> Result<Url, Error> {
    if what.is_empty() {
        return Err(wrong("`sim:` names no drive".into(), "write `sim:tmcl` or `sim:rack.toml`"));
    }
    let target = Target::Sim { what: decoded(what)? };
    Ok(Url { protocol: String::new(), target, keys, axes })
}

fn wire(head: &str, keys: Vec<(String, String)>, axes: Vec<u32>) -> Result<Url, Error> {
    let Some((scheme, address)) = head.split_once("://") else {
        let what = format!("`{head}` is no connection string");
        let hint = "write PROTOCOL+LINK://ADDRESS, such as `tmcl+serial:///dev/ttyUSB0:9600#1`, \
                    or `sim:tmcl`";
        return Err(wrong(what, hint));
    };
    let (protocol, link) = cut(scheme, '+');
    let known = registry::names();
    if !known.contains(&protocol) {
        let near = words::hint(protocol, known.iter().copied());
        let what = format!("`{protocol}` is no protocol that can be connected to{near}");
        return Err(Error::usage("E203", what, format!("it can be {}", known.join(", "))));
    }
    if address.is_empty() {
        return Err(wrong(format!("`{head}` names nothing to open"), ""));
    }
    let target = match link.unwrap_or_else(|| guessed(address)) {
        "serial" => serial(address)?,
        "tcp" => tcp(address)?,
        other => {
            let near = words::hint(other, LINKS);
            let what = format!("`{other}` is no kind of link{near}");
            return Err(wrong(what, "it can be serial or tcp"));
        }
    };
    Ok(Url { protocol: protocol.to_owned(), target, keys, axes })
}

/// A path is a port; what else ends in a number is a host.
fn guessed(address: &str) -> &'static str {
    let windows = address.len() > 3 && address[..3].eq_ignore_ascii_case("com");
    if address.starts_with('/') || windows && !address.contains('.') { "serial" } else { "tcp" }
}

fn serial(address: &str) -> Result<Target, Error> {
    let split = address.rsplit_once(':').and_then(|(path, baud)| {
        baud.bytes().all(|c| c.is_ascii_digit()).then(|| (path, baud.parse::<u32>().ok()))
    });
    let (path, baud) = match split {
        None => (address, None),
        Some((path, Some(baud))) if baud > 0 => (path, Some(baud)),
        Some(_) => return Err(wrong(format!("`{address}` has no possible baud rate"), "")),
    };
    Ok(Target::Serial { path: decoded(path)?, baud })
}

fn tcp(address: &str) -> Result<Target, Error> {
    let port = address.rsplit_once(':').and_then(|(host, port)| {
        (!host.is_empty()).then(|| port.parse::<u16>().ok().filter(|port| *port > 0)).flatten()
    });
    if port.is_none() {
        let what = format!("`{address}` has no port number");
        return Err(wrong(what, "write HOST:PORT, such as `10.0.0.5:4001`"));
    }
    Ok(Target::Tcp { address: address.to_owned() })
}

fn keys(query: &str) -> Result<Vec<(String, String)>, Error> {
    let mut keys: Vec<(String, String)> = Vec::new();
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (key, value) = cut(pair, '=');
        if keys.iter().any(|(other, _)| other == key) {
            return Err(wrong(format!("`{key}` is given twice"), ""));
        }
        if keys.len() == KEYS_MAX {
            return Err(wrong(format!("more than {KEYS_MAX} keys"), ""));
        }
        keys.push((decoded(key)?, decoded(value.unwrap_or_default())?));
    }
    Ok(keys)
}

/// `1,2` or `1-4`.
fn axes(fragment: &str) -> Result<Vec<u32>, Error> {
    let mut axes = Vec::new();
    for piece in fragment.split(',').filter(|_| !fragment.is_empty()) {
        let number = |text: &str| {
            let number = crate::file::number(text.trim()).and_then(|n| u32::try_from(n).ok());
            let what = || format!("`#{fragment}`: `{piece}` is no axis number");
            number.ok_or_else(|| wrong(what(), "write `#1`, `#1,2` or `#1-4`"))
        };
        let (first, last) = match piece.split_once('-') {
            Some((first, last)) => (number(first)?, number(last)?),
            None => (number(piece)?, number(piece)?),
        };
        if first > last || (last - first) as usize >= AXES_MAX - axes.len() {
            return Err(wrong(format!("`#{fragment}`: at most {AXES_MAX} axes, upwards"), ""));
        }
        for axis in first..=last {
            if axes.contains(&axis) {
                return Err(wrong(format!("`#{fragment}` names axis {axis} twice"), ""));
            }
            axes.push(axis);
        }
    }
    Ok(axes)
}

impl Url {
    fn check_keys(&self) -> Result<(), Error> {
        let sim = matches!(self.target, Target::Sim { .. });
        let known: &[&str] = if sim { &SIM_KEYS } else { &KEYS };
        for (key, _) in &self.keys {
            if known.contains(&key.as_str()) {
                continue;
            }
            // What a simulated family knows beyond these is its own: it refuses the rest itself.
            let near = words::nearest(key, known.iter().copied());
            if sim && near.is_none() && !key.is_empty() {
                continue;
            }
            let near = words::hint(key, known.iter().copied());
            return Err(wrong(
                format!("unknown key `{key}`{near}"),
                &format!("keys are {}", known.join(", ")),
            ));
        }
        Ok(())
    }

    /// Keys that are for the simulated family alone.
    pub(crate) fn extra(&self) -> Vec<(String, String)> {
        let own = |(key, _): &&(String, String)| !SIM_KEYS.contains(&key.as_str());
        self.keys.iter().filter(own).cloned().collect()
    }
}

impl fmt::Display for Url {
    /// A string that reads back as the same.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.target {
            Target::Serial { path, baud } => {
                write!(f, "{}+serial://{}", self.protocol, encoded(path, ""))?;
                baud.map_or(Ok(()), |baud| write!(f, ":{baud}"))?;
            }
            Target::Tcp { address } => write!(f, "{}+tcp://{address}", self.protocol)?,
            Target::Sim { what } => write!(f, "sim:{}", encoded(what, ""))?,
        }
        for (n, (key, value)) in self.keys.iter().enumerate() {
            let mark = if n == 0 { '?' } else { '&' };
            write!(f, "{mark}{}={}", encoded(key, "=&"), encoded(value, "=&"))?;
        }
        for (n, axis) in self.axes.iter().enumerate() {
            write!(f, "{}{axis}", if n == 0 { '#' } else { ',' })?;
        }
        Ok(())
    }
}

/// `%3F` for `?`: what would end the part it stands in.
fn encoded(text: &str, more: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '%' | '?' | '#' => out.push_str(&format!("%{:02X}", u32::from(c))),
            c if more.contains(c) => out.push_str(&format!("%{:02X}", u32::from(c))),
            c => out.push(c),
        }
    }
    out
}

fn decoded(text: &str) -> Result<String, Error> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let [first, tail @ ..] = rest {
        rest = tail;
        if *first != b'%' {
            bytes.push(*first);
            continue;
        }
        let digits = tail.get(..2).and_then(|two| std::str::from_utf8(two).ok());
        let byte = digits.and_then(|two| u8::from_str_radix(two, 16).ok());
        let bad = || wrong(format!("`{text}`: `%` must be followed by two hex digits"), "");
        bytes.push(byte.ok_or_else(bad)?);
        rest = &tail[2..];
    }
    String::from_utf8(bytes).map_err(|_| wrong(format!("`{text}` is not UTF-8"), ""))
}
