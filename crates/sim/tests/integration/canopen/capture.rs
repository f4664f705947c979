//! Findings of the analyser on our buses: none on healthy ones, and the planted fault on others.

use polepair_capture::session::{AnomalyKind, SessionNotice};
use polepair_capture::{CaptureDecoder, Rules, Timestamp};
use polepair_sim::world::{Reception, ReceptionData};

use super::*;

/// Anomalies in the frames that every node received, as kinds and sentences.
fn odds(bench: &mut Bench) -> Vec<(AnomalyKind, String)> {
    let mut decoder = CaptureDecoder::new(Rules::parse("canopen").unwrap());
    let (mut odds, mut seen) = (Vec::new(), None);
    let mut keep = |notices: &[SessionNotice]| {
        odds.extend(notices.iter().filter_map(|notice| match notice {
            SessionNotice::Anomaly(anomaly) => {
                Some((anomaly.kind, format!("{:?}: {}", anomaly.axis, anomaly.text)))
            }
            _ => None,
        }));
    };
    for Reception { at, data, .. } in bench.world.take_log() {
        let ReceptionData::Frame(frame, _) = data else { continue };
        // All nodes receive a frame at the same time.
        if seen.replace((at, frame)) == Some((at, frame)) {
            continue;
        }
        let time = Some(Timestamp(at.since(Instant::ZERO).as_nanos() as u64));
        decoder.decode_frame(time, "can0", None, &frame, &mut |event| {
            assert_eq!(event.defect, None, "{frame}: {}", event.explanation.text);
            keep(event.notices);
        });
    }
    decoder.finish_sessions(&mut |event| keep(event.notices));
    odds
}

fn listened(seed: u64, profiles: &[&'static Profile]) -> Bench {
    let mut bench = Bench::new(seed, profiles);
    bench.world.enable_log();
    bench
}

#[test]
fn nothing_is_odd_with_a_bus_that_is_well() {
    seeds(|seed| {
        let mut bench = listened(seed, &[cia402(), ts(), cia402()]);
        for axis in [0, 2] {
            bench.set(axis, &[("heartbeat time", 100)]);
            let id = 0x182 + i64::from(axis);
            bench.set(axis, &[("tpdo 1 identifier", id | 1 << 31), ("tpdo 1 entries", 0)]);
            bench.set(axis, &[("tpdo 1 entry 1", 0x6041_0010), ("tpdo 1 entry 2", 0x6064_0020)]);
            bench.set(axis, &[("tpdo 1 entries", 2), ("tpdo 1 identifier", id)]);
        }
        for axis in 0..3 {
            bench.spin(axis, 20.0);
            done(bench.verb(axis, Verb::Stop));
            let by = Command { target: Some(1.0), ..Command::new(Verb::MoveBy) };
            done(bench.command(axis, by));
            done(bench.verb(axis, Verb::Reached));
            done(bench.verb(axis, Verb::Disable));
        }
        bench.pass(2_000);
        assert_eq!(odds(&mut bench), []);
    });
}

#[test]
fn a_node_that_leaves_the_bus_is_silent_once() {
    seeds(|seed| {
        let mut bench = listened(seed, &[cia402(), cia402()]);
        for axis in [0, 1] {
            bench.set(axis, &[("heartbeat time", 100)]);
        }
        bench.pass(2_000);
        bench.pull(0, true);
        bench.pass(5_000);
        done(bench.read(1, "statusword"));
        let odds = odds(&mut bench);
        let kinds: Vec<AnomalyKind> = odds.iter().map(|(kind, _)| *kind).collect();
        assert_eq!(kinds, [AnomalyKind::Silent], "{odds:?}");
    });
}

#[test]
fn two_nodes_with_one_number_are_found() {
    seeds(|seed| {
        let mut bench = listened(seed, &[cia402(), cia402()]);
        bench.set(0, &[("heartbeat time", 100)]);
        bench.pass(2_000);
        // The other one's heartbeat comes between.
        let beat = Frame::standard(0x702, &[0x7F]);
        bench.pass(30);
        bench.flood(beat, 40, 100_000);
        bench.pass(3_000);
        let odds = odds(&mut bench);
        let kinds: Vec<AnomalyKind> = odds.iter().map(|(kind, _)| *kind).collect();
        assert_eq!(kinds, [AnomalyKind::DuplicateAddress], "{odds:?}");
    });
}
