//! Outcomes in words: what was asked, what came of it, what to try.

use super::Axis;
use crate::error::Error;
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::profile::{Fault, ParameterId};

impl Axis {
    /// The error for an outcome that is not [`Outcome::Done`].
    pub(crate) fn failed(&self, what: &str, outcome: Outcome) -> Error {
        let failure = match outcome {
            Outcome::NotDone(failure) | Outcome::Unknown(failure) => failure,
            Outcome::Done(_) => Failure::Misbehaved,
        };
        if let Failure::Impossible(why) = failure {
            return self.refuse(what, why);
        }
        let (reason, hint) = self.reason(failure);
        Error::Failed { what: format!("{}: {what}: {reason}", self.label()), outcome, hint }
    }

    fn reason(&self, failure: Failure) -> (String, String) {
        let said = |reason: &str, hint: &str| (reason.to_owned(), hint.to_owned());
        match failure {
            Failure::Silent => said(
                "no answer",
                "check power, wiring, baud rate and address; `polepair scan` looks for other addresses",
            ),
            Failure::Refused { code } => self.refusal(code),
            Failure::Misbehaved => said(
                "what came back was corrupt or answered another question",
                "look for two drives with one address, an echoing adapter, noise or a wrong baud \
                 rate; `-v` shows the frames",
            ),
            Failure::NotReached => said("not reached in time", "see whether something blocks it"),
            Failure::NotReady { hint } => said("the drive is not ready", hint),
            Failure::Faulted { code } => self.fault(code),
            Failure::Differs { start, end } => (
                format!("the drive has other words at {start:04X} to {end:04X}"),
                "load the program again; if that does not help, that memory is locked \
                 (LOCKEEPROM), not there, or worn out"
                    .to_owned(),
            ),
            Failure::Cancelled => said("a stop or a newer command came between", ""),
            Failure::LinkDown => {
                let trouble = self.connection.trouble();
                let hint = trouble.as_ref().map(|t| t.hint().to_owned()).unwrap_or_default();
                let reason = trouble.map_or("the link is down".to_owned(), |t| t.to_string());
                (reason, hint)
            }
            other => (format!("it ended as {other:?}"), String::new()),
        }
    }

    fn refusal(&self, code: u32) -> (String, String) {
        let dissector = polepair_core::proto::dissector(self.protocol);
        let meaning = dissector.and_then(|dissector| dissector.code(code));
        // Long ones are never written otherwise, as abort codes of CANopen.
        let code = if code > 0xFFFF { format!("0x{code:08X}") } else { code.to_string() };
        let reason = match meaning {
            Some(meaning) => format!("the drive refused: {meaning} (code {code})"),
            None => format!("the drive refused with code {code}"),
        };
        (reason, String::new())
    }

    fn fault(&self, code: u32) -> (String, String) {
        let known = faults(self.profile.faults, code);
        let Some(first) = known.first() else {
            return (format!("the drive reports fault {code:#x}"), String::new());
        };
        let texts: Vec<String> =
            known.iter().map(|fault| format!("{} ({})", fault.text, fault.name)).collect();
        let hint = [first.cause, first.remedy].map(|s| s.trim_end_matches('.'));
        let hint: Vec<&str> = hint.into_iter().filter(|s| !s.is_empty()).collect();
        (format!("the drive reports: {}", texts.join(", ")), hint.join(". "))
    }

    /// The error for what cannot be; nothing was sent.
    pub(crate) fn refuse(&self, what: &str, why: Unsupported) -> Error {
        let product = self.profile.name;
        let name = |id: ParameterId| self.profile.parameter(id).map_or("it", |p| p.name);
        let (reason, hint) = match why {
            Unsupported::NoSuchAxis => ("there is no such axis".into(), String::new()),
            Unsupported::NoSuchParameter => ("there is no such parameter".into(), String::new()),
            Unsupported::NoPlan => {
                let verbs: Vec<&str> =
                    self.profile.plans.iter().map(|plan| plan.verb.name()).collect();
                let can =
                    if verbs.is_empty() { "nothing of the kind".into() } else { verbs.join(", ") };
                (
                    format!("{product} cannot do that, or it is not known how"),
                    format!("it can {can}"),
                )
            }
            Unsupported::ReadOnly(id) => {
                (format!("`{}` can only be read", name(id)), String::new())
            }
            Unsupported::WriteOnly(id) => {
                (format!("`{}` can only be written", name(id)), String::new())
            }
            Unsupported::OutOfRange { parameter, value, min, max } => {
                self.range(parameter, value, min, max)
            }
            Unsupported::BadArgument => {
                ("a value is missing, or is no finite number".into(), String::new())
            }
            Unsupported::NotArmed => {
                ("the axis is not armed".into(), "arm it first: motion needs an armed axis".into())
            }
            Unsupported::Busy => (
                "the axis is busy with another command".into(),
                "wait for it, or stop the axis".into(),
            ),
            Unsupported::BadText => {
                (format!("that is no {} text", self.protocol), "`polepair encode` shows how".into())
            }
            Unsupported::Forbidden(rule) => (rule.to_owned(), String::new()),
            other => (format!("{other:?}"), String::new()),
        };
        Error::Unsupported { what: format!("{}: {what}: {reason}", self.label()), why, hint }
    }

    fn range(&self, id: ParameterId, value: i64, min: i64, max: i64) -> (String, String) {
        let name = self.profile.parameter(id).map_or("it", |p| p.name);
        let (unit, factor) = (self.unit(id), self.factor(id));
        // Without asking the drive: an unknown scale is shown raw.
        let shown = |raw: i64| {
            let si = self.connection.with(|axes, _| axes.to_si(self.index, id, raw));
            match si {
                Some(si) => {
                    let number = (si / factor / unit.si() * 1e6).round() / 1e6;
                    format!("{number} {}", unit.symbol()).trim_end().to_owned()
                }
                None => format!("{raw} (raw)"),
            }
        };
        let (value, min, max) = (shown(value), shown(min), shown(max));
        (format!("{value} is outside the limits of `{name}`"), format!("it can be {min} to {max}"))
    }
}

/// The faults that a code means: the one of that code, or those whose bits are in it.
fn faults(table: &'static [Fault], code: u32) -> Vec<&'static Fault> {
    if let Some(fault) = table.iter().find(|fault| fault.code == code) {
        return vec![fault];
    }
    let masks = table.iter().all(|fault| fault.code.count_ones() == 1);
    table.iter().filter(|fault| masks && fault.code & code != 0).collect()
}
