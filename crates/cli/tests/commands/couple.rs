//! Axes that follow each other.

use crate::run;

use run::{Served, ok, polepair};

fn turns(url: &str) -> f64 {
    let read = ok(&["get", url, "actual position"]);
    let value = read.trim().rsplit_once("= ").and_then(|(_, value)| value.split_once(' '));
    value.and_then(|(number, _)| number.parse().ok()).unwrap_or_else(|| panic!("{read}"))
}

#[cfg(unix)]
#[test]
fn a_follower_moves_with_its_master_from_command_to_command() {
    let sim = Served::with(&["tmlcan:1,2", "--socketcand", "127.0.0.1:0"]);
    let link = sim.link();
    let [master, follower] = [1, 2].map(|axis| format!("{link}#{axis}"));
    let coupled = polepair(&["couple", &follower, "--to", &master, "--ratio", "1:2"]);
    assert_eq!(coupled.code, 0, "{}", coupled.err);
    for line in [
        "axis 2 follows axis 1: turns of their motors 1:2",
        "axis 2 is powered, and turns when axis 1 does",
        "to end it: polepair uncouple",
    ] {
        assert!(coupled.err.contains(line), "{}", coupled.err);
    }
    ok(&["move", &master, "1turn"]);
    assert!((turns(&follower) - 0.5).abs() < 0.01, "{}", turns(&follower));
    let ended = polepair(&["uncouple", &follower, "--to", "1"]);
    assert_eq!(ended.code, 0, "{}", ended.err);
    assert!(
        ended.err.contains("axis 2 is at rest and holds its position, powered"),
        "{}",
        ended.err
    );
    ok(&["move", &master, "2turn"]);
    assert!((turns(&follower) - 0.5).abs() < 0.01, "{}", turns(&follower));
    sim.end();
}

#[test]
fn a_cam_comes_from_a_file() {
    let path = std::env::temp_dir().join(format!("polepair-{}-press.csv", std::process::id()));
    std::fs::write(&path, "master [deg],follower [deg]\n0,0\n180,90\n360,0\n").unwrap();
    let file = path.to_str().unwrap();
    let drive = "sim:tmlcan:1,2?time=virtual#2";
    let coupled = polepair(&["couple", drive, "--to", "1", "--cam", file, "--inferred"]);
    assert_eq!(coupled.code, 0, "{}", coupled.err);
    assert!(coupled.err.contains("cam of 501 points, one every 4 counts"), "{}", coupled.err);
    std::fs::write(file, "0,0\n180,90\n").unwrap();
    let refused = polepair(&["couple", drive, "--to", "1", "--cam", file, "--inferred"]);
    assert_eq!(refused.code, 2, "{}", refused.err);
    assert!(refused.err.contains("press.csv: the first line"), "{}", refused.err);
    std::fs::remove_file(path).unwrap();
}

#[test]
fn what_cannot_be_coupled_is_refused() {
    for (drive, to, code, hint) in [
        ("sim:tmlcan:1,2?time=virtual#2", "2", 2, "a coupling has one follower"),
        ("sim:tmlcan:1,2,3?time=virtual", "1", 2, "a coupling has one follower"),
        ("sim:tmlcan:1,2?time=virtual#2", "sim:tmlcan:3#3", 2, "is another link than"),
        ("sim:cia402:1,2?time=virtual#2", "1", 2, "E218"),
        // Only the host begins on RS-485: the master's position never comes.
        ("sim:tml:1,2?time=virtual#2", "1", 1, "does not receive the position of axis 1"),
    ] {
        let ran = polepair(&["couple", drive, "--to", to, "--ratio", "1:3"]);
        assert_eq!(ran.code, code, "{drive}: {}", ran.err);
        assert!(ran.err.contains(hint), "{drive}: {}", ran.err);
    }
    for ratio in ["0:1", "1:0", "half"] {
        let ran =
            polepair(&["couple", "sim:tmlcan:1,2?time=virtual#2", "--to", "1", "--ratio", ratio]);
        assert_eq!(ran.code, 2, "{ratio}: {}", ran.err);
    }
}
