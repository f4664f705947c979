//! Waits on descriptors by epoll, because poll costs nearly twice as much for each wait.
//!
//! Streams are edge-triggered, which is only safe after a read that returned all data: the rest would not
//! be reported. A short read of a terminal or stream socket has returned all, see epoll(7), but TCP also
//! stops before urgent bytes. Until such a read, after an end of file or urgent bytes, and on other
//! systems, the caller polls. Datagram sockets are level-triggered, because a read returns one datagram of
//! several.
//!
//! The time limit is a timer in the same set, because setting a timeout for each wait costs half as much
//! again. A timer that fires early is not changed: the woken thread reads the clock and waits again.
//!
//! Why: LINK-3.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use polepair_core::time::Instant;
use rustix::event::PollFlags;
use rustix::event::epoll::{self, CreateFlags, Event, EventData, EventFlags};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use rustix::io::Errno;
use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, timerfd_create, timerfd_settime,
};

use crate::clock;
use crate::read_mode::{ReadMode, timespec};

const LINK_KEY: u64 = 0;
const WAKER_KEY: u64 = 1;
const TIMER_KEY: u64 = 2;
/// Greatest delay of a timer; the kernel takes as much with a timeout.
const SLACK_NS: u64 = 50_000;

/// A list of one link, its waker and an alarm.
#[derive(Debug)]
pub(crate) struct EpollSet {
    set: Option<(OwnedFd, WaitTimer)>,
    /// Nothing would be left untold.
    drained: AtomicBool,
    /// True once the caller must poll: the far end has hung up or sends urgent data, which is reported once only, or
    /// the kernel has no such wait.
    unusable: AtomicBool,
}

impl EpollSet {
    /// Creates the set. If the system has no more descriptors, the caller polls for ever.
    pub(crate) fn new(link: BorrowedFd<'_>, reads: ReadMode, waker: BorrowedFd<'_>) -> Self {
        Self {
            set: create_set(link, reads, waker).ok(),
            drained: AtomicBool::new(reads == ReadMode::Messages),
            unusable: AtomicBool::new(false),
        }
    }

    /// Notes whether the last read took all there was.
    pub(crate) fn set_drained(&self, drained: bool) {
        self.drained.store(drained && !self.unusable.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    /// Waits until `until`, or for less. Returns the link's ready events, and whether the waker rang; `None`
    /// when the caller must poll.
    pub(crate) fn wait(&self, until: Instant) -> Option<Result<(PollFlags, bool), Errno>> {
        let list = self.set.as_ref().filter(|_| self.drained.load(Ordering::Relaxed));
        let (epoll, alarm) = list?;
        let none = Event { flags: EventFlags::empty(), data: EventData::new_u64(TIMER_KEY) };
        let mut events = [none; 3];
        let waited = alarm.arm_until(until).and_then(|()| epoll::wait(epoll, &mut events, None));
        let count = match waited {
            Ok(count) => count,
            Err(Errno::INTR) => return Some(Err(Errno::INTR)),
            // Some containers forbid one or the other.
            Err(_) => {
                self.fall_back_to_poll();
                return None;
            }
        };
        let (mut ready, mut woken) = (PollFlags::empty(), false);
        for event in &events[..count] {
            match event.data.u64() {
                LINK_KEY => ready = self.poll_flags(event.flags),
                WAKER_KEY => woken = true,
                _ => alarm.clear(),
            }
        }
        Some(Ok((ready, woken)))
    }

    fn poll_flags(&self, flags: EventFlags) -> PollFlags {
        let gone = flags.intersects(EventFlags::HUP | EventFlags::ERR);
        if gone || flags.intersects(EventFlags::RDHUP | EventFlags::PRI) {
            self.fall_back_to_poll();
        }
        if gone { PollFlags::IN | PollFlags::HUP } else { PollFlags::IN }
    }

    fn fall_back_to_poll(&self) {
        self.unusable.store(true, Ordering::Relaxed);
        self.set_drained(false);
    }
}

fn create_set(
    link: BorrowedFd<'_>,
    reads: ReadMode,
    waker: BorrowedFd<'_>,
) -> Result<(OwnedFd, WaitTimer), Errno> {
    let list = epoll::create(CreateFlags::CLOEXEC)?;
    let alarm = WaitTimer::new()?;
    let flags = match reads {
        ReadMode::Stream => EventFlags::IN | EventFlags::PRI | EventFlags::RDHUP | EventFlags::ET,
        ReadMode::Messages => EventFlags::IN,
    };
    epoll::add(&list, link, EventData::new_u64(LINK_KEY), flags)?;
    epoll::add(&list, waker, EventData::new_u64(WAKER_KEY), EventFlags::IN)?;
    epoll::add(&list, alarm.timer.as_fd(), EventData::new_u64(TIMER_KEY), EventFlags::IN)?;
    Ok((list, alarm))
}

/// Readable from some instant on. Only the one thread that waits touches it.
#[derive(Debug)]
struct WaitTimer {
    timer: OwnedFd,
    /// When it rings, in nanoseconds; [`Instant::FAR_FUTURE`] when it has rung or was never set.
    expires_at: AtomicU64,
}

impl WaitTimer {
    fn new() -> Result<Self, Errno> {
        let flags = TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK;
        let timer = timerfd_create(TimerfdClockId::Monotonic, flags)?;
        Ok(Self { timer, expires_at: AtomicU64::new(Instant::FAR_FUTURE.0) })
    }

    /// Sees to it that it rings by `until`. It may ring before, and for a wait without end.
    fn arm_until(&self, until: Instant) -> Result<(), Errno> {
        if self.expires_at.load(Ordering::Relaxed) <= until.0.saturating_add(SLACK_NS) {
            return Ok(());
        }
        let now = clock::now();
        // Zero would mean never.
        let left = until.since(now).max(Duration::from_nanos(1));
        let once = Itimerspec { it_interval: timespec(Duration::ZERO), it_value: timespec(left) };
        timerfd_settime(&self.timer, TimerfdTimerFlags::empty(), &once)?;
        self.expires_at.store((now + left).0, Ordering::Relaxed);
        Ok(())
    }

    /// Takes its ringing, which otherwise goes on.
    fn clear(&self) {
        let _ = rustix::io::read(&self.timer, &mut [0_u8; 8]);
        self.expires_at.store(Instant::FAR_FUTURE.0, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant as Clock};

    use crate::clock;
    use crate::descriptor::Descriptor;
    use crate::link::Received;

    /// Nothing is left unread, whatever the size of a read, and an end is reported during a wait.
    #[test]
    fn leftovers_later_bytes_and_the_end_are_reported_at_once() {
        let (near, far) = std::os::unix::net::UnixStream::pair().unwrap();
        near.set_nonblocking(true).unwrap();
        let link = Descriptor::new(near.into(), "pair").unwrap();
        let mut buffer = [0; 4];
        let mut get = || match link.receive(&mut buffer, clock::now().plus_ms(5_000)) {
            Ok(Received::Bytes { len, .. }) => len,
            Err(error) if error.is_gone() => 0,
            other => panic!("{other:?}"),
        };
        let far = Descriptor::new(far.into(), "far").unwrap();
        let began = Clock::now();
        for _ in 0..100 {
            far.send(&[0; 7]).unwrap();
            assert_eq!((get(), get()), (4, 3));
            far.send(&[0; 4]).unwrap();
            assert_eq!(get(), 4);
        }
        let later = std::thread::spawn(move || {
            for _ in 0..3 {
                std::thread::sleep(Duration::from_millis(20));
                far.send(&[0; 2]).unwrap();
            }
            far.send(&[0; 3]).unwrap();
        });
        let mut sum = 0;
        while sum < 9 {
            sum += get();
        }
        assert_eq!((sum, get(), get()), (9, 0, 0));
        later.join().unwrap();
        assert!(began.elapsed() < Duration::from_secs(2), "{:?}", began.elapsed());
    }

    /// A read stops short of an urgent byte, though more lies behind it.
    #[test]
    fn nothing_lies_unread_behind_an_urgent_byte() {
        use rustix::net::{SendFlags, send};
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let near = std::net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (far, _) = listener.accept().unwrap();
        near.set_nonblocking(true).unwrap();
        let link = Descriptor::new(near.into(), "near").unwrap();
        let mut buffer = [0; 64];
        let mut get = || match link.receive(&mut buffer, clock::now().plus_ms(5_000)) {
            Ok(Received::Bytes { len, .. }) => len,
            other => panic!("{other:?}"),
        };
        let began = Clock::now();
        for _ in 0..3 {
            send(&far, &[0; 5], SendFlags::empty()).unwrap();
            assert_eq!(get(), 5);
            send(&far, &[0; 3], SendFlags::OOB).unwrap();
            send(&far, &[0; 4], SendFlags::empty()).unwrap();
            let mut sum = 0;
            // The urgent byte itself is not in the stream.
            while sum < 6 {
                sum += get();
            }
        }
        assert!(began.elapsed() < Duration::from_secs(2), "{:?}", began.elapsed());
    }

    /// An alarm that was set for a shorter wait neither ends a longer one nor rings for ever, and a
    /// shorter one is not kept waiting by a longer one.
    #[test]
    fn every_wait_ends_in_time_whatever_the_one_before() {
        let (near, far) = std::os::unix::net::UnixStream::pair().unwrap();
        near.set_nonblocking(true).unwrap();
        let link = Descriptor::new(near.into(), "pair").unwrap();
        let far = Descriptor::new(far.into(), "far").unwrap();
        for ms in [5, 30, 3, 3, 20, 1, 40, 2] {
            far.send(&[1]).unwrap();
            let received = link.receive(&mut [0; 4], clock::now().plus_ms(ms)).unwrap();
            assert!(matches!(received, Received::Bytes { len: 1, .. }));
            let until = clock::now().plus_ms(ms);
            assert_eq!(link.receive(&mut [0; 4], until).unwrap(), Received::TimedOut);
            let late = clock::now().since(until);
            assert!(clock::now() >= until && late < Duration::from_secs(1), "{ms} ms: {late:?}");
        }
        // The alarm has rung. A wait without end must not notice.
        let waker = link.waker.clone();
        let later = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(30));
            waker.wake();
        });
        let woken = link.receive(&mut [0; 4], polepair_core::time::Instant::FAR_FUTURE).unwrap();
        assert_eq!(woken, Received::Woken);
        later.join().unwrap();
    }

    #[test]
    fn a_waker_ends_every_kind_of_wait() {
        let (near, far) = std::os::unix::net::UnixStream::pair().unwrap();
        near.set_nonblocking(true).unwrap();
        let link = Descriptor::new(near.into(), "pair").unwrap();
        let far = Descriptor::new(far.into(), "far").unwrap();
        for _ in 0..3 {
            let waker = link.waker.clone();
            let later = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(10));
                waker.wake();
            });
            let woken = link.receive(&mut [0; 4], clock::now().plus_ms(5_000)).unwrap();
            assert_eq!(woken, Received::Woken);
            later.join().unwrap();
            let nothing = link.receive(&mut [0; 4], clock::now().plus_ms(5)).unwrap();
            assert_eq!(nothing, Received::TimedOut);
            far.send(&[1]).unwrap();
            let received = link.receive(&mut [0; 4], clock::now().plus_ms(5_000)).unwrap();
            assert!(matches!(received, Received::Bytes { len: 1, .. }));
        }
    }
}
