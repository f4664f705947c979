//! The kernel's CAN interfaces, where there are some: `interop/test_socketcan.py` runs this in a
//! guest that has them. Elsewhere each test prints that it is skipped.
//!
//! A program of its own: it is carried into that guest.
#![cfg(target_os = "linux")]

use std::process::Command;

use polepair_core::medium::{CanLine, Frame};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;
use polepair_link::socketcan::{self, CanFilter, SocketcanLink};
use polepair_link::{Cause, LinkIo, Losses, Received, clock};

const ANY: CanLine = CanLine { bit_rate: 0 };

/// Two ends of a virtual bus of the test's own, which goes with it.
struct Bus(&'static str);

impl Bus {
    /// Makes an interface. Returns `None` if the environment does not promise that one can be made.
    fn new(name: &'static str) -> Option<Self> {
        if std::env::var_os("POLEPAIR_VCAN").is_none() {
            eprintln!("skipped: runs in the guest of interop/test_socketcan.py");
            return None;
        }
        let bus = Self(name);
        assert!(ip(&["link", "add", name, "type", "vcan"]) && ip(&["link", "set", name, "up"]));
        Some(bus)
    }

    fn open(&self) -> SocketcanLink {
        socketcan::open(self.0, ANY).unwrap()
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        ip(&["link", "delete", self.0]);
    }
}

fn ip(words: &[&str]) -> bool {
    Command::new("ip").args(words).output().is_ok_and(|output| output.status.success())
}

fn receive(link: &SocketcanLink) -> (Received, Frame) {
    let mut frame = Frame::default();
    (link.receive(&mut frame, clock::now().plus_ms(1000)).unwrap(), frame)
}

fn next(link: &SocketcanLink) -> Frame {
    let (received, frame) = receive(link);
    assert!(matches!(received, Received::Bytes { len: 1, .. }), "{received:?}");
    frame
}

fn is_quiet(link: &SocketcanLink) -> bool {
    let mut frame = Frame::default();
    link.receive(&mut frame, clock::now().plus_ms(50)).unwrap() == Received::TimedOut
}

fn extended(id: u32, data: &[u8]) -> Frame {
    Frame { id, extended: true, ..Frame::standard(0, data) }
}

#[test]
fn frames_of_every_kind_pass_and_are_stamped() {
    let Some(bus) = Bus::new("pp0") else { return };
    let (one, other) = (bus.open(), bus.open());
    let remote = Frame { remote: true, len: 5, ..Frame::standard(0x7FF, &[]) };
    let frames = [
        Frame::standard(0, &[]),
        Frame::standard(0x123, &[1, 2, 3, 4, 5, 6, 7, 8]),
        extended(0x1FFF_FFFF, &[0xFF]),
        extended(0x123, &[0; 8]),
        remote,
        Frame { extended: true, ..remote },
    ];
    for frame in frames {
        let before = clock::now();
        one.send(&frame).unwrap();
        let (received, got) = receive(&other);
        let Received::Bytes { at, .. } = received else { panic!("{received:?}") };
        assert_eq!(got, frame);
        // The wall clock and the monotonic one are read one after the other.
        assert!(before <= at.plus_ns(1_000_000) && at <= clock::now(), "{before:?} {at:?}");
    }
    assert!(is_quiet(&one), "nobody hears himself");
}

#[test]
fn frames_dropped_by_the_kernel_are_counted() {
    const BURST: u64 = 10_000;
    let Some(bus) = Bus::new("pp1") else { return };
    let (one, other) = (bus.open(), bus.open());
    for n in 0..BURST {
        one.send(&Frame::standard(0x55, &n.to_le_bytes())).unwrap();
    }
    let mut received = 0;
    while !is_quiet(&other) {
        received += 1;
    }
    assert!(received > 100 && received < BURST, "{received}");
    // The count comes with the next frame that is received.
    one.send(&Frame::standard(0x56, &[])).unwrap();
    assert_eq!(next(&other).id, 0x56);
    assert_eq!(other.losses(), Losses { overrun: BURST - received, ..Losses::default() });
}

#[test]
fn the_kernel_filters() {
    let Some(bus) = Bus::new("pp2") else { return };
    let (one, other) = (bus.open(), bus.open());
    let filter = CanFilter { id: 0x200, mask: 0x700, extended: false };
    other.set_filters(&[filter, CanFilter { id: 7, mask: 0x1FFF_FFFF, extended: true }]).unwrap();
    assert_eq!(other.set_filters(&[]).unwrap_err().cause(), Cause::Unsuitable);
    let passing = [Frame::standard(0x2FF, &[1]), extended(7, &[2])];
    for frame in [extended(0x200, &[]), passing[0], Frame::standard(7, &[]), passing[1]] {
        one.send(&frame).unwrap();
    }
    assert_eq!([next(&other), next(&other)], passing);
    assert!(is_quiet(&other));
}

#[test]
fn error_frames_tell_what_happens_to_the_bus() {
    let Some(bus) = Bus::new("pp3") else { return };
    let link = bus.open();
    // Receive overflow, bus-off twice, no acknowledgement, restarted, and no news after that.
    for error in ["20000004#0001", "20000040#", "20000040#", "20000020#", "20000100#", "20000100#"]
    {
        let (class, data) = error.split_once('#').unwrap();
        let frame = format!("{class}#{data:0<16}");
        assert!(Command::new("cansend").args([bus.0, &frame]).status().unwrap().success());
    }
    let (off, up) = (receive(&link).0, receive(&link).0);
    assert!(matches!(off, Received::Line { event: LineEvent::BusOff, .. }), "{off:?}");
    assert!(matches!(up, Received::Line { event: LineEvent::Up, .. }), "{up:?}");
    assert!(is_quiet(&link));
    assert_eq!(link.losses(), Losses { overrun: 1, errors: 1, ..Losses::default() });
}

#[test]
fn an_interface_is_lost_and_comes_back() {
    let Some(bus) = Bus::new("pp4") else { return };
    let (link, other) = (bus.open(), bus.open());
    let mut frame = Frame::default();
    assert!(ip(&["link", "set", bus.0, "down"]));
    let lost = link.receive(&mut frame, Instant::FAR_FUTURE).unwrap_err();
    assert_eq!((lost.cause(), lost.is_gone()), (Cause::Down, true));
    let command = "`sudo ip link set pp4 up`";
    assert!(lost.hint().contains(command), "{}", lost.hint());
    assert_eq!(other.send(&frame).unwrap_err().cause(), Cause::Down);
    let closed = link.reopen().err().unwrap();
    assert_eq!(closed.cause(), Cause::Down);
    assert!(ip(&["link", "set", bus.0, "up"]));
    let again = link.reopen().unwrap();
    bus.open().send(&Frame::standard(0x42, &[])).unwrap();
    let received = again.receive(&mut frame, clock::now().plus_ms(1000)).unwrap();
    assert!(matches!(received, Received::Bytes { .. }), "{received:?}");
    assert_eq!(frame.id, 0x42);

    assert!(ip(&["link", "delete", bus.0]));
    let lost = again.receive(&mut frame, Instant::FAR_FUTURE).unwrap_err();
    assert!(matches!(lost.cause(), Cause::Down | Cause::Gone), "{lost}");
    assert_eq!(again.send(&frame).unwrap_err().cause(), Cause::Gone);
    assert_eq!(again.reopen().err().unwrap().cause(), Cause::NotFound);
}

#[test]
fn interfaces_are_listed() {
    let Some(bus) = Bus::new("pp5") else { return };
    let found = socketcan::interfaces();
    let listed = found.iter().find(|interface| interface.name == bus.0).unwrap();
    assert_eq!((listed.up, listed.kind.as_str(), listed.bit_rate), (true, "vcan", None));
    let error = socketcan::open("nocan", ANY).unwrap_err();
    assert_eq!(error.cause(), Cause::NotFound);
    assert!(error.hint().contains(bus.0), "{}", error.hint());
    assert_eq!(socketcan::open("lo", ANY).unwrap_err().cause(), Cause::NotFound);
}
