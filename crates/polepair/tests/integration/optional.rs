//! Drives that lack what CiA 402-2 leaves to their makers: by the generic profile, which learns it from
//! their refusals, and by data sheets, which state it.

use polepair::axis::WatchdogState;
use polepair::doctor::{self, Grade};
use polepair::{Amount, Connector, LocalAxis, LocalLink};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

const SHEET: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../interop/sheets/motor.eds");
/// Objects that a drive may lack, each with the CiA 301 number of its type.
const OPTIONAL: [(u16, u8); 11] = [
    (0x603F, 0x06),
    (0x606C, 0x04),
    (0x6071, 0x03),
    (0x6075, 0x07),
    (0x6076, 0x07),
    (0x6077, 0x03),
    (0x6078, 0x03),
    (0x6079, 0x07),
    (0x607A, 0x04),
    (0x608F, 0x07),
    (0x60FF, 0x04),
];
const NODE: u32 = 5;

/// A folder of files that is gone when this is.
struct Files(PathBuf);

impl Files {
    /// A drive's data sheet without these objects, and a rack that has the drive, in which it is known
    /// by what it answers alone.
    fn without(lacking: &[u16]) -> Self {
        Self::with(&OPTIONAL, lacking)
    }

    /// A drive's data sheet with the first objects, unless they are in `lacking`.
    fn with(objects: &[(u16, u8)], lacking: &[u16]) -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let n = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = format!("polepair-optional-{}-{n}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        std::fs::create_dir_all(&folder).unwrap();
        let mut sheet = polepair::eds::load(Path::new(SHEET)).unwrap();
        let model = sheet.object(0x6064).unwrap().clone();
        for &(index, kind) in objects {
            if sheet.object(index).is_none() {
                let mut object = model.clone();
                object.index = index;
                object.name = format!("object {index:04X}");
                object.entries[0].name.clone_from(&object.name);
                object.entries[0].access = polepair::eds::ObjectAccess::Rw;
                object.entries[0].data_type = polepair::eds::DataType(kind.into());
                let at = sheet.objects.partition_point(|other| other.index < index);
                sheet.objects.insert(at, object);
            }
        }
        sheet.objects.retain(|object| !lacking.contains(&object.index));
        std::fs::write(folder.join("drive.eds"), sheet.to_string()).unwrap();
        let rack = format!(
            "[[link]]\nbitrate = 500000\n[[link.drive]]\nprofile = \"canopen\"\naddress = {NODE}\n\
             eds = \"drive.eds\"\n"
        );
        std::fs::write(folder.join("rack.toml"), rack).unwrap();
        Self(folder)
    }

    /// URLs with the generic profile, and with the sheet's own.
    fn urls(&self) -> [String; 2] {
        let folder = self.0.display();
        [
            format!("sim:{folder}/rack.toml?time=virtual"),
            format!("sim:canopen:{NODE}?eds={folder}/drive.eds&time=virtual"),
        ]
    }
}

impl Drop for Files {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn speed(link: &LocalLink) -> f64 {
    link.simulation().unwrap().truth(0, 0).unwrap().velocity
}

/// Returns whether the profile has a parameter for the object of this index.
fn has(axis: &LocalAxis, index: u16) -> bool {
    axis.params().iter().any(|p| p.index == index)
}

/// A number in the unit that a speed or a way has here: the drive's own where nothing scales it.
fn amount(lacking: &[u16], with_unit: &str, raw: f64) -> Amount {
    if lacking.contains(&0x608F) { raw.into() } else { with_unit.into() }
}

#[test]
fn plans_go_on_without_what_is_optional() {
    let one_by_one = OPTIONAL.iter().map(|(index, _)| vec![*index]);
    let all = OPTIONAL.iter().map(|(index, _)| *index).collect::<Vec<_>>();
    for lacking in one_by_one.chain([Vec::new(), all]) {
        let files = Files::without(&lacking);
        for url in files.urls() {
            let shown = lacking.iter().map(|index| format!("{index:04X}")).collect::<Vec<_>>();
            let about = format!("{} without {}", url.split('?').next().unwrap(), shown.join(" "));
            let link = polepair::connect_local(&url).unwrap_or_else(|e| panic!("{about}: {e}"));
            let axis = &link.axes()[0];
            walk(&about, &link, axis, &lacking);
        }
    }
}

fn walk(about: &str, link: &LocalLink, axis: &LocalAxis, lacking: &[u16]) {
    let fine = |what: &str, done: Result<(), polepair::Error>| {
        done.unwrap_or_else(|error| panic!("{about}: {what}: {error}"));
    };
    for signal in Signal::ALL {
        let reports =
            axis.provides_signal(signal).unwrap_or_else(|e| panic!("{about}: {signal:?}: {e}"));
        let source = axis.profile().signal(signal);
        let index = source.map(|s| axis.profile().parameter(s.parameter).unwrap().index);
        assert_eq!(reports, index.is_some_and(|i| !lacking.contains(&i)), "{about}: {signal:?}");
    }
    fine("stop", axis.stop());
    let armed = axis.armed().unwrap_or_else(|e| panic!("{about}: enable: {e}"));
    if lacking.contains(&0x60FF) {
        assert!(axis.velocity(1.0).is_err(), "{about}: nothing takes a speed");
    } else {
        fine("velocity", axis.velocity(amount(lacking, "60 rpm", 65_536.0)));
        link.sleep(Duration::from_secs(3));
        assert!(speed(link) > 5.0, "{about}: {}", speed(link));
    }
    fine("stop", axis.stop());
    assert!(speed(link).abs() < 0.1, "{about}: stopped at {}", speed(link));
    if lacking.contains(&0x607A) {
        assert!(axis.move_to(1.0).is_err(), "{about}: nothing takes a target");
    } else {
        fine("move", axis.move_to(amount(lacking, "90 deg", 16_384.0)));
        fine("wait", axis.wait(Duration::from_secs(20)));
    }
    fine("stop", axis.stop());
    // Method 37: the present position becomes the home position.
    fine("homing method", axis.set_raw("homing method", 37));
    fine("home", axis.home());
    fine("release", armed.release());
}

#[test]
fn the_doctor_says_absent_and_not_wrong() {
    let all: Vec<u16> = OPTIONAL.iter().map(|(index, _)| *index).collect();
    let files = Files::without(&all);
    let mut checks = Vec::new();
    let options = doctor::DoctorOptions::default();
    let [url, _] = files.urls();
    doctor::check_link(&Connector::default(), &url, options, &mut |check| checks.push(check))
        .unwrap();
    let wrong: Vec<_> = checks.iter().filter(|check| check.grade == Grade::Wrong).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(checks.iter().any(|check| check.found.contains("voltage: absent")), "{checks:#?}");
}

#[test]
fn an_absent_object_is_queried_once() {
    let files = Files::without(&[0x6071, 0x606C]);
    let [url, _] = files.urls();
    let link = polepair::connect_local(&url).unwrap();
    let axis = &link.axes()[0];
    axis.stop().unwrap();
    let id = |name: &str| axis.find(name).unwrap();
    assert!(axis.lacks(id("target torque")) && axis.lacks(id("velocity actual")));
    assert!(!axis.lacks(id("target velocity")), "it is there");
    let before = link.counters(axis);
    axis.stop().unwrap();
    let sent = link.counters(axis).sent - before.sent;
    // Statusword, target velocity, and the statusword until it reports standstill; then two
    // positions.
    assert!(sent <= 6, "{sent} requests");
    assert!(!has(axis, 0x2345));
}

#[test]
fn a_value_without_a_scale_has_no_unit() {
    let files = Files::without(&[0x608F]);
    for url in files.urls() {
        let link = polepair::connect_local(&url).unwrap();
        let axis = &link.axes()[0];
        // The drive's boot-up message, which disarms the axis, is received.
        axis.stop().unwrap();
        let armed = axis.armed().unwrap();
        if axis.profile().name == "cia402" {
            let error = axis.move_to("90 deg").unwrap_err();
            assert_eq!(error.code(), "E217", "{url}: {error}");
        }
        let error = axis.move_to("16384").unwrap_err();
        assert_eq!(error.code(), "E217", "{url}: of what? {error}");
        axis.move_to(16_384.0).unwrap();
        axis.wait(Duration::from_secs(20)).unwrap();
        assert_eq!(axis.get("position actual").unwrap().unit.symbol(), "");
        let position = axis.get_raw("position actual").unwrap();
        assert!((position - 16384).abs() < 50, "{url}: {position}");
        armed.release().unwrap();
    }
}

#[test]
fn life_guarding_is_a_watchdog_of_another_host() {
    const GUARDING: [(u16, u8); 2] = [(0x100C, 0x06), (0x100D, 0x05)];
    let files = Files::with(&GUARDING, &[]);
    for url in files.urls() {
        let link = polepair::connect_local(&url).expect("a simulation");
        let axis = &link.axes()[0];
        let found = axis.watchdog().unwrap();
        axis.set_raw("guard time", 100).unwrap();
        assert_eq!(axis.watchdog().unwrap(), found, "{url}: a factor of 0 is never");
        axis.set_raw("life time factor", 3).unwrap();
        let guarded = axis.watchdog().unwrap();
        assert_eq!(guarded, WatchdogState::LifeGuarding(Duration::from_millis(300)), "{url}");
        assert!(axis.report_watchdog(guarded).text.contains("this host sends none"), "{url}");
    }
    // A drive without these objects has none.
    let link = polepair::connect_local("sim:cia402:5?time=virtual").expect("a simulation");
    assert_eq!(link.axes()[0].watchdog().unwrap(), WatchdogState::Off);
}

/// Shown as the drive's own number, it is that number: a rack's gear and direction change what has a unit.
#[test]
fn a_rack_scales_no_number_of_the_drives_own() {
    let files = Files::without(&[0x608F]);
    let rack = files.0.join("rack.toml");
    let text = std::fs::read_to_string(&rack).unwrap();
    std::fs::write(&rack, format!("{text}gear = 2\ndirection = \"inverted\"\n")).unwrap();
    let link = polepair::connect_local(&files.urls()[0]).expect("a simulation");
    let axis = &link.axes()[0];
    let shown = |name: &str| {
        let id = axis.find(name).unwrap();
        let raw = axis.read(id).unwrap();
        (axis.value(id, raw).unwrap().value, raw)
    };
    axis.arm(true);
    axis.set_raw("target position", 1000).unwrap();
    assert_eq!(shown("target position"), (1000.0, 1000));
    let target = axis.raw_argument(Verb::MoveTo, Argument::Target, 500).unwrap();
    axis.enable().unwrap();
    axis.run(Command { target: Some(target), raw: true, ..Command::new(Verb::MoveTo) }).unwrap();
    assert_eq!(shown("target position"), (500.0, 500));
    // A limit in degrees cannot be held against numbers of the drive's own.
    let limited = format!("{text}limits = {{ position = [\"0 deg\", \"360 deg\"] }}\n");
    std::fs::write(&rack, limited).unwrap();
    let link = polepair::connect_local(&files.urls()[0]).expect("a simulation");
    let axis = &link.axes()[0];
    assert_eq!(axis.get_raw("position actual").unwrap(), 0);
    axis.arm(true);
    axis.enable().unwrap();
    let refused = axis.run(Command { target: Some(1.0), ..Command::new(Verb::MoveTo) });
    assert_eq!(refused.unwrap_err().code(), "E223");
}
