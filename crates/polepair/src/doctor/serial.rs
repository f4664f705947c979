//! Checks of a serial line: noise, baud rate, echo.

use super::{CheckResult, DoctorOptions, UNITS_MAX};
use crate::connect::Connector;
use crate::error::{Error, Exit};
use crate::identify::{ProbeResult, Prober};
use crate::protocol_line::ProtocolLine;
use crate::search::{BAUD_RATES, search};
use crate::url::{LinkTarget, Url};
use crate::wire::CountedLink;
use polepair_core::explain::Dissector;
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::proto;
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;
use polepair_link::tap::{Tap, TapDirection};
use polepair_link::{LinkIo as _, Received};
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex, PoisonError};

/// Time of listening to a line at each baud rate.
const LISTEN_MS: u32 = 300;

/// Listens without sending, and reports silence or noise.
pub(super) fn check_noise(
    link: &CountedLink<Stream>,
    line: &ProtocolLine,
    on_event: &mut dyn FnMut(CheckResult),
) -> Result<(), Error> {
    let baud = line.options.baud;
    let (bytes, breaks) = receive_bytes(link)?;
    let dissector = proto::find_dissector(line.protocol.name);
    let good = dissector.map_or(0, |dissector| count_framed_bytes(dissector, &bytes));
    on_event(match (bytes.len(), breaks) {
        (0, 0) => CheckResult::ok("noise", format!("silent for {LISTEN_MS} ms, as it should be")),
        (0, breaks) => {
            let text = format!("{breaks} breaks or framing errors, and no bytes");
            CheckResult::wrong(
                "noise",
                Exit::Corrupt,
                text,
                "A and B swapped, or no bias on the pair",
            )
        }
        (all, _) if good * 2 > all => {
            let text = format!("{all} unsolicited bytes, {good} of them in whole frames");
            let remedy = "another host polls this line, or a drive sends by itself; use one host \
             for each line";
            CheckResult::suspicious("noise", text, remedy)
        }
        (all, _) => {
            let text = format!("{all} unsolicited bytes, {good} of them in whole frames");
            CheckResult::wrong(
                "noise",
                Exit::Corrupt,
                text,
                find_better_rate(link, line, dissector)?,
            )
        }
    });
    if baud > 0 {
        on_event(CheckResult::ok(
            "rate",
            format!("{baud} baud, from the connection string, or the factory setting"),
        ));
    }
    Ok(())
}

/// Listens at other baud rates, and reports a rate with valid frames.
fn find_better_rate(
    link: &CountedLink<Stream>,
    line: &ProtocolLine,
    dissector: Option<&'static dyn Dissector>,
) -> Result<String, Error> {
    let mut best = (0, 0);
    for &rate in
        BAUD_RATES.iter().filter(|rate| line.options.baud > 0 && **rate != line.options.baud)
    {
        link.set_line(SerialLine::new_8n1(rate))?;
        let (bytes, _) = receive_bytes(link)?;
        let good = dissector.map_or(0, |dissector| count_framed_bytes(dissector, &bytes));
        if good * 2 > bytes.len() && good > best.0 {
            best = (good, rate);
        }
    }
    link.set_line(SerialLine::new_8n1(line.options.baud))?;
    Ok(match best {
        (0, _) => "noise or another protocol: shield, common ground, terminators, no other host \
                   on the line"
            .to_owned(),
        (_, rate) => format!("at {rate} baud frames are complete: write `:{rate}` after the port"),
    })
}

/// Bytes received within a while, and the number of breaks.
fn receive_bytes(link: &CountedLink<Stream>) -> Result<(Vec<u8>, usize), Error> {
    let until = link.now().plus_ms(LISTEN_MS);
    let (mut bytes, mut breaks, mut buffer) = (Vec::new(), 0, [0; 256]);
    for _ in 0..UNITS_MAX {
        match link.receive(&mut buffer, until)? {
            Received::TimedOut => break,
            Received::Bytes { len, .. } => bytes.extend_from_slice(&buffer[..len]),
            Received::Line { event: LineEvent::Break, .. } => breaks += 1,
            Received::Line { .. } | Received::Woken => {}
        }
    }
    Ok((bytes, breaks))
}

/// Checks whether a drive without valid replies is in a text mode: it is polled in this mode, and the
/// result states how to end it. Returns whether there is one.
pub(super) fn check_text_mode(
    link: &CountedLink<Stream>,
    line: &ProtocolLine,
    numbers: &[u32],
    on_event: &mut dyn FnMut(CheckResult),
) -> Result<bool, Error> {
    let Some(dissector) = proto::find_dissector(line.protocol.name) else { return Ok(false) };
    for number in numbers {
        let (mut query, mut exit) = (String::new(), String::new());
        let known =
            dissector.write_text_mode(*number, &mut |piece| query.push_str(piece), &mut |piece| {
                exit.push_str(piece)
            });
        if !known {
            continue;
        }
        // What the drive has taken for the beginning of a line ends with the first of these.
        link.send(b"\r")?;
        receive_bytes(link)?;
        link.send(format!("{query}\r").as_bytes())?;
        let (bytes, _) = receive_bytes(link)?;
        if bytes.split(|byte| *byte == b'\r').any(|line| answers_in_text(dissector, line)) {
            let remedy = format!(
                "send it the line `{exit}` with a carriage return from a terminal, or switch it \
                 off and on; \
                 if it returns at power-up, `ascii mode` (GP 67) is set"
            );
            let text = "is in ASCII mode: it answers lines of text";
            on_event(CheckResult::wrong(&format!("axis {number}"), Exit::NoReply, text, remedy));
            return Ok(true);
        }
    }
    Ok(false)
}

/// An answer, also behind the characters that a drive echoes.
fn answers_in_text(dissector: &dyn Dissector, line: &[u8]) -> bool {
    (0..line.len()).any(|at| dissector.is_text_answer(&line[at..]))
}

/// Number of bytes in frames whose check agrees.
fn count_framed_bytes(dissector: &dyn Dissector, mut bytes: &[u8]) -> usize {
    let mut good = 0;
    while !bytes.is_empty() {
        let whole = dissector.valid_frame_len(bytes, None).filter(|len| *len > 0);
        good += whole.unwrap_or(0);
        bytes = &bytes[whole.unwrap_or(1).min(bytes.len())..];
    }
    good
}

/// Records sent and received bytes to detect an echo of the adapter.
#[derive(Clone, Default)]
pub(super) struct EchoDetector(Arc<Mutex<(Vec<u8>, Vec<u8>)>>);

impl Tap<Stream> for EchoDetector {
    fn record_unit(&mut self, _: Instant, direction: TapDirection, bytes: &[u8]) {
        let mut stored = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (sent, received) = &mut *stored;
        match direction {
            TapDirection::ToDrive if sent.is_empty() => sent.extend_from_slice(bytes),
            TapDirection::ToHost if !sent.is_empty() && received.len() < sent.len() => {
                received.extend_from_slice(bytes);
            }
            TapDirection::ToDrive | TapDirection::ToHost => {}
        }
    }
}

impl EchoDetector {
    /// Watches the line from now on.
    pub(super) fn attach(line: &mut ProtocolLine) -> Self {
        let echo = Self::default();
        line.link = line.link.with_tap(echo.clone());
        echo
    }

    /// Returns whether own bytes come back; `None` if nothing was received.
    fn echo_seen(&self) -> Option<bool> {
        let stored = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (sent, received) = &*stored;
        (!received.is_empty()).then(|| !sent.is_empty() && received.starts_with(sent))
    }

    /// Returns whether the host counts on another kind of adapter than this one.
    pub(super) fn differs_from_options(&self, line: &ProtocolLine) -> bool {
        self.echo_seen().is_some_and(|echo| echo != line.options.echo)
    }

    pub(super) fn check_result(&self, line: &ProtocolLine) -> CheckResult {
        match (self.echo_seen(), line.options.echo) {
            (None, _) => {
                let remedy = "to test the adapter alone, unplug the drive and connect TX to RX: \
                 sent bytes must return";
                CheckResult::suspicious(
                    "echo",
                    "no reply, so the adapter's echo is unknown",
                    remedy,
                )
            }
            (Some(false), false) => CheckResult::ok("echo", "sent bytes do not return"),
            (Some(true), true) => CheckResult::ok("echo", "sent bytes return, as expected"),
            (Some(true), false) => {
                let remedy = "add `echo=yes` to the connection string, or switch the adapter's \
                 echo off";
                CheckResult::wrong("echo", Exit::Negative, "sent bytes return", remedy)
            }
            (Some(false), true) => {
                let remedy = "remove `echo=yes` from the connection string";
                CheckResult::wrong("echo", Exit::Negative, "sent bytes do not return", remedy)
            }
        }
    }
}

/// Asks by reads at other baud rates, if that is wanted.
pub(super) fn check_other_rates(
    connector: &Connector,
    url: &Url,
    options: DoctorOptions,
) -> Result<CheckResult, Error> {
    let LinkTarget::Serial { path, baud } = &url.target else {
        return Ok(CheckResult::ok("other rates", "the far end has the baud rate"));
    };
    if !options.try_bauds {
        let text = "tried one baud rate only";
        return Ok(CheckResult::suspicious(
            "other rates",
            text,
            "--try-bauds tries the others, by reads",
        ));
    }
    let mut tried = Vec::new();
    let protocol = url.protocol_info()?;
    let is_other = |rate: &&u32| Some(**rate) != *baud && protocol.has_rate(**rate);
    for &rate in BAUD_RATES.iter().filter(is_other) {
        let mut other = url.clone();
        other.target = LinkTarget::Serial { path: path.clone(), baud: Some(rate) };
        // An adapter that cannot do a rate refuses here.
        let Ok((lines, _)) = connector.open_lines(&other) else { continue };
        for line in &lines {
            let number =
                line.axis_numbers.first().copied().unwrap_or(*line.protocol.addresses.start());
            let probe = Prober::new(line, &connector.config).scanning().probe(number)?;
            if matches!(probe, ProbeResult::Found { .. }) {
                let output = format!("axis {number} answers at {rate} baud");
                let remedy = format!("write `:{rate}` after the port");
                return Ok(CheckResult::wrong("other rates", Exit::NoReply, output, remedy));
            }
        }
        tried.push(rate);
    }
    // The drive may be another one than in the connection string.
    let report = search(connector, std::slice::from_ref(path), &mut |_| ControlFlow::Continue(()))?;
    if let Some(link) = report.links.first() {
        let number = link.drives.first().map_or(0, |drive| drive.number);
        let output = format!("axis {number} answers to another protocol: {}", link.url);
        let remedy = format!("use {}#{number}", link.url);
        return Ok(CheckResult::wrong("other rates", Exit::NoReply, output, remedy));
    }
    let output = format!(
        "no drive replies at {} baud either, and none to another protocol",
        super::join_numbers(&tried)
    );
    Ok(CheckResult::wrong("other rates", Exit::NoReply, output, "check power, wiring and address"))
}

#[cfg(test)]
mod tests {
    use super::count_framed_bytes;
    use polepair_core::proto;

    #[test]
    fn frames_are_distinguished_from_noise() {
        let Some(tmcl) = proto::find_dissector("tmcl") else { return };
        let frame = [0x01, 0x01, 0, 0, 0, 0, 0x01, 0x5E, 0x61];
        let noisy = [&[0xFF, 0x00][..], &frame, &[0x55], &frame].concat();
        assert_eq!(count_framed_bytes(tmcl, &noisy), 18);
        assert_eq!(count_framed_bytes(tmcl, &[0x55; 40]), 0);
    }
}
