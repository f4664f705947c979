//! Simulated devices out of data sheets, against our host, in virtual time.

use polepair::connect_local;
use polepair::eds::{Eds, SheetValues};
use polepair::settings::Settings;
use polepair::simulate::{rack_of_text, rack_of_words};
use polepair::{FileError, LocalLink};
use std::path::Path;
use std::time::Duration;

const SHEETS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../interop/sheets");

fn device(sheet: &str) -> LocalLink {
    connect_local(&format!("sim:canopen:5?eds={SHEETS}/{sheet}&time=virtual")).expect(sheet)
}

#[test]
fn a_sheets_objects_are_there_by_name() {
    let link = device("motor.eds");
    let axis = link.axis(5).unwrap();
    assert_eq!(axis.profile().title, "Proving Ground Spindle 3");
    let raw = |name: &str| axis.get_raw(name).expect(name);
    assert_eq!((raw("trim"), raw("offset"), raw("octal")), (-5, -2, 64));
    assert_eq!((raw("product code"), raw("serial number")), (0x3_0001, 5));
    assert_eq!(raw("supported modes"), 0x25, "the sheet's, not the generic drive's");
    assert_eq!(raw("1801h:1"), 0x285, "the sheet forgot the node-ID");
    axis.set_raw("trim", 9).unwrap();
    assert_eq!(raw("trim"), 9);
    assert_eq!(axis.set_raw("trim", 11).unwrap_err().code(), "E216", "above its limit");
    let refused = axis.raw("read 0x2fff:0").unwrap_err().to_string();
    assert!(refused.contains("object does not exist"), "{refused}");
}

#[test]
fn a_sheets_drive_turns_though_its_ramps_are_left_at_0() {
    let link = device("motor.eds");
    let axis = link.axis(5).unwrap();
    assert_eq!(axis.get_raw("6083h").unwrap(), 0);
    let armed = axis.armed().unwrap();
    axis.move_by("2 rev").unwrap();
    axis.wait(Duration::from_secs(20)).unwrap();
    let truth = link.simulation().unwrap().truth(0, 0).unwrap();
    assert!((truth.position - 2.0 * std::f64::consts::TAU).abs() < 0.01, "{}", truth.position);
    let increments = axis.get_raw("6064h").unwrap();
    assert!((increments - 2 * 65_536).abs() < 100, "{increments}");
    armed.release().unwrap();
}

#[test]
fn a_device_without_a_motor_has_no_verbs() {
    let link = device("inputs.eds");
    let axis = link.axis(5).unwrap();
    assert_eq!(axis.raw("read 0x6000:1").unwrap(), 0x81);
    let armed = axis.armed().unwrap();
    axis.raw("write 0x6200:2 u8 7").unwrap();
    armed.release().unwrap();
    assert_eq!(axis.raw("read 0x6200:2").unwrap(), 7);
    assert_eq!(axis.velocity("1 rpm").unwrap_err().code(), "E218");
}

const RACK: &str = "[[link]]\n[[link.drive]]\nname = \"spindle\"\nprofile = \"canopen\"\n\
                    address = 7\neds = \"motor.eds\"\n";

#[test]
fn a_rack_names_a_sheet_beside_it() {
    let rack = format!("{SHEETS}/rack.toml");
    let description = rack_of_text(&rack, RACK, 1).unwrap();
    let drive = &description.rack.links[0].drives[0];
    assert_eq!(drive.address, Some(7));
    assert!(drive.data_sheet.as_ref().is_some_and(|sheet| sheet.is_drive()));
    for (from, to, why) in [
        ("motor.eds", "absent.eds", "absent.eds: No such file"),
        ("motor.eds", "../conftest.py", "no object in it"),
        ("\"canopen\"", "\"syntron-ts-canopen\"", "no device of a data sheet"),
    ] {
        let wrong = RACK.replace(from, to);
        let error = rack_of_text("interop/sheets/rack.toml", &wrong, 1).unwrap_err().to_string();
        let location = "interop/sheets/rack.toml:";
        assert!(error.contains(location), "{error}");
        let error = rack_of_text(&rack, &wrong, 1).unwrap_err().to_string();
        assert!(error.contains(why) && error.contains("rack.toml:"), "{error}");
    }
}

#[test]
fn a_sheets_slips_are_reported_and_other_drives_have_none() {
    let mut description = rack_of_words(&["canopen:5"], 1).unwrap();
    let sheet = format!("{SHEETS}/motor.eds");
    let slips: Vec<FileError> = description.apply_sheet(0, Path::new(&sheet)).unwrap();
    let reports: Vec<&str> = slips.iter().map(|slip| slip.reason.as_str()).collect();
    assert_eq!(reports, ["`0100` begins with 0: read as octal, 64"]);
    let mut others = rack_of_words(&["syntron-ts-canopen:2"], 1).unwrap();
    assert_eq!(others.apply_sheet(0, Path::new(&sheet)).unwrap_err().code(), "E213");
}

#[test]
fn the_sheet_of_a_drive_describes_it_and_restores_it() {
    for url in ["sim:syntron-ts-canopen", "sim:cia402", "sim:canopen:5"] {
        let link = connect_local(&format!(
            "{url}{}time=virtual",
            if url.contains('?') { '&' } else { '?' }
        ));
        let link = link.expect("a link");
        let axis = &link.axes()[0];
        let sheet = Eds::of_drive(axis, SheetValues::None, &mut |_, _| {}).expect("a sheet");
        let read = polepair::eds::parse("drive.eds", &sheet.to_string()).expect("read back");
        assert_eq!((&read.objects, &read.warnings), (&sheet.objects, &Vec::new()), "{url}");
        for parameter in axis.profile().parameters {
            assert!(
                read.entry(parameter.index, parameter.space).is_some(),
                "{url}: {}",
                parameter.name
            );
        }
        let node = Eds::of_drive(axis, SheetValues::OfDrive, &mut |_, _| {}).expect("a sheet");
        let read = polepair::eds::parse("node.dcf", &node.to_string()).expect("read back");
        assert_eq!(read.node_id(), Some(axis.number() as u8), "{url}");
        // Nothing differs from the drive that it was read from.
        let file = std::env::temp_dir().join(format!("polepair-sheet-{}.dcf", std::process::id()));
        std::fs::write(&file, node.to_string()).expect("written");
        let settings = Settings::load(&file).expect("settings");
        let changes = settings.axes[0].changes(axis, &mut |_, _| {}).expect("compared");
        assert!(changes.is_empty(), "{url}: {changes:?}");
        std::fs::remove_file(&file).expect("removed");
    }
    let link = connect_local("sim:tmcl?time=virtual").expect("a link");
    let error = Eds::of_drive(&link.axes()[0], SheetValues::None, &mut |_, _| {});
    assert_eq!(error.expect_err("no CANopen").code(), "E248");
}

/// A boot-up that was received before the axis is armed is no restart of an armed drive.
#[test]
fn a_device_without_a_motor_is_armed_and_written() {
    let link = device("inputs.eds");
    let axis = &link.axes()[0];
    let refused = axis.set_raw("6200h:1", 3).expect_err("not armed");
    assert_eq!(refused.code(), "E219", "{refused}");
    let link = device("inputs.eds");
    let axis = &link.axes()[0];
    axis.arm(true);
    axis.set_raw("6200h:1", 3).expect("armed");
    assert_eq!(axis.get_raw("6200h:1").expect("an output"), 3);
}
