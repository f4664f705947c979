//! Several motors behind one address: as axes of a link, in racks, and from outside the wire.

use polepair::error::Exit;
use polepair::events::{Event, EventKind};
use polepair::simulate::SimulatedMotor;
use polepair::stop::{self, StopOptions};
use polepair::url::AxisNumber;
use polepair::{Connector, connect_local};
use polepair_core::profile::Signal;
use polepair_drives::surroundings::Act;
use std::f64::consts::TAU;
use std::time::Duration;

const RACK: &str = "\
[[link]]
protocol = \"tmcl\"
[[link.drive]]
name = \"x\"
profile = \"tmcm-6110\"
address = 1
[[link.drive.axis]]
number = 1
name = \"y\"
lead = \"5 mm\"
[[link.drive.axis]]
number = 4
name = \"z\"
direction = \"inverted\"
[[link.drive.axis.act]]
at = \"3 s\"
do = \"jam\"
[[link.drive]]
profile = \"tmcm-1140\"
address = 2
[[link.drive]]
profile = \"tmcm-171\"
address = 3
";

fn numbers(link: &polepair::LocalLink) -> Vec<String> {
    link.axes().iter().map(|axis| AxisNumber(axis.number()).to_string()).collect()
}

/// A rack file, as long as this lives.
struct RackFile(std::path::PathBuf);

impl RackFile {
    fn new(name: &str, text: &str) -> Self {
        let name = format!("polepair-motors-{name}-{}.toml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).expect("a file");
        Self(path)
    }

    fn url(&self) -> String {
        format!("sim:{}?time=virtual", self.0.display())
    }
}

impl Drop for RackFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn a_link_has_every_motor_as_an_axis() {
    let link = connect_local("sim:tmcm-6110?time=virtual").unwrap();
    assert_eq!(numbers(&link), ["1", "1.1", "1.2", "1.3", "1.4", "1.5"]);
    let link = connect_local("sim:tmcm-6110+can:3,7?time=virtual#7.0-2,3.5").unwrap();
    assert_eq!(numbers(&link), ["3.5", "7", "7.1", "7.2"]);
    let refused = connect_local("sim:tmcm-1140?time=virtual#1.1").unwrap_err();
    assert!(refused.code() == "E212" && refused.to_string().contains("no such motor"), "{refused}");
    let refused = connect_local("sim:tmcm-6110?time=virtual#1.6").unwrap_err();
    assert_eq!(refused.code(), "E212", "{refused}");
}

#[test]
fn each_motor_moves_alone_by_its_own_settings() {
    let link = connect_local("sim:tmcm-6110+can?time=virtual").unwrap();
    let axis = link.axis_named("1.3").unwrap();
    axis.set("microstep resolution", "16").unwrap();
    let armed = axis.armed().unwrap();
    armed.move_to("0.5 turn").unwrap();
    armed.wait(Duration::from_secs(20)).unwrap();
    drop(armed);
    let truth = |motor| {
        let motor = SimulatedMotor { link: 0, drive: 0, motor };
        link.simulation().unwrap().motor_truth(motor).unwrap().position
    };
    assert!((truth(3) - TAU / 2.0).abs() < 0.01, "{}", truth(3));
    assert!([0, 1, 2, 4, 5].into_iter().all(|motor| truth(motor).abs() < 1e-9));
    assert_eq!(axis.get_raw("actual position").unwrap(), 1600);
    // `AP 1` is the axis' own, `AP 1.0` another motor's.
    assert_eq!(axis.get_raw("AP 1").unwrap(), 1600);
    assert_eq!(axis.get_raw("AP 1.0").unwrap(), 0);
    let other = link.axis_named("1").unwrap();
    assert_eq!(other.get_raw("AP 1.3").unwrap(), 1600);
}

#[test]
fn a_rack_names_motors_and_mounts_them() {
    let file = RackFile::new("named", RACK);
    let link = connect_local(&file.url()).unwrap();
    assert_eq!(numbers(&link), ["1", "1.1", "1.4", "2", "3"]);
    let y = link.axis_named("y").unwrap();
    let armed = y.armed().unwrap();
    armed.move_to("2 mm").unwrap();
    armed.wait(Duration::from_secs(20)).unwrap();
    drop(armed);
    let simulation = link.simulation().unwrap();
    let of = |motor| SimulatedMotor { link: 0, drive: 0, motor };
    let turned = simulation.motor_truth(of(1)).unwrap().position / TAU;
    assert!((turned - 0.4).abs() < 0.01, "{turned} turns of a lead of 5 mm");
    let z = link.axis_named("z").unwrap();
    let armed = z.armed().unwrap();
    armed.velocity("30 rpm").unwrap();
    link.sleep(Duration::from_secs(1));
    assert!(simulation.motor_truth(of(4)).unwrap().velocity < -2.0, "it is inverted");
    link.sleep(Duration::from_secs(3));
    assert_eq!(simulation.motor_truth(of(4)).unwrap().velocity, 0.0, "it was jammed");
    assert!(simulation.act_on_motor(of(4), Act::Jam(false)));
    drop(armed);
    let wrong = RACK.replace("number = 4", "number = 6");
    let refused = connect_local(&RackFile::new("wrong", &wrong).url()).unwrap_err();
    assert!(refused.to_string().contains("number"), "{refused}");
    let wrong = RACK.replace("name = \"z\"", "name = \"x\"");
    let refused = connect_local(&RackFile::new("wrong", &wrong).url()).unwrap_err();
    assert!(refused.to_string().contains("called `x`"), "{refused}");
}

#[test]
fn a_stop_of_the_module_reaches_all_of_its_motors() {
    let file = RackFile::new("stopped", RACK);
    let url = file.url();
    let link = connect_local(&url).unwrap();
    for axis in link.axes() {
        axis.arm(true);
        axis.enable().unwrap();
        let speed = if axis.name() == "y" { "2.5 mm/s" } else { "30 rpm" };
        axis.velocity(speed).unwrap();
    }
    link.sleep(Duration::from_secs(1));
    for axis in link.axes() {
        axis.stop().unwrap();
        let speed = axis.signals(&[Signal::Velocity]).unwrap()[0].value;
        assert!(speed.abs() < 0.6, "{}: {speed}", axis.label());
    }
    let stopped = stop::stop(&Connector::default(), &url, StopOptions::default(), &mut |_| {
        std::ops::ControlFlow::Continue(())
    })
    .unwrap();
    let labels: Vec<&str> = stopped.axes.iter().map(|(label, _)| label.as_str()).collect();
    assert_eq!(labels, ["axis 1 (x)", "axis 1.1 (y)", "axis 1.4 (z)", "axis 2", "axis 3"]);
    assert!(stopped.axes.iter().all(|(_, ended)| ended.is_ok()), "{:?}", stopped.axes);
    // Motors that the file does not list are stopped too.
    assert_eq!(stopped.motors[0].confirmed, [2, 3, 5]);
}

/// Instruction 138 reports each motor by its bit.
#[test]
fn an_arrival_is_the_event_of_its_motor() {
    let link = connect_local("sim:tmcm-6110+can?time=virtual").unwrap();
    let axis = link.axis_named("1.2").unwrap();
    let armed = axis.armed().unwrap();
    armed.move_to("0.5 turn").unwrap();
    let events = link.events().unwrap();
    axis.raw("138, 0, 0, 4").unwrap();
    let is_reached = |event: &Event| match event.kind {
        EventKind::Signal { signal, reading } => signal == Signal::Reached && reading.raw == 1,
        _ => false,
    };
    let within = Duration::from_secs(5);
    let reached = std::iter::from_fn(|| events.next(within)).find(is_reached).expect("an event");
    let number = AxisNumber(reached.axis.expect("an axis"));
    assert_eq!(number.to_string(), "1.2");
    drop(armed);
}

/// A motor with 400 full steps needs twice the microsteps for a turn.
#[test]
fn full_steps_of_a_motor_are_stated_by_url_or_rack() {
    let turned = |link: &polepair::LocalLink, number: &str, motor| {
        let axis = link.axis_named(number).unwrap();
        let armed = axis.armed().unwrap();
        armed.move_to("0.5 turn").unwrap();
        armed.wait(Duration::from_secs(20)).unwrap();
        let motor = SimulatedMotor { link: 0, drive: 0, motor };
        let truth = link.simulation().unwrap().motor_truth(motor).unwrap();
        (truth.position / TAU, axis.get_raw("actual position").unwrap())
    };
    let link = connect_local("sim:tmcm-6110?time=virtual&steps=400").unwrap();
    let (turns, raw) = turned(&link, "1.2", 2);
    assert!((turns - 0.5).abs() < 0.01 && raw == 51_200, "{turns} turns, {raw}");
    let text = "[[link]]\n[[link.drive]]\nprofile = \"tmcm-6110\"\naddress = 1\nsteps = 400\n\
        [[link.drive.axis]]\nnumber = 1\nsteps = 48\n";
    let file = RackFile::new("steps", text);
    let link = connect_local(&file.url()).unwrap();
    for (number, motor, expected) in [("1", 0, 51_200), ("1.1", 1, 6_144)] {
        let (turns, raw) = turned(&link, number, motor);
        assert!((turns - 0.5).abs() < 0.01 && raw == expected, "{number}: {turns} turns, {raw}");
    }
    for (url, word) in [("sim:tmcm-6110?steps=0", "0"), ("sim:tmcl?steps=400", "steps")] {
        let refused = connect_local(url).unwrap_err();
        assert!(
            refused.exit() == Exit::Usage && refused.to_string().contains(word),
            "{url}: {refused}"
        );
    }
}

#[test]
fn coordinates_are_of_the_motor_that_is_meant() {
    let link = connect_local("sim:tmcm-6110+can?time=virtual").unwrap();
    let axis = link.axis_named("1.2").unwrap();
    axis.set_raw("CO 3", 5000).unwrap();
    axis.set_raw("CO 3.4", 4000).unwrap();
    assert_eq!((axis.get_raw("CO 3").unwrap(), axis.get_raw("CO 3.2").unwrap()), (5000, 5000));
    assert_eq!(link.axis_named("1.4").unwrap().get_raw("CO 3").unwrap(), 4000);
    axis.arm(true);
    axis.raw("MVP COORD, 2, 3").unwrap();
    axis.wait(Duration::from_secs(10)).unwrap();
    assert_eq!(axis.get_raw("actual position").unwrap(), 5000);
}

/// Each stepper module of the catalogue: known by its version, moved and stopped in turns.
#[test]
fn every_stepper_of_the_catalogue_is_known_and_moves_in_turns() {
    let modules = polepair::profile::catalogue().iter();
    let mut count = 0;
    for module in modules.filter(|module| module.profile().family == "tmcm") {
        let link = connect_local(&format!("sim:{}?time=virtual", module.name)).unwrap();
        let profile = module.profile();
        assert_eq!(link.axes().len(), usize::from(profile.motors), "{}", module.name);
        let axis = link.axis(1).unwrap();
        assert_eq!(axis.profile().name, module.name);
        let truth = || link.simulation().unwrap().truth(0, 0).unwrap();
        let armed = axis.armed().unwrap();
        armed.move_to("0.5 turn").unwrap();
        armed.wait(Duration::from_secs(60)).unwrap();
        let position = truth().position;
        assert!((position - TAU / 2.0).abs() < 0.02, "{}: {position}", module.name);
        armed.velocity("60 rpm").unwrap();
        let rpm = || truth().velocity.abs() * 60.0 / TAU;
        let turns =
            (0..2000).any(|_| axis.get("actual velocity").is_ok() && (rpm() - 60.0).abs() < 1.0);
        assert!(turns, "{}: {}", module.name, rpm());
        armed.stop().unwrap();
        count += 1;
    }
    assert!(count > 30, "{count}");
}
