//! A round trip allocates nothing once the connection runs, nor does a frame on any CAN link.
//!
//! A program of its own: it replaces the allocator of the process.
#![cfg(unix)]
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use polepair_core::error::Outcome;
use polepair_core::lane::Lane;
use polepair_core::medium::{Can, CanLine, Frame, SerialLine, Stream};
use polepair_core::profile::ParameterId;
use polepair_core::proto::tmcl::Tmcl;
use polepair_core::proto::{HostOptions, Protocol};
use polepair_core::station::AxisIndex;
use polepair_core::time::Instant;
use polepair_link::{
    Connection, LinkError, LinkIo, LinkWaker, Received, clock, slcan, socketcand, udp,
};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: both pass on to the system's allocator what they are given; the counter does not
// allocate (a const-initialised `Cell` without a destructor).
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps the promises of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the promises of `dealloc`.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A drive that is there at once: module 1 answers 123456 to whatever it is asked.
struct Prompt(LinkWaker, AtomicBool);

impl LinkIo<Stream> for Prompt {
    fn now(&self) -> Instant {
        clock::now()
    }
    fn send(&self, _unit: &[u8]) -> Result<(), LinkError> {
        self.1.store(true, Ordering::Relaxed);
        Ok(())
    }
    fn receive(&self, buffer: &mut [u8], _until: Instant) -> Result<Received, LinkError> {
        if !self.1.swap(false, Ordering::Relaxed) {
            return Ok(Received::TimedOut);
        }
        let mut reply = [2, 1, 100, 6, 0, 1, 0xE2, 0x40, 0];
        reply[8] = reply[..8].iter().fold(0, |sum, byte| u8::wrapping_add(sum, *byte));
        buffer[..9].copy_from_slice(&reply);
        Ok(Received::Bytes { len: 9, at: clock::now() })
    }
    fn set_line(&self, _line: SerialLine) -> Result<(), LinkError> {
        Ok(())
    }
    fn waker(&self) -> LinkWaker {
        self.0.clone()
    }
    fn describe(&self) -> String {
        String::new()
    }
}

#[test]
fn a_round_trip_allocates_nothing() {
    let options = HostOptions { gap_us: Some(0), ..HostOptions::new(0) };
    let driver = Tmcl::create_driver(Tmcl::generic_profile(), 1);
    let lane = Lane::<Stream, _>::new(Tmcl::create_host(&options, &[1]), [Box::new(driver) as _]);
    let link = Prompt(LinkWaker::new().unwrap(), AtomicBool::new(false));
    let connection = Connection::new(Box::new(link), Box::new(lane));
    let request = || {
        let deadline = clock::now().plus_ms(1_000);
        connection.request(deadline, |axes, now, ticket| {
            axes.read_parameter(now, ticket, AxisIndex(0), ParameterId(0))
        })
    };
    assert_eq!(request(), Ok(Some(Outcome::Done(123_456))));
    let before = ALLOCATIONS.get();
    for _ in 0..1_000 {
        assert_eq!(request(), Ok(Some(Outcome::Done(123_456))));
    }
    assert_eq!(ALLOCATIONS.get(), before);
    drop(vec![1_u8; 10]);
    assert_eq!(ALLOCATIONS.get(), before + 1, "the counter counts");
}

/// Returns the number of allocations on this thread in a thousand further runs of `act`.
fn allocated(mut act: impl FnMut()) -> u64 {
    act();
    let before = ALLOCATIONS.get();
    (0..1_000).for_each(|_| act());
    ALLOCATIONS.get() - before
}

fn crosses(from: &dyn LinkIo<Can>, to: &dyn LinkIo<Can>) {
    let (sent, mut got) = (Frame::standard(0x123, &[1, 2, 3]), Frame::default());
    from.send(&sent).unwrap();
    let received = to.receive(&mut got, clock::now().plus_ms(1_000)).unwrap();
    assert!(matches!(received, Received::Bytes { .. }) && got == sent, "{received:?} {got:?}");
}

#[test]
fn a_frame_over_udp_allocates_nothing() {
    let group = udp::MulticastGroup { port: 43_120, hops: 0, ..udp::MulticastGroup::default() };
    let (one, other) = (udp::open(group).unwrap(), udp::open(group).unwrap());
    assert_eq!(allocated(|| crosses(&one, &other)), 0);
}

#[test]
fn a_frame_through_adapter_and_server_allocates_nothing() {
    let line = CanLine { bit_rate: 500_000 };
    let adapter = slcan::listen("0", line).unwrap();
    let server = socketcand::listen("0", "can0").unwrap();
    let (at, bus) = (adapter.address().unwrap(), server.address().unwrap());
    std::thread::scope(|scope| {
        let one = scope.spawn(move || slcan::open_tcp(&at.to_string(), line).unwrap());
        let other = scope.spawn(move || socketcand::connect(&bus.to_string(), "can0").unwrap());
        while !(one.is_finished() && other.is_finished()) {
            for link in [&adapter as &dyn LinkIo<Can>, &server] {
                link.receive(&mut Frame::default(), clock::now().plus_ms(2)).unwrap();
            }
        }
        let (one, other) = (one.join().unwrap(), other.join().unwrap());
        assert_eq!(allocated(|| crosses(&one, &adapter)), 0);
        assert_eq!(allocated(|| crosses(&adapter, &one)), 0);
        assert_eq!(allocated(|| crosses(&other, &server)), 0);
        assert_eq!(allocated(|| crosses(&server, &other)), 0);
    });
}
