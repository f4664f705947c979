//! Opening links and finding out what is on them.
//!
//! ```
//! # if polepair_core::drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let link = polepair::connect("sim:tmcl?time=virtual")?;
//! let axis = link.axis(1)?;
//! println!("{}, {}", axis.profile().title, axis.identified());
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod chosen;
mod found;
mod given;
mod kept;
mod options;
mod parts;
mod rack;
mod readdressed;
mod spoken;
mod tapped;

use crate::axis::{Axis, stop_until_standing};
use crate::bus;
use crate::config::Config;
use crate::error::Error;
use crate::file::{FileError, Place};
use crate::identify::Identified;
use crate::mounting::{Mounted, Mounting};
use crate::registry::{self, Spoken};
use crate::scan::Found;
use crate::simulate::{self, Description, Pace, Simulation};
use crate::url::{Number, Target, Url};
use crate::wire::{AnyLink, OpenWire, Sent, SharedLink};
pub(crate) use kept::{Kept, Lent};
use options::{line_of, rate, seed, standard, wire_options};
pub use parts::Part;
use polepair_core::medium::{Can, CanLine, MediumKind, Stream};
use polepair_core::mux::Mux;
use polepair_core::profile::Profile;
use polepair_core::proto::HostOptions;
use polepair_core::station::{AxisIndex, Counters};
use polepair_link::{Connection, Interrupter, Link as _};
use rack::{expected, seed_of};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
pub use tapped::AnyTap;
pub(crate) use tapped::SharedTap;
use tapped::{Links, Taps};

/// Opens a link with the configuration that is found from the working folder upward.
///
/// # Errors
/// [`Error::Usage`] for a wrong connection string, [`Error::Link`] when it cannot be opened,
/// [`Error::Failed`] when an axis that it names does not answer.
pub fn connect(url: &str) -> Result<Link, Error> {
    Connector::discover().connect(url)
}

/// How links are opened: with which names, profiles and taps.
#[derive(Clone, Debug, Default)]
pub struct Connector {
    /// Named links and users' profiles.
    pub config: Config,
    taps: Option<Taps>,
    links: Option<Links>,
    stops: bool,
    /// Files that were wrong and could be done without.
    passed_over: Arc<Mutex<Vec<FileError>>>,
    sent: Sent,
}

impl Connector {
    /// With the configuration that is found from the working folder upward: see
    /// [`Config::broken`] for what is wrong with it.
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
        Ok(self)
    }

    /// What counts the frames that leave on every link that this connector, or a clone of it, opens.
    #[must_use]
    pub fn sent(&self) -> Sent {
        self.sent.clone()
    }

    /// The connection string with its name, if it is one, looked up.
    ///
    /// # Errors
    /// [`Error::Usage`].
    pub fn url(&self, text: &str) -> Result<Url, Error> {
        Url::read(&self.config.expand(text)?, self.stops)
    }

    /// The connection strings of each protocol that a scan is to ask on one link:
    /// `canopen,thruster+udp://…`.
    pub(crate) fn urls(&self, text: &str) -> Result<Vec<Url>, Error> {
        let text = self.config.expand(text)?;
        let (head, rest) = text.split_at(text.find("://").unwrap_or(0));
        let (words, link) = head.split_at(head.find('+').unwrap_or(head.len()));
        if !words.contains(',') {
            return Ok(vec![Url::read(&text, self.stops)?]);
        }
        let words = words.split(',').map(str::trim);
        words.map(|word| Url::read(&format!("{word}{link}{rest}"), self.stops)).collect()
    }

    /// Opens the link of several protocols, once.
    pub(crate) fn lines_of(&self, urls: &[Url]) -> Result<(Vec<Line>, Option<Simulation>), Error> {
        let [first, others @ ..] = urls else { return Ok((Vec::new(), None)) };
        let (mut lines, simulation) = self.lines(first)?;
        for url in others {
            let link = lines[0].link.clone();
            let adapter = matches!(url.target, Target::Slcan { .. } | Target::SlcanTcp { .. });
            let what = match (&link, adapter && url.key("bitrate").is_none()) {
                (SharedLink::Serial(_), _) => "a serial line carries one protocol",
                (_, true) => "protocols have different bit rates from the factory: say `bitrate=`",
                _ if lines.iter().any(|line| line.spoken.name == url.protocol) => {
                    "a protocol is named twice"
                }
                _ => {
                    lines.push(self.line_on(url, Some(link))?);
                    continue;
                }
            };
            return Err(Error::usage("E210", what, ""));
        }
        Ok((lines, simulation))
    }

    /// Opens a link and finds out what is there.
    ///
    /// # Errors
    /// As [`connect`].
    pub fn connect(&self, text: &str) -> Result<Link, Error> {
        self.connect_with(text, true)
    }

    /// Opens a link; unless it is to `ask`, the drives are taken for what the string or the rack says,
    /// so that one that is silent keeps nobody waiting.
    pub(crate) fn connect_with(&self, text: &str, ask: bool) -> Result<Link, Error> {
        let url = self.url(text)?;
        let (lines, simulation) = self.lines(&url)?;
        self.link(url, &lines, simulation, ask)
    }

    /// The axes that are on opened lines.
    fn link(
        &self,
        url: Url,
        lines: &[Line],
        simulation: Option<Simulation>,
        ask: bool,
    ) -> Result<Link, Error> {
        let (mut axes, mut wires, mut kept) = (Vec::new(), Vec::new(), Vec::new());
        for lines in lines.chunk_by(|one, other| one.wire == other.wire) {
            let its = self.axes(&url, lines, simulation.as_ref(), ask)?;
            let connection = its.first().map(|axis| axis.connection.clone());
            kept.push((connection, lines.iter().map(Line::kept).collect()));
            axes.extend(its);
            wires.extend(Line::wire_of(lines));
        }
        axes.iter().try_for_each(Axis::learn_scales)?;
        let link = Link { url, axes, wires, kept, simulation };
        link.url.names.iter().try_for_each(|name| link.named(name).map(drop))?;
        Ok(link)
    }

    /// Opens what the string names, without asking anybody anything.
    pub(crate) fn lines(&self, url: &Url) -> Result<(Vec<Line>, Option<Simulation>), Error> {
        match &url.target {
            Target::Sim { what } => self.sim(url, describe(url, what, seed_of(url)?)?, None),
            Target::Rack { file } => self.rack(url, file),
            _ => Ok((vec![self.line_on(url, None)?], None)),
        }
    }

    /// One protocol on a link, which is opened unless it is already.
    fn line_on(&self, url: &Url, opened: Option<SharedLink>) -> Result<Line, Error> {
        let spoken = url.spoken()?;
        url.axes.iter().try_for_each(|axis| spoken.check(*axis))?;
        let mut options = wire_options(url, &spoken)?;
        options.host = options.host.or_else(|| spoken.other_host(&url.axes));
        let link = match opened {
            Some(link) => link,
            None => self.tapped(0, open(url, &spoken, &options)?, None),
        };
        let numbers =
            if url.axes.is_empty() { vec![*spoken.addresses.start()] } else { url.axes.clone() };
        let seats = vec![Seat::default(); numbers.len()];
        let relay = url.axes.first().copied();
        let all = Arc::default();
        Ok(Line { wire: 0, link, spoken, options, numbers, relay, seats, all })
    }

    /// The axes of one wire, on one connection: a line for each protocol that is spoken on it.
    fn axes(
        &self,
        url: &Url,
        lines: &[Line],
        simulation: Option<&Simulation>,
        ask: bool,
    ) -> Result<Vec<Axis>, Error> {
        let found: Vec<Vec<(&'static Profile, Identified)>> =
            lines.iter().map(|line| self.identified(url, line, ask)).collect::<Result<_, _>>()?;
        let profiles: Vec<Vec<(&'static Profile, u32)>> = lines
            .iter()
            .zip(&found)
            .map(|(line, found)| found.iter().map(|one| one.0).zip(line.numbers.iter().copied()))
            .map(Iterator::collect)
            .collect();
        let connection = Line::connection_of(lines, &profiles)?;
        let mut axes = Vec::new();
        for (line, found) in lines.iter().zip(found) {
            for (n, (profile, identified)) in found.into_iter().enumerate() {
                let mounted = line.mounting(n).map(|m| Arc::new(Mounted::new(m, profile)));
                axes.push(Axis {
                    connection: connection.clone(),
                    index: AxisIndex(u8::try_from(axes.len()).unwrap_or(u8::MAX)),
                    number: line.numbers[n],
                    name: line.seats[n].name.clone(),
                    protocol: line.spoken.name,
                    medium: line.spoken.medium,
                    host: line.host(),
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

    /// Axes by number on one line, whatever others it has. One host at a time.
    pub(crate) fn axes_found(&self, line: &Line, found: &[Found]) -> Result<Vec<Axis>, Error> {
        let profiles: Vec<_> = found.iter().map(|one| (one.profile, one.number)).collect();
        let (connection, before) = line.probe(&profiles, false)?;
        let axis = |(n, one): (usize, &Found)| Axis {
            connection: connection.clone(),
            index: AxisIndex(u8::try_from(before + n).unwrap_or(u8::MAX)),
            number: one.number,
            name: String::new(),
            protocol: line.spoken.name,
            medium: line.spoken.medium,
            host: line.host(),
            heartbeat: line.heartbeat(),
            profile: one.profile,
            identified: one.identified.clone(),
            simulation: None,
            mounted: None,
        };
        Ok(found.iter().enumerate().map(axis).collect())
    }
}

/// Opens what the string names. The link is set as the protocol's host wants it.
fn open(url: &Url, spoken: &Spoken, options: &HostOptions) -> Result<AnyLink, Error> {
    // A serial adapter must be told; the other buses have their bit rate already, or none.
    let usual = matches!(url.target, Target::Slcan { .. } | Target::SlcanTcp { .. });
    let usual = if usual { spoken.baud } else { 0 };
    let bus = CanLine { bit_rate: rate(url, "bitrate")?.unwrap_or(usual) };
    Ok(match &url.target {
        Target::Serial { path, baud } => {
            let line = line_of(url, spoken, *options, baud.unwrap_or(spoken.baud))?;
            AnyLink::Serial(Box::new(polepair_link::serial::open(path, line)?))
        }
        Target::Tcp { address } => {
            AnyLink::Serial(Box::new(polepair_link::tcp::TcpLink::connect(address)?))
        }
        #[cfg(unix)]
        Target::Udp { group } => AnyLink::Can(Box::new(polepair_link::udp::open(group.parse()?)?)),
        Target::Slcan { path, baud } => {
            let baud = baud.unwrap_or(polepair_link::slcan::BAUD);
            AnyLink::Can(Box::new(polepair_link::slcan::open_serial(path, baud, bus)?))
        }
        Target::SlcanTcp { address } => {
            AnyLink::Can(Box::new(polepair_link::slcan::open_tcp(address, bus)?))
        }
        Target::Socketcand { address, bus } => {
            AnyLink::Can(Box::new(polepair_link::socketcand::connect(address, bus)?))
        }
        #[cfg(target_os = "linux")]
        Target::Socketcan { interface } => {
            AnyLink::Can(Box::new(polepair_link::socketcan::open(interface, bus)?))
        }
        _ => {
            let what = format!("this operating system cannot open {url}");
            return Err(Error::usage(
                "E210",
                what,
                "slcan adapters and socketcand work everywhere",
            ));
        }
    })
}

fn simulated(url: &Url, mut description: Description) -> Result<Simulation, Error> {
    let seed = seed_of(url)?;
    if let Some(file) = url.key("eds") {
        description.take_sheet_where_fit(Path::new(file))?;
    }
    description.set_rates(rate(url, "baud")?, rate(url, "bitrate")?);
    if let Some(word) = url.key("timing") {
        description.set_timing(word)?;
    }
    if let Some(standard) = standard(url)? {
        description.set_standard(standard);
    }
    if url.key("echo").is_some() {
        description.set_echo(url.flag("echo")?);
    }
    // What is behind a rack's file is the file's to say.
    let own = if matches!(url.target, Target::Sim { .. }) { url.extra() } else { Vec::new() };
    for drive in description.rack.links.iter_mut().flat_map(|link| &mut link.drives) {
        drive.extra.extend(own.iter().cloned());
    }
    if let Some(host) = url.key("host") {
        description.answer_to(host);
    }
    let pace = match url.key("time") {
        None | Some("real") => Pace::Real,
        Some("virtual") => Pace::Virtual,
        Some(other) => {
            let what = format!("`time={other}` is neither real nor virtual");
            return Err(Error::usage("E210", what, ""));
        }
    };
    Simulation::new(&description, seed, pace)
}

fn describe(url: &Url, what: &str, seed: u64) -> Result<Description, Error> {
    let file = Path::new(what);
    if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) {
        return simulate::rack_of_file(file, seed);
    }
    let count = url.number("axes")?.unwrap_or(1);
    let drives = url.axes.iter().filter(|axis| !Number(**axis).is_group());
    let most = drives.copied().map(u64::from).max().unwrap_or(0);
    let count = count.max(most);
    if count == 0 || count > 32 {
        let what = format!("`axes={count}` is not 1 to 32");
        return Err(Error::usage("E210", what, "for more, write a rack file"));
    }
    if what.contains(':') {
        return simulate::rack_of_words(&[what], seed);
    }
    let own = simulate::drive_of(what)?.1.host.map(u64::from);
    let host = url.number("host")?.or(own).filter(|_| own.is_some());
    // Axes that the string names are there in any case: what is wrong with them is told then.
    let free = |n: &u64| Some(*n) != host || u32::try_from(*n).is_ok_and(|n| url.axes.contains(&n));
    let numbers: Vec<String> =
        (1..).filter(free).take(count as usize).map(|n| n.to_string()).collect();
    simulate::rack_of_words(&[&format!("{what}:{}", numbers.join(","))], seed)
}

/// One protocol on an opened wire, and what is to be found there.
#[derive(Clone)]
pub(crate) struct Line {
    /// Which wire: lines of one share it.
    pub(crate) wire: usize,
    pub(crate) link: SharedLink,
    pub(crate) spoken: Spoken,
    pub(crate) options: HostOptions,
    pub(crate) numbers: Vec<u32>,
    /// The axis that a host is wired to, where others may be behind it.
    relay: Option<u32>,
    /// What is known of each axis, whoever answers.
    seats: Vec<Seat>,
    /// What a rack says of all that it has there, also of axes that nobody named.
    all: Arc<[(u32, Seat)]>,
}

/// What a rack says of the drive at an address.
#[derive(Clone, Debug, Default)]
struct Seat {
    name: String,
    mounting: Option<Arc<Mounting>>,
    /// Which drive it is to be, and where that is said.
    profile: Option<(&'static Profile, Option<Place>)>,
}

impl Line {
    /// The wire that these share.
    pub(crate) fn wire_of(lines: &[Self]) -> Option<OpenWire> {
        let first = lines.first()?;
        let rate = match first.spoken.medium {
            MediumKind::Serial => first.options.baud,
            MediumKind::Can => first.options.bit_rate,
        };
        Some(OpenWire {
            name: first.link.describe(),
            medium: first.spoken.medium,
            rate: Some(rate).filter(|rate| *rate > 0),
            protocols: lines.iter().map(|line| line.spoken.name).collect(),
        })
    }

    /// A place on the line's wire.
    pub(crate) fn seat(&self, address: u32) -> bus::Seat {
        bus::Seat { spoken: self.spoken.clone(), address }
    }

    /// The number that the host has on it.
    pub(crate) fn host(&self) -> Option<u32> {
        self.options.host.or(self.spoken.host)
    }

    /// The period of the host's heartbeat, where it was told to send one.
    fn heartbeat(&self) -> Option<Duration> {
        let ms = self.options.heartbeat_ms.filter(|ms| *ms > 0)?;
        Some(Duration::from_millis(ms.into()))
    }

    fn mounting(&self, axis: usize) -> Option<Arc<Mounting>> {
        self.seats[axis].mounting.clone()
    }

    /// Sets a simulated port as the protocol's host wants it.
    fn set_port(&self) -> Result<(), Error> {
        if let SharedLink::Serial(link) = &self.link
            && let Some(lane) = registry::lane::<Stream>(self.spoken.name, self.options, &[])
        {
            link.set_line(lane.line())?;
        }
        Ok(())
    }

    /// A host with these axes on the wire, and before them the one that it is wired to if that is
    /// none of them: so many are before them. One at a time.
    pub(crate) fn probe(
        &self,
        axes: &[(&'static Profile, u32)],
        probing: bool,
    ) -> Result<(Connection, usize), Error> {
        let relay = self.relay.filter(|relay| axes.iter().all(|(_, number)| number != relay));
        let first = relay.map(|relay| (self.spoken.generic, relay));
        let all: Vec<_> = first.into_iter().chain(axes.iter().copied()).collect();
        let options = self.session_options();
        // Who looks for drives takes whatever tells of one.
        let doubt = options.doubt.filter(|_| !probing);
        let options = HostOptions { probing, doubt, ..options };
        Ok((self.connection_with(options, &all)?, all.len() - axes.len()))
    }

    /// The host's settings for one session: what it asked may still be answered in the next, whose probes
    /// are drawn anew.
    fn session_options(&self) -> HostOptions {
        HostOptions { doubt: self.options.doubt.map(|_| seed()), ..self.options }
    }

    /// A host with these axes on the wire. One at a time.
    pub(crate) fn connection(&self, axes: &[(&'static Profile, u32)]) -> Result<Connection, Error> {
        self.connection_with(self.session_options(), axes)
    }

    /// One connection for all that is spoken on a wire, axes of the first line first.
    fn connection_of(
        lines: &[Self],
        axes: &[Vec<(&'static Profile, u32)>],
    ) -> Result<Connection, Error> {
        let [first, _, ..] = lines else { return lines[0].connection(&axes[0]) };
        let no = |what: &str| Error::usage("E203", what, "");
        let SharedLink::Can(link) = &first.link else {
            return Err(no("a serial line carries one protocol"));
        };
        let lane = |(line, axes): (&Self, &Vec<_>)| {
            registry::lane::<Can>(line.spoken.name, line.session_options(), axes)
        };
        let lanes: Option<Vec<_>> = lines.iter().zip(axes).map(lane).collect();
        let mux = Mux::new(lanes.ok_or_else(|| no("the protocol has no host"))?);
        let mux = mux.ok_or_else(|| no("these drives cannot share a bus: too many axes"))?;
        Ok(Connection::new::<Can>(Box::new(link.clone()), Box::new(mux)))
    }

    fn connection_with(
        &self,
        options: HostOptions,
        axes: &[(&'static Profile, u32)],
    ) -> Result<Connection, Error> {
        let missing = || Error::usage("E203", "the protocol has no host", "");
        let name = self.spoken.name;
        Ok(match &self.link {
            SharedLink::Serial(link) => {
                let lane = registry::lane(name, options, axes).ok_or_else(missing)?;
                Connection::new::<Stream>(Box::new(link.clone()), lane)
            }
            SharedLink::Can(link) => {
                let lane = registry::lane(name, options, axes).ok_or_else(missing)?;
                Connection::new::<Can>(Box::new(link.clone()), lane)
            }
        })
    }
}

/// An open link and its axes. Dropping the last handle closes it.
#[derive(Clone, Debug)]
pub struct Link {
    url: Url,
    axes: Vec<Axis>,
    wires: Vec<OpenWire>,
    /// Of each wire its connection, where it has axes, and what is spoken on it.
    kept: Vec<(Option<Connection>, Arc<[Kept]>)>,
    simulation: Option<Simulation>,
}

impl Link {
    /// What it was opened by.
    #[must_use]
    pub fn url(&self) -> &Url {
        &self.url
    }

    /// Every axis, in order.
    #[must_use]
    pub fn axes(&self) -> &[Axis] {
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
    pub fn axis(&self, number: u32) -> Result<Axis, Error> {
        let mut found = self.axes.iter().filter(|axis| axis.number == number);
        match (found.next(), found.next()) {
            (Some(axis), None) => Ok(axis.clone()),
            (Some(_), Some(_)) => {
                let what = format!("several links have an axis {number}");
                Err(Error::usage("E212", what, "name the drives in the rack, and ask by name"))
            }
            (None, _) => Err(self.no_axis(&number.to_string())),
        }
    }

    /// The axis that a rack file calls so.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212`.
    pub fn named(&self, name: &str) -> Result<Axis, Error> {
        let found = self.axes.iter().find(|axis| axis.name == name);
        found.cloned().ok_or_else(|| self.no_axis(name))
    }

    fn no_axis(&self, wanted: &str) -> Error {
        let known: Vec<String> = self.axes.iter().map(Axis::label).collect();
        let what = format!("this link has no axis {wanted}");
        let hint = match known.is_empty() {
            true => "name axes after `#`".to_owned(),
            false => format!("it was opened with {}; name axes after `#`", known.join(", ")),
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
        let axes: Vec<&Axis> = self.axes.iter().collect();
        let stood = stop_until_standing(&axes, Duration::ZERO, |_, _| false);
        let stood = stood.into_iter().map(|stood| stood.map(drop));
        stood.fold(Ok(()), Result::and)
    }

    /// Closes it at once, though axes of it are still held elsewhere: they end with `E322` from now on.
    /// No axis is stopped by this.
    pub fn close(self) {
        self.axes.iter().for_each(|axis| axis.connection.close());
    }

    /// What ends waits from elsewhere, for instance upon Ctrl-C: one for each wire.
    #[must_use]
    pub fn interrupters(&self) -> Vec<Interrupter> {
        self.axes.iter().map(|axis| axis.connection.interrupter()).collect()
    }

    /// What happened on the wire of an axis so far.
    #[must_use]
    pub fn counters(&self, axis: &Axis) -> Counters {
        axis.connection.with(|axes, _| axes.counters())
    }

    /// Waits on the link's own clock: a simulated link in virtual time is there at once.
    pub fn sleep(&self, span: Duration) {
        simulate::pass(self.simulation.as_ref(), span);
    }
}
