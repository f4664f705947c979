//! `polepair sim RACK.toml | PROTO[:ADDRESS…] [--pty PATH] [--tcp ADDR] [--udp GROUP] …`

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use clap::Args;
use polepair::AnyLink;
use polepair::simulate::{self, Description, DriveLine};
use polepair_core::medium::{Can, Medium, MediumKind, Stream};
use polepair_core::time::Instant;
use polepair_link::serve::Served;
use polepair_link::udp::Group;
use polepair_link::{Link, LinkError, Received, Waker, pty::Pty, tcp::TcpServer, udp};

use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::Output;

/// Simulates drives that any program can talk to, until Ctrl-C.
///
/// One line `ready URL` is printed for each link as soon as it can be used. Drives are as from the
/// factory. A serial link gets a pseudo-terminal, unless --tcp gives it a port; a CAN bus gets a UDP
/// multicast group. With --udp, a protocol that is spoken on both is put on CAN; `tmcl+can` says so
/// by itself.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair sim tmcl                              ready tmcl+serial:///dev/pts/3#1
  polepair sim tmcl:1,2 --pty /tmp/drives        two drives on one line
  polepair sim modbus-rtu:1 --tcp 127.0.0.1:4001
  polepair sim tmcl:1,2 --udp 239.74.163.2:43113  a CAN bus that python-can can join
  polepair sim rack.toml --seed 7")]
pub struct Sim {
    /// A rack file, or for each link a protocol or product and addresses: tmcl:1,2
    #[arg(required = true, value_name = "RACK.toml|PROTO[:ADDRESS,…]")]
    drives: Vec<String>,
    /// Make PATH a link to the pseudo-terminal; once for each link, in order
    #[arg(long, value_name = "PATH")]
    pty: Vec<PathBuf>,
    /// Serve a link on TCP instead; port 0 takes a free one
    #[arg(long, value_name = "ADDR:PORT")]
    tcp: Vec<String>,
    /// Serve a CAN bus on this UDP multicast group, as python-can's udp_multicast
    #[arg(long, value_name = "GROUP:PORT")]
    udp: Vec<String>,
    /// Whatever is random comes from this
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// How many times faster than real motors
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    speed: f64,
}

impl Sim {
    pub fn run(self) -> Result {
        if !(self.speed > 0.0 && self.speed <= 1000.0) {
            return Err(Problem::usage("E243", "--speed is more than 0 and at most 1000."));
        }
        let description = self.description()?;
        let mut ends = Ends::of(&self);
        let mut served = Vec::new();
        let mut out = Output::stdout();
        let lines = simulate::lines(&description, self.seed).map_err(outcome::error)?;
        for (link, line) in lines.into_iter().enumerate() {
            let (wire, place) = ends.open(description.rack.links[link].wire.medium())?;
            served.push(self.serve(line, wire));
            out.line(&format!("ready {}", description.url(link, &place)));
        }
        ends.all_used()?;
        let stops: Vec<_> = served.iter().map(Served::stop).collect();
        crate::interrupt::listen(move || stops.iter().for_each(polepair_link::Stop::stop));
        out.flush()?;
        served
            .into_iter()
            .try_for_each(Served::wait)
            .map_err(|error| outcome::link_error(&error))?;
        Ok(Exit::Ok)
    }

    fn serve(&self, line: DriveLine, wire: AnyLink) -> Served {
        match wire {
            AnyLink::Serial(wire) => line.serve(scaled(wire, self.speed)),
            AnyLink::Can(wire) => line.serve(scaled(wire, self.speed)),
        }
    }

    fn description(&self) -> Result<Description> {
        let described = match &self.drives[..] {
            [file] if file.ends_with(".toml") => simulate::rack_of_file(Path::new(file), self.seed),
            words => {
                let can = !self.udp.is_empty();
                let words: Vec<String> = words
                    .iter()
                    .map(|word| if can { on_can(word) } else { word.clone() })
                    .collect();
                let words: Vec<&str> = words.iter().map(String::as_str).collect();
                simulate::rack_of_words(&words, self.seed)
            }
        };
        described.map_err(outcome::error)
    }
}

/// The word with `+can` behind its name, where the protocol is spoken on both media.
fn on_can(word: &str) -> String {
    let (name, rest) = word.split_once(':').map_or((word, ""), |(name, rest)| (name, rest));
    let twin = format!("{name}+can");
    match simulate::is_drive(&twin) {
        true if rest.is_empty() => twin,
        true => format!("{twin}:{rest}"),
        false => word.to_owned(),
    }
}

/// The ends of wires that the user asked for, to be given to links in order.
struct Ends {
    pty: VecDeque<PathBuf>,
    tcp: VecDeque<String>,
    udp: VecDeque<String>,
}

impl Ends {
    fn of(sim: &Sim) -> Self {
        let own = |list: &[String]| list.iter().cloned().collect();
        let pty = sim.pty.iter().cloned().collect();
        Self { pty, tcp: own(&sim.tcp), udp: own(&sim.udp) }
    }

    /// The wire of a link, and where others find it.
    fn open(&mut self, medium: MediumKind) -> Result<(AnyLink, String)> {
        let opened = match medium {
            MediumKind::Serial => self.open_serial().map(|(l, place)| (AnyLink::Serial(l), place)),
            MediumKind::Can => self.open_can().map(|(l, place)| (AnyLink::Can(l), place)),
        };
        opened.map_err(|error| outcome::link_error(&error))
    }

    fn open_serial(&mut self) -> Opened<Stream> {
        let pty = self.pty.pop_front();
        if let Some(address) = self.tcp.front().filter(|_| pty.is_none()) {
            let server = TcpServer::bind(address)?;
            self.tcp.pop_front();
            let place = format!("tcp://{}", server.address());
            return Ok((Box::new(server), place));
        }
        let pty = Pty::open(pty.as_deref())?;
        let place = format!("serial://{}", path(&pty));
        Ok((Box::new(pty), place))
    }

    fn open_can(&mut self) -> Opened<Can> {
        let group = match self.udp.pop_front() {
            Some(text) => text.parse()?,
            None => Group::default(),
        };
        let link = udp::open(group)?;
        let place = format!("udp://{}", link.describe());
        Ok((Box::new(link), place))
    }

    /// Refuses what no link was there for.
    fn all_used(&self) -> Result<()> {
        match self.pty.len() + self.tcp.len() + self.udp.len() {
            0 => Ok(()),
            left => {
                let what = format!("{left} of --pty, --tcp and --udp found no link to serve.");
                Err(Problem::usage("E244", what)
                    .hint("a serial link takes --pty or --tcp, a CAN bus --udp"))
            }
        }
    }
}

type Opened<M> = std::result::Result<(Box<dyn Link<M>>, String), LinkError>;

fn path(pty: &Pty) -> String {
    let path = std::path::absolute(pty.path()).unwrap_or_else(|_| pty.path().into());
    path.display().to_string()
}

/// The wire as its drives see it where time passes faster for them.
fn scaled<M: Medium>(wire: Box<dyn Link<M>>, speed: f64) -> Box<dyn Link<M>> {
    match speed {
        1.0 => wire,
        speed => Box::new(Scaled { inner: wire, speed }),
    }
}

/// A wire on which time passes faster.
struct Scaled<M: Medium> {
    inner: Box<dyn Link<M>>,
    speed: f64,
}

impl<M: Medium> Scaled<M> {
    fn fast(&self, real: Instant) -> Instant {
        Instant((real.0 as f64 * self.speed) as u64)
    }

    fn real(&self, fast: Instant) -> Instant {
        if fast == Instant::FAR { fast } else { Instant((fast.0 as f64 / self.speed) as u64) }
    }
}

impl<M: Medium> Link<M> for Scaled<M> {
    fn now(&self) -> Instant {
        self.fast(self.inner.now())
    }

    fn send(&self, unit: &M::Unit) -> std::result::Result<(), LinkError> {
        self.inner.send(unit)
    }

    fn receive(
        &self,
        buffer: &mut M::Out,
        until: Instant,
    ) -> std::result::Result<Received, LinkError> {
        Ok(match self.inner.receive(buffer, self.real(until))? {
            Received::Bytes { len, at } => Received::Bytes { len, at: self.fast(at) },
            other => other,
        })
    }

    fn set_line(&self, line: M::Line) -> std::result::Result<(), LinkError> {
        self.inner.set_line(line)
    }

    fn waker(&self) -> Waker {
        self.inner.waker()
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }
}
