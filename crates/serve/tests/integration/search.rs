//! Searches of ports: refused, broken off, and the message for a port without replies.

use std::time::Duration;

use polepair_link::pty::Pty;
use polepair_serve::bench::{Bench, BenchEvent, BenchOptions, SessionName};
use polepair_serve::message::{ScanState, SearchRequest, SearchView};
use polepair_test_support::wait_until;

fn request(ports: &[&str]) -> SearchRequest {
    SearchRequest { ports: ports.iter().map(|port| (*port).to_owned()).collect() }
}

#[test]
fn a_search_is_refused_for_other_ports_and_broken_off() {
    let pty = Pty::open(None).expect("a pseudo-terminal");
    let path = pty.path().to_owned();
    let options = BenchOptions { search_ports: vec![path.clone()], ..BenchOptions::default() };
    let bench = Bench::open(&["sim:tmcl".to_owned()], options).expect("a bench");
    let ann: SessionName = "ann".into();
    assert_eq!(bench.search_view().expect_err("no search").code, "gateway.missing");
    for unknown in ["/etc/passwd", "/dev/null", "/dev/tty", "", "../x"] {
        let refused = bench.start_search(&ann, &request(&[unknown])).expect_err(unknown);
        assert_eq!((&*refused.code, refused.executed), ("gateway.missing", Some(false)));
    }
    assert_eq!(bench.cancel_search(&ann).expect_err("nobody searches").code, "gateway.missing");
    let mut events = bench.subscribe_events();
    let view = bench.start_search(&ann, &request(&[&path])).expect("begins");
    assert_eq!((view.state, &*view.by), (ScanState::UnderWay, "ann"));
    let refused = bench.start_search(&ann, &request(&[&path])).expect_err("one at a time");
    assert_eq!(refused.code, "gateway.look");
    wait_until("the first attempt", || {
        bench.search_view().is_ok_and(|view| view.step.contains(&path) && view.of > 0)
    });
    bench.cancel_search(&ann).expect("it is under way");
    let ended = |view: &SearchView| view.state != ScanState::UnderWay;
    wait_until("its end", || bench.search_view().is_ok_and(|view| ended(&view)));
    let view = bench.search_view().expect("the last search");
    assert_eq!((view.state, &*view.step), (ScanState::BrokenOff, ""));
    assert_eq!((view.found.len(), &*view.silent[0].port), (0, &*path));
    assert_eq!(bench.snapshot().search, Some(view));
    let mut told = std::iter::from_fn(|| events.try_recv().ok());
    assert!(told.any(|event| matches!(event, BenchEvent::Search(view) if ended(&view))));
}

#[test]
fn the_end_of_a_bench_ends_its_search() {
    let pty = Pty::open(None).expect("a pseudo-terminal");
    let path = pty.path().to_owned();
    let options = BenchOptions { search_ports: vec![path.clone()], ..BenchOptions::default() };
    let bench = Bench::open(&["sim:tmcl".to_owned()], options).expect("a bench");
    bench.start_search(&"ann".into(), &request(&[&path])).expect("begins");
    std::thread::sleep(Duration::from_millis(50));
    // It waits for its threads.
    assert!(bench.shutdown().is_empty());
}
