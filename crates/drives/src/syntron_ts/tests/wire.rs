use super::*;

/// The manual's printed frames, RTU with its true silence of 10 ms (TS manual V2 §1.4.1, §2.3).
#[test]
fn printed_frames_are_answered_as_printed() {
    let cases: [(&[u8], &[u8]); 4] = [
        (
            &[0x01, 0x06, 0x00, 0x00, 0x00, 0x14, 0x89, 0xC5],
            &[0x01, 0x06, 0x00, 0x00, 0x00, 0x14, 0x89, 0xC5],
        ),
        (&[0x01, 0x01, 0x00, 0x00, 0x00, 0x01, 0xFD, 0xCA], &[0x01, 0x01, 0x01]),
        (&[0x01, 0x02, 0x00, 0x00, 0x00, 0x01, 0xB9, 0xCA], &[0x01, 0x02, 0x01, 0x00, 0xA1, 0x88]),
        (
            &[0x01, 0x10, 0x00, 0x30, 0x00, 0x02, 0x04, 0x00, 0x05, 0x00, 0x05, 0x20, 0xB9],
            &[0x01, 0x10, 0x00, 0x30, 0x00, 0x02, 0x41, 0xC7],
        ),
    ];
    let options = DeviceOptions { untimed: false, ..OPTIONS };
    let mut fixture = DriveFixture::new();
    fixture.device = SyntronTs::create_device(SyntronTs::profiles()[0], &options).unwrap();
    fixture.act(Act::Switch { which: 0, at: f64::NAN });
    for (request, reply) in cases {
        Station::<Stream>::handle_input(&mut fixture.device, fixture.now, request);
        let mut out = [0; STREAM_UNIT_MAX];
        fixture.advance(10);
        assert_eq!(
            Station::<Stream>::poll_transmit(&mut fixture.device, fixture.now, &mut out),
            None,
            "10 ms are not over"
        );
        fixture.advance(1);
        let len =
            Station::<Stream>::poll_transmit(&mut fixture.device, fixture.now, &mut out).unwrap();
        assert_eq!(out[..len.min(reply.len())], *reply);
        fixture.advance(20);
    }
}

#[test]
fn two_requests_within_the_silence_are_one_bad_frame() {
    let options = DeviceOptions { untimed: false, ..OPTIONS };
    let mut fixture = DriveFixture::new();
    fixture.device = SyntronTs::create_device(SyntronTs::profiles()[0], &options).unwrap();
    let request = [0x01, 0x06, 0x00, 0x33, 0x00, 0xC8, 0x78, 0x53];
    Station::<Stream>::handle_input(&mut fixture.device, fixture.now, &request);
    fixture.advance(5);
    Station::<Stream>::handle_input(&mut fixture.device, fixture.now, &request);
    assert_eq!(fixture.reply(), None);
    Station::<Stream>::handle_input(&mut fixture.device, fixture.now, &request);
    assert_eq!(fixture.reply().unwrap(), request);
}

#[test]
fn only_five_functions_are_known() {
    let mut fixture = DriveFixture::new();
    for (pdu, code) in [
        (&[4, 0, 0, 0, 1][..], 0x84),
        (&[5, 0, 0, 0xFF, 0], 0x85),
        (&[15, 0, 0, 0, 1, 1, 1], 0x8F),
        (&[22, 0, 0, 0, 0, 0, 0], 0x96),
        (&[0x43, 0, 0], 0xC3),
    ] {
        assert_eq!(fixture.request(pdu).unwrap(), [code, 1]);
    }
}

#[test]
fn registers_exist_as_far_as_the_manual_says() {
    let mut fixture = DriveFixture::new();
    for address in [0x0000, 0x02FF, 0x1000, 0x102F] {
        fixture.read(address);
    }
    for address in [0x0300_u16, 0x0FFF, 0x1030, 0x2000, 0xFFFF] {
        let [a, b] = address.to_be_bytes();
        assert_eq!(fixture.request(&[3, a, b, 0, 1]).unwrap(), [0x83, 2]);
        assert_eq!(fixture.try_write(address, 0), Err(2));
    }
    assert_eq!(fixture.request(&[3, 2, 0xFF, 0, 2]).unwrap(), [0x83, 2]);
    assert_eq!(fixture.try_write(0x1000, 0), Err(2), "readings cannot be written");
    fixture.write(0x02AB, 0xBEEF);
    assert_eq!(fixture.read(0x02AB), 0xBEEF, "unnamed registers store");
    assert_eq!(fixture.read(0x1005), 0, "unnamed readings are 0");
}

#[test]
fn limits_are_kept_and_a_block_is_written_whole_or_not_at_all() {
    let mut fixture = DriveFixture::new();
    for (number, value) in
        [(0x00, 21), (0x38, 2), (0x3A, 128), (0x3C, 7), (0x99, 2), (0x20B, 33), (0x20E, 2)]
    {
        assert_eq!(fixture.try_write(number, value), Err(3), "Fn_{number:X}");
    }
    for value in [0, 3, 100, 103, 0x101, 0x102] {
        assert_eq!(fixture.try_write(0x3D, value), Err(3), "Fn_3D = {value}");
    }
    for value in [1, 2, 101, 102] {
        fixture.write(0x3D, value);
    }
    fixture.write(0x33, (-3000_i16) as u16);
    let block = [16, 0x02, 0x0A, 0, 2, 4, 0, 0, 0, 33];
    assert_eq!(fixture.request(&block).unwrap(), [0x90, 3]);
    assert_eq!(fixture.read(0x20A), 1, "the good half was not written either");
}

#[test]
fn lines_are_read_eight_at_once() {
    let mut fixture = DriveFixture::new();
    assert_eq!(fixture.request(&[1, 0, 0, 0, 1]).unwrap(), [1, 1, 0b0101], "ready, path done");
    fixture.write(0x00, 1);
    fixture.write(0x38, 1);
    assert_eq!(fixture.request(&[1, 0, 0, 0, 1]).unwrap(), [1, 1, 0b1101], "and powered");
    assert_eq!(fixture.request(&[1, 0, 3, 0, 1]).unwrap(), [1, 1, 1], "shifted by the start");
    fixture.act(Act::Fault(0x1614));
    assert_eq!(fixture.request(&[1, 0, 0, 0, 4]).unwrap(), [1, 1, 0b0110]);
    fixture.act(Act::Input(8, true));
    // The shaft is forward of the home switch, so input 5 is closed too.
    assert_eq!(fixture.request(&[2, 0, 0, 0, 1]).unwrap(), [2, 1, 0b1001_0000]);
    assert_eq!(fixture.request(&[2, 0, 4, 0, 2]).unwrap(), [2, 1, 1]);
    assert_eq!(fixture.request(&[1, 0, 4, 0, 1]).unwrap(), [0x81, 2]);
    assert_eq!(fixture.request(&[2, 0, 8, 0, 1]).unwrap(), [0x82, 2]);
}

#[test]
fn flash_wears_unless_writes_are_kept_in_ram() {
    let mut fixture = DriveFixture::new();
    for _ in 0..3 {
        fixture.write(0x33, 100);
    }
    assert_eq!(fixture.truth().flash_writes, 3, "equal values too");
    fixture.write(0x99, 1);
    fixture.write(0x33, 200);
    fixture.fill(1, 1002, 90_000, 100, [1, 2, 3, 4]);
    assert_eq!(fixture.truth().flash_writes, 4, "Fn_99 itself is kept");
    fixture.act(Act::PowerCycle);
    assert_eq!([0x33, 0x99, 0x100].map(|n| fixture.read(n)), [100, 1, 0]);
    fixture.write(0x99, 0);
    fixture.fill(1, 1002, 90_000, 100, [1, 2, 3, 4]);
    assert_eq!(fixture.truth().flash_writes, 4 + 1 + 8);
    fixture.act(Act::PowerCycle);
    assert_eq!([0x100, 0x103, 0x107].map(|n| fixture.read(n)), [1002, 100, 4]);
}

#[test]
fn variants_refuse_modes_they_were_not_bought_with() {
    for (variant, allowed) in [
        ("standard", [false, false]),
        ("position", [true, false]),
        ("canopen", [false, true]),
        ("all", [true, true]),
    ] {
        let mut fixture = DriveFixture::with(&[("variant", variant)]);
        for (mode, allowed) in [14, 20].into_iter().zip(allowed) {
            let wanted = if allowed { Ok(()) } else { Err(3) };
            assert_eq!(fixture.try_write(0x00, mode), wanted, "{variant} {mode}");
        }
        fixture.write(0x00, 1);
    }
    let bad = DeviceOptions { extra: &[("variant", "deluxe")], ..OPTIONS };
    assert_eq!(SyntronTs::create_device(SyntronTs::profiles()[0], &bad).err(), Some("deluxe"));
    let bad = DeviceOptions { extra: &[("colour", "red")], ..OPTIONS };
    assert_eq!(SyntronTs::create_device(SyntronTs::profiles()[0], &bad).err(), Some("colour"));
}

#[test]
fn a_password_locks_the_chosen_range() {
    let mut fixture = DriveFixture::with(&[("locked", "00+3A")]);
    assert_eq!(fixture.try_write(0x00, 1), Err(4));
    assert_eq!(fixture.try_write(0x3A, 5), Err(4));
    fixture.write(0x33, 5);
    fixture.write(0x3F, 9876);
    fixture.write(0x00, 1);
    fixture.write(0x3F, 9870);
    assert_eq!(fixture.try_write(0x00, 2), Err(4));
}

#[test]
fn address_baud_and_framing_act_at_the_next_power_on() {
    let mut fixture = DriveFixture::with(&[]);
    let options = DeviceOptions { untimed: false, extra: &[("gap", "0")], ..OPTIONS };
    fixture.device = SyntronTs::create_device(SyntronTs::profiles()[0], &options).unwrap();
    assert_eq!(Station::<Stream>::line(&fixture.device).baud, 115_200);
    for (number, value) in [(0x3A, 7), (0x3C, 1), (0x3D, 102)] {
        fixture.write(number, value);
    }
    assert_eq!(fixture.read(0x3A), 7, "still answers as before");
    fixture.act(Act::PowerCycle);
    assert_eq!(Station::<Stream>::line(&fixture.device).baud, 9600);
    assert_eq!(fixture.request(&[3, 0, 0x3A, 0, 1]), None, "not at address 1, not in RTU");
    fixture.ascii = true;
    assert_eq!(fixture.request(&[3, 0, 0x3A, 0, 1]), None, "not at address 1");
    fixture.unit = 7;
    assert_eq!(fixture.read(0x3A), 7);
    for (value, baud) in [2400, 9600, 38_400, 57_600, 115_200, 192_000, 512_000].iter().enumerate()
    {
        fixture.write(0x3C, value as u16);
        fixture.act(Act::PowerCycle);
        assert_eq!(Station::<Stream>::line(&fixture.device).baud, *baud);
    }
}

#[test]
fn settings_can_act_at_once() {
    let mut fixture = DriveFixture::with(&[("settings", "at-once")]);
    fixture.write(0x3A, 7);
    assert_eq!(fixture.request(&[3, 0, 0x3A, 0, 1]), None);
    fixture.unit = 7;
    assert_eq!(fixture.read(0x3A), 7);
}

#[test]
fn ascii_takes_twelve_words() {
    let options = DeviceOptions { wires: &["modbus-ascii"], ..OPTIONS };
    let mut fixture = DriveFixture::new();
    fixture.device = SyntronTs::create_device(SyntronTs::profiles()[0], &options).unwrap();
    fixture.ascii = true;
    assert_eq!(fixture.read(0x3D), 2);
    assert_eq!(fixture.request(&[3, 0, 0, 0, 12]).unwrap().len(), 2 + 24);
    assert_eq!(fixture.request(&[3, 0, 0, 0, 13]).unwrap(), [0x83, 3]);
}

#[test]
fn a_broadcast_is_obeyed_in_silence() {
    let mut fixture = DriveFixture::new();
    fixture.unit = 0;
    assert_eq!(fixture.request(&[6, 0, 0x33, 0, 100]), None);
    fixture.unit = 1;
    assert_eq!(fixture.read(0x33), 100);
}

#[test]
fn the_encoder_position_comes_low_word_first() {
    let mut fixture = DriveFixture::positioning(&[]);
    // The manual's example value: 0x000BF32D counts.
    fixture.write(fn_registers::MOTOR_TURNS, 1);
    fixture.write(fn_registers::TRAVEL, 10);
    fixture.fill(1, 1002, 783_149, 3000, [100, 100, 0, 0]);
    fixture.trigger(1);
    fixture.settle(10_000);
    fixture.is_at(0xBF32D);
    assert_eq!(fixture.read(0x102F), 0x000B);
}

#[test]
fn the_sibling_tells_load_version_and_temperature() {
    let readings = [0x1002, 0x1008, 0x1016];
    let mut fixture = DriveFixture::new();
    assert_eq!(readings.map(|address| fixture.read(address)), [0; 3]);
    let mut fixture = DriveFixture::with(&[("ds102", "1")]);
    fixture.write(0x00, 1);
    fixture.write(0x38, 1);
    fixture.act(Act::Load(-0.65));
    fixture.advance(500);
    let [load, version, temperature] = readings.map(|address| fixture.read(address));
    assert!((450..550).contains(&load), "half the rated torque, not {load}");
    assert_eq!((version, temperature), (0x0102, 25));
    assert_eq!(fixture.read(0x05), 1270);
    for (number, value) in [(0x2B, 10), (0x2C, 10), (0x2A, 1), (0x33, 1000)] {
        fixture.write(number, value);
    }
    fixture.act(Act::Load(0.0));
    fixture.advance(20);
    assert!(fixture.truth().current.abs() < 1.9, "limited: {}", fixture.truth().current);
}

/// §1.1: a TS without the position option. Its stop is that of the speed, and no error.
#[test]
fn a_standard_ts_has_no_registers_of_the_position_option() {
    let mut fixture = DriveFixture::with(&[("variant", "standard")]);
    assert_eq!(fixture.try_write(0x20E, 1), Err(2));
    assert_eq!(fixture.request(&[3, 0x02, 0x00, 0, 1]), Some(std::vec![0x83, 2]));
    assert_eq!(fixture.try_write(0x33, 100), Ok(()));
}

/// Function 16 whose count, byte count and data contradict each other is exception 03, and writes nothing.
#[test]
fn a_write_of_several_registers_with_a_wrong_count_is_exception_03() {
    let mut fixture = DriveFixture::new();
    let before = fixture.read(0x33);
    for pdu in [
        &[0x10, 0, 0x33, 0, 1, 4, 0, 7, 0, 7][..],
        &[0x10, 0, 0x33, 0, 2, 2, 0, 7],
        &[0x10, 0, 0x33, 0, 0, 0],
        &[0x10, 0, 0x33, 0, 1, 1, 7],
    ] {
        assert_eq!(fixture.request(pdu), Some(std::vec![0x90, 3]), "{pdu:02X?}");
    }
    assert_eq!(fixture.read(0x33), before);
}
