//! `polepair demo [--headless]`: three makers' drives, simulated, on pseudo-terminals, in real time.

mod relay;

use std::collections::VecDeque;
use std::io::Write as _;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use clap::Args;
use polepair::simulate::{self, DriveLine};
use polepair::{Axis, Connector, Link};
use polepair_capture::{Decoder, Rules, text};
use polepair_core::drives::bench::Act;
use polepair_core::medium::{Can, Frame, Stream};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::serve::Served;
use polepair_link::tap::{Direction, Tap};
use polepair_link::{Stop, clock, pty::Pty};

use crate::cmd::info;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::signal;
use crate::target::Unit;
use crate::terminal::{self, Table, say};

/// Frames of a step that are shown.
const FRAMES_SHOWN: usize = 3;
/// Reads that are timed on each drive.
const READS: u32 = 200;

/// Finds, homes, moves, spins, faults and recovers two simulated drives, and turns two behind a
/// relay.
///
/// A Trinamic TMCM-171 over TMCL and a SYNTRON TS over Modbus RTU, each behind its own protocol on
/// a pseudo-terminal, and two Technosoft drives on CAN behind a third, all through the same axis
/// interface. No hardware is needed.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair demo --headless")]
pub struct Demo {
    /// No live lines; end with the summary
    #[arg(long)]
    headless: bool,
}

/// The rack of the scene: what is special about each drive stands here, and nowhere below.
const PARTS: [Part; 2] = [
    Part {
        drive: "tmcm-171:1",
        position_mode: &[("stop switch enable", 1)],
        speed_mode: &[],
        cycle_power: false,
        switches: &[Act::Switch { which: 0, at: 3.0 }],
        trouble: "its supply sags to 7 V",
        fault: Act::Supply(7.0),
        cure: "the supply comes back",
        cured: Act::Supply(24.0),
    },
    Part {
        drive: "syntron-ts:1",
        position_mode: &[("control mode", 14), ("homing way", 20_000)],
        speed_mode: &[("control mode", 1)],
        cycle_power: true,
        switches: &[Act::Switch { which: 0, at: -1.0 }],
        trouble: "its encoder cable comes loose",
        fault: Act::EncoderBroken(true),
        cure: "the cable is plugged in and the drive switched off and on",
        cured: Act::EncoderBroken(false),
    },
];

struct Part {
    drive: &'static str,
    /// Settings, raw, before it takes positions.
    position_mode: &'static [(&'static str, i64)],
    /// Settings, raw, before it takes speeds.
    speed_mode: &'static [(&'static str, i64)],
    /// A new mode, and a cured fault, need the power off and on.
    cycle_power: bool,
    switches: &'static [Act],
    trouble: &'static str,
    fault: Act,
    cure: &'static str,
    cured: Act,
}

/// A served drive and its open link.
struct Actor {
    part: &'static Part,
    line: DriveLine,
    stop: Stop,
    link: Link,
    frames: Frames,
    done: Vec<&'static str>,
    failed: Vec<String>,
    read_us: f64,
    _served: Served,
}

type Frames = Arc<Mutex<VecDeque<String>>>;

impl Demo {
    pub fn run(self) -> Result {
        crate::interrupt::listen(|| ());
        say("polepair demo: simulated drives, each behind its own wire protocol\n");
        let mut actors = Vec::new();
        for part in &PARTS {
            actors.push(Actor::enter(part)?);
        }
        for actor in &mut actors {
            actor.play(self.headless)?;
        }
        let failed = relay::play()?;
        print!("{}", summary(&actors, failed.as_deref()));
        let _ = std::io::stdout().flush();
        let played = actors.iter().all(|actor| actor.failed.is_empty() && errors(actor) == 0);
        match played && failed.is_none() {
            true => Ok(Exit::Ok),
            false => {
                Err(Problem::new(Exit::Negative, "E112", "the scene did not play as written."))
            }
        }
    }
}

impl Actor {
    /// Serves the drive, finds it by a scan, and opens its link.
    fn enter(part: &'static Part) -> Result<Self> {
        let description = simulate::rack_of_words(&[part.drive], 1).map_err(outcome::error)?;
        let lines = simulate::lines(&description, 1).map_err(outcome::error)?;
        let Some(line) = lines.into_iter().next() else {
            return Err(Problem::usage("E244", "the demo's rack has no link."));
        };
        let pty = Pty::open(None).map_err(|error| outcome::link_error(&error))?;
        let url = description.urls(0, &format!("serial://{}", pty.path())).remove(0);
        let url = url.split('#').next().unwrap_or(&url).to_owned();
        let served = line.clone().serve(Box::new(pty));
        say(&format!("scanning {url}"));
        let frames = Frames::default();
        let connector = connector(&url, &frames);
        let found = polepair::scan::scan(&connector, &url, 1..=3, &mut |_| {
            std::ops::ControlFlow::Continue(())
        });
        let found = found.map_err(outcome::error)?.found;
        for one in &found {
            say(&format!(
                "  found axis {}: {} ({})",
                one.number, one.profile.title, one.identified
            ));
        }
        let number = found.first().map_or(1, |found| found.number);
        let link = connector.connect(&format!("{url}#{number}")).map_err(outcome::error)?;
        say("");
        Ok(Self {
            part,
            line,
            stop: served.stop(),
            link,
            frames,
            done: Vec::new(),
            failed: Vec::new(),
            read_us: 0.0,
            _served: served,
        })
    }

    fn play(&mut self, headless: bool) -> Result<()> {
        let axis = self.link.axes()[0].clone();
        say(&format!("== {} ==", axis.profile().title));
        for signal in [Signal::Position, Signal::Voltage, Signal::Temperature, Signal::Fault] {
            if let Some(shown) = info::shown(&axis, signal)? {
                say(&format!("  {:<12} {shown}", signal.name()));
            }
        }
        let part = self.part;
        part.switches.iter().for_each(|act| self.act(*act));
        self.step("prepare for positions", |actor| actor.settings(&axis, part.position_mode));
        axis.arm(true);
        self.step("enable", |_| axis.enable());
        self.step("home", |_| axis.home());
        self.step("move by one turn", |_| {
            axis.move_by("1 turn")?;
            axis.wait(Duration::from_secs(10))
        });
        self.step("disable", |_| axis.disable());
        self.step("prepare for speeds", |actor| actor.settings(&axis, part.speed_mode));
        axis.arm(true);
        self.step("spin at 300 rpm", |actor| {
            axis.enable()?;
            axis.velocity("300 rpm")?;
            actor.watch(&axis, headless, 1500)
        });
        self.act(Act::Load(-0.05));
        self.step("hold it under load", |actor| actor.watch(&axis, headless, 800));
        self.act(Act::Load(0.0));
        self.trip(&axis, headless)?;
        self.step("time its answers", |actor| actor.measure(&axis));
        axis.arm(false);
        say("");
        if crate::interrupt::came() { Err(Problem::interrupted()) } else { Ok(()) }
    }

    /// A fault, its words, its cure, and the motor turning again.
    fn trip(&mut self, axis: &Axis, headless: bool) -> Result<()> {
        let part = self.part;
        say(&format!("  -- {} --", part.trouble));
        self.act(part.fault);
        self.step("see the fault", |_| {
            for _ in 0..40 {
                pause(50);
                let value = axis.signals(&[Signal::Fault])?[0];
                let faults = outcome::faults(axis.profile(), u32::try_from(value.raw).unwrap_or(0));
                let serious = |f: &&&polepair_core::profile::Fault| {
                    f.severity == polepair_core::profile::Severity::Fault
                };
                if let Some(fault) = faults.iter().find(serious) {
                    say(&format!("     {}: {} {}", fault.name, fault.text, fault.remedy));
                    return Ok(());
                }
            }
            axis.wait(Duration::ZERO)
        });
        say(&format!("  -- {} --", part.cure));
        self.act(part.cured);
        if part.cycle_power {
            self.act(Act::PowerCycle);
        }
        pause(500);
        self.step("clear", |_| axis.clear());
        axis.arm(true);
        self.step("spin again", |actor| {
            axis.enable()?;
            axis.velocity("120 rpm")?;
            actor.watch(axis, headless, 800)
        });
        self.step("stop", |_| axis.stop());
        self.step("power off", |_| axis.disable());
        Ok(())
    }

    /// Does a step, and shows the first of its frames.
    fn step(
        &mut self,
        name: &'static str,
        act: impl FnOnce(&mut Self) -> std::result::Result<(), polepair::Error>,
    ) {
        if crate::interrupt::came() {
            return;
        }
        self.frames.lock().unwrap_or_else(PoisonError::into_inner).clear();
        let begun = clock::now();
        let ended = act(self);
        let took = clock::now().since(begun).as_secs_f64();
        match ended {
            Ok(()) => {
                self.done.push(name);
                say(&format!("  {name:<24} ok   {took:>6.3} s"));
            }
            Err(error) => {
                say(&format!("  {name:<24} FAILED: {error}"));
                self.failed.push(format!("{name}: {error}"));
            }
        }
        for frame in self.frames.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            say(&format!("      {frame}"));
        }
    }

    /// Does something to the drive from outside.
    fn act(&self, act: Act) {
        self.line.bench(0, |bench| bench.act(clock::now(), act));
        self.stop.look();
    }

    fn settings(
        &mut self,
        axis: &Axis,
        settings: &[(&str, i64)],
    ) -> std::result::Result<(), polepair::Error> {
        axis.arm(true);
        for (name, raw) in settings {
            // What is to outlast the power must be kept.
            axis.write(axis.find(name)?, *raw, self.part.cycle_power)?;
        }
        if self.part.cycle_power && !settings.is_empty() {
            self.act(Act::PowerCycle);
            pause(500);
        }
        Ok(())
    }

    /// A live line for a while.
    fn watch(
        &mut self,
        axis: &Axis,
        headless: bool,
        ms: u32,
    ) -> std::result::Result<(), polepair::Error> {
        let end = clock::now().plus_ms(ms);
        while clock::now() < end && !crate::interrupt::came() {
            let mut line = String::new();
            for wanted in [Signal::Velocity, Signal::Position, Signal::Current] {
                if let Ok(Some(value)) = signal(axis, wanted) {
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

    /// How long a read takes, in the middle.
    fn measure(&mut self, axis: &Axis) -> std::result::Result<(), polepair::Error> {
        let source = axis.profile().signal(Signal::Velocity).map(|source| source.parameter);
        let Some(id) = source else { return Ok(()) };
        let mut spans = Vec::new();
        for _ in 0..READS {
            let begun = clock::now();
            axis.read(id)?;
            spans.push(clock::now().since(begun).as_secs_f64() * 1e6);
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
fn connector(url: &str, frames: &Frames) -> Connector {
    let protocol = url.split('+').next().unwrap_or(url).to_owned();
    let rules = Rules::parse(&protocol).unwrap_or_default();
    let decoder = Decoder::new(rules);
    let text =
        text::Text::new(text::Style { colour: terminal::colour_err(), ..text::Style::default() });
    Connector::default().with_tap(Watcher { decoder, text, frames: Arc::clone(frames) })
}

/// Keeps the first frames of a step, explained.
struct Watcher {
    decoder: Decoder,
    text: text::Text,
    frames: Frames,
}

impl Watcher {
    fn see(&mut self, at: Instant, direction: Direction, unit: Unit<'_>) {
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

impl Tap<Stream> for Watcher {
    fn unit(&mut self, at: Instant, direction: Direction, bytes: &[u8]) {
        self.see(at, direction, Unit::Bytes(bytes));
    }
}

impl Tap<Can> for Watcher {
    fn unit(&mut self, at: Instant, direction: Direction, frame: &Frame) {
        self.see(at, direction, Unit::Frame(frame));
    }
}

fn errors(actor: &Actor) -> u64 {
    let counters = actor.link.counters(&actor.link.axes()[0]);
    counters.late + counters.foreign + counters.corrupt
}

fn summary(actors: &[Actor], behind_relay: Option<&str>) -> String {
    let mut table =
        Table::with_heads(&["drive", "protocol", "steps", "round trips", "one read", "errors"]);
    for actor in actors {
        let axis = &actor.link.axes()[0];
        let counters = actor.link.counters(axis);
        table.row([
            axis.profile().title.to_owned(),
            axis.protocol().to_owned(),
            format!("{} of {}", actor.done.len(), actor.done.len() + actor.failed.len()),
            counters.answered.to_string(),
            format!("{:.0} us", actor.read_us),
            (errors(actor) + actor.failed.len() as u64).to_string(),
        ]);
    }
    let mut text = format!("Found {} drives of two makers by a scan.\n", actors.len());
    if actors.iter().all(|actor| actor.failed.is_empty()) {
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
        for failed in &actor.failed {
            text.push_str(&format!("failed: {failed}\n"));
        }
    }
    text.push_str("\nNext: polepair sim tmcl --pty /tmp/drive, and in another terminal\n");
    text.push_str("      polepair spin tmcl+serial:///tmp/drive#1 300rpm\n");
    text
}

/// What the scene leaves to the drives' own plans.
#[cfg(test)]
mod tests {
    use super::PARTS;
    use polepair_core::axis::Verb;

    #[test]
    fn every_drive_of_the_scene_has_the_plans_it_plays() {
        for part in &PARTS {
            let name = part.drive.split(':').next().unwrap_or("");
            let profile = polepair_core::drives::profiles().iter().find(|p| p.name == name);
            let profile = profile.expect("a profile");
            for verb in [Verb::Enable, Verb::Home, Verb::MoveBy, Verb::Velocity, Verb::Stop] {
                assert!(profile.plan(verb).is_some(), "{name}: {}", verb.name());
            }
        }
    }
}
