//! Request and reply over a pty: a whole connection beside the least that any program must do,
//! write and blocking read, in turns against the same responder in another process.
//!
//! `cargo bench -p polepair-link`, under `taskset -c 1` for figures that repeat.

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
    use std::time::Instant as Clock;

    use polepair_core::lane::Lane;
    use polepair_core::medium::{SerialLine, Stream};
    use polepair_core::profile::ParameterId;
    use polepair_core::proto::tmcl::Tmcl;
    use polepair_core::proto::{HostOptions, Protocol};
    use polepair_core::station::AxisIndex;
    use polepair_link::{Connection, clock, serial};
    use rustix::pty::{OpenptFlags, openpt, ptsname, unlockpt};

    const REQUEST: [u8; 9] = [1, 6, 0, 0, 0, 0, 0, 0, 7];
    const ROUNDS: usize = 100;
    const TURNS: usize = 50;
    const SERIES: usize = 9;

    /// Answers every nine bytes at once, in the cheapest way that is legal.
    pub(super) fn respond() {
        let (mut wire, mut out) = (std::io::stdin().lock(), File::from(stdout()));
        let mut asked = [0_u8; 9];
        while wire.read_exact(&mut asked).is_ok() {
            let mut reply = [2, asked[0], 100, asked[1], 0, 1, 0xE2, 0x40, 0];
            reply[8] = reply[..8].iter().fold(0, |sum, byte| u8::wrapping_add(sum, *byte));
            if out.write_all(&reply).is_err() {
                break;
            }
        }
    }

    pub(super) fn run() {
        let (path, mut child) = responder();
        let mut floor = floor(&path);
        let mut ours = connection(&path);
        let mut best = [f64::MAX; 2];
        println!("series   floor p50   ours p50   ratio   (µs; floor = write + blocking read)");
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

    fn floor(path: &str) -> impl FnMut() + use<> {
        let mut port = File::options().read(true).write(true).open(path).unwrap();
        let mut reply = [0_u8; 9];
        move || {
            port.write_all(&REQUEST).unwrap();
            port.read_exact(&mut reply).unwrap();
        }
    }

    fn connection(path: &str) -> impl FnMut() + use<> {
        let options = HostOptions {
            baud: 0,
            reply_timeout_ms: None,
            gap_us: Some(0),
            host: None,
            echo: false,
        };
        let driver = Tmcl::driver(Tmcl::generic(), 1);
        let lane = Lane::<Stream, _>::new(Tmcl::host(&options), [Box::new(driver) as _]);
        let port = serial::open(path, SerialLine::n81(0)).unwrap();
        let connection = Connection::new(Box::new(port), Box::new(lane));
        move || {
            let deadline = clock::now().plus_ms(1_000);
            let outcome = connection.ask(deadline, |axes, now, ticket| {
                axes.read(now, ticket, AxisIndex(0), ParameterId(0))
            });
            assert!(matches!(outcome, Ok(Some(_))), "{outcome:?}");
        }
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

    fn responder() -> (String, Child) {
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
            .arg("respond")
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
