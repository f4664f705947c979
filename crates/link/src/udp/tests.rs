use super::datagram::{DATAGRAM_MAX, UnpackedDatagram, pack, unpack};
use super::*;
use crate::link::LinkIo;

/// Nothing leaves this machine; each test has a port of its own.
fn group(port: u16) -> MulticastGroup {
    MulticastGroup { hops: 0, port, ..MulticastGroup::default() }
}

fn packed(frame: &Frame, wall_ns: u64) -> Vec<u8> {
    let mut out = [0; DATAGRAM_MAX];
    let len = pack(frame, wall_ns, &mut out);
    out[..len].to_vec()
}

fn next(link: &UdpLink, ms: u32) -> Option<Frame> {
    let mut frame = Frame::default();
    match link.receive(&mut frame, clock::now().plus_ms(ms)).unwrap() {
        Received::Bytes { .. } => Some(frame),
        _ => None,
    }
}

#[test]
fn one_hears_the_other_and_none_itself() {
    let group = group(43_117);
    let (one, other) = (open(group).unwrap(), open(group).unwrap());
    let sent = Frame { id: 0x1ABC_DEF0, extended: true, ..Frame::standard(0, &[1, 2, 3]) };
    one.send(&sent).unwrap();
    assert_eq!(next(&other, 2000), Some(sent));
    assert_eq!(next(&one, 50), None);
}

#[test]
fn ipv6_is_a_bus_as_well() {
    let group = MulticastGroup { address: GROUP_IPV6.into(), ..group(43_121) };
    let (one, other) = match (open(group), open(group)) {
        (Ok(one), Ok(other)) => (one, other),
        (Err(error), _) | (_, Err(error)) => return eprintln!("skipped: no IPv6 here: {error}"),
    };
    let sent = Frame::standard(0x7FF, &[6; 6]);
    one.send(&sent).unwrap();
    assert_eq!(next(&other, 2000), Some(sent));
    assert_eq!(next(&one, 50), None);
}

/// Datagrams that overflow the socket's buffer are counted; our own are not.
#[cfg(target_os = "linux")]
#[test]
fn unread_frames_are_counted() {
    const BURST: u64 = 5000;
    let group = group(43_118);
    let (one, other) = (open(group).unwrap(), open(group).unwrap());
    for n in 0..BURST {
        one.send(&Frame::standard(0x123, &n.to_le_bytes())).unwrap();
    }
    let mut received = 0;
    while next(&other, 20).is_some() {
        received += 1;
    }
    assert!(received > 100, "{received}");
    assert_eq!(other.losses(), Losses { overrun: BURST - received, ..Losses::default() });
    assert_eq!(one.losses(), Losses::default());
}

#[test]
fn groups_are_read_as_they_are_written() {
    let default = MulticastGroup::default();
    assert_eq!("239.74.163.2:43113".parse(), Ok(default));
    assert_eq!("239.74.163.2".parse(), Ok(default));
    let six = MulticastGroup { address: GROUP_IPV6.into(), port: 5000, ..default };
    assert_eq!("[ff15:7079:7468:6f6e:6465:6d6f:6d63:6173]:5000".parse(), Ok(six));
    let six = MulticastGroup { port: PORT, ..six };
    assert_eq!("ff15:7079:7468:6f6e:6465:6d6f:6d63:6173".parse(), Ok(six));
    for wrong in ["", "10.0.0.5:43113", "239.74.163.2:0", "239.74.163.2:x", "can0", "::1"] {
        let error = wrong.parse::<MulticastGroup>().unwrap_err();
        assert!(error.hint().contains("239.74.163.2:43113"), "{wrong}");
    }
}

/// Datagrams that python-can 4.6.1 made (`can.interfaces.udp_multicast.utils.pack_message`).
#[test]
fn datagrams_are_those_of_python_can() {
    let vectors = [
        (Frame::standard(0x123, &[0xDE, 0xAD, 0xBE, 0xEF]), 1_700_000_000_500_000_000, STANDARD),
        (
            Frame {
                extended: true,
                id: 0x1F33_4455,
                ..Frame::standard(0, &[1, 2, 3, 4, 5, 6, 7, 8])
            },
            0,
            EXTENDED,
        ),
        (Frame { remote: true, len: 4, ..Frame::standard(0x7F, &[]) }, 0, REMOTE),
    ];
    for (frame, wall_ns, hex) in vectors {
        let datagram = bytes(hex);
        assert_eq!(packed(&frame, wall_ns), datagram);
        assert_eq!(unpack(&datagram), Some(UnpackedDatagram::Frame(frame)));
    }
    assert_eq!(unpack(&bytes(ERROR)), Some(UnpackedDatagram::ErrorFrame));
    assert_eq!(unpack(&bytes(FD)), None);
}

#[test]
fn keys_come_in_any_order_and_foreign_ones_are_skipped() {
    let id = "ae6172626974726174696f6e5f6964cd0123";
    let data = "a464617461c402abcd";
    let standard = "ae69735f657874656e6465645f6964c2";
    let foreign = "a3666f6f9281a16101c0";
    let nested = "a36261728193c3cb3ff0000000000000d60112345678c0";
    let frame = Some(UnpackedDatagram::Frame(Frame::standard(0x123, &[0xAB, 0xCD])));
    assert_eq!(unpack(&bytes(&format!("83{data}{standard}{id}"))), frame);
    assert_eq!(unpack(&bytes(&format!("85{foreign}{id}{nested}{data}{standard}"))), frame);
    assert_eq!(unpack(&bytes(&format!("de0003{id}{standard}{data}"))), frame);
    // Without the key python-can takes a frame for an extended one.
    let extended = Frame { extended: true, ..Frame::standard(0x123, &[0xAB, 0xCD]) };
    assert_eq!(unpack(&bytes(&format!("82{id}{data}"))), Some(UnpackedDatagram::Frame(extended)));
    for wrong in [
        format!("82{data}{standard}"),
        format!("83{id}{standard}{data}00"),
        format!("84{id}{standard}{data}a3646c6303"),
        format!("83{id}{standard}a464617461c409000000000000000000"),
        format!("82ae6172626974726174696f6e5f6964cd0800{standard}"),
        format!("82ae6172626974726174696f6e5f6964d1ffff{standard}"),
        "ddffffffff".to_owned(),
        "81a0dfffffffff".to_owned(),
        "c1".to_owned(),
        String::new(),
    ] {
        assert_eq!(unpack(&bytes(&wrong)), None, "{wrong}");
    }
}

/// Cut off anywhere, or with any byte changed, a datagram is refused or read, never worse; and it
/// is read alike whether or not its map is counted in the usual form.
#[test]
fn damaged_datagrams_do_no_harm() {
    for hex in [STANDARD, EXTENDED, REMOTE, ERROR, FD] {
        let datagram = bytes(hex);
        for at in 0..datagram.len() {
            assert_eq!(unpack(&datagram[..at]), None);
            for value in 0..=u8::MAX {
                let mut damaged = datagram.clone();
                damaged[at] = value;
                let read = unpack(&damaged);
                if let Some(UnpackedDatagram::Frame(frame)) = read {
                    assert!(frame.len <= 8 && frame.id <= 0x1FFF_FFFF);
                }
                if at > 0 {
                    damaged.splice(..1, [0xDE, 0, damaged[0] & 0x0F]);
                    assert_eq!(unpack(&damaged), read);
                }
            }
        }
    }
}

/// Datagrams of another program on the port are counted and ignored.
#[test]
fn a_datagram_that_is_no_frame_is_counted() {
    let group = group(43_119);
    let (link, udp_link) = (open(group).unwrap(), open(group).unwrap());
    for hex in ["00", ERROR, FD] {
        udp_link.sender.send(&bytes(hex)).unwrap();
    }
    let sent = Frame::standard(0x1, &[]);
    udp_link.send(&sent).unwrap();
    assert_eq!(next(&link, 2000), Some(sent));
    assert_eq!(link.losses(), Losses { malformed: 2, errors: 1, ..Losses::default() });
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits = hex.as_bytes().chunks_exact(2);
    digits.map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

const STANDARD: &str = "8ba974696d657374616d70cb41d954fc40200000ae6172626974726174696f6e5f6964cd0123ae69735f6578\
     74656e6465645f6964c2af69735f72656d6f74655f6672616d65c2ae69735f6572726f725f6672616d65c2a7\
     6368616e6e656cc0a3646c6304a464617461c404deadbeefa569735f6664c2ae626974726174655f73776974\
     6368c2b56572726f725f73746174655f696e64696361746f72c2";

const EXTENDED: &str = "8ba974696d657374616d70cb0000000000000000ae6172626974726174696f6e5f6964ce1f334455ae69735f\
     657874656e6465645f6964c3af69735f72656d6f74655f6672616d65c2ae69735f6572726f725f6672616d65\
     c2a76368616e6e656cc0a3646c6308a464617461c4080102030405060708a569735f6664c2ae626974726174\
     655f737769746368c2b56572726f725f73746174655f696e64696361746f72c2";

const REMOTE: &str = "8ba974696d657374616d70cb0000000000000000ae6172626974726174696f6e5f69647fae69735f65787465\
     6e6465645f6964c2af69735f72656d6f74655f6672616d65c3ae69735f6572726f725f6672616d65c2a76368\
     616e6e656cc0a3646c6304a464617461c400a569735f6664c2ae626974726174655f737769746368c2b56572\
     726f725f73746174655f696e64696361746f72c2";

const ERROR: &str = "8ba974696d657374616d70cb0000000000000000ae6172626974726174696f6e5f696440ae69735f65787465\
     6e6465645f6964c3af69735f72656d6f74655f6672616d65c2ae69735f6572726f725f6672616d65c3a76368\
     616e6e656cc0a3646c6308a464617461c4080000000000000000a569735f6664c2ae626974726174655f7377\
     69746368c2b56572726f725f73746174655f696e64696361746f72c2";

const FD: &str = "8ba974696d657374616d70cb0000000000000000ae6172626974726174696f6e5f6964cd0123ae69735f6578\
     74656e6465645f6964c2af69735f72656d6f74655f6672616d65c2ae69735f6572726f725f6672616d65c2a7\
     6368616e6e656cc0a3646c630ca464617461c40c000000000000000000000000a569735f6664c3ae62697472\
     6174655f737769746368c3b56572726f725f73746174655f696e64696361746f72c2";
