//! A scan that proceeds address by address, on its own link or between the requests of an open link.

use super::{
    ScanAddresses, ScanProgress, ScanReport, addresses_to_query, exclude_clashing, mark_clashes,
};
use crate::axis::LocalAxis;
use crate::bus::{self, BusAddress};
use crate::connect::{AnyBorrowedLink, Connector, LineConfig, LocalLink};
use crate::detected_drive::DetectedDrive;
use crate::duplicate_address::{duplicate_address_text, stray_answers_text};
use crate::error::Error;
use crate::identification::Identification;
use crate::identify::{ProbeResult, Prober, is_answer};
use crate::lss::{self, LssMaster};
use crate::no_reply::{ACKNOWLEDGES, NoReplyCause, NoReplyDetails};
use crate::protocol_line::ProtocolLine;
use crate::url::AxisNumber;
use polepair_core::profile::{Access, ParameterId, Profile};
use polepair_core::station::Counters;
use polepair_link::{Connection, LinkError};
use std::collections::VecDeque;

/// Addresses that one drive answers, after which it answers whatever is asked.
const MISADDRESSED_MIN: usize = 2;

/// A look for drives, one address after the other. Only reads are sent.
///
/// On an open link its axes are distinguished from new drives: they are asked as usual, and only for a reply. Before
/// each other address the scan waits until no other request is active on the link, and between two addresses other
/// requests go first. So a request waits for one address at most; and if `broken` returns true, for one question.
///
/// ```
/// # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
/// use polepair::scan::DriveScanner;
/// let connector = polepair::Connector::default();
/// let link = connector.connect_local("sim:tmcl?axes=3&time=virtual#1")?;
/// let mut look = DriveScanner::on_link(&connector, &link, 0, 1..=5)?;
/// while look.next_address(&|| false)?.is_some() {
///     look.query_next(&|| false)?;
/// }
/// let scan = look.finish();
/// assert!(scan.axes[0].answers);
/// let link = link.add_drives(0, &scan.found)?;
/// assert_eq!(link.axes().iter().map(|axis| axis.number()).collect::<Vec<_>>(), [1, 3, 4]);
/// # }
/// # Ok::<(), polepair::Error>(())
/// ```
#[derive(Debug)]
pub struct DriveScanner {
    connector: Connector,
    /// Targets in their order.
    targets: Vec<ScanTarget>,
    addresses: ScanAddresses,
    /// The addresses that a connection string names.
    named_axes: Vec<u32>,
    known_axes: Vec<KnownAxis>,
    /// Index of the present target, and whether it began.
    current: usize,
    started: bool,
    queue: VecDeque<u32>,
    done: usize,
    damaged: Vec<u32>,
    /// Frames received from silent addresses of the present protocol.
    received: NoReplyDetails,
    /// Addresses of the line that were asked in vain, and those among them that another drive answered.
    unanswered: usize,
    misaddressed: usize,
    acknowledged: u16,
    /// Drives that were found on the lines before.
    found_before: usize,
    /// Addresses of each found drive.
    found_addresses: Vec<(usize, BusAddress)>,
    report: ScanReport,
}

/// One protocol on one wire.
enum ScanTarget {
    /// On a line that is this look's alone.
    OwnLine(Box<ProtocolLine>),
    /// On an open link.
    OpenLink(Box<LineConfig>, Connection),
}

/// An axis that is there already.
#[derive(Debug)]
struct KnownAxis {
    index: usize,
    axis: LocalAxis,
    bus_address: (usize, BusAddress),
}

/// True if an axis that the link has answered.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct AxisAnswer {
    /// Index in [`LocalLink::axes`].
    pub index: usize,
    /// Address of the axis.
    pub number: u32,
    /// True if it replied.
    pub answers: bool,
    /// Set when more came back than was asked for: another drive may have its address.
    pub clash: Option<String>,
}

impl std::fmt::Debug for ScanTarget {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::OwnLine(line) => line.protocol.name,
            Self::OpenLink(line_config, _) => line_config.protocol.name,
        })
    }
}

impl ScanTarget {
    fn protocol_name(&self) -> &'static str {
        match self {
            Self::OwnLine(line) => line.protocol.name,
            Self::OpenLink(line_config, _) => line_config.protocol.name,
        }
    }

    /// The line, and what keeps others from it meanwhile.
    fn open_line(&self) -> Result<(ProtocolLine, Option<AnyBorrowedLink>), Error> {
        match self {
            Self::OwnLine(line) => Ok((ProtocolLine::clone(line), None)),
            Self::OpenLink(line_config, connection) => {
                let borrowed = AnyBorrowedLink::borrow(connection, line_config.protocol.medium)?;
                Ok((line_config.on_link(borrowed.link()), Some(borrowed)))
            }
        }
    }
}

impl DriveScanner {
    /// On lines that were opened for it; of their addresses those in `axes`, unless there are none.
    pub(super) fn on_lines(
        connector: &Connector,
        lines: Vec<ProtocolLine>,
        axes: Vec<u32>,
        numbers: ScanAddresses,
    ) -> Self {
        let requests = lines.into_iter().map(|line| ScanTarget::OwnLine(Box::new(line))).collect();
        Self::new(connector, requests, axes, numbers)
    }

    /// On one wire of an open link, for every protocol that is spoken there. Without `numbers` every
    /// address is asked, whichever the link was opened with.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212` for a wire that there is not.
    pub fn on_link(
        connector: &Connector,
        link: &LocalLink,
        wire: usize,
        numbers: impl Into<ScanAddresses>,
    ) -> Result<Self, Error> {
        let mut stored = link.line_configs_on(wire)?.to_vec();
        bus::sort_guests_last(&mut stored, |line_config| &line_config.protocol);
        let axes = link.axes_on(wire);
        let known = axes.iter().filter(|(_, axis)| !AxisNumber(axis.number()).is_group());
        let known = known.filter_map(|(position, axis)| {
            let info = &stored
                .iter()
                .find(|line_config| line_config.protocol.name == axis.protocol())?
                .protocol;
            let entry = BusAddress { protocol: info.clone(), address: axis.number() };
            Some(KnownAxis {
                index: *position,
                axis: LocalAxis::clone(axis),
                bus_address: (0, entry),
            })
        });
        let known = known.collect();
        let connection = axes.first().map(|(_, axis)| axis.connection().clone());
        let connection = connection.ok_or_else(|| Error::usage("E212", "no axis replied", ""))?;
        let requests = stored.into_iter().map(|line_config| {
            ScanTarget::OpenLink(Box::new(line_config.with_single_wire()), connection.clone())
        });
        let scanner = Self::new(connector, requests.collect(), Vec::new(), numbers.into());
        Ok(Self { known_axes: known, ..scanner })
    }

    fn new(
        connector: &Connector,
        targets: Vec<ScanTarget>,
        named_axes: Vec<u32>,
        addresses: ScanAddresses,
    ) -> Self {
        Self {
            connector: connector.clone(),
            targets,
            addresses,
            named_axes,
            known_axes: Vec::new(),
            current: 0,
            started: false,
            queue: VecDeque::new(),
            done: 0,
            damaged: Vec::new(),
            received: NoReplyDetails::default(),
            unanswered: 0,
            misaddressed: 0,
            acknowledged: 0,
            found_before: 0,
            found_addresses: Vec::new(),
            report: ScanReport::default(),
        }
    }

    /// The next address of [`query_next`](Self::query_next); `None` at the end. On a CAN bus this may first
    /// listen, until `broken` returns true.
    ///
    /// # Errors
    /// [`Error::Link`] if the link is lost, [`Error::Usage`] `E220` if other requests never leave the link
    /// free.
    pub fn next_address(
        &mut self,
        broken: &dyn Fn() -> bool,
    ) -> Result<Option<ScanProgress>, Error> {
        loop {
            if let Some(&number) = self.queue.front() {
                let (done, of) = (self.done, self.done + self.queue.len());
                return Ok(Some(ScanProgress { number, done, of }));
            }
            if std::mem::take(&mut self.started) {
                self.report_damaged();
                self.current += 1;
            }
            if self.current >= self.targets.len() {
                return Ok(None);
            }
            self.begin_target(broken)?;
        }
    }

    /// Determines the addresses of the next protocol.
    fn begin_target(&mut self, broken: &dyn Fn() -> bool) -> Result<(), Error> {
        let (line, borrowed) = self.targets[self.current].open_line()?;
        let mut numbers = self.addresses.on_line(&line, &self.named_axes);
        let every = self.addresses.0.is_none() && self.named_axes.is_empty();
        let known = self.known_axes.iter().map(|known| &known.bus_address);
        let own: Vec<u32> = known
            .clone()
            .filter(|(_, bus_address)| bus_address.protocol.name == line.protocol.name)
            .filter(|(_, bus_address)| every || numbers.contains(&bus_address.address))
            .map(|(_, bus_address)| bus_address.address)
            .collect();
        let seats: Vec<(usize, BusAddress)> = known.chain(&self.found_addresses).cloned().collect();
        self.report.wiring = line.wiring();
        let tried = &mut self.report.tried;
        // Before the first request: all addresses may be asked at once.
        exclude_clashing(&line, &seats, &mut numbers, tried);
        let mut wanted = addresses_to_query(&line, numbers, every, tried, broken)?;
        // An axis that was silent for a moment is asked all the same at its address.
        if !own.is_empty() {
            wanted.extend(own);
            wanted.sort_unstable();
            wanted.dedup();
        }
        exclude_clashing(&line, &seats, &mut wanted, tried);
        if every && line.protocol.name == lss::PROTOCOL && !broken() {
            self.report.has_unconfigured |= LssMaster::on_line(&line, 1..=1)?.has_unconfigured()?;
        }
        // The link goes back before the caller is asked, who may wait for a person.
        drop((line, borrowed));
        (self.queue, self.done, self.started) = (wanted.into(), 0, true);
        self.found_before = self.report.found.len();
        Ok(())
    }

    /// Tries the next address. If `broken` returns true in between, the scan of this address ends.
    ///
    /// # Errors
    /// As [`next_address`](Self::next_address). Silence is not an error.
    pub fn query_next(&mut self, broken: &dyn Fn() -> bool) -> Result<(), Error> {
        let Some(&number) = self.queue.front() else { return Ok(()) };
        let name = self.targets[self.current].protocol_name();
        let its =
            |known: &&KnownAxis| known.axis.number() == number && known.axis.protocol() == name;
        match self.known_axes.iter().find(its) {
            Some(known) => self.report.axes.extend(known.check_answer()),
            None => self.probe_address(number, broken)?,
        }
        // Not before: a failure above leaves the address in the queue, and in the count of those not asked.
        if self.queue.pop_front().is_some() {
            self.done += 1;
        }
        Ok(())
    }

    fn probe_address(&mut self, number: u32, broken: &dyn Fn() -> bool) -> Result<(), Error> {
        let scan_target = &self.targets[self.current];
        let (line, borrowed) = scan_target.open_line()?;
        let prober = Prober::new(&line, &self.connector.config).scanning().with_cancel(broken);
        let probe = prober.probe(number)?;
        let (mut details, mut further) = (Vec::new(), Vec::new());
        if let ProbeResult::Found { profile, identified, doubtful: false, .. } = &probe
            && !broken()
        {
            details = line.read_details(number, profile);
            further = line.further_axes(&DetectedDrive {
                identified: identified.clone(),
                ..DetectedDrive::with_known_profile(&line, number, profile)
            })?;
        }
        // Given back before the connection is asked about its link.
        drop(borrowed);
        if let ScanTarget::OpenLink(_, connection) = scan_target
            && let Some(trouble) = connection.link_error()
        {
            return Err(trouble.into());
        }
        match probe {
            ProbeResult::Silent(_) if broken() => self.cancel(),
            ProbeResult::Silent(details) => self.record_unanswered(details),
            ProbeResult::Damaged(details) if details.misaddressed > 0 => {
                self.record_unanswered(details);
            }
            ProbeResult::Damaged(_) => self.damaged.push(number),
            ProbeResult::Forbidden(hint) => {
                self.report.tried.push(format!("all addresses except {number}: {hint}"));
            }
            ProbeResult::AnsweredTwice => {
                let text = duplicate_address_text(line.protocol.name, number);
                let generic = (line.protocol.generic, Identification::Generic { nearest: None });
                self.record_found(&line, number, generic, Some(text));
            }
            ProbeResult::Found { profile, identified, stray, .. } => {
                let clash = stray_answers_text(stray);
                self.record_found(&line, number, (profile, identified), clash);
                if let Some(found) = self.report.found.last_mut() {
                    found.details = details;
                }
                for axis in further {
                    self.found_addresses.push((line.wire, line.bus_address(axis.number)));
                    self.report.found.push(axis);
                }
            }
        }
        Ok(())
    }

    fn record_found(
        &mut self,
        line: &ProtocolLine,
        number: u32,
        identity: (&'static Profile, Identification),
        clash: Option<String>,
    ) {
        let (profile, identified) = identity;

        let found = DetectedDrive::with_known_profile(line, number, profile);
        self.report.found.push(DetectedDrive { identified, clash, ..found });
        self.found_addresses.push((line.wire, line.bus_address(number)));
    }

    /// Notes a drive that answers whatever address is asked, as modules on USB do: the only one of its line, and
    /// each other address was answered in its name.
    fn note_ignored_address(&mut self) -> bool {
        let (unanswered, misaddressed) =
            (std::mem::take(&mut self.unanswered), std::mem::take(&mut self.misaddressed));
        let found = &mut self.report.found[self.found_before..];
        match found {
            [only] if misaddressed >= MISADDRESSED_MIN && misaddressed == unanswered => {
                // One drive at one address and its reply to every other request: its address is not looked at.
                only.ignores_address = true;
                true
            }
            _ => false,
        }
    }

    /// Records frames that were received from a silent address.
    fn record_unanswered(&mut self, details: NoReplyDetails) {
        self.unanswered += 1;
        self.misaddressed += usize::from(details.misaddressed > 0);
        self.received = self.received.plus(details.only_foreign());
        self.acknowledged = self.acknowledged.saturating_add(details.acknowledged);
    }

    fn report_damaged(&mut self) {
        let mut details = std::mem::take(&mut self.received);
        let acknowledged = std::mem::take(&mut self.acknowledged);
        if acknowledged > 0 && self.report.found.len() == self.found_before {
            // The drive at the cable acknowledges requests to others, so it is one that was not asked.
            details.acknowledged = acknowledged;
        }
        if self.note_ignored_address() {
            details = NoReplyDetails::default();
        }
        if !details.is_nothing() {
            let hint = match details.cause() {
                NoReplyCause::Acknowledged => ACKNOWLEDGES.into(),
                _ => details.hint(),
            };
            self.report.received = self.report.received.plus(details);
            self.report.tried.push(format!(
                "addresses without a reply, although frames arrived ({details}): {hint}"
            ));
        }
        let damaged = std::mem::take(&mut self.damaged);
        if let (Some(first), Some(last)) = (damaged.first(), damaged.last()) {
            self.report.tried.push(format!(
                "{} addresses from {first} to {last} with damaged replies only: two drives \
                 with one address, noise, or another baud rate?",
                damaged.len()
            ));
        }
    }

    /// Ends the scan: the drives found so far are kept.
    pub fn cancel(&mut self) {
        // What was not asked is reported as such, and never as free.
        self.report.not_queried = self.queue.len();
        self.queue.clear();
        self.targets.truncate(self.current + usize::from(self.started));
    }

    /// Ends the scan after a lost link: found drives are kept, the others count as not tried, with the
    /// present address.
    pub(super) fn set_link_lost(&mut self, error: LinkError) {
        let rest = self.targets.iter().skip(self.current + usize::from(self.started)).filter_map(
            |scan_target| {
                let line = scan_target.open_line().ok()?.0;
                Some(self.addresses.on_line(&line, &self.named_axes).len())
            },
        );
        let rest: usize = rest.sum();
        // The rest is counted before the queue is emptied.
        self.cancel();
        self.report.not_queried += rest;
        self.report.link_error = Some(error);
    }

    /// Attempts and results.
    #[must_use]
    pub fn finish(mut self) -> ScanReport {
        if self.started {
            self.report_damaged();
        }
        let known: Vec<_> = self.known_axes.iter().map(|known| known.bus_address.clone()).collect();
        mark_clashes(&self.found_addresses, &known, &mut self.report.found);
        self.report
    }
}

impl KnownAxis {
    /// Asks the axis for something as always. `None` where it has nothing that can be asked for.
    fn check_answer(&self) -> Option<AxisAnswer> {
        let profile = self.axis.profile();
        let signal_parameters = profile.signals.iter().map(|source| source.parameter);
        let all = (0..).map(ParameterId).take(profile.parameters.len());
        let id = signal_parameters.chain(all).find(|id| {
            profile.parameter(*id).is_some_and(|parameter| parameter.access != Access::Write)
        })?;
        // Frames that belong to no request during this one read: a second drive with the address.
        let before = self.session_counters();
        let answers = match self.axis.read(id) {
            Ok(_) => true,
            Err(Error::Failed { outcome, .. }) => is_answer(outcome),
            Err(_) => false,
        };
        let clash = stray_answers_text(self.session_counters().since(before).unaccounted());
        let clash = clash.filter(|_| answers);
        Some(AxisAnswer { index: self.index, number: self.axis.number(), answers, clash })
    }

    fn session_counters(&self) -> Counters {
        self.axis.connection().with_axes(|axes, _| axes.counters())
    }
}
