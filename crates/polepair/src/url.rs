//! Connection strings: `PROTO[+LINK]://ADDRESS[:BAUD or :PORT][?key=value&…][#AXES]`.
//!
//! ```
//! use polepair::url::{LinkTarget, Url};
//! let url: Url = "tmcl+serial:///dev/ttyUSB0:9600?timeout=50#1,2".parse()?;
//! assert_eq!(url.target, LinkTarget::Serial { path: "/dev/ttyUSB0".into(), baud: Some(9600) });
//! assert_eq!(url.axes, [1, 2]);
//! assert_eq!(url.to_string(), "tmcl+serial:///dev/ttyUSB0:9600?timeout=50#1,2");
//!
//! let error = "tmlc+serial:///dev/ttyUSB0".parse::<Url>().unwrap_err();
//! assert!(error.to_string().contains("did you mean `tmcl`?"));
//! # Ok::<(), polepair::Error>(())
//! ```

mod keys;

use crate::error::Error;
use crate::registry;
use crate::simulate;
use crate::spelling;
pub use keys::{link_keys, protocol_keys, rack_keys, simulation_keys};
use polepair_core::convert::saturating;
use polepair_core::medium::MediumKind;
pub use polepair_core::proto::AxisNumber;
use polepair_core::proto::{GROUP, SUB_AXIS, with_sub_axis};
use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

/// Axes that one connection string names at most.
pub const AXES_MAX: usize = 256;
/// Keys that one connection string has at most.
const KEYS_MAX: usize = 32;

const LINK_KINDS: [&str; 6] = ["serial", "tcp", "udp", "slcan", "socketcand", "socketcan"];
/// A connection string, taken apart.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Url {
    /// Name of the protocol; empty for simulated drives of a rack.
    pub protocol: String,
    /// Target to open.
    pub target: LinkTarget,
    /// Keys and their values, in order.
    pub keys: Vec<(String, String)>,
    /// The axes named, in order, as [`AxisNumber`] has them; empty when none is.
    pub axes: Vec<u32>,
    /// Axes named by a word, as racks call them.
    pub names: Vec<String>,
}

/// The protocols' words, each with every medium that it is spoken on.
#[must_use]
pub fn protocols() -> Vec<(&'static str, MediumKind)> {
    registry::protocols().iter().map(|protocol| (protocol.name, protocol.medium)).collect()
}

/// Target of a connection string.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum LinkTarget {
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
    /// A CAN bus over UDP multicast, in python-can's `udp_multicast` format.
    Udp {
        /// Group and port: `239.74.163.2:43113`.
        group: String,
    },
    /// A CAN bus behind an slcan adapter on a serial port.
    Slcan {
        /// `/dev/ttyACM0`, `COM3`.
        path: String,
        /// The port's bits per second, where the adapter has a real serial line.
        baud: Option<u32>,
    },
    /// A CAN bus behind an slcan adapter on a serial server.
    SlcanTcp {
        /// Host name and port.
        address: String,
    },
    /// A CAN bus of another computer that runs socketcand.
    Socketcand {
        /// Host name and port.
        address: String,
        /// The bus' name there: `can0`.
        bus: String,
    },
    /// A CAN bus of this computer, on Linux.
    Socketcan {
        /// The interface: `can0`.
        interface: String,
    },
    /// Simulated drives in this process: a protocol's or product's word, or a rack file.
    Sim {
        /// `tmcl`, `tmcm-171`, `rack.toml`.
        what: String,
    },
    /// A link that a program opened itself: no string means it.
    External {
        /// Name of the link.
        name: String,
        /// Medium of the link.
        medium: MediumKind,
    },
    /// The links of a rack file: real ones if it has `connect`, else simulated.
    Rack {
        /// `cell.toml`.
        file: String,
    },
}

impl LinkTarget {
    /// Medium of the wire; a simulation's links have their own.
    #[must_use]
    pub const fn medium(&self) -> Option<MediumKind> {
        match self {
            Self::Serial { .. } | Self::Tcp { .. } => Some(MediumKind::Serial),
            Self::Sim { .. } | Self::Rack { .. } => None,
            Self::External { medium, .. } => Some(*medium),
            _ => Some(MediumKind::Can),
        }
    }
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
        let number = crate::toml_file::parse_number(text).and_then(|n| u64::try_from(n).ok());
        number.map(Some).ok_or_else(|| {
            url_error(
                format!(
                    "`{name}={text}` is not a whole \
         number"
                ),
                "",
            )
        })
    }

    /// The value of a key as milliseconds: a plain number, or one with a unit of time.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub fn milliseconds(&self, name: &str) -> Result<Option<f64>, Error> {
        let Some(text) = self.key(name) else { return Ok(None) };
        Ok(Some(keys::seconds(name, text)? * 1000.0))
    }

    /// The value of a key as yes or no.
    ///
    /// # Errors
    /// [`Error::Usage`] `E210`.
    pub fn flag(&self, name: &str) -> Result<bool, Error> {
        match self.key(name) {
            None | Some("0" | "no" | "off" | "false") => Ok(false),
            Some("1" | "yes" | "on" | "true" | "") => Ok(true),
            Some(other) => Err(url_error(format!("`{name}={other}` is not `yes` or `no`"), "")),
        }
    }
}

fn url_error(what: String, hint: &str) -> Error {
    Error::usage("E210", what, hint)
}

impl FromStr for Url {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        Self::parse_with(text, false)
    }
}

impl Url {
    /// Parses the string; for stops, a `repeated` axis counts once.
    pub(crate) fn parse_with(text: &str, repeated: bool) -> Result<Self, Error> {
        let url = Self::parse_unchecked(text, repeated)?;
        url.check_keys()?;
        Ok(url)
    }

    /// Parses the string for one of several protocols of a bus: keys of the others are skipped.
    pub(crate) fn parse_among(
        text: &str,
        protocols: &[&str],
        repeated: bool,
    ) -> Result<Self, Error> {
        let mut url = Self::parse_unchecked(text, repeated)?;
        // A key of one protocol is none of the others, but all share the string.
        url.drop_keys_of(protocols);
        url.check_keys()?;
        Ok(url)
    }

    fn parse_unchecked(text: &str, repeated: bool) -> Result<Self, Error> {
        // From the end to the front: a query may hold a `+` or `://`, the address may not.
        let (rest, fragment) = text.split_once('#').unwrap_or((text, ""));
        let (head, query) = rest.split_once('?').unwrap_or((rest, ""));
        let keys = parse_keys(query)?;
        Ok(match (head.strip_prefix("sim:"), head.strip_prefix("rack:")) {
            (None, None) => {
                parse_wire(head, keys, parse_axes(fragment, repeated)?)?.with_broadcast_named()
            }
            (what, file) => {
                let (names, numbers) = split_names(fragment);
                let axes = parse_axes(&numbers, repeated)?;
                let target = match (what, file) {
                    (_, Some(file)) => parse_rack(file)?,
                    (what, None) => parse_sim(what.unwrap_or_default())?,
                };
                Url { protocol: String::new(), target, keys, axes, names }.with_broadcast_named()
            }
        })
    }
}

fn split_at_mark(text: &str, at: char) -> (&str, Option<&str>) {
    text.split_once(at).map_or((text, None), |(head, rest)| (head, Some(rest)))
}

fn parse_sim(what: &str) -> Result<LinkTarget, Error> {
    let what = what.strip_prefix("//").unwrap_or(what);
    if what.is_empty() {
        return Err(url_error(
            "`sim:` names no drive".into(),
            "write `sim:tmcl` or `sim:rack.toml`",
        ));
    }
    Ok(LinkTarget::Sim { what: decode(what)? })
}

fn parse_rack(file: &str) -> Result<LinkTarget, Error> {
    if file.is_empty() {
        return Err(url_error("`rack:` names no file".into(), "write `rack:cell.toml`"));
    }
    Ok(LinkTarget::Rack { file: decode(file)? })
}

fn parse_wire(head: &str, keys: Vec<(String, String)>, axes: Vec<u32>) -> Result<Url, Error> {
    let Some((scheme, address)) = head.split_once("://") else {
        let what = format!("`{head}` is not a connection string");
        let hint = "write PROTOCOL+LINK://ADDRESS, such as `tmcl+serial:///dev/ttyUSB0:9600#1`, \
                    or `sim:tmcl`";
        return Err(url_error(what, hint));
    };
    let (protocol, link) = split_at_mark(scheme, '+');
    let known = registry::protocol_names();
    if !known.contains(&protocol) {
        let near = spelling::suggestion(protocol, known.iter().copied());
        let what = format!("`{protocol}` is not a protocol of connection strings{near}");
        return Err(Error::usage("E203", what, format!("it can be {}", known.join(", "))));
    }
    if address.is_empty() {
        return Err(url_error(format!("`{head}` names no device to open"), ""));
    }
    let target = match link.unwrap_or_else(|| guess_link(protocol, address)) {
        "serial" => parse_port(address).map(|(path, baud)| LinkTarget::Serial { path, baud })?,
        "tcp" => LinkTarget::Tcp { address: parse_server(protocol, address)? },
        "udp" => LinkTarget::Udp { group: parse_host_port(address)? },
        "slcan" if is_port(address) => {
            parse_port(address).map(|(path, baud)| LinkTarget::Slcan { path, baud })?
        }
        "slcan" => LinkTarget::SlcanTcp { address: parse_host_port(address)? },
        "socketcand" => parse_socketcand(address)?,
        "socketcan" => LinkTarget::Socketcan { interface: decode(address)? },
        other => {
            let near = spelling::suggestion(other, LINK_KINDS);
            let what = format!("`{other}` is not a link type{near}");
            return Err(url_error(what, &format!("it can be {}", LINK_KINDS.join(", "))));
        }
    };
    let mut url = Url { protocol: protocol.to_owned(), target, keys, axes, names: Vec::new() };
    let known = url.protocol_info()?;
    if let LinkTarget::Serial { baud: Some(baud), .. } = &mut url.target {
        *baud = known.checked_rate(*baud, "baud")?;
    }
    if let Some(rate) = url.number("bitrate")? {
        known.checked_rate(saturating(rate), "bit/s")?;
    }
    Ok(url)
}

/// Kind of link of a string without one: a path is a port, an end in a number is a host, and a protocol on CAN alone is
/// on a bus of this computer.
fn guess_link(protocol: &str, address: &str) -> &'static str {
    match (registry::find_protocol(protocol, MediumKind::Serial), is_port(address)) {
        (Some(known), true) if known.network_port.is_none() => "serial",
        (Some(_), _) => "tcp",
        (None, true) => "slcan",
        (None, false) => "socketcan",
    }
}

/// Returns whether it names a serial port.
fn is_port(address: &str) -> bool {
    let windows = address.get(..3).is_some_and(|word| word.eq_ignore_ascii_case("com"));
    // A host name with a dot is none, even if it begins with `com`.
    address.starts_with('/') || windows && address.len() > 3 && !address.contains('.')
}

fn parse_port(address: &str) -> Result<(String, Option<u32>), Error> {
    let split = address.rsplit_once(':').and_then(|(path, baud)| {
        baud.bytes().all(|c| c.is_ascii_digit()).then(|| (path, baud.parse::<u32>().ok()))
    });
    let (path, baud) = match split {
        None => (address, None),
        Some((path, Some(baud))) if baud > 0 => (path, Some(baud)),
        Some(_) => return Err(url_error(format!("`{address}` has no valid baud rate"), "")),
    };
    Ok((decode(path)?, baud))
}

fn parse_host_port(address: &str) -> Result<String, Error> {
    let port = address.rsplit_once(':').and_then(|(host, port)| {
        (!host.is_empty()).then(|| port.parse::<u16>().ok().filter(|port| *port > 0)).flatten()
    });
    if port.is_none() {
        let what = format!("`{address}` has no port number");
        return Err(url_error(what, "write HOST:PORT, such as `10.0.0.5:4001`"));
    }
    Ok(address.to_owned())
}

/// Host and port of a server; a protocol of the network has a usual port.
fn parse_server(protocol: &str, address: &str) -> Result<String, Error> {
    let known = registry::find_protocol(protocol, MediumKind::Serial);
    let has_port = address.rsplit_once(':').is_some_and(|(_, port)| !port.ends_with(']'));
    match known.and_then(|known| known.network_port) {
        Some(port) if !has_port => parse_host_port(&format!("{address}:{port}")),
        _ => parse_host_port(address),
    }
}

fn parse_socketcand(address: &str) -> Result<LinkTarget, Error> {
    let Some((server, bus)) = address.split_once('/').filter(|(_, bus)| !bus.is_empty()) else {
        let what = format!("`{address}` names no bus");
        return Err(url_error(what, "write HOST:PORT/BUS, such as `10.0.0.5:29536/can0`"));
    };
    Ok(LinkTarget::Socketcand { address: parse_host_port(server)?, bus: decode(bus)? })
}

pub(crate) fn parse_keys(query: &str) -> Result<Vec<(String, String)>, Error> {
    let mut keys: Vec<(String, String)> = Vec::new();
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
        let (key, value) = (decode(key)?, decode(value)?);
        // The first or the last would win by chance; with a baud rate that is no small matter.
        if keys.iter().any(|(other, _)| *other == key) {
            return Err(url_error(format!("`{key}` is given twice"), ""));
        }
        if keys.len() == KEYS_MAX {
            return Err(url_error(format!("more than {KEYS_MAX} keys"), ""));
        }
        keys.push((key, value));
    }
    Ok(keys)
}

/// The names of a fragment, and what else it has: `x,y,3` are two names and a number. A word that
/// begins like a group is one.
pub(crate) fn split_names(fragment: &str) -> (Vec<String>, String) {
    let (names, numbers): (Vec<&str>, Vec<&str>) = fragment.split(',').partition(|piece| {
        piece.trim().starts_with(char::is_alphabetic) && !is_group_piece(piece.trim())
    });
    (names.iter().map(|name| name.trim().to_owned()).collect(), numbers.join(","))
}

fn is_group_piece(piece: &str) -> bool {
    let rest = piece.strip_prefix('g').and_then(|rest| rest.chars().next());
    rest.is_some_and(|c| c == '*' || c.is_ascii_digit())
}

/// `1,2`, `1-4`, `5.2`, `1.0-5`, `g3`, `g1+2`, `g*`.
fn parse_axes(fragment: &str, repeated: bool) -> Result<Vec<u32>, Error> {
    let mut axes = Vec::new();
    for piece in fragment.split(',').filter(|_| !fragment.is_empty()) {
        let (first, last, step) = match piece.trim().strip_prefix('g') {
            Some(groups) => (parse_group(fragment, groups)?, parse_group(fragment, groups)?, 1),
            None => parse_range(fragment, piece)?,
        };
        // Before the loop: `#1-4000000000` must not be counted up.
        if first > last || (last - first) as usize / step >= AXES_MAX - axes.len() {
            return Err(url_error(format!("`#{fragment}`: at most {AXES_MAX} axes, upwards"), ""));
        }
        for axis in (first..=last).step_by(step) {
            if axes.contains(&axis) {
                if repeated {
                    continue;
                }
                let number = AxisNumber(axis);
                return Err(url_error(format!("`#{fragment}` names axis {number} twice"), ""));
            }
            axes.push(axis);
        }
    }
    Ok(axes)
}

/// From one axis of a drive to its next.
const SUB_AXIS_STEP: usize = 1 << SUB_AXIS.trailing_zeros();

/// First, last, and how far each lies from the next.
fn parse_range(fragment: &str, piece: &str) -> Result<(u32, u32, usize), Error> {
    let number = |text: &str| {
        let number =
            crate::toml_file::parse_number(text.trim()).and_then(|n| u32::try_from(n).ok());
        let number = number.filter(|number| AxisNumber(*number).is_plain());
        let what = || format!("`#{fragment}`: `{piece}` is not an axis number");
        number.ok_or_else(|| url_error(what(), "write `#1`, `#1,2`, `#1-4` or `#1.2`"))
    };
    if let Some((drive, sub)) = piece.split_once('.') {
        let (first, last) = sub.split_once('-').unwrap_or((sub, sub));
        let what = || format!("`#{fragment}`: `{piece}` is not an axis number");
        let sub_axis =
            |text| u8::try_from(number(text)?).map_err(|_| url_error(what(), "write `#1.2`"));
        let drive = number(drive)?;
        let (first, last) = (sub_axis(first)?, sub_axis(last)?);
        return Ok((with_sub_axis(drive, first), with_sub_axis(drive, last), SUB_AXIS_STEP));
    }
    match piece.split_once('-') {
        Some((first, last)) => Ok((number(first)?, number(last)?, 1)),
        None => number(piece).map(|axis| (axis, axis, 1)),
    }
}

/// Group in a fragment behind the `g`: numbers from 1, or a star.
fn parse_group(fragment: &str, groups: &str) -> Result<u32, Error> {
    if groups == "*" {
        return Ok(GROUP);
    }
    groups.split('+').try_fold(GROUP, |mask, text| {
        let number = text.parse::<u32>().ok().filter(|number| (1..=31).contains(number));
        let number = number.ok_or_else(|| {
            url_error(bad_group(fragment, groups), "write `#g3`, `#g1+2` or `#g*`")
        })?;
        Ok(mask | 1 << (number - 1))
    })
}

fn bad_group(fragment: &str, groups: &str) -> String {
    format!("`#{fragment}`: `g{groups}` is not a group")
}

impl Url {
    /// This string with the protocol's number of its broadcast written as `g*`.
    fn with_broadcast_named(mut self) -> Self {
        let Some(protocol) = self.known_protocol() else { return self };
        let named = self.axes.iter_mut().find(|axis| Some(**axis) == protocol.broadcast_number);
        if let (Some(axis), Some(all)) = (named, protocol.broadcast) {
            *axis = all;
        }
        self
    }

    /// The protocol, where the string alone is enough: a rack's file has one for each link.
    fn known_protocol(&self) -> Option<registry::ProtocolInfo> {
        match &self.target {
            LinkTarget::Sim { what } => simulate::find_drive(what).ok().map(|(_, known)| known),
            _ => self.protocol_info().ok(),
        }
    }

    /// Takes the broadcast of a protocol out whose stations do not answer it, and returns whether it was named.
    ///
    /// The caller asks each station afterwards.
    pub fn take_unanswered_broadcast(&mut self) -> bool {
        let Some(protocol) = self.known_protocol() else { return false };
        let before = self.axes.len();
        self.axes.retain(|axis| !protocol.is_unanswered(*axis));
        self.axes.len() < before
    }

    /// The protocol on the target's medium.
    pub(crate) fn protocol_info(&self) -> Result<registry::ProtocolInfo, Error> {
        let Some(medium) = self.target.medium() else {
            return Err(url_error("the links of a rack state their protocols".into(), ""));
        };
        let known = self.protocol_on(medium);
        if let (Some(known), LinkTarget::Serial { .. }) = (&known, &self.target)
            && let Some(port) = known.network_port
        {
            let what = format!("`{}` is not used on a serial line", self.protocol);
            let hint = format!("it is used on TCP: {}://10.0.0.5:{port}#1", self.protocol);
            return Err(url_error(what, &hint));
        }
        known.ok_or_else(|| {
            let (not, hint) = match medium {
                MediumKind::Serial => {
                    ("a serial line", "it is used on CAN: udp, slcan, socketcand, socketcan")
                }
                MediumKind::Can => ("CAN", "it is used on serial lines: serial, tcp"),
            };
            url_error(format!("`{}` is not used on {not}", self.protocol), hint)
        })
    }

    fn protocol_on(&self, medium: MediumKind) -> Option<registry::ProtocolInfo> {
        registry::find_protocol(&self.protocol, medium)
    }
}

impl Url {
    /// This string with another baud rate; `None` where it has no port.
    #[must_use]
    pub fn with_baud(&self, rate: u32) -> Option<Self> {
        let mut other = self.clone();
        match &mut other.target {
            LinkTarget::Serial { baud, .. } => *baud = Some(rate),
            _ => return None,
        }
        Some(other)
    }
}

impl fmt::Display for Url {
    /// A string that reads back as the same.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.target {
            LinkTarget::Serial { path, baud } => {
                write!(f, "{}+serial://{}", self.protocol, encode_port(path, *baud))?;
            }
            LinkTarget::Tcp { address } => match self.protocol_info() {
                Ok(known) => write!(f, "{}", known.url_at(&format!("tcp://{address}")))?,
                Err(_) => write!(f, "{}+tcp://{address}", self.protocol)?,
            },
            LinkTarget::Udp { group } => write!(f, "{}+udp://{group}", self.protocol)?,
            LinkTarget::Slcan { path, baud } => {
                // A dot in what is no path would make a host name of it.
                let port = encode_port(path, *baud);
                let port = if path.starts_with('/') { port } else { port.replace('.', "%2E") };
                write!(f, "{}+slcan://{port}", self.protocol)?;
            }
            LinkTarget::SlcanTcp { address } => write!(f, "{}+slcan://{address}", self.protocol)?,
            LinkTarget::Socketcand { address, bus } => {
                write!(f, "{}+socketcand://{address}/{}", self.protocol, encode(bus, ""))?;
            }
            LinkTarget::Socketcan { interface } => {
                write!(f, "{}+socketcan://{}", self.protocol, encode(interface, ""))?;
            }
            LinkTarget::External { name, .. } => write!(f, "{}+{name}", self.protocol)?,
            LinkTarget::Sim { what } => {
                // Two slashes at the front are taken off when it is read.
                let front = if what.starts_with("//") { "//" } else { "" };
                write!(f, "sim:{front}{}", encode(what, ""))?;
            }
            LinkTarget::Rack { file } => write!(f, "rack:{}", encode(file, ""))?,
        }
        for (n, (key, value)) in self.keys.iter().enumerate() {
            let mark = if n == 0 { '?' } else { '&' };
            write!(f, "{mark}{}={}", encode(key, "=&"), encode(value, "=&"))?;
        }
        let numbers = self.axes.iter().map(|axis| AxisNumber(*axis).to_string());
        for (n, axis) in numbers.chain(self.names.iter().cloned()).enumerate() {
            write!(f, "{}{axis}", if n == 0 { '#' } else { ',' })?;
        }
        Ok(())
    }
}

/// The connection string without its axes: the link.
///
/// ```
/// use polepair::url::without_axes;
/// assert_eq!(without_axes("tmcl+serial:///dev/ttyUSB0#1,2"), "tmcl+serial:///dev/ttyUSB0");
/// ```
#[must_use]
pub fn without_axes(url: &str) -> &str {
    url.split_once('#').map_or(url, |(link, _)| link)
}

/// The word quoted for a shell: a connection string may have characters that mean something there. A command that is
/// shown to be pasted names its drives by this.
///
/// ```
/// use polepair::url::shell_word;
/// assert_eq!(shell_word("tmcl+tcp://10.0.0.4:4001#1,2"), "tmcl+tcp://10.0.0.4:4001#1,2");
/// # #[cfg(not(windows))]
/// assert_eq!(shell_word("tmcl://x?host=3&timeout=9#1"), "'tmcl://x?host=3&timeout=9#1'");
/// ```
#[must_use]
pub fn shell_word(word: &str) -> Cow<'_, str> {
    // Behind something else `#` begins no comment.
    let is_plain = word.chars().enumerate().all(|(n, c)| is_plain_char(c) || c == '#' && n > 0);
    if is_plain && !word.is_empty() {
        Cow::Borrowed(word)
    } else if cfg!(windows) {
        Cow::Owned(format!("\"{}\"", word.replace('"', "\\\"")))
    } else {
        Cow::Owned(format!("'{}'", word.replace('\'', r"'\''")))
    }
}

fn is_plain_char(c: char) -> bool {
    c.is_alphanumeric() || "_-+=:,./@%".contains(c)
}

/// The string that means the links of a rack file, or one of them.
pub(crate) fn rack_url(file: &str, link: Option<&str>) -> String {
    let link = link.map_or_else(String::new, |link| format!("?link={}", encode(link, "=&")));
    format!("rack:{}{link}", encode(file, ""))
}

/// A port and its baud rate. Without one, what looks like a baud rate at the path's end is its own.
fn encode_port(path: &str, baud: Option<u32>) -> String {
    let text = encode(path, "");
    match (baud, text.rsplit_once(':')) {
        (Some(baud), _) => format!("{text}:{baud}"),
        (None, Some((head, tail))) if tail.bytes().all(|c| c.is_ascii_digit()) => {
            format!("{head}%3A{tail}")
        }
        (None, _) => text,
    }
}

/// Percent-encodes characters that would end the part, such as `%3F` for `?`.
fn encode(text: &str, more: &str) -> String {
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

pub(crate) fn decode(text: &str) -> Result<String, Error> {
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
        bytes.push(byte.ok_or_else(|| {
            url_error(format!("`{text}`: `%` must be followed by two hex digits"), "")
        })?);
        rest = &tail[2..];
    }
    String::from_utf8(bytes).map_err(|_| url_error(format!("`{text}` is not UTF-8"), ""))
}
