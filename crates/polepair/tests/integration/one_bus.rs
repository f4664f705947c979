//! Drives of several protocols on one CAN bus, under one command.

use std::time::Duration;

use polepair::simulate::rack_of_text;
use polepair::{Connector, LocalAxis, LocalLink};
use polepair_core::axis::{Command, Verb};

const RACK: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples/one-bus.toml");

fn open(axes: &str) -> LocalLink {
    let url = format!("sim:{RACK}?time=virtual{axes}");
    Connector::default().connect_local(&url).expect("every drive answers")
}

fn turning(axis: &LocalAxis) -> f64 {
    let signals = axis.signals(&[polepair_core::profile::Signal::Velocity]).expect("a speed");
    signals[0].value
}

#[test]
fn every_axis_is_found_as_what_it_is() {
    let link = open("");
    let found: Vec<_> = link.axes().iter().map(|a| (a.name(), a.protocol(), a.number())).collect();
    let expected = [
        ("spindle", "canopen", 2),
        ("x", "technocan", 5),
        ("y", "technocan", 7),
        ("gripper", "tmcl", 0x61),
        ("port", "thruster", 11),
        ("starboard", "thruster", 12),
    ];
    assert_eq!(found, expected);
    let families: Vec<&str> = link.axes().iter().map(|axis| axis.profile().family).collect();
    assert!(families[0].starts_with("syntron") && families[3].starts_with("tmcm"), "{families:?}");
}

#[test]
fn axes_are_named_by_words() {
    let link = open("#x,gripper");
    assert_eq!(link.axes().iter().map(LocalAxis::name).collect::<Vec<_>>(), ["x", "gripper"]);
    let url = format!("sim:{RACK}?time=virtual#x,z");
    let error = Connector::default().connect_local(&url).expect_err("no such axis");
    assert_eq!(error.code(), "E212", "{error}");
}

/// All drives turn at once for some seconds, and each reply belongs to its own request.
#[test]
fn all_turn_on_one_wire() {
    let link = open("#spindle,x,y,gripper,port,starboard");
    let speeds = [20.0, 10.0, -10.0, 15.0, 40.0, -40.0];
    for axis in link.axes() {
        axis.arm(true);
        if axis.profile().plan(Verb::Enable).is_some() {
            axis.enable().unwrap_or_else(|error| panic!("{}: {error}", axis.label()));
        }
    }
    let started: Vec<_> = link
        .axes()
        .iter()
        .zip(speeds)
        .filter(|(axis, _)| axis.profile().plan(Verb::Velocity).is_some())
        .map(|(axis, speed)| {
            let command = Command { velocity: Some(speed), ..Command::new(Verb::Velocity) };
            (axis, axis.start(command))
        })
        .collect();
    for (axis, running) in started {
        let ended = running.and_then(|mut running| running.finish());
        ended.unwrap_or_else(|error| panic!("{}: {error}", axis.label()));
    }
    for _ in 0..50 {
        link.sleep(Duration::from_millis(40));
        assert!(link.axes().iter().all(|axis| turning(axis).is_finite()));
    }
    for (axis, wanted) in link.axes().iter().zip(&speeds[..4]) {
        let speed = turning(axis);
        assert!((speed - wanted).abs() < 2.0, "{}: {speed} rad/s", axis.label());
    }
    let counters = link.counters(&link.axes()[0]);
    assert_eq!((counters.corrupt, counters.late, counters.silent), (0, 0, 0), "{counters:?}");
    link.stop_all().expect("all stop");
}

fn refused(text: &str) -> String {
    rack_of_text("rack.toml", text, 1).expect_err("a clash").to_string()
}

fn rack(drives: &[&str]) -> String {
    let drives = drives.iter().map(|drive| format!("[[link.drive]]\n{drive}\n"));
    format!("[[link]]\nkind = \"can\"\nbitrate = 500000\n{}", drives.collect::<String>())
}

#[test]
fn clashes_are_refused_when_the_rack_is_read() {
    let thruster = "profile = \"thruster\"\naddress = 11";
    let node = "profile = \"cia402\"\naddress = 11";
    let text = refused(&rack(&[thruster, node]));
    assert!(text.contains("both use the identifier 28Bh"), "{text}");
    let text = refused(&rack(&[node, node]));
    assert!(text.contains("canopen 11 is used twice"), "{text}");
    let axis = "profile = \"technosoft-f514l\"\nprotocol = \"technocan\"\naddress = 5";
    let text = refused(&rack(&[axis, "profile = \"tmcm-171\"\naddress = 1"]));
    assert!(text.contains("both use the identifier 1h"), "{text}");
    let text = refused(&rack(&[&axis.replace("= 5", "= 64")]));
    assert!(text.contains("multiple of 32"), "{text}");
}

#[test]
fn more_load_than_a_bus_carries_is_refused_with_the_sum() {
    let busy = "profile = \"thruster\"\naddress = 11\ncycle = 1500";
    let text = refused(&rack(&[busy, &busy.replace("11", "12")]));
    assert!(text.contains("133.2 to 162.0 %"), "{text}");
}

#[test]
fn a_served_bus_has_a_string_for_each_protocol() {
    let description = polepair::simulate::rack_of_file(RACK.as_ref(), 1).expect("a rack");
    let urls = description.urls(0, "udp://239.74.163.2:43113");
    let words: Vec<_> = urls.iter().map(|url| url.split('+').next().unwrap_or("")).collect();
    assert_eq!(words, ["canopen", "technocan", "tmcl", "thruster"]);
    let load = description.wires[0].load;
    assert!(load.least > 0.45 && load.most < 0.58, "{load}");
}
