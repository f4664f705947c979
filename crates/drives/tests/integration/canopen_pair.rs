//! Our CANopen host and a simulated drive on one wire that loses, repeats and holds back frames:
//! every request ends once, and one that ends as done was done.

use std::collections::VecDeque;

use polepair_core::error::Failure;
use polepair_core::medium::{Can, Frame};
use polepair_core::proto::HostOptions;
use polepair_core::proto::canopen::sdo::ObjectIndex;
use polepair_core::proto::canopen::{Answer, CanHost, HostRequest};
use polepair_core::station::{
    EventSubject, Host as _, HostData, RequestClass, Station, Ticket, Timed,
};
use polepair_core::time::{Instant, earliest};
use polepair_drives::{DeviceOptions, Family, cia402};

const NODE: u8 = 2;
/// Time that a frame takes, ns.
const FRAME_NS: u64 = 250_000;
/// Steps of the wire that one request may take.
const STEPS_MAX: usize = 200_000;

/// Number of frames in a thousand that are lost, repeated, and delayed.
#[derive(Clone, Copy)]
struct Faults {
    lost: u32,
    copied: u32,
    held: u32,
}

const NONE: Faults = Faults { lost: 0, copied: 0, held: 0 };

struct Wire {
    host: CanHost,
    drive: cia402::device::Device,
    /// Frames on their way, with when they arrive and whether to the drive.
    flying: VecDeque<(Instant, bool, Frame)>,
    /// When the last frame arrives, each way.
    last: [Instant; 2],
    now: Instant,
    faults: Faults,
    random: u64,
}

impl Wire {
    fn new(faults: Faults, seed: u64) -> Self {
        let options = DeviceOptions {
            address: Some(NODE.into()),
            wires: &["canopen"],
            standard: None,
            untimed: false,
            seed,
            extra: &[],
        };
        let profile = cia402::Cia402::profiles()[0];
        let drive = cia402::Cia402::create_device(profile, &options).expect("a drive");
        let host = CanHost::new(&HostOptions::new(0));
        let random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let last = [Instant::ZERO; 2];
        Self { host, drive, flying: VecDeque::new(), last, now: Instant::ZERO, faults, random }
    }

    /// Returns true this many times of a thousand.
    fn chance(&mut self, of_thousand: u32) -> bool {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 33) % 1000 < u64::from(of_thousand)
    }

    fn fly(&mut self, to_drive: bool, frame: Frame) {
        let Faults { lost, copied, held } = self.faults;
        if self.chance(lost) {
            return;
        }
        let held = if self.chance(held) { 300_000_000 } else { 0 };
        // A delayed frame delays those behind it: a bus keeps the order.
        let behind = self.last[usize::from(to_drive)];
        let mut at = self.now.max(behind).plus_ns(FRAME_NS + held);
        self.flying.push_back((at, to_drive, frame));
        if self.chance(copied) {
            at = at.plus_ns(FRAME_NS);
            self.flying.push_back((at, to_drive, frame));
        }
        self.last[usize::from(to_drive)] = at;
    }

    /// Lets both ends send their frames, and time go on to the next event.
    fn step(&mut self) {
        let mut frame = Frame::default();
        while Station::<Can>::poll_transmit(&mut self.host, self.now, &mut frame).is_some() {
            self.fly(true, frame);
        }
        while Station::<Can>::poll_transmit(&mut self.drive, self.now, &mut frame).is_some() {
            self.fly(false, frame);
        }
        let due = self.flying.iter().map(|(at, ..)| *at).min();
        let next = earliest(due, earliest(self.host.poll_timeout(), self.drive.poll_timeout()));
        self.now = self.now.max(next.unwrap_or(self.now)).plus_ns(1);
        while let Some(at) = self.flying.iter().position(|(at, ..)| *at <= self.now) {
            let Some((_, to_drive, frame)) = self.flying.remove(at) else { break };
            if to_drive {
                self.drive.handle_input(self.now, &frame)
            } else {
                self.host.handle_input(self.now, &frame)
            }
        }
        self.host.handle_timeout(self.now);
        self.drive.handle_timeout(self.now);
    }

    /// Asks, gives `bytes` as they are wanted, and takes what comes.
    fn run_request(
        &mut self,
        n: u32,
        host_request: HostRequest,
        bytes: &[u8],
    ) -> (Result<Answer, Failure>, Vec<u8>) {
        let ticket = Ticket(n);
        self.host.submit(self.now, ticket, host_request).expect("nothing else is under way");
        let (mut given, mut consumed, mut buffer) = (0, Vec::new(), [0; 100]);
        for _ in 0..STEPS_MAX {
            self.step();
            if matches!(host_request, HostRequest::Download { .. }) {
                given += self.host.feed_bytes(ticket, &bytes[given..]).unwrap_or(0);
            } else if let Some(count) = self.host.poll_bytes(ticket, &mut buffer) {
                consumed.extend_from_slice(&buffer[..count]);
            }
            while let Some(&(to, result)) = self.host.poll_event() {
                if let EventSubject::Request(ended) = to {
                    assert_eq!(ended, ticket, "of a request that ended before");
                    return (result, consumed);
                }
            }
        }
        panic!("{host_request:?} does not end");
    }
}

const NAME: ObjectIndex = ObjectIndex::new(0x1008, 0);
const TARGET: ObjectIndex = ObjectIndex::new(0x607A, 0);
/// The drive keeps what is written there, up to 1024 bytes.
const FILE: ObjectIndex = ObjectIndex::new(0x2F00, 0);

fn write(bits: u64) -> HostRequest {
    HostRequest::Write { node: NODE, object: TARGET, bits, len: 4, class: RequestClass::ReadBack }
}

#[test]
fn a_string_is_the_same_in_segments_and_in_blocks() {
    let mut wire = Wire::new(NONE, 1);
    let upload = |block| HostRequest::Upload { node: NODE, object: NAME, block, max: 0 };
    let (result, segments) = wire.run_request(1, upload(false), &[]);
    assert_eq!(result, Ok(Answer::Transferred(segments.len() as u32)));
    assert!(segments.len() > 4, "{segments:?}");
    let (result, blocks) = wire.run_request(2, upload(true), &[]);
    assert_eq!((result.is_ok(), blocks), (true, segments));
}

#[test]
fn files_go_there_and_back_whatever_their_size() {
    let mut wire = Wire::new(NONE, 1);
    for (n, size) in [1, 7, 8, 888, 889, 890, 1024].into_iter().enumerate() {
        let file: Vec<u8> = (0..size).map(|at| (at * 7 + n) as u8).collect();
        for block in [false, true] {
            let size = file.len() as u32;
            let down = HostRequest::Download { node: NODE, object: FILE, block, size };
            let (result, _) = wire.run_request(1, down, &file);
            assert_eq!(result, Ok(Answer::Transferred(size)), "{size} {block}");
            for back in [false, true] {
                let up = HostRequest::Upload { node: NODE, object: FILE, block: back, max: 0 };
                let (result, consumed) = wire.run_request(2, up, &[]);
                assert_eq!(result, Ok(Answer::Transferred(size)), "{size} {block} {back}");
                assert!(consumed == file, "{size} {block} {back}");
            }
        }
    }
}

#[test]
fn on_a_bad_wire_every_request_ends_and_what_is_done_is_done() {
    let (mut done, mut failed) = (0, 0);
    for seed in 1..=60 {
        let faults = Faults { lost: 30, copied: 30, held: 10 };
        let mut wire = Wire::new(faults, seed);
        for n in 0..40 {
            let value = u64::from(n) * 1000 + seed;
            let (written, _) = wire.run_request(n, write(value), &[]);
            let (read, _) =
                wire.run_request(1000 + n, HostRequest::Read { node: NODE, object: TARGET }, &[]);
            match (written, read) {
                (Ok(_), Ok(Answer::Value { bits, .. })) => {
                    assert_eq!(bits, value, "seed {seed}, write {n}");
                    done += 1;
                }
                _ => failed += 1,
            }
        }
    }
    assert!(done > 1000 && failed > 10, "{done} done, {failed} failed");
}

#[test]
fn on_a_bad_wire_no_file_is_taken_for_another() {
    let (mut done, mut failed) = (0, 0);
    for seed in 1..=40 {
        let mut wire = Wire::new(Faults { lost: 3, copied: 0, held: 0 }, seed);
        let file: Vec<u8> = (0..500).map(|at| (at * seed) as u8).collect();
        for (n, block) in [(0, false), (10, true)] {
            let size = file.len() as u32;
            let down = HostRequest::Download { node: NODE, object: FILE, block, size };
            let (sent, _) = wire.run_request(n, down, &file);
            let up = HostRequest::Upload { node: NODE, object: FILE, block, max: 0 };
            let (came, consumed) = wire.run_request(n + 1, up, &[]);
            match (sent, came) {
                (Ok(_), Ok(_)) => {
                    assert!(consumed == file, "seed {seed}");
                    done += 1;
                }
                _ => failed += 1,
            }
        }
    }
    assert!(done > 10 && failed > 10, "{done} done, {failed} failed");
}
