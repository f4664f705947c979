extern crate std;

use super::device::{Device, Tmcm};
use super::profile;
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use crate::{DeviceOptions, Family};
use core::f64::consts::TAU;
use polepair_core::medium::Stream;
use polepair_core::profile::Profile;
use polepair_core::proto::tmcl::{Opcode, Reply, Request};
use polepair_core::station::{Station, Timed};
use polepair_core::time::Instant;
use std::vec::Vec;

const ROR: u8 = 1;
const MST: u8 = 3;
const MVP: u8 = 4;
const SAP: u8 = 5;
const GAP: u8 = 6;
const RFS: u8 = 13;
const GIO: u8 = 15;

struct Rig {
    device: Device,
    now: Instant,
}

impl Rig {
    fn new(profile: &'static Profile, extra: &[(&str, &str)]) -> Self {
        let options = DeviceOptions {
            address: None,
            wires: &["tmcl"],
            standard: None,
            untimed: true,
            seed: 1,
            extra,
        };
        Self { device: Tmcm::create_device(profile, &options).unwrap(), now: Instant::ZERO }
    }

    fn six() -> Self {
        Self::new(&profile::TMCM_6110, &[])
    }

    /// Status and value.
    fn say(&mut self, opcode: u8, kind: u8, motor: u8, value: i32) -> (u8, i32) {
        let request = Request { address: 1, opcode: Opcode::from(opcode), kind, motor, value };
        Station::<Stream>::handle_input(&mut self.device, self.now, &request.emit());
        let mut out = [0; 520];
        let sent = Station::<Stream>::poll_transmit(&mut self.device, self.now, &mut out);
        let reply = Reply::parse(&out[..sent.expect("a reply")]).expect("a reply");
        assert_eq!(reply.opcode.number(), opcode);
        (reply.status.number(), reply.value)
    }

    fn ok(&mut self, opcode: u8, kind: u8, motor: u8, value: i32) -> i32 {
        let (status, answer) = self.say(opcode, kind, motor, value);
        assert_eq!(status, 100, "{opcode} {kind} {motor} {value}");
        answer
    }

    fn gap(&mut self, motor: u8, number: u8) -> i32 {
        self.ok(GAP, number, motor, 0)
    }

    fn wait(&mut self, ms: u32) {
        self.now = self.now.plus_ms(ms);
        self.device.handle_timeout(self.now);
    }

    /// Waits for what a parameter reads.
    fn until(&mut self, motor: u8, number: u8, value: i32) {
        for _ in 0..60_000 {
            if self.gap(motor, number) == value {
                return;
            }
            self.wait(10);
        }
        panic!("AP {number} of motor {motor} never was {value}: {}", self.gap(motor, number));
    }

    fn truth(&mut self, motor: u8) -> GroundTruth {
        self.device.motor_truth(self.now, motor).expect("a motor")
    }

    fn act(&mut self, motor: u8, act: Act) {
        assert!(self.device.act_on_motor(self.now, motor, act), "{act:?}");
    }
}

/// Hardware manual of the TMCM-1140, chapter 8: 16 MHz · v / (2^pulse_div · 2048 · 32), and the
/// acceleration of the same chapter.
#[test]
fn speeds_and_accelerations_are_those_of_the_manual() {
    let mut rig = Rig::six();
    rig.ok(SAP, 5, 2, 100);
    rig.ok(ROR, 0, 2, 1000);
    rig.wait(100);
    let microstep = TAU / 51_200.0;
    let acceleration = 16e6 * 16e6 * 100.0 / f64::from(1_u32 << 20) / f64::from(1_u32 << 19);
    let speed = rig.truth(2).setpoint.unwrap().velocity / microstep;
    assert!((speed / (0.1 * acceleration) - 1.0).abs() < 0.02, "{speed} {acceleration}");
    rig.wait(5000);
    let expected = 16e6 * 1000.0 / (8.0 * 2048.0 * 32.0);
    let truth = rig.truth(2);
    assert!((truth.setpoint.unwrap().velocity / microstep / expected - 1.0).abs() < 1e-6);
    assert!((truth.velocity / microstep / expected - 1.0).abs() < 0.02, "the rotor follows");
    assert_eq!(rig.gap(2, 3), 1000);
    // One less of the divisor is twice the speed.
    rig.ok(SAP, 154, 2, 2);
    rig.ok(ROR, 0, 2, 1000);
    rig.wait(5000);
    let twice = rig.truth(2).setpoint.unwrap().velocity / microstep;
    assert!((twice / expected - 2.0).abs() < 1e-6);
    rig.ok(MST, 0, 2, 0);
    rig.wait(5000);
    assert_eq!((rig.gap(2, 3), rig.truth(2).velocity), (0, 0.0));
}

#[test]
fn six_motors_go_their_own_ways() {
    let mut rig = Rig::six();
    for motor in 0..6 {
        rig.ok(MVP, 0, motor, 10_000 * (i32::from(motor) - 2));
    }
    rig.wait(20_000);
    for motor in 0..6_u8 {
        let target = 10_000 * (i32::from(motor) - 2);
        assert_eq!((rig.gap(motor, 1), rig.gap(motor, 8)), (target, 1));
        let turned = rig.truth(motor).position / TAU * 51_200.0;
        assert!((turned - f64::from(target)).abs() < 30.0, "{turned} {target}");
    }
    assert_eq!(rig.say(GAP, 1, 6, 0).0, 4, "there is no seventh");
    assert_eq!(rig.ok(MVP, 1, 3, -500), 9_500, "the target of a relative move");
}

#[test]
fn the_counter_is_set_without_moving() {
    let mut rig = Rig::six();
    rig.ok(MVP, 0, 1, 5000);
    rig.until(1, 8, 1);
    let before = rig.truth(1).position;
    rig.ok(SAP, 1, 1, 0);
    rig.wait(500);
    assert_eq!((rig.gap(1, 0), rig.gap(1, 1), rig.gap(1, 8)), (0, 0, 1));
    assert!((rig.truth(1).position - before).abs() < 1e-9);
    // With half the microsteps the same number is twice as far.
    rig.ok(SAP, 140, 1, 7);
    rig.ok(MVP, 0, 1, 5000);
    rig.until(1, 8, 1);
    let turned = (rig.truth(1).position - before) / TAU * 25_600.0;
    assert!((turned - 5000.0).abs() < 30.0, "{turned}");
}

/// A load beyond the current's torque costs whole periods of four full steps, and the module does not
/// notice it.
#[test]
fn steps_are_lost_by_load_and_not_reported() {
    let mut rig = Rig::six();
    rig.ok(SAP, 6, 0, 60);
    rig.ok(ROR, 0, 0, 500);
    rig.wait(1000);
    rig.act(0, Act::Load(-0.5));
    rig.wait(1000);
    rig.act(0, Act::Load(0.0));
    rig.ok(MST, 0, 0, 0);
    rig.wait(3000);
    let counted = f64::from(rig.gap(0, 1)) / 51_200.0 * 200.0;
    let lost = counted - rig.truth(0).position / TAU * 200.0;
    assert!(lost > 3.0, "{lost} full steps");
    assert!((lost / 4.0 - libm::round(lost / 4.0)).abs() < 0.1, "{lost} are whole periods");
    assert_eq!(rig.device.take_notice(), Some("steps lost"));
    // With all of the current the same load is carried.
    rig.ok(SAP, 6, 1, 255);
    rig.ok(ROR, 0, 1, 500);
    rig.wait(1000);
    rig.act(1, Act::Load(-0.2));
    rig.wait(1000);
    rig.act(1, Act::Load(0.0));
    rig.ok(MST, 0, 1, 0);
    rig.wait(3000);
    let counted = f64::from(rig.gap(1, 1)) / 51_200.0 * 200.0;
    assert!((counted - rig.truth(1).position / TAU * 200.0).abs() < 0.5);
}

#[test]
fn a_stall_stops_the_motor_where_that_is_set() {
    let mut rig = Rig::new(&profile::TMCM_1140, &[]);
    rig.ok(SAP, 181, 0, 100);
    rig.ok(ROR, 0, 0, 1000);
    rig.wait(2000);
    let free = rig.gap(0, 206);
    assert!(free > 100, "{free}");
    assert_eq!(rig.gap(0, 3), 1000, "it turns freely");
    rig.act(0, Act::Jam(true));
    rig.until(0, 3, 0);
    assert_eq!((rig.gap(0, 207), rig.gap(0, 207)), (1, 0), "reading clears it");
    rig.act(0, Act::Jam(false));
    // Without the setting it goes on.
    rig.ok(SAP, 181, 0, 0);
    rig.ok(ROR, 0, 0, 1000);
    rig.wait(2000);
    rig.act(0, Act::Jam(true));
    rig.wait(2000);
    assert_eq!((rig.gap(0, 3), rig.gap(0, 207)), (1000, 0));
}

#[test]
fn stop_switches_stop_and_may_be_left() {
    let mut rig = Rig::new(&profile::TMCM_6110, &[("ends", "-360..720")]);
    rig.ok(ROR, 0, 0, 1000);
    rig.wait(500);
    rig.until(0, 3, 0);
    let at = rig.truth(0).position;
    assert!((at - 2.0 * TAU).abs() < 0.1, "{at}");
    assert_eq!((rig.gap(0, 10), rig.gap(0, 11)), (1, 0));
    rig.ok(ROR, 0, 0, 1000);
    rig.wait(1000);
    assert!((rig.truth(0).position - at).abs() < 0.1, "it does not go on");
    rig.ok(ROR, 0, 0, -1000);
    rig.wait(500);
    assert!(rig.truth(0).position < at - 0.1);
    rig.until(0, 3, 0);
    assert!((rig.truth(0).position + TAU).abs() < 0.1);
    rig.ok(SAP, 13, 0, 1);
    rig.ok(ROR, 0, 0, -1000);
    rig.wait(2000);
    assert!(rig.truth(0).position < -1.5 * TAU, "a switch that is disabled stops nothing");
}

/// TMCL reference, RFS and axis parameters 193 to 197.
#[test]
fn each_search_finds_its_switch() {
    let places =
        [(1, -2.0), (2, -2.0), (3, -2.0), (4, -2.0), (5, 0.5), (6, 0.5), (7, 0.5), (65, 3.0)];
    for (mode, turns) in places {
        let mut rig = Rig::new(&profile::TMCM_6110, &[("ends", "-720..1080")]);
        rig.act(4, Act::Switch { which: 0, at: 0.5 * TAU });
        rig.ok(SAP, 193, 4, mode);
        rig.ok(RFS, 0, 4, 0);
        assert_ne!(rig.ok(RFS, 2, 4, 0), 0);
        for _ in 0..100_000 {
            if rig.ok(RFS, 2, 4, 0) == 0 {
                break;
            }
            rig.wait(10);
        }
        rig.wait(500);
        assert_eq!(rig.ok(RFS, 2, 4, 0), 0, "mode {mode} ended");
        let truth = rig.truth(4);
        assert!(
            (truth.position / TAU - turns).abs() < 0.02,
            "mode {mode}: {}",
            truth.position / TAU
        );
        assert_eq!((rig.gap(4, 1), rig.gap(4, 0), truth.velocity), (0, 0, 0.0), "mode {mode}");
        if mode == 2 {
            let distance = f64::from(rig.gap(4, 196)) / 51_200.0;
            assert!((distance - 5.0).abs() < 0.05, "{distance} turns between the ends");
        }
    }
    let mut rig = Rig::six();
    rig.ok(SAP, 193, 0, 99);
    assert_eq!(rig.say(RFS, 0, 0, 0).0, 4, "there is no such mode");
    rig.ok(SAP, 193, 0, 1);
    rig.ok(RFS, 0, 0, 0);
    rig.wait(300);
    rig.ok(RFS, 1, 0, 0);
    rig.wait(1000);
    assert_eq!((rig.ok(RFS, 2, 0, 0), rig.gap(0, 3)), (0, 0), "it can be ended");
}

#[test]
fn standing_motors_have_their_standby_current_or_none() {
    let mut rig = Rig::six();
    rig.ok(MVP, 0, 0, 1000);
    rig.wait(10);
    assert!(rig.truth(0).current > 0.5);
    rig.until(0, 8, 1);
    rig.wait(2500);
    let standby = rig.truth(0).current;
    assert!((standby - 1.1 * 8.0 / 255.0).abs() < 1e-9, "{standby}");
    rig.ok(SAP, 204, 0, 300);
    rig.wait(2000);
    assert!(!rig.truth(0).enabled, "it is free after three seconds");
    rig.ok(MVP, 0, 0, 0);
    rig.wait(10);
    assert!(rig.truth(0).enabled);
}

/// 138 reports which of the motors in its mask have arrived (TMCL reference).
#[test]
fn arrived_motors_are_recognised_by_their_bits() {
    let mut rig = Rig::six();
    rig.ok(MVP, 0, 2, 2_000);
    rig.ok(MVP, 0, 5, 60_000);
    rig.ok(138, 0, 0, 1 << 2 | 1 << 5);
    let (mut told, mut out) = (Vec::new(), [0; 520]);
    for _ in 0..10_000 {
        rig.wait(1);
        if let Some(n) = Station::<Stream>::poll_transmit(&mut rig.device, rig.now, &mut out) {
            let reply = Reply::parse(&out[..n]).expect("an event");
            told.push((reply.status.number(), reply.value));
        }
    }
    assert_eq!(told, [(128, 1 << 2)], "one event answers one request");
}

#[test]
fn ports_and_identity() {
    let mut rig = Rig::six();
    assert_eq!(rig.ok(136, 1, 0, 0) >> 16, 6110);
    assert_eq!((rig.ok(GIO, 8, 1, 0), rig.ok(GIO, 9, 1, 0)), (240, 25));
    rig.ok(14, 3, 2, 1);
    assert_eq!(rig.ok(GIO, 3, 2, 0), 1);
    rig.act(0, Act::Input(2, true));
    assert_eq!(rig.ok(GIO, 1, 0, 0), 1);
    rig.act(0, Act::Supply(12.0));
    assert_eq!(rig.ok(GIO, 8, 1, 0), 120);
}

#[test]
fn a_motor_at_its_target_is_reported_at_once() {
    let mut rig = Rig::six();
    rig.ok(138, 0, 0, 1 << 2);
    rig.wait(20);
    let mut out = [0; 520];
    let n = Station::<Stream>::poll_transmit(&mut rig.device, rig.now, &mut out).expect("an event");
    let reply = Reply::parse(&out[..n]).expect("an event");
    assert_eq!((reply.status.number(), reply.value), (128, 1 << 2));
    rig.ok(MVP, 0, 2, 5000);
    rig.until(2, 8, 1);
}

/// TMCL reference, SCO, GCO, CCO and MVP COORD.
#[test]
fn motors_start_together_for_their_coordinates() {
    const SCO: u8 = 30;
    const GCO: u8 = 31;
    const CCO: u8 = 32;
    let mut rig = Rig::six();
    for motor in 0..6 {
        rig.ok(SCO, 3, motor, 1000 * i32::from(motor));
    }
    assert_eq!(rig.ok(GCO, 3, 5, 0), 5000);
    // Motors 1, 2 and 4 by a mask, 5 alone.
    rig.ok(MVP, 2, 0x40 | 0b1_0110, 3);
    rig.ok(MVP, 2, 5, 3);
    for (motor, target) in [(0, 0), (1, 1000), (2, 2000), (3, 0), (4, 4000), (5, 5000)] {
        rig.until(motor, 8, 1);
        assert_eq!(rig.gap(motor, 1), target);
    }
    rig.ok(CCO, 7, 255, 0);
    assert_eq!((rig.ok(GCO, 7, 4, 0), rig.ok(GCO, 7, 3, 0)), (4000, 0));
    assert_eq!((rig.say(GCO, 21, 0, 0).0, rig.say(MVP, 2, 0x40, 3).0), (3, 4));
    assert_eq!((rig.say(MVP, 2, 6, 3).0, rig.say(MVP, 2, 0, 21).0), (4, 4));
}

#[test]
fn a_fault_of_the_driver_takes_the_power_until_it_was_off() {
    let mut rig = Rig::six();
    rig.ok(ROR, 0, 0, 500);
    rig.wait(1000);
    rig.act(0, Act::Fault(8));
    rig.wait(3000);
    assert_eq!(rig.gap(0, 208) & 8, 8);
    let truth = rig.truth(0);
    assert!(!truth.enabled && truth.velocity == 0.0 && truth.fault == 8, "{truth:?}");
    assert!(!rig.device.act_on_motor(rig.now, 0, Act::Fault(4)), "a warning is none");
    rig.act(0, Act::PowerCycle);
    assert_eq!(rig.gap(0, 208) & 8, 0);
}
