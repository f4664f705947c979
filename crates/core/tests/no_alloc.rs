//! Nothing allocates once a lane runs.
//!
//! A program of its own: it replaces the allocator of the process.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use polepair_core::axis::AxisRequests;
use polepair_core::error::Outcome;
use polepair_core::lane::Lane;
use polepair_core::profile::ParameterId;
use polepair_core::proto::tmcl::Tmcl;
use polepair_core::proto::tmcl::opcode::{Opcode, Status};
use polepair_core::proto::tmcl::wire::Reply;
use polepair_core::proto::{HostOptions, Protocol};
use polepair_core::station::{AxisIndex, Station, Ticket, Timed};
use polepair_core::time::Instant;

struct Counting;

thread_local! {
    /// Allocations of this thread: the test harness has a thread of its own, which may still be busy.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call is handed to the system's allocator as it came; the counter does not allocate (a
// const-initialised `Cell` without a destructor).
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps `alloc`'s contract, which is the system's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_running_lane_does_not_allocate() {
    let options = HostOptions { gap_us: Some(0), ..HostOptions::new(0) };
    let driver = Box::new(Tmcl::create_driver(Tmcl::generic_profile(), 1));
    let mut lane = Lane::new(Tmcl::create_host(&options, &[1]), [driver as Box<_>]);
    let (mut out, mut now, mut done) = ([0; 520], Instant::ZERO, 0);
    let before = ALLOCATIONS.get();
    for n in 0..10_000u32 {
        now = now.plus_ms(1000);
        lane.read_parameter(now, Ticket(n), AxisIndex(0), ParameterId(1)).unwrap();
        let mut received = 0;
        let ended = loop {
            if lane.poll_transmit(now, &mut out).is_some() {
                received += 1;
                // One in ten meets garbage first: silence, retries and quarantine, the long way.
                if n % 10 == 9 && received < 3 {
                    lane.handle_input(now, &[0x55; 30]);
                } else {
                    let (opcode, status) = (Opcode::from(out[1]), Status::Ok);
                    let reply = Reply { host: 2, module: 1, status, opcode, value: 7 };
                    lane.handle_input(now, &reply.emit());
                }
            } else if let Some(ended) = lane.poll_outcome() {
                break ended;
            } else {
                now = lane.poll_timeout().expect("something is waited for").max(now);
                lane.handle_timeout(now);
            }
        };
        assert_eq!(ended.0, Ticket(n));
        done += u32::from(ended.1 == Outcome::Done(7));
    }
    assert_eq!(ALLOCATIONS.get(), before);
    assert!(done >= 9_000, "{done} answered");
}
