//! Opens links and identifies their drives.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let link = polepair::connect_local("sim:tmcl?time=virtual")?;
//! let axis = link.axis(1)?;
//! println!("{}, {}", axis.profile().title, axis.identified());
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod external_link;
mod identification;
mod line_config;
mod link_parts;
mod options;
mod profile_choice;
mod protocols;
mod rack;
mod readdress;
mod taps;

use crate::axis::{LocalAxis, StopOptions, stop_axes};
use crate::config::Config;
use crate::error::Error;
use crate::identification::Identification;
use crate::mounting::ResolvedMounting;
use crate::protocol_line::{ProtocolLine, RackEntry};
use crate::registry::ProtocolInfo;
use crate::simulate::{self, RackDescription, Simulation, SimulationPace};
use crate::toml_file::FileError;
use crate::url::{AxisNumber, LinkTarget, Url};
use crate::wire::{AnyLink, OpenWire, SentCounter, SharedLink};
pub(crate) use line_config::{AnyBorrowedLink, LineConfig};
pub use link_parts::LinkPart;
use options::{rate_key, serial_line, wire_options};
use polepair_core::convert::saturating;
use polepair_core::medium::CanLine;
use polepair_core::profile::Profile;
use polepair_core::proto::{HostOptions, drive_address};
use polepair_core::station::{AxisIndex, Counters};
use polepair_link::{Connection, Interrupter};
use rack::{identify_expected, seed_of};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use taps::{LinkWrapper, TapFactory};

/// Opens a wire or simulated drives with the configuration that is found from the working folder upward.
/// [`connect`](fn@crate::connect) also opens a running gateway.
///
/// # Errors
/// [`Error::Usage`] for a wrong connection string, [`Error::Link`] when it cannot be opened,
/// [`Error::Failed`] when an axis that it names does not answer.
pub fn connect_local(url: &str) -> Result<LocalLink, Error> {
    Connector::discover().connect_local(url)
}

/// Opens links, with names, profiles and taps.
#[derive(Clone, Debug, Default)]
pub struct Connector {
    /// Named links and users' profiles.
    pub config: Config,
    tap_factory: Option<TapFactory>,
    link_wrapper: Option<LinkWrapper>,
    is_for_stop: bool,
    /// Files that were wrong and could be done without.
    ignored_files: Arc<Mutex<Vec<FileError>>>,
    /// Peculiarities of the data sheets that were read.
    sheet_warnings: Arc<Mutex<Vec<FileError>>>,
    sent_counter: SentCounter,
}

impl Connector {
    /// With the configuration that is found from the working folder upward: see
    /// [`Config::broken`] for its faults.
    #[must_use]
    pub fn discover() -> Self {
        Self { config: Config::discover(), ..Self::default() }
    }

    /// With a user's profile file besides.
    ///
    /// # Errors
    /// [`Error::File`] with file, line, column and reason.
    pub fn with_profile(mut self, file: &Path) -> Result<Self, Error> {
        self.config.add_profile(file)?;
        self.keep_sheet_warnings(file);
        Ok(self)
    }

    /// Counter of the sent frames on every link that this connector, or a clone of it, opens.
    #[must_use]
    pub fn sent_counter(&self) -> SentCounter {
        self.sent_counter.clone()
    }

    /// The connection string with its name, if it is one, looked up.
    ///
    /// # Errors
    /// [`Error::Usage`].
    pub fn url(&self, text: &str) -> Result<Url, Error> {
        Url::parse_with(&self.config.expand(text)?, self.is_for_stop)
    }

    /// The connection strings of each protocol that a scan is to ask on one link:
    /// `canopen,thruster+udp://…`.
    pub(crate) fn protocol_urls(&self, text: &str) -> Result<Vec<Url>, Error> {
        let text = self.config.expand(text)?;
        let (head, rest) = text.split_at(text.find("://").unwrap_or(0));
        let (words, link) = head.split_at(head.find('+').unwrap_or(head.len()));
        if !words.contains(',') {
            return Ok(vec![Url::parse_with(&text, self.is_for_stop)?]);
        }
        let words: Vec<&str> = words.split(',').map(str::trim).collect();
        words
            .iter()
            .map(|word| Url::parse_among(&format!("{word}{link}{rest}"), &words, self.is_for_stop))
            .collect()
    }

    /// Opens the link of several protocols, once.
    pub(crate) fn open_shared_lines(
        &self,
        urls: &[Url],
    ) -> Result<(Vec<ProtocolLine>, Option<Simulation>), Error> {
        let [first, others @ ..] = urls else { return Ok((Vec::new(), None)) };
        // The link is opened once; the protocols after the first share it.
        let (mut lines, simulation) = self.open_lines(first)?;
        for url in others {
            let link = lines[0].link.clone();
            let adapter =
                matches!(url.target, LinkTarget::Slcan { .. } | LinkTarget::SlcanTcp { .. });
            let what = match (&link, adapter && url.key("bitrate").is_none()) {
                (SharedLink::Serial(_), _) => "a serial line carries one protocol",
                (_, true) => "the protocols have different factory bit rates: add `bitrate=`",
                _ if lines.iter().any(|line| line.protocol.name == url.protocol) => {
                    "a protocol is given twice"
                }
                _ => {
                    lines.push(self.open_line(url, Some(link))?);
                    continue;
                }
            };
            return Err(Error::usage("E210", what, ""));
        }
        Ok((lines, simulation))
    }

    /// Opens a wire or simulated drives, and identifies the drives.
    ///
    /// # Errors
    /// As [`connect_local`].
    pub fn connect_local(&self, text: &str) -> Result<LocalLink, Error> {
        self.connect_with(text, true)
    }

    /// Opens a link; without `must_ask` the drives are taken from the string or the rack, so that a silent one causes
    /// no delay.
    pub(crate) fn connect_with(&self, text: &str, must_ask: bool) -> Result<LocalLink, Error> {
        let url = self.url(text)?;
        let (lines, simulation) = self.open_lines(&url)?;
        self.assemble_link(url, &lines, simulation, must_ask)
    }

    /// The axes that are on opened lines.
    fn assemble_link(
        &self,
        url: Url,
        lines: &[ProtocolLine],
        simulation: Option<Simulation>,
        must_ask: bool,
    ) -> Result<LocalLink, Error> {
        let (mut axes, mut wires, mut stored) = (Vec::new(), Vec::new(), Vec::new());
        for lines in lines.chunk_by(|one, other| one.wire == other.wire) {
            let its = self.open_axes(&url, lines, simulation.as_ref(), must_ask)?;
            let connection = its.first().map(|axis| axis.connection.clone());
            stored.push((connection, lines.iter().map(ProtocolLine::to_config).collect()));
            axes.extend(its);
            wires.extend(ProtocolLine::open_wire(lines));
        }
        // After all are open: an axis of a later wire would otherwise miss its heartbeat during these reads.
        axes.iter().try_for_each(LocalAxis::read_optional_scales)?;
        let link = LocalLink { url, axes, wires, line_configs: stored, simulation };
        // A misspelt name is found here, before any command.
        link.url.names.iter().try_for_each(|name| link.axis_named(name).map(drop))?;
        Ok(link)
    }

    /// Opens what the string names, without asking anybody anything.
    pub(crate) fn open_lines(
        &self,
        url: &Url,
    ) -> Result<(Vec<ProtocolLine>, Option<Simulation>), Error> {
        match &url.target {
            LinkTarget::Sim { what } => {
                self.open_simulated(url, describe_rack(url, what, seed_of(url)?)?, None)
            }
            LinkTarget::Rack { file } => self.open_rack(url, file),
            _ => Ok((vec![self.open_line(url, None)?], None)),
        }
    }

    /// One protocol on a link, which is opened unless it is already.
    fn open_line(&self, url: &Url, opened: Option<SharedLink>) -> Result<ProtocolLine, Error> {
        let info = url.protocol_info()?;
        url.axes.iter().try_for_each(|axis| info.check_address(*axis))?;
        let url = &self.with_factory_line(url, &info);
        let mut options = wire_options(url, &info)?;
        // The host's usual address may be that of a named drive.
        options.host_address = options.host_address.or_else(|| info.alternative_host(&url.axes));
        let link = match opened {
            Some(link) => link,
            None => self.wrap_and_tap(0, open(url, &info, &options)?, None),
        };
        let numbers =
            // Without a number the first address, where a drive from the factory answers.
            if url.axes.is_empty() { vec![*info.addresses.start()] } else { url.axes.clone() };
        let seats = vec![RackEntry::default(); numbers.len()];
        let first = url.axes.iter().find(|axis| !AxisNumber(**axis).is_group());
        // On a serial line the first named drive is taken for the one at the cable.
        options.relay_axis = options.relay_axis.or(first.copied());
        let all = Arc::default();
        Ok(ProtocolLine {
            wire: 0,
            link,
            protocol: info,
            options,
            axis_numbers: numbers,
            entries: seats,
            rack_entries: all,
        })
    }

    /// The axes of one wire, on one connection: a line for each protocol that is spoken on it.
    fn open_axes(
        &self,
        url: &Url,
        lines: &[ProtocolLine],
        simulation: Option<&Simulation>,
        must_ask: bool,
    ) -> Result<Vec<LocalAxis>, Error> {
        // All are identified before the connection is built, because a lane takes its profiles once.
        let found: Vec<Vec<(&'static Profile, Identification)>> = lines
            .iter()
            .map(|line| self.identify_axes(url, line, must_ask))
            .collect::<Result<_, _>>()?;
        let profiles: Vec<Vec<(&'static Profile, u32)>> = lines
            .iter()
            .zip(&found)
            .map(|(line, found)| {
                found.iter().map(|one| one.0).zip(line.axis_numbers.iter().copied())
            })
            .map(Iterator::collect)
            .collect();
        debug_assert_eq!(lines.len(), profiles.len());
        let connection = ProtocolLine::open_shared_connection(lines, &profiles)?;
        let mut axes = Vec::new();
        for (line, found) in lines.iter().zip(found) {
            for (n, (profile, identified)) in found.into_iter().enumerate() {
                let mounted = line.mounting(n).map(|m| Arc::new(ResolvedMounting::new(m, profile)));
                axes.push(LocalAxis {
                    connection: connection.clone(),
                    index: AxisIndex(saturating(axes.len())),
                    number: line.axis_numbers[n],
                    name: line.entries[n].name.clone(),
                    protocol: line.protocol.name,
                    medium: line.protocol.medium,
                    host: line.host(),
                    relay: line.options.relay_axis,
                    heartbeat: line.heartbeat(),
                    profile,
                    identified,
                    simulation: simulation.cloned(),
                    mounted,
                });
            }
        }
        Ok(axes)
    }
}

/// Opens what the string names. The link is set as the protocol's host wants it.
fn open(url: &Url, protocol: &ProtocolInfo, options: &HostOptions) -> Result<AnyLink, Error> {
    // A serial adapter needs the bit rate; the other buses have it already, or none.
    let usual = matches!(url.target, LinkTarget::Slcan { .. } | LinkTarget::SlcanTcp { .. });
    let usual = if usual { protocol.baud } else { 0 };
    let bus = CanLine { bit_rate: rate_key(url, "bitrate")?.unwrap_or(usual) };
    Ok(match &url.target {
        LinkTarget::Serial { path, baud } => {
            let line = serial_line(url, protocol, *options, baud.unwrap_or(protocol.baud))?;
            AnyLink::Serial(Box::new(polepair_link::serial::open(path, line)?))
        }
        LinkTarget::Tcp { address } => {
            AnyLink::Serial(Box::new(polepair_link::tcp::TcpLink::connect(address)?))
        }
        LinkTarget::Udp { group } => {
            AnyLink::Can(Box::new(polepair_link::udp::open(group.parse()?)?))
        }
        LinkTarget::Slcan { path, baud } => {
            let baud = baud.unwrap_or(polepair_link::slcan::BAUD);
            AnyLink::Can(Box::new(polepair_link::slcan::open_serial(path, baud, bus)?))
        }
        LinkTarget::SlcanTcp { address } => {
            AnyLink::Can(Box::new(polepair_link::slcan::open_tcp(address, bus)?))
        }
        LinkTarget::Socketcand { address, bus } => {
            AnyLink::Can(Box::new(polepair_link::socketcand::connect(address, bus)?))
        }
        #[cfg(target_os = "linux")]
        LinkTarget::Socketcan { interface } => {
            AnyLink::Can(Box::new(polepair_link::socketcan::open(interface, bus)?))
        }
        _ => {
            let what = format!("{url} cannot be opened: SocketCAN is a part of Linux");
            let hint = "use an adapter with slcan firmware (`slcan://COM3`), or a bus that a Linux \
                        machine shares by socketcand (`socketcand://HOST/can0`)";
            return Err(Error::usage("E210", what, hint));
        }
    })
}

fn build_simulation(url: &Url, mut description: RackDescription) -> Result<Simulation, Error> {
    let seed = seed_of(url)?;
    if let Some(file) = url.key("eds") {
        description.apply_sheet_where_possible(Path::new(file))?;
    }
    description.set_rates(rate_key(url, "baud")?, rate_key(url, "bitrate")?);
    if let Some(word) = url.key("timing") {
        description.set_timing(word)?;
    }
    description.let_drives_set_rates();
    if let Some(standard) = url.stated_options()?.standard {
        description.set_standard(standard);
    }
    if url.key("echo").is_some() {
        description.set_echo(url.flag("echo")?);
    }
    // Parts of a rack are described by its file.
    let own = if matches!(url.target, LinkTarget::Sim { .. }) {
        url.family_options()
    } else {
        Vec::new()
    };
    for drive in description.rack.links.iter_mut().flat_map(|link| &mut link.drives) {
        drive.extra.extend(own.iter().cloned());
    }
    if let Some(host) = url.key("host") {
        description.set_host(host);
    }
    let pace = match url.key("time") {
        None | Some("real") => SimulationPace::Real,
        Some("virtual") => SimulationPace::Virtual,
        Some(other) => {
            let what = format!("`time={other}` is not `real` or `virtual`");
            return Err(Error::usage("E210", what, ""));
        }
    };
    Simulation::new(&description, seed, pace)
}

fn describe_rack(url: &Url, what: &str, seed: u64) -> Result<RackDescription, Error> {
    let file = Path::new(what);
    if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
        return simulate::rack_of_file(file, seed);
    }
    if what.contains(':') {
        return simulate::rack_of_words(&[what], seed);
    }
    let count = url.number("axes")?.unwrap_or(1);
    let axes = url.axes.iter().filter(|axis| !AxisNumber(**axis).is_group());
    let max = axes.map(|axis| u64::from(drive_address(*axis))).fold(0, u64::max);
    // `sim:x#3` without a count has three drives.
    let count = count.max(max);
    if count == 0 || count > 32 {
        let what = format!("`axes={count}` is not 1 to 32");
        return Err(Error::usage("E210", what, "for more, write a rack file"));
    }
    let own = simulate::find_drive(what)?.1.host.map(u64::from);
    let host = url.number("host")?.or(own).filter(|_| own.is_some());
    // Axes that the string names exist in any case: their errors are returned then.
    let numbers: Vec<String> = (1..)
        .filter(|n| Some(*n) != host || u32::try_from(*n).is_ok_and(|n| url.axes.contains(&n)))
        .take(count as usize)
        .map(|n| n.to_string())
        .collect();
    simulate::rack_of_words(&[&format!("{what}:{}", numbers.join(","))], seed)
}

/// An open link and its axes. Dropping the last handle closes it.
#[derive(Clone, Debug)]
pub struct LocalLink {
    url: Url,
    axes: Vec<LocalAxis>,
    wires: Vec<OpenWire>,
    /// For each wire its connection, if it has axes, and its protocols.
    line_configs: Vec<(Option<Connection>, Arc<[LineConfig]>)>,
    simulation: Option<Simulation>,
}

impl LocalLink {
    /// Connection string of the link.
    #[must_use]
    pub fn url(&self) -> &Url {
        &self.url
    }

    /// Every axis, in order.
    #[must_use]
    pub fn axes(&self) -> &[LocalAxis] {
        &self.axes
    }

    /// Every wire, in the order in which [taps](Connector::with_taps) count them.
    #[must_use]
    pub fn wires(&self) -> &[OpenWire] {
        &self.wires
    }

    /// The axis of that number: the drive's address on the wire.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212` when the link was opened without it, or several have that number.
    pub fn axis(&self, number: u32) -> Result<LocalAxis, Error> {
        let mut found = self.axes.iter().filter(|axis| axis.number == number);
        match (found.next(), found.next()) {
            (Some(axis), None) => Ok(axis.clone()),
            (Some(_), Some(_)) => {
                let what = format!("several links have an axis {number}");
                Err(Error::usage("E212", what, "name the drives in the rack, and ask by name"))
            }
            (None, _) => Err(self.no_axis_error(&number.to_string())),
        }
    }

    /// The axis that a rack file calls so, or that has this number as connection strings write it:
    /// `5.2` is the second axis of drive 5.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212`.
    pub fn axis_named(&self, name: &str) -> Result<LocalAxis, Error> {
        let found = self.axes.iter().find(|axis| axis.name == name);
        let found = found
            .or_else(|| self.axes.iter().find(|axis| AxisNumber(axis.number).to_string() == name));
        found.cloned().ok_or_else(|| self.no_axis_error(name))
    }

    fn no_axis_error(&self, wanted: &str) -> Error {
        let known: Vec<String> = self.axes.iter().map(LocalAxis::label).collect();
        let what = format!("this link has no axis {wanted}");
        let hint = if known.is_empty() {
            "name axes after `#`".to_owned()
        } else {
            format!("it was opened with {}; name axes after `#`", known.join(", "))
        };
        Error::usage("E212", what, hint)
    }

    /// The simulation behind a `sim:` link.
    #[must_use]
    pub fn simulation(&self) -> Option<&Simulation> {
        self.simulation.as_ref()
    }

    /// Stops every axis as fast as the verbs allow: all stops are sent before the first is waited
    /// for.
    ///
    /// # Errors
    /// The first error, after every axis was tried.
    pub fn stop_all(&self) -> Result<(), Error> {
        // No retry: a program that ends must not hang on a drive that has gone.
        let stops = stop_axes(&self.axes, StopOptions::default(), Duration::ZERO, |_, _| true);
        stops.into_iter().try_for_each(|stop| stop.standstill.map(drop))
    }

    /// Closes it at once, though axes of it are still held elsewhere: they end with `E322` from now on.
    /// No axis is stopped by this.
    pub fn close(self) {
        self.axes.iter().for_each(|axis| axis.connection.close());
    }

    /// Handles that end waits from elsewhere, for instance upon Ctrl-C: one for each wire.
    #[must_use]
    pub fn interrupters(&self) -> Vec<Interrupter> {
        self.axes.iter().map(|axis| axis.connection.interrupter()).collect()
    }

    /// Counters of the wire of an axis.
    #[must_use]
    pub fn counters(&self, axis: &LocalAxis) -> Counters {
        axis.connection.with_axes(|axes, _| axes.counters())
    }

    /// Waits on the link's own clock: a simulated link in virtual time is there at once.
    pub fn sleep(&self, span: Duration) {
        simulate::sleep_on_clock(self.simulation.as_ref(), span);
    }
}
