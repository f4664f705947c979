//! The world of one seed: what is in it, what breaks in it, and when.

use polepair_core::drives;
use polepair_core::drives::bench::Act;
use polepair_core::medium::MediumKind;
use polepair_core::profile::Profile;
use polepair_core::proto::HostOptions;
use polepair_core::proto::tml::host::REPLY_TIMEOUT_MS;
use polepair_core::station::AxisIndex;
use polepair_core::time::Instant;

use super::axis::Axis;
use super::client::Client;
use super::inert::{host_options, inert};
use super::{RECOVERY_MS, Report};
use crate::can_bus::CanFaults;
use crate::check::Violation;
use crate::fault::Faults;
use crate::host::{self, Spoken};
use crate::rack::RackDrive;
use crate::random::{Ppm, Random};
use crate::serial_line::{Duplex, Serial, Timing};
use crate::world::{Happening, Heard, NodeId, WireId, World};

/// Links in a world, drives on a link.
const LINKS_MAX: i64 = 3;
const DRIVES_MAX: i64 = 3;
/// When faults begin, and for how long there may be faults, ms.
pub(super) const BEGIN_MS: u32 = 500;
const STORM_MS: i64 = 6_000;
/// How long everything must work after the time to recover, ms.
const CALM_MS: u32 = 500;
/// A late reply comes within so many times the host's patience: what a profile promises at most.
pub(super) const LATEST_IN_TIMEOUTS: u32 = 3;
/// What the drive's own pauses and the host's adapter take of that, ms.
pub(super) const OWN_MS: u32 = 40;

/// What is between host and wire, the usual more often.
const TIMINGS: [Timing; 8] = {
    let mut timings = [Timing::Uart; 8];
    (timings[5], timings[6], timings[7]) = (Timing::Ftdi, Timing::Cdc, Timing::Tcp);
    timings
};

/// How long the host of such a drive waits for a reply, ms: one of TML's less than the profile says.
pub(super) fn patience_ms(profile: &Profile) -> u32 {
    let most = if profile.protocol == "tml" { REPLY_TIMEOUT_MS } else { u32::MAX };
    profile.reply_timeout_ms.min(most)
}

/// A world with its users and its calamities.
pub struct Scene {
    pub(super) world: World,
    pub(super) wires: Vec<WireId>,
    pub(super) clients: Vec<Client>,
    calamities: Vec<(Instant, Calamity)>,
    pub(super) calm_at: Instant,
    report: Report,
    /// What is in the world, and what will break in it.
    contents: Vec<String>,
}

/// What breaks. The first number is the client whom it hits, or one of those on the bus.
#[derive(Clone, Copy, Debug)]
pub(super) enum Calamity {
    /// The client's serial wire begins to do its worst.
    Storm(usize, Faults),
    /// The client's bus begins to do its worst.
    Disturb(usize, CanFaults),
    /// The host's port is set to another baud rate, or to the right one again (F13).
    Baud(usize, u32),
    /// The cable is pulled, or plugged.
    Cut(usize, bool),
    /// A drive loses its supply for a moment (F14).
    Reset(usize, usize),
    /// The host's controller, or that of a drive, goes bus-off (F9).
    Off(usize, Option<usize>),
    /// A drive's connector is pulled from the bus, or put in again.
    Pull(usize, usize, bool),
    /// A second drive of a drive's address is plugged into the bus, or pulled (F8).
    Twin(usize, usize, NodeId, bool),
}

impl Scene {
    pub fn new(medium: MediumKind, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let world = World::new(random.word());
        let calm_at = Instant::ZERO.plus_ms(BEGIN_MS + random.between(1_000, STORM_MS) as u32);
        let mut scene = Self {
            world,
            wires: Vec::new(),
            clients: Vec::new(),
            calamities: Vec::new(),
            calm_at,
            report: Report { seed, ..Report::default() },
            contents: Vec::new(),
        };
        match medium {
            MediumKind::Serial => scene.add_links(&mut random),
            MediumKind::Can => scene.add_bus(&mut random),
        }
        scene.calamities.sort_by_key(|(at, _)| *at);
        scene
    }

    fn add_links(&mut self, random: &mut Random) {
        let spoken: Vec<_> =
            host::protocols().into_iter().filter(|p| p.medium == MediumKind::Serial).collect();
        for _ in 0..random.between(1, LINKS_MAX) {
            if !spoken.is_empty() {
                let protocol = random.pick(&spoken);
                self.add_link(&protocol, random);
            }
        }
    }

    /// Notes something that is in the world.
    pub(super) fn note(&mut self, what: String) {
        self.contents.push(what);
    }

    /// Notes something that will break.
    pub(super) fn befalls(&mut self, at: Instant, calamity: Calamity) {
        self.calamities.push((at, calamity));
    }

    /// Writes down what happens.
    pub fn keep_diary(&mut self) {
        self.world.keep_log();
        self.report.keeps_diary = true;
    }

    /// Lives to the end and tells what came of it.
    pub fn live(self) -> Report {
        self.tell(&mut |_| {})
    }

    /// The same, and tells what happens meanwhile, if a diary is kept.
    pub fn tell(mut self, tell: &mut dyn FnMut(&str)) -> Report {
        let end = self.calm_at.plus_ms(RECOVERY_MS + CALM_MS);
        self.contents.iter().for_each(|line| tell(line));
        for (at, calamity) in &self.calamities {
            tell(&format!("at {:.6}: {calamity:?}", at.0 as f64 / 1e9));
        }
        self.live_until(self.calm_at, tell);
        self.calm();
        self.live_until(end, tell);
        for client in &mut self.clients {
            client.close(&mut self.world, &mut self.report);
        }
        for wire in &self.wires {
            self.report.made.add(&self.world.made(*wire));
            self.report.made_on_can.add(&self.world.can_made(*wire));
        }
        let spins = self.world.spins();
        if spins > 0 {
            let what = format!("a station wanted time {spins} times without making use of it");
            let violation = Violation { invariant: "I8", at: self.world.now(), what };
            self.report.violations_of([violation]);
        }
        self.report.events = self.world.events();
        self.report.history = self.world.history();
        self.report.lived = self.world.now();
        self.report
    }

    fn live_until(&mut self, end: Instant, tell: &mut dyn FnMut(&str)) {
        let mut calamities = std::mem::take(&mut self.calamities).into_iter().peekable();
        loop {
            let asks = self.clients.iter().map(|c| c.next_at).min().unwrap_or(Instant::FAR);
            let breaks = calamities.peek().map_or(Instant::FAR, |(at, _)| *at);
            let happens = self.world.next_event().unwrap_or(Instant::FAR);
            let next = asks.min(breaks).min(happens);
            if next > end {
                break;
            }
            for line in self.report.diary.drain(..) {
                tell(&line);
            }
            if happens == next {
                self.step();
            } else if breaks == next {
                self.world.run_until(next);
                let (_, calamity) = calamities.next().unwrap_or((end, Calamity::Cut(0, false)));
                self.report.write(next, || format!("{calamity:?}"));
                self.befall(calamity);
            } else {
                self.world.run_until(next);
                self.ask(next);
            }
        }
        self.world.run_until(end);
    }

    fn step(&mut self) {
        let happened = self.world.step();
        for heard in self.world.take_log() {
            let Heard { at, by, carried, .. } = heard;
            self.report.write(at, || format!("{by:?} hears {carried}"));
        }
        for client in &mut self.clients {
            let touched = match happened {
                Some(Happening::Arrival(wire)) => wire == client.wire,
                Some(Happening::Time(node)) => node == client.host,
                _ => false,
            };
            if touched {
                client.after(&mut self.world, &mut self.report);
            }
        }
    }

    fn ask(&mut self, now: Instant) {
        for client in self.clients.iter_mut().filter(|c| c.next_at <= now) {
            client.ask(&mut self.world, &mut self.report);
            client.after(&mut self.world, &mut self.report);
        }
    }

    fn befall(&mut self, calamity: Calamity) {
        let (world, report) = (&mut self.world, &mut self.report);
        match calamity {
            Calamity::Storm(at, faults) => {
                world.faults(self.clients[at].wire).into_iter().for_each(|f| *f = faults);
            }
            Calamity::Baud(at, baud) => {
                world.faults(self.clients[at].wire).into_iter().for_each(|f| f.host_baud = baud);
            }
            Calamity::Cut(at, down) => {
                let wire = self.clients[at].wire;
                let changes = world.cut(wire, down);
                for client in self.clients.iter_mut().filter(|client| client.wire == wire) {
                    if changes {
                        client.disarmed();
                    }
                    client.after(world, report);
                }
                report.cuts += u64::from(down);
            }
            Calamity::Disturb(at, faults) => {
                let wire = self.clients[at].wire;
                world.can_faults(wire).into_iter().for_each(|f| *f = faults);
            }
            Calamity::Off(at, which) => {
                let client = &mut self.clients[at];
                let node = which.map_or(client.host, |which| client.axes[which].drive);
                world.switch_off(client.wire, node);
                client.after(world, report);
            }
            Calamity::Pull(at, which, away) => {
                let client = &self.clients[at];
                world.pull(client.wire, client.axes[which].drive, away);
            }
            Calamity::Twin(at, which, twin, there) => {
                let client = &mut self.clients[at];
                world.pull(client.wire, twin, !there);
                let axis = &mut client.axes[which];
                (axis.spoiled, axis.twinned) = (true, there);
                axis.forget();
            }
            Calamity::Reset(at, which) => {
                let axis = &mut self.clients[at].axes[which];
                let drive = axis.drive;
                world.with(drive, |n, now| n.bench().map(|b| b.act(now, Act::PowerCycle)));
                axis.forget();
                report.resets += 1;
            }
        }
    }

    /// Every fault ends.
    fn calm(&mut self) {
        for wire in self.wires.clone() {
            let world = &mut self.world;
            world.faults(wire).into_iter().for_each(|faults| *faults = Faults::NONE);
            world.can_faults(wire).into_iter().for_each(|faults| *faults = CanFaults::default());
            let joined = world.cut(wire, false);
            for client in self.clients.iter_mut().filter(|client| client.wire == wire) {
                for axis in client.axes.iter().filter(|_| client.medium == MediumKind::Can) {
                    world.pull(wire, axis.drive, false);
                }
                if joined {
                    client.disarmed();
                }
                client.calm(self.calm_at);
                client.after(world, &mut self.report);
            }
        }
    }

    fn add_link(&mut self, spoken: &Spoken, random: &mut Random) {
        let products: Vec<_> =
            drives::profiles().iter().copied().filter(|p| p.protocol == spoken.profile).collect();
        if products.is_empty() {
            return;
        }
        let count = random.between(1, DRIVES_MAX) as u32;
        let bus = count > 1 || random.chance(Ppm(500_000));
        let echo = bus && random.chance(Ppm(300_000));
        let duplex = if bus { Duplex::Half } else { Duplex::Full };
        let timing = random.pick(&TIMINGS);
        let (cdc, tcp) = (timing == Timing::Cdc, timing == Timing::Tcp);
        // The port of a serial server is set there, not by the host.
        let baud = tcp.then_some(spoken.baud);
        let wire = self.world.serial(Serial { duplex, timing, echo, baud });
        let options = HostOptions {
            untimed: cdc && random.chance(Ppm(500_000)),
            doubt: random.chance(Ppm(500_000)).then(|| random.word() as u32),
            ..host_options(spoken, bus, echo)
        };
        // What the host of a connection string is told of a serial server.
        let options = match tcp {
            true => HostOptions { baud: 0, gap_us: Some(0), pause_ms: Some(100), ..options },
            false => options,
        };
        self.note(format!("{wire:?}: {timing:?}, {options:?}"));
        self.wires.push(wire);
        let (mut axes, mut served) = (Vec::new(), Vec::new());
        for n in 0..count {
            // Odd steps leave room for host addresses between the drives'.
            let (profile, address) = (random.pick(&products), spoken.first_address + 2 * n);
            let mut spec = RackDrive::new(profile, spoken.name);
            (spec.address, spec.seed) = (Some(address), random.word());
            // A family that knows of several standards is told which one this wire follows.
            let plain = spec.clone();
            spec.extra.extend(bus.then(|| ("wire".to_owned(), "rs485".to_owned())));
            let spec = if spec.device(cdc).is_ok() { spec } else { plain };
            let Ok(drive) = spec.build(&mut self.world, wire, cdc) else { continue };
            let index = AxisIndex(axes.len() as u8);
            axes.push(Axis::new(index, drive, profile, spoken.name, inert(spoken, profile)));
            self.note(format!("{drive:?}: {} on {}, address {address}", profile.name, spoken.name));
            served.push((profile, address));
        }
        let Some(lane) = host::lane(spoken.name, spoken.medium, options, &served) else {
            return;
        };
        let host = self.world.add(lane);
        self.world.plug_host(wire, host, 0);
        let mut client = Client::new(&self.world, host, wire, axes, random);
        client.next_at = Instant::ZERO.plus_ms(random.between(0, 300) as u32);
        self.brew(&mut client, &served, spoken.baud, timing, random);
        self.clients.push(client);
    }

    /// Decides what will break on a link, and when.
    fn brew(
        &mut self,
        client: &mut Client,
        served: &[(&'static Profile, u32)],
        baud: u32,
        timing: Timing,
        random: &mut Random,
    ) {
        let at = self.clients.len();
        let patience = served.iter().map(|(p, _)| patience_ms(p)).max().unwrap_or(100);
        let begin = Instant::ZERO.plus_ms(BEGIN_MS);
        let network = if timing == Timing::Tcp { 2 * Timing::NETWORK_MS } else { 0 };
        let latest = (LATEST_IN_TIMEOUTS * patience).saturating_sub(OWN_MS + network);
        let mut faults = Faults::random(random, patience, latest);
        if timing == Timing::Tcp {
            // What doubles bytes is an adapter, and a network's packets are numbered.
            faults.duplicate = Ppm::NEVER;
        }
        if timing == Timing::Cdc {
            // USB checks its packets and numbers them: nothing is changed, nothing comes twice.
            let (flip, burst, lose, insert) = (Ppm::NEVER, Ppm::NEVER, Ppm::NEVER, Ppm::NEVER);
            let (truncate, duplicate, collide) = (Ppm::NEVER, Ppm::NEVER, Ppm::NEVER);
            faults = Faults { flip, burst, lose, insert, truncate, duplicate, collide, ..faults };
        }
        client.sound = random.chance(Ppm(125_000));
        if client.sound {
            let (chunk_gap_us, latency_ms) = (faults.chunk_gap_us, faults.latency_ms);
            faults = Faults { chunk: Ppm::ALWAYS, chunk_gap_us, latency_ms, ..Faults::NONE };
        }
        self.calamities.push((begin, Calamity::Storm(at, faults)));
        if client.sound {
            return;
        }
        let span = self.calm_at.since(begin).as_nanos() as u64;
        let sometime = |random: &mut Random| begin.plus_ns(random.below(span));
        if random.chance(Ppm(200_000)) {
            let wrong = random.pick(&[baud / 2, baud * 2, baud / 4 * 3]);
            let from = sometime(random);
            let until = from.plus_ms(random.between(50, 500) as u32);
            self.calamities.push((from, Calamity::Baud(at, wrong)));
            self.calamities.push((until, Calamity::Baud(at, 0)));
        }
        if random.chance(Ppm(200_000)) {
            let from = sometime(random);
            let until = from.plus_ms(random.between(1, 800) as u32);
            self.calamities.push((from, Calamity::Cut(at, true)));
            self.calamities.push((until, Calamity::Cut(at, false)));
        }
        for _ in 0..random.below(3) * u64::from(random.chance(Ppm(300_000))) {
            let which = random.below(served.len() as u64) as usize;
            self.calamities.push((sometime(random), Calamity::Reset(at, which)));
        }
    }
}
