//! Finds drives, by reads only.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use polepair::scan::scan;
//! let connector = polepair::Connector::default();
//! let scan = scan(&connector, "sim:tmcl?axes=2&time=virtual", 1..=4, &mut |_| std::ops::ControlFlow::Continue(()))?;
//! assert_eq!(scan.found.iter().map(|f| f.number).collect::<Vec<_>>(), [1, 3]);
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod scanner;

pub use scanner::{AxisAnswer, DriveScanner};

use crate::axis::LocalAxis;
use crate::bus::{self, BusAddress};
use crate::connect::Connector;
pub use crate::detected_drive::DetectedDrive;
use crate::error::Error;
use crate::identification::Identification;
use crate::no_reply::{NoReplyDetails, Wiring};
use crate::protocol_line::ProtocolLine;
use crate::registry::SenderDetector;
use crate::url::{AxisNumber, LinkTarget, Url};
use crate::wire::{CountedLink, SharedLink};
use polepair_core::medium::{Can, Frame};
use polepair_core::profile::{Profile, Signal};
use polepair_core::proto::{sub_axis, with_sub_axis};
use polepair_link::{LinkError, LinkIo, Received, clock};
use std::ops::{ControlFlow, RangeInclusive};

/// Addresses that one scan tries at most on one wire.
const ADDRESSES_MAX: usize = 256;
/// Time that a scan listens on a CAN bus before it asks, and in which drives may answer the question that goes to all
/// of them, after the last that did.
const LISTEN_MS: u32 = 150;
const ANSWERS_MS: u32 = 250;
/// Requests that are sent in a row, and the pause after them: an adapter's queue holds about ten frames, which take
/// 13 ms at 125 kbit/s.
const BURST: usize = 8;
const BURST_PAUSE_MS: u32 = 15;
/// Times that a silent address is asked among all: one request may be lost on a bus with other traffic.
const ROUNDS: usize = 2;
/// Frames that a scan listens to at most.
const FRAMES_MAX: usize = 20_000;

/// Interval at which a listening scan checks for cancellation.
const POLL_MS: u32 = 10;

/// Attempts and results of a scan.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct ScanReport {
    /// Attempts, in words: link, protocol, line, addresses.
    pub tried: Vec<String>,
    /// Drives that answered, by address.
    pub found: Vec<DetectedDrive>,
    /// Axes that the link has already, where it was open: whether they answer.
    pub axes: Vec<AxisAnswer>,
    /// Addresses that were not asked any more because the scan was broken off.
    pub not_queried: usize,
    /// Frames received from silent addresses.
    pub received: NoReplyDetails,
    /// Kind of the wire.
    pub wiring: Wiring,
    /// A CANopen device without node-ID answered: [`LssMaster`](crate::lss::LssMaster) gives it one.
    /// Asked for where all addresses are.
    pub has_unconfigured: bool,
    /// Why the link went away before all were asked, if it did.
    pub link_error: Option<LinkError>,
}

impl DetectedDrive {
    /// One of which the profile is known without asking.
    pub(crate) fn with_known_profile(
        line: &ProtocolLine,
        number: u32,
        profile: &'static Profile,
    ) -> Self {
        let (protocol, identified) = (line.protocol.name, Identification::Named);
        let profile = line.protocol.profile_of_axis(profile, number);
        let (clash, ignores_address, details) = (None, false, Vec::new());
        Self { number, protocol, profile, identified, clash, ignores_address, details }
    }
}

impl ProtocolLine {
    /// The further axes of a found drive: as many as its profile has, else each that reports its state, up
    /// to the first that does not. A drive that also reports the state of an impossible axis ignores the
    /// axis number and has one axis.
    pub(crate) fn further_axes(&self, one: &DetectedDrive) -> Result<Vec<DetectedDrive>, Error> {
        let (first, last) = (*self.protocol.sub_axes.start(), *self.protocol.sub_axes.end());
        if first == last || sub_axis(one.number) != 0 {
            return Ok(Vec::new());
        }
        let known = one.profile.motors;
        debug_assert!(first <= last);
        let last = if known > 0 { first + known - 1 } else { last + 1 };
        let numbers = (first + 1..=last).map(|sub| with_sub_axis(one.number, sub));
        let found = |number: u32| DetectedDrive {
            number,
            identified: one.identified.clone(),
            ..DetectedDrive::with_known_profile(self, number, one.profile)
        };
        if known > 0 {
            return Ok(numbers.map(found).collect());
        }
        let Some(state) = signal_parameter(Signal::Enabled, one.profile)
            .or_else(|| signal_parameter(Signal::Position, one.profile))
        else {
            return Ok(Vec::new());
        };
        let drives: Vec<_> = numbers.map(|number| (one.profile, number)).collect();
        let axes = self.probe_axes(&drives, false)?;
        if let Some(axis) = axes.first() {
            axis.connection().with_axes(|axes, now| axes.handle_resume(now));
        }
        let answers: Vec<&LocalAxis> =
            // The axes of a module are numbered without gaps.
            axes.iter().take_while(|axis| axis.read(state).is_ok()).collect();
        // A module that accepts a number beyond its axes ignores it: its replies are no further axes.
        let looks_at_axis = answers.len() < axes.len();
        Ok(answers.iter().filter(|_| looks_at_axis).map(|axis| found(axis.number())).collect())
    }
}

fn signal_parameter(
    signal: Signal,
    one_profile: &Profile,
) -> Option<polepair_core::profile::ParameterId> {
    one_profile.signal(signal).map(|source| source.parameter)
}

/// Progress of a scan.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ScanProgress {
    /// The address that is asked now.
    pub number: u32,
    /// Addresses asked before.
    pub done: usize,
    /// Addresses in all.
    pub of: usize,
}

/// Tries every address of the link's protocol, or those of `numbers` if that is not empty. Only reads are
/// sent. `progress` is called before each address, and may cancel the scan; found drives are kept.
///
/// On a CAN bus it first listens for active senders. If the protocol has a request that every drive
/// answers, it is sent once instead of one for each address. Several protocols of a bus can be scanned one
/// after the other: `canopen,thruster+udp://…`. An address is skipped if a found drive would take the
/// request as a command.
///
/// # Errors
/// [`Error::Usage`] for an invalid connection string, [`Error::Link`] if it cannot be opened. Silence is
/// not an error. A link that is lost during the scan is in [`ScanReport::link_error`], with the drives
/// found before.
pub fn scan(
    connector: &Connector,
    url: &str,
    numbers: impl Into<ScanAddresses>,
    progress: &mut dyn FnMut(ScanProgress) -> ControlFlow<()>,
) -> Result<ScanReport, Error> {
    let urls = connector.protocol_urls(url)?;
    // All drives of a rack are there, whichever axes the string names.
    let rack = matches!(urls[0].target, LinkTarget::Sim { .. } | LinkTarget::Rack { .. });
    let axes = if rack { Vec::new() } else { urls[0].axes.clone() };
    let whole = urls
        .into_iter()
        .map(|url| if rack { Url { axes: Vec::new(), names: Vec::new(), ..url } } else { url });
    let (mut lines, _simulation) = connector.open_shared_lines(&whole.collect::<Vec<_>>())?;
    // Protocols whose requests another one's drives would obey come last, when those drives are known.
    bus::sort_guests_last(&mut lines, |line| &line.protocol);
    let mut scanner = DriveScanner::on_lines(connector, lines, axes, numbers.into());
    loop {
        match scan_step(&mut scanner, progress) {
            Ok(true) => {}
            Ok(false) => break,
            Err(Error::Link(lost)) => {
                scanner.set_link_lost(lost);
                break;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(scanner.finish())
}

/// Asks the next address; false when all were.
fn scan_step(
    scanner: &mut DriveScanner,
    progress: &mut dyn FnMut(ScanProgress) -> ControlFlow<()>,
) -> Result<bool, Error> {
    let Some(at) = scanner.next_address(&|| false)? else { return Ok(false) };
    match progress(at) {
        ControlFlow::Continue(()) => scanner.query_next(&|| false)?,
        ControlFlow::Break(()) => scanner.cancel(),
    }
    Ok(true)
}

/// Takes addresses out that a drive found before has an identifier of: a question there might be a
/// command to it.
fn exclude_clashing(
    line: &ProtocolLine,
    seats: &[(usize, BusAddress)],
    wanted: &mut Vec<u32>,
    tried: &mut Vec<String>,
) {
    for (_, bus_address) in seats.iter().filter(|(wire, bus_address)| {
        *wire == line.wire && bus_address.protocol.name != line.protocol.name
    }) {
        let left: Vec<(u32, u32)> = wanted
            .iter()
            .filter_map(|number| {
                line.bus_address(*number)
                    .shared_identifier(bus_address)
                    .map(|(id, _)| (*number, id))
            })
            .collect();
        let (Some((first, id)), Some((last, _))) = (left.first(), left.last()) else { continue };
        // Left out before a byte is sent: the read of one protocol is a motion command of the other (thruster
        // on PDO2).
        wanted.retain(|number| left.iter().all(|(other, _)| other != number));
        let (name, other) = (line.protocol.name, bus_address.label());
        let addresses = if first == last {
            format!("{first}")
        } else {
            format!("{} addresses from {first} to {last}", left.len())
        };
        tried.push(format!(
            "not {name} {addresses}: {other} is there and has the identifier {id:X}h too, so a \
             read would be a command to it; a {name} drive there clashes with it"
        ));
    }
}

/// Notes with each drive which other has an identifier of its, also of those that were known.
fn mark_clashes(
    seats: &[(usize, BusAddress)],
    known: &[(usize, BusAddress)],
    found: &mut [DetectedDrive],
) {
    for (n, (wire, bus_address)) in seats.iter().enumerate() {
        let others = seats.iter().enumerate().filter(|(other, _)| *other != n);
        let others = others.map(|(_, other)| other).chain(known);
        for (_, other) in others.filter(|(other, _)| other == wire) {
            let Some((id, extended)) = bus_address.shared_identifier(other) else { continue };
            let what = if extended {
                "the 29-bit identifiers".to_owned()
            } else {
                format!("the identifier {id:X}h")
            };
            let why = format!(
                "{} and {} both use {what}: give one of them another address",
                bus_address.label(),
                other.label()
            );
            found[n].clash.get_or_insert(why);
        }
    }
}

/// Usual addresses of drives, the lowest and highest first, because they are factory settings.
pub(crate) fn default_addresses(line: &ProtocolLine) -> Result<Vec<u32>, Error> {
    let every = line.protocol.addresses.clone().take(ADDRESSES_MAX).collect();
    let mut wanted = addresses_to_query(line, every, true, &mut Vec::new(), &|| false)?;
    if let Some(last) = wanted.pop() {
        // The last address is where several makers' drives are before they are set up, so it comes early.
        wanted.insert(wanted.len().min(1), last);
    }
    Ok(wanted)
}

/// Returns whether [`default_addresses`] asks all drives of the line before it waits for an answer.
pub(crate) fn asks_at_once(line: &ProtocolLine) -> bool {
    let detector = SenderDetector::new(line.protocol.name, line.options);
    let first = *line.protocol.addresses.start();
    matches!(line.link, SharedLink::Can(_))
        && (detector.question.is_some() || detector.presence_frame(first).is_some())
}

/// The addresses to try, with active senders if `every` address may be tried, and a text about them.
fn addresses_to_query(
    line: &ProtocolLine,
    mut wanted: Vec<u32>,
    every: bool,
    tried: &mut Vec<String>,
    broken: &dyn Fn() -> bool,
) -> Result<Vec<u32>, Error> {
    let (name, protocol) = (line.link.describe(), line.protocol.name);
    let rate = match (&line.link, line.options.baud, line.options.bit_rate) {
        (SharedLink::Serial(_), 0, _) | (SharedLink::Can(_), _, 0) => String::new(),
        (SharedLink::Serial(_), baud, _) => format!(" at {baud} baud"),
        (SharedLink::Can(_), _, rate) => format!(" at {rate} bit/s"),
    };
    wanted.retain(|number| line.options.is_distinct_address(*number));
    let (Some(&first), Some(&last)) = (wanted.first(), wanted.last()) else {
        tried.push(format!("not {protocol} on {name}: no drive can have such an address on it"));
        return Ok(wanted);
    };
    if wanted.len() > 1 && line.ignores_addresses()? {
        tried.push(format!(
            "{protocol} on {name}: it answers at every address, so at {first} alone; `#N` names others"
        ));
        return Ok(vec![first]);
    }
    let mut text = format!("addresses {first} to {last}");
    if let SharedLink::Can(link) = &line.link {
        let listener = SenderDetector::new(protocol, line.options);
        // Listening first costs nothing and finds drives that send by themselves.
        let mut received = listen_for_senders(link, &listener, LISTEN_MS, broken)?;
        if let Some(question) = listener.question.as_ref().filter(|_| !broken()) {
            link.send(question)?;
            let answers_ms = clock::scaled_ms(ANSWERS_MS);
            received.extend(listen_for_senders(link, &listener, answers_ms, broken)?);
            wanted.retain(|number| received.contains(number));
            text.push_str(", all with one request");
        } else if wanted.len() > 1 && listener.presence_frame(first).is_some() {
            let present = find_present(link, &listener, &wanted, broken)?;
            if present.is_empty() {
                // The questions to these two show what happens on a bus where no drive answers.
                wanted = vec![first, last];
            } else {
                wanted.retain(|number| present.contains(number));
            }
            text.push_str(", all at once");
        }
        // Only a search of all addresses takes in what it did not ask for.
        received.retain(|number| every && !wanted.contains(number));
        wanted.extend(received);
        wanted.sort_unstable();
        wanted.dedup();
    }
    tried.push(format!("{protocol} on {name}{rate}, {text}"));
    Ok(wanted)
}

/// The addresses whose drives answer, asked without a wait between them.
fn find_present(
    link: &CountedLink<Can>,
    listener: &SenderDetector,
    wanted: &[u32],
    broken: &dyn Fn() -> bool,
) -> Result<Vec<u32>, Error> {
    let mut present = Vec::new();
    for _ in 0..ROUNDS {
        let silent: Vec<u32> = wanted.iter().filter(|n| !present.contains(*n)).copied().collect();
        for burst in silent.chunks(BURST) {
            for question in burst.iter().filter_map(|number| listener.presence_frame(*number)) {
                link.send(&question)?;
            }
            let pause_ms = clock::scaled_ms(BURST_PAUSE_MS);
            present.extend(listen_for_senders(link, listener, pause_ms, broken)?);
        }
        let answers_ms = clock::scaled_ms(ANSWERS_MS);
        present.extend(listen_for_senders(link, listener, answers_ms, broken)?);
        if broken() {
            break;
        }
    }
    Ok(present)
}

/// Active senders, until no new one appears for a time.
fn listen_for_senders(
    link: &CountedLink<Can>,
    listener: &SenderDetector,
    ms: u32,
    broken: &dyn Fn() -> bool,
) -> Result<Vec<u32>, Error> {
    let (mut received, mut frame) = (Vec::new(), Frame::default());
    let mut until = link.now().plus_ms(ms);
    for _ in 0..FRAMES_MAX {
        let now = link.now();
        if broken() {
            break;
        }
        match link.receive(&mut frame, until.min(now.plus_ms(POLL_MS)))? {
            Received::TimedOut if now >= until => break,
            Received::Bytes { at, .. } => {
                if let Some(number) = listener.sender(&frame).filter(|n| !received.contains(n)) {
                    received.push(number);
                    // A node that answers late in the window is followed by others.
                    until = until.max(at.plus_ms(ms));
                }
            }
            Received::Line { .. } | Received::Woken | Received::TimedOut => {}
        }
    }
    Ok(received)
}

/// Addresses that a scan asks.
#[derive(Clone, Debug, Default)]
pub struct ScanAddresses(Option<RangeInclusive<u32>>);

impl ScanAddresses {
    /// Every address of the protocol, or those that the connection string names.
    pub const ALL: Self = Self(None);
}

impl ScanAddresses {
    /// The addresses that are possible on a line, or the given ones.
    fn on_line(&self, line: &ProtocolLine, named: &[u32]) -> Vec<u32> {
        match &self.0 {
            // A driver takes a byte of it: 261 would ask the drive at 5.
            Some(range) => {
                let every = &line.protocol.all_addresses;
                let (first, last) =
                    (range.start().max(every.start()), range.end().min(every.end()));
                (*first..=*last)
                    .filter(|number| line.protocol.check_address(*number).is_ok())
                    .take(ADDRESSES_MAX)
                    .collect()
            }
            None if named.is_empty() => {
                line.protocol.addresses.clone().take(ADDRESSES_MAX).collect()
            }
            None => named.iter().copied().filter(|axis| !AxisNumber(*axis).is_group()).collect(),
        }
    }
}

impl From<RangeInclusive<u32>> for ScanAddresses {
    fn from(range: RangeInclusive<u32>) -> Self {
        Self(Some(range))
    }
}
