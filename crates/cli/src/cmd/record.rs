//! `polepair record URL -o FILE [--to FORMAT] [--for TIME] [--rotate SIZE|TIME] [-v]`

pub mod files;
pub mod live_printer;
pub mod traffic_recorder;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use polepair::listen::WireListener;
use polepair_capture::{CaptureFormat, Rules};
use polepair_core::medium::MediumKind;
use polepair_core::time::Instant;
use polepair_link::{Losses, clock};

use crate::capture::written_format;
use crate::problem::{self, Exit, Result};
use crate::tap_queue::{TapQueue, short_name};
use crate::terminal::{print_note, print_warning};
use crate::{interrupt, outcome, output_file, value};
use files::{CaptureFiles, RecordingPlace, Rotation};
use live_printer::LivePrinter;
use traffic_recorder::TrafficRecorder;

/// Interval of polling received frames, ms.
const POLL_MS: u32 = 20;
/// Interval of flushing the file: a crash loses no more than this.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// Records the frames of a link to a capture until Ctrl-C. Sends nothing.
///
/// Each frame is recorded with its time. Frames that the system or the adapter lost are counted and
/// reported. Names that end in .gz or .zst are compressed. After a crash, at most the last half second is
/// missing. An existing FILE is not overwritten; with --rotate, its number is skipped.
#[derive(Args, Debug)]
#[command(after_help = "\
A CAN controller acknowledges the frames that it receives. To prevent that, set it to listen-only:
ip link set can0 type can listen-only on.

Examples:
  polepair record canopen+socketcan://can0 -o machine.log
  polepair record tmcl+serial:///dev/ttyUSB0:9600 -o night.pcapng.zst --rotate 1h
  polepair record canopen+slcan:///dev/ttyACM0 -o bus.blf --for 10min -v --as canopen")]
pub struct RecordOptions {
    /// Link: canopen+socketcan://can0, tmcl+serial:///dev/ttyUSB0:9600, @name
    #[arg(value_name = "URL")]
    url: String,
    /// Capture to write
    #[arg(short, long = "out", value_name = "FILE")]
    out: PathBuf,
    /// Output format [default: from the name of FILE]
    #[arg(long, value_name = "FORMAT", value_parser = value::capture_format())]
    to: Option<CaptureFormat>,
    /// Replace FILE if it exists; its content is lost
    #[arg(long)]
    force: bool,
    /// Write behind the content of FILE if it exists (text logs)
    #[arg(long, conflicts_with = "force")]
    append: bool,
    /// Exit after this time
    #[arg(long = "for", value_name = "TIME", value_parser = value::parse_span)]
    seconds: Option<f64>,
    /// Start a new file, with a number in its name, after this size or time: 100MB, 1h
    #[arg(long, value_name = "SIZE|TIME", value_parser = Rotation::parse)]
    rotate: Option<Rotation>,
    /// Also print the decoded frames
    #[arg(short = 'v', long)]
    show: bool,
    /// Protocol of the printed frames, or PROTO@AXIS for a part of them; separate several by commas
    #[arg(long = "as", value_name = "PROTO[@ID],…", requires = "show")]
    rules: Option<String>,
    #[command(flatten)]
    profiles: crate::profile_args::ProfileFile,
}

impl RecordOptions {
    pub fn run(self) -> Result {
        let place = RecordingPlace {
            path: self.out.clone(),
            format: written_format(self.to, &self.out)?,
            rotation: self.rotate,
            existing: output_file::existing_file(self.force, self.append),
        };
        // Before the link is opened: hours of recording must not end at a folder without rights.
        place.check()?;
        let rules = self.rules.as_deref().map(Rules::parse).transpose();
        let rules = rules.map_err(|error| problem::no_such_protocol(&error.word))?;
        let ears = TapQueue::default();
        let taps = ears.clone();
        let connector = self.profiles.connector()?.with_taps(move |wire| taps.tap(wire));
        let listening = connector.listen(&self.url).map_err(outcome::to_problem)?;
        interrupt::listen(|| ());
        let files = CaptureFiles::create(place)?;
        let show =
            self.show.then(|| LivePrinter::new(rules.unwrap_or_else(|| link_rules(&listening))));
        let names = listening.wires().iter().map(|wire| short_name(&wire.name)).collect();
        let keeping = TrafficRecorder {
            tap_queue: ears,
            names,
            files: Some(files),
            printer: show,
            is_host: false,
        };
        let mut recorder = Recorder {
            listener: listening,
            traffic: keeping,
            overrun: 0,
            lost: 0,
            malformed: 0,
            damaged: 0,
        };
        print_note(&format!("recording to {}; Ctrl-C ends", self.out.display()));
        let started_at = clock::now();
        let ended = recorder
            .record_until(self.seconds.map(|seconds| started_at + seconds_to_duration(seconds)));
        // Also after an error: what was received so far is written.
        let result = recorder.finish_recording(clock::now().since(started_at));
        ended.and(result)
    }
}

fn seconds_to_duration(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

/// The protocol that the connection string states.
fn link_rules(listening: &WireListener) -> Rules {
    let words = listening.wires().iter().flat_map(|wire| wire.protocols.iter().copied());
    Rules::for_protocols(words.take(1))
}

struct Recorder {
    listener: WireListener,
    traffic: TrafficRecorder,
    /// Units that were dropped, those of them that got here and were not looked at in time, what
    /// was no unit that captures keep, and characters of serial lines that came damaged.
    overrun: u64,
    lost: u64,
    malformed: u64,
    damaged: u64,
}

impl Recorder {
    fn record_until(&mut self, end: Option<Instant>) -> Result<()> {
        let mut flushed = clock::now();
        loop {
            self.process_received()?;
            let now = clock::now();
            if now.since(flushed) >= FLUSH_INTERVAL {
                flushed = now;
                self.traffic.flush()?;
            }
            if let Some(gone) = self.listener.take_error() {
                return Err(outcome::link_problem(&gone));
            }
            if interrupt::was_interrupted() || end.is_some_and(|end| now >= end) {
                return Ok(());
            }
            let next = now.plus_ms(POLL_MS);
            clock::sleep_until(end.map_or(next, |end| next.min(end)));
        }
    }

    /// Writes the frames since the last call, and prints losses at once.
    fn process_received(&mut self) -> Result<()> {
        let lost = self.traffic.process_received()?;
        let dropped = self.sum_losses(overrun_count, MediumKind::Can)
            + self.sum_losses(overrun_count, MediumKind::Serial);
        self.lost += lost;
        // Counters of the system never fall; a link that was opened again begins at zero.
        let fresh = (dropped + self.lost).saturating_sub(self.overrun);
        if fresh > 0 {
            print_warning(&format!("{fresh} dropped: the system could not read them fast enough"));
        }
        self.malformed = self.sum_losses(malformed_count, MediumKind::Can);
        self.damaged = self.sum_losses(malformed_count, MediumKind::Serial);
        self.overrun += fresh;
        Ok(())
    }

    fn sum_losses(&self, which: fn(&Losses) -> u64, medium: MediumKind) -> u64 {
        let wires = self.listener.wires().iter().enumerate();
        let of = wires.filter(|(_, wire)| wire.medium == medium);
        of.map(|(wire, _)| which(&self.listener.losses(wire))).sum()
    }

    /// Completes the file and prints its contents.
    fn finish_recording(mut self, took: Duration) -> Result {
        // Frames that were received meanwhile still count.
        let last = self.process_received();
        let TrafficRecorder { files, printer, .. } = self.traffic;
        let (count, files) = files.map_or(Ok((0, 0)), CaptureFiles::finish)?;
        last?;
        let (what, seconds) = (value::plural(count, "record"), took.as_secs_f64());
        let files = if files > 1 { format!(" in {files} files") } else { String::new() };
        let malformed_text =
            count_text(self.malformed, "were not frames of classic CAN and are not recorded")
                + &count_text(self.damaged, "characters were damaged (framing or parity)");
        print_note(&format!(
            "{what}{files} in {seconds:.1} s, {} dropped{malformed_text}",
            self.overrun
        ));
        // The file is whole: now stdout may take its time.
        let skipped = printer.map_or(Ok(0), LivePrinter::finish)?;
        if skipped > 0 {
            print_warning(&format!(
                "{} recorded but not printed: stdout was not read",
                value::plural(skipped, "record")
            ));
        }
        Ok(if self.overrun > 0 { Exit::Partial } else { Exit::Ok })
    }
}

fn count_text(count: u64, what: &str) -> String {
    match count {
        0 => String::new(),
        count => format!("; {count} {what}"),
    }
}

fn malformed_count(losses: &Losses) -> u64 {
    losses.malformed
}

fn overrun_count(losses: &Losses) -> u64 {
    losses.overrun
}
