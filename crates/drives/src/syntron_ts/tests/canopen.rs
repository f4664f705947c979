//! Chapter 3 of the manual, frame by frame as it is printed.

use std::vec::Vec;

use super::*;
use polepair_core::medium::{Can, Frame};
use polepair_core::proto::canopen::sdo::{
    AbortCode, ExpeditedData, ObjectIndex, SdoReply, SdoRequest,
};

/// A drive with node-ID 2, as in the manual's examples; its operator has set Fn_00 = 20.
struct CanopenFixture {
    device: Device,
    now: Instant,
    received: Vec<Frame>,
}

/// `602 2B 40 60 00 06 00 00 00` as a frame.
fn frame(line: &str) -> Frame {
    let mut words = line.split(' ').map(|word| u16::from_str_radix(word, 16).unwrap());
    let id = words.next().unwrap();
    let data: Vec<u8> = words.map(|word| word as u8).collect();
    Frame::standard(id, &data)
}

impl CanopenFixture {
    fn with(extra: &[(&str, &str)]) -> Self {
        let options = DeviceOptions { address: Some(2), wires: &["canopen"], extra, ..OPTIONS };
        let device = SyntronTs::create_device(SyntronTs::profiles()[0], &options).unwrap();
        let mut bus = Self { device, now: Instant(1_000_000_000), received: Vec::new() };
        bus.advance(1);
        assert_eq!(bus.received, [frame("702 00")], "boot-up");
        bus.received.clear();
        bus
    }

    fn new() -> Self {
        Self::with(&[("fn00", "20")])
    }

    fn receive(&mut self, frame: Frame) {
        Station::<Can>::handle_input(&mut self.device, self.now, &frame);
        self.drain();
    }

    /// Sends lines as the manual prints them, a millisecond apart; each SDO is acknowledged.
    fn send_lines(&mut self, lines: &[&str]) {
        for line in lines {
            self.received.clear();
            self.receive(frame(line));
            if line.starts_with("602") {
                let answered = self.received.iter().any(|f| f.id == 0x582 && f.data[0] == 0x60);
                assert!(answered, "{line}: {:?}", self.received);
            }
            self.advance(1);
        }
    }

    fn drain(&mut self) {
        let mut out = Frame::default();
        while Station::<Can>::poll_transmit(&mut self.device, self.now, &mut out).is_some() {
            self.received.push(out);
        }
    }

    fn advance(&mut self, ms: u32) {
        for _ in 0..ms {
            self.now = self.now.plus_ms(1);
            self.device.handle_timeout(self.now);
            self.drain();
        }
    }

    fn request(&mut self, request: SdoRequest) -> SdoReply {
        self.received.clear();
        self.receive(request.emit(2));
        SdoReply::of(self.received.iter().find(|f| f.id == 0x582).unwrap().data)
    }

    fn read(&mut self, index: u16, sub: u8) -> i32 {
        match self.request(SdoRequest::Read(ObjectIndex::new(index, sub))) {
            SdoReply::Value(_, ExpeditedData { bits, len: 2 }) => i32::from(bits as i16),
            SdoReply::Value(_, short) => short.bits as i32,
            other => panic!("{index:04X}: {other:?}"),
        }
    }

    fn write(&mut self, index: u16, value: i32) -> Result<(), AbortCode> {
        let short = ExpeditedData { bits: value as u32, len: 4 };
        match self.request(SdoRequest::Write(ObjectIndex::new(index, 0), short)) {
            SdoReply::Written(_, echo) if echo == value as u32 => Ok(()),
            SdoReply::Abort(_, abort) => Err(abort),
            other => panic!("{other:?}"),
        }
    }

    fn status(&mut self) -> i32 {
        self.read(0x6041, 0)
    }

    fn truth(&mut self) -> GroundTruth {
        self.device.ground_truth(self.now)
    }

    fn rpm(&mut self) -> f64 {
        self.truth().velocity * 60.0 / core::f64::consts::TAU
    }

    fn act(&mut self, act: Act) {
        assert!(self.device.act(self.now, act), "{act:?}");
    }

    /// Codes of the emergencies since the last question.
    fn emergencies(&self) -> Vec<u16> {
        let of = |frame: &Frame| u16::from_le_bytes([frame.data[0], frame.data[1]]);
        self.received.iter().filter(|f| f.id == 0x82).map(of).collect()
    }
}

const ENABLE: [&str; 3] =
    ["602 2B 40 60 00 06 00 00 00", "602 2B 40 60 00 07 00 00 00", "602 2B 40 60 00 0F 00 00 00"];

/// RPDO1 to RPDO3 as §3.6.1 and §3.6.2 map them, but for the object of RPDO3.
const MAPPING: [&str; 8] = [
    "602 2F 00 16 00 00 00 00",
    "602 23 00 16 01 10 00 40 60",
    "602 2F 00 16 00 01 00 00 00",
    "602 2F 01 16 00 00 00 00",
    "602 23 01 16 01 20 00 83 60",
    "602 23 01 16 02 20 00 84 60",
    "602 2F 01 16 00 02 00 00 00",
    "602 2F 02 16 00 00 00 00",
];

#[test]
fn the_speed_recipe_turns_the_motor() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&["000 01 02"]);
    bus.send_lines(&MAPPING);
    bus.send_lines(&["602 23 02 16 01 20 00 FF 60", "602 2F 02 16 00 01 00 00 00"]);
    bus.send_lines(&[
        "602 2F 60 60 00 03 00 00 00",
        "302 E8 03 00 00 E8 03 00 00",
        "402 64 00 00 00",
    ]);
    let states = [0x0031, 0x0033, 0x0037];
    assert_eq!(bus.status(), 0x0050);
    for (line, state) in ENABLE.iter().zip(states) {
        bus.receive(frame(line));
        assert_eq!(bus.status(), state, "{line}");
    }
    bus.advance(200);
    assert!((bus.rpm() - 10.0).abs() < 1.0, "100 is 10 rpm: {}", bus.rpm());
    // Enabled, it obeys at once; a second from rest to 3000 rpm.
    bus.receive(frame("402 98 3A 00 00"));
    bus.advance(250);
    assert!((bus.rpm() - 750.0).abs() < 60.0, "{}", bus.rpm());
    bus.advance(400);
    let units =
        [bus.read(0x606C, 0), bus.read(0x6069, 0), bus.read(0x606B, 0), bus.read(0x3000, 0)];
    for (value, wanted) in units.into_iter().zip([1500, 15_000, 15_000, 1500]) {
        assert!((value - wanted).abs() <= wanted / 100, "{units:?}");
    }
    assert_eq!(bus.status(), 0x0437, "speed reached");
    bus.receive(frame("202 07 00"));
    assert_eq!((bus.status(), bus.truth().enabled), (0x0033, false));
}

#[test]
fn the_position_recipe_moves_so_many_pulses() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&["000 01 02"]);
    bus.send_lines(&MAPPING);
    bus.send_lines(&["602 23 02 16 01 20 00 7A 60", "602 2F 02 16 00 01 00 00 00"]);
    bus.send_lines(&[
        "602 2F 03 16 00 00 00 00",
        "602 23 03 16 01 20 00 81 60",
        "602 2F 03 16 00 01 00 00 00",
        "602 2F 60 60 00 01 00 00 00",
        "402 60 EA 00 00",
        "502 B8 0B 00 00",
        "302 E8 03 00 00 E8 03 00 00",
        "602 2B 93 60 01 01 00 00 00",
        "602 2B 93 60 02 01 00 00 00",
    ]);
    bus.send_lines(&ENABLE);
    bus.send_lines(&["202 0F 00", "202 5F 00", "202 4F 00"]);
    bus.advance(600);
    assert!((bus.rpm() - 300.0).abs() < 5.0, "300 rpm: {}", bus.rpm());
    bus.received.clear();
    bus.advance(1500);
    assert_eq!(bus.emergencies(), [0x8683], "position reached");
    assert!((bus.read(0x6064, 0) - 60_000).abs() <= 3);
    assert_eq!(bus.status(), 0x0437);
    // The same edge again goes on by as much; a factor of 2 makes two increments of a pulse.
    bus.send_lines(&["602 23 93 60 01 02 00 00 00", "202 5F 00", "202 4F 00"]);
    bus.advance(4000);
    assert!((bus.read(0x6063, 0) - 180_000).abs() <= 6);
    assert!((bus.read(0x6064, 0) - 90_000).abs() <= 3);
    let counts = bus.read(0x302E, 0) as u16 as i32 | bus.read(0x302F, 0) << 16;
    assert!((counts - 180_000).abs() <= 6, "Dn_2E and Dn_2F: {counts}");
}

#[test]
fn thirty_two_set_points_wait_and_the_next_is_lost() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&["000 01 02", "602 2F 60 60 00 01 00 00 00"]);
    bus.send_lines(&MAPPING);
    bus.send_lines(&ENABLE);
    bus.write(0x6081, 30_000).unwrap();
    bus.write(0x607A, 500).unwrap();
    for n in 1..=40 {
        bus.receive(frame("202 5F 00"));
        assert_eq!(bus.status() & 0x1000, 0x1000, "{n}: taken");
        bus.receive(frame("202 4F 00"));
        let full = bus.status() & 0x1000 != 0;
        assert_eq!(full, n > 32, "{n}: bit 12 stays when no other has room");
    }
    bus.advance(10_000);
    // One ran and 32 waited: later ones are lost.
    assert!((bus.read(0x6064, 0) - 33 * 500).abs() <= 5, "{}", bus.read(0x6064, 0));
}

#[test]
fn the_torque_recipe_as_printed_leaves_it_standing_and_corrected_turns_it() {
    for (mode, turns) in
        [("602 2F 60 60 00 03 00 00 00", false), ("602 2F 60 60 00 04 00 00 00", true)]
    {
        let mut bus = CanopenFixture::new();
        bus.send_lines(&[
            "000 01 02",
            mode,
            "602 2F 87 60 00 E8 03 00 00",
            "602 2F 71 60 00 64 00 00 00",
        ]);
        bus.send_lines(&ENABLE);
        assert_eq!(
            (bus.read(0x6087, 0), bus.read(0x6071, 0)),
            (1000, 100),
            "width from the object"
        );
        bus.write(0x2095, 600).unwrap();
        bus.advance(2000);
        assert_eq!(bus.rpm().abs() > 100.0, turns, "{}", bus.rpm());
        assert!(bus.rpm() < 610.0, "Fn_95 limits the speed: {}", bus.rpm());
        assert_eq!(bus.status() & 0x6F, 0x27);
        if turns {
            bus.act(Act::Jam(true));
            bus.advance(100);
            assert!((bus.truth().current / 12.7 - 0.1).abs() < 0.01, "10 % of the rated torque");
        }
    }
}

#[test]
fn the_homing_recipe_finds_the_switch() {
    let mut bus = CanopenFixture::new();
    bus.act(Act::Switch { which: 0, at: 3.0 });
    bus.send_lines(&[
        "000 01 02",
        "602 2F 60 60 00 06 00 00 00",
        "602 2F 98 60 00 14 00 00 00",
        "602 23 99 60 01 D0 07 00 00",
        "602 23 99 60 02 C8 00 00 00",
        "602 23 9A 60 00 E8 03 00 00",
        "602 23 93 60 01 01 00 00 00",
        "602 23 93 60 02 01 00 00 00",
    ]);
    bus.send_lines(&ENABLE);
    bus.send_lines(&[
        "602 2B 40 60 00 0F 00 00 00",
        "602 2B 40 60 00 5F 00 00 00",
        "602 2B 40 60 00 4F 00 00 00",
    ]);
    bus.advance(300);
    assert_eq!(bus.status() & 0x3400, 0, "under way though bit 4 fell");
    bus.advance(10_000);
    assert_eq!(bus.status() & 0x3400, 0x1400, "attained");
    let zero =
        bus.truth().position - f64::from(bus.read(0x6064, 0)) / 10_000.0 * core::f64::consts::TAU;
    assert!((zero - 3.0).abs() < 0.01, "{zero}");
    let methods = [-18, -17, -2, -1, 1, 2, 3, 4, 17, 18, 19, 20, 35];
    for method in i8::MIN..=i8::MAX {
        let accepted = bus.write(0x6098, method.into()).is_ok();
        assert_eq!(accepted, methods.contains(&method), "{method}");
    }
}

#[test]
fn without_fn_00_20_the_controlword_moves_nothing() {
    let mut bus = CanopenFixture::with(&[]);
    bus.send_lines(&["000 01 02", "602 2F 60 60 00 03 00 00 00", "602 23 FF 60 00 64 00 00 00"]);
    bus.send_lines(&ENABLE);
    bus.advance(100);
    assert_eq!((bus.status(), bus.truth().enabled), (0x0050, false));
    bus.send_lines(&["602 2B 00 20 00 14 00 00 00"]);
    bus.send_lines(&ENABLE);
    bus.advance(100);
    assert_eq!(bus.status() & 0x6F, 0x27);
    assert!(bus.rpm() > 5.0);
    // Another mode takes the power off.
    bus.send_lines(&["602 2B 00 20 00 01 00 00 00"]);
    assert_eq!((bus.status(), bus.truth().enabled), (0x0050, false));
}

#[test]
fn one_store_lies_behind_both_wires() {
    let mut bus = CanopenFixture::new();
    bus.write(0x2099, 1).unwrap();
    bus.received.clear();
    bus.receive(frame("602 2B 33 20 00 C8 00 00 00"));
    assert_eq!(bus.received, [frame("582 60 33 20 00 C8 00 00 00")], "the data is repeated");
    let mut fixture = DriveFixture { device: bus.device, now: bus.now, unit: 2, ascii: false };
    assert_eq!(fixture.read(0x33), 200);
    fixture.write(0x33, 100);
    fixture.write(0x00, 1);
    fixture.write(0x38, 1);
    fixture.advance(500);
    let mut bus = CanopenFixture { device: fixture.device, now: fixture.now, received: Vec::new() };
    assert_eq!(bus.read(0x2033, 0), 100);
    let seen = bus.read(0x3000, 0);
    assert!((seen - 100).abs() <= 2, "{seen}");
    assert_eq!(bus.write(0x3000, 1), Err(AbortCode::READ_ONLY));
    assert_eq!(bus.write(0x203A, 128), Err(AbortCode::VALUE), "an address above 127");
    assert_eq!(bus.write(0x2300, 1), Err(AbortCode::NO_OBJECT));
}

#[test]
fn alarms_are_two_bytes_and_state_0088() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&["000 01 02", "602 2F 60 60 00 03 00 00 00", "602 23 FF 60 00 10 27 00 00"]);
    bus.send_lines(&ENABLE);
    bus.advance(300);
    bus.received.clear();
    bus.act(Act::Supply(90.0));
    bus.advance(2);
    let reports: Vec<_> = bus.received.iter().filter(|f| f.id == 0x82).copied().collect();
    assert_eq!(reports, [frame("082 1C 16")], "ERR_oU");
    assert_eq!((bus.status(), bus.read(0x3012, 0), bus.read(0x603F, 0)), (0x0088, 0x161C, 0x161C));
    bus.act(Act::Supply(48.0));
    bus.send_lines(&["602 2B 40 60 00 80 00 00 00"]);
    assert_eq!((bus.status(), bus.read(0x3012, 0)), (0x0050, 0));
    bus.advance(500);
    assert!(!bus.truth().enabled, "clearing it starts nothing");
    let mut wide = CanopenFixture::with(&[("fn00", "20"), ("emcy", "8")]);
    wide.act(Act::Fault(0x160C));
    wide.advance(1);
    assert_eq!(wide.received, [frame("082 0C 16 81 00 00 00 00 00")]);
    wide.received.clear();
    wide.send_lines(&["602 2B 40 60 00 80 00 00 00"]);
    assert_eq!(wide.emergencies(), [0], "all is well again");
}

#[test]
fn limit_switches_are_reported_and_a_lost_heartbeat_is_err_lo() {
    let mut bus = CanopenFixture::new();
    bus.act(Act::Switch { which: 1, at: 20.0 });
    bus.send_lines(&["000 01 02", "602 2F 60 60 00 03 00 00 00", "602 23 FF 60 00 10 27 00 00"]);
    bus.send_lines(&ENABLE);
    bus.received.clear();
    bus.advance(1000);
    assert_eq!(bus.emergencies(), [0x8681], "positive limit, once");
    assert!(bus.rpm().abs() < 1.0);
    bus.send_lines(&["602 23 FF 60 00 F0 D8 FF FF"]);
    bus.advance(500);
    assert!(bus.rpm() < -900.0, "{}", bus.rpm());
    bus.send_lines(&["602 23 16 10 01 64 00 7F 00"]);
    for _ in 0..5 {
        bus.receive(frame("77F 05"));
        bus.advance(90);
    }
    assert!(bus.rpm() < -900.0);
    bus.received.clear();
    bus.advance(30);
    assert_eq!(bus.read(0x3012, 0), 0x1416, "ERR_Lo");
    assert!(!bus.truth().enabled);
}

#[test]
fn timed_pdos_go_by_the_manuals_50_ms() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&[
        "000 01 02",
        "602 2F 01 1A 00 00 00 00 00",
        "602 23 01 1A 01 20 00 64 60",
        "602 23 01 1A 02 20 00 6C 60",
        "602 2F 01 1A 00 02 00 00 00",
        "602 2F 01 18 05 90 01 00 00",
        "602 2F 01 18 03 90 01 00 00",
        "602 2F 01 18 02 FE 00 00 00",
    ]);
    bus.received.clear();
    bus.advance(500);
    assert_eq!(bus.received.iter().filter(|f| f.id == 0x282 && f.len == 8).count(), 10);
}

/// §3.5.1: a remote request is answered with the state, whose bit 7 alternates.
#[test]
fn node_guarding_works_from_the_factory() {
    let mut bus = CanopenFixture::new();
    let guard = Frame { id: 0x702, remote: true, ..Frame::default() };
    bus.received.clear();
    for _ in 0..3 {
        bus.receive(guard);
    }
    assert_eq!(bus.received, [frame("702 7F"), frame("702 FF"), frame("702 7F")]);
    let mut silent = CanopenFixture::with(&[("guarding", "0")]);
    silent.received.clear();
    silent.receive(guard);
    assert_eq!(silent.received, []);
}

#[test]
fn heartbeat_node_id_and_bit_rate_are_set_as_printed() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&["602 2B 17 10 00 64 00 00"]);
    bus.received.clear();
    bus.advance(1000);
    assert_eq!(bus.received, [frame("702 7F"); 10]);
    bus.send_lines(&["602 2B 17 10 00 00 00 00"]);
    bus.received.clear();
    bus.advance(300);
    assert_eq!(bus.received, []);
    bus.write(0x209A, 9).unwrap();
    bus.write(0x209C, 250).unwrap();
    assert_eq!(bus.read(0x209A, 0), 9, "still node 2");
    bus.received.clear();
    bus.act(Act::PowerCycle);
    bus.advance(1);
    assert_eq!(bus.received, [frame("709 00")]);
    assert_eq!(Station::<Can>::line(&bus.device).bit_rate, 250_000);
    let mut bus = CanopenFixture::new();
    for silent in ["7E5 04 01 00 00 00 00 00 00", "100 00 00 00 00 00 00"] {
        bus.received.clear();
        bus.receive(frame(silent));
        assert_eq!(bus.received, [], "no such service");
    }
    let refused = SdoReply::Abort(ObjectIndex::new(0x2033, 0), AbortCode::SPECIFIER);
    assert_eq!(bus.request(SdoRequest::WriteLong(ObjectIndex::new(0x2033, 0), Some(2))), refused);
}

/// §3.6.4: methods 3 and 19 search the home switch in reverse, 4 and 20 forward.
#[test]
fn homing_begins_in_the_direction_of_the_manual() {
    for (extra, method, at, direction) in [
        (&[("fn00", "20")][..], 19, 3.0, -1.0),
        (&[("fn00", "20")], 3, 3.0, -1.0),
        (&[("fn00", "20")], 19, -3.0, -1.0),
        (&[("fn00", "20")], 20, 3.0, 1.0),
        (&[("fn00", "20"), ("homing", "cia")], 19, 3.0, 1.0),
    ] {
        let mut bus = CanopenFixture::with(extra);
        bus.act(Act::Switch { which: 0, at });
        bus.send_lines(&["000 01 02", "602 2F 60 60 00 06 00 00 00"]);
        bus.write(0x6098, method).unwrap();
        bus.send_lines(&["602 23 99 60 01 D0 07 00 00", "602 23 99 60 02 C8 00 00 00"]);
        bus.send_lines(&ENABLE);
        bus.send_lines(&["602 2B 40 60 00 0F 00 00 00", "602 2B 40 60 00 1F 00 00 00"]);
        bus.advance(100);
        let velocity = bus.truth().velocity;
        assert!(velocity * direction > 1.0, "{method} {extra:?}: {velocity}");
    }
}

/// Each method finds its zero again, from either side of the switch.
#[test]
fn homing_over_canopen_finds_the_same_zero_any_number_of_times() {
    for method in [3, 4, 19, 20] {
        let mut bus = CanopenFixture::with(&[("fn00", "20")]);
        bus.send_lines(&["000 01 02", "602 2F 60 60 00 06 00 00 00"]);
        bus.write(0x6098, method).unwrap();
        bus.send_lines(&["602 23 99 60 01 D0 07 00 00", "602 23 99 60 02 C8 00 00 00"]);
        bus.send_lines(&ENABLE);
        let mut zeros = [0.0; 3];
        for zero in &mut zeros {
            bus.send_lines(&["602 2B 40 60 00 0F 00 00 00", "602 2B 40 60 00 1F 00 00 00"]);
            bus.advance(20_000);
            assert_eq!(bus.read(0x6041, 0) & 0x3000, 0x1000, "{method}: attained");
            let truth = bus.truth();
            assert!(truth.velocity.abs() < 0.1, "{method}: {truth:?}");
            *zero = truth.position;
        }
        assert!(zeros.iter().all(|zero| (zero - zeros[0]).abs() < 0.02), "{method}: {zeros:?}");
    }
}

/// §3.4: the objects of SYNC and TIME.
#[test]
fn the_objects_of_sync_and_time_are_there() {
    let mut bus = CanopenFixture::new();
    assert_eq!(bus.read(0x1007, 0), 0);
    bus.write(0x1007, 500).unwrap();
    assert_eq!(bus.read(0x1007, 0), 500);
    assert_ne!(bus.read(0x1012, 0), 0);
    let before = bus.read(0x1013, 0);
    bus.advance(10);
    let passed = bus.read(0x1013, 0) - before;
    assert!((9_000..12_000).contains(&passed), "{passed} µs");
}

/// No manual lets NMT stop raise an alarm: the motor continues as commanded.
#[test]
fn nmt_stop_raises_no_alarm() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&["000 01 02", "602 2F 60 60 00 03 00 00 00", "602 23 FF 60 00 10 27 00 00"]);
    bus.send_lines(&ENABLE);
    bus.advance(500);
    let rpm = bus.rpm();
    assert!(rpm > 900.0, "{rpm}");
    bus.receive(frame("000 02 02"));
    bus.received.clear();
    bus.advance(500);
    assert!(bus.rpm() > 900.0 && !bus.received.iter().any(|f| f.id == 0x082), "{:?}", bus.received);
    bus.receive(frame("000 01 02"));
    assert_eq!(bus.read(0x603F, 0), 0);
}

/// A frame that ends within the controlword is no controlword: an emergency reports it (CiA 301, 8210h), with
/// bit 0 beside the communication's in the error register.
#[test]
fn one_byte_for_the_controlword_is_an_emergency() {
    let mut bus = CanopenFixture::new();
    bus.send_lines(&[
        "602 2F 00 16 00 00 00 00 00",
        "602 23 00 16 01 10 00 40 60",
        "602 2F 00 16 00 01 00 00 00",
        "000 01 02",
    ]);
    bus.received.clear();
    bus.receive(frame("202 0F"));
    bus.advance(2);
    let told: Vec<_> = bus.received.iter().filter(|f| f.id == 0x082).collect();
    assert!(told.len() == 1 && told[0].data[..2] == [0x10, 0x82], "{:?}", bus.received);
    assert_eq!(bus.read(0x6040, 0), 0);
    bus.received.clear();
    bus.receive(frame("202 06 00"));
    assert_eq!(bus.read(0x6040, 0), 6);
}
