//! Inputs that users sent, and what is right for each.

use crate::run::{self, Served, polepair, polepair_with};

use std::path::PathBuf;

#[test]
fn the_size_of_an_expedited_transfer_counts() {
    for frame in ["583#4B41600018028FAF", "583#4B4160001802FFFF"] {
        let shown = run::ok(&["explain", "canopen", frame]);
        assert!(shown.contains("statusword = 536"), "{shown}");
        assert!(shown.contains("unused bytes are not zero"), "{shown}");
        let capture = format!("(1.000) can0 603#4041600000000000\n(1.001) can0 {frame}\n");
        let lines = polepair_with(&["decode", "-", "--format", "jsonl"], &capture).out;
        assert!(lines.contains("536") && !lines.contains("2945384984"), "{lines}");
    }
}

#[test]
fn a_position_beyond_the_greatest_is_refused() {
    for line in ["MVP ABS, 0, 3000000000", "MVP REL, 0, 2147483648", "ROR 0, 4294967295"] {
        let refused = polepair(&["encode", "tmcl", line]);
        assert_eq!((refused.code, &*refused.out), (2, ""), "{line}: {}", refused.err);
        assert!(refused.err.contains("2147483647"), "{}", refused.err);
    }
    run::ok(&["encode", "tmcl", "MVP ABS, 0, 2147483647"]);
}

#[test]
fn a_reply_after_an_abort_is_late_and_belongs_to_no_other_request() {
    let frames = ["602#4000100000000000", "602#8000100000000405", "702#00", "582#4300100092010200"];
    let without_times = frames.join("\n") + "\n";
    let mut with_times = String::new();
    for (frame, ms) in frames.iter().zip([0, 1000, 1400, 1500]) {
        with_times += &format!("({}.{:03}) can0 {frame}\n", 1 + ms / 1000, ms % 1000);
    }
    for (capture, says) in
        [(without_times, "after its request was given up"), (with_times, " ms after")]
    {
        let shown = polepair_with(&["decode", "-"], &capture).out;
        assert!(shown.contains("late-reply") && shown.contains(says), "{shown}");
        assert!(!shown.contains("duplicate-address"), "{shown}");
    }
}

#[test]
fn a_sheet_of_one_node_gives_others_their_own_identifiers() {
    let sheet = "[DeviceInfo]\nProductName=Small\n[MandatoryObjects]\nSupportedObjects=2\n1=0x1000\n2=0x1014\n\
                 [1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0\n\
                 [1014]\nParameterName=Emergency\nObjectType=7\nDataType=7\nAccessType=rw\n\
                 DefaultValue=$NODEID+0x80\nParameterValue=0xA0\n";
    let file: PathBuf =
        std::env::temp_dir().join(format!("polepair-{}-e35.eds", std::process::id()));
    std::fs::write(&file, sheet).expect("a file");
    let path = file.display().to_string();
    let served = Served::with(&["canopen:5", "--eds", &path, "--socketcand", "127.0.0.1:0"]);
    let url = format!("{}?eds={path}#5", served.link());
    let shown = run::ok(&["get", &url, "1014h", "--raw"]);
    assert!(shown.trim().ends_with("= 133"), "{shown}");
    served.end();
    let _ = std::fs::remove_file(file);
}

#[test]
fn a_count_of_zero_moves_by_the_drives_own_numbers_alone() {
    let served = Served::with(&["tml:1", "--tcp", "127.0.0.1:0"]);
    run::ok(&["set", &served.url, "ENCRESLONG=0"]);
    let shown = run::ok(&["get", &served.url, "APOS"]);
    assert!(!shown.contains("NaN") && !shown.contains("turn"), "{shown}");
    let refused = polepair(&["move", &served.url, "1turn"]);
    assert!(refused.code != 0 && refused.err.contains("E222"), "{}", refused.err);
    assert_eq!(run::ok(&["get", &served.url, "APOS"]).trim(), "actual position = 0");
    run::ok(&["move", &served.url, "1500", "--vel", "2000000", "--acc", "20000", "--raw"]);
    let shown = run::ok(&["get", &served.url, "APOS"]);
    let position: i64 = shown.trim().rsplit(' ').next().and_then(|n| n.parse().ok()).expect(&shown);
    assert!((position - 1500).abs() <= 3, "{shown}");
    served.end();
}

#[test]
fn common_parameters_of_a_protocol_are_listed_as_the_hint_says() {
    for (word, shown) in
        [("canopen", "1018h:1"), ("tmcl", "AP 1"), ("tml", "APOS"), ("tmcl+can", "AP 1")]
    {
        let listed = run::ok(&["params", word]);
        assert!(listed.contains(shown), "{listed}");
    }
    let none = polepair(&["params", "modbus-rtu"]);
    assert!(none.code == 0 && none.err.contains("no parameter is common"), "{}", none.err);
    assert!(run::ok(&["params", "canopen", "1018h:2"]).contains("product code"));
}

/// D3: a module of another address that answers, and one that replies to another host, are named.
#[test]
fn the_axis_that_replies_for_another_is_named() {
    for (reply_from, reply_to, text, hint) in [
        (3, 2, "address 3 answers here", "use `#3`"),
        (1, 3, "it replies to host 3", "open it with `?host=3`"),
    ] {
        let url = format!("tmcl+tcp://{}#1", answering_module(reply_from, reply_to));
        let ran = polepair(&["get", &url, "max current"]);
        assert_eq!(ran.code, 4, "{}", ran.err);
        assert!(ran.err.contains(text) && ran.err.contains(hint), "{}", ran.err);
        let (link, _) = url.split_once('#').expect("an axis");
        let ran = polepair(&["scan", link, "--ids", "1"]);
        assert!(ran.err.contains(hint) && !ran.err.contains("A and B"), "{}", ran.err);
    }
}

/// D3: the drive at the cable acknowledges requests to others.
#[test]
fn an_acknowledging_drive_of_another_axis_id_is_distinguished_from_silence() {
    let drive = Served::new("tml:200");
    let link = drive.link();
    let ran = polepair(&["scan", link, "--ids", "1"]);
    assert_eq!(ran.code, 4, "{}", ran.err);
    assert!(ran.err.contains("a drive acknowledges: its axis ID is none of these"), "{}", ran.err);
    assert!(!ran.err.contains("A and B"), "{}", ran.err);
    let ran = polepair(&["get", &format!("{link}#1"), "APOS"]);
    assert!(ran.err.contains("its axis ID may be another"), "{}", ran.err);
    drive.end();
}

/// A TMCL module on TCP that replies to requests for any address, from one address and to one host. It ends
/// with the test.
fn answering_module(reply_from: u8, reply_to: u8) -> std::net::SocketAddr {
    use std::io::{Read as _, Write as _};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let serve = move |mut stream: std::net::TcpStream| {
        let mut request = [0; 9];
        while stream.read_exact(&mut request).is_ok() {
            let mut reply = [reply_to, reply_from, 100, request[1], 0, 0, 0, 7, 0];
            reply[8] = reply[..8].iter().fold(0, |sum, byte| sum.wrapping_add(*byte));
            if stream.write_all(&reply).is_err() {
                return;
            }
        }
    };
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            std::thread::spawn(move || serve(stream));
        }
    });
    address
}

#[test]
fn a_statusword_is_shown_in_words() {
    let shown = run::ok(&["get", "sim:cia402?time=virtual", "statusword", "6041h"]);
    let word = "statusword = 0x0250 (switch on disabled, voltage enabled, remote)\n";
    assert_eq!(shown, word.repeat(2));
    let listed = run::ok(&["params", "cia402", "statusword"]);
    assert!(listed.contains("bit 10") && listed.contains("target reached"), "{listed}");
}

#[test]
fn signals_are_read_by_their_names() {
    for url in ["sim:cia402", "sim:tmcm-1140", "sim:tml", "sim:syntron-ts"] {
        let shown = run::ok(&["get", &format!("{url}?time=virtual"), "position", "velocity"]);
        assert_eq!(shown.lines().count(), 2, "{shown}");
        assert!(shown.contains(" = 0 "), "{shown}");
    }
    // A write means a parameter.
    let refused = polepair(&["set", "sim:cia402?time=virtual", "position=0"]);
    assert!(refused.code == 2 && refused.err.contains("error[E213]"), "{}", refused.err);
}
