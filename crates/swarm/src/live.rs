//! What lives in a world: clients that say things and hear what came of it, wires that fail, and those
//! who watch.

mod heard;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use polepair_core::time::Instant;
use polepair_serve::bench::{Bench, Channel, Event, Frames, Reply, Session};
use polepair_serve::message::{
    Arguments, CommandOrder, LeaseAct, LeaseGranted, Outcome, Refused, SignalValue, StopOrder,
    Stopped,
};
use polepair_sim::random::{History, Ppm, Random};

use crate::drives::Rack;
use crate::person::{Mood, Person, Step, Word};
use crate::scene::{at, note, speed};
use crate::schedule::Calamity;
use crate::watch::{Found, Watch};
use crate::wire::{AnyPort, Condition, Fate};
use crate::{Report, Tell, VIOLATIONS_MAX, Violation};

/// A lease is renewed so often, ms.
const RENEW_MS: u32 = 450;
/// What is not known to be executed may still be for so long.
const LINGERS_MS: u32 = 4_000;
/// Nothing of what was said before moves an axis that long after its wire is well and it is to stand.
const SETTLED: Duration = Duration::from_millis(3_000);

/// What was certain longer ago than this is not held against what is true now.
const FRESH: Duration = Duration::from_millis(20);

/// Something that a client waits for.
struct Asked {
    who: usize,
    axis: u16,
    said: Instant,
    what: What,
}

enum What {
    Lease(Reply<Option<LeaseGranted>>),
    Command { verb: &'static str, epoch: u64, starts: u64, alone: bool, reply: Reply<Outcome> },
    Stop { turned: Vec<bool>, late: bool, reply: Reply<Stopped> },
    Release(Reply<()>),
    Read(Reply<Vec<SignalValue>>),
}

/// All that lives.
pub struct Live {
    random: Random,
    ports: Vec<Arc<dyn AnyPort>>,
    calamities: VecDeque<Calamity>,
    people: Vec<Person>,
    asked: Vec<Asked>,
    watches: Vec<Watch>,
    verbs: Vec<Vec<String>>,
    events: Events,
    channels: Vec<Channel>,
    locked: Option<Instant>,
    ids: u32,
    begin: Instant,
    /// Nobody says anything from then on.
    quiet: Instant,
    closing: bool,
    /// What came of the world.
    pub report: Report,
    history: History,
    now: Instant,
    tell: Option<Tell>,
    frames: Option<Frames>,
    /// What was started, and since when each axis was owed when it was.
    started: Vec<u64>,
}

type Events = Box<dyn FnMut() -> Option<Event>>;

impl Live {
    #[expect(clippy::too_many_arguments, reason = "each is drawn by the scene, in its order")]
    pub fn new(
        rack: &Rack,
        mut random: Random,
        bench: &Bench,
        ports: Vec<Arc<dyn AnyPort>>,
        (begin, quiet): (Instant, Instant),
        calamities: Vec<Calamity>,
        report: Report,
        tell: Option<Tell>,
    ) -> Self {
        let mut heard = bench.events();
        let count = 1 + random.below(4) as usize;
        let people = (0..count).map(|n| Person::new(n, &mut random, begin)).collect();
        let view = bench.snapshot();
        let verbs: Vec<Vec<String>> = view
            .axes
            .iter()
            .map(|axis| axis.verbs.iter().map(|verb| verb.verb.clone()).collect())
            .collect();
        let mut channels = Vec::new();
        for axis in &view.axes {
            for signal in &axis.signals {
                let watched = random.chance(Ppm(300_000));
                let hz = random.pick(&[1.0, 5.0, 20.0]);
                if watched {
                    let channel = bench.subscribe(axis.id, Some(&signal.signal), None, hz);
                    channels.extend(channel.ok());
                }
            }
        }
        let frames = tell.is_some().then(|| bench.frames(None).ok()).flatten();
        let watches: Vec<Watch> =
            rack.axes.iter().map(|(kind, wire)| Watch::new(kind, *wire)).collect();
        Self {
            random,
            ports,
            calamities: calamities.into(),
            people,
            asked: Vec::new(),
            started: vec![0; watches.len()],
            watches,
            verbs,
            events: Box::new(move || heard.try_recv().ok()),
            channels,
            locked: None,
            ids: 0,
            begin,
            quiet,
            closing: false,
            report,
            history: History::default(),
            now: begin,
            tell,
            frames,
        }
    }

    /// Tells a line of the history, where somebody listens, and hashes it.
    pub fn say(&mut self, line: impl FnOnce() -> String) {
        let line = line();
        note(&mut self.history, &line);
        self.history.note(self.now.0);
        if let Some(tell) = &self.tell {
            tell(&format!("{:10.6} {line}", at(self.now)));
        }
    }

    /// Everything that is due now. `tends`: a drive is waited for, so that hands have their turn here.
    pub fn turn(&mut self, bench: &Bench, tends: bool) {
        self.now = bench.simulation(0).map_or(self.now, |simulation| simulation.now());
        self.report.count("turns");
        while self.calamities.front().is_some_and(|next| next.at <= self.now) {
            if let Some(Calamity { wire, condition, .. }) = self.calamities.pop_front() {
                self.say(|| format!("wire {wire} is {condition}"));
                self.report.count(word(condition));
                self.ports[wire].set(condition);
            }
        }
        self.ports.iter().for_each(|port| port.flush());
        if self.now < self.quiet {
            self.people_turn(bench);
        }
        if tends {
            bench.tend();
        }
        // What is told is held against what is true now.
        self.look(bench);
        self.hear(bench);
        self.show_frames();
    }

    fn people_turn(&mut self, bench: &Bench) {
        for who in 0..self.people.len() {
            self.mind(who, bench);
            if self.people[who].mood != Mood::Here {
                continue;
            }
            self.renew(who, bench);
            if self.people[who].next <= self.now {
                let pause = self.random.pick(&[5, 20, 60, 150, 400]);
                self.people[who].next = self.now.plus_ms(1 + self.random.below(pause) as u32);
                let axes = self.watches.len() as u16;
                let (locked, random) = (self.locked.is_some(), &mut self.random);
                let word = self.people[who].choose(random, axes, locked);
                self.speak(who, word, bench);
            }
        }
    }

    /// Comes back, goes on, or is noticed to have gone.
    fn mind(&mut self, who: usize, bench: &Bench) {
        let (now, person) = (self.now, &mut self.people[who]);
        match person.mood {
            Mood::Here => {}
            Mood::Hangs(until) if now >= until => {
                person.mood = Mood::Here;
                let name = person.name.clone();
                self.say(|| format!("{name} goes on"));
            }
            Mood::Gone(Some(noticed), back) if now >= noticed => {
                person.mood = Mood::Gone(None, back);
                let name = person.name.clone();
                self.say(|| format!("the server notices that {name} is gone"));
                bench.gone(&name);
            }
            Mood::Gone(_, back) if now >= back => {
                person.returns += 1;
                person.name = format!("client-{who}/{}", person.returns).into();
                person.holds.clear();
                person.mood = Mood::Here;
                let name = person.name.clone();
                self.say(|| format!("{name} comes back"));
            }
            Mood::Hangs(_) | Mood::Gone(..) => {}
        }
    }

    fn renew(&mut self, who: usize, bench: &Bench) {
        let now = self.now;
        let due: Vec<(u16, u64)> = self.people[who]
            .holds
            .iter_mut()
            .filter(|(_, hold)| hold.renew_at <= now)
            .map(|(axis, hold)| {
                hold.renew_at = now.plus_ms(RENEW_MS);
                (*axis, hold.epoch)
            })
            .collect();
        for (axis, epoch) in due {
            let reply = bench.lease(axis, &self.people[who].name, LeaseAct::Renew, epoch);
            self.asked.push(Asked { who, axis, said: now, what: What::Lease(reply) });
        }
    }

    fn speak(&mut self, who: usize, word: Word, bench: &Bench) {
        let (name, now) = (self.people[who].name.clone(), self.now);
        match word {
            Word::Wait => {}
            Word::Take(axis, over) => {
                self.say(|| format!("{name} takes axis {axis}{}", if over { " over" } else { "" }));
                let act = if over { LeaseAct::TakeOver } else { LeaseAct::Take };
                let reply = bench.lease(axis, &name, act, 0);
                self.asked.push(Asked { who, axis, said: now, what: What::Lease(reply) });
            }
            Word::Drop(axis) => {
                self.say(|| format!("{name} gives axis {axis} back"));
                if let Some(hold) = self.people[who].holds.remove(&axis) {
                    drop(bench.lease(axis, &name, LeaseAct::Drop, hold.epoch));
                }
            }
            Word::Verb(axis, verb) => self.command(who, axis, verb, bench),
            Word::Stop(axis) => {
                self.say(|| format!("{name} says STOP to axis {axis}"));
                self.stop(who, Some(vec![axis]), bench);
            }
            Word::StopAll => {
                self.say(|| format!("{name} says STOP ALL"));
                self.stop(who, None, bench);
            }
            Word::Release => {
                self.say(|| format!("{name} lets motion again"));
                let reply = bench.release(&name, bench.locks());
                self.asked.push(Asked { who, axis: 0, said: now, what: What::Release(reply) });
            }
            Word::Read(axis) => {
                let reply = bench.read_signals(axis, &["velocity"]);
                self.asked.push(Asked { who, axis, said: now, what: What::Read(reply) });
            }
            Word::Hang => {
                let ms = self.random.between(200, 4000) as u32;
                self.say(|| format!("{name} hangs for {ms} ms"));
                self.people[who].mood = Mood::Hangs(now.plus_ms(ms));
            }
            Word::Vanish => {
                let noticed = self.random.chance(Ppm(700_000));
                let after = self.random.below(1500) as u32;
                let back = self.random.between(1500, 6000) as u32;
                self.say(|| format!("{name} vanishes, for {back} ms"));
                let noticed = noticed.then(|| now.plus_ms(after));
                self.people[who].mood = Mood::Gone(noticed, now.plus_ms(back));
            }
        }
    }

    fn command(&mut self, who: usize, axis: u16, verb: &'static str, bench: &Bench) {
        let of = usize::from(axis);
        let offered = ["arm", "disarm"].contains(&verb) || self.verbs[of].iter().any(|v| v == verb);
        let Some(hold) = self.people[who].holds.get_mut(&axis) else { return };
        if !offered {
            // Powered by whatever moves it.
            hold.step = hold.step.max(Step::Enabled);
            return;
        }
        hold.waits = true;
        let epoch = hold.epoch;
        let watch = &mut self.watches[of];
        let velocity = (verb == "velocity").then(|| speed(watch.kind, &mut self.random));
        let moves = ["velocity", "enable"].contains(&verb);
        let alone = watch.open == 0 && watch.unknown_until < self.now;
        let starts = watch.truth.starts;
        if moves {
            watch.open += 1;
            // Whatever else is open is not alone any more.
            for asked in self.asked.iter_mut().filter(|asked| asked.axis == axis) {
                if let What::Command { alone, .. } = &mut asked.what {
                    *alone = false;
                }
            }
        }
        if ["stop", "disable"].contains(&verb) {
            watch.stopped_at = self.now;
        }
        if verb == "stop" {
            watch.is_owed_to_holder(epoch, self.now);
        }
        if verb == "velocity" {
            // Who has lost his lease and does not know it moves nothing.
            watch.moved = watch.moved.max(Some(epoch));
            watch.is_to_move(epoch, self.now);
        }
        self.ids += 1;
        let order = CommandOrder {
            id: format!("id-{}", self.ids),
            issued_ms: bench.now_ms(),
            ttl_ms: 500.25,
            epoch,
            verb: verb.into(),
            arguments: Arguments { velocity, ..Arguments::default() },
        };
        let name = self.people[who].name.clone();
        let (id, asks) = (self.ids, velocity.map_or(String::new(), |v| format!(" {v} rad/s")));
        self.say(|| format!("{name} says {verb}{asks} to axis {axis} (id-{id}, epoch {epoch})"));
        let reply = bench.command(axis, &name, order);
        let what = What::Command { verb, epoch, starts, alone, reply };
        self.asked.push(Asked { who, axis, said: self.now, what });
    }

    fn stop(&mut self, who: usize, axes: Option<Vec<u16>>, bench: &Bench) {
        let name = self.people[who].name.clone();
        self.stop_by(who, &name, axes, bench);
    }

    fn stop_by(&mut self, who: usize, name: &Session, axes: Option<Vec<u16>>, bench: &Bench) {
        self.report.count("stops said");
        let all = || (0..self.watches.len() as u16).collect();
        let named: Vec<u16> = axes.clone().unwrap_or_else(all);
        for axis in named {
            let watch = &mut self.watches[usize::from(axis)];
            watch.owed = None;
            watch.is_owed(self.now);
        }
        let turned = self.watches.iter().map(Watch::turns).collect();
        let reply = bench.stop(name, &StopOrder { axes, reason: String::new() });
        let what = What::Stop { turned, late: false, reply };
        self.asked.push(Asked { who, axis: 0, said: self.now, what });
    }

    /// Somebody whom nobody knows stops everything.
    pub fn stop_all(&mut self, bench: &Bench) {
        self.say(|| "the supervisor says STOP ALL".to_owned());
        self.stop_by(0, &"supervisor".into(), None, bench);
    }

    /// The server is about to end.
    pub fn shuts_down(&mut self) {
        self.closing = true;
        let now = self.now;
        self.watches.iter_mut().filter(|watch| watch.turns()).for_each(|watch| watch.is_owed(now));
    }

    /// It has ended, and these were told as not seen standing.
    pub fn is_shut(&mut self, bench: &Bench, left: &[String]) {
        self.turn(bench, false);
        let view = bench.snapshot();
        for n in 0..self.watches.len() {
            let named = view.axes.get(n).is_some_and(|axis| {
                let link = view.links.iter().find(|link| link.id == axis.link);
                link.is_some_and(|link| left.contains(&format!("{} of {}", axis.label, link.url)))
            });
            let well = self.ports[self.watches[n].wire].well_since();
            let found = self.watches[n].is_left(self.now, named, well);
            self.found(n, found);
        }
    }

    fn hear(&mut self, bench: &Bench) {
        while let Some(event) = (self.events)() {
            match event {
                Event::Lease { axis, lease } => {
                    let epoch = lease.as_ref().map(|lease| lease.epoch);
                    let watch = &mut self.watches[usize::from(axis)];
                    if watch.epoch != epoch {
                        let owner = lease.map_or_else(|| "nobody".to_owned(), |l| l.owner);
                        watch.leased(epoch, self.now);
                        self.say(|| format!("axis {axis} is {owner}'s"));
                    }
                }
                Event::Stopped(stopped) => {
                    let (id, class) = (stopped.id, stopped.class);
                    self.say(|| format!("all are told: axis {id} stop {class:?}"));
                    self.judge_stop(id, class);
                }
                Event::Locked(told) => {
                    self.locked = Some(self.now);
                    self.say(|| format!("motion is locked by {}", told.by));
                }
                Event::Unlocked => {
                    self.locked = None;
                    self.say(|| "motion is let again".to_owned());
                }
                Event::Bench => {
                    let states: Vec<_> = bench
                        .snapshot()
                        .links
                        .iter()
                        .map(|link| format!("{:?}", link.state))
                        .collect();
                    self.say(|| format!("links: {}", states.join(", ")));
                }
                Event::Look(_) => {}
                #[allow(unreachable_patterns, reason = "later kinds of events")]
                _ => {}
            }
        }
        let mut n = 0;
        while n < self.asked.len() {
            if self.answered(n) {
                self.asked.swap_remove(n);
            } else {
                n += 1;
            }
        }
    }

    /// The truth of each motor, and what is broken.
    fn look(&mut self, bench: &Bench) {
        for n in 0..self.watches.len() {
            let Some(truth) = bench.truth(n as u16) else { continue };
            let well = self.ports[self.watches[n].wire].well_since();
            let turned = self.watches[n].turns();
            let owed = bench.axis(n as u16).ok().map(|state| state.owed.is_some());
            let found = self.watches[n].look(self.now, truth, well, owed, false);
            let watch = &self.watches[n];
            if watch.turns() != turned {
                let (turns, speed, owed) = (watch.turns(), truth.velocity, watch.owed.is_some());
                let owed = if owed { ", owed a stop" } else { "" };
                self.say(|| match turns {
                    true => format!("truth: axis {n} turns{owed}, {speed:.1} rad/s"),
                    false => format!("truth: axis {n} turns no more{owed}, {speed:.1} rad/s"),
                });
            }
            if truth.starts != self.started[n] {
                self.started[n] = truth.starts;
                self.report.count("motion executed");
                let starts = truth.starts;
                self.say(|| format!("truth: axis {n} executed motion, number {starts}"));
                self.judge_start(n, well);
            }
            self.found(n, found);
        }
    }

    /// Nothing starts an axis while motion is locked, once all that was said before has arrived.
    fn judge_start(&mut self, n: usize, well: Option<Instant>) {
        let settled =
            |since: Instant| well.is_some_and(|well| self.now.since(well.max(since)) > SETTLED);
        // What a stop writes may look like motion.
        let stopped = self.watches[n].stopped_at;
        if let Some(locked) = self.locked
            && settled(locked.max(stopped))
        {
            let since = self.now.since(locked).as_secs_f64();
            self.violate(
                "G10",
                format!("axis {n} is moved though motion is locked for {since:.2} s"),
            );
        }
    }

    fn found(&mut self, axis: usize, found: impl IntoIterator<Item = Found>) {
        let kind = self.watches[axis].kind.name;
        for (invariant, what) in found {
            self.violate(invariant, format!("axis {axis} ({kind}): {what}"));
        }
    }

    fn violate(&mut self, invariant: &'static str, what: String) {
        self.say(|| format!("!!! {invariant} {what}"));
        if self.report.violations.len() < VIOLATIONS_MAX {
            self.report.violations.push(Violation { invariant, at: self.now, what });
        }
    }

    fn show_frames(&mut self) {
        for wire in 0..self.ports.len() {
            for seen in self.ports[wire].take_seen() {
                self.history.note(seen.at.0);
                self.history.note_bytes(&seen.bytes);
                if self.tell.is_some() && seen.fate != Fate::Passed {
                    let way = if seen.to_drives { "to drives" } else { "to the host" };
                    let (fate, bytes) = (seen.fate, &seen.bytes);
                    let line = format!("  wire {wire} {way}, {fate:?}: {bytes:02X?}");
                    self.tell.iter().for_each(|tell| tell(&format!("{:10.6} {line}", at(seen.at))));
                }
            }
        }
        let Some(frames) = &mut self.frames else { return };
        for item in frames.take(usize::MAX).0 {
            let way = match item.dir {
                Some(polepair_serve::message::FrameDirection::Tx) => '>',
                Some(polepair_serve::message::FrameDirection::Rx) => '<',
                None => '?',
            };
            let at = item.t_us / 1e6 + crate::scene::at(self.begin);
            let line = format!("{at:10.6}   wire {} {way} {} | {}", item.link, item.raw, item.text);
            self.tell.iter().for_each(|tell| tell(&line));
        }
    }

    /// The report.
    pub fn ended(mut self) -> Report {
        for port in &self.ports {
            let counts = port.counts();
            let mut add = |name, count| *self.report.counts.entry(name).or_default() += count;
            add("links lost", counts.lost);
            add("links opened again", counts.opened);
            add("links refused", counts.refused);
            add("units sent", counts.sent);
            add("units lost on the way", counts.missing);
        }
        self.channels.clear();
        self.report.history = self.history.value();
        self.report
    }
}

fn why(error: Option<&Refused>) -> String {
    error.map_or(String::new(), |refused| {
        // How old something is told to be is rounded by the machine's clock.
        let message = if refused.code == "gateway.expired" { "" } else { &*refused.message };
        format!("({}: {message}; executed {:?})", refused.code, refused.executed)
    })
}

fn word(condition: Condition) -> &'static str {
    match condition {
        Condition::Well => "wires well again",
        Condition::Gone => "wires gone",
        Condition::Drops(_) => "wires dropping",
        Condition::Silent { .. } => "wires silent",
        Condition::Slow(_) => "wires slow",
    }
}
