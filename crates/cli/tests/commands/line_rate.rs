//! Drives whose baud rate is another than that of the connection string, on pseudo-terminals.
#![cfg(unix)]

use crate::run;

use run::{Served, ok, polepair};

/// The served drive's string with a rate.
fn at_rate(sim: &Served, rate: u32) -> String {
    sim.url.replace('#', &format!(":{rate}#"))
}

#[test]
fn a_rate_that_is_set_is_followed_and_named() {
    let sim = Served::new("tml");
    let ran = polepair(&["send", &sim.url, "SCIBR 3"]);
    assert_eq!(ran.code, 2, "{}", ran.err);
    let first = ran.err.lines().next().unwrap_or_default();
    let changes = "`SCIBR 3` changes the line's rate to 57600 baud.";
    assert!(first.ends_with(changes), "{}", ran.err);
    let ran = polepair(&["send", &sim.url, "SCIBR 3", "?KPP", "--arm"]);
    assert_eq!((ran.code, ran.out.contains("KPP = 288")), (0, true), "{}{}", ran.out, ran.err);
    let note = format!("the line is at 57600 baud now: use {}\n", at_rate(&sim, 57_600));
    assert_eq!(ran.err, note, "no motion is announced");
    assert_eq!(ok(&["get", &at_rate(&sim, 57_600), "KPP"]), "position gain = 288\n");
    // The port of a client stays as its string has it.
    run::expect_silence();
    let ran = polepair(&["get", &sim.url, "KPP"]);
    assert_eq!(ran.code, 4, "{}{}", ran.out, ran.err);
    let reset = polepair(&["send", &at_rate(&sim, 57_600), "RESET", "--arm"]);
    assert_eq!(reset.code, 0, "{}", reset.err);
    assert_eq!(ok(&["get", &sim.url, "KPP"]), "position gain = 288\n", "as after every reset");
    sim.end();
}

#[test]
fn a_stop_reaches_a_drive_at_another_rate() {
    for named in [true, false] {
        let sim = Served::new("tml");
        ok(&["send", &sim.url, "SCIBR 1", "--arm"]);
        ok(&["spin", &at_rate(&sim, 19_200), "300rpm", "--detach"]);
        run::expect_silence();
        let url = if named { sim.url.clone() } else { sim.link().to_owned() };
        let ran = polepair(&["stop", &url]);
        assert_eq!(ran.code, 0, "{}", ran.err);
        let lines: Vec<&str> = ran.err.lines().collect();
        assert!(lines.contains(&"no reply: trying the other baud rates"), "{}", ran.err);
        assert!(lines.contains(&"axis 1 is stopped"), "{}", ran.err);
        let hint = if named { at_rate(&sim, 19_200) } else { format!("{url}:19200") };
        let rate = format!("the drive is at 19200 baud: use {hint}");
        assert!(lines.contains(&&*rate), "{rate}: {}", ran.err);
        assert!(!ran.err.contains("may still turn"), "{}", ran.err);
        let speed = ok(&["get", &at_rate(&sim, 19_200), "actual speed"]);
        assert!(speed.ends_with("= 0 rpm\n"), "{speed}");
        sim.end();
    }
}

#[test]
fn rates_that_the_drives_of_a_protocol_cannot_have_are_refused() {
    let rejected = [
        ("tml+serial:///dev/ttyUSB0:4800#1", "tml drives cannot be at 4800 baud"),
        ("tmlcan+slcan:///dev/ttyUSB0?bitrate=100000#1", "tmlcan drives cannot be at 100000 bit/s"),
        ("technocan+socketcan://can0?bitrate=20000#1", "technocan drives cannot be at 20000 bit/s"),
    ];
    for (url, what) in rejected {
        let ran = polepair(&["get", url, "KPP"]);
        assert_eq!((ran.code, ran.err.contains(what)), (2, true), "{url}: {}", ran.err);
    }
    // The manual's misprint is the rate that ports have.
    let sim = Served::new("tml");
    ok(&["send", &sim.url, "SCIBR 3", "--arm"]);
    assert_eq!(ok(&["get", &at_rate(&sim, 56_600), "KPP"]), "position gain = 288\n");
    sim.end();
}
