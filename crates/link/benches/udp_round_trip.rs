//! A frame and its answer over UDP multicast: our link at both ends beside the least that any
//! program must do, datagrams of the same length sent and awaited, each end in a process of its
//! own.
//!
//! `cargo bench -p polepair-link --bench udp_round_trip`, under `taskset -c 1` for figures that
//! repeat.

#[cfg(unix)]
fn main() {
    match std::env::args().nth(1).as_deref() {
        Some("floor") => bench::answer_floor(),
        Some("link") => bench::answer_link(),
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

    use polepair_core::medium::Frame;
    use polepair_core::time::Instant;
    use polepair_link::udp::{self, GROUP_IPV4, Group, UdpLink};
    use polepair_link::{Link, Received};

    const ROUNDS: usize = 100;
    const TURNS: usize = 50;
    const SERIES: usize = 9;
    /// The ends of the floor hear different ports, so that none wakes for its own datagram.
    const PORTS: [u16; 2] = [43_213, 43_214];
    /// Ours share one, as the format has it.
    const GROUP: Group = Group { address: std::net::IpAddr::V4(GROUP_IPV4), port: 43_215, hops: 0 };
    /// An SDO upload request and its answer, CiA 301 §7.2.4.3.
    const ASKED: u16 = 0x605;
    const ANSWERED: u16 = 0x585;
    /// What python-can makes of such a frame.
    const DATAGRAM: usize = 175;

    pub(super) fn run() {
        let (mut floor_end, mut link_end) = (other_end("floor"), other_end("link"));
        std::thread::sleep(std::time::Duration::from_millis(300));
        let (mut floor, mut ours) = (floor(), ours());
        let mut best = [f64::MAX; 2];
        println!(
            "udp multicast: median of {} (µs; floor = send + blocking receive)",
            ROUNDS * TURNS
        );
        println!("series       floor       ours   ratio");
        for series in 1..=SERIES {
            let (mut floors, mut our) = (Vec::new(), Vec::new());
            for _ in 0..TURNS {
                timed(&mut floors, &mut floor);
                timed(&mut our, &mut ours);
            }
            let pair = [median(floors), median(our)];
            best = [best[0].min(pair[0]), best[1].min(pair[1])];
            println!("{series:6} {:11.2} {:10.2} {:7.3}", pair[0], pair[1], pair[1] / pair[0]);
        }
        println!("  best {:11.2} {:10.2} {:7.3}", best[0], best[1], best[1] / best[0]);
        for end in [&mut floor_end, &mut link_end] {
            let _ = end.kill();
            let _ = end.wait();
        }
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

    fn ours() -> impl FnMut() {
        let link = udp::open(GROUP).unwrap();
        move || {
            link.send(&Frame::standard(ASKED, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0])).unwrap();
            await_frame(&link, ANSWERED);
        }
    }

    pub(super) fn answer_link() {
        let link = udp::open(GROUP).unwrap();
        loop {
            await_frame(&link, ASKED);
            link.send(&Frame::standard(ANSWERED, &[0x43, 0x64, 0x60, 0, 1, 2, 3, 4])).unwrap();
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
