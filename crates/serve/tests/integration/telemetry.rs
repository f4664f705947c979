//! Sixteen channels at 1 kHz from eight drives on two simulated buses, as the scope has them.

use crate::site;
use polepair_test_support::Deadline;

use std::time::{Duration, Instant};

use polepair_serve::bench::{Bench, BenchOptions, SessionName};
use polepair_serve::message::{
    LeaseAction, LinkState, OutcomeKind, ParameterInput, RawRequest, SampleSource, WriteParameters,
};
use serde_json::{Value, json};
use site::{Site, folder, memory, options, samples, send_message};
use tungstenite::Message;

/// Four drives on a bus of 1 Mbit/s.
const BUS: &str = "sim:cia402:1,2,3,4?bitrate=1000000";

/// Has a drive send its position and its speed every millisecond.
fn send(bench: &Bench, who: &SessionName, axis: u16) {
    let lease =
        || bench.request_lease(axis, who, LeaseAction::Take, 0).wait().unwrap().expect("a lease");
    let say = |text: &str| {
        let (id, text) = (format!("{axis} {text}"), text.to_owned());
        let (issued_ms, ttl_ms, epoch) = (bench.now_ms(), 5000.0, lease().epoch);
        let request = RawRequest { id, issued_ms, ttl_ms, epoch, text };
        let outcome = bench.raw(axis, who, request).wait().unwrap();
        assert_eq!(outcome.outcome, OutcomeKind::Done, "{outcome:?}");
    };
    say("nmt pre-operational");
    let identifier =
        bench.read_parameter(axis, "tpdo 1 identifier").wait().unwrap().raw.expect("a number");
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
        let values = [(format!("tpdo 1 {name}"), ParameterInput::Number(raw as f64))].into();
        let epoch = lease().epoch;
        let write = WriteParameters { values, keep: false, dry_run: false, raw: false, epoch };
        bench.write_parameters(axis, who, write).wait().unwrap();
    }
    say("nmt start");
}

/// Five, ten minutes in `make soak`.
fn seconds() -> u64 {
    let sequence = std::env::var("POLEPAIR_SCOPE_SECONDS").ok().and_then(|text| text.parse().ok());
    sequence.unwrap_or(5)
}

/// A channel, as a viewer has it.
#[derive(Default)]
struct Trace {
    /// Samples since drives send them by themselves.
    count: u64,
    first_us: u64,
    last_us: u64,
}

impl Trace {
    fn check_samples(&mut self, rows: &[(u64, f64)]) {
        for (t_us, value) in rows {
            assert!(value.is_finite());
            if self.count == 0 {
                self.first_us = *t_us;
            } else {
                let gap = t_us - self.last_us;
                assert!((100..1900).contains(&gap), "{gap} us between two: one is missing");
            }
            (self.last_us, self.count) = (*t_us, self.count + 1);
        }
    }

    /// Rate by the samples' own times.
    fn hz(&self) -> f64 {
        (self.count - 1) as f64 * 1e6 / (self.last_us - self.first_us) as f64
    }
}

#[test]
fn sixteen_channels_at_1_khz_lose_nothing_and_take_no_more_memory() {
    if !site::is_alone("telemetry::sixteen_channels_at_1_khz_lose_nothing_and_take_no_more_memory")
    {
        return;
    }
    let site = Site::of(options(folder()), &[BUS, BUS]);
    let bench = site.server.as_ref().unwrap().bench();
    (0..8).for_each(|axis| send(bench, &"scope".into(), axis));
    let mut ann = site.live_as("viewer");
    let all = (0..8).flat_map(|axis| [(axis, "position"), (axis, "velocity")]);
    for (channel, (axis, signal)) in all.enumerate() {
        send_message(
            &mut ann,
            &json!({ "type": "subscribe", "channel": channel, "axis": axis,
            "signal": signal, "hz": 1000 }),
        );
    }
    // What is not yet sent by itself is asked for meanwhile, and answers may still be on their way.
    let mut pushed = [false; 16];
    let deadline = Deadline::new("the drives send all channels by themselves");
    let mut settled = None;
    while settled.is_none_or(|at: Instant| at.elapsed() < Duration::from_millis(500)) {
        deadline.check(|| format!("sent: {pushed:?}"));
        let Message::Text(text) = ann.read().unwrap() else { continue };
        let value: Value = serde_json::from_str(&text).unwrap();
        if value["type"] == "subscribed" {
            pushed[value["channel"].as_u64().unwrap() as usize] = value["source"] == "pushed";
            settled = pushed.iter().all(|pushed| *pushed).then(Instant::now);
        }
    }
    let mut traces: [Trace; 16] = Default::default();
    let (started_at, end) = (memory(), Instant::now() + Duration::from_secs(seconds()));
    while Instant::now() < end {
        match ann.read().unwrap() {
            Message::Binary(bytes) => {
                let (channel, rows) = samples(&bytes);
                traces[usize::from(channel)].check_samples(&rows);
                assert_eq!(bytes[16..24], [0; 8], "none was lost so far");
            }
            Message::Text(text) => {
                let value: Value = serde_json::from_str(&text).unwrap();
                assert!(value["type"] != "gap" && value["type"] != "subscribed", "{value}");
            }
            _ => {}
        }
    }
    for trace in &traces {
        assert!((trace.hz() - 1000.0).abs() < 20.0, "{} Hz", trace.hz());
        // However little time the machine gave the simulation, this shows the rate.
        assert!(trace.count > 200, "{} samples", trace.count);
    }
    let grown = memory().saturating_sub(started_at);
    println!(
        "{:.2} Hz of {} samples each, {} kB more",
        traces[0].hz(),
        traces[0].count,
        grown >> 10
    );
    assert!(grown < 8 << 20, "{grown} bytes more");
    let view = bench.snapshot();
    assert!(view.links.iter().all(|link| link.state == LinkState::Open));
    assert!(view.axes[0].signals.iter().any(|s| s.signal == "position" && s.pushed));
    site.end();
}

#[test]
fn a_signal_that_a_drive_does_not_send_is_queried_at_the_wanted_rate() {
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], BenchOptions::default()).unwrap();
    let mut speed = bench.subscribe(0, Some("velocity"), None, 20.0).unwrap();
    let mut current = bench.subscribe(0, None, Some("max current"), 5.0).unwrap();
    let (mut speeds, mut currents) = (Vec::new(), Vec::new());
    let started_at = bench.now_ms();
    for _ in 0..2000 {
        bench.advance_time(Duration::from_millis(1));
        assert_eq!(
            (speed.drain_into(&mut speeds), current.drain_into(&mut currents)),
            (None, None)
        );
    }
    // Asking takes time of its own.
    let seconds = (bench.now_ms() - started_at) / 1e3;
    for (hz, count) in [(20.0, speeds.len()), (5.0, currents.len())] {
        let reported = count as f64 / seconds;
        assert!((reported / hz - 1.0).abs() < 0.2, "{reported} Hz and not {hz}");
    }
    assert_eq!((speed.source(), speed.unit()), (SampleSource::Polled, "rad/s"));
    assert!(bench.subscribe(0, Some("smell"), None, 20.0).is_err());
    assert!(bench.subscribe(0, Some("velocity"), None, f64::NAN).is_err());
}

#[test]
fn a_rate_beyond_the_wire_does_not_keep_other_signals_from_being_queried() {
    let bench = Bench::open(&["sim:tmcl?time=virtual".into()], BenchOptions::default()).unwrap();
    let watch = |signal| bench.subscribe(0, Some(signal), None, 1000.0).unwrap();
    let mut channels =
        ["position", "velocity", "current"].map(|signal| (watch(signal), Vec::new()));
    for _ in 0..2000 {
        bench.advance_time(Duration::from_millis(1));
        channels
            .iter_mut()
            .for_each(|(channel, samples)| assert_eq!(channel.drain_into(samples), None));
    }
    let counts = channels.map(|(_, samples)| samples.len());
    assert!(counts[0] > 10 && counts.iter().all(|count| count.abs_diff(counts[0]) <= 1));
}
