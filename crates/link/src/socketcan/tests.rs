use super::*;

/// `linux/can.h`: identifier with flags in the machine's order, length, three bytes, data.
#[test]
fn frames_are_packed_as_the_kernel_wants_them() {
    let data = [1, 2, 3, 4, 5, 6, 7, 8];
    let remote = Frame { remote: true, len: 8, ..Frame::standard(0x7FF, &[]) };
    let frames = [
        (Frame::standard(0x123, &data), 0x123_u32, 8, data),
        (
            Frame { extended: true, ..Frame::standard(0x12, &data[..2]) },
            0x8000_0012,
            2,
            [1, 2, 0, 0, 0, 0, 0, 0],
        ),
        (remote, 0x4000_07FF, 8, [0; 8]),
    ];
    for (frame, word, len, data) in frames {
        let packed = frame::pack(&frame);
        assert_eq!(packed[..4], word.to_ne_bytes());
        assert_eq!((packed[4], &packed[8..]), (len, &data[..]));
        assert_eq!(frame::unpack(&packed), Some(UnpackedFrame::Frame(frame)));
    }
    let mut packed = frame::pack(&remote);
    packed[4] = 9;
    assert_eq!(frame::unpack(&packed), None);
    assert_eq!(frame::unpack(&packed[..8]), None);
}

/// Classes and details of `linux/can/error.h`, as the kernel's slcan driver makes them.
#[test]
fn error_frames_are_described_by_their_meaning() {
    let error = |class: u32, controller| {
        let mut packed = [0; FRAME_LEN];
        packed[..4].copy_from_slice(&(0x2000_0000 | class).to_ne_bytes());
        (packed[4], packed[9]) = (8, controller);
        match frame::unpack(&packed) {
            Some(UnpackedFrame::Error(error)) => error,
            other => panic!("{other:?}"),
        }
    };
    let nothing = CanErrorReport::default();
    assert_eq!(error(0x40, 0), CanErrorReport { bus_off: true, ..nothing });
    assert_eq!(error(0x100, 0), CanErrorReport { active: true, ..nothing });
    assert_eq!(error(0x204, 0x40), CanErrorReport { active: true, ..nothing });
    assert_eq!(error(0x204, 0x04), nothing, "a warning is no error yet");
    assert_eq!(error(0x8C, 0x01), CanErrorReport { overflow: true, wire_error: true, ..nothing });
    assert_eq!(error(0xA8, 0), CanErrorReport { wire_error: true, ..nothing });
}

#[test]
fn a_controllers_clock_is_followed_without_the_kernels_delays() {
    let (mut clock, mut worst) = (HardwareClock::default(), 0);
    let origin = 1_700_000_000_000_000_000;
    // 50 ppm fast, and an interrupt that takes 10 to 500 µs.
    for n in 0..10_000_u64 {
        let true_ns = n * 300_000;
        let hardware = 7_000_000 + true_ns + true_ns / 20_000;
        let delay = if n % 16 == 0 { 10_000 } else { 10_000 + n * 7_919 % 490_000 };
        let placed = clock.kernel_time(hardware, origin + true_ns + delay);
        let error = placed.abs_diff(origin + true_ns);
        worst = worst.max(if n < 16 { 0 } else { error });
    }
    assert!(worst <= 15_000, "{worst} ns");
    // Another program set the kernel's clock back by a minute.
    let hardware = 7_000_000 + 3_000_300_000;
    let back = origin - 60_000_000_000;
    assert_eq!(clock.kernel_time(hardware, back), back);
}

/// `RTM_NEWLINK` as the kernel sends it: an Ethernet interface, a controller, a virtual one.
#[test]
fn interfaces_are_read_from_netlink() {
    let attribute = |kind: u16, value: &[u8]| {
        let mut bytes = (value.len() as u16 + 4).to_ne_bytes().to_vec();
        bytes.extend(kind.to_ne_bytes());
        bytes.extend(value);
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    };
    let message = |hardware: u16, index: u32, flags: u32, attributes: &[Vec<u8>]| {
        let mut body = vec![0, 0];
        body.extend(hardware.to_ne_bytes());
        [index, flags, 0].iter().for_each(|word| body.extend(word.to_ne_bytes()));
        attributes.iter().for_each(|attribute| body.extend(attribute));
        let mut bytes = (body.len() as u32 + 16).to_ne_bytes().to_vec();
        bytes.extend(16_u16.to_ne_bytes());
        bytes.extend([0; 10]);
        bytes.extend(body);
        bytes
    };
    let timing: Vec<u8> = [250_000_u32, 875].iter().flat_map(|word| word.to_ne_bytes()).collect();
    let data = [
        attribute(1, &timing),
        attribute(4, &3_u32.to_ne_bytes()),
        attribute(6, &100_u32.to_ne_bytes()),
    ];
    let info = [attribute(1, b"can\0"), attribute(2 | 0x8000, &data.concat())].concat();
    let answer = [
        message(1, 2, 1, &[attribute(3, b"eth0\0")]),
        message(280, 4, 0x10041, &[attribute(3, b"can0\0"), attribute(18, &info)]),
        message(280, 5, 0, &[attribute(3, b"vcan0\0"), attribute(18, &attribute(1, b"vcan\0"))]),
    ]
    .concat();
    let mut found = Vec::new();
    assert!(!netlink::parse_answer(&answer, &mut found));
    let interface = |name: &str, index, up, kind: &str| CanInterface {
        name: name.into(),
        index,
        up,
        kind: kind.into(),
        bit_rate: None,
        controller: None,
        restart_ms: None,
    };
    let can0 = CanInterface {
        bit_rate: Some(250_000),
        controller: Some(ControllerState::BusOff),
        restart_ms: Some(100),
        ..interface("can0", 4, true, "can")
    };
    assert_eq!(found, [can0.clone(), interface("vcan0", 5, false, "vcan")]);
    // Cut off anywhere, or with any byte damaged, it is read without panic.
    for at in 0..answer.len() {
        netlink::parse_answer(&answer[..at], &mut Vec::new());
        for value in [0, 1, 0xFF] {
            let mut damaged = answer.clone();
            damaged[at] = value;
            netlink::parse_answer(&damaged, &mut Vec::new());
        }
    }
    let trouble = |interface: &CanInterface| port(interface.clone()).error.unwrap();
    assert!(trouble(&can0).hint().contains("`sudo ip link set can0 type can restart`"));
    assert!(trouble(&found[1]).hint().contains("`sudo ip link set vcan0 up`"));
    let error = check_bit_rate(&can0, CanLine { bit_rate: 500_000 }).unwrap_err();
    let wanted = "sudo ip link set can0 up type can bitrate 500000";
    assert!(error.hint().contains(wanted), "{}", error.hint());
    assert_eq!(check_bit_rate(&can0, CanLine { bit_rate: 0 }), Ok(()));
}

#[test]
fn an_interface_that_is_not_there_is_reported_with_what_to_try() {
    let error = open("nocan7", CanLine { bit_rate: 0 }).unwrap_err();
    assert!(matches!(error.cause(), Cause::NotFound | Cause::Unsuitable | Cause::Permission));
    assert!(error.hint().contains("CAN"), "{}", error.hint());
}
