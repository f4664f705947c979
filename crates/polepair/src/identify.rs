//! Identifies a drive, by reads only.

use crate::config::Config;
use crate::duplicate_address::{DUPLICATE_ADDRESS_HINT, duplicate_address_text};
use crate::error::Error;
use crate::identification::Identification;
use crate::no_reply::{NoReplyDetails, Wiring};
use crate::profile::{Listed, find_answered, find_nearest};
use crate::protocol_line::ProtocolLine;
use crate::url::AxisNumber;
use polepair_core::axis::Refusal;
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::profile::{Access, Identity, IdentityQuery, ParameterId, Profile};
use polepair_core::program::ProgramCommand;
use polepair_core::station::{AxisIndex, Counters};
use polepair_core::time::Instant;
use polepair_link::{Connection, LinkError};
use std::cell::Cell;
use std::time::Duration;

/// Greatest axis ID on TechnoCAN.
const TECHNOCAN_AXIS_MAX: u32 = 31;
const ALIAS_HINT: &str = "another axis replies: the relay's CAN bus is TechnoCAN, which has axes 1 to 31; add \
                          `relay=technocan`";
/// Time limit of one question with all its repeats.
const QUERY_MAX: Duration = Duration::from_secs(5);
/// Time for which a stop repeats the identification of drives.
pub(crate) const IDENTIFY_RETRY_MAX: Duration = Duration::from_secs(3);
/// The notice of a drive that stored requests as instructions.
pub(crate) const STORE_ENDED: &str =
    "the module was in download mode, which was ended; its program is incomplete";
/// Products that are asked for at one address at most.
const CANDIDATES_MAX: usize = 64;

/// Identifies drives on one line.
pub(crate) struct Prober<'a> {
    line: &'a ProtocolLine,
    config: &'a Config,
    profiles: Vec<&'static Profile>,
    candidates: Vec<(&'static Profile, Identity)>,
    /// True if a drive that is none of them may be of the catalogue.
    with_catalogue: bool,
    reply_timeout: Option<Duration>,
    /// Time for all questions to one address.
    time_limit: Option<Duration>,
    single_attempt: bool,
    is_cancelled: &'a dyn Fn() -> bool,
    /// The storing of requests was ended by the last question.
    store_ended: Cell<bool>,
}

/// Result of one address.
#[derive(Clone, Debug)]
pub(crate) enum ProbeResult {
    /// No reply, with the received frames.
    Silent(NoReplyDetails),
    /// Only damaged frames came back, and what else there was.
    Damaged(NoReplyDetails),
    /// Each question was answered twice: two drives have the address.
    AnsweredTwice,
    /// The host may not ask there; nothing was sent.
    Forbidden(&'static str),
    /// A device replied. Doubtful if it is not a known drive and a reply was corrupt or for another
    /// request.
    Found {
        profile: &'static Profile,
        identified: Identification,
        /// Answers too many, or damaged.
        stray: u64,
        /// The damaged ones among them.
        corrupt: u64,
        doubtful: bool,
        /// True if it refused a question of its identity as an object that it does not have.
        lacks_identity: bool,
    },
}

impl<'a> Prober<'a> {
    pub(crate) fn new(line: &'a ProtocolLine, config: &'a Config) -> Self {
        let profiles: Vec<_> =
            config.all_profiles().filter(|p| p.protocol == line.protocol.profile).collect();
        let candidates = profiles.iter().filter_map(|p| Some((*p, p.identity?)));
        let candidates = candidates.take(CANDIDATES_MAX).collect();
        Self {
            line,
            config,
            profiles,
            candidates,
            reply_timeout: None,
            time_limit: None,
            with_catalogue: true,
            single_attempt: false,
            is_cancelled: &|| false,
            store_ended: Cell::new(false),
        }
    }

    /// Restricts the search to one product; other drives get the generic profile.
    pub(crate) fn with_candidate(mut self, profile: &'static Profile) -> Self {
        self.with_catalogue = false;
        self.candidates =
            profile.identity.map(|identity| (profile, identity)).into_iter().collect();
        self
    }

    /// Sets the reply time-out of each query, in place of the host's own.
    pub(crate) fn with_timeout(mut self, patience: Option<Duration>) -> Self {
        self.reply_timeout = patience;
        self
    }

    /// Queries each address, at most for this time, with all queries. Facts that are not known by then stay unknown.
    pub(crate) fn with_time_limit(mut self, limit: Duration) -> Self {
        self.time_limit = Some(limit);
        self
    }

    /// Takes silence for an empty address without trying twice: most are.
    pub(crate) fn scanning(mut self) -> Self {
        self.single_attempt = true;
        self
    }

    /// Sends no further request once `broken` returns true; the rest counts as silent.
    pub(crate) fn with_cancel(mut self, broken: &'a dyn Fn() -> bool) -> Self {
        self.is_cancelled = broken;
        self
    }

    /// Identifies the device at an address, or reports silence.
    pub(crate) fn identify(
        &self,
        number: u32,
    ) -> Result<(&'static Profile, Identification), Error> {
        match self.probe(number)? {
            ProbeResult::Found { doubtful: true, .. } => Err(self.confused_error(number)),
            ProbeResult::AnsweredTwice => Err(self.answered_twice_error(number)),
            ProbeResult::Found { profile, identified, .. } => Ok((profile, identified)),
            ProbeResult::Forbidden(hint) => Err(self.forbidden_error(number, hint)),
            ProbeResult::Silent(details) | ProbeResult::Damaged(details) => {
                Err(self.silent_error(number, details))
            }
        }
    }

    /// The error for an address that the host may not ask.
    pub(crate) fn forbidden_error(&self, number: u32, hint: &str) -> Error {
        let what = format!("axis {number} cannot be asked on {}", self.describe());
        Error::usage("E222", what, hint)
    }

    /// The error for a silent address.
    pub(crate) fn silent_error(&self, number: u32, details: NoReplyDetails) -> Error {
        let but = if details.is_nothing() { String::new() } else { format!(": {details}") };
        let what = match details.relay_text(self.line.options.relay_axis, number) {
            Some(text) => format!("{text} on {}", self.describe()),
            None => format!("axis {number} does not answer on {}{but}", self.describe()),
        };
        Error::Failed {
            what,
            execution: String::new(),
            outcome: Outcome::NotDone(Failure::Silent),
            received: Box::new(details),
            may_turn: false,
            hint: match (details.is_nothing(), self.line.wiring()) {
                (true, Wiring::Network) => Wiring::Network.hint().into(),
                (true, Wiring::SerialServer) => {
                    let twin = self.line.protocol.network_twin_hint();
                    format!("{}{twin}", Wiring::SerialServer.hint())
                }
                // Bytes that are no frames may be those of the other protocol.
                (false, Wiring::SerialServer) => {
                    format!("{}{}", details.hint(), self.line.protocol.network_twin_hint())
                }
                _ => details.hint().into(),
            },
        }
    }

    /// The module of the catalogue that has answered so, and its firmware.
    fn find_in_catalogue(
        &self,
        requests: &[(Identity, Option<Outcome>)],
    ) -> Option<(&'static Listed, Option<String>)> {
        let answers =
            requests.iter().filter(|_| self.with_catalogue).filter_map(|request| match request {
                (Identity { query: IdentityQuery::Text(_), .. }, Some(Outcome::Done(raw))) => {
                    Some(*raw)
                }
                _ => None,
            });
        // After the built-in profiles, which have more than a catalogue entry.
        let mut known =
            answers.filter_map(|raw| Some((find_answered(self.line.protocol.profile, raw)?, raw)));
        let (module, raw) = known.next()?;
        let firmware = module.profile().identity.map_or(0, |identity| identity.firmware);
        Some((module, format_firmware(raw, firmware)))
    }

    /// Profile of the module with the nearest number among those of the same hundred.
    fn find_nearest(&self, requests: &[(Identity, Option<Outcome>)]) -> Option<&'static str> {
        requests.iter().filter(|_| self.with_catalogue).find_map(|request| match request {
            (Identity { query: IdentityQuery::Text(_), .. }, Some(Outcome::Done(raw))) => {
                find_nearest(self.line.protocol.profile, *raw)
            }
            _ => None,
        })
    }

    /// The error with a hint for stops: naming the drive makes a reply unnecessary.
    pub(crate) fn with_profile_hint(&self, error: Error) -> Error {
        let Error::Failed { what, execution, outcome, received, may_turn, hint } = error else {
            return error;
        };
        let names: Vec<&str> = self.profiles.iter().map(|profile| profile.name).collect();
        let hint = format!("select the drive by `?profile=`: {}; {hint}", names.join(", "));
        Error::Failed { what, execution, outcome, received, may_turn, hint }
    }

    /// The profiles of drives that speak the line's protocol.
    pub(crate) fn profiles(&self) -> &[&'static Profile] {
        &self.profiles
    }

    /// The error for an address whose replies fit no query.
    pub(crate) fn confused_error(&self, number: u32) -> Error {
        let what = format!(
            "axis {number} cannot be identified on {}: the replies were corrupt or belonged to \
             other requests",
            self.describe()
        );
        let hint = "look for two drives with one address, a second host, late answers \
         (`?timeout=`) \
                    or noise; `-v` shows the frames";
        Error::Failed {
            what,
            execution: String::new(),
            outcome: Outcome::NotDone(Failure::Misbehaved),
            received: Box::default(),
            may_turn: false,
            hint: hint.into(),
        }
    }

    /// The error for an address whose device answers, and is none that is known.
    pub(crate) fn unknown_error(&self, number: u32) -> Error {
        Error::Failed {
            what: format!("axis {number} does not report a known identity on {}", self.describe()),
            execution: String::new(),
            outcome: Outcome::NotDone(Failure::Silent),
            received: Box::default(),
            may_turn: false,
            hint: "`polepair info` shows what it reports".to_owned(),
        }
    }

    /// The error for an address that answers each question twice.
    pub(crate) fn answered_twice_error(&self, number: u32) -> Error {
        let text = duplicate_address_text(self.line.protocol.name, number);
        Error::Failed {
            what: format!("{text}, on {}", self.describe()),
            execution: String::new(),
            outcome: Outcome::NotDone(Failure::AnsweredTwice),
            received: Box::default(),
            may_turn: false,
            hint: DUPLICATE_ADDRESS_HINT.into(),
        }
    }

    fn describe(&self) -> String {
        self.line.link.describe()
    }

    /// Sends every identification request of the profiles once; after a reply, checks that it is one drive.
    pub(crate) fn probe(&self, number: u32) -> Result<ProbeResult, Error> {
        let mut result = self.probe_once(number)?;
        if self.single_attempt
            && self.line.protocol.name == "tmcl"
            && let ProbeResult::Found { stray, corrupt, .. } = &mut result
        {
            if self.answers_twice(number)? {
                return Ok(ProbeResult::AnsweredTwice);
            }
            // What else came was late, or for others.
            *stray = *corrupt;
        }
        if matches!(result, ProbeResult::Found { .. })
            && self.may_be_alias(number)
            && !self.answers_by_own_number(number)?
        {
            return Ok(ProbeResult::Forbidden(ALIAS_HINT));
        }
        Ok(result)
    }

    /// Returns whether a relay may have passed a request to another axis: on TechnoCAN, which has axes 1 to 31, it
    /// sends only the last five bits of a number.
    fn may_be_alias(&self, number: u32) -> bool {
        let options = &self.line.options;
        options.relay_axis.is_some_and(|relay| relay != number)
            && options.relay_axis_max.is_none()
            && number > TECHNOCAN_AXIS_MAX
    }

    /// Returns whether a drive replies with this number as the sender's. The reply to a question for the firmware
    /// does not name the sender, that to a question for a value does.
    fn answers_by_own_number(&self, number: u32) -> Result<bool, Error> {
        let generic = self.line.protocol.generic;
        let connection =
            self.line.probe_connection(&[(generic, number)], self.single_attempt, true)?;
        let question = IdentityQuery::Parameter(ParameterId(0));
        Ok(self.query(&connection, 0, question, Instant::FAR_FUTURE).is_none_or(is_answer))
    }

    /// Returns whether two modules answer at the address. Only a session that proves its addresses sees that, which a
    /// scan does not.
    fn answers_twice(&self, number: u32) -> Result<bool, Error> {
        let generic = self.line.protocol.generic;
        let connection = self.line.probe_connection(&[(generic, number)], false, false)?;
        // A whole exchange with retries, which sees a second reply to one request.
        let question = IdentityQuery::Parameter(ParameterId(0));
        let outcome = self.query(&connection, 0, question, Instant::FAR_FUTURE);
        Ok(outcome.and_then(Outcome::failure) == Some(Failure::AnsweredTwice))
    }

    fn probe_once(&self, number: u32) -> Result<ProbeResult, Error> {
        let generic = self.line.protocol.generic;
        let mut axes: Vec<_> = self.candidates.iter().map(|(p, _)| (*p, number)).collect();
        axes.push((generic, number));
        // With a limit there is no room for the pauses that a quiet start of a session takes.
        let urgent = self.reply_timeout.is_some() || self.time_limit.is_some();
        let connection = self.line.probe_connection(&axes, self.single_attempt, urgent)?;
        // Another host may have sent just now, which this one has not received.
        connection.with_axes(|axes, now| axes.handle_resume(now));
        let until = self.time_limit.map_or(Instant::FAR_FUTURE, |limit| {
            connection.now() + connection.scale_timeout(limit)
        });
        // The most specific identity wins: a mask of more bits fits fewer products.
        let (mut received, mut doubtful, mut best) = (false, false, None::<(u32, usize, i64)>);
        let (mut lacks_identity, mut is_refused, mut has_value) = (false, false, false);
        let mut requests: Vec<(Identity, Option<Outcome>)> = Vec::new();
        for (n, (profile, identity)) in self.candidates.iter().enumerate() {
            if (self.is_cancelled)() {
                return Ok(ProbeResult::Silent(NoReplyDetails::default()));
            }
            if is_time_over(&connection, until) {
                break;
            }
            // One reply distinguishes products that share a question; sixty questions would take seconds.
            let outcome = match requests.iter().find(|(q, _)| is_same_query(q, identity, profile)) {
                Some((_, outcome)) => *outcome,
                None => self.query(&connection, n, identity.query, until),
            };
            has_value |= matches!(outcome, Some(Outcome::Done(_)));
            if let Some(Failure::Refused { code }) = outcome.and_then(Outcome::failure) {
                is_refused = true;
                let axis = AxisIndex(n as u8);
                let refusal = connection.with_axes(|axes, _| axes.refusal(axis, code));
                lacks_identity |= refusal == Refusal::Missing;
            }
            if outcome.and_then(Outcome::failure) == Some(Failure::LinkDown) {
                // Not "silent": at a lost link no address can be called free.
                return Err(self.link_lost_error(&connection));
            }
            requests.push((*identity, outcome));
            if outcome.and_then(Outcome::failure) == Some(Failure::AnsweredTwice) {
                return Ok(ProbeResult::AnsweredTwice);
            }
            match outcome {
                Some(Outcome::NotDone(
                    Failure::NotReady { hint } | Failure::Impossible(Unsupported::Forbidden(hint)),
                )) => {
                    return Ok(ProbeResult::Forbidden(hint));
                }
                Some(Outcome::Done(raw)) => {
                    received = true;
                    let sure = identity.mask.count_ones();
                    let fits = raw & identity.mask == identity.equals;
                    if fits && best.is_none_or(|(other, ..)| sure > other) {
                        best = Some((sure, n, raw));
                    }
                }
                Some(outcome) => {
                    received |= is_answer(outcome);
                    doubtful |= is_misbehaved(outcome);
                }
                None => {}
            }
            // The first question without any reply decides; the others would each cost their full time.
            if is_silent(outcome) && !received {
                let counted = connection.with_axes(|axes, _| axes.counters());
                // The bytes that are held are those of the question that ended last.
                let held =
                    connection.with_axes(|axes, _| axes.silence_counters(AxisIndex(n as u8)));
                let skipped = counted.skipped.max(held.skipped);
                let details = NoReplyDetails::from_counters(&Counters { skipped, ..counted });
                return Ok(match details.corrupt {
                    0 => ProbeResult::Silent(details),
                    _ => ProbeResult::Damaged(details),
                });
            }
        }
        // A module in download mode refuses its version, and stores a read.
        let only_refused = is_refused && best.is_none() && !has_value;
        if (!received || only_refused)
            && !(self.is_cancelled)()
            && !is_time_over(&connection, until)
        {
            let answer = self.query_generic(&connection, generic, until)?;
            if answer.and_then(Outcome::failure) == Some(Failure::AnsweredTwice) {
                return Ok(ProbeResult::AnsweredTwice);
            }
            // Only once: the flag is set by the end of a download mode that really was there.
            if self.store_ended.take() {
                return self.probe_once(number);
            }
            received |= answer.is_none_or(is_answer);
            doubtful |= answer.is_some_and(is_misbehaved);
        }
        let counters = connection.with_axes(|axes, _| axes.counters());
        let (stray, corrupt) = (counters.unaccounted(), counters.corrupt);
        let queried = match best {
            Some((_, n, raw)) => {
                let (profile, identity) = self.candidates[n];
                Some((profile, format_firmware(raw, identity.firmware)))
            }
            None => self
                .find_in_catalogue(&requests)
                .map(|(module, firmware)| (module.profile(), firmware)),
        };
        let (profile, identified) = match queried {
            Some((profile, firmware)) => (profile, Identification::Queried { firmware }),
            None if received => {
                let nearest = self.find_nearest(&requests);
                (generic, Identification::Generic { nearest })
            }
            None => return Ok(ProbeResult::Silent(NoReplyDetails::from_counters(&counters))),
        };
        // An identity that was read is certain, whatever else came.
        let doubtful = doubtful && identified.is_generic();
        Ok(ProbeResult::Found { profile, identified, stray, corrupt, doubtful, lacks_identity })
    }

    /// The reply to the generic profile's first readable parameter; `None` without such a parameter.
    fn query_generic(
        &self,
        connection: &Connection,
        generic: &'static Profile,
        until: Instant,
    ) -> Result<Option<Outcome>, Error> {
        let readable = generic.parameters.iter().position(|p| p.access != Access::Write);
        let Some(id) = readable.and_then(|n| u16::try_from(n).ok()) else { return Ok(None) };
        let question = IdentityQuery::Parameter(ParameterId(id));
        let outcome = self.query(connection, self.candidates.len(), question, until);
        match outcome.and_then(Outcome::failure) {
            Some(Failure::LinkDown) => Err(self.link_lost_error(connection)),
            // What cannot be asked is silence too.
            _ => Ok(Some(outcome.unwrap_or(Outcome::NotDone(Failure::Silent)))),
        }
    }

    /// The error for a link that was lost during the identification.
    fn link_lost_error(&self, connection: &Connection) -> Error {
        let trouble = connection.link_error();
        Error::Link(trouble.unwrap_or_else(|| LinkError::gone(&self.describe())))
    }

    fn query(
        &self,
        connection: &Connection,
        axis: usize,
        question: IdentityQuery,
        until: Instant,
    ) -> Option<Outcome> {
        let axis = AxisIndex(u8::try_from(axis).ok()?);
        // However the host judges it: what may keep others from the wire has an end.
        let patience = self.reply_timeout.or(self.single_attempt.then_some(QUERY_MAX));
        let until = patience.map_or(until, |patience| {
            until.min(connection.now() + connection.scale_timeout(patience))
        });
        let ask = || {
            let answer = connection.request(until, |axes, now, ticket| match question {
                IdentityQuery::Parameter(id) => axes.read_parameter(now, ticket, axis, id),
                IdentityQuery::Text(text) => axes.send_text(now, ticket, axis, text),
            });
            // Nothing within the time is silence too.
            Some(answer.ok()?.unwrap_or(Outcome::NotDone(Failure::Silent)))
        };
        let outcome = ask()?;
        if self.end_store(connection, axis, outcome, until) { ask() } else { Some(outcome) }
    }

    /// Ends the storing of requests as instructions of a program, where the drive did so with the question. Each
    /// further question would be one more instruction in its memory. False if it did not.
    fn end_store(
        &self,
        connection: &Connection,
        axis: AxisIndex,
        outcome: Outcome,
        until: Instant,
    ) -> bool {
        let Some(Failure::Refused { code }) = outcome.failure() else { return false };
        // No other refusal permits a write during identification.
        if connection.with_axes(|axes, _| axes.refusal(axis, code)) != Refusal::Stored {
            return false;
        }
        let ended = connection.request(until, |axes, now, ticket| {
            axes.send_program_command(now, ticket, axis, ProgramCommand::EndStore)
        });
        let is_ended = matches!(ended, Ok(Some(Outcome::Done(_))));
        if is_ended {
            self.store_ended.set(true);
            let number = connection.with_axes(|axes, _| axes.address(axis));
            debug_assert!(number.is_some(), "the axis has just replied");
            if let Some(number) = number {
                self.config.add_notice(format!("axis {}: {STORE_ENDED}", AxisNumber(number)));
            }
        }
        is_ended
    }
}

fn is_time_over(connection: &Connection, until: Instant) -> bool {
    connection.now() >= until
}

/// Returns whether two questions are the same, so that their answer can be shared. A parameter's number means another
/// thing in another profile.
fn is_same_query(identity: &Identity, wanted: &Identity, _profile: &Profile) -> bool {
    matches!((identity.query, wanted.query), (IdentityQuery::Text(a), IdentityQuery::Text(b)) if a == b)
}

/// Returns whether a device replied, a refusal included.
pub(crate) const fn is_answer(outcome: Outcome) -> bool {
    matches!(outcome.failure(), None | Some(Failure::Refused { .. } | Failure::Misbehaved))
}

const fn is_misbehaved(outcome: Outcome) -> bool {
    matches!(outcome.failure(), Some(Failure::Misbehaved))
}

fn is_silent(outcome: Option<Outcome>) -> bool {
    let failure = outcome.and_then(Outcome::failure);
    matches!(failure, Some(Failure::Silent | Failure::LinkDown))
}

/// The version's bits as people write versions: text where they are text, else major.minor.
fn format_firmware(raw: i64, mask: i64) -> Option<String> {
    if mask == 0 {
        return None;
    }
    let bits = ((raw & mask).cast_unsigned()) >> mask.trailing_zeros();
    let bytes: Vec<u8> = bits.to_be_bytes().into_iter().skip_while(|b| *b == 0).collect();
    // Letters and digits are a name such as `F514L`; shorter ones are numbers by chance.
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
    use super::format_firmware;

    #[test]
    fn versions_are_shown_as_people_write_them() {
        assert_eq!(
            format_firmware(0x3137_3156_312E_3039, 0xFF_FFFF_FFFF).as_deref(),
            Some("V1.09")
        );
        assert_eq!(format_firmware(0x00AB_0114, 0xFFFF).as_deref(), Some("1.20"));
        assert_eq!(format_firmware(7, 0xFF).as_deref(), Some("7"));
        assert_eq!(format_firmware(7, 0), None);
    }
}
