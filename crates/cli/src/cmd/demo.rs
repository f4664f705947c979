//! `polepair demo [--headless]`: simulated drives of three makers on pseudo-terminals, in real time.

mod relay;

use polepair::url::without_axes;
use std::collections::VecDeque;
use std::io::Write as _;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use clap::Args;
use polepair::simulate::{self, DriveLine};
use polepair::{Connector, LocalAxis, LocalLink};
use polepair_capture::{CaptureDecoder, Rules, text};
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;
use polepair_link::serve::ServeThread;
use polepair_link::tap::{Tap, TapDirection};
use polepair_link::{ServeHandle, clock};

use crate::cmd::info;
use crate::local_wire;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::read_signal;
use crate::target::UnitRef;
use crate::terminal::{self, TextTable, print_note};

/// Frames of a step that are shown.
const FRAMES_SHOWN: usize = 3;
/// Reads that are timed on each drive.
const TIMED_READS: u32 = 200;

/// Shows all functions on simulated drives. No hardware is needed.
///
/// Three links are simulated: a Trinamic TMCM-171 (TMCL), a SYNTRON TS (Modbus RTU), and two Technosoft
/// drives behind a relay (TMLCAN). The demo finds, homes, moves and spins them, triggers faults and
/// recovers, always through the same axis interface.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair demo --headless")]
pub struct Demo {
    /// Print no live lines; end with the summary
    #[arg(long)]
    headless: bool,
}

/// The rack of the scene: all properties of single drives are here, and none below.
const DEMO_DRIVES: [DemoDrive; 2] = [
    DemoDrive {
        drive: "tmcm-171:1",
        position_mode: &[("stop switch enable", 1)],
        speed_mode: &[],
        cycle_power: false,
        switches: &[Act::Switch { which: 0, at: 3.0 }],
        fault_text: "its supply sags to 7 V",
        fault: Act::Supply(7.0),
        recovery_text: "the supply comes back",
        recovery: Act::Supply(24.0),
    },
    DemoDrive {
        drive: "syntron-ts:1",
        position_mode: &[("control mode", 14), ("homing way", 20_000)],
        speed_mode: &[("control mode", 1)],
        cycle_power: true,
        switches: &[Act::Switch { which: 0, at: -1.0 }],
        fault_text: "its encoder cable comes loose",
        fault: Act::EncoderBroken(true),
        recovery_text: "the cable is plugged in and the drive switched off and on",
        recovery: Act::EncoderBroken(false),
    },
];

struct DemoDrive {
    drive: &'static str,
    /// Settings, raw, before it takes positions.
    position_mode: &'static [(&'static str, i64)],
    /// Settings, raw, before it takes speeds.
    speed_mode: &'static [(&'static str, i64)],
    /// A new mode, and a cured fault, need the power off and on.
    cycle_power: bool,
    switches: &'static [Act],
    fault_text: &'static str,
    fault: Act,
    recovery_text: &'static str,
    recovery: Act,
}

/// A served drive and its open link.
struct DemoRun {
    demo_drive: &'static DemoDrive,
    line: DriveLine,
    stop: ServeHandle,
    link: LocalLink,
    frames: FrameLines,
    passed_steps: Vec<&'static str>,
    failed_steps: Vec<String>,
    read_us: f64,
    _served: ServeThread,
}

type FrameLines = Arc<Mutex<VecDeque<String>>>;

impl Demo {
    pub fn run(self) -> Result {
        crate::interrupt::listen(|| ());
        print_note("polepair demo: simulated drives, each behind its own wire protocol\n");
        let mut actors = Vec::new();
        for part in &DEMO_DRIVES {
            actors.push(DemoRun::open(part)?);
        }
        for actor in &mut actors {
            actor.run_scene(self.headless)?;
        }
        let failed = relay::run_relay_scene()?;
        print!("{}", summary_text(&actors, failed.as_deref()));
        let _ = std::io::stdout().flush();
        let played =
            actors.iter().all(|actor| actor.failed_steps.is_empty() && error_count(actor) == 0);
        if played && failed.is_none() {
            Ok(Exit::Ok)
        } else {
            Err(Problem::new(Exit::Negative, "E112", "a step of the demo failed."))
        }
    }
}

impl DemoRun {
    /// Serves the drive, finds it by a scan, and opens its link.
    fn open(part: &'static DemoDrive) -> Result<Self> {
        let description = simulate::rack_of_words(&[part.drive], 1).map_err(outcome::to_problem)?;
        let lines = simulate::drive_lines(&description, 1).map_err(outcome::to_problem)?;
        let Some(line) = lines.into_iter().next() else {
            return Err(Problem::usage("E244", "the demo's rack has no link."));
        };
        let (wire, place) =
            local_wire::open(None).map_err(|error| outcome::link_problem(&error))?;
        let url = description.urls(0, &place).remove(0);
        let url = without_axes(&url).to_owned();
        let served = line.clone().serve(wire);
        print_note(&format!("scanning {url}"));
        let frames = FrameLines::default();
        let connector = recording_connector(&url, &frames);
        let found = polepair::scan::scan(&connector, &url, 1..=3, &mut |_| {
            std::ops::ControlFlow::Continue(())
        });
        let found = found.map_err(outcome::to_problem)?.found;
        for one in &found {
            print_note(&format!(
                "  found axis {}: {} ({})",
                one.number, one.profile.title, one.identified
            ));
        }
        let number = found.first().map_or(1, |found| found.number);
        let link =
            connector.connect_local(&format!("{url}#{number}")).map_err(outcome::to_problem)?;
        print_note("");
        Ok(Self {
            demo_drive: part,
            line,
            stop: served.handle(),
            link,
            frames,
            passed_steps: Vec::new(),
            failed_steps: Vec::new(),
            read_us: 0.0,
            _served: served,
        })
    }

    fn run_scene(&mut self, headless: bool) -> Result<()> {
        let axis = self.link.axes()[0].clone();
        print_note(&format!("== {} ==", axis.profile().title));
        for signal in [Signal::Position, Signal::Voltage, Signal::Temperature, Signal::Fault] {
            if let Some(shown) = info::signal_text(&axis, signal)? {
                print_note(&format!("  {:<12} {shown}", signal.name()));
            }
        }
        let part = self.demo_drive;
        part.switches.iter().for_each(|act| self.apply_act(*act));
        self.run_step("prepare for positions", |actor| {
            actor.write_settings(&axis, part.position_mode)
        });
        axis.arm(true);
        self.run_step("enable", |_| axis.enable());
        self.run_step("home", |_| axis.home());
        self.run_step("move by one turn", |_| {
            axis.move_by("1 turn")?;
            axis.wait(Duration::from_secs(10))
        });
        self.run_step("disable", |_| axis.disable());
        self.run_step("prepare for speeds", |actor| actor.write_settings(&axis, part.speed_mode));
        axis.arm(true);
        self.run_step("spin at 300 rpm", |actor| {
            axis.enable()?;
            axis.velocity("300 rpm")?;
            actor.show_live(&axis, headless, 1500)
        });
        self.apply_act(Act::Load(-0.05));
        self.run_step("hold it under load", |actor| actor.show_live(&axis, headless, 800));
        self.apply_act(Act::Load(0.0));
        self.run_fault(&axis, headless)?;
        self.run_step("time its answers", |actor| actor.time_reads(&axis));
        axis.arm(false);
        print_note("");
        if crate::interrupt::was_interrupted() { Err(Problem::interrupted()) } else { Ok(()) }
    }

    /// A fault, its words, its cure, and the motor turning again.
    fn run_fault(&mut self, axis: &LocalAxis, headless: bool) -> Result<()> {
        let part = self.demo_drive;
        print_note(&format!("  -- {} --", part.fault_text));
        self.apply_act(part.fault);
        self.run_step("see the fault", |_| {
            for _ in 0..40 {
                pause(50);
                let value = axis.signals(&[Signal::Fault])?[0];
                let faults = polepair::active_faults(axis.profile(), value.raw);
                if let Some(fault) = faults.iter().find(|fault| !fault.is_warning) {
                    print_note(&format!("     {}: {} {}", fault.name, fault.text, fault.remedy));
                    return Ok(());
                }
            }
            axis.wait(Duration::ZERO)
        });
        print_note(&format!("  -- {} --", part.recovery_text));
        self.apply_act(part.recovery);
        if part.cycle_power {
            self.apply_act(Act::PowerCycle);
        }
        pause(500);
        self.run_step("clear", |_| axis.clear());
        axis.arm(true);
        self.run_step("spin again", |actor| {
            axis.enable()?;
            axis.velocity("120 rpm")?;
            actor.show_live(axis, headless, 800)
        });
        self.run_step("stop", |_| axis.stop());
        self.run_step("power off", |_| axis.disable());
        Ok(())
    }

    /// Does a step, and shows the first of its frames.
    fn run_step(
        &mut self,
        name: &'static str,
        act: impl FnOnce(&mut Self) -> std::result::Result<(), polepair::Error>,
    ) {
        if crate::interrupt::was_interrupted() {
            return;
        }
        self.frames.lock().unwrap_or_else(PoisonError::into_inner).clear();
        let started_at = clock::now();
        let ended = act(self);
        let took = clock::now().since(started_at).as_secs_f64();
        match ended {
            Ok(()) => {
                self.passed_steps.push(name);
                print_note(&format!("  {name:<24} ok   {took:>6.3} s"));
            }
            Err(error) => {
                print_note(&format!("  {name:<24} FAILED: {error}"));
                self.failed_steps.push(format!("{name}: {error}"));
            }
        }
        for frame in self.frames.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            print_note(&format!("      {frame}"));
        }
    }

    /// Does something to the drive from outside.
    fn apply_act(&self, act: Act) {
        self.line.with_bench(0, |bench| bench.act(clock::now(), act));
        self.stop.wake();
    }

    fn write_settings(
        &mut self,
        axis: &LocalAxis,
        settings: &[(&str, i64)],
    ) -> std::result::Result<(), polepair::Error> {
        axis.arm(true);
        for (name, raw) in settings {
            // Only kept settings outlast the power cycle that follows.
            axis.write(axis.find(name)?, *raw, self.demo_drive.cycle_power)?;
        }
        if self.demo_drive.cycle_power && !settings.is_empty() {
            self.apply_act(Act::PowerCycle);
            pause(500);
        }
        Ok(())
    }

    /// A live line for a while.
    fn show_live(
        &mut self,
        axis: &LocalAxis,
        headless: bool,
        ms: u32,
    ) -> std::result::Result<(), polepair::Error> {
        let end = clock::now().plus_ms(ms);
        while clock::now() < end && !crate::interrupt::was_interrupted() {
            let mut line = String::new();
            for wanted in [Signal::Velocity, Signal::Position, Signal::Current] {
                if let Ok(Some(value)) = read_signal(axis, wanted) {
                    line.push_str(&format!("{} {value:<20.20}  ", wanted.name()));
                }
            }
            if !headless {
                terminal::draw(&format!("\r\x1b[K  | {line}"));
            }
            pause(50);
        }
        if !headless {
            terminal::draw("\r\x1b[K");
        }
        Ok(())
    }

    /// Measures the median time of a read.
    fn time_reads(&mut self, axis: &LocalAxis) -> std::result::Result<(), polepair::Error> {
        let source = axis.profile().signal(Signal::Velocity).map(|source| source.parameter);
        let Some(id) = source else { return Ok(()) };
        let mut spans = Vec::new();
        for _ in 0..TIMED_READS {
            let started_at = clock::now();
            axis.read(id)?;
            spans.push(clock::now().since(started_at).as_secs_f64() * 1e6);
        }
        spans.sort_by(f64::total_cmp);
        self.read_us = spans[spans.len() / 2];
        Ok(())
    }
}

/// Lets real time pass.
fn pause(ms: u32) {
    clock::sleep_until(clock::now().plus_ms(ms));
}

/// A connector whose frames are explained into `frames`.
fn recording_connector(url: &str, frames: &FrameLines) -> Connector {
    let protocol = url.split('+').next().unwrap_or(url).to_owned();
    let rules = Rules::for_protocols([&*protocol]);
    let decoder = CaptureDecoder::new(rules);
    let text = text::FrameTextWriter::new(text::TextStyle {
        colour: terminal::colour_err(),
        ..text::TextStyle::default()
    });
    Connector::default().with_tap(FrameRecorder { decoder, text, frames: Arc::clone(frames) })
}

/// Keeps the first frames of a step, explained.
struct FrameRecorder {
    decoder: CaptureDecoder,
    text: text::FrameTextWriter,
    frames: FrameLines,
}

impl FrameRecorder {
    fn record_frame(&mut self, at: Instant, direction: TapDirection, unit: UnitRef<'_>) {
        let Self { decoder, text, frames } = self;
        unit.decode(decoder, at, "link", direction, &mut |event| {
            let mut line = Vec::new();
            text.write(event, &mut line);
            let mut frames = frames.lock().unwrap_or_else(PoisonError::into_inner);
            if frames.len() < FRAMES_SHOWN * 2 {
                frames.push_back(String::from_utf8_lossy(&line).trim().to_owned());
            }
        });
    }
}

impl Tap<Stream> for FrameRecorder {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, bytes: &[u8]) {
        self.record_frame(at, direction, UnitRef::Bytes(bytes));
    }
}

impl Tap<Can> for FrameRecorder {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, frame: &Frame) {
        self.record_frame(at, direction, UnitRef::Frame(frame));
    }
}

fn error_count(actor: &DemoRun) -> u64 {
    let counters = actor.link.counters(&actor.link.axes()[0]);
    counters.late + counters.foreign + counters.corrupt
}

fn summary_text(actors: &[DemoRun], behind_relay: Option<&str>) -> String {
    let mut table =
        TextTable::with_heads(&["drive", "protocol", "steps", "round trips", "one read", "errors"]);
    for actor in actors {
        let axis = &actor.link.axes()[0];
        let counters = actor.link.counters(axis);
        table.add_row([
            axis.profile().title.to_owned(),
            axis.protocol().to_owned(),
            format!(
                "{} of {}",
                actor.passed_steps.len(),
                actor.passed_steps.len() + actor.failed_steps.len()
            ),
            counters.answered.to_string(),
            format!("{:.0} us", actor.read_us),
            (error_count(actor) + actor.failed_steps.len() as u64).to_string(),
        ]);
    }
    let mut text = format!("Found {} drives of two makers by a scan.\n", actors.len());
    if actors.iter().all(|actor| actor.failed_steps.is_empty()) {
        text.push_str(
            "Each was enabled, homed, moved, spun, loaded, faulted and recovered through the\n",
        );
        text.push_str("same axis interface, over its own protocol on a pseudo-terminal.\n");
    }
    match behind_relay {
        None => text.push_str("Two drives on CAN were turned through a third one's serial port.\n"),
        Some(failed) => text.push_str(&format!("failed: {failed}\n")),
    }
    text.push('\n');
    text.push_str(&table.render(terminal::colour_out()));
    for actor in actors {
        for failed in &actor.failed_steps {
            text.push_str(&format!("failed: {failed}\n"));
        }
    }
    text.push_str("\nNext: polepair sim tmcl --pty /tmp/drive, and in another terminal\n");
    text.push_str("      polepair spin tmcl+serial:///tmp/drive#1 300rpm\n");
    text
}

/// Tests of the parts of the scene that the drives' own plans decide.
#[cfg(test)]
mod tests {
    use super::DEMO_DRIVES;
    use polepair_core::axis::Verb;

    #[test]
    fn every_drive_of_the_scene_has_the_plans_it_plays() {
        for part in &DEMO_DRIVES {
            let name = part.drive.split_once(':').map_or(part.drive, |(name, _)| name);
            let profile = polepair_drives::profiles().iter().find(|p| p.name == name);
            let profile = profile.expect("a profile");
            for verb in [Verb::Enable, Verb::Home, Verb::MoveBy, Verb::Velocity, Verb::Stop] {
                assert!(profile.plan(verb).is_some(), "{name}: {}", verb.name());
            }
        }
    }
}
