//! A rack's file as the real machine: its simulation served on a wire of the operating system, and
//! commanded by the names of the file.

use std::path::{Path, PathBuf};
use std::time::Duration;

use polepair::config::Config;
use polepair::error::Exit;
use polepair::scan::{ScanAddresses, ScanReport, scan};
use polepair::simulate::{Simulation, SimulationPace, drive_lines, rack_of_file, rack_of_text};
use polepair::stop::StopOptions;
use polepair::{Connector, Error, LocalAxis};
use polepair_core::medium::Stream;
use polepair_core::profile::Signal;
use polepair_core::station::{Station, Timed as _};
use polepair_core::time::Instant;
use polepair_link::{ServeThread, socketcand};
use polepair_test_support::wait_until;

const CELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/cell.toml");

/// A served rack, and a folder with a `polepair.toml` that names its port.
struct Machine {
    folder: PathBuf,
    served: Option<ServeThread>,
}

impl Machine {
    /// Serves the rack `there` and writes `here` about it to the file, with `connect` put in.
    fn new(name: &str, there: &str, here: &str) -> Self {
        let rack = rack_of_text("rack.toml", there, 1).expect("a rack");
        let line = drive_lines(&rack, 1).expect("drives").remove(0);
        let bus = socketcand::listen("127.0.0.1:0", "can0").expect("a port");
        let at = format!("socketcand://{}/can0", bus.address().expect("an address"));
        let folder = format!("polepair-rack-{}-{name}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        std::fs::create_dir_all(&folder).expect("a folder");
        let connected = here.replacen("[[link]]", &format!("[[link]]\nconnect = '{at}'"), 1);
        std::fs::write(folder.join("polepair.toml"), connected).expect("a file");
        Self { folder, served: Some(line.serve(Box::new(bus))) }
    }

    fn connector(&self) -> Connector {
        let config = Config::discover_from(&self.folder, None);
        assert_eq!(config.broken, [], "the file is right");
        let mut connector = Connector::default();
        connector.config = config;
        connector
    }

    /// Asks the first twelve addresses.
    fn scan(&self, text: &str) -> ScanReport {
        let go = &mut |_| std::ops::ControlFlow::Continue(());
        scan(&self.connector(), text, ScanAddresses::from(1..=12), go).expect("a scan")
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        if let Some(served) = self.served.take() {
            served.handle().stop();
            served.join().expect("it served to the end");
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn cell() -> String {
    std::fs::read_to_string(CELL).expect("the example")
}

fn position(axis: &LocalAxis) -> f64 {
    axis.signals(&[Signal::Position]).expect("a position")[0].value
}

#[test]
fn names_of_a_file_move_the_real_machine() {
    let machine = Machine::new("moves", &cell(), &cell());
    let link = machine.connector().connect_local("@cell#x,y").expect("both answer");
    assert!(link.simulation().is_none());
    let [x, y] = link.axes() else { panic!("{link:?}") };
    assert_eq!((x.name(), x.number(), y.name(), y.protocol()), ("x", 5, "y", "technocan"));
    let (x, y) = (x.armed().expect("enabled"), y.armed().expect("enabled"));
    x.move_to("10 mm").expect("within");
    y.move_to("2 mm").expect("within");
    for (axis, at) in [(&x, 0.010), (&y, 0.002)] {
        axis.wait(Duration::from_secs(30)).expect("it arrives");
        assert!((position(axis) - at).abs() < 2e-4, "{}: {}", axis.label(), position(axis));
    }
    let error = y.move_to("-1 mm").expect_err("beyond its end");
    assert_eq!((error.code(), error.exit()), ("E223", Exit::Usage), "{error}");
    assert!(error.to_string().contains("polepair.toml:4"), "{error}");
}

#[test]
fn a_name_covers_all_links_of_a_file() {
    let machine = Machine::new("names", &cell(), &cell());
    let connector = machine.connector();
    let link = connector.connect_local("@machine").expect("all answer");
    let names: Vec<&str> = link.axes().iter().map(LocalAxis::name).collect();
    assert_eq!(names, ["spindle", "x", "y", "port"]);
    assert_eq!(connector.connect_local("@cell#z").expect_err("nobody").code(), "E212");
    let unknown = connector.connect_local("@cel").expect_err("nothing");
    assert!(unknown.to_string().contains("did you mean `cell`?"), "{unknown}");
    let real = connector.connect_local("@cell?time=virtual").expect_err("a real link");
    assert!(real.to_string().contains("is not supported on a real link"), "{real}");
}

#[test]
fn another_drive_than_the_files_is_refused_with_its_line() {
    let there = "[[link]]\nkind = 'can'\n[[link.drive]]\nprofile = 'tmcm-170+can'\naddress = 3\n";
    let here = there.replace("'can'\n", "'can'\nname = 'arm'\n").replace("170", "171");
    let machine = Machine::new("other", there, &here);
    let error = machine.connector().connect_local("@arm").expect_err("it is another");
    let Error::File(error) = error else { panic!("{error:?}") };
    assert!(error.reason.contains("no `tmcm-171`"), "{error}");
}

#[test]
fn a_drive_that_is_away_keeps_no_other_from_its_stop() {
    let there = cell();
    let gone = "[[link.drive]]\nname = 'gone'\nprofile = 'thruster'\naddress = 12\n";
    let machine = Machine::new("stop", &there, &format!("{there}\n{gone}"));
    let stopped =
        polepair::stop::stop(&machine.connector(), "@cell", StopOptions::default(), &mut |_| {
            std::ops::ControlFlow::Continue(())
        })
        .expect("open");
    let ended: Vec<_> = stopped.axes.iter().map(|(_, ended)| ended.is_ok()).collect();
    assert_eq!(ended, [true, true, true, true, false], "{stopped:?}");
}

#[test]
fn several_protocols_are_asked_without_harm() {
    let machine = Machine::new("scan", &cell(), &cell());
    let url = std::fs::read_to_string(machine.folder.join("polepair.toml")).expect("the file");
    let at = url.split('\'').nth(1).expect("connect").to_owned();
    let found = machine.scan(&format!("tmcl,thruster,canopen,technocan+{at}"));
    let who: Vec<(&str, u32)> =
        found.found.iter().map(|one| (one.profile.protocol, one.number)).collect();
    assert_eq!(who.len(), 4, "{who:?}");
    for one in [("canopen", 2), ("tml", 5), ("tml", 7), ("thruster", 11)] {
        assert!(who.contains(&one), "{who:?}");
    }
    assert!(found.found.iter().all(|one| one.clash.is_none()), "{found:?}");
    let text = found.tried.join("\n");
    assert!(text.contains("not thruster 2: canopen 2 is there"), "{text}");
    assert!(text.contains("not tmcl"), "{text}");
}

/// Two nodes of one number are two on a real bus, where their answers do not come at one instant.
#[test]
fn a_number_that_answers_twice_is_reported() {
    let there =
        "[[link]]\nname = 'l'\nkind = 'can'\n[[link.drive]]\nprofile = 'cia402'\naddress = 2\n";
    let machine = Machine::new("twice", there, there);
    let text = std::fs::read_to_string(machine.folder.join("polepair.toml")).expect("the file");
    let at = text.split('\'').nth(1).expect("connect").to_owned();
    let (server, bus) = at.trim_start_matches("socketcand://").split_once('/').expect("a bus");
    let twin = drive_lines(&rack_of_text("rack.toml", there, 2).expect("a rack"), 2);
    let wire = socketcand::connect(server, bus).expect("another place on the bus");
    let twin = twin.expect("a drive").remove(0).serve(Box::new(wire));
    // The second answer may come after the scan has gone on, where the machine is busy.
    wait_until("the scan reports two drives with this address", || {
        let found = machine.scan(&format!("canopen+{at}")).found;
        assert_eq!(found.iter().map(|one| one.number).collect::<Vec<_>>(), [2]);
        found[0]
            .clash
            .as_deref()
            .is_some_and(|clash| clash.contains("two drives with this address"))
    });
    twin.handle().stop();
    twin.join().expect("it served to the end");
}

/// The planned load of a rack's bus is the real one: without SYNC and PDOs, which are not sent here, the
/// bus' own measure holds for each master.
#[test]
fn a_bus_is_as_busy_as_was_counted() {
    let rack = rack_of_file(Path::new(CELL), 1).expect("a rack");
    let simulation = Simulation::new(&rack, 1, SimulationPace::Virtual).expect("drives");
    let (bus_load_range, busy) = simulation.load(0).expect("a CAN bus");
    assert!(
        (0.40..0.50).contains(&bus_load_range.least) && bus_load_range.most < 0.56,
        "{bus_load_range}"
    );
    assert!(busy.abs() < 1e-9, "{busy}");
    let url = format!("sim:{CELL}?time=virtual#port");
    let link = Connector::default().connect_local(&url).expect("a drive");
    let simulation = link.simulation().expect("simulated").clone();
    let (begin, (_, before)) = (simulation.now(), simulation.load(0).expect("a bus"));
    for _ in 0..1000 {
        link.axes()[0].get("faults").expect("read");
        link.sleep(Duration::from_millis(5));
    }
    let (end, (_, after)) = (simulation.now(), simulation.load(0).expect("a bus"));
    let (begin, end) = (begin.0 as f64, end.0 as f64);
    let share = (after * end - before * begin) / (end - begin);
    // A question of two bytes and an answer of four to eight, at most 200 times a second.
    assert!((0.01..0.05).contains(&share), "{share}");
}

/// `[[link.drive.act]]`: at its time something is done to the drive, and not before.
#[test]
fn a_rack_does_things_to_its_drives_at_given_times() {
    let file = std::env::temp_dir().join(format!("polepair-acts-{}.toml", std::process::id()));
    let rack = |act: &str| {
        let drive = "[[link]]\n[[link.drive]]\nname = 'x'\nprofile = 'tmcm-171'\n";
        format!("{drive}[[link.drive.act]]\n{act}\n")
    };
    std::fs::write(&file, rack("at = '2 s'\ndo = 'supply=7 V'")).expect("a file");
    let url = format!("sim:{}?time=virtual#x", file.display());
    let link = Connector::default().connect_local(&url).expect("a drive");
    link.sleep(Duration::from_millis(1900));
    let fault = || link.axes()[0].signals(&[Signal::Fault]).expect("read")[0].raw;
    assert_eq!(fault(), 0);
    link.sleep(Duration::from_millis(200));
    assert_ne!(fault(), 0, "the supply is too low");
    for (act, reason) in [
        ("at = '2 s'\ndo = 'bogus'", "`bogus` is nothing that can be done"),
        ("at = 'soon'\ndo = 'jam'", "`soon` is no time"),
        ("at = '2 s'", "an act needs `do`"),
        ("at = '2 s'\ndo = 'sto'", "it has nothing for one of its acts"),
    ] {
        std::fs::write(&file, rack(act)).expect("a file");
        let error = Connector::default().connect_local(&url).expect_err("refused").to_string();
        assert!(error.contains(reason), "{act}: {error}");
    }
    std::fs::remove_file(&file).expect("a file");
}

/// Bytes that drives on a line send within 300 ms after these.
fn replies(rack: &str, request: &[u8]) -> Vec<u8> {
    let rack = rack_of_text("rack.toml", rack, 1).expect("a rack");
    let mut line = drive_lines(&rack, 1).expect("drives").remove(0);
    let (mut now, mut sent, mut out) = (Instant::ZERO.plus_ms(100), Vec::new(), [0; 520]);
    Station::<Stream>::handle_input(&mut line, now, request);
    let end = now.plus_ms(300);
    while now < end {
        while let Some(len) = Station::<Stream>::poll_transmit(&mut line, now, &mut out) {
            sent.extend_from_slice(&out[..len]);
        }
        now = line.poll_timeout().unwrap_or(end).max(now.plus_ns(1000)).min(end);
        line.handle_timeout(now);
    }
    sent
}

/// On a half-duplex line the drives of a group reply at once, so no reply survives.
#[test]
fn replies_of_a_group_collide_on_a_served_line() {
    let drive = |axis| format!("[[link.drive]]\nprofile = 'technosoft-f514l'\naddress = {axis}\n");
    let line = |drives: &str| format!("[[link]]\nname = 'l'\nduplex = 'half'\n{drives}");
    // GiveMeData2 APOS to group 1, from 254 (TML communication manual, chapter 3).
    let request = [0x08, 0x10, 0x10, 0xB2, 0x05, 0x0F, 0xE0, 0x02, 0x28, 0xF8];
    let alone = replies(&line(&drive(1)), &request);
    // TakeData2 from axis 1: its opcode is D5h and the axis.
    assert!(alone.windows(2).any(|pair| pair == [0xD5, 0x01]), "{alone:02X?}");
    let both = replies(&line(&(drive(1) + &drive(2))), &request);
    assert!(!both.windows(alone.len()).any(|part| part == alone), "{both:02X?}");
    assert!(!both.is_empty(), "their noise arrives");
}
