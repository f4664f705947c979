//! `polepair replay FILE URL… [--speed N|--fast] [--loop N] [--direction tx|rx|both] [--filter EXPR]
//! [--link NAME]… [--arm] [--store] [--dry-run]`

mod feed;
mod player;
mod selector;
mod survey;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use polepair::Connector;
use polepair::listen::RawWires;
use polepair::stop::{StopEvent as Stopping, stop_on};
use polepair::wire::OpenWire;
use polepair_capture::text::NoticeLevel;
use polepair_capture::{DecodedFrame, Rule, RuleScope, Rules, text};
use polepair_core::medium::MediumKind;
use polepair_core::proto;
use polepair_link::clock;

use crate::capture::{CaptureSource, StatedArgs, read_pieces, report_damage, written_format};
use crate::cmd::decode::parse_filter;
use crate::cmd::record::files::{CaptureFiles, RecordingPlace};
use crate::cmd::record::live_printer::LivePrinter;
use crate::cmd::record::traffic_recorder::TrafficRecorder;
use crate::cmd::stop;
use crate::data_output::DataOutput;
use crate::problem::{Exit, Problem, Result};
use crate::tap_queue::{TapQueue, short_name};
use crate::terminal::{colour_out, print_note};
use crate::trace::TraceArgs;
use crate::value::plural;
use crate::{interrupt, outcome, output_file};
use feed::CaptureFeed;
use player::{ReplayControl, ReplayPace, ReplayResult};
use selector::{FrameSelector, ReplayRoute, SendDirection};
use survey::Survey;

/// Interval of polling the frames, ms.
const POLL_MS: u32 = 20;

/// Sends the recorded frames of a capture to links or to simulated drives.
///
/// The command first prints what it is about to send. Frames that may move motors, and unknown frames, need
/// --arm. Frames that write to permanent memory need --store. Axes that received such frames are stopped at
/// the end, at Ctrl-C and after an error. If a capture does not record the direction of frames, it is
/// derived from the protocol.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair replay good.log canopen+socketcan://can0 --dry-run
  polepair replay good.log canopen+socketcan://can0 --arm
  polepair replay polling.log tmcl+serial:///dev/ttyUSB0:9600 --fast --loop 10
  polepair replay good.log sim:canopen:2 --arm --trace answers.log
  polepair replay cell.pcapng canopen+socketcan://can0 tmcl+serial:///dev/ttyUSB0 \\
      --link can1 --link ttyS3 --filter 'time in 10..20s'")]
pub struct ReplayOptions {
    /// Capture to send
    #[arg(value_name = "FILE")]
    source: PathBuf,
    /// Destination: canopen+socketcan://can0, tmcl+serial:///dev/ttyUSB0:9600, sim:tmcl
    #[arg(value_name = "URL", required_unless_present = "to")]
    urls: Vec<String>,
    /// Destination, as URL
    #[arg(long, value_name = "URL", hide = true)]
    to: Vec<String>,
    /// Speed factor; 2 sends twice as fast as recorded
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = parse_speed)]
    speed: f64,
    /// Send each frame as soon as the one before is answered, or its recorded wait is over
    #[arg(long, conflicts_with = "speed")]
    fast: bool,
    /// Number of repetitions; 0 repeats until Ctrl-C
    #[arg(long = "loop", value_name = "N", default_value_t = 1)]
    times: u64,
    /// Frames to send, by their sender
    #[arg(long, value_enum, default_value_t = SendDirection::Tx)]
    direction: SendDirection,
    /// Send only frames that match an expression: 'axis = 2', 'time in 10..20s', 'kind = GAP'
    #[arg(long, value_name = "EXPR")]
    filter: Option<String>,
    /// Link of the capture for the first URL; repeat the option for each further URL
    #[arg(long = "link", value_name = "NAME")]
    links: Vec<String>,
    #[command(flatten)]
    stated: StatedArgs,
    /// Also send frames that may move a motor, and unknown frames
    #[arg(long)]
    arm: bool,
    /// Also send frames that write to permanent memory
    #[arg(long)]
    store: bool,
    /// Leave the motors as the capture leaves them
    #[arg(long)]
    detach: bool,
    /// Print what would be sent and its effect, and send nothing
    #[arg(long)]
    dry_run: bool,
    /// Print all frames, decoded
    #[arg(short = 'v', long)]
    verbose: bool,
    #[command(flatten)]
    trace: TraceArgs,
}

fn parse_speed(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(speed) if (1e-3..=1e3).contains(&speed) => Ok(speed),
        _ => Err("a factor from 0.001 to 1000: 0.5 is half as fast as recorded".to_owned()),
    }
}

impl ReplayOptions {
    pub fn run(self) -> Result {
        if self.source.as_os_str() == "-" {
            return Err(Problem::usage("E242", "`replay` cannot read stdin.")
                .why("It reads the capture twice.")
                .hint("write it to a file first"));
        }
        let source = self.stated.source()?;
        let wanted = self.filter.as_deref().map(parse_filter).transpose()?;
        output_file::refuse_input(self.trace.path(), [self.source.as_path()])?;
        let trace = self.trace.path().map(|path| self.trace_file(path)).transpose()?;
        let connector = crate::profile_args::discover_connector();
        outcome::count_frames_of(&connector);
        let urls: Vec<&str> = self.urls.iter().chain(&self.to).map(String::as_str).collect();
        let (routes, rules) = self.routes(&connector, &urls)?;
        let mut choice = FrameSelector::new(self.direction, wanted, routes);
        choice.profile = source.profile;
        let survey = self.survey_capture(&source, &rules, &choice)?;
        let file = self.source.display().to_string();
        survey.print_summary(
            &file,
            &urls.iter().map(|url| url_location(url).to_owned()).collect::<Vec<_>>(),
        );
        if self.dry_run {
            survey.print_left_out();
            print_note("dry run: none of this was sent");
            return Ok(Exit::Ok);
        }
        // Before the links are opened, so that what is refused has touched no wire.
        survey.check_allowed(&choice.routes, self.arm, self.store)?;
        let stage = ReplayLinks::open(&connector, &urls)?;
        self.play_capture(stage, source, rules, choice, &survey, trace)
    }

    /// Each wire with the link on which it is played, and its protocols.
    fn routes(&self, connector: &Connector, urls: &[&str]) -> Result<(Vec<ReplayRoute>, Rules)> {
        let mut wires: Vec<(MediumKind, Vec<&str>)> = Vec::new();
        for url in urls {
            wires.extend(connector.wire_protocols(url).map_err(outcome::to_problem)?);
        }
        if !self.links.is_empty() && self.links.len() != wires.len() {
            let (links, wires) = (self.links.len(), wires.len());
            let what = format!("{links} links of the capture for {wires} wires.");
            return Err(Problem::usage("E242", what).hint("give --link NAME once for each URL"));
        }
        if self.links.is_empty() && wires.len() > 1 {
            let what = "the links of the capture are not assigned to the URLs.";
            return Err(Problem::usage("E242", what)
                .hint("give --link NAME for each URL, in their order")
                .hint(format!("`polepair summary {}` names its links", self.source.display())));
        }
        let (mut routes, mut rules) = (Vec::new(), Rules::default());
        for (n, (medium, words)) in wires.into_iter().enumerate() {
            let link = self.links.get(n).cloned();
            let scope = link.clone().map_or(RuleScope::Anywhere, RuleScope::Link);
            let protocols = words.into_iter().filter_map(proto::find_dissector);
            rules.0.extend(protocols.map(|dissector| Rule { dissector, scope: scope.clone() }));
            routes.push(ReplayRoute { link, medium });
        }
        Ok((routes, rules))
    }

    /// Looks through the capture, and prints it if nothing else is wanted.
    fn survey_capture(
        &self,
        source: &CaptureSource,
        rules: &Rules,
        choice: &FrameSelector,
    ) -> Result<Survey> {
        let (mut survey, mut choice) = (Survey::default(), choice.clone());
        let mut decoder = source.decoder_or(rules);
        let style = text::TextStyle {
            colour: colour_out(),
            notices: NoticeLevel::None,
            ..text::TextStyle::default()
        };
        let (mut lines, mut out) = (text::FrameTextWriter::new(style), DataOutput::stdout());
        let mut note = |event: &DecodedFrame<'_>, out: &mut DataOutput| {
            let chosen = choice.select(event);
            survey.add_frame(event, &chosen);
            if let (true, Ok(item)) = (self.dry_run, &chosen) {
                let word = selector::effect_word(item.effect);
                out.buffer().extend_from_slice(format!("{word:<6}").as_bytes());
                lines.write(event, out.buffer());
            }
        };
        read_pieces(&self.source, false, &mut |piece| {
            decoder.feed(piece, &mut |event| note(event, &mut out));
            out.flush_if_full()
        })?;
        decoder.finish(&mut |event| note(event, &mut out));
        out.flush()?;
        report_damage(decoder.statistics())?;
        let several = survey.links.len() > 1 && self.links.is_empty();
        if several {
            let what = format!("the capture has links {}.", survey.links.join(", "));
            return Err(Problem::usage("E242", what).hint("--link NAME selects one"));
        }
        Ok(survey)
    }

    fn trace_file(&self, path: &Path) -> Result<RecordingPlace> {
        let place = RecordingPlace {
            path: path.to_owned(),
            format: written_format(None, path)?,
            rotation: None,
            existing: self.trace.existing(),
        };
        place.check()?;
        Ok(place)
    }

    fn play_capture(
        &self,
        stage: ReplayLinks,
        source: CaptureSource,
        rules: Rules,
        choice: FrameSelector,
        survey: &Survey,
        trace: Option<RecordingPlace>,
    ) -> Result {
        let show = self.verbose.then(|| LivePrinter::new(stage.link_rules()));
        let files = trace.map(CaptureFiles::create).transpose()?;
        let names = stage.wires().map(|wire| short_name(&wire.name)).collect();
        let taps = stage.ears.clone();
        let mut keeping =
            TrafficRecorder { tap_queue: taps, names, files, printer: show, is_host: true };
        let times = (self.times > 0).then_some(self.times);
        let pace = if self.fast { ReplayPace::Fast } else { ReplayPace::Recorded(self.speed) };
        let gap = survey.span / survey.frames.saturating_sub(1).max(1);
        let capture_feed = CaptureFeed {
            path: self.source.clone(),
            selector: choice,
            make_decoder: Box::new(move || source.decoder_or(&rules)),
            times,
            period: survey.span + gap,
        };
        let started_at = clock::now();
        let (played, read) = stage.play(capture_feed, pace, &mut keeping);
        let took = clock::now().since(started_at);
        print_result(&played, took);
        // After all players have ended, so that no later frame starts the motor again.
        let stopped = if self.detach { Ok(()) } else { stage.stop(&played) };
        // Replies to the last frames, and to the stops.
        keeping.process_received()?;
        let TrafficRecorder { files, printer, .. } = keeping;
        files.map_or(Ok((0, 0)), CaptureFiles::finish)?;
        printer.map_or(Ok(0), LivePrinter::finish)?;
        // After the stop: a capture that cannot be read to its end must not leave a motor running.
        read?;
        final_result(&played, survey.unfit_count(), stopped)
    }
}

/// Place in a URL.
fn url_location(url: &str) -> &str {
    url.split(['?', '#']).next().unwrap_or(url)
}

/// The links that are played on.
struct ReplayLinks {
    connector: Connector,
    opened: Vec<(String, RawWires)>,
    ears: TapQueue,
}

impl ReplayLinks {
    fn open(connector: &Connector, urls: &[&str]) -> Result<Self> {
        let (tap_queue, mut opened, mut before) = (TapQueue::default(), Vec::new(), 0);
        for url in urls {
            let taps = tap_queue.clone();
            let tapped = connector.clone().with_taps(move |wire| taps.tap(before + wire));
            let one = tapped.open_wires(url).map_err(outcome::to_problem)?;
            before += one.wires().len();
            opened.push(((*url).to_owned(), one));
        }
        Ok(Self { connector: connector.clone(), opened, ears: tap_queue })
    }

    fn wires(&self) -> impl Iterator<Item = OpenWire> {
        self.opened.iter().flat_map(|(_, opened)| opened.wires())
    }

    /// Protocols of the wires, by their own names.
    fn link_rules(&self) -> Rules {
        let rules = self.wires().flat_map(|wire| {
            let link = short_name(&wire.name);
            let protocols = wire.protocols.into_iter().filter_map(proto::find_dissector);
            protocols.map(move |dissector| Rule { dissector, scope: RuleScope::Link(link.clone()) })
        });
        Rules(rules.collect())
    }

    /// Replays all wires at once. Returns the result of each, and that of reading the capture.
    fn play(
        &self,
        capture_feed: CaptureFeed,
        pace: ReplayPace,
        keeping: &mut TrafficRecorder,
    ) -> (Vec<ReplayResult>, Result<()>) {
        let rates: Vec<Option<u32>> = self.wires().map(|wire| wire.rate).collect();
        let links = self.opened.iter().flat_map(|(_, opened)| opened.links());
        let score = ReplayControl { pace, halt: Arc::new(AtomicBool::new(false)) };
        let (reader, items) = capture_feed.start(rates.len());
        let players = links.zip(rates).zip(items).map(|((link, rate), items)| {
            let (score, waker) = (score.clone(), link.waker());
            interrupt::listen(move || waker.wake());
            std::thread::spawn(move || score.play_wire(link, rate, items))
        });
        let players: Vec<_> = players.collect();
        let mut watched = Ok(());
        while players.iter().any(|player| !player.is_finished()) && watched.is_ok() {
            clock::sleep_until(clock::now().plus_ms(POLL_MS));
            watched = keeping.process_received().and_then(|_| keeping.flush());
        }
        // A failed write ends it: the frames would not be visible.
        score.halt.store(true, Ordering::Relaxed);
        let played = players.into_iter().map(|player| join_thread(player.join())).collect();
        let read = join_thread(reader.join());
        (played, watched.and(read))
    }

    /// Stops the axes that were sent what may move them.
    fn stop(&self, played: &[ReplayResult]) -> Result<()> {
        let (mut played, mut ended) = (played.iter(), Ok(()));
        for (url, opened) in &self.opened {
            for (wire, played) in (0..opened.wires().len()).zip(&mut played) {
                // A wire on which nothing was moved gets no stop, which is a command, too.
                if played.moved_axes.is_empty() && !played.moved_unknown {
                    continue;
                }
                let all = played.moved_unknown;
                let axes: Vec<u32> = played.moved_axes.iter().copied().filter(|_| !all).collect();
                let stopped = stop_on(&self.connector, opened, wire, &axes, &mut ignore_stop_event);
                let result =
                    stopped.map_err(outcome::to_problem).and_then(|it| stop::report_stops(url, it));
                ended = ended.and(result.map(drop));
            }
        }
        ended
    }
}

fn ignore_stop_event(_: Stopping<'_>) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn join_thread<T>(ended: std::thread::Result<T>) -> T {
    ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Prints the number of frames, their rate and their delays.
fn print_result(played: &[ReplayResult], took: Duration) {
    let (sent, received) =
        (plural(sum_results(|it| it.sent, played), "frame"), sum_results(|it| it.received, played));
    print_note(&format!("{sent} sent in {:.3} s; {received} received", took.as_secs_f64()));
    for (min_value, middle, max_value) in played.iter().filter_map(|it| it.lateness.summary()) {
        let (least, middle, most) =
            (milliseconds(min_value), milliseconds(middle), milliseconds(max_value));
        print_note(&format!("late by {least:.3} / {middle:.3} / {most:.3} ms (min/median/max)"));
    }
}

fn milliseconds(span: Duration) -> f64 {
    span.as_secs_f64() * 1e3
}

fn sum_results(which: fn(&ReplayResult) -> u64, played: &[ReplayResult]) -> u64 {
    played.iter().map(which).sum::<u64>()
}

/// Result of the whole: an error of a link before frames that could not be sent.
fn final_result(played: &[ReplayResult], unfit: u64, stopped: Result<()>) -> Result {
    if let Some(error) = played.iter().find_map(|it| it.ended_by.as_ref()) {
        return Err(outcome::link_problem(error));
    }
    stopped?;
    if interrupt::was_interrupted() {
        return Err(Problem::interrupted());
    }
    let unsent = unfit + played.iter().map(|it| it.unsent).sum::<u64>();
    if let Some(error) = played.iter().find_map(|it| it.trouble.as_ref()) {
        print_note(&format!("{} not sent: {error}", plural(unsent, "frame")));
    }
    Ok(if unsent > 0 { Exit::Partial } else { Exit::Ok })
}
