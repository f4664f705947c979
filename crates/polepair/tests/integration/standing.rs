//! A stop is over when the motor is at standstill by measurement, not by a trajectory
//! or an acknowledgement.

use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use polepair::axis::{
    STOP_RETRY_MAX, StopOptions, StopPersistence, StopProgress, StopSupervisor, WireAirtime,
    stop_axes,
};
use polepair::{Error, LocalLink, connect_local};
use polepair_drives::surroundings::Act;

/// Drives whose stop waits for nothing that is measured.
const BLIND: [&str; 3] =
    ["sim:technosoft-f514l?time=virtual", "sim:tmlcan?time=virtual", "sim:thruster?time=virtual"];

fn speed(link: &LocalLink) -> f64 {
    link.simulation().unwrap().truth(0, 0).unwrap().velocity.abs()
}

fn load(link: &LocalLink, torque: f64) {
    assert!(link.simulation().unwrap().act(0, 0, Act::Load(torque)));
}

/// A motor without power that its load turns.
fn turned_by_its_load(url: &str) -> LocalLink {
    let link = connect_local(url).unwrap_or_else(|error| panic!("{url}: {error}"));
    load(&link, 0.2);
    link.sleep(Duration::from_secs(1));
    assert!(speed(&link) > 1.0, "{url}: {}", speed(&link));
    link
}

/// Stops the only axis of a link, and repeats that where it is lost.
fn stop_with_retry(link: &LocalLink) -> Result<(), Error> {
    stop_axes(link.axes(), StopOptions::default(), STOP_RETRY_MAX, |_, _| true)
        .remove(0)
        .standstill
        .map(drop)
}

fn may_turn(url: &str, ended: &Result<(), Error>) {
    let Err(error) = ended else { panic!("{url}: it turns") };
    assert!(error.may_turn(), "{url}: {error}");
    assert!(error.to_string().contains("is not at standstill after 5 s"), "{url}: {error}");
}

#[test]
fn a_motor_that_its_load_turns_is_not_reported_as_stopped() {
    for url in BLIND {
        let link = turned_by_its_load(url);
        may_turn(url, &link.axes()[0].stop());
        may_turn(url, &link.stop_all());
        may_turn(url, &stop_with_retry(&link));
        load(&link, 0.0);
        link.sleep(Duration::from_secs(20));
        assert!(speed(&link) < 0.01, "{url}: {}", speed(&link));
        link.axes()[0].stop().unwrap_or_else(|error| panic!("{url}: {error}"));
    }
}

/// The mode of a drive during its motion is named, though it reports the mode with other bits then.
#[test]
fn a_mode_is_named_by_the_signals_words_or_its_parameters() {
    let link = connect_local("sim:technosoft-f514l?time=virtual").expect("a drive");
    let axis = &link.axes()[0];
    let armed = axis.armed().expect("armed");
    axis.velocity("60 rpm").expect("turns");
    axis.get_raw("motion command").expect("told");
    assert_eq!(axis.mode(&axis.state()).as_deref(), Some("speed profile"));
    armed.release().expect("stands");
}

#[test]
fn a_turning_motor_is_at_standstill_when_its_stop_returns() {
    for url in BLIND {
        let link = connect_local(url).unwrap_or_else(|error| panic!("{url}: {error}"));
        let axis = &link.axes()[0];
        let armed = axis.armed().unwrap_or_else(|error| panic!("{url}: {error}"));
        match axis.velocity("300 rpm") {
            Err(Error::Unsupported { .. }) => axis.torque(0.1).expect("a torque"),
            other => other.unwrap_or_else(|error| panic!("{url}: {error}")),
        }
        link.sleep(Duration::from_secs(2));
        assert!(speed(&link) > 1.0, "{url}: {}", speed(&link));
        axis.stop().unwrap_or_else(|error| panic!("{url}: {error}"));
        assert!(speed(&link) < 0.1, "{url}: {}", speed(&link));
        armed.detach().unwrap();
    }
}

/// A TMCL module made from the protocol's manual: it reports a speed of `speed`, and its position changes by this
/// number of counts a second until it got `stops` stops. 4000 counts are a turn. Returns its address.
fn module_whose_position_runs(speed: i32, counts_per_s: f64, stops: u32) -> String {
    module_that_loses(0, speed, counts_per_s, stops)
}

/// The same, and of its answers about its speed it loses the `lost`th after its stop.
fn module_that_loses(lost: u32, speed: i32, counts_per_s: f64, stops: u32) -> String {
    let server = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("tmcl+tcp://{}?profile=tmcm-170#1", server.local_addr().expect("an address"));
    std::thread::spawn(move || {
        let (mut reported, mut looks) = (0, 0);
        for wire in server.incoming() {
            let Ok(mut wire) = wire else { return };
            let (started_at, mut request, mut stands_at) = (Instant::now(), [0; 9], None);
            while wire.read_exact(&mut request).is_ok() {
                let position = (started_at.elapsed().as_secs_f64() * counts_per_s) as i32;
                reported += u32::from(request[1] == 3);
                if reported >= stops && request[1] == 3 {
                    stands_at.get_or_insert(position);
                }
                let polled = reported > 0 && (request[1], request[2]) == (6, 3);
                looks += u32::from(polled);
                if polled && looks == lost {
                    continue;
                }
                let (status, value): (u8, i32) = match (request[1], request[2]) {
                    (3, _) => (100, 0),
                    // A count that toggles by one, as an encoder between two counts reports it.
                    (6, 1) => (100, stands_at.unwrap_or(position) + position % 2),
                    // A fast motor reports its standstill.
                    (6, 3) if speed > 100 && stands_at.is_some() => (100, 0),
                    (6, 3) => (100, speed),
                    (6, 210 | 250) => (100, 4000),
                    (6, _) => (100, 0),
                    (136, _) => (100, 0x00AA_0112),
                    _ => (2, 0),
                };
                let mut reply = [2, 1, status, request[1], 0, 0, 0, 0, 0];
                reply[4..8].copy_from_slice(&value.to_be_bytes());
                reply[8] = reply[..8].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
                if wire.write_all(&reply).is_err() {
                    break;
                }
            }
        }
    });
    url
}

#[test]
fn a_motor_whose_position_runs_does_not_stand() {
    // 300 rpm, of which the drive reports nothing.
    let link = connect_local(&module_whose_position_runs(0, 20_000.0, u32::MAX)).expect("a module");
    let Err(error) = link.axes()[0].stop() else { panic!("it turns") };
    assert!(error.may_turn(), "{error}");
    let text = error.to_string();
    assert!(text.contains("reports a speed of 0 rpm, but its position went from "), "{text}");
    assert!(text.contains("° to ") || text.contains("deg to "), "{text}");
    let persistence = StopPersistence::UntilStandstill;
    let mut stopping = StopSupervisor::begin(&link.axes()[0], StopOptions::default(), persistence);
    let _ = stopping.wait(&mut WireAirtime::default(), Duration::from_millis(500));
    assert!(stopping.may_be_turning() && *stopping.progress() == StopProgress::Acknowledged);
    assert!(
        stopping.trouble().is_some_and(|error| error.to_string().contains("its position went"))
    );
}

/// The stop is repeated to such a motor, and standstill is confirmed once its position stays.
#[test]
fn a_motor_whose_position_runs_is_commanded_to_stop_again() {
    let link = connect_local(&module_whose_position_runs(0, 20_000.0, 3)).expect("a module");
    link.axes()[0].stop().expect("the third stop is obeyed");
}

/// If a motor turns on though its drive replied to the stop, the stop is repeated at once, not after the
/// time that a motor has to brake.
#[test]
fn a_motor_that_turns_on_is_commanded_to_stop_again() {
    for way in 0..3 {
        let link = connect_local(&module_whose_position_runs(300, 20_000.0, 3)).expect("a module");
        let started_at = Instant::now();
        let stopped = match way {
            0 => link.axes()[0].stop(),
            1 => link.stop_all(),
            _ => stop_with_retry(&link),
        };
        stopped.expect("the third stop is obeyed");
        assert!(started_at.elapsed() >= Duration::from_secs(3), "it is given time to brake");
    }
}

/// The time of a closed link goes on, so a wait for standstill ends with an error.
#[test]
fn a_link_that_is_closed_ends_the_wait_for_its_stop() {
    let link =
        connect_local(&module_whose_position_runs(300, 20_000.0, u32::MAX)).expect("a module");
    let axes = link.axes().to_vec();
    let (sender, ended) = mpsc::channel();
    std::thread::spawn(move || {
        let options = StopOptions::default();
        sender.send(stop_axes(&axes, options, Duration::from_secs(3), |_, _| true))
    });
    std::thread::sleep(Duration::from_millis(500));
    link.close();
    let ended = ended.recv_timeout(Duration::from_secs(120)).expect("the wait ends");
    let error = ended[0].standstill.as_ref().expect_err("it turns");
    assert!(error.may_turn(), "{error}");
}

/// One answer that is lost while a motor is looked at makes no stop fail: it is asked for again.
#[test]
fn a_look_that_is_lost_is_asked_for_again() {
    let link = connect_local(&module_that_loses(2, 300, 20_000.0, 1)).expect("a module");
    link.axes()[0].stop().expect("it stands");
}

/// A motor whose encoder toggles by one count is at standstill; one that creeps at 4 rpm is not.
#[test]
fn standstill_is_slower_than_half_a_turn_in_a_minute() {
    for (speed, counts_per_s, stands) in [(0, 0.0, true), (0, 10.0, true), (4, 266.0, false)] {
        let link = connect_local(&module_whose_position_runs(speed, counts_per_s, u32::MAX));
        let stopped = link.expect("a module").axes()[0].stop();
        assert_eq!(stopped.is_ok(), stands, "{speed} rpm, {counts_per_s}: {stopped:?}");
    }
}
