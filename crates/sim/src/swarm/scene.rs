//! The world of one seed: what is in it, what breaks in it, and when.

use polepair_core::drives;
use polepair_core::drives::bench::Act;
use polepair_core::medium::MediumKind;
use polepair_core::profile::Profile;
use polepair_core::station::AxisIndex;
use polepair_core::time::Instant;

use super::axis::Axis;
use super::client::Client;
use super::inert::{host_options, inert};
use super::{RECOVERY_MS, Report};
use crate::check::Violation;
use crate::fault::Faults;
use crate::host::{self, Spoken};
use crate::rack::RackDrive;
use crate::random::{Ppm, Random};
use crate::serial_line::{Duplex, Serial};
use crate::world::{Happening, Heard, World};

/// Links in a world, drives on a link.
const LINKS_MAX: i64 = 3;
const DRIVES_MAX: i64 = 3;
/// When faults begin, and for how long there may be faults, ms.
const BEGIN_MS: u32 = 500;
const STORM_MS: i64 = 6_000;
/// How long everything must work after the time to recover, ms.
const CALM_MS: u32 = 500;
/// A late reply comes within so many times the host's patience: what a profile promises at most.
const LATEST_IN_TIMEOUTS: u32 = 3;
/// What the drive's own pauses and the host's adapter take of that, ms.
const OWN_MS: u32 = 40;

/// A world with its users and its calamities.
pub struct Scene {
    world: World,
    clients: Vec<Client>,
    calamities: Vec<(Instant, Calamity)>,
    calm_at: Instant,
    report: Report,
}

#[derive(Clone, Copy, Debug)]
enum Calamity {
    /// The wire of that client begins to do its worst.
    Storm(usize, Faults),
    /// The host's port of that client is set to another baud rate, or to the right one again.
    Baud(usize, u32),
    /// The cable of that client is pulled, or plugged.
    Cut(usize, bool),
    /// A drive of that client loses its supply for a moment.
    Reset(usize, usize),
}

impl Scene {
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let world = World::new(random.word());
        let calm_at = Instant::ZERO.plus_ms(BEGIN_MS + random.between(1_000, STORM_MS) as u32);
        let report = Report { seed, ..Report::default() };
        let calamities = Vec::new();
        let mut scene = Self { world, clients: Vec::new(), calamities, calm_at, report };
        let spoken: Vec<_> =
            host::protocols().into_iter().filter(|p| p.medium == MediumKind::Serial).collect();
        for _ in 0..random.between(1, LINKS_MAX) {
            if !spoken.is_empty() {
                let protocol = random.pick(&spoken);
                scene.add_link(&protocol, &mut random);
            }
        }
        scene.calamities.sort_by_key(|(at, _)| *at);
        scene
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
        self.live_until(self.calm_at, tell);
        self.calm();
        self.live_until(end, tell);
        for client in &mut self.clients {
            client.close(&mut self.world, &mut self.report);
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
            let Heard { at, by, bytes, label, .. } = heard;
            let changed = if label.tainted { " changed" } else { "" };
            let (tag, answers) = (label.tag, label.answers);
            self.report
                .write(at, || format!("{by:?} hears {bytes:02X?} = {tag} to {answers}{changed}"));
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
                let client = &mut self.clients[at];
                if world.cut(client.wire, down) {
                    client.disarmed();
                }
                client.after(world, report);
                report.cuts += u64::from(down);
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
        for client in &mut self.clients {
            self.world.faults(client.wire).into_iter().for_each(|faults| *faults = Faults::NONE);
            if self.world.cut(client.wire, false) {
                client.disarmed();
            }
            client.calm(self.calm_at);
            client.after(&mut self.world, &mut self.report);
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
        let wire = self.world.serial(Serial { duplex, timed: true, echo, baud: None });
        let (mut axes, mut served) = (Vec::new(), Vec::new());
        for n in 0..count {
            // Odd steps leave room for host addresses between the drives'.
            let (profile, address) = (random.pick(&products), spoken.first_address + 2 * n);
            let mut spec = RackDrive::new(profile, spoken.name);
            (spec.address, spec.seed) = (Some(address), random.word());
            // A family that knows of several standards is told which one this wire follows.
            let plain = spec.clone();
            spec.extra.extend(bus.then(|| ("wire".to_owned(), "rs485".to_owned())));
            let spec = if spec.device(false).is_ok() { spec } else { plain };
            let Ok(drive) = spec.build(&mut self.world, wire, false) else { continue };
            let index = AxisIndex(axes.len() as u8);
            axes.push(Axis::new(index, drive, profile, inert(spoken, profile)));
            served.push((profile, address));
        }
        let Some(lane) =
            host::lane(spoken.name, spoken.medium, host_options(spoken, bus, echo), &served)
        else {
            return;
        };
        let host = self.world.add(lane);
        self.world.plug_host(wire, host, 0);
        let mut client = Client::new(host, wire, spoken.name, axes, random.fork());
        client.next_at = Instant::ZERO.plus_ms(random.between(0, 300) as u32);
        self.brew(&mut client, &served, spoken.baud, random);
        self.clients.push(client);
    }

    /// Decides what will break on a link, and when.
    fn brew(
        &mut self,
        client: &mut Client,
        served: &[(&'static Profile, u32)],
        baud: u32,
        random: &mut Random,
    ) {
        let at = self.clients.len();
        let patience = served.iter().map(|(p, _)| p.reply_timeout_ms).max().unwrap_or(100);
        let begin = Instant::ZERO.plus_ms(BEGIN_MS);
        let latest = (LATEST_IN_TIMEOUTS * patience).saturating_sub(OWN_MS);
        let mut faults = Faults::random(random, patience, latest);
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
