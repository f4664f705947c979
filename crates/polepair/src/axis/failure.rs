//! Converts outcomes to errors: request, result, and what to try.

use super::LocalAxis;
use super::unmet_wait::MODE_HINT;
use crate::duplicate_address::{DUPLICATE_ADDRESS_HINT, duplicate_address_text};
use crate::error::{ARMING_HINT, Error};
use crate::identification::Identification;
use crate::no_reply::NoReplyDetails;
use crate::registry;
use crate::url::AxisNumber;
use polepair_core::axis::{MotionReport, Refusal, Verb};
use polepair_core::error::{Extent, Failure, Outcome, Unsupported};
use polepair_core::judge::{EndReason, LimitEnd};
use polepair_core::lane::write_steps;
use polepair_core::plan::{Argument, Operand, Step};
use polepair_core::profile::{Encoding, Fault, ParameterId, Signal, Watchdog};
use polepair_link::Cause;

/// The kind of a request, for the text of its error.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum RequestKind {
    /// A query, which changes nothing.
    Query,
    /// A check of standstill after a stop.
    StandstillQuery,
    /// A plan of the profile.
    Verb(Verb),
    /// A parameter is set to this raw value, and kept over power-off if the last is true.
    Write(ParameterId, i64, bool),
    /// Anything else that may change the drive.
    Command,
}

/// Steps that are named one by one at most.
const NAMED_STEPS_MAX: usize = 6;

impl LocalAxis {
    /// The error for an outcome that is not [`Outcome::Done`].
    pub(crate) fn outcome_error(&self, what: &str, kind: RequestKind, outcome: Outcome) -> Error {
        let failure = outcome.failure().unwrap_or(Failure::Misbehaved);
        // The stop was sent: it is the question that was not executed.
        let outcome = match (kind, outcome) {
            (RequestKind::StandstillQuery, Outcome::NotDone(failure)) => Outcome::Unknown(failure),
            // The move was started: it is its end that is not known.
            (
                RequestKind::Verb(Verb::Reached),
                Outcome::NotDone(
                    failure @ (Failure::Silent | Failure::Misbehaved | Failure::LinkDown),
                ),
            ) => Outcome::Unknown(failure),
            _ => outcome,
        };
        // Nothing was sent, so this is the caller's error and not the drive's.
        if let (Failure::Impossible(why), Outcome::NotDone(_)) = (failure, outcome) {
            return self.unsupported_error(what, why);
        }
        // Who closed it knows that it is no lost link, but not that a motor was left turning.
        if let (Failure::LinkDown, Some(closed)) = (failure, self.connection.link_error())
            && closed.cause() == Cause::Closed
            && kind != RequestKind::StandstillQuery
            && !self.may_turn()
        {
            return Error::Link(closed);
        }
        // Before anything else is asked: the next request resets the counters.
        let details = self.no_reply_details(failure);
        let (reason, mut hint) = match failure {
            Failure::Silent => {
                let reason = match details.relay_text(self.relay, self.number) {
                    Some(text) => text,
                    None => no_answer_text(&details),
                };
                (reason, details.hint().into_owned())
            }
            Failure::Unconfirmed if matches!(outcome, Outcome::Unknown(_)) => (
                "nothing on this wire confirms it".to_owned(),
                "name the axes instead of the group, so that each is asked, or look at the motors"
                    .to_owned(),
            ),
            failure => self.failure_reason(failure),
        };
        if let (RequestKind::Verb(verb), Outcome::Partly(Failure::Refused { .. }, extent)) =
            (kind, outcome)
            && self.refused_mode(verb, extent)
        {
            // Seen on CiA 402 drives, which change 6060h only in SWITCH ON DISABLED.
            hint = MODE_HINT.to_owned();
        }
        if let (RequestKind::Write(id, ..), Failure::Refused { .. }, true) =
            (kind, failure, hint.is_empty())
        {
            hint = self.password_hint(id);
        }
        let reason = match failure {
            Failure::Faulted { .. } | Failure::PowerLost | Failure::NotReached => {
                match self.motion_text().filter(|_| is_motion(kind)) {
                    Some(place) => format!("{reason}; {place}"),
                    None => reason,
                }
            }
            _ => reason,
        };
        let reason = match failure {
            Failure::PowerLost
            | Failure::NotReached
            | Failure::Elsewhere(_)
            | Failure::ModeChanged { .. } => match self.recent_emergency() {
                Some(emergency) => format!("{reason}; {emergency}"),
                None => reason,
            },
            _ => reason,
        };
        // Not simply "it was moving": where the link lives, the caller can still stop it.
        let may_turn = self.is_out_of_reach(kind, failure);
        if let (true, Watchdog::Fixed { after_ms }) = (may_turn, self.profile.watchdog) {
            hint = format!("the drive should stop {after_ms} ms after the link died; {hint}");
        }
        Error::Failed {
            what: format!("{}: {what}: {reason}", self.label()),
            execution: self.execution_text(kind, outcome, failure),
            outcome,
            received: Box::new(details),
            may_turn,
            hint,
        }
    }

    /// Details of a missing reply.
    fn no_reply_details(&self, failure: Failure) -> NoReplyDetails {
        match failure {
            Failure::Silent => NoReplyDetails::from_counters(
                &self.connection.with_axes(|axes, _| axes.silence_counters(self.index)),
            ),
            _ => NoReplyDetails::default(),
        }
    }

    /// Returns whether the motor may turn, and nothing can be done about it from here: the link is lost, or its stop
    /// was not answered.
    fn is_out_of_reach(&self, kind: RequestKind, failure: Failure) -> bool {
        let stop = matches!(
            kind,
            RequestKind::StandstillQuery | RequestKind::Verb(Verb::Stop | Verb::QuickStop)
        );
        match failure {
            Failure::LinkDown => stop || self.may_turn(),
            Failure::Silent
            | Failure::Misbehaved
            | Failure::AnsweredTwice
            | Failure::Refused { .. } => stop,
            _ => false,
        }
    }

    /// Returns whether the motor may turn: it was started, or was moving at the last reading, and since then neither
    /// arrived, nor acknowledged a stop, nor was switched off, as far as this link knows.
    #[must_use]
    pub fn may_turn(&self) -> bool {
        self.state().motion_active || self.is_turning() == Some(true)
    }

    /// Text about the execution. Empty if there was nothing to execute, and if the drive's reply states it.
    fn execution_text(&self, kind: RequestKind, outcome: Outcome, failure: Failure) -> String {
        let of_the_wire =
            matches!(failure, Failure::Silent | Failure::Misbehaved | Failure::LinkDown);
        match (kind, outcome) {
            (RequestKind::Query | RequestKind::StandstillQuery, _) | (_, Outcome::Done(_)) => {
                String::new()
            }
            (_, Outcome::NotDone(_)) if of_the_wire => "it was not executed".to_owned(),
            (_, Outcome::NotDone(_)) => String::new(),
            (RequestKind::Verb(Verb::Reached), Outcome::Unknown(_)) => {
                "whether the move arrived is not known".to_owned()
            }
            (_, Outcome::Unknown(_)) => "it may have been executed".to_owned(),
            (_, Outcome::Partly(_, extent)) => self.partial_execution_text(kind, extent),
        }
    }

    /// Progress of a plan, step by step.
    fn partial_execution_text(&self, kind: RequestKind, extent: Extent) -> String {
        let steps = match kind {
            RequestKind::Verb(verb) => self.profile.plan(verb).map(|plan| plan.steps.to_vec()),
            RequestKind::Write(id, raw, keep) => self
                .parameter(id)
                .map(|parameter| write_steps(self.profile, id, parameter, raw, keep)),
            RequestKind::Query | RequestKind::StandstillQuery | RequestKind::Command => None,
        };
        let steps = steps.unwrap_or_default();
        let parts = [
            self.bit_names("done", extent.done, &steps),
            self.bit_names("refused", extent.refused, &steps),
            self.bit_names("unknown whether executed", extent.unknown, &steps),
            extent.rolled_back.then(|| "the executed part was undone".to_owned()),
        ];
        let messages: Vec<String> = parts.into_iter().flatten().collect();
        format!("it was executed in part; {}", messages.join("; "))
    }

    fn bit_names(&self, word: &str, mask: u64, steps: &[Step]) -> Option<String> {
        debug_assert!(steps.len() <= 64, "an extent has a bit for each step");
        let its = (0..64).filter(|n| mask >> n & 1 == 1);
        let names: Vec<String> = its.map(|n| self.step_name(n, steps.get(n))).collect();
        // The last steps are the ones that a technician looks for; a plan has up to sixty.
        let left = names.len().saturating_sub(NAMED_STEPS_MAX);
        let first = names[left..].join(", ");
        match (names.len(), left) {
            (0, _) => None,
            (_, 0) => Some(format!("{word}: {first}")),
            _ => Some(format!("{word}: {left} steps and {first}")),
        }
    }

    /// Returns whether a verb was refused because of its mode of operation.
    fn refused_mode(&self, verb: Verb, extent: Extent) -> bool {
        let (Some((id, mode)), Some(plan)) = (self.mode_for(verb), self.profile.plan(verb)) else {
            return false;
        };
        let refused = plan.steps.iter().enumerate().filter(|(n, _)| extent.refused >> n & 1 == 1);
        refused.map(|(_, step)| step).any(|step| *step == Step::Write(id, Operand::Constant(mode)))
    }

    fn step_name(&self, n: usize, step: Option<&Step>) -> String {
        match step {
            Some(Step::Write(id, Operand::Constant(raw)) | Step::Ensure(id, raw)) => {
                self.setting_text(*id, Some(*raw))
            }
            Some(Step::Write(id, _) | Step::WriteBits { id, .. } | Step::Copy { to: id, .. }) => {
                self.setting_text(*id, None)
            }
            Some(Step::Send { like: Some(id), .. }) => self.setting_text(*id, None),
            Some(Step::Store(id)) => format!("keeping {}", self.setting_text(*id, None)),
            _ => format!("step {}", n + 1),
        }
    }

    fn setting_text(&self, id: ParameterId, raw: Option<i64>) -> String {
        let parameter = self.parameter(id);
        let name = parameter.map_or("?", |parameter| parameter.name);
        let word = |raw| parameter?.values.iter().find(|(value, _)| *value == raw);
        match raw {
            None => format!("`{name}`"),
            Some(raw) => match word(raw) {
                Some((_, word)) => format!("`{name}` = {word}"),
                // Bits, as manuals write them.
                None if raw > 9 => format!("`{name}` = {raw:X}h"),
                None => format!("`{name}` = {raw}"),
            },
        }
    }

    fn failure_reason(&self, failure: Failure) -> (String, String) {
        let reason_and_hint = |reason: &str, hint: &str| (reason.to_owned(), hint.to_owned());
        match failure {
            Failure::Refused { code } => self.refusal_reason(code),
            Failure::Misbehaved => reason_and_hint(
                "the replies were corrupt or belonged to another request",
                "look for two drives with one address, an echoing adapter, noise or a wrong baud \
                 rate; `-v` shows the frames",
            ),
            Failure::WrongSize { found, need } => (
                format!(
                    "the answer has {found} of {need} bytes: the object is of another type, such as \
                     an array"
                ),
                "read its sub-indices, or describe the object in a profile of your own".to_owned(),
            ),
            Failure::AnsweredTwice => reason_and_hint(
                &duplicate_address_text(self.protocol, self.number),
                DUPLICATE_ADDRESS_HINT,
            ),
            Failure::NotReached => self.unmet_wait_reason(),
            Failure::Elsewhere(reason) => self.end_reason(reason),
            Failure::Unconfirmed => self.unconfirmed_reason(),
            Failure::PowerLost => reason_and_hint(
                "the motor has lost its power",
                "an input (STO, enable), another program or the drive itself switched it off: \
                 `polepair info` shows its state",
            ),
            Failure::ModeChanged { mode } => (
                format!("the drive is in another mode, {}", self.mode_text(mode)),
                "check whether another master controls it".to_owned(),
            ),
            Failure::NotReady { hint } => reason_and_hint("the drive is not ready", hint),
            Failure::Faulted { code } => self.fault_reason(code),
            Failure::Differs { start, end } => (
                format!("the drive has different words at {start:04X} to {end:04X}"),
                "load the program again; if that does not help, that memory is locked \
                 (LOCKEEPROM), not there, or worn out"
                    .to_owned(),
            ),
            Failure::Cancelled => reason_and_hint("a stop or a newer command replaced it", ""),
            Failure::LinkDown => {
                let trouble = self.connection.link_error();
                let hint = trouble.as_ref().map(|t| t.hint().to_owned()).unwrap_or_default();
                let reason = trouble.map_or("the link is down".to_owned(), |t| t.to_string());
                (reason, hint)
            }
            Failure::Impossible(why) => self.unsupported_reason(why),
            other => (format!("it ended with {other:?}"), String::new()),
        }
    }

    /// End and target of the last motion: of a group, those of each drive that is elsewhere.
    fn motion_text(&self) -> Option<String> {
        // Of a group the drives that arrived are not listed, so that the others are not overlooked.
        let away = self.motion_reports().into_iter().filter(|report| !report.arrived);
        let texts: Vec<String> = away.filter_map(|report| self.place_text(&report)).collect();
        (!texts.is_empty()).then(|| texts.join("; "))
    }

    /// Reports of the last motion: of a group, one for each drive that answered.
    pub(crate) fn motion_reports(&self) -> Vec<MotionReport> {
        self.connection
            .with_axes(|axes, _| (0..).map_while(|n| axes.motion_report(self.index, n)).collect())
    }

    fn place_text(&self, report: &MotionReport) -> Option<String> {
        let (position, target) = (report.position?, report.target?);
        let subject = self.subject(report);
        let (position, target) = (self.position_text(position)?, self.position_text(target)?);
        Some(format!("{subject} is at {position}, the target is {target}"))
    }

    /// `it`, or of a group the number of the drive.
    fn subject(&self, report: &MotionReport) -> String {
        if AxisNumber(self.number).is_group() {
            format!("axis {}", report.address)
        } else {
            "it".to_owned()
        }
    }

    /// A raw position in the unit of the axis.
    fn position_text(&self, raw: i64) -> Option<String> {
        let id = self.profile.signal(Signal::Position)?.parameter;
        Some(self.value(id, raw).ok()?.to_string())
    }

    /// Describes why a motion ended elsewhere than at its target.
    fn end_reason(&self, reason: EndReason) -> (String, String) {
        let reports = self.motion_reports();
        let report = reports.iter().find(|report| !report.arrived).or(reports.first());
        let subject = report.map_or_else(|| "it".to_owned(), |report| self.subject(report));
        let places = report.and_then(|report| {
            Some((self.position_text(report.position?)?, self.position_text(report.target?)?))
        });
        let (at, aim) = match &places {
            Some((at, target)) => (format!(" at {at}"), format!("; the target is {target}")),
            None => (String::new(), String::new()),
        };
        // The drive's bit and the measured place disagree: both are shown, and whose word is which.
        let flagged = report.is_some_and(|report| report.flag == Some(true));
        let start = report.and_then(|report| self.position_text(report.start?));
        // An axis that never started is where it was; the start would be the same number twice.
        let start = start.filter(|_| !matches!(reason, EndReason::NotStarted));
        let from = start.map_or_else(String::new, |start| format!("; it started at {start}"));
        let claim = match (flagged, &places) {
            (true, Some((at, _))) => {
                format!("the drive says that the target is reached at {at}{aim}")
            }
            _ => format!("{subject} stopped{at}{aim}"),
        };
        let others = self.other_members(report);
        let (text, hint) = match reason {
            EndReason::Limit(end) => {
                let name = self.limit_name(end);
                let text = if flagged {
                    format!("{claim}; the {name} holds the axis")
                } else {
                    format!("the {name} stopped {subject}{at}{aim}")
                };
                (text, "move it the other way, or check the switch and the limits of the drive")
            }
            EndReason::Halted => (
                format!("another master halted {subject}{at}{aim}"),
                "end the other program, or wait until it is done",
            ),
            EndReason::Mode(mode) => (
                format!("another master set mode {}: {claim}", self.mode_text(mode)),
                "end the other program, or wait until it is done",
            ),
            EndReason::Stalled => (
                format!("{subject} stalled{at}{aim}"),
                "check what blocks it; less acceleration or more current may help",
            ),
            // Only a homing has no target.
            EndReason::NotStarted if report.is_some_and(|report| report.target.is_none()) => (
                format!("{claim}; the axis was not seen to start"),
                "if it was on its switch already, move it off and home it again; else check what it \
                 needs for a start",
            ),
            EndReason::NotStarted => (
                format!("{claim}; the axis was not seen to start"),
                "check whether another master controls the drive, and what it needs for a start",
            ),
            _ => (
                format!("{claim}{from}"),
                "check what blocks it, and whether another master controls the drive",
            ),
        };
        let hint = match self.destination(Verb::MoveTo, Argument::Velocity).flatten() {
            // A speed of 0 is obeyed as well: nothing moves.
            Some(speed) if matches!(reason, EndReason::NotStarted) && places.is_some() => {
                format!("{hint}; if `{}` is 0, give the move a speed (--vel)", speed.name)
            }
            _ => hint.to_owned(),
        };
        (format!("{text}{others}"), hint)
    }

    /// The other drives of a group that are elsewhere.
    fn other_members(&self, first: Option<&MotionReport>) -> String {
        let reports = self.motion_reports();
        let others = reports.iter().filter(|report| !report.arrived && Some(*report) != first);
        others.filter_map(|report| Some(format!("; {}", self.place_text(report)?))).collect()
    }

    /// The name of a limit, in the words of the profile.
    pub(crate) fn limit_name(&self, end: LimitEnd) -> &'static str {
        let (signal, name) = match end {
            LimitEnd::Negative => (Signal::NegativeLimit, "negative limit"),
            LimitEnd::Positive => (Signal::PositiveLimit, "positive limit"),
            LimitEnd::Either => (Signal::PositiveLimit, "limit"),
        };
        let source = self.profile.signal(signal);
        source.and_then(|source| source.values.first()).map_or(name, |(_, word)| *word)
    }

    /// Describes why the end of a motion is not known.
    fn unconfirmed_reason(&self) -> (String, String) {
        let hint = "measure the position by other means, or look at the motor";
        let group = AxisNumber(self.number).is_group();
        let text = if group && self.motion_reports().is_empty() {
            "the drives of this group cannot be asked where they are"
        } else if self.profile.signal(Signal::Position).is_none() {
            "the drive reports no position, so nothing shows where the motor is"
        } else {
            "the position before the move, or its unit, is not known, so nothing shows whether the \
             motor is at its target"
        };
        (format!("the motion was started; {text}"), hint.to_owned())
    }

    fn mode_text(&self, mode: i64) -> String {
        let source = self.profile.signal(Signal::Mode);
        let parameter = source.and_then(|source| self.parameter(source.parameter));
        let own = parameter.map_or(&[][..], |parameter| parameter.values);
        let mut words = source.map_or(&[][..], |source| source.values).iter().chain(own);
        let word = words.find(|(known, _)| *known == mode).map(|(_, word)| *word);
        word.map_or_else(|| mode.to_string(), |word| format!("{mode} ({word})"))
    }

    fn refusal_reason(&self, code: u32) -> (String, String) {
        let dissector = polepair_core::proto::find_dissector(self.protocol);
        let meaning = dissector.and_then(|dissector| dissector.code_meaning(code));
        let number = code;
        // Long ones are never written otherwise, as abort codes of CANopen.
        let code = if code > 0xFFFF { format!("0x{code:08X}") } else { code.to_string() };
        let reason = match meaning {
            Some(meaning) => format!("the drive refused: {meaning} (code {code})"),
            None => format!("the drive refused with code {code}"),
        };
        let refusal = self.connection.with_axes(|axes, _| axes.refusal(self.index, number));
        let hint = match refusal {
            Refusal::Stored => "another program loads one into it; `polepair stop` ends that",
            _ => "",
        };
        (reason, hint.to_owned())
    }

    /// Hint for a write that a drive with a password refuses; empty for others.
    fn password_hint(&self, id: ParameterId) -> String {
        let password = self.profile.find_parameter("password").filter(|password| *password != id);
        match password.and_then(|password| self.profile.parameter(password)) {
            None => String::new(),
            Some(it) => format!("it may be locked by `{}` ({}): {}", it.name, it.symbol, it.about),
        }
    }

    fn fault_reason(&self, code: u32) -> (String, String) {
        // One code may stand for several causes, as the alarm words of TS drives do; all are named.
        let known: Vec<&Fault> = self.profile.faults_for_code(code).collect();
        let Some(first) = known.first() else {
            return (format!("the drive reports fault {code:#x}"), String::new());
        };
        let texts: Vec<String> =
            known.iter().map(|fault| format!("{} ({})", fault.text, fault.name)).collect();
        let hint = [first.cause, first.remedy].map(|s| s.trim_end_matches('.'));
        // Of the first only: three remedies in one line are read by no one.
        let hint: Vec<&str> = hint.into_iter().filter(|s| !s.is_empty()).collect();
        (format!("the drive reports: {}", texts.join(", ")), hint.join(". "))
    }

    /// The error for what cannot be; nothing was sent.
    pub(crate) fn unsupported_error(&self, what: &str, why: Unsupported) -> Error {
        let (mut reason, hint) = self.unsupported_reason(why);
        // A verb without a plan is best explained by the objects that the drive lacks for it.
        let verb = Verb::ALL.into_iter().find(|verb| verb.name() == what);
        let missing = verb.filter(|_| why == Unsupported::NoPlan);
        let missing = missing.map_or_else(String::new, |verb| self.missing_for(verb, None));
        let way_out = verb.filter(|_| why == Unsupported::NoPlan).map(|verb| self.way_out(verb));
        let hint = way_out.filter(|way_out| !way_out.is_empty()).unwrap_or(hint);
        if !missing.is_empty() {
            reason = format!("the drive has no {missing}");
        }
        Error::Unsupported { what: format!("{}: {what}: {reason}", self.label()), why, hint }
    }

    /// Remedy for a verb without steps on a drive that is not known: another profile, or the protocol's own words.
    #[must_use]
    pub fn way_out(&self, verb: Verb) -> String {
        if !self.identified.is_generic() {
            return String::new();
        }
        let dissector = polepair_core::proto::find_dissector(self.protocol);
        let example = dissector.and_then(|dissector| dissector.verb_example(verb));
        let example = example.map_or_else(String::new, |example| {
            format!(
                "; `polepair send URL \"{example}\" --arm` sends the drive's own command, in its \
                 own units"
            )
        });
        self.unknown_drive_hint() + &example
    }

    fn unknown_drive_hint(&self) -> String {
        match &self.identified {
            Identification::Generic { nearest: Some(name) } => {
                format!(
                    "no known drive replies like this; the nearest is {name}: `?profile={name}`, \
                     on a motor that may turn"
                )
            }
            _ => {
                let known = registry::protocols().into_iter().find(|it| it.name == self.protocol);
                let has_setup =
                    known.is_some_and(|it| it.keys.iter().any(|key| key.name == "setup"));
                let setup =
                    if has_setup { ", or give its set-up archive by `?setup=`" } else { "" };
                format!("no known drive replies like this; select the drive by `?profile=`{setup}")
            }
        }
    }

    fn unsupported_reason(&self, why: Unsupported) -> (String, String) {
        let product = self.profile.name;
        match why {
            Unsupported::NoSuchAxis => ("there is no such axis".into(), String::new()),
            Unsupported::NoSuchParameter => ("there is no such parameter".into(), String::new()),
            Unsupported::NoPlan => {
                let verbs: Vec<&str> = self.profile.verbs().map(Verb::name).collect();
                let hint = match (&self.identified, verbs.is_empty()) {
                    (Identification::Generic { .. }, _) => self.unknown_drive_hint(),
                    (_, true) => "the drive does not support this".to_owned(),
                    (_, false) => format!("it can {}", verbs.join(", ")),
                };
                (
                    format!("{product} does not support this, or its profile does not describe it"),
                    hint,
                )
            }
            Unsupported::ReadOnly(id)
                if self.parameter(id).is_some_and(|p| p.encoding == Encoding::AnyLength) =>
            {
                let hint = format!("give it with the address, as in `{}`", self.address_example());
                (format!("the type of `{}` is not known", self.parameter_label(id)), hint)
            }
            Unsupported::ReadOnly(id) => {
                // Where another parameter writes it, its description has that.
                let about = self.parameter(id).map_or("", |parameter| parameter.about);
                let hint = if about.contains("Written by") { about } else { "" };
                (format!("`{}` can only be read", self.parameter_label(id)), hint.to_owned())
            }
            Unsupported::WriteOnly(id) => {
                (format!("`{}` can only be written", self.parameter_label(id)), String::new())
            }
            Unsupported::OutOfRange { parameter, value, min, max } => {
                self.range_reason(parameter, value, min, max)
            }
            Unsupported::MissingArgument(argument) => missing_argument(argument),
            Unsupported::BadArgument => ("a value is no finite number".into(), String::new()),
            Unsupported::NotArmed => ("the axis is not armed".into(), ARMING_HINT.into()),
            Unsupported::Busy => (
                "the axis is busy with another command".into(),
                "wait for it, or stop the axis".into(),
            ),
            Unsupported::BadText => (
                format!("that is not a valid {} request", self.protocol),
                "`polepair encode` \
                 shows how"
                    .into(),
            ),
            Unsupported::Forbidden(rule) => (rule.to_owned(), String::new()),
            other => (format!("{other:?}"), String::new()),
        }
    }

    fn parameter_label(&self, id: ParameterId) -> &str {
        self.parameter(id).map_or("it", |p| p.name)
    }

    fn range_reason(&self, id: ParameterId, value: i64, min: i64, max: i64) -> (String, String) {
        let name = self.parameter_label(id);
        if let Some((parameter, defect)) =
            self.parameter(id).and_then(|it| Some((it, it.digit_defect(value)?)))
        {
            let about = parameter.about.to_owned();
            return (format!("`{name}` cannot be {value}: {defect}"), about);
        }
        let (unit, factor) = (self.unit(id), self.factor(id));
        // Without asking the drive: an unknown scale is shown raw.
        let shown = |raw: i64| {
            let si = self.connection.with_axes(|axes, _| axes.to_si(self.index, id, raw));
            match si {
                Some(si) => {
                    let number = (si / factor / unit.si_factor() * 1e6).round() / 1e6;
                    format!("{number} {}", unit.symbol()).trim_end().to_owned()
                }
                None => format!("{raw} (raw)"),
            }
        };
        let (value, min, max) = (shown(value), shown(min), shown(max));
        (format!("{value} is outside the limits of `{name}`"), format!("it can be {min} to {max}"))
    }
}

pub(super) fn value_word(raw: i64, parameter_values: &[(i64, &'static str)]) -> String {
    match parameter_values.iter().find(|(known, _)| *known == raw) {
        Some((_, word)) => format!("{raw} ({word})"),
        None => raw.to_string(),
    }
}

/// Returns whether a request waits for the end of a motion.
fn is_motion(kind: RequestKind) -> bool {
    matches!(kind, RequestKind::Verb(verb) if verb == Verb::Reached || verb.is_move())
}

/// Text of a missing reply, with the received frames.
fn no_answer_text(details: &NoReplyDetails) -> String {
    if details.is_nothing() { "no answer".to_owned() } else { format!("no answer, but {details}") }
}

/// The reason and the remedy where a plan needs what the caller left out.
fn missing_argument(argument: Argument) -> (String, String) {
    let (name, option) = match argument {
        Argument::Target => ("a target", ""),
        Argument::Velocity => ("a speed", "--vel, as in `--vel 60rpm`"),
        Argument::Acceleration => ("an acceleration", "--acc"),
        Argument::Deceleration => ("a deceleration", "--dec"),
        Argument::Torque => ("a torque", "--torque"),
        Argument::JerkTime => ("a jerk time", "--s-curve"),
        Argument::Period => ("a period", "--period"),
        Argument::Path => ("a path", "--path"),
    };
    let hint = if option.is_empty() { String::new() } else { format!("give it with {option}") };
    (format!("this drive starts it with {name}, and none is given"), hint)
}
