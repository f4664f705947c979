//! Set-up, relay axis and addresses as the manual describes them, observed on the wire.

use polepair_core::error::Outcome;
use polepair_core::medium::Frame;
use polepair_core::proto::GROUP;
use polepair_core::proto::tml::tmlcan;
use polepair_drives::surroundings::Act;
use polepair_sim::world::ReceptionData;

use super::{Bench, done};

impl Bench {
    fn read_time_us(&mut self, axis: u8) -> u64 {
        let begin = self.world.now();
        assert!(done(self.read(axis, "KPP")));
        (self.world.now().0 - begin.0) / 1000
    }

    /// The frames on CAN since this was last called.
    fn can_frames(&mut self) -> Vec<Frame> {
        let frame = |data| match data {
            ReceptionData::Frame(frame, ..) => Some(frame),
            ReceptionData::Bytes(..) => None,
        };
        self.world.take_log().into_iter().filter_map(|one| frame(one.data)).collect()
    }
}

/// Chapter 2: settings of RAM are lost with the power; those of the set-up table come back.
#[test]
fn settings_survive_a_power_cycle_only_if_saved() {
    for rs485 in [false, true] {
        let mut bench = Bench::serial(rs485);
        for (value, saves, after) in [(400, false, 288), (401, true, 401), (402, false, 401)] {
            assert_eq!(bench.write(0, "KPP", value), Outcome::Done(value));
            if saves {
                assert!(done(bench.raw(0, "SAVE")));
                bench.pass(500);
            }
            bench.act(Act::PowerCycle);
            assert_eq!(bench.read(0, "KPP"), Outcome::Done(after), "{rs485} {value}");
        }
    }
}

/// Chapter 1: what is for others goes out on CAN, and the answer comes back the same way. The frames on
/// CAN take their time while the relay's acknowledgement goes out: at 9600 baud nothing is left to see,
/// at 115200 baud what exceeds one character.
#[test]
fn a_relay_costs_the_time_of_its_frames() {
    for (baud, least_us, most_us) in [(9600, 0, 0), (115_200, 150, 700)] {
        let mut bench = Bench::relay_at(baud, "tmlcan", &[255, 1]);
        bench.read_time_us(0);
        let (direct, behind) = (bench.read_time_us(0), bench.read_time_us(1));
        let cost = behind - direct;
        assert!((least_us..=most_us).contains(&cost), "{baud}: {direct}, {behind} µs");
    }
}

/// Chapters 2 and 4: a group is asked with host bit 0; each of its drives answers to the axis ID of the
/// relay with host bit 1, so that the relay passes the answer on and does not execute it.
#[test]
fn answers_of_a_group_behind_a_relay_carry_the_host_bit() {
    let mut bench = Bench::relay("tmlcan", &[255, 1, 2, GROUP | 1]);
    bench.world.enable_log();
    assert_eq!(bench.read(3, "POSERR"), Outcome::Done(0));
    assert_eq!(bench.parts.iter().map(|part| part.0).collect::<Vec<_>>(), [1, 2, 255]);
    let mut codes: Vec<_> = bench
        .can_frames()
        .iter()
        .map(|frame| tmlcan::decode(frame).expect("TMLCAN"))
        .map(|message| (message.to.group, message.to.id, message.to.host))
        .collect();
    codes.dedup();
    codes.sort_unstable();
    codes.dedup();
    assert_eq!(codes, [(false, 255, true), (true, 1, false)]);
}
