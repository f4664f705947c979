//! Connections, links and the server against a toy drive on real ptys and sockets.

mod toy;

use std::io::{Read, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Wake, Waker as TaskWaker};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Failure, Outcome, Unsupported};
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::profile::ParameterId;
use polepair_core::station::AxisIndex;
use polepair_core::time::Instant;

use crate::pty::Pty;
use crate::serial;
use crate::serve::ServeHandle;
use crate::tcp::{TcpLink, TcpServer};
use crate::{
    Cause, Connection, ConnectionEvent, LinkError, LinkIo, LinkWaker, Mailbox, PendingRequest,
    Received, TapDirection, TappedLink, WaitResult, clock, serve,
};
use toy::{STOP_VALUE, ToyDevice, ToyLane};

const AXIS: AxisIndex = AxisIndex(0);
const LINE: SerialLine = SerialLine::new_8n1(115_200);
const LOST: Outcome = Outcome::Unknown(Failure::LinkDown);
const SILENT: WaitResult = WaitResult::Ended(Outcome::Unknown(Failure::Silent));
/// Longer than anything takes that works, however busy the machine.
const LONG_MS: u32 = 60_000;
/// Time that a lane waits for a reply in tests without one.
const SOON_MS: u32 = 150;

/// A served toy drive. Dropping it unplugs the drive.
struct ServedToy {
    stop: ServeHandle,
    device: Arc<Mutex<ToyDevice>>,
    thread: Option<JoinHandle<()>>,
}

impl ServedToy {
    fn serve_on(link: impl LinkIo<Stream> + 'static, device: ToyDevice) -> Self {
        let stop = ServeHandle::for_link(&link);
        let device = Arc::new(Mutex::new(device));
        let (its_stop, mut wire) = (stop.clone(), Arc::clone(&device));
        let thread = thread::spawn(move || {
            let _ = serve(&link, &mut wire, &its_stop);
        });
        Self { stop, device, thread: Some(thread) }
    }

    fn request_count(&self) -> u32 {
        self.device.lock().unwrap().request_count
    }
}

impl Drop for ServedToy {
    fn drop(&mut self) {
        self.stop.stop();
        self.thread.take().unwrap().join().unwrap();
    }
}

fn serve_and_connect(device: ToyDevice) -> (ServedToy, Connection) {
    let (drive, link) = plug_in(device);
    (drive, connect(link))
}

fn plug_in(device: ToyDevice) -> (ServedToy, Box<dyn LinkIo<Stream>>) {
    let pty = Pty::open(None).unwrap();
    let port = serial::open(pty.path(), LINE).unwrap();
    (ServedToy::serve_on(pty, device), Box::new(port))
}

fn connect(link: Box<dyn LinkIo<Stream>>) -> Connection {
    connect_with_timeout(link, LONG_MS)
}

/// Connected by a lane with this reply time-out.
fn connect_with_timeout(link: Box<dyn LinkIo<Stream>>, reply_timeout_ms: u32) -> Connection {
    Connection::new(link, Box::new(ToyLane::with_reply_timeout(reply_timeout_ms)))
}

fn submit_write(connection: &Connection, value: u32) -> PendingRequest {
    let raw = i64::from(value);
    connection
        .submit(|axes, now, ticket| {
            axes.write_parameter(now, ticket, AXIS, ParameterId(0), raw, false)
        })
        .unwrap()
}

fn submit_command(connection: &Connection, verb: Verb) -> PendingRequest {
    connection
        .submit(|axes, now, ticket| axes.command(now, ticket, AXIS, Command::new(verb)))
        .unwrap()
}

fn in_ms(ms: u32) -> Instant {
    clock::now().plus_ms(ms)
}

/// Longest wait of a test.
fn long_deadline() -> Instant {
    in_ms(LONG_MS)
}

/// Waits until something is so.
fn wait_until(is_so: impl Fn() -> bool) {
    let deadline = long_deadline();
    while !is_so() {
        assert!(clock::now() < deadline, "it never came to be so");
        thread::sleep(Duration::from_millis(1));
    }
}

fn done(value: u32) -> WaitResult {
    WaitResult::Ended(Outcome::Done(value.into()))
}

fn temporary(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("polepair-{name}-{}", std::process::id()))
}

#[test]
fn a_request_is_answered_over_a_pty() {
    let (_drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    for value in 0..100 {
        assert_eq!(submit_write(&connection, value).wait(long_deadline()), done(value + 1));
    }
}

#[test]
fn two_hundred_threads_get_their_own_answers() {
    let (drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    let threads: Vec<_> = (0..200_u32)
        .map(|thread| {
            let connection = connection.clone();
            thread::spawn(move || {
                for turn in 0..5 {
                    let value = thread * 1000 + turn;
                    let outcome = connection.request(long_deadline(), |axes, now, ticket| {
                        axes.write_parameter(now, ticket, AXIS, ParameterId(0), value.into(), false)
                    });
                    assert_eq!(outcome, Ok(Some(Outcome::Done(i64::from(value) + 1))));
                }
            })
        })
        .collect();
    threads.into_iter().for_each(|thread| thread.join().unwrap());
    assert_eq!(drive.request_count(), 1000);
}

#[test]
fn busy_is_reported_at_once_when_it_is_not_for_want_of_room() {
    let (_drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    let mut calls = 0;
    let outcome = connection.request(long_deadline(), |_, _, _| {
        calls += 1;
        Err(Unsupported::Busy)
    });
    assert_eq!((outcome, calls), (Err(Unsupported::Busy), 1));
}

#[test]
fn the_next_waiter_leads_when_the_leader_leaves() {
    const TURNS: u32 = 10;
    let (_drive, connection) = serve_and_connect(ToyDevice::with_delay(60));
    let began = clock::now();
    for _ in 0..TURNS {
        let mut first = submit_write(&connection, 1);
        let mut second = submit_write(&connection, 2);
        let leader = thread::spawn(move || first.wait(long_deadline()));
        thread::sleep(Duration::from_millis(20));
        assert_eq!(second.wait(long_deadline()), done(3));
        assert_eq!(leader.join().unwrap(), done(2));
    }
    // 120 ms a turn. Without a hand-over each would have slept a follower's 500 ms first.
    let took = clock::now().since(began);
    assert!(took < TURNS * Duration::from_millis(400), "{took:?}");
}

#[test]
fn a_plan_ends_without_a_waiter() {
    let (drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    drop(submit_command(&connection, Verb::MoveTo));
    wait_until(|| drive.request_count() == 10);
}

#[test]
fn a_caller_takes_over_from_the_keeper() {
    let (drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    drop(submit_command(&connection, Verb::MoveTo));
    let mut others = 0;
    while drive.request_count() < 10 + others {
        others += 1;
        assert_eq!(submit_write(&connection, others).wait(long_deadline()), done(others + 1));
        assert!(others < 1_000_000, "the plan does not get on");
    }
}

#[test]
fn an_outcome_can_be_polled_for() {
    let pty = Pty::open(None).unwrap();
    let connection = connect(Box::new(serial::open(pty.path(), LINE).unwrap()));
    let mut pending = submit_write(&connection, 4);
    assert_eq!(pending.poll(), None);
    pty.send(&toy::frame(1, 5)).unwrap();
    let deadline = long_deadline();
    while pending.poll().is_none() && clock::now() < deadline {
        thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(pending.poll(), Some(Outcome::Done(5)));
}

/// The late replies, once there are as many as wanted, or after the longest wait of a test.
fn wait_for_late(connection: &Connection, max: u64) -> u64 {
    let deadline = long_deadline();
    loop {
        let late = connection.with_axes(|axes, _| axes.counters().late);
        if late >= max || clock::now() >= deadline {
            return late;
        }
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn an_idle_link_is_read_while_somebody_listens() {
    let pty = Pty::open(None).unwrap();
    let connection = connect(Box::new(serial::open(pty.path(), LINE).unwrap()));
    let mailbox = Mailbox::new(8);
    let (one, other) = (connection.listen(&mailbox, 0, None), connection.listen(&mailbox, 1, None));
    pty.send(&[0; 8]).unwrap();
    assert_eq!(wait_for_late(&connection, 1), 1);
    drop(one);
    pty.send(&[0; 8]).unwrap();
    assert_eq!(wait_for_late(&connection, 2), 2);
    drop(other);
    // Without a listener it stays unread until the next request. The background thread has left by now.
    connection.catch_up();
    pty.send(&[0; 8]).unwrap();
    thread::sleep(Duration::from_millis(100));
    assert_eq!(connection.with_axes(|axes, _| axes.counters().late), 2);
    drop(submit_write(&connection, 1));
    assert_eq!(wait_for_late(&connection, 3), 3);
}

#[test]
fn listeners_are_reported_that_the_link_is_lost() {
    let (drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    let mailbox = Mailbox::new(8);
    let _listening = connection.listen(&mailbox, 7, None);
    drop(drive);
    let report = mailbox.wait_next(long_deadline());
    assert!(matches!(report, Some((7, ConnectionEvent::LinkLost(..)))), "{report:?}");
}

#[test]
fn callers_and_a_listener_share_a_link() {
    let (_drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    let _listening = connection.listen(&Mailbox::new(8), 0, None);
    for value in 0..50 {
        // After a pause the background thread reads, and gives way.
        if value % 10 == 0 {
            thread::sleep(Duration::from_millis(20));
        }
        assert_eq!(submit_write(&connection, value).wait(long_deadline()), done(value + 1));
    }
}

#[derive(Default)]
struct WakeCounter(AtomicUsize);

impl Wake for WakeCounter {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Ordering::SeqCst);
    }
}

#[test]
fn a_waker_is_woken_once_by_the_keeper() {
    let (_drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    let woken = Arc::new(WakeCounter::default());
    let waker = TaskWaker::from(Arc::clone(&woken));
    for turn in 0..20_usize {
        let mut pending = submit_write(&connection, 1);
        if pending.poll_or_wake(&waker).is_some() {
            woken.0.fetch_add(1, Ordering::SeqCst);
        }
        wait_until(|| woken.0.load(Ordering::SeqCst) > turn);
        assert_eq!(pending.poll_or_wake(&waker), Some(Outcome::Done(2)));
        assert_eq!(woken.0.load(Ordering::SeqCst), turn + 1);
    }
}

#[test]
fn an_unawaited_request_leaves_nothing_behind() {
    let (drive, connection) = serve_and_connect(ToyDevice::with_delay(0));
    for value in 0..3000 {
        let mut pending = submit_write(&connection, value);
        if value % 2 == 0 {
            pending.wait(long_deadline());
        }
    }
    assert_eq!(submit_write(&connection, 1).wait(long_deadline()), done(2));
    assert_eq!(drive.request_count(), 3001);
    let slots = connection.slot_count();
    assert!(slots < 10, "{slots} slots for one waiter");
}

#[test]
fn an_interrupt_ends_waits_and_is_not_lost() {
    let (_drive, link) = plug_in(ToyDevice::mute());
    let connection = connect_with_timeout(link, SOON_MS);
    let interrupter = connection.interrupter();
    let mut early = submit_write(&connection, 1);
    interrupter.interrupt();
    assert_eq!(early.wait(long_deadline()), WaitResult::Interrupted);
    assert_eq!(early.wait(long_deadline()), SILENT);

    let (_drive, connection) = serve_and_connect(ToyDevice::mute());
    let interrupter = connection.interrupter();
    let mut late = submit_write(&connection, 1);
    let waiting = thread::spawn(move || late.wait(long_deadline()));
    thread::sleep(Duration::from_millis(30));
    interrupter.interrupt();
    assert_eq!(waiting.join().unwrap(), WaitResult::Interrupted);
}

#[test]
fn a_late_answer_is_read_before_the_next_request_goes_out() {
    let pty = Pty::open(None).unwrap();
    let connection =
        connect_with_timeout(Box::new(serial::open(pty.path(), LINE).unwrap()), SOON_MS);
    assert_eq!(submit_write(&connection, 1).wait(long_deadline()), SILENT);
    pty.send(&toy::frame(1, 2)).unwrap();
    // A frame with a later time stamp counts as the later one.
    thread::sleep(Duration::from_millis(1));
    let late = connection.submit(|axes, now, ticket| {
        assert_eq!(axes.counters().late, 1);
        axes.write_parameter(now, ticket, AXIS, ParameterId(0), 0, false)
    });
    assert!(late.is_ok());
}

/// Counts the calls that a spinning leader would make.
struct CountingLink(Box<dyn LinkIo<Stream>>, Arc<AtomicU64>);

impl LinkIo<Stream> for CountingLink {
    fn now(&self) -> Instant {
        self.0.now()
    }
    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        self.0.send(unit)
    }
    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        self.1.fetch_add(1, Ordering::SeqCst);
        self.0.receive(buffer, until)
    }
    fn set_line(&self, line: SerialLine) -> Result<(), LinkError> {
        self.0.set_line(line)
    }
    fn waker(&self) -> LinkWaker {
        self.0.waker()
    }
    fn describe(&self) -> String {
        self.0.describe()
    }
    fn reopen(&self) -> Result<Box<dyn LinkIo<Stream>>, LinkError> {
        Ok(Box::new(Self(self.0.reopen()?, Arc::clone(&self.1))))
    }
}

#[test]
fn unplugging_ends_every_request_at_once_and_nothing_spins() {
    let calls = Arc::new(AtomicU64::new(0));
    let mut quickest = Duration::MAX;
    let mut connection = None;
    for _ in 0..5 {
        let (drive, link) = plug_in(ToyDevice::mute());
        let lost = connect(Box::new(CountingLink(link, Arc::clone(&calls))));
        let waiting: Vec<_> = (0..5)
            .map(|value| {
                let mut pending = submit_write(&lost, value);
                thread::spawn(move || (pending.wait(long_deadline()), clock::now()))
            })
            .collect();
        thread::sleep(Duration::from_millis(20));
        let unplugged = clock::now();
        drop(drive);
        let reports =
            waiting.into_iter().map(|thread| thread.join().unwrap()).map(|(waited, at)| {
                assert_eq!(waited, WaitResult::Ended(LOST));
                at.since(unplugged)
            });
        quickest = quickest.min(reports.max().unwrap());
        connection = Some(lost);
    }
    // A follower without a wake-up would look by itself after 500 ms.
    assert!(quickest < Duration::from_millis(250), "{quickest:?}");
    let connection = connection.unwrap();
    let before = calls.load(Ordering::SeqCst);
    thread::sleep(Duration::from_millis(600));
    assert!(calls.load(Ordering::SeqCst) - before < 10);
    assert!(connection.link_error().is_some());
    let refused = WaitResult::Ended(Outcome::NotDone(Failure::LinkDown));
    assert_eq!(submit_write(&connection, 1).wait(long_deadline()), refused);
}

#[test]
fn plugging_in_again_brings_the_line_up() {
    let alias = temporary("replug");
    let pty = Pty::open(Some(&alias)).unwrap();
    let port = serial::open(pty.path(), LINE).unwrap();
    let drive = ServedToy::serve_on(pty, ToyDevice::with_delay(0));
    let connection = connect(Box::new(port));
    assert_eq!(submit_write(&connection, 1).wait(long_deadline()), done(2));
    drop(drive);
    // An idle line has no reader; the next request finds it dead.
    let lost = submit_write(&connection, 1).wait(long_deadline());
    assert!(matches!(lost, WaitResult::Ended(Outcome::NotDone(_) | LOST)), "{lost:?}");
    assert!(!alias.exists(), "the alias outlived its pty");

    let pty = Pty::open(Some(&alias)).unwrap();
    let _drive = ServedToy::serve_on(pty, ToyDevice::with_delay(0));
    // The background thread does it: nothing is submitted meanwhile.
    wait_until(|| connection.link_error().is_none());
    assert_eq!(connection.with_axes(|axes, _| axes.address(AXIS)), Some(1), "one Up");
    assert_eq!(submit_write(&connection, 5).wait(long_deadline()), done(6));
}

#[test]
fn a_stop_overtakes_what_is_queued() {
    let (_drive, link) = plug_in(ToyDevice::with_delay(4));
    let sent = Arc::new(AtomicU64::new(0));
    let stop_was = Arc::new(AtomicU64::new(0));
    let (count, seen) = (Arc::clone(&sent), Arc::clone(&stop_was));
    let tapped = TappedLink::new(link, move |_, direction, bytes: &[u8]| {
        if direction == TapDirection::ToDrive {
            let number = count.fetch_add(1, Ordering::SeqCst) + 1;
            if bytes[4..8] == STOP_VALUE.to_le_bytes() {
                seen.store(number, Ordering::SeqCst);
            }
        }
    });
    let connection = connect(Box::new(tapped));
    let over = Arc::new(AtomicBool::new(false));
    let pollers: Vec<_> = (0..32)
        .map(|_| {
            let (connection, over) = (connection.clone(), Arc::clone(&over));
            thread::spawn(move || {
                while !over.load(Ordering::SeqCst) {
                    submit_write(&connection, 1).wait(long_deadline());
                }
            })
        })
        .collect();
    wait_until(|| sent.load(Ordering::SeqCst) >= 64);
    let mut before = 0;
    let stop = connection.submit(|axes, now, ticket| {
        before = sent.load(Ordering::SeqCst);
        axes.command(now, ticket, AXIS, Command::new(Verb::Stop))
    });
    assert_eq!(stop.unwrap().wait(long_deadline()), done(STOP_VALUE + 1));
    over.store(true, Ordering::SeqCst);
    pollers.into_iter().for_each(|thread| thread.join().unwrap());
    assert_eq!(stop_was.load(Ordering::SeqCst), before + 1, "it is the next that goes out");
}

#[test]
fn a_link_is_lent_between_exchanges_and_what_waits_goes_on_behind() {
    let (drive, connection) = serve_and_connect(ToyDevice::with_delay(2));
    let over = Arc::new(AtomicBool::new(false));
    let poller = {
        let (connection, over) = (connection.clone(), Arc::clone(&over));
        thread::spawn(move || {
            while !over.load(Ordering::SeqCst) {
                assert_eq!(submit_write(&connection, 1).wait(long_deadline()), done(2));
            }
        })
    };
    for _ in 0..10 {
        let aside =
            connection.borrow_link::<Stream>(long_deadline()).unwrap().expect("between two");
        let beside = connect(aside.link());
        assert_eq!(submit_write(&beside, 5).wait(long_deadline()), done(6));
        let before = drive.request_count();
        let mut stop = submit_command(&connection, Verb::Stop);
        assert_eq!(stop.wait(in_ms(20)), WaitResult::TimedOut, "it waits, and its caller does not");
        assert_eq!(drive.request_count(), before, "nothing is sent meanwhile");
        drop(beside);
        let late = aside.link();
        drop(aside);
        assert!(late.send(&[0; 8]).is_err(), "it is no longer theirs");
        assert_eq!(stop.wait(long_deadline()), done(STOP_VALUE + 1));
    }
    over.store(true, Ordering::SeqCst);
    poller.join().unwrap();
}

#[test]
fn a_link_that_is_lost_while_it_is_lent_is_lost_to_its_connection_too() {
    let (drive, connection) = serve_and_connect(ToyDevice::with_delay(2));
    assert_eq!(submit_write(&connection, 1).wait(long_deadline()), done(2));
    let aside =
        connection.borrow_link::<Stream>(long_deadline()).unwrap().expect("nothing is asked");
    let beside = connect(aside.link());
    let mut pending_request = submit_write(&beside, 5);
    let mut waits = submit_write(&connection, 7);
    drop(drive);
    assert!(!matches!(pending_request.wait(long_deadline()), WaitResult::Ended(Outcome::Done(_))));
    assert_eq!(waits.wait(long_deadline()), WaitResult::Ended(LOST), "it is told while it waits");
    drop((pending_request, beside));
    drop(aside);
    assert!(connection.link_error().is_some());
    let refused = connection.borrow_link::<Stream>(in_ms(50));
    assert!(refused.is_err(), "{refused:?}");
}

#[test]
fn tcp_reaches_a_served_drive_client_after_client() {
    let server = TcpServer::bind("0").unwrap();
    let address = server.address().to_string();
    assert!(address.starts_with("127.0.0.1:"));
    let _drive = ServedToy::serve_on(server, ToyDevice::with_delay(0));
    for value in 0..3 {
        let connection = connect(Box::new(TcpLink::connect(&address).unwrap()));
        assert_eq!(submit_write(&connection, value).wait(long_deadline()), done(value + 1));
    }
}

#[test]
fn a_half_open_peer_is_silence_and_a_closed_one_is_loss() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let hasty = connect_with_timeout(Box::new(TcpLink::connect(&address).unwrap()), SOON_MS);
    let (_silent, _) = listener.accept().unwrap();
    assert_eq!(submit_write(&hasty, 1).wait(long_deadline()), SILENT);
    // A reply is waited for as long as the test is: what ends the request is the loss.
    let connection = connect(Box::new(TcpLink::connect(&address).unwrap()));
    let (peer, _) = listener.accept().unwrap();
    let mut pending = submit_write(&connection, 1);
    drop(peer);
    assert_eq!(pending.wait(long_deadline()), WaitResult::Ended(LOST));
    assert!(connection.link_error().is_some());
}

#[test]
fn a_tcp_server_that_comes_back_is_found_again() {
    let server = TcpServer::bind("0").unwrap();
    let address = server.address().to_string();
    let drive = ServedToy::serve_on(server, ToyDevice::with_delay(0));
    let connection = connect(Box::new(TcpLink::connect(&address).unwrap()));
    assert_eq!(submit_write(&connection, 1).wait(long_deadline()), done(2));
    drop(drive);
    assert_ne!(submit_write(&connection, 1).wait(long_deadline()), done(2));
    let _drive = ServedToy::serve_on(TcpServer::bind(&address).unwrap(), ToyDevice::with_delay(0));
    wait_until(|| connection.link_error().is_none());
    assert_eq!(submit_write(&connection, 1).wait(long_deadline()), done(2));
}

#[test]
fn a_far_end_that_hangs_up_at_once_is_not_pestered() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let connection = connect(Box::new(TcpLink::connect(&address).unwrap()));
    let mut pending = submit_write(&connection, 1);
    let accepted = Arc::new(AtomicU64::new(0));
    let count = Arc::clone(&accepted);
    thread::spawn(move || {
        while listener.accept().is_ok() {
            count.fetch_add(1, Ordering::SeqCst);
        }
    });
    assert_eq!(pending.wait(long_deadline()), WaitResult::Ended(LOST));
    let began = clock::now();
    let (min, deadline) = (in_ms(1_100), long_deadline());
    let attempts = || accepted.load(Ordering::SeqCst);
    while clock::now() < min || attempts() < 2 {
        assert!(clock::now() < deadline, "it is not tried again");
        // Not too fast itself: each request may make one attempt.
        submit_write(&connection, 1).wait(long_deadline());
        thread::sleep(Duration::from_millis(5));
    }
    // Four a second, and those before and at the ends of that time.
    let max = clock::now().since(began).as_millis() as u64 / 250 + 3;
    assert!(attempts() <= max, "{} and not {max}", attempts());
}

#[test]
fn refused_and_missing_links_say_what_to_try() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    drop(listener);
    assert_eq!(TcpLink::connect(&address).unwrap_err().cause(), Cause::Refused);
    assert_eq!(TcpLink::connect("nonsense").unwrap_err().cause(), Cause::NotFound);
    let missing = serial::open("/dev/ttyNOPE", LINE).unwrap_err();
    assert_eq!(missing.cause(), Cause::NotFound);
    assert!(missing.hint().starts_with("Ports that exist: "), "{}", missing.hint());
    assert!(missing.to_string().starts_with("/dev/ttyNOPE: "), "{missing}");
    let no_port = serial::open("/dev/null", LINE).unwrap_err();
    assert_eq!(no_port.cause(), Cause::Unsuitable);
}

#[test]
fn a_port_is_opened_by_one_program_only() {
    let pty = Pty::open(None).unwrap();
    let first = serial::open(pty.path(), LINE).unwrap();
    assert_eq!(serial::open(pty.path(), LINE).unwrap_err().cause(), Cause::Busy);
    drop(first);
    assert!(serial::open(pty.path(), LINE).is_ok());
}

#[test]
fn any_baud_rate_is_set_when_the_lane_changes_its_own() {
    let pty = Pty::open(None).unwrap();
    let path = pty.path().to_owned();
    let port = serial::open(&path, SerialLine::new_8n1(192_000)).unwrap();
    assert_eq!(speed(&path), 192_000);
    let _drive = ServedToy::serve_on(pty, ToyDevice::with_delay(0));
    let connection = connect(Box::new(port));
    connection.with_axes(|axes, _| axes.set_armed(AXIS, true));
    submit_write(&connection, 1).wait(long_deadline());
    assert_eq!(speed(&path), 512_000);
}

fn speed(path: &str) -> u32 {
    let port = std::fs::File::open(path).unwrap();
    rustix::termios::tcgetattr(&port).unwrap().output_speed()
}

#[test]
fn a_foreign_program_reads_and_writes_through_the_alias() {
    let alias = temporary("alias");
    std::os::unix::fs::symlink("/nowhere", &alias).unwrap();
    let pty = Pty::open(Some(&alias)).unwrap();
    let _drive = ServedToy::serve_on(pty, ToyDevice::with_delay(0));
    let mut port = std::fs::OpenOptions::new().read(true).write(true).open(&alias).unwrap();
    port.write_all(&[1, 0, 0, 0, 0x0A, 0x0D, 3, 4]).unwrap();
    let mut reply = [0; 8];
    port.read_exact(&mut reply).unwrap();
    assert_eq!(reply, [1, 0, 0, 0, 0x0B, 0x0D, 3, 4]);
}

#[test]
fn an_alias_never_replaces_a_file() {
    let alias = temporary("file");
    std::fs::write(&alias, "precious").unwrap();
    assert_eq!(Pty::open(Some(&alias)).unwrap_err().cause(), Cause::Busy);
    assert_eq!(std::fs::read_to_string(&alias).unwrap(), "precious");
    std::fs::remove_file(&alias).unwrap();
}

#[test]
fn a_log_is_in_the_capture_format() {
    use crate::tap::TraceWriter;
    use polepair_core::medium::Frame;
    let mut text = Vec::new();
    let mut log = TraceWriter::new(&mut text, "/dev/ttyUSB0");
    log.write_bytes(clock::now(), TapDirection::ToDrive, &[1, 0x5E]);
    log.write_bytes(clock::now(), TapDirection::ToHost, &[2]);
    let frame = Frame::standard(0x12, &[0xAB, 1]);
    log.write_frame(clock::now(), TapDirection::ToDrive, &frame);
    log.write_frame(clock::now(), TapDirection::ToHost, &Frame { extended: true, ..frame });
    log.write_frame(clock::now(), TapDirection::ToHost, &Frame { remote: true, len: 4, ..frame });
    let text = String::from_utf8(text).unwrap();
    let lines: Vec<_> = text.lines().map(|line| line.split_once(") ").unwrap().1).collect();
    let can = ["ttyUSB0 012#AB01 T", "ttyUSB0 00000012#AB01 R", "ttyUSB0 012#R4 R"];
    assert_eq!(lines, [&["ttyUSB0 > 01 5E", "ttyUSB0 < 02"][..], &can].concat());
    let seconds: f64 = text[1..].split_once(')').unwrap().0.parse().unwrap();
    assert!(seconds > 1.7e9);
}

#[test]
fn a_wake_up_counts_once_and_is_never_lost() {
    let waker = LinkWaker::new().unwrap();
    assert!(!waker.take_wakeup());
    waker.wake();
    waker.wake();
    assert!(waker.take_wakeup());
    assert!(!waker.take_wakeup());
}
