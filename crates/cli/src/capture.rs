//! Input captures of the verbs: reads a file or stdin by the user's options, and passes the frames to a
//! sink.

use std::fs::File;
use std::io::{Read as _, stdin};
use std::path::Path;
use std::time::Duration;

use clap::{Args, ValueEnum};
use polepair_capture::parallel::{self, BatchConsumer, JOBS_MAX, OutputCallback};
use polepair_capture::{
    CaptureDecoder, CaptureFormat, DecodedFrame, FollowEvent, FollowReader, LinkDetection,
    LogTimes, ProtocolDetector, ReadOptions, ReadStatistics, Remark, Rules, WriteError,
};
use polepair_core::profile::Profile;

use crate::problem::{self, Exit, Problem, Result};
use crate::profile_args::NamingArgs;
use crate::progress::Progress;
use crate::terminal::{print_note, print_warning};
use crate::value;

/// Pause of a capture on stdin after which its protocol is decided by the received part, and it is followed from there.
const JUDGE_PAUSE: Duration = Duration::from_millis(700);
/// Bytes of a capture on stdin that are gathered for the judgement.
const GATHER_MAX: usize = 1 << 28;
const READ_SIZE: usize = 1 << 18;

/// Options of reading a capture.
#[derive(Args, Debug)]
pub struct CaptureArgs {
    #[command(flatten)]
    stated: StatedArgs,
    /// Times of a text log: absolute, or differences to the line before (`candump -td`)
    #[arg(long, value_name = "KIND", value_enum, default_value_t = TimesArg::Detect)]
    times: TimesArg,
}

/// Properties of a capture that the user states.
#[derive(Args, Debug)]
pub struct StatedArgs {
    /// Protocol of the capture, or PROTO@AXIS or PROTO@LINK for a part of it; separate several by commas
    #[arg(long = "as", value_name = "PROTO[@ID],…")]
    rules: Option<String>,
    /// File format of the capture [default: detected from its first bytes]
    #[arg(long, value_name = "FORMAT", value_parser = value::capture_format())]
    from: Option<CaptureFormat>,
    #[command(flatten)]
    named_by: NamingArgs,
}

/// Origin of the times of a text log.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub enum TimesArg {
    /// Differences if the first is 0 and a later one is less than the one before
    Detect,
    /// One moment for all lines
    Absolute,
    /// The line before
    Delta,
}

impl From<TimesArg> for LogTimes {
    fn from(times: TimesArg) -> Self {
        match times {
            TimesArg::Detect => Self::Detect,
            TimesArg::Absolute => Self::Absolute,
            TimesArg::Delta => Self::Delta,
        }
    }
}

/// Receiver of the frames of a capture.
pub trait EventSink {
    /// Takes a frame.
    fn handle_event(&mut self, event: &DecodedFrame<'_>);

    /// A frame that is not wanted: it counts for the time alone.
    fn skip_event(&mut self, event: &DecodedFrame<'_>) {
        let _ = event;
    }

    /// Called after some frames. `now`: the time of the next one is unknown.
    fn flush(&mut self, now: bool) -> Result<()> {
        let _ = now;
        Ok(())
    }

    /// The capture was read to its end, and is one.
    fn finish(&mut self) -> Result<()> {
        self.flush(true)
    }

    /// Handles the open ends of conversations, which are no frame.
    fn handle_final(&mut self, event: &DecodedFrame<'_>) {
        let _ = event;
    }
}

impl<S: EventSink + ?Sized> EventSink for &mut S {
    fn handle_event(&mut self, event: &DecodedFrame<'_>) {
        (**self).handle_event(event);
    }

    fn skip_event(&mut self, event: &DecodedFrame<'_>) {
        (**self).skip_event(event);
    }

    fn flush(&mut self, now: bool) -> Result<()> {
        (**self).flush(now)
    }

    fn finish(&mut self) -> Result<()> {
        (**self).finish()
    }

    fn handle_final(&mut self, event: &DecodedFrame<'_>) {
        (**self).handle_final(event);
    }
}

impl CaptureArgs {
    /// The word that names the drive; empty if there is none.
    pub fn profile_word(&self) -> &str {
        self.stated.named_by.word()
    }

    /// The arguments in one line: the same line means the same result for a capture.
    #[cfg(feature = "tables")]
    pub fn describe(&self) -> String {
        let rules = self.stated.rules.as_deref().unwrap_or_default();
        let form = self.stated.from.map_or("", CaptureFormat::name);
        let times = match self.times {
            TimesArg::Detect => "",
            TimesArg::Absolute => " times=absolute",
            TimesArg::Delta => " times=delta",
        };
        format!("as={rules} from={form} profile={}{times}", self.profile_word())
    }

    /// Checks the arguments, before anything is read or written.
    pub fn source(&self) -> Result<CaptureSource> {
        let source = self.stated.source()?;
        let options = ReadOptions { times: self.times.into(), ..source.options };
        Ok(CaptureSource { options, ..source })
    }
}

impl StatedArgs {
    /// Checks the arguments, before anything is read or written.
    pub fn source(&self) -> Result<CaptureSource> {
        let rules = self.rules.as_deref().map(Rules::parse).transpose();
        let rules = rules.map_err(|error| problem::no_such_protocol(&error.word))?;
        let (profile, options) = (self.named_by.profile()?, ReadOptions::from(self.from));
        Ok(CaptureSource {
            rules,
            profile,
            options,
            with_words: true,
            with_signals: true,
            progress: false,
            quiet: false,
        })
    }
}

/// A capture with its stated properties, checked.
pub struct CaptureSource {
    rules: Option<Rules>,
    /// The drive whose names are used.
    pub profile: Option<&'static Profile>,
    options: ReadOptions,
    with_words: bool,
    with_signals: bool,
    progress: bool,
    quiet: bool,
}

impl CaptureSource {
    /// Skips the text and fields of frames.
    pub fn without_words(self) -> Self {
        Self { with_words: false, ..self }
    }

    /// Leaves notices of values out where that saves time.
    pub fn without_signals(self) -> Self {
        Self { with_signals: false, ..self }
    }

    /// Does not print detections.
    #[cfg(feature = "tables")]
    pub fn quiet(self) -> Self {
        Self { quiet: true, ..self }
    }

    /// Permits a progress bar, if data go elsewhere.
    pub fn with_progress(self, progress: bool) -> Self {
        Self { progress, ..self }
    }

    /// Decodes a capture file with a thread for each of `makers`; their output is handed over in
    /// the capture's order.
    pub fn decode_parallel<M: BatchConsumer>(
        mut self,
        path: &Path,
        makers: &mut [M],
        put: OutputCallback<'_, M, Problem>,
    ) -> Result<CaptureDecoder> {
        let mut decoder = self.decoder_for(path)?;
        let mut reading = CaptureFileReader::open(path, self.progress)?;
        let fill = &mut |piece: &mut Vec<u8>, max| reading.append(piece, max);
        parallel::decode(&mut decoder, makers, fill, put)?;
        Ok(decoder)
    }

    /// Explains a capture, frame by frame. A [stream](is_stream) is followed as it grows.
    pub fn decode(self, path: &Path, sink: &mut dyn EventSink) -> Result<CaptureDecoder> {
        let mut decoder = if is_stream(path) {
            self.follow_stream(open_stream(path)?, sink)?
        } else {
            self.decode_file(path, sink)?
        };
        decoder.finish(&mut |event| sink.handle_event(event));
        decoder.finish_sessions(&mut |event| sink.handle_final(event));
        // A file that is no capture replaces no result of an earlier one.
        match check_readable(decoder.statistics()) {
            Ok(_) => sink.finish()?,
            Err(_) => sink.flush(true)?,
        }
        Ok(decoder)
    }

    /// A decoder by the stated rules, else by these.
    pub fn decoder_or(&self, rules: &Rules) -> CaptureDecoder {
        self.build_decoder(self.rules.as_ref().unwrap_or(rules).clone())
    }

    fn build_decoder(&self, rules: Rules) -> CaptureDecoder {
        self.apply_words(
            CaptureDecoder::new(rules).with_profile(self.profile).with_read_options(self.options),
        )
    }

    fn judged_decoder(&self, judge: ProtocolDetector) -> CaptureDecoder {
        let (verdicts, decoder) = judge.decide();
        verdicts.iter().for_each(print_detection);
        self.apply_words(decoder.with_profile(self.profile))
    }

    fn apply_words(&self, decoder: CaptureDecoder) -> CaptureDecoder {
        let decoder = if self.with_words { decoder } else { decoder.without_text() };
        if self.with_signals { decoder } else { decoder.without_signals() }
    }

    /// A decoder for a file. Where the user does not name the protocol, it is detected while the file is
    /// decoded.
    fn decoder_for(&mut self, path: &Path) -> Result<CaptureDecoder> {
        if let Some(rules) = self.rules.take() {
            return Ok(self.build_decoder(rules));
        }
        let opened = File::open(path)
            .and_then(|file| CaptureDecoder::detect(Box::new(file), self.options))
            .map_err(|error| problem::file_problem(path, "read", &error))?;
        if !self.quiet {
            opened.detections().iter().for_each(print_detection);
        }
        Ok(self.apply_words(opened.with_profile(self.profile)))
    }

    /// Decodes a file from its beginning to its end.
    fn decode_file(mut self, path: &Path, sink: &mut dyn EventSink) -> Result<CaptureDecoder> {
        let mut decoder = self.decoder_for(path)?;
        read_pieces(path, self.progress, &mut |piece| {
            decoder.feed(piece, &mut |event| sink.handle_event(event));
            sink.flush(false)
        })?;
        Ok(decoder)
    }

    /// Decodes a stream, piece by piece as it comes.
    fn follow_stream(
        mut self,
        source: FollowReader,
        sink: &mut dyn EventSink,
    ) -> Result<CaptureDecoder> {
        let (mut decoder, mut ended) = match self.rules.take() {
            Some(rules) => (self.build_decoder(rules), false),
            None => self.gather_stream(&source, sink)?,
        };
        sink.flush(true)?;
        while !ended {
            ended = match source.next_event(None) {
                FollowEvent::Piece(piece) => {
                    decoder.feed(&piece, &mut |event| sink.handle_event(event));
                    sink.flush(true)?;
                    false
                }
                FollowEvent::Timeout => false,
                FollowEvent::End(error) => end_of_input(error)?,
            };
        }
        Ok(decoder)
    }

    /// Gathers a stream until it ends or pauses, detects its protocol, and explains the gathered frames.
    fn gather_stream(
        &self,
        source: &FollowReader,
        sink: &mut dyn EventSink,
    ) -> Result<(CaptureDecoder, bool)> {
        let mut gathered = Vec::new();
        let ended = loop {
            match source.next_event(Some(JUDGE_PAUSE)) {
                FollowEvent::Piece(piece) => gathered.extend_from_slice(&piece),
                FollowEvent::Timeout if gathered.is_empty() => {}
                FollowEvent::Timeout => break false,
                FollowEvent::End(error) => break end_of_input(error)?,
            }
            // A stream without a pause would be held back for ever.
            if gathered.len() > GATHER_MAX {
                break false;
            }
        };
        let mut judge = ProtocolDetector::with_read_options(self.options);
        judge.feed(&gathered);
        let mut decoder = self.judged_decoder(judge);
        if !ended {
            print_note("detected from the frames so far; --as PROTO states the protocol");
        }
        // The bytes that the detection held back are decoded first.
        decoder.feed(&gathered, &mut |event| sink.handle_event(event));
        Ok((decoder, ended))
    }
}

/// Returns whether a capture can be read once only: `-` is stdin, others are pipes and terminals.
pub fn is_stream(path: &Path) -> bool {
    path.as_os_str() == "-" || std::fs::metadata(path).is_ok_and(|it| !it.is_file() && !it.is_dir())
}

fn open_stream(path: &Path) -> Result<FollowReader> {
    if path.as_os_str() == "-" {
        return Ok(FollowReader::new(stdin()));
    }
    let file = File::open(path).map_err(|error| problem::file_problem(path, "read", &error))?;
    Ok(FollowReader::new(file))
}

/// Threads that decode one capture: as many as asked for, else as there are cores.
pub fn job_count(requested: Option<usize>) -> usize {
    requested
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
        .clamp(1, JOBS_MAX)
}

/// Reads a file in pieces; how far it is may be shown.
pub fn read_pieces(
    path: &Path,
    progress: bool,
    each: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let (mut reading, mut piece) =
        (CaptureFileReader::open(path, progress)?, Vec::with_capacity(READ_SIZE));
    loop {
        piece.clear();
        reading.append(&mut piece, READ_SIZE)?;
        if piece.is_empty() {
            return Ok(());
        }
        each(&piece)?;
    }
}

/// A file that is read from its beginning to its end.
struct CaptureFileReader<'a> {
    path: &'a Path,
    file: File,
    progress: Progress,
}

impl<'a> CaptureFileReader<'a> {
    fn open(path: &'a Path, progress: bool) -> Result<Self> {
        let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (size, file) = opened.map_err(|error| problem::file_problem(path, "read", &error))?;
        // Some files of the system have no size.
        let shown = progress && size > 0;
        let progress = if shown { Progress::of_file(size) } else { Progress::hidden() };
        Ok(Self { path, file, progress })
    }

    /// Appends at most `max` bytes; none at the end.
    fn append(&mut self, piece: &mut Vec<u8>, max: usize) -> Result<()> {
        let read = (&mut self.file).take(max as u64).read_to_end(piece);
        self.progress.add(read.map_err(|error| problem::file_problem(self.path, "read", &error))?);
        Ok(())
    }
}

fn end_of_input(error: Option<std::io::Error>) -> Result<bool> {
    error.map_or(Ok(true), |error| Err(problem::file_problem(Path::new("stdin"), "read", &error)))
}

fn print_detection(detected: &LinkDetection) {
    print_note(&detection_text(detected));
}

/// A detection in one line.
pub fn detection_text(detected: &LinkDetection) -> String {
    let is_guess = detected.protocol.is_some() && is_doubtful(detected);
    let advice = if is_guess { " - a guess; --as PROTO states the protocol" } else { "" };
    format!("{detected}{advice}")
}

/// Returns whether a user should check the detected protocol.
pub fn is_doubtful(detected: &LinkDetection) -> bool {
    detected.protocol.is_none() || detected.confidence < 0.5
}

/// Format for writing a capture: the stated one, or that of the file's name.
pub fn written_format(capture_format: Option<CaptureFormat>, path: &Path) -> Result<CaptureFormat> {
    capture_format.or_else(|| CaptureFormat::from_path(path)).ok_or_else(|| {
        Problem::usage("E248", "the output format is unknown.")
            .why("The file name has no known ending.")
            .hint(format!(
                "--to states it: {}",
                CaptureFormat::names().collect::<Vec<_>>().join(", ")
            ))
    })
}

/// Converts a failure to write a capture.
pub fn write_problem(path: &Path, error: &WriteError) -> Problem {
    match error {
        WriteError::Io(error) => problem::file_problem(path, "write", error),
        other => Problem::usage("E248", format!("{other}."))
            .hint("`polepair decode FILE --format jsonl` explains a capture"),
    }
}

/// Prints late detections, and the parts that were left out of a capture that was read. The result is
/// [`Exit::Partial`] where frames were.
pub fn report_left_out(decoder: &CaptureDecoder) -> Result {
    decoder.later_detections().for_each(print_detection);
    Remark::of_decoder(decoder).iter().for_each(print_remark);
    check_readable(decoder.statistics())?;
    Ok(if decoder.untracked_records() > 0 { Exit::Partial } else { Exit::Ok })
}

/// Prints the parts that were not read: damaged places, and objects of other kinds. A file without a single record is
/// not a capture.
pub fn report_damage(tally: &ReadStatistics) -> Result {
    Remark::of_reading(tally).iter().for_each(print_remark);
    check_readable(tally)
}

fn print_remark(remark: &Remark) {
    match remark {
        Remark::Note(text) => print_note(text),
        Remark::Warning(text) => print_warning(text),
    }
}

fn unread_reason(tally: &ReadStatistics) -> String {
    match tally.program {
        Some(program) => format!("It names {program}, whose lines could not be read in this form."),
        None => "No record could be read.".to_owned(),
    }
}

/// A file of another kind is refused, and one without a single record.
pub fn check_readable(tally: &ReadStatistics) -> Result {
    if let Some(file) = tally.unsupported {
        return Err(Problem::new(Exit::Corrupt, "E510", format!("this is {}.", file.name))
            .why("Files of this kind are not read.")
            .hint(file.hint));
    }
    if (tally.damaged > 0 || !tally.skipped.is_empty()) && tally.records == 0 {
        return Err(Problem::new(Exit::Corrupt, "E510", "this is not a capture.")
            .why(unread_reason(tally))
            .hint(
                "lines such as `(1700000000.000500) can0 601#4041` and `12:34:56.789 TX 01 03 00 33` are read; \
                 --from FORMAT states its format, and docs/reference/capture-formats.md has all lines",
            ));
    }
    Ok(Exit::Ok)
}
