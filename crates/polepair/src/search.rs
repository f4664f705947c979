//! Finds drives on ports of which neither protocol nor rate is known, by reads only.
//!
//! Each port is tried with one protocol and rate after the other, the usual ones first, and a few addresses each;
//! then with more addresses. A port whose drive replied is scanned with that protocol and rate.

use std::ops::{ControlFlow, Range};
use std::time::Duration;

use polepair_core::medium::MediumKind;
use polepair_link::{Cause, Port, PortKind, clock, ports};

use crate::bus;
use crate::connect::Connector;
use crate::detected_drive::DetectedDrive;
use crate::error::Error;
use crate::identify::{ProbeResult, Prober};
use crate::registry::{self, ProtocolInfo};
use crate::scan::{ScanAddresses, scan};
use crate::url::{LinkTarget, Url};

/// The baud rates that drives have, the usual ones first.
pub(crate) const BAUD_RATES: [u32; 9] =
    [9_600, 115_200, 19_200, 38_400, 57_600, 230_400, 4_800, 2_400, 256_000];
/// Modbus over Serial Line V1.02, 2.5.1: the usual frame of RTU has even parity. Many drives have it at these rates.
const EVEN_PARITY: &str = "modbus-rtu";
const EVEN_PARITY_RATES: [u32; 4] = [19_200, 9_600, 38_400, 115_200];
/// Addresses of each pass: drives come from the factory with the lowest, and few lines have many.
const PASSES: [Range<usize>; 3] = [0..2, 2..8, 8..32];
/// Time for a reply in the first pass and in the others, beside the time on the wire. Drives reply within a few
/// milliseconds; adapters on USB hold bytes back for 16 ms.
const FIRST_PATIENCE: Duration = Duration::from_millis(60);
const PATIENCE: Duration = Duration::from_millis(35);
/// Requests to the first address: a TMCL module that holds part of a datagram, of nine bytes, needs one more byte for
/// each of them.
const FIRST_REQUESTS: u32 = 10;
/// Bits on the wire of a request and its reply: no more than 20 characters.
const EXCHANGE_BITS: u32 = 20 * 11;

/// Present attempt of a search.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SearchStep<'a> {
    /// The port: `/dev/ttyUSB0`, `can0`.
    pub port: &'a str,
    /// Protocol and rate of the attempt: `modbus-rtu at 19200 baud`.
    pub attempt: &'a str,
    /// Attempts before this one.
    pub done: usize,
    /// Attempts in all.
    pub of: usize,
}

/// Called before each request; may break the search off.
pub type SearchCallback<'a> = &'a mut dyn FnMut(&SearchStep<'_>) -> ControlFlow<()>;

/// A link on which drives replied.
#[derive(Clone, Debug)]
pub struct FoundLink {
    /// Connection string, without axes.
    pub url: String,
    /// The drives, by address.
    pub drives: Vec<DetectedDrive>,
}

/// A port on which no drive was found.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SilentPort {
    /// The port.
    pub port: String,
    /// Reason why it could not be asked, if so.
    pub error: Option<String>,
    /// Attempts: `tmcl and modbus-rtu at 9600 and 115200 baud, addresses 1 to 32`.
    pub tried: String,
    /// Attempts to which something replied that was no valid frame.
    pub damaged: Vec<String>,
}

/// Result of a search.
#[derive(Clone, Debug, Default)]
pub struct SearchReport {
    /// Links with drives.
    pub links: Vec<FoundLink>,
    /// The other ports.
    pub silent: Vec<SilentPort>,
    /// True if it was interrupted.
    pub is_interrupted: bool,
}

/// Returns whether a word on a command line means a port, and not a connection string.
#[must_use]
pub fn is_port_name(word: &str) -> bool {
    !word.contains("://")
        && !word.starts_with(['@', '#'])
        && (word.starts_with("/dev/")
            || is_device(word)
            || ports().iter().any(|port| is_called(port, word)))
}

/// Returns whether a path leads to a terminal, as the links of pseudo-terminals do.
#[cfg(unix)]
fn is_device(path: &str) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    std::fs::metadata(path).is_ok_and(|found| found.file_type().is_char_device())
}

#[cfg(not(unix))]
fn is_device(_path: &str) -> bool {
    false
}

fn is_called(port: &Port, word: &str) -> bool {
    port.path == word || port.stable_name.as_deref() == Some(word)
}

/// Searches ports for drives: those of this machine, or the named ones. Only reads are sent.
///
/// # Errors
/// [`Error::Link`] where a link goes away while it is scanned.
pub fn search(
    connector: &Connector,
    named: &[String],
    progress: SearchCallback<'_>,
) -> Result<SearchReport, Error> {
    let known = ports();
    let mut searches: Vec<PortSearch> = match named {
        [] => known.iter().map(PortSearch::new).collect(),
        named => named.iter().map(|word| PortSearch::of_word(&known, word)).collect(),
    };
    let of = PASSES.len() * searches.iter().map(|search| search.attempts.len()).sum::<usize>();
    let mut done = 0;
    // Low addresses at every rate before high ones at any: most drives have address 1 or 2.
    for addresses in PASSES {
        for search in &mut searches {
            let attempts = search.attempts.len();
            // A line has one rate; what it is, the first drive has shown.
            if search.found.is_empty() {
                let mut each = |port: &str, attempt: &str, at: usize| {
                    progress(&SearchStep { port, attempt, done: done + at, of })
                };
                if search.run_pass(connector, addresses.clone(), &mut each)?.is_break() {
                    return Ok(SearchReport::new(searches, true));
                }
            }
            done += attempts;
        }
    }
    Ok(SearchReport::new(searches, false))
}

/// One way to ask a port.
struct SearchAttempt {
    url: Url,
    protocol: ProtocolInfo,
    label: String,
    /// Baud rate, never 0.
    baud: u32,
}

/// A port that is being searched.
struct PortSearch {
    port: String,
    attempts: Vec<SearchAttempt>,
    /// For a CAN bus: protocols that are asked all at once, and those whose questions could be commands to drives of
    /// others, which are asked where no other drive replied.
    buses: Vec<String>,
    error: Option<String>,
    damaged: Vec<String>,
    /// Addresses that were asked of each attempt.
    asked: usize,
    /// Addresses that the host may not ask, being its own: `tmcl address 2`.
    left_out: Vec<String>,
    found: Vec<FoundLink>,
}

type AttemptCallback<'a> = &'a mut dyn FnMut(&str, &str, usize) -> ControlFlow<()>;

impl PortSearch {
    fn new(port: &Port) -> Self {
        let error = port.error.as_ref().map(|error| format!("{error}. {}", error.hint()));
        let search = match &port.kind {
            PortKind::Can { .. } => Self::of_bus(&port.path),
            PortKind::Slcan => Self {
                error: Some(format!(
                    "a wrong bit rate would disturb its bus; state it: \
                     canopen+slcan://{}?bitrate=500000",
                    port.path
                )),
                ..Self::of_serial_port(&port.path)
            },
            PortKind::Bytes => Self::of_serial_port(&port.path),
        };
        Self { error: error.or(search.error.clone()), ..search }
    }

    /// A port that a user named, which the system may not list: a pseudo-terminal.
    fn of_word(known: &[Port], word: &str) -> Self {
        let listed = known.iter().find(|port| is_called(port, word));
        listed.map_or_else(|| Self::of_serial_port(word), Self::new)
    }

    fn of_serial_port(path: &str) -> Self {
        let mut attempts = Vec::new();
        let protocols = registry::protocols();
        let serial = || {
            let is_serial =
                |it: &&ProtocolInfo| it.medium == MediumKind::Serial && it.network_port.is_none();
            protocols.iter().filter(is_serial)
        };
        let mut add = |protocol: &ProtocolInfo, rate: u32, has_parity: bool| {
            let url = Url {
                protocol: protocol.name.to_owned(),
                target: LinkTarget::Serial { path: path.to_owned(), baud: Some(rate) },
                keys: if has_parity { vec![option_pair("parity", "even")] } else { Vec::new() },
                axes: Vec::new(),
                names: Vec::new(),
            };
            let parity = if has_parity { ", even parity" } else { "" };
            let label = format!("{} at {rate} baud{parity}", protocol.name);
            attempts.push(SearchAttempt { url, protocol: protocol.clone(), label, baud: rate });
        };
        // What drives have from the factory comes first.
        serial().for_each(|protocol| add(protocol, protocol.baud, false));
        let with_parity = || serial().filter(|protocol| protocol.name == EVEN_PARITY);
        for rate in EVEN_PARITY_RATES {
            with_parity().for_each(|protocol| add(protocol, rate, true));
        }
        for rate in BAUD_RATES {
            let is_new = |it: &&ProtocolInfo| it.baud != rate && it.has_rate(rate);
            serial().filter(is_new).for_each(|protocol| add(protocol, rate, false));
        }
        Self::with_attempts(path, attempts)
    }

    fn of_bus(interface: &str) -> Self {
        let protocols = registry::protocols();
        let all: Vec<_> = protocols.iter().filter(|it| it.medium == MediumKind::Can).collect();
        let ranks = bus::guest_ranks(&all);
        let words = [named_ports(false, &all, &ranks), named_ports(true, &all, &ranks)]
            .into_iter()
            .filter(|words| !words.is_empty());
        let buses = words.map(|words| format!("{words}+socketcan://{interface}")).collect();
        Self { buses, ..Self::with_attempts(interface, Vec::new()) }
    }

    fn with_attempts(port: &str, attempts: Vec<SearchAttempt>) -> Self {
        Self {
            port: port.to_owned(),
            attempts,
            buses: Vec::new(),
            error: None,
            damaged: Vec::new(),
            asked: 0,
            left_out: Vec::new(),
            found: Vec::new(),
        }
    }

    /// Asks some addresses in each way.
    fn run_pass(
        &mut self,
        connector: &Connector,
        addresses: Range<usize>,
        each: AttemptCallback<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        // A port that cannot be opened is not tried forty times.
        if self.error.is_some() {
            return Ok(ControlFlow::Continue(()));
        }
        for bus in self.buses.clone() {
            // All addresses are asked in the first pass.
            if addresses.start > 0 || !self.found.is_empty() {
                break;
            }
            if self.scan_bus(connector, &bus, each)?.is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        for at in 0..self.attempts.len() {
            if each(&self.port, &self.attempts[at].label, at).is_break() {
                return Ok(ControlFlow::Break(()));
            }
            match self.ask(connector, at, addresses.clone(), each) {
                Ok(ControlFlow::Continue(())) if self.found.is_empty() => {}
                Ok(flow) => return Ok(flow),
                // An adapter that cannot do a rate refuses it.
                Err(Error::Link(error)) if error.cause() == Cause::Unsuitable => {}
                Err(Error::Link(error)) => {
                    self.error = Some(format!("{error}. {}", error.hint()));
                    return Ok(ControlFlow::Continue(()));
                }
                Err(error) => return Err(error),
            }
        }
        self.asked = addresses.end;
        Ok(ControlFlow::Continue(()))
    }

    fn ask(
        &mut self,
        connector: &Connector,
        at: usize,
        addresses: Range<usize>,
        each: AttemptCallback<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let SearchAttempt { url, protocol, label, baud } = &self.attempts[at];
        let (mut lines, _) = connector.open_lines(url)?;
        let Some(line) = lines.first_mut() else { return Ok(ControlFlow::Continue(())) };
        debug_assert!(!addresses.is_empty());
        let numbers = protocol.addresses.clone().skip(addresses.start).take(addresses.len());
        let on_wire = Duration::from_secs(1) * EXCHANGE_BITS / *baud;
        debug_assert!(*baud > 0, "every attempt states its rate");
        let patience = on_wire + if addresses.start == 0 { FIRST_PATIENCE } else { PATIENCE };
        // Without a rate of the port (USB CDC, pseudo-terminals) the host would wait as long as on a network.
        line.options.reply_timeout_ms = u32::try_from(patience.as_millis()).ok();
        line.options.ack_timeout_ms = line.options.reply_timeout_ms;
        let line = &lines[0];
        for number in numbers {
            if each(&self.port, label, at).is_break() {
                return Ok(ControlFlow::Break(()));
            }
            // The first address is asked again and again: a drive may hold bytes of other protocols' requests, which
            // it first drops.
            let is_first = number == *protocol.addresses.start();
            let prober = Prober::new(line, &connector.config);
            let prober = if is_first { prober } else { prober.scanning() };
            let limit = patience * if is_first { FIRST_REQUESTS } else { 1 };
            match prober.with_timeout(Some(clock::scale_timeout(limit))).probe(number)? {
                ProbeResult::Found { doubtful: false, .. } => {
                    let url = url.clone();
                    // The port is exclusive: the scan opens it anew.
                    drop(lines);
                    return self.scan_link(connector, &url, at, each);
                }
                ProbeResult::Found { .. } | ProbeResult::Damaged(_)
                    if !self.damaged.contains(label) =>
                {
                    self.damaged.push(label.clone());
                }
                ProbeResult::Forbidden(_) => {
                    let address = format!("{} address {number}", protocol.name);
                    if !self.left_out.contains(&address) {
                        self.left_out.push(address);
                    }
                }
                _ => {}
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Finds the other drives of a line.
    fn scan_link(
        &mut self,
        connector: &Connector,
        url: &Url,
        at: usize,
        each: AttemptCallback<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let (port, mut flow) = (self.port.clone(), ControlFlow::Continue(()));
        let url = url.to_string();
        let first = *self.attempts[at].protocol.addresses.start();
        let numbers = first..=first + PASSES[PASSES.len() - 1].end as u32 - 1;
        let found = scan(connector, &url, numbers, &mut |step| {
            let label = format!("{url}, address {}", step.number);
            flow = each(&port, &label, at);
            flow
        })?;
        self.found.push(FoundLink { url, drives: found.found });
        Ok(flow)
    }

    fn scan_bus(
        &mut self,
        connector: &Connector,
        bus: &str,
        each: AttemptCallback<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let (port, mut flow) = (self.port.clone(), ControlFlow::Continue(()));
        let found = scan(connector, bus, ScanAddresses::ALL, &mut |step| {
            flow = each(&port, &format!("address {}", step.number), 0);
            flow
        });
        let found = match found {
            Ok(found) => found.found,
            Err(Error::Link(error)) => {
                self.error = Some(format!("{error}. {}", error.hint()));
                return Ok(ControlFlow::Continue(()));
            }
            Err(error) => return Err(error),
        };
        for drive in found {
            let url = format!("{}+socketcan://{}", drive.protocol, self.port);
            match self.found.iter_mut().find(|link| link.url == url) {
                Some(link) => link.drives.push(drive),
                None => self.found.push(FoundLink { url, drives: vec![drive] }),
            }
        }
        Ok(flow)
    }

    /// Attempts on the port, in words.
    fn tried_text(&self) -> String {
        if !self.buses.is_empty() {
            return self.buses.join(" and ");
        }
        let mut protocols: Vec<&str> = self.attempts.iter().map(|it| it.protocol.name).collect();
        protocols.sort_unstable();
        protocols.dedup();
        let rates = BAUD_RATES.map(|rate| rate.to_string()).join(", ");
        match self.asked {
            0 => String::new(),
            count => {
                let left_out = match &*self.left_out {
                    [] => String::new(),
                    own => format!(", without {} (the host's own)", own.join(", ")),
                };
                format!(
                    "{} at {rates} baud, {EVEN_PARITY} with even parity too, the first {count} addresses \
                     of each{left_out}",
                    protocols.join(", ")
                )
            }
        }
    }
}

fn named_ports(are_guests: bool, all: &[&ProtocolInfo], ranks: &[usize]) -> String {
    let of_kind = all.iter().zip(ranks).filter(|(_, rank)| (**rank > 0) == are_guests);
    of_kind.map(|(protocol, _)| protocol.name).collect::<Vec<_>>().join(",")
}

fn option_pair(name: &str, value: &str) -> (String, String) {
    (name.to_owned(), value.to_owned())
}

impl SearchReport {
    fn new(searches: Vec<PortSearch>, is_interrupted: bool) -> Self {
        let mut report = Self { is_interrupted, ..Self::default() };
        for search in searches {
            let tried = search.tried_text();
            let PortSearch { port, error, damaged, found, .. } = search;
            if found.is_empty() {
                report.silent.push(SilentPort { port, error, tried, damaged });
            }
            report.links.extend(found);
        }
        report
    }
}

#[cfg(test)]
mod tests {
    use super::PortSearch;

    #[test]
    fn an_address_that_was_left_out_is_not_called_asked() {
        let mut search = PortSearch::of_serial_port("/dev/ttyUSB0");
        search.asked = 32;
        assert!(search.tried_text().ends_with("the first 32 addresses of each"));
        search.left_out.push("tmcl address 2".to_owned());
        assert!(search.tried_text().ends_with("without tmcl address 2 (the host's own)"));
    }

    #[test]
    fn a_serial_port_is_asked_the_usual_way_first_and_never_twice_alike() {
        let search = PortSearch::of_serial_port("/dev/ttyUSB0");
        let urls: Vec<String> = search.attempts.iter().map(|it| it.url.to_string()).collect();
        let place = |url: &str| urls.iter().position(|it| it == url).expect(url);
        let factory = place("tmcl+serial:///dev/ttyUSB0:9600");
        let even = place("modbus-rtu+serial:///dev/ttyUSB0:19200?parity=even");
        let rare = place("modbus-rtu+serial:///dev/ttyUSB0:256000");
        assert!(factory < even && even < rare, "{urls:?}");
        let mut unique = urls.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(unique.len(), urls.len());
        for url in &urls {
            url.parse::<crate::url::Url>().expect(url);
        }
    }
}
