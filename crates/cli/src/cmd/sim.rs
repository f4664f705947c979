//! `polepair sim RACK.toml | PROTO[:ADDRESS…] [--pty PATH] [--tcp ADDR] [--seed N] [--speed X]`

use std::path::{Path, PathBuf};

use clap::Args;
use polepair::simulate::{self, Description, DriveLine, FaultyLine};
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::proto::{self, Protocol};
use polepair_core::time::Instant;
use polepair_link::serve::Served;
use polepair_link::{Link, LinkError, Received, Waker, pty::Pty, tcp::TcpServer};

use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::Output;

/// Simulates drives that any program can talk to, until Ctrl-C.
///
/// One line `ready URL` is printed for each link as soon as it can be used. Drives are as from the
/// factory. Every link gets a pseudo-terminal, unless --tcp gives it a port.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair sim tmcl                              ready tmcl+serial:///dev/pts/3#1
  polepair sim tmcl:1,2 --pty /tmp/drives        two drives on one line
  polepair sim modbus-rtu:1 --tcp 127.0.0.1:4001
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
        let links = description.rack.links.len();
        if self.pty.len() + self.tcp.len() > links {
            let what = format!("there are more --pty and --tcp than links ({links}).");
            return Err(Problem::usage("E244", what));
        }
        let mut served = Vec::new();
        let mut out = Output::stdout();
        for link in 0..links {
            let (wire, place) = self.open(link)?;
            let wire: Box<dyn Link<Stream>> = match self.speed {
                1.0 => wire,
                speed => Box::new(Scaled { inner: wire, speed }),
            };
            served.push(self.serve(&description, link, wire)?);
            out.line(&format!("ready {}", url(&description, link, &place)));
        }
        let stops: Vec<_> = served.iter().map(Served::stop).collect();
        crate::interrupt::listen(move || stops.iter().for_each(polepair_link::Stop::stop));
        out.flush()?;
        served
            .into_iter()
            .try_for_each(Served::wait)
            .map_err(|error| outcome::link_error(&error))?;
        Ok(Exit::Ok)
    }

    /// Serves a link's drives; a wire with faults is a world of its own.
    fn serve(
        &self,
        description: &Description,
        link: usize,
        wire: Box<dyn Link<Stream>>,
    ) -> Result<Served> {
        if description.is_faultless(link) {
            let line = DriveLine::new(description, link).map_err(outcome::error)?;
            return Ok(Served::new(wire, Box::new(line)));
        }
        let line = FaultyLine::new(description, link, self.seed).map_err(outcome::error)?;
        Ok(Served::new(wire, Box::new(line)))
    }

    fn description(&self) -> Result<Description> {
        let words: Vec<&str> = self.drives.iter().map(String::as_str).collect();
        let described = match words[..] {
            [file] if file.ends_with(".toml") => simulate::rack_of_file(Path::new(file), self.seed),
            _ => simulate::rack_of_words(&words, self.seed),
        };
        described.map_err(outcome::error)
    }

    /// The wire of a link, and where others find it.
    fn open(&self, link: usize) -> Result<(Box<dyn Link<Stream>>, String)> {
        let problem = |error: LinkError| outcome::link_error(&error);
        let tcp = link.checked_sub(self.pty.len()).and_then(|at| self.tcp.get(at));
        if let Some(address) = tcp {
            let server = TcpServer::bind(address).map_err(problem)?;
            let place = format!("tcp://{}", server.address());
            return Ok((Box::new(server), place));
        }
        let pty = Pty::open(self.pty.get(link).map(PathBuf::as_path)).map_err(problem)?;
        let path = std::path::absolute(pty.path()).unwrap_or_else(|_| pty.path().into());
        let place = format!("serial://{}", path.display());
        Ok((Box::new(pty), place))
    }
}

/// The connection string of a simulated link.
pub fn url(description: &Description, link: usize, place: &str) -> String {
    let protocol = description.wires[link].protocol;
    let first = first_address(protocol);
    let drives = &description.rack.links[link].drives;
    let addresses = drives.iter().map(|drive| drive.address.unwrap_or(first).to_string());
    let host = description.host(link).map(|host| format!("?host={host}")).unwrap_or_default();
    format!("{protocol}+{place}{host}#{}", addresses.collect::<Vec<_>>().join(","))
}

/// The address that drives of a protocol have from the factory.
fn first_address(protocol: &str) -> u32 {
    struct First<'a>(&'a str, u32);
    impl proto::Visitor for First<'_> {
        fn protocol<P: Protocol>(&mut self) {
            if P::NAME == self.0 {
                self.1 = *P::ADDRESSES.start();
            }
        }
    }
    let mut first = First(protocol, 1);
    proto::visit(&mut first);
    first.1
}

/// A wire on which time passes faster.
struct Scaled {
    inner: Box<dyn Link<Stream>>,
    speed: f64,
}

impl Scaled {
    fn fast(&self, real: Instant) -> Instant {
        Instant((real.0 as f64 * self.speed) as u64)
    }

    fn real(&self, fast: Instant) -> Instant {
        if fast == Instant::FAR { fast } else { Instant((fast.0 as f64 / self.speed) as u64) }
    }
}

impl Link<Stream> for Scaled {
    fn now(&self) -> Instant {
        self.fast(self.inner.now())
    }

    fn send(&self, unit: &[u8]) -> std::result::Result<(), LinkError> {
        self.inner.send(unit)
    }

    fn receive(
        &self,
        buffer: &mut [u8],
        until: Instant,
    ) -> std::result::Result<Received, LinkError> {
        Ok(match self.inner.receive(buffer, self.real(until))? {
            Received::Bytes { len, at } => Received::Bytes { len, at: self.fast(at) },
            other => other,
        })
    }

    fn set_line(&self, line: SerialLine) -> std::result::Result<(), LinkError> {
        self.inner.set_line(line)
    }

    fn waker(&self) -> Waker {
        self.inner.waker()
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }
}
