//! Request and reply over a pty: a whole connection beside the least that any program must do,
//! write and blocking read, in turns against the same responder in another process. And how soon
//! another thread ends a wait.
//!
//! `cargo bench -p polepair-link`, under `taskset -c 1` for figures that repeat; with `listened` behind
//! `-- ` the last two alone.

#[cfg(unix)]
fn main() {
    if std::env::args().any(|word| word == "respond") {
        return bench::respond();
    }
    bench::run();
}

#[cfg(not(unix))]
fn main() {}

#[cfg(unix)]
mod bench {
    use std::fs::File;
    use std::io::{Read, Write};
    use std::process::{Child, Command, Stdio};
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant as Clock};

    use polepair_core::error::Outcome;
    use polepair_core::lane::Lane;
    use polepair_core::medium::{SerialLine, Stream};
    use polepair_core::profile::{ParameterId, Profile};
    use polepair_core::proto::modbus::Rtu;
    use polepair_core::proto::tmcl::Tmcl;
    use polepair_core::proto::{HostOptions, Protocol};
    use polepair_core::station::AxisIndex;
    use polepair_core::time::Instant;
    use polepair_drives::syntron_ts::profile::SYNTRON_TS;
    use polepair_link::pty::Pty;
    use polepair_link::{Connection, LinkIo, Mailbox, Received, clock, serial};
    use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};

    const ROUNDS: usize = 100;
    const TURNS: usize = 50;
    const SERIES: usize = 9;
    const WAKE_UPS: usize = 2_000;
    /// Longer than the background thread waits behind the last caller.
    const PAUSE: Duration = Duration::from_millis(10);

    /// Bytes on the wire: the request of the floor, and the reply of the responder to any request.
    struct Exchange {
        name: &'static str,
        /// Value that a read of the profile's first parameter returns.
        value: i64,
        request: &'static [u8],
        reply: &'static [u8],
    }

    /// Read axis parameter 0 of module 1: 123456. TMCM-170/171 manual §2.1.
    const TMCL: Exchange = Exchange {
        name: "tmcl",
        value: 123_456,
        request: &[1, 6, 0, 0, 0, 0, 0, 0, 7],
        reply: &[2, 1, 100, 6, 0, 1, 0xE2, 0x40, 0x90],
    };
    /// Read holding register 0 of station 1: 1. Modbus over serial line V1.02 §2.5.1.
    const MODBUS: Exchange = Exchange {
        name: "modbus-rtu",
        value: 1,
        request: &[1, 3, 0, 0, 0, 1, 0x84, 0x0A],
        reply: &[1, 3, 2, 0, 1, 0x79, 0x84],
    };

    /// Answers every request at once, in the cheapest way there is.
    pub(super) fn respond() {
        let modbus = std::env::args().any(|word| word == MODBUS.name);
        let exchange = if modbus { MODBUS } else { TMCL };
        let (mut wire, mut out) = (std::io::stdin().lock(), File::from(stdout()));
        let mut request_bytes = vec![0; exchange.request.len()];
        while wire.read_exact(&mut request_bytes).is_ok() && out.write_all(exchange.reply).is_ok() {
        }
    }

    pub(super) fn run() {
        if std::env::args().all(|word| word != "listened") {
            compare::<Tmcl>(Tmcl::generic_profile(), &TMCL);
            compare::<Rtu>(&SYNTRON_TS, &MODBUS);
        }
        listened::<Tmcl>(Tmcl::generic_profile(), &TMCL);
        wake_up();
    }

    /// Cost of a listener for requests: back to back, and after a pause in which the background thread has
    /// begun to read for it.
    fn listened<P: Protocol<Medium = Stream>>(
        profile: &'static Profile,
        exchange: &'static Exchange,
    ) {
        let (path, mut child) = responder(exchange);
        let (connection, mut request) = connection::<P>(profile, &path, exchange.value);
        println!("{}: medians (µs), alone and listened to", P::NAME);
        for (what, pause, rounds) in
            [("back to back", Duration::ZERO, 5_000), ("after 10 ms", PAUSE, 100)]
        {
            let mut best = [f64::MAX; 2];
            for _ in 0..SERIES {
                for (listens, best) in [false, true].into_iter().zip(&mut best) {
                    let mailbox = Mailbox::new(16);
                    let _guard = listens.then(|| connection.listen(&mailbox, 0, None));
                    let mut micros = Vec::new();
                    for _ in 0..rounds {
                        std::thread::sleep(pause);
                        let began = Clock::now();
                        request();
                        micros.push(began.elapsed().as_secs_f64() * 1e6);
                    }
                    *best = best.min(median(micros));
                }
            }
            println!("{what:>14} {:10.2} {:10.2} {:7.3}", best[0], best[1], best[1] / best[0]);
        }
        let _ = child.kill();
        let _ = child.wait();
    }

    /// From the waker's use in one thread to the end of the wait in another.
    fn wake_up() {
        let pty = Pty::open(None).unwrap();
        let mut buffer = [0; 16];
        assert_eq!(pty.receive(&mut buffer, Instant::ZERO).unwrap(), Received::TimedOut);
        let (waker, woken) = (pty.waker(), Arc::new(Mutex::new(Clock::now())));
        let its = Arc::clone(&woken);
        let other = std::thread::spawn(move || {
            for _ in 0..WAKE_UPS {
                std::thread::sleep(Duration::from_micros(500));
                *its.lock().unwrap() = Clock::now();
                waker.wake();
            }
        });
        let mut micros: Vec<f64> = Vec::new();
        while !other.is_finished() {
            if pty.receive(&mut buffer, clock::now().plus_ms(5)).unwrap() == Received::Woken {
                micros.push(woken.lock().unwrap().elapsed().as_secs_f64() * 1e6);
            }
        }
        other.join().unwrap();
        let best = micros.iter().copied().fold(f64::MAX, f64::min);
        println!("wake-up: best {best:.1}, median {:.1} (µs)", median(micros));
    }

    fn compare<P: Protocol<Medium = Stream>>(
        profile: &'static Profile,
        exchange: &'static Exchange,
    ) {
        assert_eq!(profile.parameters[0].index, 0, "what the floor asks for");
        let (path, mut child) = responder(exchange);
        let mut floor = floor(&path, exchange);
        let (_, mut ours) = connection::<P>(profile, &path, exchange.value);
        let mut best = [f64::MAX; 2];
        println!("{}: median of {} (µs; floor = write + blocking read)", P::NAME, ROUNDS * TURNS);
        println!("series       floor       ours   ratio");
        for series in 1..=SERIES {
            let (mut floors, mut our) = (Vec::new(), Vec::new());
            // In short turns: the pty's worker thread changes its pace every few milliseconds.
            for _ in 0..TURNS {
                timed(&mut floors, &mut floor);
                timed(&mut our, &mut ours);
            }
            let pair = [median(floors), median(our)];
            best = [best[0].min(pair[0]), best[1].min(pair[1])];
            println!("{series:6} {:11.2} {:10.2} {:7.3}", pair[0], pair[1], pair[1] / pair[0]);
        }
        println!("  best {:11.2} {:10.2} {:7.3}", best[0], best[1], best[1] / best[0]);
        let _ = child.kill();
        let _ = child.wait();
    }

    fn floor(path: &str, exchange: &'static Exchange) -> impl FnMut() + use<> {
        let mut port = File::options().read(true).write(true).open(path).unwrap();
        let mut reply = vec![0; exchange.reply.len()];
        move || {
            port.write_all(exchange.request).unwrap();
            port.read_exact(&mut reply).unwrap();
        }
    }

    fn connection<P: Protocol<Medium = Stream>>(
        profile: &'static Profile,
        path: &str,
        value: i64,
    ) -> (Connection, impl FnMut() + use<P>) {
        let options = HostOptions { gap_us: Some(0), ..HostOptions::new(0) };
        let driver = P::create_driver(profile, 1);
        let lane = Lane::<Stream, _>::new(P::create_host(&options, &[1]), [Box::new(driver) as _]);
        let port = serial::open(path, SerialLine::new_8n1(0)).unwrap();
        let connection = Connection::new(Box::new(port), Box::new(lane));
        let ours = connection.clone();
        let request = move || {
            let deadline = clock::now().plus_ms(1_000);
            let outcome = connection.request(deadline, |axes, now, ticket| {
                axes.read_parameter(now, ticket, AxisIndex(0), ParameterId(0))
            });
            assert_eq!(outcome, Ok(Some(Outcome::Done(value))));
        };
        (ours, request)
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

    fn responder(exchange: &Exchange) -> (String, Child) {
        let far = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        unlockpt(&far).unwrap();
        let path = ptsname(&far, Vec::new()).unwrap().into_string().unwrap();
        // Opened once, so that the pty is raw and outlives each client.
        let near = File::options().read(true).write(true).open(&path).unwrap();
        let mut termios = rustix::termios::tcgetattr(&near).unwrap();
        termios.make_raw();
        rustix::termios::tcsetattr(&near, rustix::termios::OptionalActions::Now, &termios).unwrap();
        std::mem::forget(near);
        let out = far.try_clone().unwrap();
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["respond", exchange.name])
            .stdin(Stdio::from(far))
            .stdout(Stdio::from(out))
            .spawn();
        (path, child.unwrap())
    }

    fn stdout() -> std::os::fd::OwnedFd {
        use std::os::fd::AsFd;
        std::io::stdout().as_fd().try_clone_to_owned().unwrap()
    }
}
