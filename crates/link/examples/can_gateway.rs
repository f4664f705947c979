//! Joins two CAN links, so that each receives the frames sent on the other:
//!
//! ```text
//! can_gateway socketcan:vcan0 slcan-pty:/tmp/can
//! can_gateway udp:239.74.163.2 socketcand-listen:29536/can0
//! ```
//!
//! Prints a `ready` line for each once it can be used, and runs until one of them is lost or
//! standard input ends.

#[cfg(not(unix))]
fn main() {}

#[cfg(unix)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    gateway::run()
}

#[cfg(unix)]
mod gateway {
    use std::error::Error;
    use std::io::Read;
    use std::path::Path;
    use std::sync::Arc;
    use std::thread;

    use polepair_core::medium::{Can, CanLine, Frame};
    use polepair_core::time::Instant;
    use polepair_link::pty::Pty;
    use polepair_link::{LinkError, LinkIo, Received, slcan, socketcand, udp};

    type Bus = Arc<dyn LinkIo<Can>>;

    pub(super) fn run() -> Result<(), Box<dyn Error>> {
        let words: Vec<String> = std::env::args().skip(1).collect();
        let [one, other] = &words[..] else { return Err("name two links".into()) };
        let (one, other) = (open(one)?, open(other)?);
        for (from, to) in [(&one, &other), (&other, &one)] {
            println!("ready {}", from.describe());
            let (from, to) = (Arc::clone(from), Arc::clone(to));
            thread::spawn(move || {
                let ended = forward(&*from, &*to);
                eprintln!("{}: {ended:?} {:?}", from.describe(), from.losses());
                std::process::exit(1);
            });
        }
        std::io::stdin().read_to_end(&mut Vec::new())?;
        for bus in [one, other] {
            println!("{}: {:?}", bus.describe(), bus.losses());
        }
        Ok(())
    }

    fn forward(from: &dyn LinkIo<Can>, to: &dyn LinkIo<Can>) -> Result<(), LinkError> {
        let mut frame = Frame::default();
        loop {
            match from.receive(&mut frame, Instant::FAR_FUTURE)? {
                Received::Bytes { .. } => match to.send(&frame) {
                    Err(error) if error.is_gone() => return Err(error),
                    // It cannot be carried there, or no receiver takes it.
                    _ => {}
                },
                Received::Line { event, .. } => println!("{}: {event:?}", from.describe()),
                Received::TimedOut | Received::Woken => {}
            }
        }
    }

    fn open(word: &str) -> Result<Bus, Box<dyn Error>> {
        let (kind, rest) = word.split_once(':').ok_or("a link is KIND:PLACE")?;
        let (location, option) = rest.split_once('?').unwrap_or((rest, ""));
        let number = |text: &str| text.parse::<u32>().unwrap_or(0);
        let line = CanLine { bit_rate: number(option) };
        Ok(match kind {
            "udp" => Arc::new(udp::open(udp::MulticastGroup { hops: 0, ..location.parse()? })?),
            "slcan" => Arc::new(slcan::open_serial(location, 0, line)?),
            "slcan-tcp" => Arc::new(slcan::open_tcp(location, line)?),
            "slcan-pty" => Arc::new(slcan::serve_pty(Pty::open(Some(Path::new(location)))?, line)?),
            "slcan-listen" => Arc::new(slcan::listen(location, line)?),
            "socketcand" => {
                let (address, bus) = location.split_once('/').ok_or("HOST:PORT/BUS")?;
                Arc::new(socketcand::connect(address, bus)?)
            }
            "socketcand-listen" => {
                let (address, bus) = location.split_once('/').ok_or("PORT/BUS")?;
                Arc::new(socketcand::listen(address, bus)?)
            }
            #[cfg(target_os = "linux")]
            "socketcan" => Arc::new(polepair_link::socketcan::open(location, line)?),
            _ => return Err("no such kind of link".into()),
        })
    }
}
