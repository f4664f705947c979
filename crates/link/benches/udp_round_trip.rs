//! A frame and its answer over UDP multicast: our link, and a whole connection on it, beside the
//! least that any program must do, datagrams of the same length sent and awaited. The other end is
//! a process of its own, with our link or without.
//!
//! `cargo bench -p polepair-link --bench udp_round_trip`, under `taskset -c 1` for figures that
//! repeat.

#[cfg(unix)]
fn main() {
    match std::env::args().nth(1).as_deref() {
        Some("floor") => bench::answer_floor(),
        Some("link") => bench::answer(0),
        Some("whole") => bench::answer(1),
        _ => bench::run(),
    }
}

#[cfg(not(unix))]
fn main() {}

#[cfg(unix)]
mod bench {
    use std::net::{Ipv4Addr, UdpSocket};
    use std::process::{Child, Command, Stdio};
    use std::time::Instant as Clock;

    use polepair_core::error::Outcome;
    use polepair_core::lane::Lane;
    use polepair_core::medium::{Can, Frame};
    use polepair_core::profile::ParameterId;
    use polepair_core::proto::tmcl::TmclCan;
    use polepair_core::proto::{HostOptions, Protocol};
    use polepair_core::station::AxisIndex;
    use polepair_core::time::Instant;
    use polepair_link::udp::{self, GROUP_IPV4, Group, UdpLink};
    use polepair_link::{Connection, Link, Received, clock};

    const ROUNDS: usize = 100;
    const TURNS: usize = 50;
    const SERIES: usize = 9;
    /// The ends of the floor hear different ports, so that none wakes for its own datagram.
    const PORTS: [u16; 2] = [43_213, 43_214];
    /// The ends of ours share one, as the format has it.
    const GROUPS: [Group; 2] = [group(43_215), group(43_216)];
    /// Read axis parameter 0 of module 1: 123456. TMCM-170/171 manual §2.1; a module's answers have
    /// the host's identifier.
    const ASKED: (u16, [u8; 7]) = (1, [6, 0, 0, 0, 0, 0, 0]);
    const ANSWERED: (u16, [u8; 7]) = (2, [1, 100, 6, 0, 1, 0xE2, 0x40]);
    /// What python-can makes of such a frame.
    const DATAGRAM: usize = 172;

    const fn group(port: u16) -> Group {
        Group { address: std::net::IpAddr::V4(GROUP_IPV4), port, hops: 0 }
    }

    pub(super) fn run() {
        let ends = ["floor", "link", "whole"].map(other_end);
        std::thread::sleep(std::time::Duration::from_millis(300));
        let (mut floor, mut link, mut whole) = (floor(), link(), whole());
        let mut best = [f64::MAX; 3];
        println!(
            "udp multicast: median of {} (µs; floor = send + blocking receive)",
            ROUNDS * TURNS
        );
        println!("series       floor       link   ratio      whole   ratio");
        for series in 1..=SERIES {
            let mut micros = [const { Vec::new() }; 3];
            for _ in 0..TURNS {
                timed(&mut micros[0], &mut floor);
                timed(&mut micros[1], &mut link);
                timed(&mut micros[2], &mut whole);
            }
            let medians = micros.map(median);
            best = std::array::from_fn(|n| best[n].min(medians[n]));
            show(&format!("{series:6}"), medians);
        }
        show("  best", best);
        for mut end in ends {
            let _ = end.kill();
            let _ = end.wait();
        }
    }

    fn show(name: &str, [floor, link, whole]: [f64; 3]) {
        let ratios = (link / floor, whole / floor);
        println!("{name} {floor:11.2} {link:10.2} {:7.3} {whole:10.2} {:7.3}", ratios.0, ratios.1);
    }

    fn floor() -> impl FnMut() {
        let socket = joined(PORTS[0]);
        let mut answer = [0; 2048];
        move || {
            socket.send_to(&[0x55; DATAGRAM], (GROUP_IPV4, PORTS[1])).unwrap();
            assert_eq!(socket.recv(&mut answer).unwrap(), DATAGRAM);
        }
    }

    pub(super) fn answer_floor() {
        let socket = joined(PORTS[1]);
        let mut asked = [0; 2048];
        while let Ok(len) = socket.recv(&mut asked) {
            socket.send_to(&asked[..len], (GROUP_IPV4, PORTS[0])).unwrap();
        }
    }

    fn link() -> impl FnMut() {
        let link = udp::open(GROUPS[0]).unwrap();
        move || {
            link.send(&Frame::standard(ASKED.0, &ASKED.1)).unwrap();
            await_frame(&link, ANSWERED.0);
        }
    }

    fn whole() -> impl FnMut() {
        let driver = TmclCan::driver(TmclCan::generic(), 1);
        let host = TmclCan::host(&HostOptions::new(0), &[1]);
        let lane = Lane::<Can, _>::new(host, [Box::new(driver) as _]);
        let link = udp::open(GROUPS[1]).unwrap();
        let connection = Connection::new::<Can>(Box::new(link), Box::new(lane));
        move || {
            let deadline = clock::now().plus_ms(1_000);
            let outcome = connection.ask(deadline, |axes, now, ticket| {
                axes.read(now, ticket, AxisIndex(0), ParameterId(0))
            });
            assert_eq!(outcome, Ok(Some(Outcome::Done(123_456))));
        }
    }

    pub(super) fn answer(group: usize) {
        let link = udp::open(GROUPS[group]).unwrap();
        loop {
            await_frame(&link, ASKED.0);
            link.send(&Frame::standard(ANSWERED.0, &ANSWERED.1)).unwrap();
        }
    }

    fn await_frame(link: &UdpLink, id: u16) {
        let mut frame = Frame::default();
        loop {
            let received = link.receive(&mut frame, Instant::FAR).unwrap();
            if matches!(received, Received::Bytes { .. }) && frame.id == u32::from(id) {
                return;
            }
        }
    }

    fn joined(port: u16) -> UdpSocket {
        let socket = UdpSocket::bind((GROUP_IPV4, port)).unwrap();
        socket.join_multicast_v4(&GROUP_IPV4, &Ipv4Addr::UNSPECIFIED).unwrap();
        socket.set_multicast_ttl_v4(0).unwrap();
        socket
    }

    fn other_end(kind: &str) -> Child {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.arg(kind).stdin(Stdio::null()).spawn().unwrap()
    }

    fn timed(micros: &mut Vec<f64>, round: &mut impl FnMut()) {
        for _ in 0..ROUNDS {
            let began = Clock::now();
            round();
            micros.push(began.elapsed().as_secs_f64() * 1e6);
        }
    }

    fn median(mut micros: Vec<f64>) -> f64 {
        micros.sort_by(f64::total_cmp);
        micros[micros.len() / 2]
    }
}
