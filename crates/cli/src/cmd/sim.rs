//! `polepair sim RACK.toml | PROTO[:ADDRESS…] [--pty PATH] [--tcp ADDR] [--udp GROUP] …`

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::Args;
use polepair::simulate::{self, DriveLine, RackDescription, WireDescription};
use polepair::{AnyLink, load_profile};
use polepair_core::medium::{Can, CanLine, Medium, MediumKind, Stream};
use polepair_core::time::Instant;
use polepair_link::serve::ServeThread;
use polepair_link::udp::MulticastGroup;
use polepair_link::{LinkError, LinkIo, LinkWaker, Received};
use polepair_link::{slcan, socketcand, tcp::TcpServer, udp};

use crate::control::{ControlServer, ServedDrives};
use crate::data_output::DataOutput;
use crate::local_wire;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{self, print_note};

/// Simulates drives for any program, until Ctrl-C.
///
/// The command prints `ready URL` for each link as soon as it can be used. The drives have factory
/// settings. A serial link is a pseudo-terminal (on Windows a free TCP port), or a TCP port with --tcp. A CAN
/// bus is a UDP multicast group, or what --can, --socketcand or --udp selects. With --pty or --tcp it is a
/// serial CAN adapter (slcan). If a protocol exists on serial lines and on CAN, write `tmcl+can` for CAN.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair sim tmcl                              ready tmcl+serial:///dev/pts/3#1
  polepair sim tmcl:1,2 --pty /tmp/drives        two drives on one line
  polepair sim \"syntron-ts:1?fn00=14\"            options of the drive, see its page
  polepair sim modbus-rtu:1 --tcp 127.0.0.1:4001   RTU behind a serial server
  polepair sim modbus-tcp:1 --tcp 127.0.0.1:5020   Modbus TCP
  polepair sim tmcl:1,2 --udp 239.74.163.2:43113   a CAN bus for python-can
  polepair sim tmcl+can --pty /tmp/adapter         a CAN bus behind a serial CAN adapter
  polepair sim canopen:5 --eds motor.eds           the object dictionary of a data sheet
  polepair sim --profile my-drive.toml             a register bank that obeys an own profile
  polepair sim rack.toml --seed 7")]
pub struct Sim {
    /// Rack file; or for each link a protocol or product, with addresses and options: tmcl:1,2?ends=none
    #[arg(
        required_unless_present = "profile",
        value_name = "RACK.toml|PROTO[:ADDRESS,…][?KEY=VALUE&…]"
    )]
    drives: Vec<String>,
    /// Link PATH to the pseudo-terminal; repeat such options in the order of the links
    #[arg(long, value_name = "PATH")]
    pty: Vec<PathBuf>,
    /// Serve a link on this TCP address; port 0 selects a free one
    #[arg(long, value_name = "ADDR:PORT")]
    tcp: Vec<String>,
    /// Serve a CAN bus on this UDP multicast group, in the format of python-can
    #[arg(long, value_name = "GROUP:PORT")]
    udp: Vec<String>,
    /// Connect the drives to a CAN interface of the kernel, such as vcan0
    #[arg(long, value_name = "INTERFACE")]
    can: Vec<String>,
    /// Serve a CAN bus by the socketcand protocol, with the name can0; port 0 selects a free one
    #[arg(long, value_name = "ADDR:PORT")]
    socketcand: Vec<String>,
    /// Object dictionary of the CANopen drives (EDS or DCF); the last file is used for all further links
    #[arg(long, value_name = "FILE")]
    eds: Vec<PathBuf>,
    /// Own profile of a drive (Modbus), for a word with its name; without such a word it is the only drive
    #[arg(long, value_name = "FILE")]
    profile: Vec<PathBuf>,
    /// End switches of all stepper motors, in degrees, such as --ends=-3600..3600; without it there are none
    #[arg(long, value_name = "DEG..DEG", allow_hyphen_values = true)]
    ends: Option<String>,
    /// Path of the control socket for `polepair act` [default: a path that `act` derives from the URL]
    #[arg(long, value_name = "PATH")]
    control: Option<PathBuf>,
    /// Seed of all random values
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Speed factor of the simulated time
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    speed: f64,
}

/// Modules with a USB interface (manuals of the TMCM-1140 and 1640; public drivers of the 1110, 3110 and 6110).
const ON_USB: [&str; 5] = ["tmcm-1110", "tmcm-1140", "tmcm-1640", "tmcm-3110", "tmcm-6110"];

impl Sim {
    pub fn run(self) -> Result {
        if !(self.speed > 0.0 && self.speed <= 1000.0) {
            return Err(Problem::usage("E243", "--speed is more than 0 and at most 1000."));
        }
        let description = self.describe()?;
        let mut ends = WireEnds::from_args(&self);
        let mut served = Vec::new();
        let mut out = DataOutput::stdout();
        let lines = simulate::drive_lines(&description, self.seed).map_err(outcome::to_problem)?;
        let mut drives = ServedDrives {
            description: description.clone(),
            lines: lines.clone(),
            locations: Vec::new(),
        };
        for (link, line) in lines.into_iter().enumerate() {
            let bus = CanLine { bit_rate: description.wires[link].baud };
            let medium = description.rack.links[link].wire.medium();
            let (wire, location) = if description.is_on_network(link) {
                ends.open_network()?
            } else {
                ends.open(medium, bus)?
            };
            served.push(self.serve_line(line, wire));
            let WireDescription { load, .. } = description.wires[link];
            if load.most > 0.0 {
                let name = &description.rack.links[link].name;
                print_note(&format!(
                    "{name}: its drives take {load} of the bus at {} bit/s",
                    bus.bit_rate
                ));
            }
            for drive in &description.rack.links[link].drives {
                if let Some((_, ends)) = drive.extra.iter().find(|(key, _)| key == "ends")
                    && ends != "none"
                {
                    print_note(&format!("{}: end switches at {ends} degrees", drive.profile.name));
                }
            }
            for url in description.urls(link, &location) {
                out.write_line(&format!("ready {url}"));
            }
            drives.locations.push(location);
        }
        ends.check_all_used()?;
        let _control = self.listen_for_acts(drives)?;
        let stops: Vec<_> = served.iter().map(ServeThread::handle).collect();
        crate::interrupt::listen(move || stops.iter().for_each(polepair_link::ServeHandle::stop));
        out.flush()?;
        served
            .into_iter()
            .try_for_each(ServeThread::join)
            .map_err(|error| outcome::link_problem(&error))?;
        Ok(Exit::Ok)
    }

    /// Listens for `polepair act`. Without a stated place, a simulation also runs without.
    fn listen_for_acts(&self, drives: ServedDrives) -> Result<Option<ControlServer>> {
        match ControlServer::start(self.control.as_deref(), drives) {
            Ok(server) => Ok(Some(server)),
            Err(error) => match &self.control {
                None => Ok(None),
                Some(path) => {
                    let what = format!("cannot listen on {}: {error}.", path.display());
                    Err(Problem::new(Exit::Adapter, "E320", what)
                        .hint("choose a path that does not exist, in a folder of your own"))
                }
            },
        }
    }

    fn serve_line(&self, line: DriveLine, wire: AnyLink) -> ServeThread {
        match wire {
            AnyLink::Serial(wire) => line.serve(scale_time(wire, self.speed)),
            AnyLink::Can(wire) => line.serve(scale_time(wire, self.speed)),
        }
    }

    fn describe(&self) -> Result<RackDescription> {
        let drives = self.drives_with_profiles()?;
        let described = match &drives[..] {
            [file] if file.ends_with(".toml") => simulate::rack_of_file(Path::new(file), self.seed),
            words => {
                let can = [&self.udp, &self.can, &self.socketcand];
                let can = can.iter().any(|ends| !ends.is_empty());
                let words: Vec<String> = words
                    .iter()
                    .map(|word| if can { can_word(word) } else { word.clone() })
                    .collect();
                let words: Vec<&str> = words.iter().map(String::as_str).collect();
                simulate::rack_of_words(&words, self.seed).map(|mut description| {
                    self.add_module_options(&mut description);
                    description
                })
            }
        };
        let mut description = described.map_err(outcome::to_problem)?;
        self.apply_sheets(&mut description)?;
        Ok(description)
    }

    /// The words of the drives, with the file in place of the name of an own profile.
    fn drives_with_profiles(&self) -> Result<Vec<String>> {
        let mut files = Vec::new();
        for file in &self.profile {
            let profile = load_profile(file).map_err(|error| outcome::to_problem(error.into()))?;
            files.push((profile.name, file.display().to_string()));
        }
        if self.drives.is_empty() {
            return Ok(files.into_iter().map(|(_, file)| file).collect());
        }
        let with_file = |word: &String| {
            let name = word.split([':', '?']).next().unwrap_or_default();
            let own = files.iter().find(|(own, _)| *own == name);
            own.map_or_else(|| word.clone(), |(_, file)| word.replacen(name, file, 1))
        };
        Ok(self.drives.iter().map(with_file).collect())
    }

    /// Foreign programs meet modules as they come: without end switches, and alone on their USB.
    fn add_module_options(&self, description: &mut RackDescription) {
        for link in &mut description.rack.links {
            let is_alone = link.drives.len() == 1 && link.wire.medium() == MediumKind::Serial;
            for drive in &mut link.drives {
                if drive.profile.family == "tmcm" {
                    let ends = self.ends.as_deref().unwrap_or("none");
                    drive.extra.push(("ends".to_owned(), ends.to_owned()));
                }
                if is_alone && ON_USB.contains(&drive.profile.name) {
                    drive.extra.push(("usb".to_owned(), "true".to_owned()));
                }
            }
        }
    }

    /// A data sheet for each link, in order; the last one for those that are left.
    fn apply_sheets(&self, description: &mut RackDescription) -> Result<()> {
        let Some(last) = self.eds.last() else { return Ok(()) };
        for link in 0..description.rack.links.len() {
            let file = self.eds.get(link).unwrap_or(last);
            let slips = description.apply_sheet(link, file).map_err(outcome::to_problem)?;
            slips.iter().for_each(|slip| terminal::print_note(&slip.to_string()));
        }
        Ok(())
    }
}

/// The word with `+can` behind its name, where the protocol is spoken on both media.
fn can_word(word: &str) -> String {
    let (name, rest) = word.split_once(':').map_or((word, ""), |(name, rest)| (name, rest));
    let twin = format!("{name}+can");
    if !simulate::is_drive(&twin) {
        word.to_owned()
    } else if rest.is_empty() {
        twin
    } else {
        format!("{twin}:{rest}")
    }
}

/// The ends of wires that the user asked for, to be given to links in order.
struct WireEnds {
    pty: VecDeque<PathBuf>,
    tcp: VecDeque<String>,
    udp: VecDeque<String>,
    can: VecDeque<String>,
    socketcand: VecDeque<String>,
}

impl WireEnds {
    fn from_args(sim: &Sim) -> Self {
        Self {
            pty: sim.pty.iter().cloned().collect(),
            tcp: cloned_list(&sim.tcp),
            udp: cloned_list(&sim.udp),
            can: cloned_list(&sim.can),
            socketcand: cloned_list(&sim.socketcand),
        }
    }

    /// The wire of a link, and where others find it.
    fn open(&mut self, medium: MediumKind, bus: CanLine) -> Result<(AnyLink, String)> {
        let opened = match medium {
            MediumKind::Serial => {
                self.open_serial().map(|(l, location)| (AnyLink::Serial(l), location))
            }
            MediumKind::Can => self.open_can(bus).map(|(l, location)| (AnyLink::Can(l), location)),
        };
        opened.map_err(|error| outcome::link_problem(&error))
    }

    /// The server of drives on TCP: this machine's alone where no address is given.
    fn open_network(&mut self) -> Result<(AnyLink, String)> {
        let address = self.tcp.pop_front().unwrap_or_else(|| "127.0.0.1:0".to_owned());
        let server = TcpServer::bind(&address).map_err(|error| outcome::link_problem(&error))?;
        let location = format!("tcp://{}", server.address());
        Ok((AnyLink::Serial(Box::new(server)), location))
    }

    fn open_serial(&mut self) -> OpenedWire<Stream> {
        let pty = self.pty.pop_front();
        if let Some(address) = self.tcp.front().filter(|_| pty.is_none()) {
            let server = TcpServer::bind(address)?;
            self.tcp.pop_front();
            let location = format!("tcp://{}", server.address());
            return Ok((Box::new(server), location));
        }
        local_wire::open(pty.as_deref())
    }

    fn open_can(&mut self, bus: CanLine) -> OpenedWire<Can> {
        if let Some(group) = self.udp.pop_front() {
            return open_udp(group.parse()?);
        }
        if let Some(interface) = self.can.pop_front() {
            return open_interface(&interface);
        }
        if let Some(address) = self.socketcand.pop_front() {
            let server = socketcand::listen(&address, BUS_NAME)?;
            let location = format!("socketcand://{}/{BUS_NAME}", address_text(server.address()));
            return Ok((Box::new(server), location));
        }
        if let Some(pty) = self.pty.pop_front() {
            return serve_slcan_pty(&pty, bus);
        }
        if let Some(address) = self.tcp.pop_front() {
            let server = slcan::listen(&address, bus)?;
            let location = format!("slcan://{}", address_text(server.address()));
            return Ok((Box::new(server), location));
        }
        open_udp(MulticastGroup::default())
    }

    /// Refuses what no link was there for.
    fn check_all_used(&self) -> Result<()> {
        let can = self.udp.len() + self.can.len() + self.socketcand.len();
        match self.pty.len() + self.tcp.len() + can {
            0 => Ok(()),
            left => {
                let what = format!("endpoint options without a link: {left}.");
                Err(Problem::usage("E244", what).hint(
                    "a serial link takes --pty or --tcp, a CAN bus these and --udp, --can, \
                     --socketcand, modbus-tcp --tcp alone",
                ))
            }
        }
    }
}

fn cloned_list(list: &[String]) -> VecDeque<String> {
    list.iter().cloned().collect()
}

/// Name of a simulated bus for clients of socketcand.
const BUS_NAME: &str = "can0";

type OpenedWire<M> = std::result::Result<(Box<dyn LinkIo<M>>, String), LinkError>;

fn open_udp(group: MulticastGroup) -> OpenedWire<Can> {
    let link = udp::open(group)?;
    let location = format!("udp://{}", link.describe());
    Ok((Box::new(link), location))
}

#[cfg(target_os = "linux")]
fn open_interface(name: &str) -> OpenedWire<Can> {
    let link = polepair_link::socketcan::open(name, CanLine { bit_rate: 0 })?;
    Ok((Box::new(link), format!("socketcan://{name}")))
}

#[cfg(not(target_os = "linux"))]
fn open_interface(name: &str) -> OpenedWire<Can> {
    Err(LinkError::new(name, polepair_link::Cause::Unsuitable).with_hint("Only Linux has them."))
}

fn address_text(address: Option<SocketAddr>) -> String {
    address.map(|address| address.to_string()).unwrap_or_default()
}

#[cfg(unix)]
fn serve_slcan_pty(path: &Path, bus: CanLine) -> OpenedWire<Can> {
    let pty = polepair_link::pty::Pty::open(Some(path))?;
    let location = format!("slcan://{}", local_wire::pty_path(&pty));
    Ok((Box::new(slcan::serve_pty(pty, bus)?), location))
}

#[cfg(windows)]
fn serve_slcan_pty(path: &Path, _bus: CanLine) -> OpenedWire<Can> {
    Err(local_wire::no_pty(path))
}

/// The wire as its drives see it where time passes faster for them.
fn scale_time<M: Medium>(wire: Box<dyn LinkIo<M>>, speed: f64) -> Box<dyn LinkIo<M>> {
    match speed {
        1.0 => wire,
        speed => Box::new(ScaledLink { inner: wire, speed }),
    }
}

/// A wire on which time passes faster.
struct ScaledLink<M: Medium> {
    inner: Box<dyn LinkIo<M>>,
    speed: f64,
}

impl<M: Medium> ScaledLink<M> {
    fn to_scaled(&self, real: Instant) -> Instant {
        Instant((real.0 as f64 * self.speed) as u64)
    }

    fn to_real(&self, fast: Instant) -> Instant {
        if fast == Instant::FAR_FUTURE {
            fast
        } else {
            Instant((fast.0 as f64 / self.speed) as u64)
        }
    }
}

impl<M: Medium> LinkIo<M> for ScaledLink<M> {
    fn now(&self) -> Instant {
        self.to_scaled(self.inner.now())
    }

    fn send(&self, unit: &M::Unit) -> std::result::Result<(), LinkError> {
        self.inner.send(unit)
    }

    fn receive(
        &self,
        buffer: &mut M::Out,
        until: Instant,
    ) -> std::result::Result<Received, LinkError> {
        Ok(match self.inner.receive(buffer, self.to_real(until))? {
            Received::Bytes { len, at } => Received::Bytes { len, at: self.to_scaled(at) },
            other => other,
        })
    }

    fn set_line(&self, line: M::Line) -> std::result::Result<(), LinkError> {
        self.inner.set_line(line)
    }

    fn waker(&self) -> LinkWaker {
        self.inner.waker()
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }
}
