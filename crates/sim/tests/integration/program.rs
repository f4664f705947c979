//! Programs on their way into drives, in virtual time: on every wire, and with what goes wrong on it.

use polepair_core::axis::{Axes, Command, ProgramEnd, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::{CanLine, MediumKind};
use polepair_core::profile::Profile;
use polepair_core::program::{MemoryBlock, TransferKind};
use polepair_core::program::{ProgramCommand, ProgramLabel, ProgramLanguage, TransferProgress};
use polepair_core::proto::tml::program::TmlLanguage;
use polepair_core::proto::{HostOptions, SerialStandard};
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_drives::surroundings::{Act, GroundTruth};
use polepair_drives::technosoft::{Device, Technosoft};
use polepair_drives::{DeviceOptions, Family};
use polepair_sim::can_bus::CanFaults;
use polepair_sim::fault::SerialFaults;
use polepair_sim::host;
use polepair_sim::node::{CAN_PORT, DriveNode, SERIAL_PORT};
use polepair_sim::random::Ppm;
use polepair_sim::serial_line::SerialWireConfig;
use polepair_sim::world::{NodeId, WireId, World};

const BIT_RATE: u32 = 500_000;
const RAM: u16 = 0x8270;
const EEPROM: u16 = 0x4000;

/// Powers the motor, moves it, and calls what moves it back.
const MOVES: &str = "\
BEGIN
    ENDINIT; TPOS = APOS; AXISON
    CSPD = 30; CACC = 0.5
    CPOS = 20000L; CALL move
    VAR_I1 = 77
    END
back: CPOS = 0L; CALL move; RET
move: MODE PP; CPA; TUM1; UPD; !MC; WAIT!; RET
";

fn profile() -> &'static Profile {
    Technosoft::profiles()[0]
}

fn device(address: u32, extra: &[(&str, &str)]) -> Box<DriveNode<Device>> {
    let options = DeviceOptions {
        address: Some(address),
        wires: &["tml", "tmlcan"],
        standard: None,
        untimed: false,
        seed: 1,
        extra,
    };
    Box::new(DriveNode(Technosoft::create_device(profile(), &options).unwrap()))
}

/// A world with one host and some drives; the one that is programmed is the last.
struct Bench {
    world: World,
    host: NodeId,
    drives: Vec<NodeId>,
    wire: WireId,
    axis: AxisIndex,
    tickets: u32,
}

impl Bench {
    /// Drives on RS-232, or on a CAN bus; more than one on both: a relay and who is behind it.
    fn new(protocol: &str, bus: &str, axes: &[u32], seed: u64) -> Self {
        let mut world = World::new(seed);
        let can = world.add_can(CanLine { bit_rate: BIT_RATE });
        let (medium, wire, options) = match protocol {
            "tml" => (
                MediumKind::Serial,
                world.add_serial(SerialWireConfig::RS232),
                HostOptions::new(9600),
            ),
            _ => (MediumKind::Can, can, HostOptions::new(BIT_RATE)),
        };
        let named: Vec<_> = axes.iter().map(|axis| (profile(), *axis)).collect();
        let host = world.add_node(host::host_lane(protocol, medium, options, &named).unwrap());
        world.plug_host(wire, host, 0);
        let mut drives = Vec::new();
        for (n, axis) in axes.iter().enumerate() {
            let drive = world.add_node(device(*axis, &[("can", bus)]));
            if protocol == "tml" && n == 0 {
                world.plug_drive(wire, drive, SERIAL_PORT);
            }
            world.plug_drive(can, drive, CAN_PORT);
            drives.push(drive);
        }
        Self::of(world, host, drives, wire)
    }

    fn rs485(axes: &[u32]) -> Self {
        let mut world = World::new(1);
        let wire = world.add_serial(SerialWireConfig::RS485);
        let options =
            HostOptions { standard: Some(SerialStandard::Rs485), ..HostOptions::new(9600) };
        let named: Vec<_> = axes.iter().map(|axis| (profile(), *axis)).collect();
        let host =
            world.add_node(host::host_lane("tml", MediumKind::Serial, options, &named).unwrap());
        world.plug_host(wire, host, 0);
        let mut drives = Vec::new();
        for axis in axes {
            let drive = world.add_node(device(*axis, &[("wire", "rs485")]));
            world.plug_drive(wire, drive, SERIAL_PORT);
            drives.push(drive);
        }
        Self::of(world, host, drives, wire)
    }

    fn of(world: World, host: NodeId, drives: Vec<NodeId>, wire: WireId) -> Self {
        let axis = AxisIndex(drives.len() as u8 - 1);
        let mut bench = Self { world, host, drives, wire, axis, tickets: 0 };
        bench.wait(50);
        bench
    }

    fn wait(&mut self, ms: u32) {
        let until = self.world.now().plus_ms(ms);
        self.world.run_until(until);
    }

    fn axes<R>(&mut self, f: impl FnOnce(&mut dyn Axes, Instant) -> R) -> R {
        self.world.with_node(self.host, |node, now| f(node.axes().unwrap(), now))
    }

    fn begin(
        &mut self,
        start: impl FnOnce(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>,
    ) -> Result<Ticket, Unsupported> {
        self.tickets += 1;
        let ticket = Ticket(self.tickets);
        let axis = self.axis;
        self.axes(|axes, now| {
            axes.set_armed(axis, true);
            start(axes, now, ticket).map(|()| ticket)
        })
    }

    /// Lives on until that has ended.
    fn end(&mut self, ticket: Ticket) -> Outcome {
        let limit = self.world.now().plus_ms(700_000);
        while self.world.now() < limit {
            self.world.step();
            while let Some((ended, outcome)) = self.axes(|axes, _| axes.poll_outcome()) {
                if ended == ticket {
                    return outcome;
                }
            }
        }
        panic!("nothing ended")
    }

    fn transfer(&mut self, kind: TransferKind, pieces: &[MemoryBlock]) -> Outcome {
        let axis = self.axis;
        let started =
            self.begin(|axes, now, ticket| axes.start_transfer(now, ticket, axis, kind, pieces));
        let ticket = started.unwrap();
        self.end(ticket)
    }

    fn write(&mut self, start: u16, words: &[u16]) -> Outcome {
        self.transfer(TransferKind::Write, &[piece(start, words)])
    }

    fn verify(&mut self, start: u16, words: &[u16]) -> Outcome {
        self.transfer(TransferKind::Verify, &[piece(start, words)])
    }

    fn read(&mut self, start: u16, count: usize) -> Vec<u16> {
        let outcome = self.transfer(TransferKind::Read, &[piece(start, &vec![0; count])]);
        assert_eq!(outcome, Outcome::Done(count as i64));
        let axis = self.axis;
        self.axes(|axes, _| axes.last_transfer(axis).unwrap().blocks()[0].words.clone())
    }

    fn progress(&mut self) -> TransferProgress {
        let axis = self.axis;
        self.axes(|axes, _| axes.last_transfer(axis).unwrap().progress())
    }

    fn order(&mut self, command: ProgramCommand) -> Outcome {
        let axis = self.axis;
        let started =
            self.begin(|axes, now, ticket| axes.send_program_command(now, ticket, axis, command));
        let ticket = started.unwrap();
        self.end(ticket)
    }

    fn calls(&mut self) -> bool {
        matches!(self.order(ProgramCommand::QueryCall), Outcome::Done(raw) if raw & 0x0100 != 0)
    }

    fn verb(&mut self, verb: Verb) -> Outcome {
        let (axis, command) = (self.axis, Command::new(verb));
        let started = self.begin(|axes, now, ticket| axes.command(now, ticket, axis, command));
        let ticket = started.unwrap();
        self.end(ticket)
    }

    fn drive(&self) -> NodeId {
        *self.drives.last().unwrap()
    }

    fn truth(&mut self) -> GroundTruth {
        let drive = self.drive();
        self.world.inspect(drive, |node, now| node.surroundings().unwrap().ground_truth(now))
    }

    fn power_cycle(&mut self) {
        let drive = self.drive();
        assert!(
            self.world.with_node(drive, |node, now| node
                .surroundings()
                .unwrap()
                .act(now, Act::PowerCycle))
        );
    }

    fn flash_writes(&mut self) -> u32 {
        let axis = self.axis;
        self.axes(|axes, _| axes.state(axis).unwrap().flash_writes)
    }
}

fn piece(start: u16, words: &[u16]) -> MemoryBlock {
    MemoryBlock { start, words: words.to_vec() }
}

/// Words of a text, and the address of its label `back`.
fn assemble(text: &str, origin: u16) -> (Vec<u16>, u16) {
    let (mut words, mut labels) = ([0; 256], [ProgramLabel::default(); 8]);
    let made =
        TmlLanguage.assemble(text, origin, Some(profile()), &mut words, &mut labels).unwrap();
    let back = labels.iter().find(|label| label.name == "back").map_or(0, |label| label.address);
    (words[..made.words].to_vec(), back)
}

/// Powers the motor, and moves it there and back for ever.
const LOOP: &str = "\
    ENDINIT; TPOS = APOS; AXISON
    CSPD = 30; CACC = 0.5
loop: CPOS = 20000L; CALL move
    CPOS = 0L; CALL move
    GOTO loop
move: MODE PP; CPA; TUM1; UPD; !MC; WAIT!; RET
";

/// Words without a pattern.
fn noise(count: u16) -> Vec<u16> {
    (0..count).map(|n| n.wrapping_mul(0x9E37).rotate_left(u32::from(n) % 13)).collect()
}

const fn hint(outcome: Outcome) -> Option<&'static str> {
    match outcome {
        Outcome::NotDone(Failure::NotReady { hint }) => Some(hint),
        _ => None,
    }
}

fn wires() -> [(&'static str, Bench); 6] {
    [
        ("RS-232", Bench::new("tml", "tmlcan", &[1], 1)),
        ("relay to TMLCAN", Bench::new("tml", "tmlcan", &[255, 1], 1)),
        ("relay to TechnoCAN", Bench::new("tml", "technocan", &[255, 1], 1)),
        ("RS-485", Bench::rs485(&[5, 1])),
        ("TMLCAN", Bench::new("tmlcan", "tmlcan", &[1], 1)),
        ("TechnoCAN", Bench::new("technocan", "technocan", &[1], 1)),
    ]
}

#[test]
fn a_program_is_loaded_run_called_and_aborted_on_every_wire() {
    for (name, mut bench) in wires() {
        let (words, back) = assemble(MOVES, RAM);
        let count = words.len() as i64;
        assert_eq!(bench.write(RAM, &words), Outcome::Done(count), "{name}");
        assert_eq!(bench.progress().repeated, 0, "{name}");
        assert_eq!(bench.read(RAM, words.len()), words, "{name}");
        assert_eq!(bench.flash_writes(), 0, "{name}");
        assert!(matches!(bench.order(ProgramCommand::Goto(RAM)), Outcome::Done(_)), "{name}");
        bench.wait(3000);
        // 20000 counts are ten turns.
        let turned = bench.truth().position / std::f64::consts::TAU;
        assert!((turned - 10.0).abs() < 0.05, "{name}: {turned}");
        let axis = bench.axis;
        let transfer = bench.write(RAM, &words);
        assert!(hint(transfer).is_some_and(|hint| hint.contains("has power")), "{name}");
        // The way back is cut short.
        assert!(matches!(bench.order(ProgramCommand::Call(back)), Outcome::Done(_)), "{name}");
        assert!(bench.calls(), "{name}");
        bench.wait(200);
        assert!(bench.truth().velocity < -1.0, "{name}");
        for command in [ProgramCommand::Abort, ProgramCommand::End] {
            assert!(matches!(bench.order(command), Outcome::Done(_)), "{name}: {command:?}");
        }
        assert!(!bench.calls(), "{name}");
        assert!(matches!(bench.verb(Verb::Stop), Outcome::Done(_)), "{name}");
        let stopped = bench.truth();
        bench.wait(1000);
        assert!((bench.truth().position - stopped.position).abs() < 0.05, "{name}: it stays");
        assert!(stopped.position > 1.0, "{name}: on its way");
        let unarmed = bench.axes(|axes, now| {
            axes.set_armed(axis, false);
            axes.send_program_command(now, Ticket(9999), axis, ProgramCommand::Goto(RAM))
        });
        assert_eq!(unarmed, Err(Unsupported::NotArmed), "{name}");
    }
}

#[test]
fn a_stop_ends_the_program_that_would_move_the_motor_again() {
    for (name, mut bench) in wires() {
        let (words, _) = assemble(LOOP, RAM);
        assert_eq!(bench.write(RAM, &words), Outcome::Done(words.len() as i64), "{name}");
        for (verb, keep_program, after_ms) in
            [(Verb::Stop, false, 350), (Verb::QuickStop, false, 1100), (Verb::Stop, true, 700)]
        {
            assert!(matches!(bench.order(ProgramCommand::Goto(RAM)), Outcome::Done(_)), "{name}");
            bench.wait(after_ms);
            assert!(bench.truth().velocity.abs() > 1.0, "{name}: it turns");
            let (axis, command) = (bench.axis, Command { keep_program, ..Command::new(verb) });
            let ticket = bench.begin(|axes, now, ticket| axes.command(now, ticket, axis, command));
            let ticket = ticket.unwrap();
            if keep_program {
                bench.wait(3000);
                assert!(bench.truth().velocity.abs() > 1.0, "{name}: its program was kept");
                assert!(matches!(bench.order(ProgramCommand::End), Outcome::Done(_)), "{name}");
                continue;
            }
            assert!(matches!(bench.end(ticket), Outcome::Done(_)), "{name}");
            let (stood, found) = (
                bench.truth().position,
                bench.axes(|axes, _| axes.state(axis).unwrap().program_end),
            );
            assert_eq!(found, Some(ProgramEnd::MayHaveRun), "{name}");
            bench.wait(3000);
            assert!((bench.truth().position - stood).abs() < 0.05, "{name}: it stays");
        }
    }
}

#[test]
fn permanent_memory_is_written_once_counted_and_outlives_the_power() {
    for (name, mut bench) in wires() {
        let (words, _) = assemble(MOVES, EEPROM);
        let written = words.len() as u32 + 1; // the END that stands guard
        assert_eq!(bench.write(EEPROM, &words), Outcome::Done(written.into()), "{name}");
        assert_eq!(bench.flash_writes(), written, "{name}");
        assert_eq!(bench.truth().flash_writes, u64::from(written), "{name}");
        assert_eq!(bench.write(RAM, &words), Outcome::Done(words.len() as i64), "{name}");
        assert_eq!(bench.truth().position, 0.0, "{name}: written is not run");
        bench.power_cycle();
        bench.wait(3000);
        assert!(bench.truth().position > 62.0, "{name}: it starts by itself");
        assert_eq!(bench.verify(EEPROM, &words), Outcome::Done(words.len() as i64), "{name}");
        let lost =
            Failure::Differs { start: RAM.into(), end: u32::from(RAM) + words.len() as u32 - 1 };
        assert_eq!(bench.verify(RAM, &words), Outcome::NotDone(lost), "{name}");
    }
}

#[test]
fn a_download_that_is_cut_short_leaves_nothing_that_starts_by_itself() {
    let mut bench = Bench::new("tml", "tmlcan", &[1], 1);
    let (words, _) = assemble(MOVES, EEPROM);
    assert!(matches!(bench.write(EEPROM, &words), Outcome::Done(_)));
    let axis = bench.axis;
    let pieces = [piece(EEPROM, &words)];
    let kind = TransferKind::Write;
    let started =
        bench.begin(|axes, now, ticket| axes.start_transfer(now, ticket, axis, kind, &pieces));
    let ticket = started.unwrap();
    while bench.progress().done < 9 {
        bench.world.step();
    }
    let busy = bench
        .begin(|axes, now, ticket| axes.command(now, ticket, axis, Command::new(Verb::Enable)));
    assert_eq!(busy, Err(Unsupported::Busy), "nothing powers the axis meanwhile");
    bench.world.set_wire_down(bench.wire, true);
    assert_eq!(bench.end(ticket), Outcome::Unknown(Failure::LinkDown));
    bench.world.set_wire_down(bench.wire, false);
    bench.power_cycle();
    bench.wait(2000);
    assert_eq!(bench.truth().position, 0.0);
    assert!(!bench.truth().enabled);
    assert!(matches!(bench.write(EEPROM, &words), Outcome::Done(_)), "and it can be loaded again");
}

#[test]
fn a_stop_overtakes_a_download_and_ends_it() {
    let mut bench = Bench::new("tml", "tmlcan", &[1], 1);
    let (axis, pieces) = (bench.axis, [piece(RAM, &noise(200))]);
    let kind = TransferKind::Write;
    let started =
        bench.begin(|axes, now, ticket| axes.start_transfer(now, ticket, axis, kind, &pieces));
    let ticket = started.unwrap();
    while bench.progress().done < 20 {
        bench.world.step();
    }
    let twice =
        bench.begin(|axes, now, ticket| axes.start_transfer(now, ticket, axis, kind, &pieces));
    assert_eq!(twice, Err(Unsupported::Busy));
    let stop = Command::new(Verb::Stop);
    bench.begin(|axes, now, ticket| axes.command(now, ticket, axis, stop)).unwrap();
    assert_eq!(bench.end(ticket), Outcome::Unknown(Failure::Cancelled));
}

#[test]
fn a_running_or_locked_program_is_not_overwritten() {
    let mut bench = Bench::new("tml", "tmlcan", &[1], 1);
    let (words, _) = assemble("BEGIN; loop: GOTO loop", EEPROM);
    assert!(matches!(bench.write(EEPROM, &words), Outcome::Done(_)));
    bench.power_cycle();
    bench.wait(10);
    let outcome = bench.write(EEPROM, &words);
    assert!(hint(outcome).is_some_and(|hint| hint.contains("AUTORUN")), "{outcome:?}");
    assert!(matches!(bench.order(ProgramCommand::End), Outcome::Done(_)));
    let axis = bench.axis;
    let lock =
        bench.begin(|axes, now, ticket| axes.send_text(now, ticket, axis, "LOCKEEPROM 3")).unwrap();
    assert!(matches!(bench.end(lock), Outcome::Done(_)));
    let differs = Failure::Differs { start: EEPROM.into(), end: EEPROM.into() };
    assert_eq!(bench.write(EEPROM, &words), Outcome::Unknown(differs), "the drive's sum tells");
    for (start, words) in [(0x0200, &words[..]), (0x7FFF, &words[..]), (RAM, &[])] {
        let kind = TransferKind::Write;
        let pieces = [piece(start, words)];
        let refused =
            bench.begin(|axes, now, ticket| axes.start_transfer(now, ticket, axis, kind, &pieces));
        assert!(refused.is_err(), "{start:04X}");
    }
}

/// After a transfer on a bad wire, the drive has the words or the outcome states that it may not.
fn judge(bench: &mut Bench, outcome: Outcome, words: &[u16], start: u16) -> bool {
    if let Some(faults) = bench.world.serial_faults(bench.wire) {
        *faults = SerialFaults::NONE;
    }
    bench.wait(2000);
    let done = matches!(outcome, Outcome::Done(_));
    if done {
        assert_eq!(bench.read(start, words.len()), words, "told as done");
    } else {
        assert!(matches!(outcome, Outcome::Unknown(_) | Outcome::NotDone(_)));
        assert!(matches!(bench.write(start, words), Outcome::Done(_)), "and it can be done again");
        assert_eq!(bench.read(start, words.len()), words);
    }
    done
}

#[test]
fn lost_acknowledgements_and_damaged_bytes_leave_no_wrong_word_untold() {
    let (mut whole, mut repeated, mut made) = (0, 0, 0);
    let kinds: [fn(&mut SerialFaults); 4] = [
        |faults| faults.lose_reply = Ppm(30_000),
        |faults| faults.lose_request = Ppm(20_000),
        |faults| faults.flip = Ppm(2_000),
        |faults| (faults.lose, faults.insert) = (Ppm(1_000), Ppm(1_000)),
    ];
    for seed in 0..16 {
        for (n, kind) in kinds.iter().enumerate() {
            let behind = seed % 2 == 1;
            let axes: &[u32] = if behind { &[255, 1] } else { &[1] };
            let mut bench = Bench::new("tml", "tmlcan", axes, seed);
            kind(bench.world.serial_faults(bench.wire).unwrap());
            let start = if n % 2 == 0 { RAM } else { EEPROM };
            let words = noise(120);
            let outcome = bench.write(start, &words);
            repeated += bench.progress().repeated;
            let wire = bench.world.injected_faults(bench.wire);
            made += wire.bytes + wire.requests_lost + wire.replies_lost;
            if start == EEPROM {
                let max = u64::from(bench.flash_writes());
                assert!(bench.truth().flash_writes <= max, "every write is counted");
            }
            whole += u32::from(judge(&mut bench, outcome, &words, start));
        }
    }
    assert!(made > 100 && repeated > 4, "something happened: {made} faults, {repeated} words");
    assert!(whole > 32, "most downloads get through: {whole} of 64");
}

#[test]
fn frames_that_are_lost_or_taken_twice_on_can_leave_no_wrong_word_untold() {
    let (mut whole, mut repeated) = (0, 0);
    for seed in 0..24 {
        let bus = if seed % 2 == 0 { "tmlcan" } else { "technocan" };
        let mut bench = Bench::new(bus, bus, &[1], seed);
        let faults = bench.world.can_faults(bench.wire).unwrap();
        (faults.lose, faults.last_bit) = (Ppm(10_000), Ppm(3_000));
        let start = if seed % 3 == 0 { EEPROM } else { RAM };
        let words = noise(120);
        let outcome = bench.write(start, &words);
        repeated += bench.progress().repeated;
        *bench.world.can_faults(bench.wire).unwrap() = CanFaults::default();
        whole += u32::from(judge(&mut bench, outcome, &words, start));
    }
    assert!(repeated > 4, "{repeated} words");
    assert!(whole > 12, "most downloads get through: {whole} of 24");
}

#[test]
fn a_lost_acknowledgement_is_no_reason_to_write_twice() {
    let mut bench = Bench::new("tml", "tmlcan", &[1], 3);
    bench.world.serial_faults(bench.wire).unwrap().lose_reply = Ppm(40_000);
    let words = noise(80);
    let outcome = bench.write(0x5000, &words);
    assert!(bench.world.injected_faults(bench.wire).replies_lost > 2);
    assert!(matches!(outcome, Outcome::Done(_)), "{outcome:?}");
    // The wire loses replies and no requests: each word was written once.
    assert_eq!((bench.progress().repeated, bench.truth().flash_writes), (0, 80));
}
