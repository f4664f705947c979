//! Checks of a CAN bus: bit rate, errors, active senders.

use super::{CheckResult, UNITS_MAX};
use crate::bus::LOAD_MAX;
use crate::error::{Error, Exit};
use crate::protocol_line::ProtocolLine;
use crate::registry::{self, SenderDetector};
use crate::url::{LinkTarget, Url};
use crate::wire::CountedLink;
use polepair_core::medium::{Can, Frame, MediumKind};
use polepair_core::station::LineEvent;
use polepair_link::{LinkIo as _, Received};
use polepair_sim::can_bus::bits;

/// Time of listening to a bus.
const LISTEN_MS: u32 = 500;
/// Speakers that are named at most.
const SENDERS_SHOWN_MAX: usize = 12;
const TERMINATION: &str = "termination: 120 ohm at both ends, 60 between CAN-H and CAN-L with \
 power \
                           off; one bit rate for all; power off before plugging a drive's \
                           connector";

const MULTICAST: &str = "use one group and port for all devices of this bus, and a network that \
 forwards multicast";

/// Frames received during the observation.
#[derive(Default)]
struct BusSample {
    frames: Vec<Frame>,
    bus_off: bool,
}

/// Listens without sending.
pub(super) fn check_traffic(
    link: &CountedLink<Can>,
    line: &ProtocolLine,
    url: &Url,
    on_event: &mut dyn FnMut(CheckResult),
) -> Result<(), Error> {
    let rate = bit_rate(line, url);
    on_event(match rate {
        0 => CheckResult::ok("bit rate", "this bus has no bit timing"),
        rate => CheckResult::ok("bit rate", format!("{rate} bit/s")),
    });
    // The counters of the interface are as old as its last start.
    let before = link.losses();
    let bus_sample = record_frames(link)?;
    let losses = link.losses();
    let errors = losses.errors - before.errors;
    on_event(match (bus_sample.bus_off, errors, bus_sample.frames.len()) {
        (true, ..) => {
            CheckResult::wrong("errors", Exit::Corrupt, "the controller went bus-off", TERMINATION)
        }
        (false, 1.., _) => {
            let text = format!("{errors} error frames in {LISTEN_MS} ms");
            CheckResult::wrong("errors", Exit::Corrupt, text, TERMINATION)
        }
        (false, 0, 0) => {
            let remedy =
                if matches!(url.target, LinkTarget::Udp { .. }) { MULTICAST } else { TERMINATION };
            CheckResult::suspicious("traffic", format!("silent for {LISTEN_MS} ms"), remedy)
        }
        (false, 0, count) => CheckResult::ok("traffic", format!("{count} frames without an error")),
    });
    if rate > 0 && !bus_sample.frames.is_empty() {
        let bits: u32 = bus_sample.frames.iter().map(bits::wire_bits).sum();
        debug_assert!(bits > 0);
        let busy = f64::from(bits) * 1000.0 / f64::from(LISTEN_MS) / f64::from(rate);
        let text = format!("{:.1} % of the bus", busy * 100.0);
        on_event(if busy > LOAD_MAX {
            CheckResult::suspicious("load", text, "poll less often, or use a higher bit rate")
        } else {
            CheckResult::ok("load", text)
        });
    }
    for (who, count) in count_senders(line, &bus_sample.frames).into_iter().take(SENDERS_SHOWN_MAX)
    {
        on_event(CheckResult::ok("received", format!("{who}: {count} frames")));
    }
    Ok(())
}

/// The bus' bit rate as far as anybody here knows it.
fn bit_rate(line: &ProtocolLine, url: &Url) -> u32 {
    #[cfg(target_os = "linux")]
    if let LinkTarget::Socketcan { interface } = &url.target {
        let known = polepair_link::socketcan::interfaces();
        let known = known.into_iter().find(|one| one.name == *interface);
        return known.and_then(|one| one.bit_rate).unwrap_or(0);
    }
    match url.target {
        LinkTarget::Udp { .. } => 0,
        _ => line.options.bit_rate,
    }
}

fn record_frames(link: &CountedLink<Can>) -> Result<BusSample, Error> {
    let until = link.now().plus_ms(LISTEN_MS);
    let (mut bus_sample, mut frame) = (BusSample::default(), Frame::default());
    for _ in 0..UNITS_MAX {
        match link.receive(&mut frame, until)? {
            Received::TimedOut => break,
            Received::Bytes { .. } => bus_sample.frames.push(frame),
            Received::Line { event: LineEvent::BusOff, .. } => bus_sample.bus_off = true,
            Received::Line { .. } | Received::Woken => {}
        }
    }
    Ok(bus_sample)
}

/// Senders of the frames, by the first protocol that knows them: that of the string goes first.
fn count_senders(line: &ProtocolLine, frames: &[Frame]) -> Vec<(String, usize)> {
    let on_can = registry::protocols().into_iter().filter(|p| p.medium == MediumKind::Can);
    let mut names: Vec<&str> = on_can.map(|protocol| protocol.name).collect();
    // Several protocols share identifiers; the one of the connection string is taken first.
    names.sort_by_key(|name| *name != line.protocol.name);
    let listeners: Vec<_> =
        names.iter().map(|name| (*name, SenderDetector::new(name, line.options))).collect();
    let mut found: Vec<(String, usize)> = Vec::new();
    for frame in frames {
        let who = listeners.iter().find_map(|(name, listener)| {
            listener.sender(frame).map(|number| format!("{name} {number}"))
        });
        let who = who.unwrap_or_else(|| format!("id {:X}, unknown device", frame.id));
        match found.iter_mut().find(|(other, _)| *other == who) {
            Some((_, count)) => *count += 1,
            None => found.push((who, 1)),
        }
    }
    found.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    found
}
