//! A CAN bus of a random world: drives of several families and protocols, one or two controlling programs,
//! and disturbances.

use std::collections::BTreeMap;

use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::proto::HostOptions;
use polepair_core::station::AxisIndex;
use polepair_core::time::Instant;

use super::axis::SwarmAxis;
use super::host_user::HostUser;
use super::inert::inert_parameters;
use super::intruder::{Intruder, IntruderAction};
use super::scenario::{
    BEGIN_MS, Disturbance, LATE_MAX_TIMEOUTS, OWN_MS, Scenario, host_timeout_ms,
};
use crate::can_bus::CanFaults;
use crate::host::{self, HostProtocol};
use crate::node::CanStationNode;
use crate::rack::RackDrive;
use crate::random::{Ppm, Random};
use crate::world::{NodeId, WireId};

/// Drives on a bus, and programs that command them.
const DRIVES_MAX: i64 = 5;
const PROGRAMS_MAX: i64 = 2;
/// Bits between two questions of several programs on a bus, which have a limited number open.
const SHARE_BITS: u64 = 6_000;
const SHARE_OPEN_MAX: usize = 2;
const BIT_RATES: [u32; 4] = [125_000, 250_000, 500_000, 1_000_000];
/// The second program's address, between those of drives. Where drives need the address of their host, both programs'
/// replies would have one identifier, and put each other off the bus.
const SECOND_HOST: u32 = 28;
/// Chance that a bus has no fault at all.
const FAULT_FREE_CHANCE: Ppm = Ppm(125_000);
/// Chance of each of the rarer calamities.
const FREQUENT: Ppm = Ppm(300_000);
const RARE: Ppm = Ppm(150_000);
/// Frames of a drive's own at the slowest bit rate with a busy bus before them, ms.
const QUEUE_MS: u32 = 20;

/// A drive that is to be on a bus.
struct PlannedDrive {
    protocol: HostProtocol,
    program: usize,
    host: Option<u32>,
    spec: RackDrive,
    drive: NodeId,
}

impl PlannedDrive {
    fn host_timeout_ms(&self) -> u32 {
        host_timeout_ms(self.spec.profile)
    }
}

impl Scenario {
    /// Adds a bus with all that is on it.
    pub(super) fn add_bus(&mut self, random: &mut Random) {
        let bit_rate = random.pick(&BIT_RATES);
        let wire = self.world.add_can(CanLine { bit_rate });
        self.wires.push(wire);
        self.describe(format!("a bus at {} kbit/s", bit_rate / 1_000));
        let wanted = self.draw_drives(wire, random);
        let first = self.users.len();
        let programs = wanted.iter().map(|wanted| wanted.program).max().map_or(0, |n| n + 1);
        for program in 0..programs {
            let own: Vec<_> = wanted.iter().filter(|wanted| wanted.program == program).collect();
            self.add_program(wire, bit_rate, &own, random);
        }
        if programs > 1 {
            // The station with the lower identifiers could otherwise keep the others from the bus for ever.
            let think_us = SHARE_BITS * 1_000_000 / u64::from(bit_rate);
            self.users[first..].iter_mut().for_each(|c| c.limit_rate(think_us, SHARE_OPEN_MAX));
        }
        let patience = wanted.iter().map(PlannedDrive::host_timeout_ms).min().unwrap_or(100);
        let sound = random.chance(FAULT_FREE_CHANCE);
        self.users[first..].iter_mut().for_each(|client| client.fault_free = sound);
        if sound {
            return self.describe("no faults".into());
        }
        self.plan_bus_faults(wire, first, patience, random);
        for at in first..self.users.len() {
            self.plan_program_faults(at, random);
        }
        if let Some(wanted) = wanted.first().filter(|_| random.chance(RARE)) {
            self.add_twin(wire, wanted, random);
        }
    }

    fn draw_drives(&mut self, wire: WireId, random: &mut Random) -> Vec<PlannedDrive> {
        let speaks =
            |p: &HostProtocol| polepair_drives::profiles().iter().any(|d| d.protocol == p.profile);
        let protocols = host::protocols().into_iter();
        let names: Vec<_> =
            protocols.filter(|p| p.medium == MediumKind::Can && speaks(p)).collect();
        let programs = random.between(1, PROGRAMS_MAX) as u64;
        let apart = random.chance(Ppm(500_000));
        let mut wanted = Vec::new();
        for n in 0..random.between(1, DRIVES_MAX) as u32 {
            let host_protocol = random.pick(&names);
            let products: Vec<_> = polepair_drives::profiles()
                .iter()
                .copied()
                .filter(|p| p.protocol == host_protocol.profile)
                .collect();
            let mut spec = RackDrive::new(random.pick(&products), host_protocol.name);
            // Odd steps leave room for what hosts have between the drives.
            (spec.address, spec.seed) =
                (Some(host_protocol.first_address + 2 * n), random.next_u64());
            let program = random.below(programs) as usize;
            let mut host = Some(SECOND_HOST).filter(|_| program > 0);
            let plain = spec.clone();
            spec.extra.extend(host.map(|host| ("host".to_owned(), host.to_string())));
            if spec.device(false).is_err() {
                (spec, host) = (plain, host.filter(|_| apart));
            }
            if let Ok(drive) = spec.build(&mut self.world, wire, false) {
                let (name, address) = (spec.profile.name, spec.address.unwrap_or(0));
                self.describe(format!(
                    "{drive:?}: {name} on {}, address {address}",
                    host_protocol.name
                ));
                wanted.push(PlannedDrive { protocol: host_protocol, program, host, spec, drive });
            }
        }
        wanted
    }

    /// A program that commands these drives: one lane for each protocol.
    fn add_program(
        &mut self,
        wire: WireId,
        bit_rate: u32,
        own: &[&PlannedDrive],
        random: &mut Random,
    ) {
        let mut lanes: BTreeMap<&str, Vec<&PlannedDrive>> = BTreeMap::new();
        own.iter().for_each(|w| lanes.entry(w.protocol.name).or_default().push(w));
        let axes = lanes.values().flatten().enumerate().map(|(n, w)| {
            let index = AxisIndex(n as u8);
            SwarmAxis::new(
                index,
                w.drive,
                w.spec.profile,
                w.protocol.name,
                inert_parameters(&w.protocol, w.spec.profile),
            )
        });
        let axes: Vec<_> = axes.collect();
        let lanes: Vec<_> = lanes
            .iter()
            .map(|(name, own)| {
                let host = own.first().and_then(|w| w.host);
                let doubt = random.chance(Ppm(500_000)).then(|| random.next_u64() as u32);
                let options = HostOptions {
                    host_address: host,
                    probe_seed: doubt,
                    ..HostOptions::new(bit_rate)
                };
                (
                    *name,
                    options,
                    own.iter()
                        .map(|w| (w.spec.profile, w.spec.address.unwrap_or(0)))
                        .collect::<Vec<_>>(),
                )
            })
            .collect();
        let Some(lane) = host::can_program(&lanes).filter(|_| !axes.is_empty()) else { return };
        let host = self.world.add_node(lane);
        self.world.plug_host(wire, host, 0);
        self.describe(format!(
            "{host:?}: commands {:?}",
            axes.iter().map(|a| a.drive).collect::<Vec<_>>()
        ));
        let client = HostUser::new(&self.world, host, wire, axes, random);
        self.users.push(client);
    }

    /// Decides what will be wrong with a bus, and when.
    fn plan_bus_faults(&mut self, wire: WireId, at: usize, patience: u32, random: &mut Random) {
        let begin = Instant::ZERO.plus_ms(BEGIN_MS);
        let latest = (LATE_MAX_TIMEOUTS * patience).saturating_sub(OWN_MS + QUEUE_MS);
        let faults = CanFaults::random(random, latest);
        self.schedule(begin, Disturbance::CanFaults(at, faults));
        for intruder_action in [
            IntruderAction::Babble,
            IntruderAction::Load(random.between(150, 2_000) as u32),
            IntruderAction::Forge,
        ] {
            if random.chance(RARE) {
                let from = self.random_fault_time(random);
                let longest = if intruder_action == IntruderAction::Babble {
                    i64::from(latest)
                } else {
                    3_000
                };
                let until = from.plus_ms(random.between(5, longest) as u32).min(self.faults_end);
                self.describe(format!("from {from:?} until {until:?}: {intruder_action:?}"));
                let intruder = Intruder::new(intruder_action, (from, until), 0, random.fork());
                let node = self.world.add_node(Box::new(CanStationNode(intruder)));
                self.world.plug_intruder(wire, node);
            }
        }
        if random.chance(RARE) {
            let from = self.random_fault_time(random);
            let until = from.plus_ms(random.between(1, 800) as u32);
            self.schedule(from, Disturbance::Cut(at, true));
            self.schedule(until, Disturbance::Cut(at, false));
        }
    }

    /// Decides what will happen to a program and its drives.
    fn plan_program_faults(&mut self, at: usize, random: &mut Random) {
        let axes = self.users[at].axes.len() as u64;
        for _ in 0..random.below(3) * u64::from(random.chance(FREQUENT)) {
            let when = self.random_fault_time(random);
            self.schedule(when, Disturbance::BusOff(at, None));
        }
        for _ in 0..random.below(3) * u64::from(random.chance(FREQUENT)) {
            let (when, which) = (self.random_fault_time(random), random.below(axes) as usize);
            self.schedule(when, Disturbance::BusOff(at, Some(which)));
        }
        for _ in 0..random.below(3) * u64::from(random.chance(FREQUENT)) {
            let (when, which) = (self.random_fault_time(random), random.below(axes) as usize);
            self.schedule(when, Disturbance::PowerCycle(at, which));
        }
        for which in 0..self.users[at].axes.len() {
            let profile = self.users[at].axes[which].profile;
            self.plan_acts(at, which, profile, random);
        }
        if random.chance(RARE) {
            let (from, which) = (self.random_fault_time(random), random.below(axes) as usize);
            let until = from.plus_ms(random.between(1, 500) as u32);
            self.schedule(from, Disturbance::Unplug(at, which, true));
            self.schedule(until, Disturbance::Unplug(at, which, false));
        }
    }

    /// For a while there is a second drive of one address (F8).
    fn add_twin(&mut self, wire: WireId, wanted: &PlannedDrive, random: &mut Random) {
        let seed = random.next_u64();
        let spec = RackDrive { seed, ..wanted.spec.clone() };
        let Ok(twin) = spec.build(&mut self.world, wire, false) else { return };
        self.world.set_unplugged(wire, twin, true);
        let owner = self.users.iter().enumerate().find_map(|(at, client)| {
            let which = client.axes.iter().position(|axis| axis.drive == wanted.drive)?;
            Some((at, which))
        });
        let Some((at, which)) = owner else { return };
        let from = self.random_fault_time(random);
        let until = from.plus_ms(random.between(20, 1_500) as u32).min(self.faults_end);
        self.schedule(from, Disturbance::Twin(at, which, twin, true));
        self.schedule(until, Disturbance::Twin(at, which, twin, false));
    }

    /// Some instant while faults may be.
    fn random_fault_time(&self, random: &mut Random) -> Instant {
        let begin = Instant::ZERO.plus_ms(BEGIN_MS);
        begin.plus_ns(random.below(self.faults_end.since(begin).as_nanos() as u64))
    }
}
