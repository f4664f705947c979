//! Random and mutated frames for every deframer, host and device in the registries.
//!
//! Nothing panics, every request ends, and no motor is powered or moved by bytes in which no frame
//! passes its check. What a check lets through is measured and printed:
//! `POLEPAIR_GARBAGE=1000000 cargo test -p polepair-sim --test integration garbage:: -- --nocapture`.

use std::collections::HashSet;

use polepair_core::axis::{Command, Verb};
use polepair_core::error::Outcome;
use polepair_core::explain::{Context, Direction, Dissector, ExplainSink, Field, FrameBoundary};
use polepair_core::medium::{MediumKind, STREAM_UNIT_MAX};
use polepair_core::profile::{Access, ParameterId, Profile};
use polepair_core::proto::{self, HostOptions};
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_drives::{self, surroundings::GroundTruth};
use polepair_sim::host::{self, HostProtocol};
use polepair_sim::node::SimNode;
use polepair_sim::rack::RackDrive;
use polepair_sim::random::{Ppm, Random};

const AXIS: AxisIndex = AxisIndex(0);
/// Time within which a request must have ended.
const PATIENCE_MS: u32 = 60_000;
/// Longer than any drive's silence between frames and any host's guard time.
const REST_MS: u32 = 12;
/// Shaft movement that is only the servo settling, rad.
const STILL: f64 = 0.01;

/// Frames for each deframer, host and device.
fn frames() -> u64 {
    let full = std::env::var("POLEPAIR_GARBAGE").ok().and_then(|text| text.parse().ok());
    full.unwrap_or(200_000)
}

/// Damage to a good frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Harm {
    OneBit,
    TwoBits,
    OneByte,
    Burst,
    Cut,
    Dropped,
    Inserted,
    Glued,
    Random,
}

const HARMS: [Harm; 9] = [
    Harm::OneBit,
    Harm::TwoBits,
    Harm::OneByte,
    Harm::Burst,
    Harm::Cut,
    Harm::Dropped,
    Harm::Inserted,
    Harm::Glued,
    Harm::Random,
];

fn harm(random: &mut Random, frames: &[Vec<u8>]) -> (Harm, Vec<u8>) {
    let kind = random.pick(&HARMS);
    let mut bytes = frames[random.below(frames.len() as u64) as usize].clone();
    let at = random.below(bytes.len() as u64) as usize;
    match kind {
        Harm::OneBit => bytes[at] ^= 1 << random.below(8),
        Harm::TwoBits => {
            let bit = random.below(bytes.len() as u64 * 8 - 1) as usize;
            let other = random.below(bytes.len() as u64 * 8) as usize;
            bytes[bit / 8] ^= 1 << (bit % 8);
            bytes[other / 8] ^= 1 << (other % 8);
        }
        Harm::OneByte => bytes[at] = random.next_byte(),
        Harm::Burst => bytes[at..].fill_with(|| random.next_byte()),
        Harm::Cut => bytes.truncate(at),
        Harm::Dropped => drop(bytes.remove(at)),
        Harm::Inserted => bytes.insert(at, random.next_byte()),
        Harm::Glued => {
            bytes.truncate(at);
            bytes.extend(&frames[random.below(frames.len() as u64) as usize]);
        }
        Harm::Random => {
            bytes = (0..random.between(1, 40)).map(|_| random.next_byte()).collect();
        }
    }
    (kind, bytes)
}

/// The first frame in `bytes` that passes its check, wherever it begins.
fn passing<'a>(
    dissector: &dyn Dissector,
    bytes: &'a [u8],
    direction: Direction,
) -> Option<&'a [u8]> {
    (0..bytes.len()).find_map(|from| {
        match dissector.find_frame(&bytes[from..], Some(direction), true) {
            FrameBoundary::Frame(len) => Some(&bytes[from..from + len]),
            _ => None,
        }
    })
}

/// Every frame in `runs`: an answer may be several.
fn whole<'a>(
    dissector: &dyn Dissector,
    runs: &'a [Vec<u8>],
    direction: Direction,
) -> HashSet<&'a [u8]> {
    let mut all = HashSet::new();
    for mut rest in runs.iter().map(Vec::as_slice) {
        while let FrameBoundary::Frame(len) = dissector.find_frame(rest, Some(direction), true) {
            all.insert(&rest[..len]);
            rest = &rest[len..];
        }
    }
    all
}

/// Counts, by what was done: frames tried, frames let through.
#[derive(Default)]
struct Passed([(u64, u64); HARMS.len()]);

impl Passed {
    fn note(&mut self, kind: Harm, through: bool) {
        let at = HARMS.iter().position(|harm| *harm == kind).unwrap_or(0);
        self.0[at].0 += 1;
        self.0[at].1 += u64::from(through);
    }

    fn print(&self, who: &str) {
        for (kind, (tried, through)) in HARMS.iter().zip(self.0) {
            let share = through as f64 * 100.0 / tried.max(1) as f64;
            println!(
                "{who:32} {:9} {tried:>8} tried {through:>6} through {share:.4} %",
                format!("{kind:?}")
            );
        }
    }
}

/// A node on no wire, and its clock.
struct LoneDrive {
    node: Box<dyn SimNode>,
    now: Instant,
    said: Vec<u8>,
}

impl LoneDrive {
    fn new(node: Box<dyn SimNode>) -> Self {
        let mut alone = Self { node, now: Instant::ZERO, said: Vec::new() };
        alone.rest(2_000);
        alone
    }

    fn receive(&mut self, bytes: &[u8]) {
        let station = self.node.stream(0).expect("a serial station");
        station.handle_input(self.now, bytes);
        self.speak();
    }

    fn speak(&mut self) {
        let mut buffer = [0; STREAM_UNIT_MAX];
        let mut turns = 0;
        while let Some(len) =
            self.node.stream(0).and_then(|s| s.poll_transmit(self.now, &mut buffer))
        {
            self.said.extend_from_slice(&buffer[..len]);
            turns += 1;
            assert!(turns < 64, "speaks without end");
        }
    }

    /// Goes on by one appointment, at most to `end`.
    fn tick(&mut self, end: Instant) {
        let due = self.node.poll_timeout().unwrap_or(end).max(self.now);
        if due > end {
            self.now = end;
            return;
        }
        self.now = if due == self.now { self.now.plus_ns(1_000) } else { due };
        self.node.handle_timeout(self.now);
        self.speak();
    }

    fn rest(&mut self, ms: u32) {
        let end = self.now.plus_ms(ms);
        while self.now < end {
            self.tick(end);
        }
    }

    fn truth(&mut self) -> GroundTruth {
        let now = self.now;
        self.node.surroundings().expect("a drive").ground_truth(now)
    }
}

fn lane(protocol: &HostProtocol, profile: &'static Profile) -> LoneDrive {
    let options = HostOptions::new(0);
    let node = host::host_lane(
        protocol.name,
        protocol.medium,
        options,
        &[(profile, protocol.first_address)],
    );
    LoneDrive { node: node.expect("in the registry"), now: Instant::ZERO, said: Vec::new() }
}

fn drive(protocol: &HostProtocol, profile: &'static Profile) -> LoneDrive {
    let mut spec = RackDrive::new(profile, protocol.name);
    spec.address = Some(protocol.first_address);
    LoneDrive::new(spec.device(false).expect("a drive as from the factory"))
}

fn readable(profile: &'static Profile) -> Vec<ParameterId> {
    let ids = (0..profile.parameters.len()).map(|n| ParameterId(n as u16));
    ids.filter(|id| profile.parameter(*id).is_some_and(|p| p.access != Access::Write)).collect()
}

/// Begins to read a parameter. `None` when its scale must be read first.
fn begin_read(protocol: &HostProtocol, profile: &'static Profile, id: ParameterId) -> LoneDrive {
    let mut host = lane(protocol, profile);
    let now = host.now;
    let axes = host.node.axes().expect("a lane");
    axes.read_parameter(now, Ticket(1), AXIS, id).expect("a readable parameter");
    let end = host.now.plus_ms(1_000);
    host.speak();
    while host.said.is_empty() && host.now < end {
        host.tick(end);
    }
    host
}

/// Good requests: every step of every verb, and reads.
fn requests(protocol: &HostProtocol, profile: &'static Profile) -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    let mut host = lane(protocol, profile);
    let axes = host.node.axes().expect("a lane");
    for verb in Verb::ALL {
        let command = Command {
            target: Some(3.0),
            velocity: Some(5.0),
            torque: Some(0.01),
            ..Command::new(verb)
        };
        // A plan whose scale is not known yet shows no bytes; reads of it are below.
        let _ = axes.rehearse(AXIS, command, &mut |step| {
            all.extend((!step.bytes.is_empty()).then(|| step.bytes.to_vec()));
        });
    }
    for id in readable(profile).into_iter().take(20) {
        all.push(begin_read(protocol, profile, id).said);
    }
    all.retain(|frame| !frame.is_empty());
    all
}

/// Good replies, as the drive gives them.
fn replies(
    protocol: &HostProtocol,
    profile: &'static Profile,
    requests: &[Vec<u8>],
) -> Vec<Vec<u8>> {
    let mut drive = drive(protocol, profile);
    let mut all = Vec::new();
    for request in requests {
        drive.said.clear();
        drive.receive(request);
        drive.rest(50);
        all.extend((!drive.said.is_empty()).then(|| drive.said.clone()));
    }
    all
}

/// Every protocol with every product that has it.
fn pairs() -> Vec<(HostProtocol, &'static dyn Dissector, &'static Profile)> {
    let mut all = Vec::new();
    for protocol in host::protocols().into_iter().filter(|p| p.medium == MediumKind::Serial) {
        let dissector = proto::find_dissector(protocol.name).expect("every host has a dissector");
        let products =
            polepair_drives::profiles().iter().filter(|p| p.protocol == protocol.profile);
        all.extend(products.map(|profile| (protocol, dissector, *profile)));
    }
    all
}

struct Count(usize);

impl ExplainSink for Count {
    fn kind(&mut self, _: &str) {}
    fn axis(&mut self, _: u32) {}
    fn field(&mut self, field: Field<'_>) {
        assert!(field.start <= field.end);
        self.0 += 1;
    }
    fn text(&mut self, piece: &str) {
        self.0 += piece.len();
    }
    fn error(&mut self, _: polepair_core::error::WireError) {
        self.0 += 1;
    }
}

#[test]
fn deframers_survive_and_go_on() {
    for (protocol, dissector, profile) in pairs() {
        let good = requests(&protocol, profile);
        let answers = replies(&protocol, profile, &good);
        for (direction, frames_of) in [(Direction::ToDrive, &good), (Direction::ToHost, &answers)] {
            let (mut random, mut passed) = (Random::new(1), Passed::default());
            let good = whole(dissector, frames_of, direction);
            for _ in 0..frames() {
                let (kind, bytes) = harm(&mut random, frames_of);
                let mut at = 0;
                let mut through = false;
                while at < bytes.len() {
                    let rest = &bytes[at..];
                    let context = Context {
                        direction: Some(direction),
                        profile: Some(profile),
                        ..Context::default()
                    };
                    dissector.explain(rest, &context, &mut Count(0));
                    at += match dissector.find_frame(rest, Some(direction), true) {
                        FrameBoundary::Frame(n) => {
                            // Single bytes, such as acks, have no check that could fail.
                            through |= n > 1 && !good.contains(&rest[..n]);
                            assert!((1..=rest.len()).contains(&n), "a frame of {n} bytes");
                            n
                        }
                        FrameBoundary::Corrupt(n) | FrameBoundary::Skip(n) => {
                            assert!((1..=rest.len()).contains(&n), "{n} bytes of {}", rest.len());
                            n
                        }
                        FrameBoundary::Incomplete => break,
                    };
                }
                passed.note(kind, through);
            }
            passed.print(&format!("{} {} {direction:?}", protocol.name, profile.name));
        }
    }
}

#[test]
fn a_drive_obeys_no_frame_whose_check_fails() {
    for (protocol, dissector, profile) in pairs() {
        let frames_of = requests(&protocol, profile);
        let (mut random, mut passed) = (Random::new(2), Passed::default());
        let mut subject = drive(&protocol, profile);
        let (mut before, mut history) = (subject.truth(), Vec::new());
        for _ in 0..frames() {
            let (kind, bytes) = harm(&mut random, &frames_of);
            subject.said.clear();
            subject.receive(&bytes);
            history.extend_from_slice(&bytes);
            subject.rest(REST_MS);
            let after = subject.truth();
            let acted = after.enabled != before.enabled
                || after.unrepeatable != before.unrepeatable
                || (after.position - before.position).abs() > STILL;
            passed.note(kind, acted);
            if acted {
                let excuse = passing(dissector, &history, Direction::ToDrive);
                assert!(excuse.is_some(), "{} obeyed {kind:?} {bytes:02X?}", profile.name);
            }
            // A frame that passed may have changed anything: begin anew.
            if acted
                || (!subject.said.is_empty()
                    && passing(dissector, &bytes, Direction::ToDrive).is_some())
            {
                subject = drive(&protocol, profile);
                before = subject.truth();
                history.clear();
            }
            let old = history.len().saturating_sub(2 * STREAM_UNIT_MAX);
            history.drain(..old);
        }
        passed.print(&format!("{} {} obeyed", protocol.name, profile.name));
    }
}

#[test]
fn every_request_ends_and_believes_no_broken_reply() {
    for (protocol, dissector, profile) in pairs() {
        let readable = readable(profile);
        let frames_of = replies(&protocol, profile, &requests(&protocol, profile));
        let good = whole(dissector, &frames_of, Direction::ToHost);
        let (mut random, mut passed) = (Random::new(3), Passed::default());
        // Each frame needs a host of its own, which takes ten times as long as a drive that goes on.
        for _ in 0..frames() / 5 {
            let id = readable[random.below(readable.len().min(20) as u64) as usize];
            let mut host = begin_read(&protocol, profile, id);
            let (kind, bytes) = harm(&mut random, &frames_of);
            if bytes.is_empty() {
                continue;
            }
            if random.chance(Ppm(500_000)) {
                host.receive(&bytes);
            } else {
                bytes.chunks(1 + random.below(4) as usize).for_each(|piece| host.receive(piece));
            }
            let end = host.now.plus_ms(PATIENCE_MS);
            let outcome = loop {
                let outcome = host.node.axes().and_then(|axes| axes.poll_outcome());
                assert!(host.now < end, "a read never ended after {kind:?} {bytes:02X?}");
                match outcome {
                    Some((_, outcome)) => break outcome,
                    None => host.tick(end),
                }
            };
            let believed = matches!(outcome, Outcome::Done(_));
            let excuse = passing(dissector, &bytes, Direction::ToHost);
            let harmed = excuse.is_some_and(|frame| !good.contains(frame));
            passed.note(kind, believed && harmed);
            assert!(
                !believed || excuse.is_some(),
                "{} believed {kind:?} {bytes:02X?}",
                protocol.name
            );
        }
        passed.print(&format!("{} {} believed", protocol.name, profile.name));
    }
}

#[test]
fn can_frames_say_what_they_are_or_what_is_wrong() {
    let mut random = Random::new(4);
    for dissector in proto::dissectors() {
        for _ in 0..frames() {
            let extended = random.chance(Ppm(500_000));
            let id = random.below(if extended { 1 << 29 } else { 1 << 11 }) as u32;
            let bytes: Vec<u8> = (0..random.below(9)).map(|_| random.next_byte()).collect();
            let context = Context { id: Some(id), extended, ..Context::default() };
            let mut count = Count(0);
            dissector.explain(&bytes, &context, &mut count);
            assert!(count.0 > 0, "{}: {id:X}#{bytes:02X?} says nothing", dissector.name());
        }
    }
}
