//! Settings of host and port from the keys of a connection string.

use crate::error::Error;
use crate::registry::{self, ProtocolInfo};
use crate::url::{LinkTarget, Url};
use polepair_core::convert::saturating;
use polepair_core::medium::{Parity, SerialLine, Stream};
use polepair_core::proto::HostOptions;
use polepair_link::clock;

/// Replies to an earlier program may be pending; each session draws its own probes.
const IN_DOUBT: Option<u32> = Some(0);
/// Time that a serial server and the network may take for each step of a resynchronisation, ms.
const TCP_PAUSE_MS: u32 = 100;

/// The host's settings that every kind of link has.
pub(super) fn host_options(
    url: &Url,
    protocol: &ProtocolInfo,
    baud: u32,
) -> Result<HostOptions, Error> {
    let is_virtual = url.key("time") == Some("virtual");
    let mut options = HostOptions {
        // On a pty or TCP, silence does not separate frames.
        gap_us: (baud == 0).then_some(0),
        untimed: !has_timing(url)?,
        echo: url.flag("echo")?,
        timeout_scale: if is_virtual { 1 } else { clock::timeout_scale() },
        ..HostOptions::new(baud)
    };
    url.apply_keys(protocol, &mut options)?;
    Ok(options)
}

/// The host's settings on a link of the operating system.
pub(super) fn wire_options(url: &Url, protocol: &ProtocolInfo) -> Result<HostOptions, Error> {
    let rate = rate_key(url, "bitrate")?;
    let (baud, bit_rate) = match &url.target {
        LinkTarget::Serial { path, .. } if is_pty(path) => (0, 0),
        // Behind these there may be no bus, and so no least time for a frame.
        LinkTarget::Slcan { path, .. } if is_pty(path) => (0, 0),
        LinkTarget::SlcanTcp { .. } => (0, 0),
        LinkTarget::Serial { baud, .. } => (baud.unwrap_or(protocol.baud), 0),
        LinkTarget::Slcan { .. } => (0, rate.unwrap_or(protocol.baud)),
        _ => (0, rate.unwrap_or(0)),
    };
    let options = match url.target {
        LinkTarget::Tcp { .. } => host_options_on_network(url, protocol)?,
        _ => host_options(url, protocol, baud)?,
    };
    let port_baud = match url.target {
        LinkTarget::Serial { baud, .. } => baud.unwrap_or(protocol.baud),
        _ => 0,
    };
    Ok(HostOptions { bit_rate, port_baud, probe_seed: IN_DOUBT, ..options })
}

/// The host's settings behind a serial server, real or simulated.
pub(super) fn host_options_on_network(
    url: &Url,
    protocol: &ProtocolInfo,
) -> Result<HostOptions, Error> {
    let options = host_options(url, protocol, 0)?;
    let resync_pause_ms = options.resync_pause_ms.or(Some(TCP_PAUSE_MS));
    Ok(HostOptions { resync_pause_ms, serial_server: true, ..options })
}

pub(super) fn rate_key(url: &Url, key: &str) -> Result<Option<u32>, Error> {
    Ok(url.number(key)?.map(saturating))
}

/// Settings of the port: those of the protocol, unless the string has others.
pub(super) fn serial_line(
    url: &Url,
    protocol: &ProtocolInfo,
    options: HostOptions,
    baud: u32,
) -> Result<SerialLine, Error> {
    let lane = registry::build_lane::<Stream>(protocol.name, options, &[]);
    let mut line = lane.map_or(SerialLine::new_8n1(baud), |lane| lane.line());
    line.baud = baud;
    match url.key("parity") {
        None => {}
        Some("none") => line.parity = Parity::None,
        Some("even") => line.parity = Parity::Even,
        Some("odd") => line.parity = Parity::Odd,
        Some(other) => {
            let what = format!("`parity={other}` is not `none`, `even` or `odd`");
            return Err(Error::usage("E210", what, ""));
        }
    }
    match url.number("bits")? {
        None | Some(8) => {}
        Some(7) if protocol.is_ascii => line.data_bits = 7,
        Some(7) => {
            let what = format!("`bits=7`: {} needs all eight bits of a byte", protocol.name);
            return Err(Error::usage("E210", what, "7 data bits are for Modbus ASCII"));
        }
        Some(_) => return Err(Error::usage("E210", "`bits` must be 7 or 8", "")),
    }
    match url.number("stop")? {
        None => {}
        Some(bits @ (1 | 2)) => line.stop_bits = if bits == 1 { 1 } else { 2 },
        Some(_) => return Err(Error::usage("E210", "`stop` must be 1 or 2", "")),
    }
    Ok(line)
}

/// Returns whether bytes take the time of the baud rate. `timing=off` and drivers of USB CDC switch this off; the baud
/// rate is set in any case.
fn has_timing(url: &Url) -> Result<bool, Error> {
    match (url.key("timing"), &url.target) {
        (None, LinkTarget::Serial { path, .. }) => Ok(!polepair_link::has_no_baud_rate(path)),
        (None | Some("uart"), _) => Ok(true),
        (Some("off"), _) => Ok(false),
        // What the simulated port is like.
        (Some(_), LinkTarget::Sim { .. }) => Ok(true),
        (Some(other), _) => {
            let what = format!("`timing={other}` is not `off` or `uart`");
            let hint = "off: replies may arrive sooner than the baud rate allows; uart: they do \
             not";
            Err(Error::usage("E210", what, hint))
        }
    }
}

/// A pseudo-terminal has no timing, whatever its name looks like.
fn is_pty(path: &str) -> bool {
    let real = std::fs::canonicalize(path);
    real.is_ok_and(|real| real.starts_with("/dev/pts") || real.starts_with("/dev/ttys"))
}

#[cfg(test)]
mod tests {
    use super::{HostOptions, Url, host_options, wire_options};
    use crate::registry;

    #[test]
    fn a_port_without_timing_is_no_clock_for_the_host() {
        let baud = |text: &str| {
            let url: Url = format!("tmcl+serial:///dev/ttyS0?{text}").parse()?;
            let protocol =
                registry::find_protocol("tmcl", polepair_core::medium::MediumKind::Serial).unwrap();
            wire_options(&url, &protocol).map(|options| (options.baud, options.untimed))
        };
        assert_eq!(baud("timing=uart").unwrap(), (9600, false));
        assert_eq!(baud("timing=off").unwrap(), (9600, true), "the port is set to it all the same");
        assert!(baud("timing=of").is_err());
    }

    #[test]
    fn a_gap_is_a_time_or_three_and_a_half_characters() {
        let gap = |text: &str| {
            let url: Url = format!("modbus-rtu+serial:///dev/ttyS0?gap={text}").parse()?;
            let protocol = url.protocol_info().unwrap();
            host_options(&url, &protocol, 115_200).map(|options| options.gap_us)
        };
        assert_eq!(gap("3.5c").unwrap(), Some(HostOptions::GAP_CHARACTERS));
        assert_eq!(gap("2ms").unwrap(), Some(2_000));
        assert!(gap("3.5 parsecs").is_err());
    }
}
