//! A frame and its answer over UDP multicast: our link, whole connections on it (TMCL, and SDO of
//! CANopen), and one to a simulated drive, beside the least that any program must do, datagrams of
//! the same length sent and awaited. The other end is a process of its own.
//!
//! `cargo bench -p polepair-link --bench udp_round_trip`, under `taskset -c 1` for figures that
//! repeat.

#[cfg(unix)]
fn main() {
    match std::env::args().nth(1).as_deref() {
        Some("floor") => bench::answer_floor(),
        Some("link") => bench::answer(0, bench::TMCL),
        Some("TMCL") => bench::answer(1, bench::TMCL),
        Some("SDO") => bench::answer(2, bench::SDO),
        Some("drive") => bench::drive(3),
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
    use polepair_core::profile::{ParameterId, Profile};
    use polepair_core::proto::canopen::Canopen;
    use polepair_core::proto::tmcl::TmclCan;
    use polepair_core::proto::{HostOptions, Protocol};
    use polepair_core::station::AxisIndex;
    use polepair_core::time::Instant;
    use polepair_drives::cia402::device::Device;
    use polepair_drives::cia402::drive::Drive;
    use polepair_drives::cia402::profile::CIA402;
    use polepair_link::udp::{self, GROUP_IPV4, MulticastGroup, UdpLink};
    use polepair_link::{Connection, LinkIo, Received, ServeHandle, clock, serve};

    const ROUNDS: usize = 100;
    const TURNS: usize = 50;
    const SERIES: usize = 9;
    /// The ends of the floor hear different ports, so that none wakes for its own datagram.
    const PORTS: [u16; 2] = [43_213, 43_214];
    /// The ends of ours share one, as the format has it.
    const GROUPS: [MulticastGroup; 4] =
        [group(43_215), group(43_216), group(43_217), group(43_218)];
    const NAMES: [&str; 5] = ["floor", "link", "TMCL", "SDO", "drive"];
    /// Size of such a frame as python-can packs it, bytes.
    const DATAGRAM: usize = 172;
    const NODE: u32 = 5;

    /// A request and its reply: identifier and data.
    pub(super) type Exchange = [(u16, &'static [u8]); 2];
    /// Read axis parameter 0 of module 1: 123456. TMCM-170/171 manual §2.1; a module's answers have
    /// the host's identifier.
    pub(super) const TMCL: Exchange =
        [(1, &[6, 0, 0, 0, 0, 0, 0]), (2, &[1, 100, 6, 0, 1, 0xE2, 0x40])];
    /// Read the position of node 5: 123456. CiA 301, 7.2.4.3.5.
    pub(super) const SDO: Exchange = [
        (0x605, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]),
        (0x585, &[0x43, 0x64, 0x60, 0, 0x40, 0xE2, 1, 0]),
    ];

    const fn group(port: u16) -> MulticastGroup {
        MulticastGroup { address: std::net::IpAddr::V4(GROUP_IPV4), port, hops: 0 }
    }

    pub(super) fn run() {
        let ends = NAMES.map(other_end);
        std::thread::sleep(std::time::Duration::from_millis(300));
        let mut rounds: [Box<dyn FnMut()>; 5] = [
            Box::new(floor()),
            Box::new(link()),
            Box::new(whole::<TmclCan>(1, (TmclCan::generic_profile(), 1), 0, Some(123_456))),
            Box::new(whole::<Canopen>(2, (&CIA402, NODE), 0x6064, Some(123_456))),
            Box::new(whole::<Canopen>(3, (&CIA402, NODE), 0x6064, None)),
        ];
        let (mut best, mut all) = ([f64::MAX; 5], [const { Vec::new() }; 5]);
        println!("udp multicast: median of {} (µs; floor: send, blocking receive)", ROUNDS * TURNS);
        println!("{:6}{}", "series", NAMES.map(|name| format!("{name:>16}")).concat());
        for series in 1..=SERIES {
            let mut micros = [const { Vec::new() }; 5];
            for _ in 0..TURNS {
                for (micros, round) in micros.iter_mut().zip(&mut rounds) {
                    timed(micros, round);
                }
            }
            let medians = micros.map(median);
            best = std::array::from_fn(|n| best[n].min(medians[n]));
            all.iter_mut().zip(medians).for_each(|(all, median)| all.push(median));
            show(&series.to_string(), medians);
        }
        show("best", best);
        show("median", all.map(median));
        for mut end in ends {
            let _ = end.kill();
            let _ = end.wait();
        }
    }

    fn show(name: &str, micros: [f64; 5]) {
        let cells = micros.map(|each| format!("{each:8.2} ({:.3})", each / micros[0]));
        println!("{name:6}{}", cells.concat());
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
        let mut request = [0; 2048];
        while let Ok(len) = socket.recv(&mut request) {
            socket.send_to(&request[..len], (GROUP_IPV4, PORTS[0])).unwrap();
        }
    }

    fn link() -> impl FnMut() {
        let link = udp::open(GROUPS[0]).unwrap();
        move || {
            link.send(&Frame::standard(TMCL[0].0, TMCL[0].1)).unwrap();
            await_frame(&link, TMCL[1].0);
        }
    }

    /// Reads the parameter with that index, which is `expected` if that is known.
    fn whole<P: Protocol<Medium = Can>>(
        group: usize,
        axis: (&'static Profile, u32),
        index: u16,
        expected: Option<i64>,
    ) -> impl FnMut() {
        let id = axis.0.parameters.iter().position(|each| each.index == index).unwrap();
        let id = ParameterId(id as u16);
        let host = P::create_host(&HostOptions::new(0), &[axis.1]);
        let driver = P::create_driver(axis.0, axis.1);
        let lane = Lane::<Can, _>::new(host, [Box::new(driver) as _]);
        let link = udp::open(GROUPS[group]).unwrap();
        let connection = Connection::new::<Can>(Box::new(link), Box::new(lane));
        move || {
            let deadline = clock::now().plus_ms(1_000);
            let outcome = connection.request(deadline, |axes, now, ticket| {
                axes.read_parameter(now, ticket, AxisIndex(0), id)
            });
            match outcome {
                Ok(Some(Outcome::Done(value))) => assert_eq!(value, expected.unwrap_or(value)),
                other => panic!("{other:?}"),
            }
        }
    }

    pub(super) fn answer(group: usize, [request, answered]: Exchange) {
        let link = udp::open(GROUPS[group]).unwrap();
        loop {
            await_frame(&link, request.0);
            link.send(&Frame::standard(answered.0, answered.1)).unwrap();
        }
    }

    pub(super) fn drive(group: usize) {
        let link = udp::open(GROUPS[group]).unwrap();
        let mut wire = Box::new(Device::new(Drive::new(NODE as u8, 1, 1_000_000)));
        serve::<Can>(&link, &mut wire, &ServeHandle::for_link(&link)).unwrap();
    }

    fn await_frame(link: &UdpLink, id: u16) {
        let mut frame = Frame::default();
        loop {
            let received = link.receive(&mut frame, Instant::FAR_FUTURE).unwrap();
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
