//! Common options of verbs on drives, and the conversion of a connection string to a session.

use std::sync::{Arc, OnceLock};

use clap::{Args, ValueEnum};
use polepair::axis::Rehearsal;
use polepair::url::{LinkTarget::Rack, shell_word};
use polepair::{Axis, Connector, LocalAxis, LocalLink};
use polepair_capture::{CaptureDecoder, Rules, Timestamp, text};
use polepair_core::axis::{Command, RehearsalAction, Verb};
use polepair_core::explain::Direction as Said;
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::profile::{ParameterId, Profile};
use polepair_core::proto::drive_address;
use polepair_core::time::Instant;
use polepair_link::clock;
use polepair_link::tap::{Tap, TapDirection};

use crate::data_output::DataOutput;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::profile_args::warn_ignored_file;
use crate::remote::{self, ServerArgs};
use crate::session::{LocalSession, Session};
use crate::tap_queue::{QueueTap, TapQueue};
use crate::terminal::{self, print_note, print_warning};
use crate::trace::TraceArgs;
use crate::trace::{self, FrameTrace};

/// A drive, and options to show the frames exchanged with it.
#[derive(Args, Debug)]
pub struct DriveArgs {
    /// Link and axes: tmcl+serial:///dev/ttyUSB0:9600#1, sim:tmcl, @name
    #[arg(value_name = "URL")]
    pub url: String,
    /// Print all frames, decoded, on stderr
    #[arg(short, long)]
    pub verbose: bool,
    #[command(flatten)]
    pub trace: TraceArgs,
    #[command(flatten)]
    pub profiles: crate::profile_args::ProfileFile,
    /// Profiles of the drives found so far, used to decode their frames.
    #[arg(skip)]
    naming: NamingProfiles,
    /// Set for stops: an unreadable optional file must not prevent them.
    #[arg(skip)]
    stops: bool,
}

/// The drives by whose profiles frames are named, once they are known: addresses and profiles.
type NamingProfiles = Arc<OnceLock<Vec<(u32, &'static Profile)>>>;

/// Warnings about data sheets that are printed.
const SHEET_WARNINGS_MAX: usize = 10;

/// Output formats of readings.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub enum OutputFormat {
    /// Text
    Text,
    /// One JSON object for each reading
    Jsonl,
    /// Comma-separated, with a header
    Csv,
}

impl DriveArgs {
    /// Target of a stop.
    pub fn for_stop(self) -> Self {
        Self { stops: true, ..self }
    }

    /// Replaces the URL.
    pub fn at(self, url: String) -> Self {
        Self { url, ..self }
    }

    /// Opens the link and identifies its drives.
    pub fn open(&self) -> Result<LocalSession> {
        self.open_url(&self.url)
    }

    /// Opens the link, or joins the server that is named.
    pub fn connect(&self, server: ServerArgs) -> Result<Session> {
        if server.is_given() {
            let words = self.remote_axes()?;
            Ok(Session::of_server(server.link(words)?, words))
        } else {
            self.open().map(Session::from)
        }
    }

    /// [`connect`](Self::connect), and on a link the errors of the axes that do not reply. A server lists missing
    /// axes itself.
    pub fn connect_present(&self, server: ServerArgs) -> Result<(Session, Vec<Problem>)> {
        if server.is_given() {
            return Ok((self.connect(server)?, Vec::new()));
        }
        let (session, absent) = self.open_present()?;
        Ok((Session::from(session), absent))
    }

    /// Opens the axes that answer, and returns the others with their errors.
    pub fn open_present(&self) -> Result<(LocalSession, Vec<Problem>)> {
        let connector = self.connector()?;
        let (link, absent) = connector.connect_present(&self.url).map_err(outcome::to_problem)?;
        warn_ignored_files(&connector);
        let absent = absent.into_iter().map(|(_, error)| outcome::to_problem(error)).collect();
        Ok((self.build_session(link, &self.url)?, absent))
    }

    /// Selected axes in the place of the URL, on a server. Frames pass where the server is.
    pub fn remote_axes(&self) -> Result<&str> {
        if self.verbose || self.trace.path().is_some() || self.profiles.is_given() {
            return Err(remote::unsupported_problem(
                "-v, --trace or --profile",
                "A server opens its links itself.",
            )
            .hint("its page shows the frames"));
        }
        Ok(&self.url)
    }

    /// Opens the link; a queue gets a copy of its frames.
    pub fn open_with_queue(&self, queue: &TapQueue) -> Result<LocalSession> {
        self.open_with(&self.build_connector(Some(queue))?, &self.url)
    }

    /// Connector with the taps that print or record frames.
    pub fn connector(&self) -> Result<Connector> {
        self.build_connector(None)
    }

    fn build_connector(&self, queue: Option<&TapQueue>) -> Result<Connector> {
        let mut connector = if self.stops {
            self.profiles.connector_to_stop()
        } else {
            self.profiles.connector()?
        };
        #[cfg(test)]
        {
            connector = crate::every_frame::with_faulty_wire(connector);
        }
        let trace = match self.trace.create(&self.url) {
            Err(problem) if self.stops => {
                print_warning(&format!(
                    "warning: {} {} No frame is recorded.",
                    problem.what, problem.why
                ));
                None
            }
            trace => trace?,
        };
        if self.verbose || trace.is_some() || queue.is_some() {
            let name = trace::link_name(&self.url);
            let protocols = connector.protocols(&self.url).map_err(outcome::to_problem)?;
            let shown =
                self.verbose.then(|| FramePrinter::new(&protocols, name, self.naming.clone()));
            let queue = queue.map(|queue| queue.tap(0));
            connector = connector.with_tap(FrameTap { trace, shown, queue });
        }
        Ok(connector)
    }

    /// Prints the frames of a command, step by step, and sends nothing of it.
    pub fn rehearse(&self, command: impl Fn(&LocalAxis) -> Result<Command>) -> Result {
        self.rehearse_all(|axis| Ok(vec![command(axis)?]))
    }

    /// Prints the frames of a motion as its verb sends them: it powers the axis first.
    pub fn rehearse_motion(&self, command: impl Fn(&Axis) -> Result<Command>) -> Result {
        self.rehearse_all(|axis| {
            let enable = axis.profile().plan(Verb::Enable).map(|_| Command::new(Verb::Enable));
            let command = command(&Axis::from(axis.clone()))?;
            if let Some((id, mode)) = axis.mode_for(command.verb) {
                let name = axis.parameter(id).map_or("?", |parameter| parameter.name);
                print_note(&format!(
                    "where the axis is off and in another mode: write {name} = {mode} first"
                ));
            }
            Ok(enable.into_iter().chain([command]).collect())
        })
    }

    fn rehearse_all(&self, commands: impl Fn(&LocalAxis) -> Result<Vec<Command>>) -> Result {
        let session = self.open()?;
        let mut out = DataOutput::stdout();
        for axis in session.axes() {
            for command in commands(axis)? {
                for step in axis.rehearse(command).map_err(outcome::to_problem)? {
                    out.write_line(&format!(
                        "{}{}",
                        session.axis_prefix(axis),
                        describe_step(axis, &step)
                    ));
                }
            }
        }
        out.flush()?;
        terminal::print_note("dry run: none of this was sent");
        Ok(Exit::Ok)
    }

    /// Has frames shown by the names of the drives' profiles, once they are known.
    fn name_frames(&self, axes: &[LocalAxis]) {
        let _ = self
            .naming
            .set(axes.iter().map(|axis| (drive_address(axis.number()), axis.profile())).collect());
    }

    fn open_url(&self, url: &str) -> Result<LocalSession> {
        self.open_with(&self.connector()?, url)
    }

    /// Opens a link as a connector does: for who opens several, one trace has the frames of all.
    pub fn open_with(&self, connector: &Connector, url: &str) -> Result<LocalSession> {
        let link = connector.connect_local(url).map_err(outcome::to_problem)?;
        warn_ignored_files(connector);
        self.build_session(link, url)
    }

    fn build_session(&self, link: LocalLink, url: &str) -> Result<LocalSession> {
        if link.axes().is_empty() {
            return Err(Problem::new(Exit::NoReply, "E402", format!("there is no axis on {url}.")));
        }
        if matches!(link.url().target, Rack { .. }) && link.simulation().is_some() {
            print_note(&format!(
                "{url} is simulated: its file does not say where it is (`connect`)"
            ));
        }
        self.name_frames(link.axes());
        Ok(LocalSession {
            link,
            arguments: format!("{}{}", shell_word(&self.url), self.profiles.as_arguments()),
        })
    }
}

/// Prints the wrong files that were ignored, except those of the configuration, which were printed.
pub fn warn_ignored_files(connector: &Connector) {
    // Those were printed when the configuration was read.
    let known = connector.config.broken.len();
    connector.ignored_files().iter().skip(known).for_each(warn_ignored_file);
    connector.config.take_notices().iter().for_each(|notice| print_warning(notice));
    let warnings = connector.sheet_warnings();
    warnings
        .iter()
        .take(SHEET_WARNINGS_MAX)
        .for_each(|warning| print_warning(&format!("{warning}")));
    if let Some(more @ 1..) = warnings.len().checked_sub(SHEET_WARNINGS_MAX) {
        print_note(&format!("{more} more of the data sheet"));
    }
}

/// One step of a plan: its bytes, and their meaning.
pub fn describe_step(axis: &LocalAxis, step: &Rehearsal) -> String {
    let does = match step.step {
        RehearsalAction::Read(id) => format!("read {}", parameter_name(id, axis)),
        RehearsalAction::Write(id, raw) => {
            format!("write {} = {raw} raw", parameter_name(id, axis))
        }
        RehearsalAction::WriteIfDifferent(id, raw) => {
            format!("write {} = {raw} raw unless it is", parameter_name(id, axis))
        }
        RehearsalAction::WriteReadValue(from, to) => {
            format!(
                "read {} and write it to {}",
                parameter_name(from, axis),
                parameter_name(to, axis)
            )
        }
        RehearsalAction::WriteTogether(writes) => {
            let names: Vec<&str> = writes.iter().map(|(id, _)| parameter_name(*id, axis)).collect();
            format!("write {} with one request", names.join(", "))
        }
        RehearsalAction::WriteBits(id, mask, raw) => {
            format!(
                "read {}, write it with its bits {mask:#x} = {raw:#x}",
                parameter_name(id, axis)
            )
        }
        RehearsalAction::Store(id) => format!("keep {} over power-off", parameter_name(id, axis)),
        RehearsalAction::Send => format!("send {}", explain_step(axis, step)),
        RehearsalAction::QueryProgram => "read whether its program runs".to_owned(),
        RehearsalAction::EndProgram => "end its program, if one runs".to_owned(),
        RehearsalAction::Wait(ms) => format!("wait {ms} ms"),
    };
    let shown = match &step.frame {
        Some(frame) => frame.to_string(),
        None => {
            let mut bytes = Vec::new();
            text::append_spaced_hex(&mut bytes, &step.bytes);
            String::from_utf8_lossy(&bytes).into_owned()
        }
    };
    format!("{shown:<26}  {does}")
}

fn parameter_name(id: ParameterId, axis: &LocalAxis) -> &str {
    axis.parameter(id).map_or("?", |parameter| parameter.name)
}

/// Meaning of a frame in its protocol's own words; empty if unknown.
fn explain_step(axis: &LocalAxis, step: &Rehearsal) -> String {
    let rules = Rules::for_protocols([axis.protocol()]);
    let mut decoder = CaptureDecoder::new(rules).with_profile(Some(axis.profile()));
    let mut text = String::new();
    let mut keep =
        |event: &polepair_capture::DecodedFrame<'_>| text = event.explanation.text.to_owned();
    let by = Some(Said::ToDrive);
    match &step.frame {
        Some(frame) => decoder.decode_frame(None, "link", by, frame, &mut |event| keep(event)),
        None => decoder.decode_bytes(None, "link", by, &step.bytes, &mut |event| keep(event)),
    }
    text
}

/// Treatment of frames by `-v` and `--trace`, and their further receivers.
struct FrameTap {
    trace: Option<FrameTrace>,
    shown: Option<FramePrinter>,
    queue: Option<QueueTap>,
}

impl Tap<Stream> for FrameTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, bytes: &[u8]) {
        if let Some(trace) = &mut self.trace {
            trace.write_bytes(at, direction, bytes);
        }
        if let Some(shown) = &mut self.shown {
            shown.print(at, direction, UnitRef::Bytes(bytes));
        }
        if let Some(queue) = &mut self.queue {
            Tap::<Stream>::record_unit(queue, at, direction, bytes);
        }
    }
}

impl Tap<Can> for FrameTap {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, frame: &Frame) {
        if let Some(trace) = &mut self.trace {
            trace.write_frame(at, direction, frame);
        }
        if let Some(shown) = &mut self.shown {
            shown.print(at, direction, UnitRef::Frame(frame));
        }
        if let Some(queue) = &mut self.queue {
            Tap::<Can>::record_unit(queue, at, direction, frame);
        }
    }
}

/// A unit on a link.
#[derive(Clone, Copy, Debug)]
pub enum UnitRef<'a> {
    /// Bytes of a serial line.
    Bytes(&'a [u8]),
    /// A CAN frame.
    Frame(&'a Frame),
}

impl UnitRef<'_> {
    /// Has a decoder look at it.
    pub fn decode(
        &self,
        decoder: &mut CaptureDecoder,
        at: Instant,
        link: &str,
        direction: TapDirection,
        out: &mut dyn FnMut(&polepair_capture::DecodedFrame<'_>),
    ) {
        let statement = match direction {
            TapDirection::ToDrive => Said::ToDrive,
            TapDirection::ToHost => Said::ToHost,
        };
        let time = Some(Timestamp(clock::wall_ns(at)));
        match self {
            Self::Bytes(bytes) => decoder.decode_bytes(time, link, Some(statement), bytes, out),
            Self::Frame(frame) => decoder.decode_frame(time, link, Some(statement), frame, out),
        }
    }
}

/// Frames, explained, on stderr.
struct FramePrinter {
    decoder: CaptureDecoder,
    text: text::FrameTextWriter,
    name: String,
    naming: NamingProfiles,
}

impl FramePrinter {
    /// For a link on which these protocols are spoken.
    fn new(protocols: &[&str], name: String, naming: NamingProfiles) -> Self {
        let rules = Rules::for_protocols(protocols.iter().copied());
        let style =
            text::TextStyle { colour: terminal::colour_err(), ..text::TextStyle::default() };
        Self {
            decoder: CaptureDecoder::new(rules),
            text: text::FrameTextWriter::new(style),
            name,
            naming,
        }
    }

    fn print(&mut self, at: Instant, direction: TapDirection, unit: UnitRef<'_>) {
        let Self { decoder, text, name, naming } = self;
        if let Some(drives) = naming.get() {
            // The drives are identified while frames are already shown; names are used from then on.
            decoder.set_drive_profiles(drives.clone());
        }
        let mut lines = Vec::new();
        unit.decode(decoder, at, name, direction, &mut |event| text.write(event, &mut lines));
        terminal::draw(&String::from_utf8_lossy(&lines));
    }
}
