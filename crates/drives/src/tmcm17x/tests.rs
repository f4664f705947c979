extern crate std;

use super::device::{Device, Tmcm17x};
use super::{flags, profile};
use crate::surroundings::{Act, SurroundingsControl};
use crate::{DeviceOptions, Family};
use polepair_core::medium::{Can, Frame, SerialLine, Stream};
use polepair_core::profile::{Access, Profile};
use polepair_core::proto::tmcl::{Opcode, Reply, Request};
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;
use std::vec::Vec;

/// A module on a wire without timing, and a clock.
struct Rig {
    device: Device,
    now: Instant,
}

fn options<'a>(extra: &'a [(&'a str, &'a str)]) -> DeviceOptions<'a> {
    DeviceOptions { address: None, wires: &["tmcl"], standard: None, untimed: true, seed: 1, extra }
}

impl Rig {
    fn of(profile: &'static Profile) -> Self {
        Self { device: Tmcm17x::create_device(profile, &options(&[])).unwrap(), now: Instant::ZERO }
    }

    fn new() -> Self {
        Self::of(&profile::TMCM_171)
    }

    fn bytes(&mut self, bytes: &[u8]) -> Vec<u8> {
        Station::<Stream>::handle_input(&mut self.device, self.now, bytes);
        self.sent()
    }

    fn sent(&mut self) -> Vec<u8> {
        let (mut all, mut out) = (Vec::new(), [0; 520]);
        while let Some(n) = Station::<Stream>::poll_transmit(&mut self.device, self.now, &mut out) {
            all.extend_from_slice(&out[..n]);
        }
        all
    }

    fn send_request(&mut self, opcode: u8, kind: u8, motor: u8, value: i32) -> Option<Reply> {
        let request = Request { address: 1, opcode: Opcode::from(opcode), kind, motor, value };
        Reply::parse(&self.bytes(&request.emit())).ok()
    }

    /// Status and value.
    fn say(&mut self, opcode: u8, kind: u8, motor: u8, value: i32) -> (u8, i32) {
        let reply = self.send_request(opcode, kind, motor, value).expect("a reply");
        assert_eq!(reply.opcode.number(), opcode);
        (reply.status.number(), reply.value)
    }

    fn ok(&mut self, opcode: u8, kind: u8, value: i32) -> i32 {
        let (status, answer) = self.say(opcode, kind, 0, value);
        assert_eq!(status, 100, "{opcode} {kind} {value}");
        answer
    }

    fn sap(&mut self, number: u8, value: i32) {
        self.ok(5, number, value);
    }

    fn gap(&mut self, number: u8) -> i32 {
        self.ok(6, number, 0)
    }

    fn flags(&mut self) -> u32 {
        self.gap(156) as u32
    }

    fn wait(&mut self, ms: u32) {
        self.now = self.now.plus_ms(ms);
        self.device.handle_timeout(self.now);
    }

    fn act(&mut self, act: Act) {
        assert!(self.device.act(self.now, act), "{act:?}");
    }
}

#[test]
fn the_printed_frames_do_what_is_printed() {
    let mut rig = Rig::new();
    let reply = rig.bytes(&[1, 1, 0, 0, 0, 0, 1, 0x5E, 0x61]);
    assert_eq!(reply, [2, 1, 100, 1, 0, 0, 1, 0x5E, 0xC7]);
    rig.wait(2000);
    assert_eq!(rig.gap(3), 350);
    rig.ok(3, 0, 0);
    rig.wait(1000);
    rig.sap(1, 711);
    let reply = rig.bytes(&[1, 6, 1, 0, 0, 0, 0, 0, 8]);
    assert_eq!(reply, [2, 1, 0x64, 6, 0, 0, 2, 0xC7, 0x36]);
}

#[test]
fn every_refusal_has_its_status() {
    let mut rig = Rig::new();
    assert_eq!(rig.bytes(&[1, 6, 1, 0, 0, 0, 0, 0, 9])[2], 1);
    for (request, status) in [
        ((99, 0, 0, 0), 2),
        ((13, 0, 0, 0), 2),
        ((4, 2, 0, 0), 3),
        ((4, 7, 0, 0), 3),
        ((6, 99, 0, 0), 3),
        ((5, 3, 0, 1), 3),
        ((6, 160, 0, 0), 3),
        ((7, 3, 0, 0), 3),
        ((5, 4, 0, 0), 4),
        ((5, 253, 0, 255), 4),
        ((6, 1, 1, 0), 4),
        ((1, 0, 0, 100_001), 4),
        ((2, 0, 0, i32::MIN), 4),
        ((9, 66, 1, 1), 4),
        ((10, 99, 0, 0), 3),
        ((9, 73, 0, 5), 4),
        ((137, 0, 0, 1), 4),
        ((255, 0, 0, 1), 4),
        ((14, 2, 2, 1), 3),
        ((14, 0, 2, 2), 4),
        ((21, 0, 0, 1), 6),
        ((132, 0, 0, 2048), 4),
        ((136, 2, 0, 0), 3),
    ] {
        let (opcode, kind, motor, value) = request;
        assert_eq!(rig.say(opcode, kind, motor, value).0, status, "{request:?}");
    }
    assert_eq!(rig.gap(3), 0);
    assert!(!rig.device.ground_truth(rig.now).enabled, "nothing of this powered the motor");
}

#[test]
fn the_170_has_no_programs_and_no_step_input() {
    let mut rig = Rig::of(&profile::TMCM_170);
    assert_eq!(rig.bytes(&[1, 136, 0, 0, 0, 0, 0, 0, 137]), b"\x02170V1.14");
    assert_eq!(rig.ok(136, 1, 0), 170 << 16 | 1 << 8 | 14);
    for opcode in [128, 129, 132, 133, 134, 135, 19, 27] {
        assert_eq!(rig.say(opcode, 0, 0, 0).0, 2, "{opcode}");
    }
    assert_eq!(rig.say(5, 128, 0, 3).0, 4);
    assert!(!rig.device.act(rig.now, Act::Input(6, true)));
    let mut rig = Rig::new();
    assert_eq!(rig.bytes(&[1, 136, 0, 0, 0, 0, 0, 0, 137]), b"\x02171V1.14");
    rig.sap(128, 3);
    rig.sap(157, 100);
    for _ in 0..5 {
        rig.act(Act::Input(6, true));
        rig.act(Act::Input(6, false));
    }
    rig.wait(1000);
    assert_eq!(rig.gap(0), 500);
    assert!((rig.gap(1) - 500).abs() <= 10);
}

#[test]
fn every_parameter_takes_its_extremes_and_nothing_beyond() {
    for profile in Tmcm17x::profiles() {
        let mut rig = Rig::of(profile);
        for p in profile.parameters.iter().filter(|p| p.space == 0) {
            let number = p.index as u8;
            if p.access == Access::Read {
                assert_eq!(rig.say(5, number, 0, 0).0, 3, "{}", p.name);
                rig.gap(number);
                continue;
            }
            for value in [p.min, p.max] {
                let value = value as i32;
                rig.sap(number, value);
                // Readings that follow the motor are not what was just written.
                if p.access == Access::ReadWrite && number != 1 {
                    assert_eq!(rig.gap(number), value, "{} {value}", p.name);
                }
            }
            for beyond in [p.min - 1, p.max + 1] {
                if let Ok(beyond) = i32::try_from(beyond) {
                    assert_eq!(rig.say(5, number, 0, beyond).0, 4, "{} {beyond}", p.name);
                }
            }
            if let Some(default) = p.default {
                rig.sap(number, default as i32);
            }
        }
        rig.wait(2000);
        assert!(rig.device.ground_truth(rig.now).position.is_finite());
    }
}

#[test]
fn it_moves_both_ways_and_says_when_it_is_there() {
    let mut rig = Rig::new();
    assert_eq!(rig.ok(4, 0, 8192), 8192);
    assert_eq!(rig.flags() & (flags::POSMOD | flags::POS_END | flags::HALTED), flags::POSMOD);
    rig.wait(3000);
    assert!((rig.gap(1) - 8192).abs() <= 10);
    assert_ne!(rig.flags() & flags::POS_END, 0);
    let from = rig.gap(1);
    assert_eq!(rig.ok(4, 1, -12288), from - 12288);
    assert_eq!(rig.flags() & flags::POS_END, 0, "a new move clears it");
    rig.wait(3000);
    assert!((rig.gap(1) - (from - 12288)).abs() <= 10);
    assert_eq!(rig.device.ground_truth(rig.now).unrepeatable, 1);
    rig.sap(1, 0);
    assert_eq!(rig.flags() & flags::POS_END, 0, "so does a new actual position, until it is seen");
    rig.wait(100);
    assert!(rig.gap(1).abs() <= 2 && rig.gap(3) == 0, "it did not move");
}

#[test]
fn enabling_never_jumps_and_disabling_frees_the_shaft() {
    let mut rig = Rig::new();
    assert_ne!(rig.flags() & flags::HALTED, 0);
    rig.act(Act::Load(0.1));
    rig.wait(300);
    assert!(rig.device.ground_truth(rig.now).velocity > 1.0, "off, it gives way");
    rig.act(Act::Load(0.0));
    rig.wait(5000);
    let at = rig.device.ground_truth(rig.now).position;
    rig.sap(255, 1);
    rig.wait(1000);
    assert!((rig.device.ground_truth(rig.now).position - at).abs() < 0.01);
    assert_eq!(rig.flags() & flags::HALTED, 0);
    rig.ok(1, 0, 1000);
    rig.wait(1500);
    rig.sap(255, 0);
    let truth = rig.device.ground_truth(rig.now);
    assert!(!truth.enabled && truth.velocity > 50.0);
    rig.wait(1);
    assert_eq!(rig.device.ground_truth(rig.now).current, 0.0);
    assert_eq!(rig.say(1, 0, 0, 1000).0, 6, "switched off, it refuses to turn");
    assert_eq!(rig.say(4, 1, 0, 1000).0, 6);
}

#[test]
fn voltage_trips_with_hysteresis() {
    let mut rig = Rig::new();
    rig.ok(1, 0, 500);
    rig.wait(1000);
    for (volts, flag, on) in [
        (10.5, flags::UNDERVOLT, false),
        (9.5, flags::UNDERVOLT, true),
        (11.5, flags::UNDERVOLT, true),
        (12.5, flags::UNDERVOLT, false),
        (54.9, flags::OVERVOLT, false),
        (56.0, flags::OVERVOLT, true),
        (54.5, flags::OVERVOLT, true),
        (53.0, flags::OVERVOLT, false),
    ] {
        rig.act(Act::Supply(volts));
        rig.wait(5);
        assert_eq!(rig.flags() & flag != 0, on, "{volts} V");
        assert_eq!(rig.gap(151), (volts * 10.0) as i32);
    }
    assert!(!rig.device.ground_truth(rig.now).enabled, "it stays off until told");
    rig.act(Act::Supply(9.5));
    rig.wait(5);
    assert_eq!(rig.say(1, 0, 0, 500).0, 6);
    rig.act(Act::Supply(6.0));
    assert_eq!(rig.send_request(6, 1, 0, 0), None, "the logic is dead");
    rig.act(Act::Supply(24.0));
    rig.ok(1, 0, 500);
    rig.sap(245, 0);
    rig.act(Act::Supply(56.0));
    rig.wait(5);
    assert_eq!(rig.flags() & flags::OVERVOLT, 0, "protection can be switched off");
}

#[test]
fn heat_warns_then_trips_then_lets_go() {
    let mut rig = Rig::new();
    rig.ok(1, 0, 200);
    rig.act(Act::Ambient(90.0));
    rig.wait(400_000);
    assert_eq!(rig.flags() & (flags::TEMPWARN | flags::OVERTEMP), flags::TEMPWARN);
    assert_eq!(rig.gap(3), 200);
    rig.act(Act::Ambient(125.0));
    rig.wait(400_000);
    assert_ne!(rig.flags() & flags::OVERTEMP, 0);
    assert!(!rig.device.ground_truth(rig.now).enabled);
    rig.act(Act::Ambient(110.0));
    rig.wait(600_000);
    assert_ne!(rig.flags() & flags::OVERTEMP, 0, "105 °C is where it ends");
    rig.act(Act::Ambient(25.0));
    rig.wait(400_000);
    assert_eq!(rig.flags() & (flags::TEMPWARN | flags::OVERTEMP), 0);
}

#[test]
fn hall_and_encoder_errors_clear_by_reading() {
    let mut rig = Rig::new();
    rig.ok(1, 0, 500);
    rig.wait(1000);
    rig.act(Act::HallBroken(true));
    rig.wait(5);
    assert!(!rig.device.ground_truth(rig.now).enabled);
    rig.act(Act::HallBroken(false));
    assert_ne!(rig.flags() & flags::HALLERR, 0);
    assert_eq!(rig.flags() & flags::HALLERR, 0);
    rig.ok(1, 0, 500);
    rig.wait(1000);
    rig.act(Act::EncoderBroken(true));
    rig.wait(1000);
    assert_eq!(rig.device.ground_truth(rig.now).fault, flags::ENCERR);
    rig.act(Act::EncoderBroken(false));
    assert_ne!(rig.flags() & flags::ENCERR, 0);
    assert_eq!(rig.flags() & flags::ENCERR, 0);
}

#[test]
fn a_stalled_motor_trips() {
    let mut rig = Rig::new();
    rig.ok(1, 0, 500);
    rig.wait(1000);
    rig.act(Act::Jam(true));
    rig.wait(500);
    assert!((rig.gap(150) - 10_000).abs() < 500, "at its current limit");
    rig.wait(2500);
    assert!(!rig.device.ground_truth(rig.now).enabled);
    assert_eq!(rig.device.take_notice(), Some("stalled: motor off"));
    assert_ne!(rig.flags() & flags::HALTED, 0);
}

#[test]
fn the_stop_switch_stops_and_zeroes() {
    let mut rig = Rig::new();
    rig.act(Act::Switch { which: 0, at: 20.0 });
    rig.sap(164, 1);
    rig.sap(162, 1);
    rig.sap(163, 1);
    rig.ok(1, 0, 100);
    rig.wait(4000);
    assert_ne!(rig.flags() & flags::STOPSWITCH, 0);
    assert_eq!(rig.gap(3), 0);
    assert_eq!(rig.gap(162), 0, "only once");
    let truth = rig.device.ground_truth(rig.now);
    assert!(truth.position > 20.0 && truth.position < 21.0, "{truth:?}");
    let counts = (truth.position - 20.0) / core::f64::consts::TAU * 4096.0;
    assert!((f64::from(rig.gap(1)) - counts).abs() < 12.0);
    rig.ok(1, 0, -100);
    rig.wait(1000);
    assert_eq!(rig.flags() & flags::STOPSWITCH, 0, "it can leave the switch");
    rig.ok(3, 0, 0);
    assert_ne!(rig.flags() & flags::STOPSWITCH, 0, "a stop command shows too");
    rig.sap(164, 0);
    rig.ok(1, 0, 100);
    rig.wait(4000);
    assert_eq!(rig.gap(3), 100, "not watched, it does not stop");
    rig.sap(164, 1);
    rig.sap(166, 1);
    rig.wait(1000);
    assert_eq!(rig.gap(3), 100, "the other polarity: closed is fine");
}

#[test]
fn settings_are_stored_restored_locked_and_lost() {
    let mut rig = Rig::new();
    rig.sap(4, 1234);
    rig.ok(7, 4, 0);
    rig.sap(4, 999);
    assert_eq!(rig.ok(8, 4, 0), 1234);
    rig.sap(4, 777);
    assert_eq!(rig.say(9, 73, 0, 1234), (100, 1234));
    assert_eq!(rig.say(10, 73, 0, 0), (100, 1));
    for (opcode, kind, bank) in [(7, 4, 0), (9, 75, 0), (11, 3, 2), (137, 0, 0)] {
        assert_eq!(rig.say(opcode, kind, bank, if opcode == 137 { 1234 } else { 1 }).0, 5);
    }
    rig.act(Act::PowerCycle);
    assert_eq!(rig.gap(4), 1234);
    assert_eq!(rig.say(10, 73, 0, 0), (100, 1), "the lock is kept");
    rig.say(9, 73, 0, 4321);
    assert_eq!(rig.say(9, 5, 2, -77), (100, -77));
    rig.act(Act::PowerCycle);
    assert_eq!(rig.say(10, 5, 2, 0), (100, 0), "a variable is in RAM");
    rig.say(9, 5, 2, -77);
    rig.say(11, 5, 2, 0);
    rig.act(Act::PowerCycle);
    assert_eq!(rig.say(10, 5, 2, 0), (100, -77));
    rig.say(9, 64, 0, 1);
    rig.act(Act::PowerCycle);
    assert_eq!(rig.gap(4), 3000, "without its magic the EEPROM starts anew");
    assert!(rig.device.ground_truth(rig.now).flash_writes > 5);
}

#[test]
fn factory_settings_silence_it_for_five_seconds() {
    let mut rig = Rig::new();
    rig.sap(4, 1234);
    rig.ok(7, 4, 0);
    assert_eq!(rig.say(137, 0, 0, 1234), (100, 1234));
    rig.wait(4990);
    assert_eq!(rig.send_request(6, 4, 0, 0), None);
    rig.wait(20);
    assert_eq!(rig.gap(4), 3000);
}

#[test]
fn address_host_and_baud_change_after_the_reply() {
    let mut rig = Rig::new();
    let reply = rig.send_request(9, 66, 0, 7).unwrap();
    assert_eq!(reply.module, 1);
    assert_eq!(rig.send_request(6, 1, 0, 0), None);
    let to = |address: u8, opcode: u8, kind, value| {
        Request { address, opcode: Opcode::from(opcode), kind, motor: 0, value }.emit()
    };
    assert_eq!(rig.bytes(&to(7, 6, 1, 0))[..2], [2, 7]);
    assert_eq!(rig.bytes(&to(7, 9, 76, 9))[0], 2);
    assert_eq!(rig.bytes(&to(7, 6, 1, 0))[0], 9);
    rig.bytes(&to(7, 9, 87, 40));
    assert!(rig.bytes(&to(40, 5, 4, 55)).is_empty(), "a group is obeyed without an answer");
    assert_eq!(rig.bytes(&to(7, 6, 4, 0))[7], 55);
    assert_eq!(Station::<Stream>::line(&rig.device), SerialLine::new_8n1(9600));
    rig.bytes(&to(7, 9, 65, 7));
    rig.sent();
    assert_eq!(Station::<Stream>::line(&rig.device), SerialLine::new_8n1(115_200));
    rig.bytes(&to(7, 9, 75, 20));
    rig.wait(20);
    rig.sent();
    assert!(rig.bytes(&to(7, 6, 1, 0)).is_empty(), "the pause holds the reply back");
    rig.wait(20);
    assert_eq!(rig.sent().len(), 9);
}

#[test]
fn silence_stops_the_motor_where_a_heartbeat_is_set() {
    let mut rig = Rig::new();
    rig.ok(1, 0, 500);
    rig.wait(3000);
    assert_eq!(rig.gap(3), 500, "without one it goes on");
    rig.say(9, 68, 0, 200);
    for _ in 0..10 {
        rig.wait(150);
        assert_eq!(rig.gap(3), 500);
    }
    rig.wait(1500);
    assert_eq!(rig.gap(3), 0);
    assert_eq!(rig.device.take_notice(), Some("no serial request: motor stopped"));
}

#[test]
fn stand_alone_modes_turn_the_motor() {
    let mut rig = Rig::new();
    rig.sap(157, 600);
    rig.sap(128, 1);
    rig.act(Act::Analog(1, 5.0));
    rig.wait(1500);
    assert!((rig.gap(3) - 300).abs() <= 1);
    rig.sap(128, 2);
    rig.ok(7, 128, 0);
    rig.ok(7, 157, 0);
    rig.act(Act::PowerCycle);
    rig.wait(1500);
    assert_eq!(rig.gap(3), 600);
}

#[test]
fn torque_mode_pushes_with_its_current() {
    let mut rig = Rig::new();
    rig.act(Act::Jam(true));
    rig.sap(155, 2500);
    rig.wait(5000);
    assert_eq!(rig.gap(150), 2500);
    assert!(rig.device.ground_truth(rig.now).enabled, "torque against a stop is no stall");
    rig.sap(6, 10);
    rig.wait(200);
    assert_eq!(rig.gap(150), 1000, "the limit is above it");
    rig.sap(6, 100);
    rig.act(Act::Jam(false));
    rig.sap(155, 1000);
    rig.wait(500);
    let speed = rig.device.ground_truth(rig.now).velocity;
    rig.ok(1, 0, 0);
    rig.wait(1);
    let after = rig.device.ground_truth(rig.now).velocity;
    assert!((speed - after).abs() < 20.0, "back to speed without a jump: {speed} {after}");
}

fn load(rig: &mut Rig, program: &[(u8, u8, u8, i32)]) {
    assert_eq!(rig.say(132, 0, 0, 0).0, 100);
    for (opcode, kind, motor, value) in program {
        assert_eq!(rig.say(*opcode, *kind, *motor, *value).0, 101);
    }
    assert_eq!(rig.say(133, 0, 0, 0).0, 100);
}

#[test]
fn a_program_is_loaded_read_back_and_run() {
    let mut rig = Rig::new();
    let program = [
        (9, 1, 2, 3),    // 0 SGP 1, 2, 3
        (4, 1, 0, 4096), // 1 MVP REL, 0, 4096
        (27, 1, 0, 0),   // 2 WAIT POS, 0, 0
        (23, 0, 0, 8),   // 3 CSUB 8
        (20, 0, 0, 0),   // 4 COMP 0
        (21, 4, 0, 1),   // 5 JC GT, 1
        (14, 1, 2, 1),   // 6 SIO 1, 2, 1
        (28, 0, 0, 0),   // 7 STOP
        (10, 1, 2, 0),   // 8 GGP 1, 2
        (19, 1, 0, 1),   // 9 CALC SUB, 1
        (35, 1, 2, 0),   // 10 AGP 1, 2
        (24, 0, 0, 0),   // 11 RSUB
    ];
    load(&mut rig, &program);
    let back = rig.send_request(134, 0, 0, 1).unwrap();
    assert_eq!((back.module, back.status.number(), back.value), (4, 1, 4096));
    assert_eq!(rig.say(129, 1, 0, 0).0, 100);
    assert_eq!(rig.ok(135, 0, 0), 1);
    rig.wait(10_000);
    assert_eq!(rig.ok(135, 0, 0), 0);
    assert_eq!(rig.say(10, 1, 2, 0), (100, 0));
    assert!((rig.gap(1) - 3 * 4096).abs() <= 30, "three turns: {}", rig.gap(1));
    assert_eq!(rig.say(15, 1, 2, 0), (100, 1));
    assert_eq!(rig.say(10, 130, 0, 0), (100, 8));
    assert_eq!(rig.say(27, 0, 0, 1).0, 6, "not from a host");
}

#[test]
fn a_program_waits_times_out_steps_and_stops() {
    let mut rig = Rig::new();
    load(
        &mut rig,
        &[
            (27, 0, 0, 10), // 0 WAIT TICKS, 0, 10
            (9, 0, 2, 1),   // 1 SGP 0, 2, 1
            (27, 2, 0, 5),  // 2 WAIT REFSW, 0, 5
            (21, 8, 0, 5),  // 3 JC ETO, 5
            (28, 0, 0, 0),  // 4 STOP
            (9, 0, 2, 2),   // 5 SGP 0, 2, 2
            (22, 0, 0, 6),  // 6 JA 6
        ],
    );
    rig.say(129, 1, 0, 0);
    rig.wait(99);
    assert_eq!(rig.say(10, 0, 2, 0).1, 0);
    rig.wait(5);
    assert_eq!(rig.say(10, 0, 2, 0).1, 1);
    rig.wait(60);
    assert_eq!(rig.say(10, 0, 2, 0).1, 2, "the switch never came");
    assert_eq!(rig.ok(135, 0, 0), 1, "a loop runs on");
    rig.ok(128, 0, 0);
    assert_eq!(rig.ok(135, 0, 0), 0);
    rig.ok(131, 0, 0);
    assert_eq!(rig.say(10, 130, 0, 0).1, 0);
    rig.ok(130, 0, 0);
    rig.wait(5);
    assert_eq!(rig.say(10, 130, 0, 0).1, 1, "one step");
    rig.say(9, 81, 0, 3);
    assert_eq!(rig.say(134, 0, 0, 0).0, 6);
    assert_eq!(rig.say(132, 0, 0, 0).0, 10);
    rig.say(9, 81, 0, 0);
    let back = rig.send_request(134, 0, 0, 1).unwrap();
    assert_eq!(back.module, 28, "dropping the protection erased it");
}

#[test]
fn the_event_comes_once_and_by_itself() {
    let mut rig = Rig::new();
    rig.ok(4, 0, 4096);
    assert_eq!(rig.ok(138, 0, 1), 1);
    let mut events = Vec::new();
    for _ in 0..3000 {
        let Some(at) = rig.device.poll_timeout() else { break };
        rig.now = at;
        rig.device.handle_timeout(at);
        events.extend(rig.sent());
    }
    let event = Reply::parse(&events).unwrap();
    assert_eq!((event.status.number(), event.opcode.number(), event.value), (128, 138, 1));
    assert_eq!(rig.device.poll_timeout(), None);
}

#[test]
fn reset_and_boot_do_not_answer() {
    let mut rig = Rig::new();
    rig.sap(4, 5);
    assert_eq!(rig.send_request(255, 0, 0, 1234), None);
    assert_eq!(rig.gap(4), 3000);
    assert_eq!(rig.send_request(242, 0x81, 0x92, 0xA3B4_C5D6_u32 as i32), None);
    assert_eq!(rig.send_request(6, 4, 0, 0), None);
    rig.act(Act::PowerCycle);
    assert_eq!(rig.gap(4), 3000);
}

#[test]
fn it_speaks_on_can_too() {
    let mut rig = Rig::new();
    let mut out = Frame::default();
    let frame = Frame::standard(1, &[9, 71, 0, 0, 0, 0, 5]);
    Station::<Can>::handle_input(&mut rig.device, rig.now, &frame);
    assert_eq!(Station::<Can>::poll_transmit(&mut rig.device, rig.now, &mut out), Some(1));
    assert_eq!((out.id, out.bytes()), (2, &[1, 100, 9, 0, 0, 0, 5][..]));
    Station::<Can>::handle_input(&mut rig.device, rig.now, &frame);
    assert_eq!(Station::<Can>::poll_transmit(&mut rig.device, rig.now, &mut out), None);
    assert_eq!(Station::<Can>::line(&rig.device).bit_rate, 250_000);
}

#[test]
fn options_are_known_or_named() {
    let refused = |extra| Tmcm17x::create_device(&profile::TMCM_171, &options(extra)).err();
    assert_eq!(refused(&[("dlc", "8"), ("deaf-ms", "50")]), None);
    assert_eq!(refused(&[("dlc", "9")]), Some("9"));
    assert_eq!(refused(&[("colour", "red")]), Some("colour"));
}

#[test]
fn a_move_begins_where_the_motor_is_and_not_where_it_once_stood() {
    let mut rig = Rig::new();
    rig.sap(6, 1);
    rig.sap(255, 1);
    rig.act(Act::Load(0.02));
    rig.wait(300);
    rig.act(Act::Load(0.0));
    rig.wait(2000);
    let before = rig.device.ground_truth(rig.now);
    assert!(before.position > 1.0 && before.enabled && before.velocity.abs() < 0.1, "{before:?}");
    rig.ok(4, 1, 0);
    rig.wait(500);
    let moved = rig.device.ground_truth(rig.now).position - before.position;
    assert!(moved.abs() < 0.1, "no way, but it went {moved} rad");
}
