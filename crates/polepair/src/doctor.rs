//! What is wrong, from the cable up: each check one sentence, and what to try.
//!
//! Nothing is moved or written: a link is opened, listened to, and asked by reads. Only
//! [`prove_watchdog`], which nothing else calls, turns a motor.
//!
//! ```
//! # if polepair_core::drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! use polepair::doctor::{Grade, Options, link};
//! let connector = polepair::Connector::default();
//! let mut checks = Vec::new();
//! link(&connector, "sim:tmcl?time=virtual", Options::default(), &mut |check| checks.push(check))?;
//! assert!(checks.iter().all(|check| check.grade != Grade::Wrong));
//! # }
//! # Ok::<(), polepair::Error>(())
//! ```

mod bus;
mod drive;
mod machine;
mod prove;
mod serial;

use crate::connect::{Connector, Line};
use crate::error::{Error, Exit};
use crate::identify::{Probe, Prober};
use crate::scan::{self, Found};
use crate::url::{Number, Target, Url};
use crate::wire::SharedLink;
pub use drive::{ABSENT, says_absent, watchdog_if_any};
pub use machine::machine;
pub use prove::{Unproven, Witness, prove_watchdog, proving_speed};

/// Addresses that are asked where the string names none.
const FEW: usize = 8;
/// Bytes or frames that one check listens to at most.
const HEARD_MAX: usize = 20_000;

/// How a check came out.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Grade {
    /// As it should be.
    Ok,
    /// It may be meant so: look at it.
    Look,
    /// So it cannot work.
    Wrong,
}

impl Grade {
    /// The word that people read.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Look => "look",
            Self::Wrong => "wrong",
        }
    }
}

/// One thing that was looked at.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Check {
    /// What: `port`, `echo`, `axis 1 faults`.
    pub about: String,
    /// How it came out.
    pub grade: Grade,
    /// What was found, in a sentence without full stop.
    pub found: String,
    /// What to try; empty where there is nothing to do.
    pub remedy: String,
    /// What a script is told: [`Exit::Ok`] unless it is wrong.
    pub exit: Exit,
}

impl Check {
    fn new(about: &str, grade: Grade, found: impl Into<String>) -> Self {
        let exit = if grade == Grade::Wrong { Exit::Negative } else { Exit::Ok };
        Self { about: about.into(), grade, found: found.into(), remedy: String::new(), exit }
    }

    fn ok(about: &str, found: impl Into<String>) -> Self {
        Self::new(about, Grade::Ok, found)
    }

    fn look(about: &str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { remedy: remedy.into(), ..Self::new(about, Grade::Look, found) }
    }

    fn wrong(about: &str, exit: Exit, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { remedy: remedy.into(), exit, ..Self::new(about, Grade::Wrong, found) }
    }

    fn error(about: &str, error: &Error) -> Self {
        let said = error.to_string();
        // Errors of an axis begin with its label.
        let found = said.strip_prefix(about).and_then(|rest| rest.strip_prefix(": "));
        Self::wrong(about, error.exit(), found.unwrap_or(&said), error.hint())
    }
}

/// What may be tried.
#[derive(Clone, Copy, Default, Debug)]
pub struct Options {
    /// Ask, by reads, at other baud rates too when nobody answers.
    pub try_bauds: bool,
}

/// Looks at a link step by step; `hear` gets each check as soon as it is done. A check that is
/// wrong ends those that stand on it.
///
/// # Errors
/// [`Error::Usage`] and [`Error::File`] when the string itself is wrong: nothing was opened.
pub fn link(
    connector: &Connector,
    text: &str,
    options: Options,
    hear: &mut dyn FnMut(Check),
) -> Result<(), Error> {
    let url = connector.url(text)?;
    let (mut lines, _simulation) = match connector.lines(&url) {
        Ok(opened) => opened,
        Err(error @ (Error::Usage { .. } | Error::File(_))) => return Err(error),
        Err(error) => {
            hear(Check::error("port", &error));
            return Ok(());
        }
    };
    let mut silent = false;
    let mut heard = None;
    for line in &mut lines {
        // Protocols of one bus share what is to be said of it.
        let first = heard.replace(line.wire) != Some(line.wire);
        if first {
            // A port of this machine is had by one program at a time.
            let alone = match url.target {
                Target::Serial { .. } | Target::Slcan { .. } => ", and nobody else has it",
                _ => "",
            };
            hear(Check::ok("port", format!("{} opens{alone}", line.link.describe())));
        }
        if let Err(error) = examine(connector, &url, (line, first), &mut silent, hear) {
            hear(Check::error("line", &error));
        }
    }
    drop(lines);
    if silent {
        hear(serial::other_rates(connector, &url, options)?);
    }
    Ok(())
}

/// What stands on an opened port. `silent` is set where another baud rate may be the reason that
/// nobody answers.
fn examine(
    connector: &Connector,
    url: &Url,
    (line, first): (&mut Line, bool),
    silent: &mut bool,
    hear: &mut dyn FnMut(Check),
) -> Result<(), Error> {
    let echo = match line.link.clone() {
        SharedLink::Serial(link) => {
            serial::listen(&link, line, hear)?;
            Some(serial::Echo::on(line))
        }
        SharedLink::Can(link) => {
            if first {
                bus::listen(&link, line, url, hear)?;
            }
            None
        }
    };
    let found = look_for(connector, url, line, hear)?;
    if let Some(echo) = echo {
        hear(echo.judge(line));
        if found.is_empty() && echo.unlike_expected(line) {
            // The host took its own bytes for answers, or answers for its own bytes.
            line.options.echo = !line.options.echo;
            return after(connector, line, &look_for(connector, url, line, hear)?, silent, hear);
        }
    }
    after(connector, line, &found, silent, hear)
}

fn after(
    connector: &Connector,
    line: &Line,
    found: &[Found],
    silent: &mut bool,
    hear: &mut dyn FnMut(Check),
) -> Result<(), Error> {
    *silent |= found.is_empty() && line.options.baud > 0;
    for axis in connector.axes_found(line, found)? {
        drive::examine(&axis, hear);
    }
    Ok(())
}

/// Who answers: the axes that the string names, or a few addresses where somebody may be.
fn look_for(
    connector: &Connector,
    url: &Url,
    line: &Line,
    hear: &mut dyn FnMut(Check),
) -> Result<Vec<Found>, Error> {
    let named =
        !url.axes.is_empty() || matches!(url.target, Target::Sim { .. } | Target::Rack { .. });
    let mut wanted = if named { line.numbers.clone() } else { scan::everybody(line)? };
    wanted.retain(|number| !Number(*number).is_group());
    wanted.truncate(if named { wanted.len() } else { FEW });
    let chosen = connector.chosen_profile(url, &line.spoken)?;
    let prober = Prober::new(line, &connector.config).looking();
    let (mut found, mut damaged) = (Vec::new(), 0);
    let mut asked = Vec::new();
    for &number in &wanted {
        let about = format!("axis {number}");
        let probe = prober.probe(number)?;
        // Where nobody named it, the host's own address is none that is wanted.
        if !named && matches!(probe, Probe::Forbidden(_)) {
            continue;
        }
        asked.push(number);
        match probe {
            Probe::Found { profile, identified, stray, .. } => {
                let profile = chosen.unwrap_or(profile);
                let said = format!("answers: {} ({identified})", profile.title);
                hear(Check::ok(&about, said));
                if stray > 0 {
                    hear(twice(&about, stray));
                }
                found.push(Found { identified, ..Found::named(line, number, profile) });
            }
            Probe::Forbidden(hint) => {
                hear(Check::wrong(&about, Exit::Usage, "cannot be asked on this line", hint));
            }
            Probe::Damaged(_) => damaged += 1,
            Probe::Silent(heard) if named && !heard.is_nothing() => {
                let said = format!("does not answer: {heard}");
                hear(Check::wrong(&about, Exit::NoReply, said, heard.hint()));
            }
            Probe::Silent(_) if named => {
                hear(Check::wrong(&about, Exit::NoReply, "does not answer", SILENT));
            }
            Probe::Silent(_) => {}
        }
    }
    if damaged > 0 {
        let said = format!("{damaged} addresses gave damaged answers only");
        hear(Check::wrong("answers", Exit::Corrupt, said, DAMAGED));
    }
    if found.is_empty() && !named {
        let said = format!("none of the addresses {} answers", listed(&asked));
        let remedy = format!("{SILENT}; `polepair scan` asks every address");
        hear(Check::wrong("address", Exit::NoReply, said, remedy));
    }
    Ok(found)
}

const SILENT: &str = "the drive's power, A and B (or RX and TX) swapped, the common ground, its \
                      address, the baud or bit rate";
const DAMAGED: &str = "another baud rate, two drives with one address, a missing terminator or \
                       common ground; --try-bauds asks at other rates";

fn twice(about: &str, stray: u64) -> Check {
    let said = format!("{stray} answers too many or damaged: two drives with this address?");
    let remedy = "unplug one drive after the other and look who answers; give each its own address";
    Check::wrong(about, Exit::Corrupt, said, remedy)
}

fn listed(numbers: &[u32]) -> String {
    numbers.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests;
