//! Speed of a CAN bus of drives that follow paths: 31 axes on TechnoCAN at 1 Mbit/s, each with
//! a PVT point every 10 ms.
//!
//! `cargo run --release -p polepair-sim --example paths [SECONDS]`

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::proto::tml::online::{OnlineMessage, PvtPoint};
use polepair_core::proto::tml::technocan;
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::Instant;
use polepair_sim::node::CanStationNode;
use polepair_sim::rack::RackDrive;
use polepair_sim::world::World;

const AXES: u8 = 31;
const PERIOD_MS: u32 = 10;
/// Points that are in a drive's buffer before its path begins.
const AHEAD: u32 = 5;
/// Counts from point to point.
const STEP: i32 = 50;

fn main() {
    let seconds: u32 = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(20);
    let mut world = World::new(1);
    let bus = world.add_can(CanLine { bit_rate: 1_000_000 });
    let Some(profile) = polepair_drives::profiles().iter().find(|p| p.name == "technosoft-f514l")
    else {
        return;
    };
    let drives: Vec<_> = (1..=AXES)
        .filter_map(|axis| {
            let mut spec = RackDrive::new(profile, "technocan");
            spec.address = Some(axis.into());
            spec.build(&mut world, bus, false).ok()
        })
        .collect();
    let host = world.add_node(Box::new(CanStationNode(Streamer::default())));
    world.plug_host(bus, host, 0);
    world.run_until(Instant::ZERO.plus_ms(100));
    let (events, started_at) = (world.events(), std::time::Instant::now());
    let begin = world.now();
    let ms = u64::from(seconds) * 1000;
    world.run_until(begin.plus_ms(seconds * 1000));
    let took = started_at.elapsed().as_secs_f64();
    println!(
        "{} axes, {seconds} s in {took:.3} s: {:.0} x real time, {:.1} M events/s",
        drives.len(),
        ms as f64 / 1e3 / took,
        (world.events() - events) as f64 / took / 1e6,
    );
    let expected = f64::from(STEP) / f64::from(PERIOD_MS) * ms as f64 / 2000.0;
    for &drive in &drives {
        let turns = world.with_node(drive, |node, now| {
            node.surroundings()
                .map(|bench| bench.ground_truth(now).position / core::f64::consts::TAU)
        });
        assert!(turns.is_some_and(|t| (t - expected).abs() < 2.0), "{turns:?} for {expected}");
    }
}

/// Sends what starts the drives, then a point to each every 10 ms.
#[derive(Default)]
struct Streamer {
    sent: u32,
    axis: u8,
    due: Instant,
    now: Instant,
}

impl Streamer {
    /// Instructions that every drive gets before its points.
    const SET_UP: [Instruction; 5] = [
        Instruction::of(0x0020, []),               // ENDINIT
        Instruction::of(0x0102, []),               // AXISON
        Instruction::of(0x5909, [0xFFC1, 0x8709]), // MODE PVT
        Instruction::of(0x5909, [0xDFFF, 0x4000]), // CPR and TUM1
        Instruction::of(0x1880, [0x8000]),         // SETPVT: an empty buffer
    ];

    fn next(&mut self) -> Message {
        let round = self.sent as usize;
        let to = IdCode::axis(self.axis + 1);
        let instruction = match round.checked_sub(Self::SET_UP.len()) {
            None => Self::SET_UP[round],
            Some(n) if n == AHEAD as usize => Instruction::of(0x0108, []), // UPD
            Some(n) => {
                let n = if n > AHEAD as usize { n - 1 } else { n };
                let counter = (n & 0x7F) as u8;
                let velocity = STEP * 65_536 / PERIOD_MS as i32;
                let time = PERIOD_MS as u16;
                OnlineMessage::Pvt(PvtPoint { position: STEP, velocity, time, counter }).emit()
            }
        };
        self.axis += 1;
        if self.axis == AXES {
            (self.axis, self.sent) = (0, self.sent + 1);
            let first = Self::SET_UP.len() as u32 + AHEAD;
            match self.sent {
                n if n <= first => {}
                n if n == first + 1 => self.due = self.now.plus_ms(PERIOD_MS),
                _ => self.due = self.due.plus_ms(PERIOD_MS),
            }
        }
        Message { to, instruction }
    }
}

impl Timed for Streamer {
    fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
    }

    fn poll_timeout(&self) -> Option<Instant> {
        (self.due > self.now).then_some(self.due)
    }
}

impl Station<Can> for Streamer {
    fn handle_input(&mut self, _: Instant, _: &Frame) {}

    fn handle_line(&mut self, _: Instant, _: LineEvent) {}

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        self.now = now;
        if now < self.due {
            return None;
        }
        *out = technocan::encode(&self.next()).ok()?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: 1_000_000 }
    }
}
