//! The world of one seed: its content, its faults and their times.

use polepair_core::medium::MediumKind;
use polepair_core::profile::{Profile, Severity};
use polepair_core::proto::HostOptions;
use polepair_core::proto::tml::host::REPLY_TIMEOUT_MS;
use polepair_core::station::AxisIndex;
use polepair_core::time::Instant;
use polepair_drives::surroundings::Act;

use super::axis::SwarmAxis;
use super::host_user::HostUser;
use super::inert::{host_options, inert_parameters};
use super::{RECOVERY_MS, WorldReport};
use crate::can_bus::CanFaults;
use crate::check::Violation;
use crate::fault::SerialFaults;
use crate::host::{self, HostProtocol};
use crate::rack::RackDrive;
use crate::random::{Ppm, Random};
use crate::serial_line::{Duplex, SerialWireConfig, Timing};
use crate::world::{NodeId, Reception, StepResult, WireId, World};

/// Links in a world, drives on a link.
const LINKS_MAX: i64 = 3;
const DRIVES_MAX: i64 = 3;
/// When faults begin, and for how long there may be faults, ms.
pub(super) const BEGIN_MS: u32 = 500;
const FAULTS_MS: i64 = 6_000;
/// Time in which everything must work after the time to recover, ms.
const FAULT_FREE_MS: u32 = 500;
/// Longest delay of a late reply, in time-outs of the host: the most that a profile promises.
pub(super) const LATE_MAX_TIMEOUTS: u32 = 3;
/// Part of that for the drive's own pauses and the host's adapter, ms.
pub(super) const OWN_MS: u32 = 40;

/// Chance that an act ends the motions of a drive early.
const ACTS_CHANCE: Ppm = Ppm(400_000);

/// Timings between host and wire, the usual ones more often.
const TIMINGS: [Timing; 8] = {
    let mut timings = [Timing::Uart; 8];
    (timings[5], timings[6], timings[7]) = (Timing::Ftdi, Timing::Cdc, Timing::Tcp);
    timings
};

/// Reply time-out of the host of such a drive, ms: for TML less than that of the profile.
pub(super) fn host_timeout_ms(profile: &Profile) -> u32 {
    let max = if profile.protocol == "tml" { REPLY_TIMEOUT_MS } else { u32::MAX };
    profile.reply_timeout_ms.min(max)
}

/// A world with its users and its calamities.
pub struct Scenario {
    pub(super) world: World,
    pub(super) wires: Vec<WireId>,
    pub(super) users: Vec<HostUser>,
    disturbances: Vec<(Instant, Disturbance)>,
    pub(super) faults_end: Instant,
    report: WorldReport,
    /// Members of the world, and its faults.
    description: Vec<String>,
}

/// A disturbance. The first number is the client that it affects, or one of those on the bus.
#[derive(Clone, Copy, Debug)]
pub(super) enum Disturbance {
    /// The client's serial wire begins to do its worst.
    SerialFaults(usize, SerialFaults),
    /// The client's bus begins to do its worst.
    CanFaults(usize, CanFaults),
    /// The host's port is set to another baud rate, or to the right one again (F13).
    Baud(usize, u32),
    /// The cable is pulled, or plugged.
    Cut(usize, bool),
    /// A drive loses its supply for a moment (F14).
    PowerCycle(usize, usize),
    /// The host's controller, or that of a drive, goes bus-off (F9).
    BusOff(usize, Option<usize>),
    /// A drive's connector is pulled from the bus, or put in again.
    Unplug(usize, usize, bool),
    /// Something is done to a drive from outside the wire, or undone.
    Act(usize, usize, Act),
    /// A second drive of a drive's address is plugged into the bus, or pulled (F8).
    Twin(usize, usize, NodeId, bool),
}

impl Scenario {
    pub fn new(medium: MediumKind, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let world = World::new(random.next_u64());
        let calm_at = Instant::ZERO.plus_ms(BEGIN_MS + random.between(1_000, FAULTS_MS) as u32);
        let mut scene = Self {
            world,
            wires: Vec::new(),
            users: Vec::new(),
            disturbances: Vec::new(),
            faults_end: calm_at,
            report: WorldReport { seed, ..WorldReport::default() },
            description: Vec::new(),
        };
        match medium {
            MediumKind::Serial => scene.add_links(&mut random),
            MediumKind::Can => scene.add_bus(&mut random),
        }
        scene.disturbances.sort_by_key(|(at, _)| *at);
        scene
    }

    fn add_links(&mut self, random: &mut Random) {
        let names: Vec<_> =
            // The faults of a serial line are none of a TCP connection.
            host::protocols()
                .into_iter()
                .filter(|p| p.medium == MediumKind::Serial && !p.is_on_network)
                .collect();
        for _ in 0..random.between(1, LINKS_MAX) {
            if !names.is_empty() {
                let protocol = random.pick(&names);
                self.add_link(&protocol, random);
            }
        }
    }

    /// Notes something that is in the world.
    pub(super) fn describe(&mut self, what: String) {
        self.description.push(what);
    }

    /// Notes something that will break.
    pub(super) fn schedule(&mut self, at: Instant, calamity: Disturbance) {
        self.disturbances.push((at, calamity));
    }

    /// Writes down what happens.
    pub fn enable_log(&mut self) {
        self.world.enable_log();
        self.report.logs = true;
    }

    /// Runs the world to its end and returns the result.
    pub fn run(self) -> WorldReport {
        self.run_with_log(&mut |_| {})
    }

    /// [`run`](Self::run) that also reports the events, if a log is kept.
    pub fn run_with_log(mut self, report_line: &mut dyn FnMut(&str)) -> WorldReport {
        let end = self.faults_end.plus_ms(RECOVERY_MS + FAULT_FREE_MS);
        self.description.iter().for_each(|line| report_line(line));
        for (at, calamity) in &self.disturbances {
            report_line(&format!("at {:.6}: {calamity:?}", at.0 as f64 / 1e9));
        }
        self.run_until(self.faults_end, report_line);
        self.end_faults();
        self.run_until(end, report_line);
        for client in &mut self.users {
            client.finish(&mut self.world, &mut self.report);
        }
        for wire in &self.wires {
            self.report.injected.add(&self.world.injected_faults(*wire));
            self.report.injected_on_can.add(&self.world.injected_can_faults(*wire));
        }
        let spins = self.world.busy_loops();
        if spins > 0 {
            let what = format!("a station wanted time {spins} times without making use of it");
            let violation = Violation { invariant: "I8", at: self.world.now(), what };
            self.report.add_violations([violation]);
        }
        self.report.events = self.world.events();
        self.report.history = self.world.history();
        self.report.world_time = self.world.now();
        self.report
    }

    fn run_until(&mut self, end: Instant, report_line: &mut dyn FnMut(&str)) {
        let mut calamities = std::mem::take(&mut self.disturbances).into_iter().peekable();
        loop {
            let asks = self.users.iter().map(|c| c.next_at).min().unwrap_or(Instant::FAR_FUTURE);
            let breaks = calamities.peek().map_or(Instant::FAR_FUTURE, |(at, _)| *at);
            let happens = self.world.next_event().unwrap_or(Instant::FAR_FUTURE);
            let next = asks.min(breaks).min(happens);
            if next > end {
                break;
            }
            for line in self.report.log.drain(..) {
                report_line(&line);
            }
            if happens == next {
                self.step();
            } else if breaks == next {
                self.world.run_until(next);
                let (_, calamity) = calamities.next().unwrap_or((end, Disturbance::Cut(0, false)));
                self.report.log_event(next, || format!("{calamity:?}"));
                self.apply_disturbance(calamity);
            } else {
                self.world.run_until(next);
                self.run_users(next);
            }
        }
        self.world.run_until(end);
    }

    fn step(&mut self) {
        let happened = self.world.step();
        for reception in self.world.take_log() {
            let Reception { at, node: by, data, .. } = reception;
            self.report.log_event(at, || format!("{by:?} hears {data}"));
        }
        for client in &mut self.users {
            let touched = match happened {
                Some(StepResult::Arrival(wire)) => wire == client.wire,
                Some(StepResult::NodeTimeout(node)) => node == client.host,
                _ => false,
            };
            if touched {
                client.check_event(&mut self.world, &mut self.report);
            }
        }
    }

    fn run_users(&mut self, now: Instant) {
        for client in self.users.iter_mut().filter(|c| c.next_at <= now) {
            client.submit_random(&mut self.world, &mut self.report);
            client.check_event(&mut self.world, &mut self.report);
        }
    }

    fn apply_disturbance(&mut self, calamity: Disturbance) {
        let (world, report) = (&mut self.world, &mut self.report);
        match calamity {
            Disturbance::SerialFaults(at, faults) => {
                world.serial_faults(self.users[at].wire).into_iter().for_each(|f| *f = faults);
            }
            Disturbance::Baud(at, baud) => {
                world
                    .serial_faults(self.users[at].wire)
                    .into_iter()
                    .for_each(|f| f.host_baud = baud);
            }
            Disturbance::Cut(at, down) => {
                let wire = self.users[at].wire;
                let changes = world.set_wire_down(wire, down);
                for client in self.users.iter_mut().filter(|client| client.wire == wire) {
                    if changes {
                        client.record_link_lost();
                    }
                    client.check_event(world, report);
                }
                report.cable_pulls += u64::from(down);
            }
            Disturbance::CanFaults(at, faults) => {
                let wire = self.users[at].wire;
                world.can_faults(wire).into_iter().for_each(|f| *f = faults);
            }
            Disturbance::BusOff(at, which) => {
                let client = &mut self.users[at];
                let node = which.map_or(client.host, |which| client.axes[which].drive);
                world.force_bus_off(client.wire, node);
                client.check_event(world, report);
            }
            Disturbance::Unplug(at, which, away) => {
                let client = &self.users[at];
                world.set_unplugged(client.wire, client.axes[which].drive, away);
            }
            Disturbance::Twin(at, which, twin, there) => {
                let client = &mut self.users[at];
                world.set_unplugged(client.wire, twin, !there);
                let axis = &mut client.axes[which];
                (axis.untrusted, axis.has_twin) = (true, there);
                axis.invalidate();
            }
            Disturbance::Act(at, which, act) => {
                let axis = &mut self.users[at].axes[which];
                let acted =
                    world.with_node(axis.drive, |n, now| n.surroundings().map(|b| b.act(now, act)));
                if acted == Some(true) {
                    axis.record_disturbance(world.now());
                    report.acts += 1;
                }
            }
            Disturbance::PowerCycle(at, which) => {
                let axis = &mut self.users[at].axes[which];
                let drive = axis.drive;
                world.with_node(drive, |n, now| {
                    n.surroundings().map(|b| b.act(now, Act::PowerCycle))
                });
                axis.invalidate();
                report.resets += 1;
            }
        }
    }

    /// Every fault ends.
    fn end_faults(&mut self) {
        for wire in self.wires.clone() {
            let world = &mut self.world;
            world.serial_faults(wire).into_iter().for_each(|faults| *faults = SerialFaults::NONE);
            world.can_faults(wire).into_iter().for_each(|faults| *faults = CanFaults::default());
            let joined = world.set_wire_down(wire, false);
            for client in self.users.iter_mut().filter(|client| client.wire == wire) {
                for axis in client.axes.iter().filter(|_| client.medium == MediumKind::Can) {
                    world.set_unplugged(wire, axis.drive, false);
                }
                if joined {
                    client.record_link_lost();
                }
                client.end_faults(self.faults_end);
                client.check_event(world, &mut self.report);
            }
        }
    }

    fn add_link(&mut self, protocol: &HostProtocol, random: &mut Random) {
        let products: Vec<_> = polepair_drives::profiles()
            .iter()
            .copied()
            .filter(|p| p.protocol == protocol.profile)
            .collect();
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
        let baud = tcp.then_some(protocol.baud);
        let wire = self.world.add_serial(SerialWireConfig { duplex, timing, echo, baud });
        let options = HostOptions {
            untimed: cdc && random.chance(Ppm(500_000)),
            probe_seed: random.chance(Ppm(500_000)).then(|| random.next_u64() as u32),
            ..host_options(protocol, bus, echo)
        };
        // The keys of a connection string for a serial server.
        let options = if tcp {
            HostOptions { baud: 0, gap_us: Some(0), resync_pause_ms: Some(100), ..options }
        } else {
            options
        };
        self.describe(format!("{wire:?}: {timing:?}, {options:?}"));
        self.wires.push(wire);
        let (mut axes, mut served) = (Vec::new(), Vec::new());
        for n in 0..count {
            // Odd steps leave room for host addresses between the drives'.
            let (profile, address) = (random.pick(&products), protocol.first_address + 2 * n);
            let mut spec = RackDrive::new(profile, protocol.name);
            (spec.address, spec.seed) = (Some(address), random.next_u64());
            // A family that knows several standards gets that of this wire.
            let plain = spec.clone();
            spec.extra.extend(bus.then(|| ("wire".to_owned(), "rs485".to_owned())));
            let spec = if spec.device(cdc).is_ok() { spec } else { plain };
            let Ok(drive) = spec.build(&mut self.world, wire, cdc) else { continue };
            let index = AxisIndex(axes.len() as u8);
            axes.push(SwarmAxis::new(
                index,
                drive,
                profile,
                protocol.name,
                inert_parameters(protocol, profile),
            ));
            self.describe(format!(
                "{drive:?}: {} on {}, address {address}",
                profile.name, protocol.name
            ));
            served.push((profile, address));
        }
        let Some(lane) = host::host_lane(protocol.name, protocol.medium, options, &served) else {
            return;
        };
        let host = self.world.add_node(lane);
        self.world.plug_host(wire, host, 0);
        let mut client = HostUser::new(&self.world, host, wire, axes, random);
        client.next_at = Instant::ZERO.plus_ms(random.between(0, 300) as u32);
        self.plan_faults(&mut client, &served, protocol.baud, timing, random);
        self.users.push(client);
    }

    /// Decides what will break on a link, and when.
    fn plan_faults(
        &mut self,
        client: &mut HostUser,
        served: &[(&'static Profile, u32)],
        baud: u32,
        timing: Timing,
        random: &mut Random,
    ) {
        let at = self.users.len();
        let patience = served.iter().map(|(p, _)| host_timeout_ms(p)).max().unwrap_or(100);
        let begin = Instant::ZERO.plus_ms(BEGIN_MS);
        let network = if timing == Timing::Tcp { 2 * Timing::NETWORK_MS } else { 0 };
        let latest = (LATE_MAX_TIMEOUTS * patience).saturating_sub(OWN_MS + network);
        let mut faults = SerialFaults::random(random, patience, latest);
        if timing == Timing::Tcp {
            // Adapters double bytes; a network does not, for its packets are numbered.
            faults.duplicate = Ppm::NEVER;
        }
        if timing == Timing::Cdc {
            // USB checks its packets and numbers them: nothing is changed, nothing comes twice.
            let (flip, burst, lose, insert) = (Ppm::NEVER, Ppm::NEVER, Ppm::NEVER, Ppm::NEVER);
            let (truncate, duplicate, collide) = (Ppm::NEVER, Ppm::NEVER, Ppm::NEVER);
            faults =
                SerialFaults { flip, burst, lose, insert, truncate, duplicate, collide, ..faults };
        }
        client.fault_free = random.chance(Ppm(125_000));
        if client.fault_free {
            let (chunk_gap_us, latency_ms) = (faults.chunk_gap_us, faults.latency_ms);
            faults =
                SerialFaults { chunk: Ppm::ALWAYS, chunk_gap_us, latency_ms, ..SerialFaults::NONE };
        }
        self.disturbances.push((begin, Disturbance::SerialFaults(at, faults)));
        if client.fault_free {
            return;
        }
        let span = self.faults_end.since(begin).as_nanos() as u64;
        if random.chance(Ppm(200_000)) {
            let wrong = random.pick(&[baud / 2, baud * 2, baud / 4 * 3]);
            let from = random_instant(random, begin, span);
            let until = from.plus_ms(random.between(50, 500) as u32);
            self.disturbances.push((from, Disturbance::Baud(at, wrong)));
            self.disturbances.push((until, Disturbance::Baud(at, 0)));
        }
        if random.chance(Ppm(200_000)) {
            let from = random_instant(random, begin, span);
            let until = from.plus_ms(random.between(1, 800) as u32);
            self.disturbances.push((from, Disturbance::Cut(at, true)));
            self.disturbances.push((until, Disturbance::Cut(at, false)));
        }
        for _ in 0..random.below(3) * u64::from(random.chance(Ppm(300_000))) {
            let which = random.below(served.len() as u64) as usize;
            self.disturbances
                .push((random_instant(random, begin, span), Disturbance::PowerCycle(at, which)));
        }
        for (which, (profile, _)) in served.iter().enumerate() {
            self.plan_acts(at, which, profile, random);
        }
    }

    /// Decides what ends the motions of a drive early: a jam, a limit switch, a fault, safe torque off.
    pub(super) fn plan_acts(
        &mut self,
        at: usize,
        which: usize,
        profile: &'static Profile,
        random: &mut Random,
    ) {
        if !random.chance(ACTS_CHANCE) {
            return;
        }
        let begin = Instant::ZERO.plus_ms(BEGIN_MS);
        let span = self.faults_end.since(begin).as_nanos() as u64;
        let faults: Vec<u32> = profile
            .faults
            .iter()
            .filter(|fault| fault.severity == Severity::Fault)
            .map(|fault| fault.code)
            .collect();
        let limit = random.between(-20, 20) as f64;
        let (act, undo) = match random.below(4) {
            0 => (Act::Jam(true), Some(Act::Jam(false))),
            1 => (Act::Sto(true), Some(Act::Sto(false))),
            2 if !faults.is_empty() => (Act::Fault(random.pick(&faults)), None),
            _ => {
                let which = if limit > 0.0 { 1 } else { 2 };
                (switch_act(limit, which), Some(switch_act(f64::NAN, which)))
            }
        };
        let from = begin.plus_ns(random.below(span));
        self.disturbances.push((from, Disturbance::Act(at, which, act)));
        if let Some(undo) = undo {
            let until = from.plus_ms(random.between(50, 3_000) as u32);
            self.disturbances.push((until.min(self.faults_end), Disturbance::Act(at, which, undo)));
        }
    }
}

fn switch_act(at: f64, which: u8) -> Act {
    Act::Switch { which, at }
}

fn random_instant(random: &mut Random, begin: Instant, span: u64) -> Instant {
    begin.plus_ns(random.below(span))
}
