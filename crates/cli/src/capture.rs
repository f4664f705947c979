//! A capture as the verbs take it: a file or stdin, what is stated about it, who takes its frames.

use std::fs::File;
use std::io::{Read as _, stdin};
use std::path::Path;
use std::time::Duration;

use clap::Args;
use polepair_capture::parallel::{self, JOBS_MAX, Maker, Put};
use polepair_capture::{
    Decoder, Event, Follow, Format, Judge, Next, Place, Rules, Tally, Verdict, WriteError,
};
use polepair_core::profile::Profile;

use crate::cmd::{NamedBy, capture_format};
use crate::problem::{self, Exit, Problem, Result};
use crate::progress::Progress;
use crate::terminal::say;

/// A capture on stdin that pauses so long is judged by what came so far, and followed from there.
const PAUSE: Duration = Duration::from_millis(700);
/// Bytes of a capture on stdin that are gathered for the judgement.
const GATHER_MAX: usize = 1 << 28;
const PIECE: usize = 1 << 18;

/// What a person states about a capture.
#[derive(Args, Debug)]
pub struct Stated {
    /// Protocol, of everything, or @ an axis number or a link; several with commas
    #[arg(long = "as", value_name = "PROTO[@ID],…")]
    rules: Option<String>,
    /// How the capture is stored [default: told by its first bytes]
    #[arg(long, value_name = "FORMAT", value_parser = capture_format())]
    from: Option<Format>,
    #[command(flatten)]
    named_by: NamedBy,
}

/// Who takes the frames of a capture.
pub trait Sink {
    /// Takes a frame.
    fn take(&mut self, event: &Event<'_>);

    /// A frame that is not wanted: it counts for the time alone.
    fn skip(&mut self, event: &Event<'_>) {
        let _ = event;
    }

    /// After some frames. `now`: nobody knows when the next one comes.
    fn settle(&mut self, now: bool) -> Result<()> {
        let _ = now;
        Ok(())
    }

    /// The capture was read to its end.
    fn finish(&mut self) -> Result<()> {
        self.settle(true)
    }

    /// What conversations leave open at the end, which is no frame.
    fn ending(&mut self, event: &Event<'_>) {
        let _ = event;
    }
}

impl<S: Sink + ?Sized> Sink for &mut S {
    fn take(&mut self, event: &Event<'_>) {
        (**self).take(event);
    }

    fn skip(&mut self, event: &Event<'_>) {
        (**self).skip(event);
    }

    fn settle(&mut self, now: bool) -> Result<()> {
        (**self).settle(now)
    }

    fn finish(&mut self) -> Result<()> {
        (**self).finish()
    }

    fn ending(&mut self, event: &Event<'_>) {
        (**self).ending(event);
    }
}

impl Stated {
    /// The word that names the drive; empty if there is none.
    pub fn profile_word(&self) -> &str {
        self.named_by.word()
    }

    /// What is stated, in one line: the same words make the same of a capture.
    pub fn said(&self) -> String {
        let rules = self.rules.as_deref().unwrap_or_default();
        let form = self.from.map_or("", Format::name);
        format!("as={rules} from={form} profile={}", self.profile_word())
    }

    /// Understands what is stated, before anything is read or written.
    pub fn source(&self) -> Result<Source> {
        let rules = self.rules.as_deref().map(Rules::parse).transpose();
        let rules = rules.map_err(|error| problem::no_such_protocol(&error.word))?;
        let profile = self.named_by.profile()?;
        Ok(Source { rules, profile, form: self.from, words: true, progress: false })
    }
}

/// What is stated about a capture, understood.
pub struct Source {
    rules: Option<Rules>,
    /// The drive whose names are used.
    pub profile: Option<&'static Profile>,
    form: Option<Format>,
    words: bool,
    progress: bool,
}

impl Source {
    /// What frames say in words and fields is not wanted.
    pub fn without_words(self) -> Self {
        Self { words: false, ..self }
    }

    /// How far it is may be shown, where data go elsewhere.
    pub fn with_progress(self, progress: bool) -> Self {
        Self { progress, ..self }
    }

    /// Decodes a capture file with a thread for each of `makers`; what they make is handed over in
    /// the capture's order.
    pub fn read_by<M: Maker>(
        mut self,
        path: &Path,
        makers: &mut [M],
        put: Put<'_, M, Problem>,
    ) -> Result<Decoder> {
        let mut decoder = self.decoder_for(path)?;
        let mut reading = Reading::of(path, self.progress)?;
        let fill = &mut |piece: &mut Vec<u8>, most| reading.append(piece, most);
        parallel::decode(&mut decoder, makers, fill, put)?;
        Ok(decoder)
    }

    /// Explains a capture, frame by frame. `-` is stdin, which is followed as it grows.
    pub fn read(self, path: &Path, sink: &mut dyn Sink) -> Result<Decoder> {
        let mut decoder = match path.as_os_str() == "-" {
            true => self.follow(sink)?,
            false => self.file(path, sink)?,
        };
        decoder.finish(&mut |event| sink.take(event));
        decoder.ending(&mut |event| sink.ending(event));
        sink.finish()?;
        Ok(decoder)
    }

    /// A decoder by what is stated, else by these rules.
    pub fn decoder_or(&self, rules: &Rules) -> Decoder {
        self.decoder(self.rules.as_ref().unwrap_or(rules).clone())
    }

    fn decoder(&self, rules: Rules) -> Decoder {
        self.spare(Decoder::new(rules).with_profile(self.profile).with_format(self.form))
    }

    fn judged(&self, judge: Judge) -> Decoder {
        let (verdicts, decoder) = judge.decide();
        verdicts.iter().for_each(tell);
        self.spare(decoder.with_profile(self.profile))
    }

    fn spare(&self, decoder: Decoder) -> Decoder {
        if self.words { decoder } else { decoder.without_words() }
    }

    /// A decoder for a file, which is once gone through to judge it where nobody says who speaks.
    fn decoder_for(&mut self, path: &Path) -> Result<Decoder> {
        if let Some(rules) = self.rules.take() {
            return Ok(self.decoder(rules));
        }
        let mut judge = Judge::of_format(self.form);
        pieces(path, self.progress, &mut |piece| {
            judge.feed(piece);
            Ok(())
        })?;
        Ok(self.judged(judge))
    }

    /// Decodes a file: once through to judge it, once to explain it.
    fn file(mut self, path: &Path, sink: &mut dyn Sink) -> Result<Decoder> {
        let mut decoder = self.decoder_for(path)?;
        pieces(path, self.progress, &mut |piece| {
            decoder.feed(piece, &mut |event| sink.take(event));
            sink.settle(false)
        })?;
        Ok(decoder)
    }

    /// Decodes stdin, piece by piece as it comes.
    fn follow(mut self, sink: &mut dyn Sink) -> Result<Decoder> {
        let source = Follow::new(stdin());
        let (mut decoder, mut ended) = match self.rules.take() {
            Some(rules) => (self.decoder(rules), false),
            None => self.gather(&source, sink)?,
        };
        sink.settle(true)?;
        while !ended {
            ended = match source.next(None) {
                Next::Piece(piece) => {
                    decoder.feed(&piece, &mut |event| sink.take(event));
                    sink.settle(true)?;
                    false
                }
                Next::Pause => false,
                Next::End(error) => end(error)?,
            };
        }
        Ok(decoder)
    }

    /// Gathers stdin until it ends or pauses, judges it, and explains what was gathered.
    fn gather(&self, source: &Follow, sink: &mut dyn Sink) -> Result<(Decoder, bool)> {
        let mut gathered = Vec::new();
        let ended = loop {
            match source.next(Some(PAUSE)) {
                Next::Piece(piece) => gathered.extend_from_slice(&piece),
                Next::Pause if gathered.is_empty() => {}
                Next::Pause => break false,
                Next::End(error) => break end(error)?,
            }
            if gathered.len() > GATHER_MAX {
                break false;
            }
        };
        let mut judge = Judge::of_format(self.form);
        judge.feed(&gathered);
        let mut decoder = self.judged(judge);
        if !ended {
            say("judged by what came so far; --as PROTO states the protocol");
        }
        decoder.feed(&gathered, &mut |event| sink.take(event));
        Ok((decoder, ended))
    }
}

/// Threads that decode one capture: as many as asked for, else as there are cores.
pub fn jobs(asked: Option<usize>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    asked.unwrap_or_else(cores).clamp(1, JOBS_MAX)
}

/// Reads a file in pieces; how far it is may be shown.
pub fn pieces(
    path: &Path,
    progress: bool,
    each: &mut dyn FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let (mut reading, mut piece) = (Reading::of(path, progress)?, Vec::with_capacity(PIECE));
    loop {
        piece.clear();
        reading.append(&mut piece, PIECE)?;
        if piece.is_empty() {
            return Ok(());
        }
        each(&piece)?;
    }
}

/// A file that is read from its beginning to its end.
struct Reading<'a> {
    path: &'a Path,
    file: File,
    progress: Progress,
}

impl<'a> Reading<'a> {
    fn of(path: &'a Path, progress: bool) -> Result<Self> {
        let opened = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (size, file) = opened.map_err(|error| problem::file(path, "read", &error))?;
        let progress = Progress::of(Some(size).filter(|size| progress && *size > 0));
        Ok(Self { path, file, progress })
    }

    /// Appends at most so many bytes; none at the end.
    fn append(&mut self, piece: &mut Vec<u8>, most: usize) -> Result<()> {
        let read = (&mut self.file).take(most as u64).read_to_end(piece);
        self.progress.add(read.map_err(|error| problem::file(self.path, "read", &error))?);
        Ok(())
    }
}

fn end(error: Option<std::io::Error>) -> Result<bool> {
    error.map_or(Ok(true), |error| Err(problem::file(Path::new("stdin"), "read", &error)))
}

fn tell(verdict: &Verdict) {
    let doubt = verdict.protocol.is_some() && verdict.sure < 0.5;
    let advice = if doubt { " - a guess; --as PROTO states the protocol" } else { "" };
    say(&format!("{verdict}{advice}"));
}

/// The format that a capture is written in: as said, or as the file's name tells.
pub fn written_format(said: Option<Format>, path: &Path) -> Result<Format> {
    said.or_else(|| Format::of_path(path)).ok_or_else(|| {
        Problem::usage("E248", "the format to write is not known.")
            .why("The name of the file does not tell it.")
            .hint(format!("--to says it: {}", Format::names().collect::<Vec<_>>().join(", ")))
    })
}

/// Why a capture cannot be written.
pub fn not_written(path: &Path, error: &WriteError) -> Problem {
    match error {
        WriteError::Io(error) => problem::file(path, "write", error),
        other => Problem::usage("E248", format!("{other}."))
            .hint("polepair decode FILE --format jsonl explains a capture"),
    }
}

/// Tells what was left out of a capture that was read.
pub fn report(decoder: &Decoder) -> Result {
    if decoder.left_out() > 0 {
        let links = "frames of more links than are followed at once are left out";
        say(&format!("{} {links}", decoder.left_out()));
    }
    damage(decoder.tally())
}

/// Names damaged places. A file without a single readable one is no capture.
pub fn damage(tally: &Tally) -> Result {
    const SHOWN: usize = 5;
    for damage in tally.damage.iter().take(SHOWN) {
        let what = if matches!(damage.place, Place::Line(_)) { "the line" } else { "this part" };
        say(&format!("{damage}; {what} is left out"));
    }
    if tally.damaged > SHOWN as u64 {
        say(&format!("{} places could not be read, {} records were", tally.damaged, tally.records));
    }
    if tally.damaged > 0 && tally.records == 0 {
        return Err(Problem::new(Exit::Corrupt, "E510", "this is not a capture.")
            .why("Nothing of it could be read.")
            .hint("--from FORMAT states its format; polepair decode --help shows what is read"));
    }
    Ok(Exit::Ok)
}
