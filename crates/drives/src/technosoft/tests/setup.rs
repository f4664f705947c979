//! Axis IDs, groups, settings that change the wire, permanent memory.

use super::DriveFixture;
use crate::surroundings::{Act, SurroundingsControl};
use polepair_core::medium::Stream;
use polepair_core::proto::tml::wire::IdCode;
use polepair_core::station::Station;

#[test]
fn the_axis_id_at_power_up_is_found_as_the_manual_says() {
    assert_eq!(DriveFixture::at(None, &[]).axis(), 1);
    assert_eq!(DriveFixture::at(Some(0), &[]).axis(), 255, "the table says H/W, and no switches");
    assert_eq!(DriveFixture::at(Some(0), &[("switches", "9")]).axis(), 9, "the table says H/W");
    assert_eq!(DriveFixture::at(Some(4), &[("switches", "9")]).axis(), 4, "the table says 4");
    let invalid = [("setup", "invalid"), ("switches", "9")];
    assert_eq!(DriveFixture::at(Some(4), &invalid).axis(), 4, "the last valid table said 4");
    assert_eq!(DriveFixture::at(Some(0), &invalid).axis(), 9, "there was never a valid one");
}

#[test]
fn every_drive_starts_in_group_1_and_can_change() {
    let mut fixture = DriveFixture::at(Some(5), &[]);
    assert_eq!(fixture.read(0x030C), 0x0105);
    fixture.send_instruction(0x0840, &[0x0A]);
    assert_eq!(fixture.read(0x030C), 0x0B05);
    fixture.send_instruction(0x0880, &[0x03]);
    assert_eq!(fixture.read(0x030C), 0x0805);
    fixture.send_instruction(0x0801, &[7]);
    assert_eq!(fixture.axis(), 7);
    assert_eq!(fixture.send(IdCode::groups(8), 0x205E, &[77]), [0x4F]);
    assert_eq!(fixture.read(0x025E), 77);
}

#[test]
fn an_invalid_setup_table_is_reported_and_keeps_the_axis_off() {
    let mut fixture = DriveFixture::with(&[("setup", "invalid")]);
    assert_eq!(fixture.read(0x08FC), 0x0004);
    fixture.send_instruction(0x0020, &[]);
    fixture.send_instruction(0x0102, &[]);
    assert_eq!(fixture.read(0x090E) & 0x8000, 0);
    assert_eq!(fixture.read(0x08FC), 0x4004);
}

#[test]
fn the_baud_rate_changes_behind_the_acknowledgement() {
    let mut fixture = DriveFixture::new();
    assert_eq!(Station::<Stream>::line(&fixture.device).baud, 9600);
    fixture.send_instruction(0x0820, &[4]);
    assert_eq!(Station::<Stream>::line(&fixture.device).baud, 115_200);
    assert_eq!(fixture.send(IdCode::axis(255), 0x0402, &[]), [0x4F]);
    assert_eq!(Station::<Stream>::line(&fixture.device).baud, 9600, "as after every reset");
}

#[test]
fn settings_survive_only_if_saved() {
    let mut fixture = DriveFixture::new();
    fixture.word(0x025E, 400);
    fixture.act(Act::PowerCycle);
    assert_eq!(fixture.read(0x025E), 288);
    fixture.word(0x025E, 400);
    assert_eq!(fixture.device.ground_truth(fixture.now).flash_writes, 0);
    fixture.send_instruction(0x1C08, &[]);
    assert!(fixture.device.ground_truth(fixture.now).flash_writes > 0);
    fixture.act(Act::PowerCycle);
    assert_eq!(fixture.read(0x025E), 400);
}

#[test]
fn status_cannot_be_written() {
    let mut fixture = DriveFixture::with(&[("setup", "invalid")]);
    fixture.word(0x08FC, 0);
    assert_eq!(fixture.read(0x08FC), 0x0004);
}

#[test]
fn an_instruction_that_no_firmware_has_is_a_command_error() {
    let mut fixture = DriveFixture::new();
    fixture.send_instruction(0x6000, &[]);
    assert_eq!(fixture.read(0x08FC), 0x4000);
    fixture.send_instruction(0x1C04, &[]);
    assert_eq!(fixture.read(0x08FC), 0);
    fixture.send_instruction(0x0102, &[1]);
    assert_eq!(fixture.read(0x08FC), 0x4000, "a data word too many");
}
