//! Serial ports of different timing: each takes its time, and no protocol loses its way by it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use polepair::connect_local;

/// Address of a rack with one drive behind such a port, at the factory's address.
fn rack(profile: &str, protocol: &str, timing: &str) -> PathBuf {
    let text = format!(
        "[[link]]\nprotocol = \"{protocol}\"\ntiming = \"{timing}\"\n\
         [[link.drive]]\nprofile = \"{profile}\"\n"
    );
    let name = format!("timing-{protocol}-{timing}-{:?}.toml", std::thread::current().id());
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, text).expect("it is written");
    path
}

const DRIVES: [(&str, &str); 4] = [
    ("tmcm-171", "tmcl"),
    ("syntron-ts", "modbus-rtu"),
    ("syntron-ts", "modbus-ascii"),
    ("technosoft-f514l", "tml"),
];
const TIMINGS: [&str; 4] = ["uart", "cdc", "ftdi-16ms", "tcp"];

#[test]
fn a_motor_turns_and_stops_behind_each_port() {
    for (profile, protocol) in DRIVES {
        for (timing, keys) in TIMINGS.map(|timing| (timing, "")).into_iter().chain([
            // A user who knows that the baud rate is not real states it.
            ("cdc", "&timing=off"),
        ]) {
            let case = format!("{profile} by {protocol}, {timing}{keys}");
            let file = rack(profile, protocol, timing);
            let url = format!("sim:{}?time=virtual{keys}", file.display());
            let link = connect_local(&url).unwrap_or_else(|e| panic!("{case}: {e:?}"));
            let axis = link.axes()[0].clone();
            if profile == "syntron-ts" {
                // From the factory it follows pulses.
                axis.set("Fn_00", "1").unwrap_or_else(|e| panic!("{case}: {e:?}"));
            }
            let armed = axis.armed().unwrap_or_else(|e| panic!("{case}: {e:?}"));
            axis.velocity("60 rpm").unwrap_or_else(|e| panic!("{case}: {e:?}"));
            link.sleep(Duration::from_secs(1));
            let truth = || link.simulation().and_then(|sim| sim.truth(0, 0)).expect("a motor");
            assert!(truth().velocity > 5.0, "{case}: {:?}", truth());
            axis.stop().unwrap_or_else(|e| panic!("{case}: {e:?}"));
            armed.detach().unwrap();
            link.sleep(Duration::from_secs(1));
            assert!(truth().velocity.abs() < 0.1, "{case}: {:?}", truth());
        }
    }
}

#[test]
fn answers_take_what_the_port_takes() {
    let reads = |timing: &str| -> Vec<Duration> {
        let file = rack("tmcm-171", "tmcl", timing);
        let link = connect_local(&format!("sim:{}?time=virtual", file.display())).expect("opened");
        let axis = link.axes()[0].clone();
        let read = |_| {
            let started_at = axis.connection().now();
            axis.get_raw("actual position").expect("an answer");
            axis.connection().now().since(started_at)
        };
        // The first asks more: whether the module was there before.
        (0..20).map(read).skip(1).collect()
    };
    // Nine bytes each way at 9600 baud.
    let frames = Duration::from_micros(18_749);
    let all = |timing: &str, fits: &dyn Fn(Duration) -> bool| {
        let took = reads(timing);
        assert!(took.iter().copied().all(fits), "{timing}: {took:?}");
        took
    };
    let usual = frames..frames * 2;
    all("uart", &|took| usual.contains(&took));
    all("cdc", &|took| took < frames);
    all("ftdi-16ms", &|took| took.as_millis() % 16 == 0);
    let network = Duration::from_millis(40);
    let tcp = all("tcp", &|took| (frames..frames * 2 + network).contains(&took));
    let (min, max) = (tcp.iter().min().expect("one"), tcp.iter().max().expect("one"));
    assert!(*max - *min > Duration::from_millis(10), "{tcp:?}");
}

#[test]
fn a_wrong_timing_is_reported_with_its_line() {
    for (timing, baud, words) in [
        ("ftdi", "", "`ftdi` is none of uart, cdc, ftdi-16ms, tcp"),
        ("tcp", "baud = 0\n", "`tcp` has a baud rate"),
    ] {
        let text = format!(
            "[[link]]\n{baud}timing = \"{timing}\"\n[[link.drive]]\nprofile = \"tmcm-171\"\n"
        );
        let error =
            polepair::simulate::rack_of_text("cell.toml", &text, 1).expect_err("it is wrong");
        assert!(error.to_string().contains(words), "{error}");
    }
    let can = "[[link]]\ntiming = \"cdc\"\n[[link.drive]]\nprofile = \"thruster\"\n";
    let error = polepair::simulate::rack_of_text("cell.toml", can, 1).expect_err("no serial line");
    assert!(error.to_string().contains("`timing` is not supported"), "{error}");
}
