//! `polepair send URL TEXT…`

use clap::{Args, ValueEnum};
use polepair::url::AxisNumber;
use polepair::{Axis, LocalAxis};
use polepair_capture::{CaptureDecoder, ExplanationValue, Rules, jsonl};
use polepair_core::proto::drive_address;
use polepair_core::station::LineChange;
use polepair_link::tap::TapDirection;

use crate::broadcast;
use crate::cmd::encode::instructions;
use crate::data_output::DataOutput;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::session::Session;
use crate::tap_queue::{TapQueue, UnitBuf};
use crate::target::{DriveArgs, UnitRef, describe_step};
use crate::terminal::{print_note, print_warning};

/// Sends requests in the protocol's own text, and explains the replies.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair send tmcl+serial:///dev/ttyUSB0#1 \"SIO 0, 2, 1\" \"GIO 0, 0\"
  polepair send tml+serial:///dev/ttyUSB0#255 \"?APOS\"
  polepair send modbus-rtu+serial:///dev/ttyUSB0#1 \"read registers 0x1000 4\"
  polepair send canopen+socketcan://can0#5 \"read 0x6041\" \"nmt start\"
  polepair send sim:tmcl \"ROR 0, 100\" --arm

The language is that of `encode`. All requests are checked before the first one is sent.")]
pub struct Send {
    #[command(flatten)]
    target: DriveArgs,
    /// Requests, such as "GAP 1, 0", "KPP=0x1234", "write Fn_33 200", "read 0x6041", "QV"; several in one text are
    /// separated by semicolons
    #[arg(required = true, value_name = "TEXT")]
    texts: Vec<String>,
    /// Allow requests that may start or change motion
    #[arg(long)]
    arm: bool,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
    /// Output format
    #[arg(long, value_enum, default_value_t = SendFormat::Text)]
    format: SendFormat,
}

/// Output formats of `send`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum SendFormat {
    /// Text
    Text,
    /// One JSON object for each request
    Jsonl,
}

impl Send {
    pub fn run(mut self, server: ServerArgs) -> Result {
        // As `encode` reads them: several in one text are separated by semicolons.
        let split = |text: &String| {
            instructions(text).map(|(_, piece)| piece.trim().to_owned()).collect::<Vec<_>>()
        };
        self.texts = self.texts.iter().flat_map(split).collect();
        if server.is_given() && (self.dry_run || self.arm) {
            let why = "A server sends only requests that move no motor.";
            return Err(remote::unsupported_problem("--dry-run or --arm", why));
        }
        if !self.dry_run && !server.is_given() {
            self.target = broadcast::with_stations(self.target)?;
        }
        let replies = TapQueue::default();
        let session = if server.is_given() {
            self.target.connect(server)?
        } else {
            self.target.open_with_queue(&replies)?.into()
        };
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout().with_text(self.format == SendFormat::Text);
        for axis in session.axes() {
            self.check(&session, axis, &self.texts_of(&session, axis), &mut out)?;
        }
        if self.dry_run {
            out.flush()?;
            print_note("dry run: none of this was sent");
            return Ok(Exit::Ok);
        }
        for axis in broadcast::broadcasts_first(session.axes()) {
            axis.local().inspect(|axis| axis.arm(self.arm));
            for text in &self.texts_of(&session, axis) {
                drop(replies.drain());
                let rate = axis.local().and_then(|axis| axis.connection().line_rate());
                let value = axis.raw(text);
                let reply = axis.local().map(|axis| explain_replies(axis, &replies));
                let value = value.map_err(outcome::to_problem)?;
                match (axis.local(), reply) {
                    (Some(local), Some(replies)) if AxisNumber(local.number()).is_group() => {
                        self.print_each(&session, axis, text, &replies, &mut out);
                    }
                    (_, reply) => {
                        let reply = reply.map(|replies| join_texts(&replies));
                        self.print(&session, axis, text, value, reply.as_deref(), &mut out);
                    }
                }
                out.flush()?;
                if let Some(axis) = axis.local() {
                    note_line(&session, axis, text, rate);
                }
            }
            if broadcast::is_broadcast(axis) {
                print_note(&format!("{} {}", axis.label(), broadcast::SENT));
            }
            if let Some(axis) = axis.local() {
                axis.arm(false);
                self.note_motion(&session, axis);
            }
        }
        Ok(Exit::Ok)
    }

    /// The texts for an axis: beside a broadcast, which has them, a station is asked for what they wrote.
    fn texts_of(&self, session: &Session, axis: &Axis) -> Vec<String> {
        let is_asked =
            session.axes().iter().any(broadcast::is_broadcast) && !broadcast::is_broadcast(axis);
        match axis.local() {
            Some(station) if is_asked => {
                self.texts.iter().filter_map(|text| station.read_back_text(text)).collect()
            }
            _ => self.texts.clone(),
        }
    }

    /// Checks every text before the first is sent; with `--dry-run` their frames are printed.
    /// A server checks each when it is sent.
    fn check(
        &self,
        session: &Session,
        axis: &Axis,
        texts: &[String],
        out: &mut DataOutput,
    ) -> Result<()> {
        let Some(local) = axis.local() else { return Ok(()) };
        for text in texts {
            let rehearsed = local.rehearse_raw(text).map_err(outcome::to_problem)?;
            if self.dry_run {
                let who = session.axis_prefix(axis);
                for frame in &rehearsed.frames {
                    out.write_line(&format!("{who}{}", describe_step(local, frame)));
                }
            } else if rehearsed.needs_arming && !self.arm {
                let effect = describe_effect(rehearsed.line_change);
                let what = format!("{}: `{text}` {effect}.", axis.label());
                return Err(Problem::usage("E219", what)
                    .why("Nothing was sent.")
                    .hint("--arm allows it; --dry-run prints its bytes"));
            }
        }
        Ok(())
    }

    /// Prints a reply. A server sends its value alone, without the frames that explain it.
    fn print(
        &self,
        session: &Session,
        axis: &Axis,
        text: &str,
        value: i64,
        reply: Option<&str>,
        out: &mut DataOutput,
    ) {
        let who = session.axis_prefix(axis);
        match (self.format, reply) {
            (SendFormat::Text, None) => out.write_line(&format!("{who}{text}: {value}")),
            (SendFormat::Text, Some("")) => {
                out.write_line(&format!("{who}{text}: sent; no reply"));
            }
            (SendFormat::Text, Some(reply)) => out.write_line(&format!("{who}{reply}")),
            (SendFormat::Jsonl, reply) => {
                let link = axis.remote().map(|axis| axis.info().link);
                write_json(axis.number(), link, text, Some(value), reply.unwrap_or(""), out);
            }
        }
    }

    /// Prints a line for each reply of a group's drives.
    fn print_each(
        &self,
        session: &Session,
        axis: &Axis,
        text: &str,
        replies: &[DriveReply],
        out: &mut DataOutput,
    ) {
        let who = session.axis_prefix(axis);
        match self.format {
            SendFormat::Text if replies.is_empty() => {
                out.write_line(&format!("{who}{text}: sent; no reply"));
            }
            SendFormat::Text => {
                replies.iter().for_each(|reply| out.write_line(&format!("{who}{}", reply.text)));
            }
            SendFormat::Jsonl if replies.is_empty() => {
                write_json(axis.number(), None, text, None, "", out);
            }
            SendFormat::Jsonl => {
                for DriveReply { axis: sender, value, text: reply } in replies {
                    let number = sender.unwrap_or(axis.number());
                    write_json(number, None, text, *value, reply, out);
                }
            }
        }
    }

    /// Notes that a started motion continues after the end of this program.
    fn note_motion(&self, session: &Session, axis: &LocalAxis) {
        let may_move = |text: &String| {
            let rehearsed = axis.rehearse_raw(text);
            rehearsed.is_ok_and(|it| it.needs_arming && it.line_change.is_none())
        };
        if self.texts.iter().any(may_move) {
            print_warning(&format!(
                "{} may turn now: `polepair stop {}` stops it",
                axis.label(),
                session.arguments
            ));
        }
    }
}

/// Notes the rate at which the drive is reached from now on. `before` is that of the line before the request.
fn note_line(session: &Session, axis: &LocalAxis, text: &str, before: Option<u32>) {
    let rehearsed = axis.rehearse_raw(text).ok();
    let Some(change) = rehearsed.and_then(|it| it.line_change) else { return };
    let url_at = |rate| session.local_url()?.with_baud(rate);
    let now = axis.connection().line_rate();
    let label = axis.label();
    match (change, now) {
        (LineChange::Baud(_), Some(rate)) if now != before => {
            let url = url_at(rate).map(|url| format!(": use {url}")).unwrap_or_default();
            print_note(&format!("the line is at {rate} baud now{url}"));
        }
        (LineChange::Baud(Some(rate)), _) if now != Some(rate) => {
            let line = now.map_or_else(
                || "the rate of this line is set elsewhere".to_owned(),
                |now| format!("this line stays at {now}, as its other axes need it"),
            );
            let url = url_at(rate).map(|url| format!(": only {url} reaches it"));
            let url = url.unwrap_or_default();
            print_warning(&format!("{label} is at {rate} baud now, and {line}{url}"));
        }
        (LineChange::BitRate, _) => print_warning(&format!(
            "{label} may be at another bit rate now: the rates of its numbers are not published; \
             a power cycle restores 500 kbit/s"
        )),
        _ => {}
    }
}

/// Reason why a request needs to be allowed.
fn describe_effect(change: Option<LineChange>) -> String {
    match change {
        None => "may start the motor".to_owned(),
        Some(LineChange::Baud(Some(rate))) => format!("changes the line's rate to {rate} baud"),
        Some(LineChange::Baud(None)) => "changes the line's rate".to_owned(),
        Some(LineChange::BitRate) => "changes the bit rate of the drive".to_owned(),
        Some(LineChange::Address) => "changes the address or the groups of the drive".to_owned(),
    }
}

/// A frame that a drive sent.
struct DriveReply {
    /// The axis that sent it; `None` where the frame does not name it.
    axis: Option<u32>,
    /// Value in the frame, if it has one.
    value: Option<i64>,
    /// Meaning of the frame.
    text: String,
}

/// The drive's frames, from the last answered request on: the host may send another one before. For a group, those of
/// each drive.
fn explain_replies(axis: &LocalAxis, replies: &TapQueue) -> Vec<DriveReply> {
    let rules = Rules::for_protocols([axis.protocol()]);
    let mut decoder = CaptureDecoder::new(rules).with_profile(Some(axis.profile()));
    let (mut found, mut asked) = (Vec::<DriveReply>::new(), false);
    let is_group = AxisNumber(axis.number()).is_group();
    let (units, _) = replies.drain();
    for queued in &units {
        let unit = match &queued.unit {
            UnitBuf::Bytes(bytes) => UnitRef::Bytes(bytes),
            UnitBuf::Frame(frame) => UnitRef::Frame(frame),
        };
        let from_drive = queued.direction == TapDirection::ToHost;
        unit.decode(&mut decoder, queued.at, "link", queued.direction, &mut |event| {
            let explanation = &event.explanation;
            let is_own = |other: u32| is_group || other == drive_address(axis.number());
            if from_drive && explanation.axis.is_none_or(is_own) && !explanation.text.is_empty() {
                if std::mem::take(&mut asked) {
                    found.clear();
                }
                let mut fields = explanation.fields();
                let value = fields.find(|field| field.name == "value");
                let value = value.and_then(|field| match field.value {
                    ExplanationValue::Int(value) => Some(value),
                    _ => None,
                });
                let text = explanation.text.clone();
                found.push(DriveReply { axis: explanation.axis, value, text });
            }
            asked |= !from_drive;
        });
    }
    found
}

fn join_texts(replies: &[DriveReply]) -> String {
    replies.iter().map(|reply| reply.text.as_str()).collect::<Vec<_>>().join("; ")
}

fn write_json(
    number: u32,
    link: Option<u16>,
    text: &str,
    value: Option<i64>,
    reply: &str,
    out: &mut DataOutput,
) {
    let value = value.map_or_else(|| "null".to_owned(), |value| value.to_string());
    let out = out.buffer();
    out.extend_from_slice(format!("{{\"axis\":{},", AxisNumber(number).json()).as_bytes());
    if let Some(link) = link {
        out.extend_from_slice(format!("\"link\":{link},").as_bytes());
    }
    out.extend_from_slice(b"\"request\":");
    jsonl::write_string(out, text);
    out.extend_from_slice(format!(",\"value\":{value},\"reply\":").as_bytes());
    jsonl::write_string(out, reply);
    out.extend_from_slice(b"}\n");
}
