//! Frames in their conversation: who speaks, what is owed by the VM in force, which values are told.

use super::readings;
use crate::explain::{Act, Awaits, Effect, Owed, Raw, Reading, Sink, Talk, Turn, What};
use crate::profile::Profile;
use crate::proto::thruster::readings::{Form, Readings, is_command};
use crate::proto::thruster::rules::{self, class_of};
use crate::proto::thruster::wire::{
    Bare, Command, Heard, REFUSED, Reply, Report, Request, Shape, node,
};

pub(super) fn turn(frame: &Raw<'_>, talk: &Talk<'_>) -> Turn {
    match frame.id.filter(|_| !frame.extended).and_then(node) {
        Some(Ok(_)) => Turn::Asks(awaits(frame, talk)),
        Some(Err(_)) => match Heard::parse(frame.bytes) {
            Ok(Heard::Report(Report { of: Report::BY_ITSELF, .. })) => Turn::Tells,
            // ML and MM make a drive tell these by itself.
            Ok(Heard::Reply(Reply { command: Command::QC | Command::QV, .. })) => Turn::Tells,
            Ok(Heard::Reply(reply)) if reply.command.known().is_none() => Turn::Aside,
            Ok(_) => Turn::Answers,
            Err(_) => Turn::Aside,
        },
        None => Turn::Aside,
    }
}

/// What is no command of this protocol is another one's on the same identifiers.
pub(super) fn effect(frame: &Raw<'_>) -> Effect {
    match (frame.id.filter(|_| !frame.extended).and_then(node), Request::parse(frame.bytes)) {
        (Some(Err(_)), _) => Effect::NOTHING,
        (Some(Ok(_)), Ok(request)) if request.command.known().is_some() => {
            let keeps = rules::keeps(&request);
            let act = if keeps { Act::Sets } else { Effect::of_class(class_of(&request)).act };
            Effect { act, keeps }
        }
        _ => Effect::UNKNOWN,
    }
}

fn awaits(request: &Raw<'_>, talk: &Talk<'_>) -> Awaits {
    match Request::parse(request.bytes) {
        Ok(request) if request.command.is_output() => output_awaits(form(talk)),
        Ok(request) if request.command.known().is_some() => Awaits::ANSWER,
        _ => Awaits::NOTHING,
    }
}

/// TC and VC are answered as VM says; nobody knows how while no VM was seen.
fn output_awaits(form: Option<Form>) -> Awaits {
    match form {
        None => Awaits::PERHAPS,
        Some(Form::Silent) => Awaits::NOTHING,
        Some(Form::Echo | Form::Headerless) => Awaits::ANSWER,
        Some(Form::Frames(frames)) => {
            Awaits { acks: Owed::Nothing, answers: Owed::Exactly(frames.count_ones() as u8) }
        }
    }
}

fn form(talk: &Talk<'_>) -> Option<Form> {
    let request = Request::parse(talk.form?.bytes).ok()?;
    Some(readings(talk.profile).form(request.data? as u16))
}

pub(super) fn forms(request: &Raw<'_>) -> bool {
    Request::parse(request.bytes).is_ok_and(|r| r.command == Command::VM && r.data.is_some())
}

/// The value that means refusal, or a setting that comes back as another than was sent.
pub(super) fn refuses(answer: &Raw<'_>, request: &Raw<'_>) -> Option<&'static str> {
    let Ok(Heard::Reply(reply)) = Heard::parse(answer.bytes) else { return None };
    let asked = Request::parse(request.bytes).ok()?.data;
    if reply.data == REFUSED && asked != Some(REFUSED) {
        return Some("refused: a fault, an output that is forbidden, or a bad value");
    }
    let set = matches!(reply.command.known(), Some((Shape::Set, _)));
    let read = |data| reply.command.width().read(data);
    let other = asked.is_some_and(|asked| read(asked) != read(reply.data));
    (set && other).then_some("not what was asked: not accepted, or stopped")
}

/// From power-up a drive repeats TC and VC; one that was told otherwise by VM and repeats them has
/// forgotten it.
pub(super) fn restarted(answer: &Raw<'_>, request: &Raw<'_>, talk: &Talk<'_>) -> bool {
    let output = Request::parse(request.bytes).is_ok_and(|asked| asked.command.is_output());
    let told = form(talk).is_some_and(|form| form != Form::Echo);
    let repeats = matches!(
        Heard::parse(answer.bytes),
        Ok(Heard::Reply(Reply { command, data, .. })) if command.is_output() && data != REFUSED
    );
    output && told && repeats
}

/// What is set.
pub(super) fn told(request: &Request, profile: Option<&'static Profile>, sink: &mut dyn Sink) {
    let set = matches!(request.command.known(), Some((Shape::Set, _)));
    if let (true, Some(data)) = (set && request.command != Command::SP, request.data) {
        tell(request.command, request.command.width().read(data), true, profile, sink);
    }
}

/// What a drive says.
pub(super) fn found(
    heard: &Heard,
    asked: Option<u32>,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let mut say = |command: Command, raw: i64| tell(command, raw, false, profile, sink);
    match heard {
        Heard::Reply(Reply { command, data, .. }) => {
            let query = matches!(command.known(), Some((Shape::Query, _)));
            let refused = *data == REFUSED && asked != Some(REFUSED);
            if query && !refused && *command != Command::RP {
                say(*command, command.width().read(*data));
            }
        }
        Heard::Report(report) => reported(report, readings(profile), &mut say),
        Heard::Bare(Bare { rpm, decivolt, deciamp, status }) => {
            say(Command::QV, (*rpm).into());
            say(Command::QP, (*decivolt).into());
            say(Command::QC, (*deciamp).into());
            say(Command::EF, (*status).into());
        }
    }
}

fn reported(report: &Report, readings: Readings, say: &mut dyn FnMut(Command, i64)) {
    let [a, b, c] = report.words;
    let signed = |word: u16| i64::from(word.cast_signed());
    match report.part {
        1 => {
            say(Command::QV, signed(a));
            say(Command::QP, b.into());
            say(Command::QC, signed(c));
        }
        2 => {
            say(Command::EF, a.into());
            say(Command::QT, signed(b));
            say(Command::EQ, signed(c));
        }
        _ => {
            let (absolute, relative) = readings.positions(report);
            say(Command::QA, absolute.into());
            say(Command::QR, relative.into());
        }
    }
}

fn tell(
    command: Command,
    raw: i64,
    written: bool,
    profile: Option<&'static Profile>,
    sink: &mut dyn Sink,
) {
    let mut parameters = profile.into_iter().flat_map(|profile| profile.parameters);
    let parameter = parameters.find(|parameter| is_command(parameter, command));
    let letters = command.letters();
    let what = parameter.map_or(What::Named(letters.as_str()), What::Parameter);
    sink.reading(Reading { what, raw, written, part: 0 });
}
