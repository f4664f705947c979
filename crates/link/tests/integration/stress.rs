//! A reply that has arrived is delivered at once: threads ask, lead in turns, interrupt and stop each
//! other, clients come and go, and no answer lies unread though its leader sleeps.
//!
//! `POLEPAIR_EXCHANGES=1000000 cargo test --release -p polepair-link --test integration stress:: -- --nocapture`
//! is the long form.
#![cfg(unix)]

use std::borrow::{Borrow, BorrowMut};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant as Clock};

use polepair_core::axis::Axes;
use polepair_core::error::{Outcome, Unsupported};
use polepair_core::lane::Lane;
use polepair_core::medium::{Can, Frame, Medium, SerialLine, Stream};
use polepair_core::profile::ParameterId;
use polepair_core::proto::tmcl::opcode::Status;
use polepair_core::proto::tmcl::wire::{DATAGRAM, HOST, MODULE, Reply, Request};
use polepair_core::proto::tmcl::{Tmcl, TmclCan};
use polepair_core::proto::{HostOptions, Protocol};
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_link::pty::Pty;
use polepair_link::tcp::{TcpLink, TcpServer};
use polepair_link::udp::{self, MulticastGroup};
use polepair_link::{Connection, LinkIo, LinkWaker, Received, WaitResult, clock, serial};

const AXIS: AxisIndex = AxisIndex(0);
/// A reply without a wake-up is found when its time limit is over, at the latest.
const REPLY_TIMEOUT_MS: u32 = 60_000;
/// An exchange that took this long had no wake-up, or the machine was suspended.
const LATE: Duration = Duration::from_secs(50);
const ASKERS: usize = 3;
/// Connections made one after another to the same far end.
const CLIENTS: usize = 8;
const LINE: SerialLine = SerialLine::new_8n1(0);

fn exchanges() -> usize {
    let wanted = std::env::var("POLEPAIR_EXCHANGES").ok();
    wanted.map_or(3_000, |number| number.parse().expect("POLEPAIR_EXCHANGES is a number"))
}

#[test]
fn no_answer_lies_unread_on_a_pty() {
    let pty = Pty::open(None).unwrap();
    let path = pty.path().to_owned();
    let _module = Module::on(Box::new(pty), serial());
    stress::<Tmcl>("pty", || Box::new(serial::open(&path, LINE).unwrap()));
}

#[test]
fn no_answer_lies_unread_on_tcp() {
    let server = TcpServer::bind("0").unwrap();
    let address = server.address().to_string();
    let _module = Module::on(Box::new(server), serial());
    stress::<Tmcl>("tcp", || Box::new(TcpLink::connect(&address).unwrap()));
}

#[test]
fn no_answer_lies_unread_on_udp() {
    let group = MulticastGroup { hops: 0, port: 43_119, ..MulticastGroup::default() };
    let _module = Module::on(Box::new(udp::open(group).unwrap()), answer_frame);
    stress::<TmclCan>("udp", || Box::new(udp::open(group).unwrap()));
}

fn stress<P: Protocol>(name: &str, open: impl Fn() -> Box<dyn LinkIo<P::Medium>>) {
    let began = Clock::now();
    let mut worst = [Duration::ZERO; 2];
    for _ in 0..CLIENTS {
        let timeout = Some(REPLY_TIMEOUT_MS);
        let options =
            HostOptions { gap_us: Some(0), reply_timeout_ms: timeout, ..HostOptions::new(0) };
        let driver = Box::new(P::create_driver(P::generic_profile(), MODULE.into()));
        let lane = Lane::new(P::create_host(&options, &[MODULE.into()]), [driver as Box<_>]);
        let of_client = client(&Connection::new(open(), Box::new(lane)));
        worst = [0, 1].map(|n| worst[n].max(of_client[n]));
    }
    println!(
        "{name}: {} exchanges in {:?}, longest read and stop {worst:?}",
        exchanges(),
        began.elapsed()
    );
}

/// The longest read and the longest stop.
fn client(connection: &Connection) -> [Duration; 2] {
    let over = Arc::new(AtomicBool::new(false));
    let until_over = |every: Duration, mut act: Box<dyn FnMut() + Send>| {
        let over = Arc::clone(&over);
        thread::spawn(move || {
            while !over.load(Ordering::Relaxed) {
                act();
                thread::sleep(every);
            }
        })
    };
    let interrupter = connection.interrupter();
    let interrupts =
        until_over(Duration::from_millis(1), Box::new(move || interrupter.interrupt()));
    let askers: Vec<_> = (0..ASKERS)
        .map(|_| {
            let connection = connection.clone();
            thread::spawn(move || {
                let each = exchanges() / CLIENTS / ASKERS;
                (0..each).map(|_| exchange(&connection, read)).max().unwrap_or_default()
            })
        })
        .collect();
    let mut stops = Duration::ZERO;
    while !askers.iter().all(JoinHandle::is_finished) {
        stops = stops.max(exchange(connection, stop));
        thread::sleep(Duration::from_micros(300));
    }
    let reads = askers.into_iter().map(|asker| asker.join().unwrap()).max().unwrap();
    over.store(true, Ordering::Relaxed);
    interrupts.join().unwrap();
    [reads, stops]
}

type Ask = fn(&mut dyn Axes, Instant, Ticket) -> Result<(), Unsupported>;

fn read(axes: &mut dyn Axes, now: Instant, ticket: Ticket) -> Result<(), Unsupported> {
    axes.read_parameter(now, ticket, AXIS, ParameterId(1))
}

fn stop(axes: &mut dyn Axes, now: Instant, ticket: Ticket) -> Result<(), Unsupported> {
    axes.send_text(now, ticket, AXIS, "MST 0")
}

/// Exchanges a request for its reply. Returns the time with all interrupts.
fn exchange(connection: &Connection, request: Ask) -> Duration {
    let began = Clock::now();
    let deadline = clock::now().plus_ms(2 * REPLY_TIMEOUT_MS);
    let mut pending = connection.submit(request).unwrap();
    let waited = loop {
        match pending.wait(deadline) {
            WaitResult::Interrupted => {}
            waited => break waited,
        }
    };
    let took = began.elapsed();
    assert!(matches!(waited, WaitResult::Ended(Outcome::Done(_))), "{waited:?} after {took:?}");
    assert!(took < LATE, "answered at once, and told after {took:?}");
    took
}

/// A module that answers at once, sometimes in pieces.
struct Module {
    over: Arc<AtomicBool>,
    waker: LinkWaker,
    thread: Option<JoinHandle<()>>,
}

impl Module {
    fn on<M: Medium>(
        link: Box<dyn LinkIo<M>>,
        mut on_event: impl FnMut(&dyn LinkIo<M>, &M::Unit) + Send + 'static,
    ) -> Self {
        let (over, waker) = (Arc::new(AtomicBool::new(false)), link.waker());
        let its = Arc::clone(&over);
        let thread = thread::spawn(move || {
            let mut buffer = M::buffer();
            while !its.load(Ordering::Relaxed) {
                if let Ok(Received::Bytes { len, .. }) =
                    link.receive(buffer.borrow_mut(), Instant::FAR_FUTURE)
                {
                    on_event(&*link, M::unit(buffer.borrow(), len));
                }
            }
        });
        Self { over, waker, thread: Some(thread) }
    }
}

impl Drop for Module {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        self.waker.wake();
        self.thread.take().unwrap().join().unwrap();
    }
}

fn answer(request: Request) -> Reply {
    let Request { address, opcode, value, .. } = request;
    Reply { host: HOST, module: address, status: Status::Ok, opcode, value }
}

fn serial() -> impl FnMut(&dyn LinkIo<Stream>, &[u8]) + Send {
    let (mut received, mut answers) = (Vec::new(), 0_usize);
    move |link, bytes| {
        received.extend_from_slice(bytes);
        while let Some(first) = received.first_chunk::<DATAGRAM>() {
            let reply = answer(Request::parse(first).unwrap()).emit();
            received.drain(..DATAGRAM);
            answers += 1;
            let (early, late) =
                reply.split_at(if answers % 3 == 0 { answers % DATAGRAM } else { 0 });
            let _ = link.send(early);
            if answers % 4 == 0 {
                thread::yield_now();
            }
            let _ = link.send(late);
        }
    }
}

fn answer_frame(link: &dyn LinkIo<Can>, frame: &Frame) {
    if frame.id == u32::from(MODULE) {
        let reply = answer(Request::parse_can(frame.bytes(), MODULE).unwrap());
        let _ = link.send(&reply.emit_can(HOST.into(), false));
    }
}
