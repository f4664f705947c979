use super::{DataSheet, DataSheetDevice, DataSheetEntry, FactoryValue};
use polepair_core::medium::Frame;
use polepair_core::station::Station;
use polepair_core::time::Instant;
use polepair_drives::surroundings::{Act, SurroundingsControl};
use std::sync::Arc;

const NODE: u8 = 5;

fn listed(index: u16, sub: u8, kind: u8, worth: FactoryValue) -> DataSheetEntry {
    DataSheetEntry {
        index,
        sub,
        data_type: kind,
        name: format!("{index:04X}"),
        readable: true,
        writable: true,
        tpdo_mappable: true,
        rpdo_mappable: true,
        limits: (i64::MIN, i64::MAX),
        default: worth,
    }
}

fn number(index: u16, kind: u8, number: i64) -> DataSheetEntry {
    listed(index, 0, kind, FactoryValue::Number(number))
}

/// A device that has sent its boot-up message.
fn device(listed: &[DataSheetEntry]) -> DataSheetDevice {
    let mut device = DataSheetDevice::new(Arc::new(DataSheet::new(listed, true)), NODE, 9);
    let booted = answers(&mut device);
    assert_eq!((booted.len(), booted[0].id), (1, 0x700 + u32::from(NODE)));
    device
}

fn answers(device: &mut DataSheetDevice) -> Vec<Frame> {
    let (mut all, mut frame) = (Vec::new(), Frame::standard(0, &[]));
    while Station::poll_transmit(device, Instant::ZERO, &mut frame).is_some() {
        all.push(frame);
    }
    all
}

/// Reply to an SDO request.
fn sdo_reply_to(device: &mut DataSheetDevice, request: [u8; 8]) -> [u8; 8] {
    device.handle_input(Instant::ZERO, &Frame::standard(0x600 + u16::from(NODE), &request));
    answers(device)[0].data
}

fn read(device: &mut DataSheetDevice, index: u16) -> [u8; 8] {
    let [low, high] = index.to_le_bytes();
    sdo_reply_to(device, [0x40, low, high, 0, 0, 0, 0, 0])
}

#[test]
fn a_cell_keeps_what_is_written_until_power_goes() {
    let mut device = device(&[number(0x1000, 7, 0x191), number(0x2000, 6, 0x1234)]);
    assert_eq!(read(&mut device, 0x2000), [0x4B, 0, 0x20, 0, 0x34, 0x12, 0, 0]);
    assert_eq!(sdo_reply_to(&mut device, [0x2B, 0, 0x20, 0, 1, 0, 0, 0])[0], 0x60);
    assert_eq!(read(&mut device, 0x2000)[4], 1);
    assert!(device.act(Instant::ZERO, Act::PowerCycle));
    answers(&mut device);
    assert_eq!(read(&mut device, 0x2000)[4..6], [0x34, 0x12]);
}

#[test]
fn only_controlword_and_statusword_make_a_drive() {
    let mode = number(0x6060, 2, 0);
    let lone = [number(0x6040, 6, 0), mode.clone()];
    assert!(!DataSheet::new(&lone, true).is_drive());
    let words = [number(0x6040, 6, 0), number(0x6041, 6, 0), mode];
    assert!(DataSheet::new(&words, true).is_drive());
    // As texts they are no words of a drive.
    let texts = words.map(|one| DataSheetEntry { data_type: 9, ..one });
    assert!(!DataSheet::new(&texts, true).is_drive());
}

#[test]
fn a_mode_that_the_sheet_does_not_name_is_refused() {
    let modes = |bits| {
        let words = [0x6040, 0x6041].map(|index| number(index, 6, 0));
        [words[0].clone(), words[1].clone(), number(0x6060, 2, 0), number(0x6502, 7, bits)]
    };
    let cyclic = [0x2F, 0x60, 0x60, 0, 8, 0, 0, 0];
    let refused = sdo_reply_to(&mut device(&modes(0x05)), cyclic);
    assert_eq!(refused, [0x80, 0x60, 0x60, 0, 0x30, 0, 9, 6]);
    assert_eq!(sdo_reply_to(&mut device(&modes(0x80)), cyclic)[0], 0x60);
    assert_eq!(sdo_reply_to(&mut device(&modes(0)), cyclic)[0], 0x60, "the sheet tells none");
}

#[test]
fn texts_and_numbers_that_follow_the_node_are_as_listed() {
    let text = listed(0x2001, 0, 9, FactoryValue::Bytes(b"abc".to_vec()));
    let mut device = device(&[listed(0x2000, 0, 7, FactoryValue::PlusNodeId(0x100)), text]);
    assert_eq!(read(&mut device, 0x2000)[4..], [0x05, 1, 0, 0]);
    assert_eq!(read(&mut device, 0x2001), [0x47, 1, 0x20, 0, b'a', b'b', b'c', 0]);
}

#[test]
fn the_second_axis_of_a_sheet_has_a_motor_of_its_own() {
    let words = [0x6040, 0x6041, 0x6840, 0x6841].map(|index| number(index, 6, 0));
    let modes = [number(0x6060, 2, 0), number(0x6860, 2, 0), number(0x6861, 2, 0)];
    let mut all = [words.as_slice(), &modes].concat();
    all.sort_by_key(|one| one.index);
    let mut device = device(&all);
    let order = |device: &mut DataSheetDevice, index: u16, word: u8| {
        let [low, high] = index.to_le_bytes();
        assert_eq!(sdo_reply_to(device, [0x2B, low, high, 0, word, 0, 0, 0])[0], 0x60);
    };
    for word in [6, 7, 15] {
        order(&mut device, 0x6840, word);
    }
    assert_eq!(read(&mut device, 0x6841)[4] & 0x6F, 0x27, "it is enabled");
    assert_eq!(read(&mut device, 0x6041)[4] & 0x4F, 0x40, "the first is not");
    // 6860h = 3 is shown at 6861h.
    assert_eq!(sdo_reply_to(&mut device, [0x2F, 0x60, 0x68, 0, 3, 0, 0, 0])[0], 0x60);
    assert_eq!(read(&mut device, 0x6861)[4], 3);
}
