//! Sixteen channels at 1 kHz from eight drives on two simulated buses, as the scope has them.

use std::time::{Duration, Instant};

use polepair_serve::bench::{Bench, Channel, Options, Session};
use polepair_serve::message::telemetry::Sample;
use polepair_serve::message::{Given, LeaseAct, LinkState, Source, WriteParameters};

/// Four drives on a bus of 1 Mbit/s.
const BUS: &str = "sim:cia402:1,2,3,4?bitrate=1000000";

/// Has a drive send its position and its speed every millisecond.
fn send(bench: &Bench, who: &Session, axis: u16) {
    let lease = || bench.lease(axis, who, LeaseAct::Take, 0).wait().unwrap().expect("a lease");
    bench.raw(axis, who, lease().epoch, "nmt pre-operational").wait().unwrap();
    let identifier = bench.read_parameter(axis, "tpdo 1 identifier").wait().unwrap().raw;
    let settings = [
        ("identifier", identifier | 1 << 31),
        ("transmission", 255),
        ("inhibit time", 0),
        ("event time", 1),
        ("entries", 0),
        ("entry 1", 0x6064_0020),
        ("entry 2", 0x606C_0020),
        ("entries", 2),
        ("identifier", identifier & !(1 << 31)),
    ];
    for (name, raw) in settings {
        let values = [(format!("tpdo 1 {name}"), Given::Number(raw as f64))].into();
        let epoch = lease().epoch;
        let write = WriteParameters { values, keep: false, dry_run: false, epoch };
        bench.apply(axis, who, write).wait().unwrap();
    }
    bench.raw(axis, who, lease().epoch, "nmt start").wait().unwrap();
}

fn seconds() -> u64 {
    let said = std::env::var("POLEPAIR_SCOPE_SECONDS").ok().and_then(|text| text.parse().ok());
    said.unwrap_or(3)
}

/// Bytes of this process that lie in memory.
fn memory() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let resident = pages.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok());
    resident.unwrap_or(0) * 4096
}

#[test]
fn sixteen_channels_at_1_khz_lose_nothing_and_take_no_more_memory() {
    let who: Session = "scope".into();
    let bench = Bench::open(&[BUS.into(), BUS.into()], Options::default()).unwrap();
    (0..8).for_each(|axis| send(&bench, &who, axis));
    let watch = |(axis, signal)| bench.subscribe(axis, Some(signal), None, 1000.0).unwrap();
    let all = (0..8).flat_map(|axis| [(axis, "position"), (axis, "velocity")]);
    let mut channels: Vec<(Channel, Vec<Sample>)> = all.map(|c| (watch(c), Vec::new())).collect();
    // What is not yet sent by itself is asked for meanwhile.
    let deadline = Instant::now() + Duration::from_secs(60);
    while channels.iter().any(|(channel, _)| channel.source() == Source::Polled) {
        assert!(Instant::now() < deadline, "the drives do not send");
        std::thread::sleep(Duration::from_millis(10));
    }
    // Answers may still be on their way.
    std::thread::sleep(Duration::from_millis(200));
    for (channel, _) in &mut channels {
        let mut before = Vec::new();
        assert_eq!(channel.take(&mut before), None);
    }
    let (begun, end) = (memory(), Instant::now() + Duration::from_secs(seconds()));
    let mut counts = vec![0_u64; channels.len()];
    while Instant::now() < end {
        std::thread::sleep(Duration::from_millis(16));
        for ((channel, samples), count) in channels.iter_mut().zip(&mut counts) {
            assert_eq!(channel.take(samples), None);
            for pair in samples.windows(2) {
                let gap = pair[1].t_us - pair[0].t_us;
                assert!((500..1500).contains(&gap), "{gap} us between two: one is missing");
            }
            *count += samples.len() as u64;
            // The last is compared with the next.
            samples.drain(..samples.len().saturating_sub(1));
        }
    }
    for ((channel, _), count) in channels.iter().zip(&counts) {
        assert_eq!((channel.lost(), channel.source()), (0, Source::Pushed));
        assert!((channel.hz() - 1000.0).abs() < 20.0, "{} Hz", channel.hz());
        assert!(*count > seconds() * 800, "{count} samples");
    }
    let grown = memory().saturating_sub(begun);
    assert!(grown < 8 << 20, "{grown} bytes more");
    let view = bench.snapshot();
    assert!(view.links.iter().all(|link| link.state == LinkState::Open));
    assert!(view.axes[0].signals.iter().any(|s| s.signal == "position" && s.pushed));
    bench.shutdown();
}

#[test]
fn what_a_drive_does_not_send_is_asked_for_at_the_rate_that_is_wanted() {
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], Options::default()).unwrap();
    let mut speed = bench.subscribe(0, Some("velocity"), None, 20.0).unwrap();
    let mut current = bench.subscribe(0, None, Some("max current"), 5.0).unwrap();
    let (mut speeds, mut currents) = (Vec::new(), Vec::new());
    let begun = bench.now_ms();
    for _ in 0..2000 {
        bench.pass(Duration::from_millis(1));
        assert_eq!((speed.take(&mut speeds), current.take(&mut currents)), (None, None));
    }
    // Asking takes time of its own.
    let seconds = (bench.now_ms() - begun) / 1e3;
    for (hz, count) in [(20.0, speeds.len()), (5.0, currents.len())] {
        let told = count as f64 / seconds;
        assert!((told / hz - 1.0).abs() < 0.2, "{told} Hz and not {hz}");
    }
    assert_eq!((speed.source(), speed.unit()), (Source::Polled, "rad/s"));
    assert!(bench.subscribe(0, Some("smell"), None, 20.0).is_err());
    assert!(bench.subscribe(0, Some("velocity"), None, f64::NAN).is_err());
}

#[test]
fn what_is_wanted_oftener_than_the_wire_carries_does_not_keep_the_rest_from_being_asked_for() {
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], Options::default()).unwrap();
    let watch = |signal| bench.subscribe(0, Some(signal), None, 1000.0).unwrap();
    let mut channels =
        ["position", "velocity", "current"].map(|signal| (watch(signal), Vec::new()));
    for _ in 0..2000 {
        bench.pass(Duration::from_millis(1));
        channels.iter_mut().for_each(|(channel, samples)| assert_eq!(channel.take(samples), None));
    }
    let counts = channels.map(|(_, samples)| samples.len());
    assert!(counts[0] > 10 && counts.iter().all(|count| count.abs_diff(counts[0]) <= 1));
}
