//! Waiting for a descriptor that is known to hold nothing.
//!
//! `poll` is handed its descriptors anew at every wait and asks each of them twice. Here the kernel
//! keeps the list and tells only what changes (`epoll`, edge-triggered), which saves nearly half of
//! what a wait costs. It is safe only behind a read that took all there was: what was left would
//! never be told. A short read of a terminal or a stream socket has taken all, see epoll(7); but
//! TCP stops short of urgent bytes, too. Until such a read, after an end or urgent bytes, and on
//! other systems, the caller polls.

use std::sync::atomic::{AtomicBool, Ordering};

use rustix::event::epoll::{self, CreateFlags, Event, EventData, EventFlags};
use rustix::event::{PollFlags, Timespec};
use rustix::fd::{BorrowedFd, OwnedFd};
use rustix::io::Errno;

const LINK: u64 = 0;
const WAKER: u64 = 1;

/// A list of one link and its waker.
#[derive(Debug)]
pub(crate) struct Edge {
    epoll: Option<OwnedFd>,
    drained: AtomicBool,
    /// From now on the caller polls: the far end has hung up or hurries, which is told once only,
    /// or the kernel has no such wait.
    retired: AtomicBool,
}

impl Edge {
    /// Where the system has no more descriptors, the caller polls for ever.
    pub(crate) fn new(link: BorrowedFd<'_>, waker: BorrowedFd<'_>) -> Self {
        Self {
            epoll: list(link, waker).ok(),
            drained: AtomicBool::new(false),
            retired: AtomicBool::new(false),
        }
    }

    /// Notes whether the last read took all there was.
    pub(crate) fn note(&self, drained: bool) {
        self.drained.store(drained && !self.retired.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    /// What is ready on the link, and whether the waker is; `None` when the caller must poll.
    pub(crate) fn wait(&self, left: Option<&Timespec>) -> Option<Result<(PollFlags, bool), Errno>> {
        let list = self.epoll.as_ref().filter(|_| self.drained.load(Ordering::Relaxed))?;
        let none = Event { flags: EventFlags::empty(), data: EventData::new_u64(WAKER) };
        let mut events = [none; 2];
        let count = match epoll::wait(list, &mut events, left) {
            Ok(count) => count,
            Err(Errno::INTR) => return Some(Err(Errno::INTR)),
            // Before Linux 5.11 there is no such wait below a millisecond, and some containers
            // forbid it.
            Err(_) => {
                self.retire();
                return None;
            }
        };
        let (mut ready, mut woken) = (PollFlags::empty(), false);
        for event in &events[..count] {
            match event.data.u64() {
                LINK => ready = self.ready(event.flags),
                _ => woken = true,
            }
        }
        Some(Ok((ready, woken)))
    }

    fn ready(&self, flags: EventFlags) -> PollFlags {
        let gone = flags.intersects(EventFlags::HUP | EventFlags::ERR);
        if gone || flags.intersects(EventFlags::RDHUP | EventFlags::PRI) {
            self.retire();
        }
        if gone { PollFlags::IN | PollFlags::HUP } else { PollFlags::IN }
    }

    fn retire(&self) {
        self.retired.store(true, Ordering::Relaxed);
        self.note(false);
    }
}

fn list(link: BorrowedFd<'_>, waker: BorrowedFd<'_>) -> Result<OwnedFd, Errno> {
    let list = epoll::create(CreateFlags::CLOEXEC)?;
    let edges = EventFlags::IN | EventFlags::PRI | EventFlags::RDHUP | EventFlags::ET;
    epoll::add(&list, link, EventData::new_u64(LINK), edges)?;
    epoll::add(&list, waker, EventData::new_u64(WAKER), EventFlags::IN)?;
    Ok(list)
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant as Clock};

    use crate::clock;
    use crate::descriptor::Descriptor;
    use crate::link::Received;

    /// Nothing is left lying, whatever the size of a read, and an end is told while one waits.
    #[test]
    fn what_was_left_what_comes_later_and_the_end_are_told_at_once() {
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

    #[test]
    fn a_waker_ends_every_kind_of_wait() {
        let (near, far) = std::os::unix::net::UnixStream::pair().unwrap();
        near.set_nonblocking(true).unwrap();
        let link = Descriptor::new(near.into(), "pair").unwrap();
        let far = Descriptor::new(far.into(), "far").unwrap();
        for _ in 0..3 {
            let waker = link.wake.clone();
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
