//! The library against simulated drives, in virtual time.

use polepair::connect_local;
use polepair::error::Exit;
use polepair::scan::{ScanAddresses, scan};
use polepair::simulate::{Simulation, SimulationPace, rack_of_text, rack_of_words};
use polepair::{Connector, Error, Identification, LocalAxis};
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use std::time::Duration;

#[test]
fn a_simulated_drive_is_identified_and_read_by_name() {
    let link = connect_local("sim:syntron-ts?time=virtual#1").unwrap();
    let axis = link.axis(1).unwrap();
    assert_eq!(axis.profile().name, "syntron-ts");
    assert!(matches!(axis.identified(), Identification::Queried { .. }));
    assert_eq!(axis.get("Fn_00").unwrap().to_string(), "position by pulses");
    assert_eq!(axis.get_raw("alarm code").unwrap(), 0);
    let error = axis.get("controll mode").unwrap_err();
    assert_eq!(error.code(), "E213");
    assert!(error.to_string().contains("did you mean `control mode`?"), "{error}");
    assert!(link.axis(2).unwrap_err().hint().contains("axis 1"));
}

#[test]
fn both_modbus_encodings_reach_the_same_drive() {
    for url in ["sim:modbus-rtu?time=virtual", "sim:modbus-ascii?time=virtual"] {
        let link = connect_local(url).unwrap();
        assert_eq!(link.axes()[0].get_raw("control mode").unwrap(), 2, "{url}");
    }
}

#[test]
fn a_value_outside_its_limits_is_refused_before_a_byte_is_sent() {
    let link = connect_local("sim:syntron-ts?time=virtual").unwrap();
    let axis = &link.axes()[0];
    let before = link.counters(axis).sent;
    let error = axis.set_raw("control mode", 21).unwrap_err();
    assert_eq!((error.code(), error.exit(), error.executed()), ("E216", Exit::Usage, Some(false)));
    assert_eq!(axis.set("alarm code", 1).unwrap_err().code(), "E214");
    assert_eq!(axis.velocity("60 rpm").unwrap_err().code(), "E219");
    assert_eq!(axis.set("control mode", "3 A").unwrap_err().code(), "E217");
    assert_eq!(link.counters(axis).sent, before);
}

#[test]
fn a_word_sets_a_value_and_a_rehearsal_sends_nothing() {
    let link = connect_local("sim:syntron-ts?time=virtual").unwrap();
    let axis = &link.axes()[0];
    let before = link.counters(axis).sent;
    let steps = axis.rehearse(Command::new(Verb::Disable)).unwrap();
    assert!(!steps.is_empty() && steps.iter().any(|step| !step.bytes.is_empty()));
    assert_eq!(link.counters(axis).sent, before);
    axis.arm(true);
    axis.set("Fn_00", "internal speed").unwrap();
    assert_eq!(axis.get_raw("Fn_00").unwrap(), 1);
    assert!(axis.signals(&[Signal::Mode, Signal::Fault]).unwrap().iter().all(|r| r.at.is_some()));
}

#[test]
fn a_drive_that_is_not_ready_says_what_to_do() {
    let link = connect_local("sim:syntron-ts?time=virtual").unwrap();
    let error = link.axes()[0].armed().map(drop).unwrap_err();
    assert_eq!((error.code(), error.exit()), ("E602", Exit::Refused));
    assert!(error.hint().contains("Fn_00"), "{error}: {}", error.hint());
    assert!(!link.axes()[0].state().armed);
}

#[test]
fn a_scan_finds_who_is_there_and_says_what_it_tried() {
    let connector = Connector::default();
    let url = "sim:syntron-ts?axes=3&time=virtual";
    let mut requested = 0;
    let scan = scan(&connector, url, 1..=5, &mut |_| {
        requested += 1;
        std::ops::ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(requested, 5);
    let numbers: Vec<u32> = scan.found.iter().map(|found| found.number).collect();
    assert_eq!(numbers, [1, 2, 3]);
    assert!(scan.found.iter().all(|found| found.profile.name == "syntron-ts"));
    assert!(scan.found.iter().all(|found| found.clash.is_none()), "{:?}", scan.found);
    assert!(scan.tried[0].contains("addresses 1 to 5"), "{:?}", scan.tried);
}

#[test]
fn a_silent_address_is_an_error_that_says_so() {
    let rack = "sim:syntron-ts:3?time=virtual";
    assert_eq!(connect_local(rack).unwrap().axes()[0].number(), 3);
    let connector = Connector::default();
    let none = scan(&connector, rack, 4..=5, &mut |_| std::ops::ControlFlow::Continue(())).unwrap();
    assert!(none.found.is_empty());
    let all =
        scan(&connector, rack, ScanAddresses::ALL, &mut |_| std::ops::ControlFlow::Continue(()))
            .unwrap();
    assert_eq!(all.found.len(), 1);
}

#[test]
fn threads_share_a_link() {
    let link = connect_local("sim:syntron-ts?axes=2&time=virtual").unwrap();
    std::thread::scope(|scope| {
        for axis in link.axes() {
            scope.spawn(move || {
                for _ in 0..20 {
                    assert_eq!(axis.get_raw("control mode").unwrap(), 2);
                }
            });
        }
    });
}

/// A register map that no shipped profile knows, tried on a drive that has registers there.
const UNKNOWN: &str = r#"
name = "acme-7"
protocol = "modbus"
title = "Acme 7"
axis = "rotary"

[[parameter]]
name = "what it follows"
index = 0x0000
max = 3
values = { 2 = "pulses", 1 = "registers" }

[[parameter]]
name = "set speed"
index = 0x0033
encoding = "i16"
unit = "rpm"
min = -3000
max = 3000

[plans.stop]
steps = ["write set speed = 0"]
"#;

#[test]
fn a_users_file_makes_an_unknown_drive_speak_by_name() {
    let folder = std::env::temp_dir().join(format!("polepair-acme-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("acme-7.toml");
    std::fs::write(&file, UNKNOWN).unwrap();
    let connector = Connector::default().with_profile(&file).unwrap();
    let link = connector.connect_local("sim:modbus-rtu?time=virtual&profile=acme-7").unwrap();
    let axis = &link.axes()[0];
    assert_eq!((axis.profile().name, axis.identified()), ("acme-7", &Identification::Named));
    assert_eq!(axis.get("What-It-Follows").unwrap().to_string(), "pulses");
    axis.set("set speed", "-150 rpm").unwrap();
    assert_eq!(axis.get("set speed").unwrap().to_string(), "-150 rpm");
    let error = axis.set("set speed", "4000 rpm").unwrap_err();
    assert!(error.hint().contains("-3000 rpm to 3000 rpm"), "{error}: {}", error.hint());
    axis.stop().unwrap();
    assert_eq!(axis.get_raw("set speed").unwrap(), 0);
    axis.arm(true);
    assert_eq!(axis.velocity(1.0).unwrap_err().code(), "E218");
    let error = connector.connect_local("sim:modbus-rtu?time=virtual&profile=acme-8").unwrap_err();
    assert!(error.to_string().contains("did you mean `acme-7`?"), "{error}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_rack_file_has_named_drives_on_several_links() {
    let text = "[[link]]\nname = \"a\"\nbaud = 115200\n[[link.drive]]\nname = \"x\"\n\
                profile = \"syntron-ts\"\naddress = 4\nload = 0.1\n[[link]]\nname = \"b\"\n\
                protocol = \"modbus-ascii\"\n[[link.drive]]\nname = \"y\"\n\
                profile = \"syntron-ts\"\naddress = 4\n";
    let file = std::env::temp_dir().join(format!("polepair-rack-{}.toml", std::process::id()));
    std::fs::write(&file, text).unwrap();
    let link = connect_local(&format!("sim:{}?time=virtual", file.display())).unwrap();
    assert_eq!(link.axes().len(), 2);
    assert_eq!(link.axis_named("y").unwrap().protocol(), "modbus-ascii");
    assert_eq!(link.axis_named("x").unwrap().get_raw("control mode").unwrap(), 2);
    assert_eq!(link.axis(4).unwrap_err().code(), "E212");
    std::fs::remove_file(&file).unwrap();

    for (from, to, output) in [
        ("syntron-ts", "syntron-tx", "did you mean `syntron-ts`?"),
        ("modbus-ascii", "modbus-asci", "did you mean `modbus-ascii`?"),
        ("load = 0.1", "laod = 0.1", "rack.toml:8:1: unknown key `laod`; did you mean `load`?"),
        ("baud = 115200", "baud = 115200\nfaults = { flip = 2 }", "it must be 0 to 1"),
        ("name = \"a\"", "duplex = \"both\"", "neither half nor full"),
    ] {
        assert!(text.contains(from), "{from}");
        let error = rack_of_text("rack.toml", &text.replacen(from, to, 1), 1).unwrap_err();
        assert!(error.to_string().contains(output), "{error}");
    }
}

#[test]
fn words_make_racks() {
    let rack = rack_of_words(&["modbus-rtu:1,2", "syntron-ds102:7"], 1).unwrap();
    assert_eq!(rack.rack.links.len(), 2);
    assert_eq!(rack.rack.links[0].drives[1].address, Some(2));
    assert_eq!(rack.rack.links[1].drives[0].profile.name, "syntron-ds102");
    assert!(rack_of_words(&["modbus-rtu:one"], 1).is_err());
    let error = rack_of_words(&["modbus-rtx"], 1).unwrap_err();
    assert!(error.to_string().contains("did you mean `modbus-rtu`?"), "{error}");
    let simulation = Simulation::new(&rack, 1, SimulationPace::Virtual).unwrap();
    assert!(simulation.truth(0, 1).is_some() && simulation.truth(0, 2).is_none());
    let before = simulation.now();
    simulation.advance(Duration::from_millis(5));
    assert_eq!(simulation.now().since(before), Duration::from_millis(5));
}

#[test]
fn real_time_passes_as_on_the_wall() {
    let link = connect_local("sim:modbus-rtu").unwrap();
    let simulation = link.simulation().unwrap();
    let before = simulation.now();
    assert_eq!(link.axes()[0].get_raw("control mode").unwrap(), 2);
    link.sleep(Duration::from_millis(20));
    assert!(simulation.now().since(before) >= Duration::from_millis(20));
}

#[test]
fn named_links_are_looked_up_from_the_folder_upward() {
    let folder = std::env::temp_dir().join(format!("polepair-config-{}", std::process::id()));
    let deep = folder.join("a/b");
    std::fs::create_dir_all(&deep).unwrap();
    let text = "[links]\narm = \"sim:modbus-rtu?time=virtual&seed=3#1\"\n";
    std::fs::write(folder.join("polepair.toml"), text).unwrap();
    let config = polepair::config::Config::discover_from(&deep, None);
    let expanded = |text: &str| config.expand(text).unwrap();
    assert_eq!(expanded("@arm"), "sim:modbus-rtu?time=virtual&seed=3#1");
    assert_eq!(expanded("@arm?seed=4#2"), "sim:modbus-rtu?time=virtual&seed=4#2");
    assert_eq!(expanded("sim:tmcl"), "sim:tmcl");
    let error: Error = config.expand("@amr").unwrap_err();
    assert_eq!(error.code(), "E211");
    assert!(error.to_string().contains("did you mean `arm`?"), "{error}");
    std::fs::write(folder.join("polepair.toml"), "[link]\n").unwrap();
    let config = polepair::config::Config::discover_from(&deep, None);
    assert_eq!(config.expand("sim:tmcl").unwrap(), "sim:tmcl", "it needs nothing of the file");
    let error = config.expand("@arm").unwrap_err();
    assert!(error.to_string().contains("polepair.toml:1:"), "{error}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_rehearsed_move_knows_its_scale() {
    let link = polepair::connect_local("sim:tmcl?time=virtual").unwrap();
    let command = Command { target: Some(std::f64::consts::TAU), ..Command::new(Verb::MoveTo) };
    let steps = link.axes()[0].rehearse(command).unwrap();
    // MVP ABS by 4096 encoder steps, as the factory counts a turn.
    let sent = [0x01, 0x04, 0x00, 0x00, 0x00, 0x00, 0x10, 0x00, 0x15];
    assert!(steps.iter().any(|step| step.bytes == sent), "{steps:?}");
}

#[test]
fn every_axis_of_a_link_is_stopped() {
    let link = connect_local("sim:tmcl:1,3?time=virtual").unwrap();
    let armed: Vec<_> = link.axes().iter().map(|axis| axis.armed().unwrap()).collect();
    for axis in &armed {
        axis.velocity("60rpm").unwrap();
    }
    link.sleep(Duration::from_secs(1));
    let speed = |axis: &LocalAxis| axis.signals(&[Signal::Velocity]).unwrap()[0].value;
    let speeds = || link.axes().iter().map(speed).collect::<Vec<f64>>();
    assert!(speeds().iter().all(|speed| (5.0..7.5).contains(speed)), "{:?}", speeds());
    link.stop_all().unwrap();
    link.sleep(Duration::from_secs(1));
    assert!(speeds().iter().all(|speed| speed.abs() < 0.5), "{:?}", speeds());
}

#[test]
fn the_protocols_own_bytes_are_held_to_its_words() {
    let link = connect_local("sim:tmcl?time=virtual#1").unwrap();
    let axis = &link.axes()[0];
    let current = axis.raw("GAP 6, 0").unwrap();
    let bytes = [1, 6, 6, 0, 0, 0, 0, 0, 13];
    assert_eq!(axis.raw_bytes(&bytes, None).unwrap(), current);
    let sent = link.counters(axis).sent;
    let foreign = axis.raw_bytes(&[2, 6, 6, 0, 0, 0, 0, 0, 14], None).unwrap_err();
    assert_eq!((foreign.code(), foreign.executed()), ("E221", Some(false)));
    assert!(foreign.to_string().contains("for axis 2"), "{foreign}");
    let broken = axis.raw_bytes(&[1, 6, 6, 0, 0, 0, 0, 0, 14], None).unwrap_err();
    assert!(broken.to_string().contains("checksum"), "{broken}");
    // A request that moves the motor needs an armed axis, in whatever form it is sent.
    let turning = axis.raw_bytes(&[1, 1, 0, 0, 0, 0, 1, 0x5E, 0x61], None).unwrap_err();
    assert_eq!(turning.code(), "E219");
    assert_eq!(link.counters(axis).sent, sent);
}

#[test]
fn a_link_that_is_closed_is_closed_for_every_axis_that_is_held() {
    let link = connect_local("sim:tmcl?time=virtual").unwrap();
    let axis = link.axis(1).unwrap();
    axis.get("max current").unwrap();
    link.close();
    let closed = axis.get("max current").unwrap_err();
    assert_eq!((closed.code(), closed.exit()), ("E322", Exit::Adapter), "{closed}");
    assert!(closed.to_string().contains("this program has closed it"), "{closed}");
}

#[test]
fn text_for_a_motion_needs_a_unit() {
    let link = connect_local("sim:tmcl?time=virtual").unwrap();
    let axis = link.axis(1).unwrap().armed().unwrap();
    assert_eq!(axis.move_to("4096").unwrap_err().code(), "E217");
    axis.move_to("0").unwrap();
    axis.move_to("90 deg").unwrap();
}

#[test]
fn every_protocol_takes_its_own_bytes() {
    // What its own host would send, step by step: an axis that is not armed lets nothing start.
    for drive in ["tmcl", "tmcl+can", "syntron-ts", "technosoft-f514l", "thruster", "cia402"] {
        let link = connect_local(&format!("sim:{drive}?time=virtual")).unwrap();
        let axis = &link.axes()[0];
        let (mut consumed, mut kept_back) = (0, 0);
        let verbs = [Verb::Enable, Verb::Stop, Verb::Reached, Verb::Disable];
        let plans = verbs.into_iter().filter(|verb| axis.profile().plan(*verb).is_some());
        for step in plans.flat_map(|verb| axis.rehearse(Command::new(verb)).unwrap()) {
            let frame = step.frame.map(|frame| (frame.bytes().to_vec(), Some(frame.id)));
            let (bytes, id) = frame.unwrap_or((step.bytes, None));
            if bytes.is_empty() {
                continue;
            }
            match axis.raw_bytes(&bytes, id) {
                Ok(_) => consumed += 1,
                Err(error) if error.code() == "E219" => kept_back += 1,
                Err(error) => panic!("{drive}: {bytes:02X?}: {error}"),
            }
        }
        assert!(consumed + kept_back > 0, "{drive}: {consumed} taken, {kept_back} kept back");
    }
}

#[test]
fn on_can_bytes_come_with_their_identifier() {
    let link = connect_local("sim:cia402:2?time=virtual").unwrap();
    let axis = &link.axes()[0];
    let read = [0x40, 0x41, 0x60, 0, 0, 0, 0, 0];
    let status = axis.raw("read 0x6041:0").unwrap();
    assert_eq!(axis.raw_bytes(&read, Some(0x602)).unwrap(), status);
    assert_eq!(axis.raw_bytes(&read, Some(0x603)).unwrap_err().code(), "E221");
}
