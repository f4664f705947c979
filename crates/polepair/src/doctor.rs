//! Checks a link from the cable to the drive. Each check has a result and a suggestion.
//!
//! The checks open the link, listen, and read. They move and write nothing, except [`prove_watchdog`], which
//! turns a motor.
//!
//! ```
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use polepair::doctor::{Grade, DoctorOptions, check_link};
//! let connector = polepair::Connector::default();
//! let mut checks = Vec::new();
//! check_link(&connector, "sim:tmcl?time=virtual", DoctorOptions::default(), &mut |check| checks.push(check))?;
//! assert!(checks.iter().all(|check| check.grade != Grade::Wrong));
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod bus;
mod drive;
mod machine;
mod objects;
mod serial;
mod watchdog_proof;

use crate::connect::Connector;
use crate::duplicate_address::{
    DUPLICATE_ADDRESS_HINT, duplicate_address_text, stray_answers_text,
};
use crate::error::{Error, Exit};
use crate::identify::{ProbeResult, Prober};
use crate::protocol_line::ProtocolLine;
use crate::scan::{self, DetectedDrive};
use crate::url::{AxisNumber, LinkTarget, Url};
use crate::wire::SharedLink;
pub use drive::{ABSENT_TEXT, is_absent_error, read_watchdog};
pub use machine::check_machine;
pub use watchdog_proof::{ProofError, ProofObserver, prove_watchdog, proving_speed};

/// Addresses that are asked in text at most.
const TEXT_PROBES_MAX: usize = 3;
/// Addresses that are asked where the string names none.
const UNNAMED_PROBES_MAX: usize = 8;
/// Bytes or frames that one check listens to at most.
const UNITS_MAX: usize = 20_000;

/// Grade of a check.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Grade {
    /// The result is good.
    Ok,
    /// The result may be intended: it needs a look.
    Suspicious,
    /// The result is an error: it cannot work.
    Wrong,
}

impl Grade {
    /// The word that people read.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Suspicious => "look",
            Self::Wrong => "wrong",
        }
    }
}

/// One thing that was looked at.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CheckResult {
    /// Subject: `port`, `echo`, `axis 1 faults`.
    pub about: String,
    /// Grade of the result.
    pub grade: Grade,
    /// Finding, in a sentence without full stop.
    pub found: String,
    /// Remedy to try; empty for none.
    pub remedy: String,
    /// Exit code for scripts: [`Exit::Ok`] unless the check failed.
    pub exit: Exit,
}

impl CheckResult {
    fn new(about: &str, grade: Grade, found: impl Into<String>) -> Self {
        let exit = if grade == Grade::Wrong { Exit::Negative } else { Exit::Ok };
        Self { about: about.into(), grade, found: found.into(), remedy: String::new(), exit }
    }

    fn ok(about: &str, found: impl Into<String>) -> Self {
        Self::new(about, Grade::Ok, found)
    }

    fn suspicious(about: &str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { remedy: remedy.into(), ..Self::new(about, Grade::Suspicious, found) }
    }

    fn wrong(about: &str, exit: Exit, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { remedy: remedy.into(), exit, ..Self::new(about, Grade::Wrong, found) }
    }

    fn error(about: &str, error: &Error) -> Self {
        let text = error.to_string();
        // Errors of an axis begin with its label.
        let found = text.strip_prefix(about).and_then(|rest| rest.strip_prefix(": "));
        Self::wrong(about, error.exit(), found.unwrap_or(&text), error.hint())
    }
}

/// Permitted tests.
#[derive(Clone, Copy, Default, Debug)]
pub struct DoctorOptions {
    /// If no drive replies, also try other baud rates, by reads.
    pub try_bauds: bool,
}

/// Checks a link step by step. `hear` gets each result at once. A failed check skips the checks that depend
/// on it.
///
/// # Errors
/// [`Error::Usage`] and [`Error::File`] for an error of the string; nothing was opened.
pub fn check_link(
    connector: &Connector,
    text: &str,
    options: DoctorOptions,
    on_event: &mut dyn FnMut(CheckResult),
) -> Result<(), Error> {
    let url = connector.url(text)?;
    let (mut lines, _simulation) = match connector.open_lines(&url) {
        Ok(opened) => opened,
        Err(error @ (Error::Usage { .. } | Error::File(_))) => return Err(error),
        Err(error) => {
            on_event(CheckResult::error("port", &error));
            return Ok(());
        }
    };
    let mut silent = false;
    let mut received = None;
    for line in &mut lines {
        // Protocols of one bus share its results.
        let first = received.replace(line.wire) != Some(line.wire);
        if first {
            // A port of this machine is had by one program at a time.
            let alone = match url.target {
                LinkTarget::Serial { .. } | LinkTarget::Slcan { .. } => {
                    ", and no other program \
                 has it"
                }
                _ => "",
            };
            on_event(CheckResult::ok("port", format!("{} opens{alone}", line.link.describe())));
        }
        if let Err(error) = check_line(connector, &url, line, first, &mut silent, on_event) {
            on_event(CheckResult::error("line", &error));
        }
    }
    // The port has to be free for the other rates.
    drop(lines);
    if silent && matches!(url.target, LinkTarget::Serial { .. }) {
        on_event(serial::check_other_rates(connector, &url, options)?);
    }
    Ok(())
}

/// Checks the devices on an open port. `silent` is set if another baud rate may be the reason for a missing
/// reply.
fn check_line(
    connector: &Connector,
    url: &Url,
    line: &mut ProtocolLine,
    first: bool,
    silent: &mut bool,
    on_event: &mut dyn FnMut(CheckResult),
) -> Result<(), Error> {
    let echo = match line.link.clone() {
        SharedLink::Serial(link) => {
            // Before the first request: afterwards noise and replies cannot be separated.
            serial::check_noise(&link, line, on_event)?;
            Some(serial::EchoDetector::attach(line))
        }
        SharedLink::Can(link) => {
            if first {
                bus::check_traffic(&link, line, url, on_event)?;
            }
            None
        }
    };
    let found = find_drives(connector, url, line, on_event)?;
    if found.is_empty()
        && let SharedLink::Serial(link) = line.link.clone()
        && serial::check_text_mode(&link, line, &text_mode_numbers(line)?, on_event)?
    {
        return Ok(());
    }
    if let Some(echo) = echo {
        on_event(echo.check_result(line));
        if found.is_empty() && echo.differs_from_options(line) {
            // The host took its own bytes for answers, or answers for its own bytes.
            // So that the rest of the check works although the connection string is wrong; the finding stays.
            line.options.echo = !line.options.echo;
            return check_found(
                line,
                &find_drives(connector, url, line, on_event)?,
                silent,
                on_event,
            );
        }
    }
    check_found(line, &found, silent, on_event)
}

/// Addresses that are asked in text where no frame was answered.
fn text_mode_numbers(line: &ProtocolLine) -> Result<Vec<u32>, Error> {
    let mut numbers = if line.axis_numbers.is_empty() {
        scan::default_addresses(line)?
    } else {
        line.axis_numbers.clone()
    };
    numbers.retain(|number| !AxisNumber(*number).is_group());
    numbers.truncate(TEXT_PROBES_MAX);
    Ok(numbers)
}

fn check_found(
    line: &ProtocolLine,
    found: &[DetectedDrive],
    silent: &mut bool,
    on_event: &mut dyn FnMut(CheckResult),
) -> Result<(), Error> {
    *silent |= found.is_empty();
    for axis in line.axes_of_found(found)? {
        drive::check_drive(&axis, on_event);
    }
    Ok(())
}

/// Finds drives: at the axes of the string, or at a few usual addresses.
fn find_drives(
    connector: &Connector,
    url: &Url,
    line: &ProtocolLine,
    on_event: &mut dyn FnMut(CheckResult),
) -> Result<Vec<DetectedDrive>, Error> {
    let named = !url.axes.is_empty()
        || matches!(url.target, LinkTarget::Sim { .. } | LinkTarget::Rack { .. });
    let mut wanted = if named { line.axis_numbers.clone() } else { scan::default_addresses(line)? };
    wanted.retain(|number| !AxisNumber(*number).is_group());
    wanted.truncate(if named { wanted.len() } else { UNNAMED_PROBES_MAX });
    let is_can = line.protocol.medium == polepair_core::medium::MediumKind::Can;
    let silent_remedy = if is_can { SILENT_ON_CAN_REMEDY } else { SILENT_REMEDY };
    let chosen = connector.chosen_profile(url, &line.protocol)?;
    let prober = Prober::new(line, &connector.config).scanning();
    let (mut found, mut damaged, mut answers, mut misaddressed) = (Vec::new(), 0, false, None);
    let mut requests = Vec::new();
    for &number in &wanted {
        let about = format!("axis {number}");
        let probe = prober.probe(number)?;
        // If no axis was named, the host's own address is left out.
        if !named && matches!(probe, ProbeResult::Forbidden(_)) {
            continue;
        }
        requests.push(number);
        match probe {
            ProbeResult::Found { profile, identified, stray, .. } => {
                let profile = chosen.unwrap_or(profile);
                let text = format!("answers: {} ({identified})", profile.title);
                on_event(CheckResult::ok(&about, text));
                if let Some(text) = stray_answers_text(stray) {
                    on_event(duplicate_address_check(&about, text));
                }
                found.push(DetectedDrive {
                    identified,
                    ..DetectedDrive::with_known_profile(line, number, profile)
                });
            }
            ProbeResult::Forbidden(hint) => {
                on_event(CheckResult::wrong(
                    &about,
                    Exit::Usage,
                    "cannot be read on this line",
                    hint,
                ));
            }
            ProbeResult::AnsweredTwice => {
                let text = duplicate_address_text(line.protocol.name, number);
                on_event(duplicate_address_check(&about, text));
                answers = true;
            }
            ProbeResult::Damaged(_) => damaged += 1,
            ProbeResult::Silent(details) if named && !details.is_nothing() => {
                let text = format!("does not answer: {details}");
                on_event(CheckResult::wrong(&about, Exit::NoReply, text, details.hint()));
            }
            ProbeResult::Silent(_) if named => {
                on_event(CheckResult::wrong(
                    &about,
                    Exit::NoReply,
                    "does not answer",
                    silent_remedy,
                ));
            }
            ProbeResult::Silent(details) => misaddressed = misaddressed.or(details.other_address),
        }
    }
    if damaged > 0 {
        let text = format!("{damaged} addresses gave damaged replies only");
        on_event(CheckResult::wrong("answers", Exit::Corrupt, text, DAMAGED_REMEDY));
    }
    if found.is_empty() && !named && !answers {
        let numbers = join_numbers(&requests);
        let (text, remedy) = match misaddressed {
            Some(address) => (
                format!(
                    "none of the addresses {numbers} is the drive's: address {address} answers here"
                ),
                format!("use `#{address}`"),
            ),
            None => (
                format!("none of the addresses {numbers} answers"),
                format!("{silent_remedy}; `polepair scan` tries every address"),
            ),
        };
        on_event(CheckResult::wrong("address", Exit::NoReply, text, remedy));
    }
    Ok(found)
}

const SILENT_REMEDY: &str = "the drive's power, A and B (or RX and TX) swapped, the common ground, its address, \
                             the baud rate";
const SILENT_ON_CAN_REMEDY: &str =
    "the drive's power and address; on a cable CAN_H, CAN_L and the bit rate";
const DAMAGED_REMEDY: &str = "another baud rate, two drives with one address, a missing \
 terminator or \
                       common ground; --try-bauds tries other rates";

fn duplicate_address_check(about: &str, text: String) -> CheckResult {
    CheckResult::wrong(about, Exit::Corrupt, text, DUPLICATE_ADDRESS_HINT)
}

fn join_numbers(numbers: &[u32]) -> String {
    numbers.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests;
