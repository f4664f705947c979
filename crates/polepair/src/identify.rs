//! Finding out what a drive is, by reads only.

use crate::config::Config;
use crate::connect::Line;
use crate::error::Error;
use crate::heard::Heard;
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::profile::{Access, Ask, Identity, ParameterId, Profile};
use polepair_core::station::{AxisIndex, Counters};
use polepair_core::time::Instant;
use polepair_link::{Connection, LinkError};
use std::fmt;
use std::time::Duration;

/// How long one question may take, with all its repeats.
const QUESTION_MAX: Duration = Duration::from_secs(5);
/// So long drives are asked again what they are by those who bring motors to rest.
pub(crate) const AGAIN_MAX: Duration = Duration::from_secs(3);
/// Products that are asked for at one address at most.
const CANDIDATES_MAX: usize = 64;

/// How an axis came to its profile.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Identified {
    /// The connection string names it: nobody was asked.
    Named,
    /// The drive's answer tells it.
    Asked {
        /// The firmware's version, where the answer tells it.
        firmware: Option<String>,
    },
    /// A group: it cannot be asked and is taken for what the link's first axis is.
    Group,
    /// Something answers, and no profile that is known fits: the protocol's generic one serves.
    Generic,
}

impl fmt::Display for Identified {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Named => f.write_str("named in the connection string"),
            Self::Asked { firmware: Some(firmware) } => write!(f, "firmware {firmware}"),
            Self::Asked { firmware: None } => f.write_str("told by its answer"),
            Self::Group => f.write_str("a group: taken for what the link's first axis is"),
            Self::Generic => f.write_str("not known: served by the protocol's generic profile"),
        }
    }
}

/// Asks drives on one line what they are.
pub(crate) struct Prober<'a> {
    line: &'a Line,
    known: Vec<&'static Profile>,
    candidates: Vec<(&'static Profile, Identity)>,
    patience: Option<Duration>,
    looking: bool,
    broken: &'a dyn Fn() -> bool,
}

/// What one address gave.
#[derive(Clone, Debug)]
pub(crate) enum Probe {
    /// Nobody answered anything: what came instead.
    Silent(Heard),
    /// Only damaged frames came back, and what else there was.
    Damaged(Heard),
    /// The host may not ask there; nothing was sent.
    Forbidden(&'static str),
    /// Somebody is there; doubtful where it is no known drive and an answer was
    /// corrupt or to another question.
    Found { profile: &'static Profile, identified: Identified, stray: u64, doubtful: bool },
}

impl<'a> Prober<'a> {
    pub(crate) fn new(line: &'a Line, config: &Config) -> Self {
        let speaks = |p: &&'static Profile| p.protocol == line.spoken.profile;
        let known: Vec<_> = config.all_profiles().filter(speaks).collect();
        let candidates = known.iter().filter_map(|p| Some((*p, p.identity?)));
        let candidates = candidates.take(CANDIDATES_MAX).collect();
        Self { line, known, candidates, patience: None, looking: false, broken: &|| false }
    }

    /// Asks for one product alone: whoever is another is served by the generic profile.
    pub(crate) fn expecting(mut self, profile: &'static Profile) -> Self {
        self.candidates =
            profile.identity.map(|identity| (profile, identity)).into_iter().collect();
        self
    }

    /// Waits for each answer at most so long, whatever the host would.
    pub(crate) fn patient(mut self, patience: Option<Duration>) -> Self {
        self.patience = patience;
        self
    }

    /// Takes silence for an empty address without trying twice: most are.
    pub(crate) fn looking(mut self) -> Self {
        self.looking = true;
        self
    }

    /// Asks nothing more once `broken` says so; what was not found out by then is silence.
    pub(crate) fn until(mut self, broken: &'a dyn Fn() -> bool) -> Self {
        self.broken = broken;
        self
    }

    /// What is at the address, or that nobody is.
    pub(crate) fn identify(&self, number: u32) -> Result<(&'static Profile, Identified), Error> {
        match self.probe(number)? {
            Probe::Found { doubtful: true, .. } => Err(self.confused(number)),
            Probe::Found { profile, identified, .. } => Ok((profile, identified)),
            Probe::Forbidden(hint) => Err(self.forbidden(number, hint)),
            Probe::Silent(heard) | Probe::Damaged(heard) => Err(self.silent(number, heard)),
        }
    }

    /// The error for an address that the host may not ask.
    pub(crate) fn forbidden(&self, number: u32, hint: &str) -> Error {
        let what = format!("axis {number} cannot be asked on {}", self.describe());
        Error::usage("E222", what, hint)
    }

    /// The error for an address where nobody answers.
    pub(crate) fn silent(&self, number: u32, heard: Heard) -> Error {
        let but = if heard.is_nothing() { String::new() } else { format!(": {heard}") };
        Error::Failed {
            what: format!("axis {number} does not answer on {}{but}", self.describe()),
            went: String::new(),
            outcome: Outcome::NotDone(Failure::Silent),
            heard: Box::new(heard),
            may_turn: false,
            hint: heard.hint().into(),
        }
    }

    /// The same error for those who bring motors to rest: who names the drive needs no answer.
    pub(crate) fn naming(&self, error: Error) -> Error {
        let Error::Failed { what, went, outcome, heard, may_turn, hint } = error else {
            return error;
        };
        let names: Vec<&str> = self.known.iter().map(|profile| profile.name).collect();
        let hint = format!("say what it is by `?profile=`: {}; {hint}", names.join(", "));
        Error::Failed { what, went, outcome, heard, may_turn, hint }
    }

    /// The profiles of drives that speak the line's protocol.
    pub(crate) fn known(&self) -> &[&'static Profile] {
        &self.known
    }

    /// The error for an address where nothing that comes fits what was asked.
    pub(crate) fn confused(&self, number: u32) -> Error {
        let what = format!(
            "axis {number} cannot be identified on {}: what came was corrupt or answered other questions",
            self.describe()
        );
        let hint = "look for two drives with one address, a second host, late answers (`?timeout=`) \
                    or noise; `-v` shows the frames";
        Error::Failed {
            what,
            went: String::new(),
            outcome: Outcome::NotDone(Failure::Misbehaved),
            heard: Box::default(),
            may_turn: false,
            hint: hint.into(),
        }
    }

    fn describe(&self) -> String {
        self.line.link.describe()
    }

    /// Asks every question that some profile has, once.
    pub(crate) fn probe(&self, number: u32) -> Result<Probe, Error> {
        let generic = self.line.spoken.generic;
        let mut axes: Vec<_> = self.candidates.iter().map(|(p, _)| (*p, number)).collect();
        axes.push((generic, number));
        let (connection, before) = self.line.probe(&axes, self.looking)?;
        // Somebody may have spoken just now: this host has not heard it.
        connection.with(|axes, now| axes.disturbed(now));
        let (mut heard, mut doubtful, mut best) = (false, false, None::<(u32, usize, i64)>);
        let mut asked: Vec<(Identity, Option<Outcome>)> = Vec::new();
        for (n, (profile, identity)) in self.candidates.iter().enumerate() {
            if (self.broken)() {
                return Ok(Probe::Silent(Heard::default()));
            }
            let outcome = match asked.iter().find(|(q, _)| same(q, identity, profile)) {
                Some((_, outcome)) => *outcome,
                None => self.ask(&connection, before + n, identity.ask),
            };
            if outcome.and_then(Outcome::failure) == Some(Failure::LinkDown) {
                return Err(self.lost(&connection));
            }
            asked.push((*identity, outcome));
            match outcome {
                Some(Outcome::NotDone(
                    Failure::NotReady { hint } | Failure::Impossible(Unsupported::Forbidden(hint)),
                )) => {
                    return Ok(Probe::Forbidden(hint));
                }
                Some(Outcome::Done(raw)) => {
                    heard = true;
                    let sure = identity.mask.count_ones();
                    let fits = raw & identity.mask == identity.equals;
                    if fits && best.is_none_or(|(other, ..)| sure > other) {
                        best = Some((sure, n, raw));
                    }
                }
                Some(outcome) => {
                    heard |= answered(outcome);
                    doubtful |= misbehaved(outcome);
                }
                None => {}
            }
            if silent(outcome) && !heard {
                let counted = connection.with(|axes, _| axes.counters());
                // The bytes that are held are those of the question that ended last.
                let held = connection.with(|axes, _| axes.heard(AxisIndex((before + n) as u8)));
                let skipped = counted.skipped.max(held.skipped);
                let heard = Heard::of(&Counters { skipped, ..counted });
                return Ok(match heard.corrupt {
                    0 => Probe::Silent(heard),
                    _ => Probe::Damaged(heard),
                });
            }
        }
        if !heard && !(self.broken)() {
            let answer = self.generic_answers(&connection, before, generic)?;
            heard = answer.is_none_or(answered);
            doubtful |= answer.is_some_and(misbehaved);
        }
        let counters = connection.with(|axes, _| axes.counters());
        let stray = counters.unaccounted();
        Ok(match best {
            Some((_, n, raw)) => {
                let (profile, identity) = self.candidates[n];
                let firmware = firmware(raw, identity.firmware);
                Probe::Found {
                    profile,
                    identified: Identified::Asked { firmware },
                    stray,
                    doubtful: false,
                }
            }
            None if heard => {
                Probe::Found { profile: generic, identified: Identified::Generic, stray, doubtful }
            }
            None => Probe::Silent(Heard::of(&counters)),
        })
    }

    /// What came for the generic profile's first readable parameter; `None` where it has none: its
    /// address is taken as it is.
    fn generic_answers(
        &self,
        connection: &Connection,
        before: usize,
        generic: &'static Profile,
    ) -> Result<Option<Outcome>, Error> {
        let readable = generic.parameters.iter().position(|p| p.access != Access::Write);
        let Some(id) = readable.and_then(|n| u16::try_from(n).ok()) else { return Ok(None) };
        let question = Ask::Parameter(ParameterId(id));
        let outcome = self.ask(connection, before + self.candidates.len(), question);
        match outcome.and_then(Outcome::failure) {
            Some(Failure::LinkDown) => Err(self.lost(connection)),
            // What cannot be asked is silence too.
            _ => Ok(Some(outcome.unwrap_or(Outcome::NotDone(Failure::Silent)))),
        }
    }

    /// The error for a link that went away while somebody was asked: that is no silence.
    fn lost(&self, connection: &Connection) -> Error {
        let trouble = connection.trouble();
        Error::Link(trouble.unwrap_or_else(|| LinkError::gone(&self.describe())))
    }

    fn ask(&self, connection: &Connection, axis: usize, question: Ask) -> Option<Outcome> {
        let axis = AxisIndex(u8::try_from(axis).ok()?);
        // However the host judges it: what may keep others from the wire has an end.
        let patience = self.patience.or(self.looking.then_some(QUESTION_MAX));
        let until = patience.map_or(Instant::FAR, |patience| connection.now() + patience);
        let outcome: Result<Option<Outcome>, Unsupported> =
            connection.ask(until, |axes, now, ticket| match question {
                Ask::Parameter(id) => axes.read(now, ticket, axis, id),
                Ask::Text(text) => axes.raw(now, ticket, axis, text),
            });
        // Nothing within the time is silence too.
        Some(outcome.ok()?.unwrap_or(Outcome::NotDone(Failure::Silent)))
    }
}

/// The same question, so that its answer can be shared. A parameter's number means another thing
/// in another profile.
fn same(asked: &Identity, wanted: &Identity, _profile: &Profile) -> bool {
    matches!((asked.ask, wanted.ask), (Ask::Text(a), Ask::Text(b)) if a == b)
}

/// Somebody said something, if only no.
pub(crate) const fn answered(outcome: Outcome) -> bool {
    matches!(outcome.failure(), None | Some(Failure::Refused { .. } | Failure::Misbehaved))
}

const fn misbehaved(outcome: Outcome) -> bool {
    matches!(outcome.failure(), Some(Failure::Misbehaved))
}

fn silent(outcome: Option<Outcome>) -> bool {
    let failure = outcome.and_then(Outcome::failure);
    matches!(failure, Some(Failure::Silent | Failure::LinkDown))
}

/// The version's bits as people write versions: text where they are text, else major.minor.
fn firmware(raw: i64, mask: i64) -> Option<String> {
    if mask == 0 {
        return None;
    }
    let bits = ((raw & mask).cast_unsigned()) >> mask.trailing_zeros();
    let bytes: Vec<u8> = bits.to_be_bytes().into_iter().skip_while(|b| *b == 0).collect();
    if bytes.len() >= 3 && bytes.iter().all(u8::is_ascii_graphic) {
        return Some(bytes.iter().map(|b| char::from(*b)).collect());
    }
    Some(match bits {
        0x100..=0xFFFF => format!("{}.{:02}", bits >> 8, bits & 0xFF),
        other => other.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::firmware;

    #[test]
    fn versions_are_shown_as_people_write_them() {
        assert_eq!(firmware(0x3137_3156_312E_3039, 0xFF_FFFF_FFFF).as_deref(), Some("V1.09"));
        assert_eq!(firmware(0x00AB_0114, 0xFFFF).as_deref(), Some("1.20"));
        assert_eq!(firmware(7, 0xFF).as_deref(), Some("7"));
        assert_eq!(firmware(7, 0), None);
    }
}
