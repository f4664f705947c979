//! Objects, registers and parameters by number, and requests in the protocol's own text.

use crate::run::{self, Served, polepair, polepair_with};

#[test]
fn every_protocol_reads_by_number() {
    for (url, addresses) in [
        ("sim:canopen", &["0x1018:1", "2030h:1:u16", "0x6041"][..]),
        ("sim:modbus-rtu", &["0x33", "R 51", "0x1000:u32:le"]),
        ("sim:tmcl", &["AP 6", "GP 66", "IO 0.1"]),
        ("sim:tml", &["@0x03B0", "@0x0228:i32", "pm@0x4000"]),
        ("sim:thruster", &["QV"]),
    ] {
        for address in addresses {
            let read = polepair(&["get", url, address]);
            let refused = address.starts_with("2030h");
            assert_eq!(read.code, if refused { 6 } else { 0 }, "{url} {address}: {}", read.err);
        }
        let wrong = polepair(&["get", url, "no such thing"]);
        assert!(
            wrong.code == 2 && wrong.err.contains("is an example of a number"),
            "{}",
            wrong.err
        );
    }
}

#[test]
fn an_undocumented_parameter_is_written_only_with_arm() {
    let served = Served::with(&["canopen:2", "--udp", "239.74.163.31:43131"]);
    let refused = polepair(&["set", &served.url, "0x2F01:1:u32=77"]);
    assert!(refused.code == 2 && refused.err.contains("E219"), "{}", refused.err);
    let planned = run::ok(&["set", &served.url, "0x2F01:1:u32=77", "--dry-run"]);
    assert!(planned.contains("-> 77"), "{planned}");
    let written = run::ok(&["set", &served.url, "0x2F01:1:u32=0x4D", "--arm"]);
    assert_eq!(written, "2F01h:1:u32 = 77\n");
    let file = std::env::temp_dir().join(format!("polepair-{}-object.bin", std::process::id()));
    let saved = polepair(&["get", &served.url, "0x2F01:2", "-o", file.to_str().expect("text")]);
    assert!(saved.code == 0 && saved.err.contains("77 bytes saved"), "{}", saved.err);
    assert_eq!(std::fs::read(&file).expect("saved").len(), 77);
    let put = format!("0x2F01:2:bytes=@{}", file.display());
    let written = run::ok(&["set", &served.url, &put, "--arm"]);
    assert!(written.contains("77 bytes"), "{written}");
    std::fs::remove_file(&file).expect("removed");
    let missing = polepair(&["set", &served.url, &put, "--arm"]);
    assert!(missing.code == 2 && missing.err.contains("E230"), "{}", missing.err);
    let rows = run::ok(&["get", &served.url, "1008h", "0x1018:1", "--format", "jsonl"]);
    assert!(rows.contains(r#""raw":null,"value":"Polepair CiA 402 drive","unit":"""#), "{rows}");
    let watched =
        run::ok(&["watch", &served.url, "0x2F01:1:u32", "--for", "1ms", "--format", "csv"]);
    assert!(watched.contains("0x2f01:1:u32") && watched.contains(",77"), "{watched}");
    served.end();
}

#[test]
fn a_dcf_is_compared_and_applied() {
    let served = Served::with(&["canopen:2", "--udp", "239.74.163.32:43132"]);
    let folder = std::env::temp_dir().join(format!("polepair-dcf-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let dcf = folder.join("node2.dcf");
    let object = |index: &str, kind: u8, value: &str| {
        format!("[{index}]\nParameterName=o{index}\nDataType={kind}\nAccessType=rw\n{value}\n")
    };
    let entry = |index: &str, sub: u8, kind: u8, value: &str| {
        object(&format!("{index}sub{sub}"), kind, &format!("ParameterValue={value}"))
    };
    let text = [
        "[1400]\nParameterName=RPDO\nObjectType=9\nSubNumber=3\n".to_owned(),
        "[1600]\nParameterName=mapping\nObjectType=9\nSubNumber=4\n".to_owned(),
        "[DeviceComissioning]\nNodeID=2\n".to_owned(),
        object("1017", 6, "ParameterValue=250"),
        entry("1400", 1, 7, "$NODEID+0x200"),
        entry("1400", 2, 5, "1"),
        entry("1600", 0, 5, "2"),
        entry("1600", 1, 7, "0x60400010"),
        entry("1600", 2, 7, "0x60FF0020"),
        entry("1600", 3, 7, "0"),
        object("6040", 6, "ParameterValue=15"),
        object("6083", 7, "ParameterValue=0x1000"),
        object("6084", 7, "DefaultValue=5"),
    ];
    std::fs::write(&dcf, text.concat()).expect("written");
    let file = dcf.to_str().expect("text");
    let differs = polepair(&["config", "diff", &served.url, file]);
    assert_eq!(differs.code, 1, "{}", differs.err);
    assert!(differs.err.contains("6040h:u16 is skipped: it moves the motor"), "{}", differs.err);
    let shown = &differs.out;
    assert!(shown.contains("heartbeat time") && !shown.contains("6084"), "{shown}");
    assert!(shown.contains("rpdo 1 entry 2") && !shown.contains("entry 3"), "{shown}");
    let applied = polepair(&["config", "apply", &served.url, file, "--yes"]);
    assert!(applied.code == 0 && applied.err.contains("read back"), "{}", applied.err);
    assert_eq!(run::ok(&["get", &served.url, "0x1017", "--raw"]), "heartbeat time = 250\n");
    assert_eq!(polepair(&["config", "diff", &served.url, file]).code, 0);
    let mapped = ["0x1400:1:u32", "0x1400:2:u8", "0x1600:0:u8", "0x1600:2:u32"];
    let shown = run::ok(&[&["get", &served.url, "--raw", "--format", "csv"], &mapped[..]].concat());
    for value in [0x202, 1, 2, 0x60FF_0020_u32] {
        assert!(shown.contains(&format!(",{value},")), "{value} in {shown}");
    }
    // Without the node-ID the identifier would be another one.
    std::fs::write(&dcf, text.concat().replace("NodeID=2", "NodeName=x")).expect("written");
    let other = polepair(&["config", "diff", &served.url, file]);
    assert!(other.err.contains("1400h:1 is skipped: it depends on the node-ID"), "{}", other.err);
    assert!(!other.out.contains("identifier"), "{}", other.out);
    // What no table describes needs --arm.
    let more = object("2F01", 5, "ParameterValue=33");
    std::fs::write(&dcf, text.concat() + &more).expect("written");
    let refused = polepair(&["config", "apply", &served.url, file, "--yes"]);
    assert!(refused.code == 2 && refused.err.contains("E219"), "{}", refused.err);
    let sheet = folder.join("sheet.eds");
    std::fs::write(&sheet, object("1017", 6, "DefaultValue=0")).expect("written");
    let none = polepair(&["config", "diff", &served.url, sheet.to_str().expect("text")]);
    assert!(none.code == 2 && none.err.contains("no value to write"), "{}", none.err);
    served.end();
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_request_in_the_protocols_own_text_has_its_reply_explained() {
    for (url, text, reply) in [
        ("sim:tmcl", "GAP 1, 0", "actual position = 0"),
        ("sim:tmcl", "GET VERSION", "firmware version 171V1.14"),
        ("sim:tml", "?APOS", "APOS = 0"),
        ("sim:modbus-rtu", "read Fn_33", "internal speed = 0 rpm"),
        ("sim:canopen", "read 0x6041", "statusword"),
        ("sim:thruster", "QV", "QV"),
    ] {
        let shown = run::ok(&["send", url, text]);
        assert!(shown.contains(reply), "{url} {text}: {shown}");
    }
    let text = "time 2026-11-21T16:00:00";
    let nobody = run::ok(&["send", "sim:canopen", text]);
    assert_eq!(nobody, format!("{text}: sent; no reply\n"));
    let json = run::ok(&["send", "sim:tmcl", "GAP 6, 0", "--format", "jsonl"]);
    assert!(json.contains(r#""request":"GAP 6, 0","value":"#), "{json}");
}

#[test]
fn a_request_that_may_start_a_motor_is_sent_only_with_arm() {
    for (url, text) in [
        ("sim:tmcl", "ROR 0, 100"),
        ("sim:tml", "UPD"),
        ("sim:modbus-rtu", "write 0x33 5"),
        ("sim:canopen", "write 0x6040:0 u16 15"),
        ("sim:thruster", "TC 5"),
    ] {
        // The first text is not sent either.
        let trace = std::env::temp_dir().join(format!("polepair-{}-send.log", std::process::id()));
        let path = trace.to_str().expect("text");
        let refused = polepair(&["send", url, text, "--trace", path]);
        assert!(refused.code == 2 && refused.err.contains("E219"), "{url}: {}", refused.err);
        let shown = polepair(&["send", url, text, "--dry-run"]);
        assert!(shown.code == 0 && shown.err.contains("none of this was sent"), "{}", shown.err);
        assert!(!shown.out.is_empty());
        std::fs::remove_file(&trace).expect("removed");
    }
    let started = polepair(&["send", "sim:tmcl", "ROR 0, 100", "--arm"]);
    assert!(started.code == 0 && started.err.contains("polepair stop sim:tmcl"), "{}", started.err);
    let stopped = polepair(&["send", "sim:tmcl", "MST 0"]);
    assert!(stopped.code == 0 && stopped.err.is_empty(), "{}", stopped.err);
}

#[test]
fn a_text_that_is_none_is_reported_with_its_place() {
    for (url, text, part) in [
        ("sim:tmcl", "GAP x", "at `x`"),
        ("sim:canopen", "write 0x6040:0 u8 256", "at `256`"),
        ("sim:canopen", "nmt start all", "not a request from a host to one drive"),
        ("sim:canopen", "upload 0x1008:0", "ADDRESS:bytes"),
        ("sim:modbus-rtu", "read nothing", "at `nothing`"),
    ] {
        let refused = polepair(&["send", url, text]);
        assert!(refused.code == 2 && refused.err.contains(part), "{url} {text}: {}", refused.err);
    }
}

#[test]
fn modbus_ascii_goes_over_seven_bits_and_is_read_as_characters() {
    let path = std::env::temp_dir().join(format!("polepair-{}-ascii", std::process::id()));
    let pty = path.to_str().expect("text");
    let served = Served::with(&["modbus-ascii:1", "--pty", pty]);
    let port = format!("modbus-ascii+serial://{pty}?bits=7&parity=even#1");
    assert_eq!(run::ok(&["get", &port, "R 51"]), "internal speed = 0 rpm\n");
    let refused = polepair(&["get", &format!("modbus-rtu+serial://{pty}?bits=7#1"), "R 51"]);
    assert!(refused.code == 2 && refused.err.contains("all eight bits"), "{}", refused.err);
    served.end();
    let shown = run::ok(&["explain", "modbus-ascii", ":010300330002C7"]);
    assert!(shown.contains("read register 0x0033, 2 registers"), "{shown}");
    let decoded = polepair_with(&["decode", "-"], "(1.0) tty > :010300330002C7\n");
    assert!(decoded.out.contains("modbus-ascii"), "{}", decoded.out);
}

#[test]
fn a_capture_is_filtered_by_address() {
    let canopen = "(1.000) can0 603#4041600000000000\n(1.001) can0 583#4B41600018020000\n\
                   (1.002) can0 603#4030200100000000\n(1.003) can0 583#4B30200105000000\n";
    let count = |capture: &str, protocol: &str, filter: &str| {
        let words = ["decode", "-", "--as", protocol, "--filter", filter, "--format", "jsonl"];
        let ran = polepair_with(&words, capture);
        assert_eq!(ran.code, 0, "{filter}: {}", ran.err);
        ran.out.lines().count()
    };
    assert_eq!(count(canopen, "canopen", "object 0x6041"), 2);
    assert_eq!(count(canopen, "canopen", "object 2030h:1"), 2);
    assert_eq!(count(canopen, "canopen", "object 2030h:1 = 5"), 1);
    assert_eq!(count(canopen, "canopen", "object 2030h:2"), 0);
    // Registers 33h and 34h are asked for, and answered.
    let modbus = "(1.000) tty > 01 03 00 33 00 02 34 04\n\
                  (1.010) tty < 01 03 04 00 C8 00 05 BB CE\n";
    assert_eq!(count(modbus, "modbus-rtu", "object \"R 52\""), 2);
    assert_eq!(count(modbus, "modbus-rtu", "object 0x34 = 5"), 1);
    assert_eq!(count(modbus, "modbus-rtu", "object 0x35"), 0);
    let tmcl = "(1.000) tty > 01 06 04 00 00 00 00 00 0B\n\
                (1.010) tty < 02 01 64 06 00 00 07 D0 44\n";
    assert_eq!(count(tmcl, "tmcl", "object \"AP 4\""), 2);
    assert_eq!(count(tmcl, "tmcl", "object \"AP 4\" = 2000"), 1);
    assert_eq!(count(tmcl, "tmcl", "object \"AP 4.1\""), 0);
    let wrong = polepair_with(&["decode", "-", "--filter", "object foo"], canopen);
    assert!(wrong.code == 2 && wrong.err.contains("expected an address"), "{}", wrong.err);
}

#[test]
fn captures_show_floating_point_numbers() {
    let folder = std::env::temp_dir().join(format!("polepair-reals-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let signals = |name: &str, profile: &str, capture: &str| {
        let file = folder.join(name);
        std::fs::write(&file, profile).expect("written");
        let file = file.to_str().expect("text").to_owned();
        let words = ["decode", "-", "--profile", &*file, "--format", "jsonl"];
        let ran = polepair_with(&words, capture);
        assert_eq!(ran.code, 0, "{}", ran.err);
        ran.out
    };
    let sheet = "[1000]\nParameterName=Device type\nDataType=7\nAccessType=ro\n\
                 [2010]\nParameterName=Gain\nDataType=8\nAccessType=rw\n";
    let canopen = "(1.0) can0 605#4010200000000000\n(1.1) can0 585#43102000000020C0\n";
    let shown = signals("gain.eds", sheet, canopen);
    assert!(shown.contains("Gain = -2.5") && shown.contains(r#""value":-2.5"#), "{shown}");
    let registers = "name = \"reals\"\nprotocol = \"modbus\"\n[[parameter]]\nname = \"gain\"\n\
                     index = 0x20\nencoding = \"f32\"\n";
    let modbus =
        "(1.000) tty > 01 03 00 20 00 02 C5 C1\n(1.010) tty < 01 03 04 C0 20 00 00 C7 F9\n";
    let shown = signals("reals.toml", registers, modbus);
    assert!(shown.contains("gain = -2.5e0") && shown.contains(r#""value":-2.5"#), "{shown}");
    std::fs::remove_dir_all(folder).expect("removed");
}

#[test]
fn a_device_loses_and_gets_its_node_id() {
    let served = Served::with(&["canopen:5,7", "--udp", "239.74.163.33:43133"]);
    let bus = served.url.split('#').next().expect("a link");
    let node = format!("{bus}#5");
    let occupied = polepair(&["lss", &node, "--node", "7"]);
    assert!(occupied.code == 2 && occupied.err.contains("E222"), "{}", occupied.err);
    let several = polepair(&["lss", bus, "--only-device"]);
    assert!(several.code == 2 && several.err.contains("several devices"), "{}", several.err);
    let shown = run::ok(&["lss", &node, "--format", "csv"]);
    assert_eq!(shown, "node,vendor,product,revision,serial\n5,0xFFFF,0x402,0x10000,0x5\n");
    let taken = polepair(&["lss", &node, "--node", "none", "--store"]);
    assert!(taken.err.contains("nmt reset-communication"), "{}", taken.err);
    run::ok(&["send", &node, "nmt reset-communication"]);
    let identity = ["--identity", "65535,0x402,0x10000,5"];
    let shown = run::ok(&["lss", bus, identity[0], identity[1], "--format", "jsonl"]);
    assert!(shown.starts_with(r#"{"node":"none","vendor":65535,"#), "{shown}");
    let given = polepair(&["lss", bus, identity[0], identity[1], "--node", "9"]);
    assert!(given.code == 0 && given.err.contains("node 9 answers"), "{}", given.err);
    assert!(run::ok(&["get", &format!("{bus}#9"), "serial number"]).contains('5'));
    served.end();
    let other = polepair(&["lss", "tmcl+tcp://127.0.0.1:9", "--node", "9"]);
    assert!(other.code == 2 && other.err.contains("E242"), "{}", other.err);
}

#[test]
fn a_node_of_two_axes_is_simulated_and_stopped() {
    let folder = std::env::temp_dir().join(format!("polepair-axes-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let sheet = folder.join("two.eds");
    let object = |(index, kind, access, value): (u32, u8, &str, &str)| {
        let head = format!("[{index:04X}]\nParameterName=o{index:04X}\nObjectType=7\n");
        format!("{head}DataType={kind}\nAccessType={access}\n{value}\nPDOMapping=1\n")
    };
    let axis = |base: u32| {
        let turn = |sub: u8, value: u32| {
            let head =
                format!("[{:04X}sub{sub}]\nParameterName=s{sub}\nObjectType=7\n", base + 0x8F);
            format!("{head}DataType=7\nAccessType=rw\nDefaultValue={value}\n")
        };
        let objects = [
            (0x40, 6, "rw", ""),
            (0x41, 6, "ro", ""),
            (0x60, 2, "rw", ""),
            (0x61, 2, "ro", ""),
            (0x64, 4, "ro", ""),
            (0x6C, 4, "ro", ""),
            (0x7A, 4, "rw", ""),
            (0x81, 7, "rw", "DefaultValue=100000"),
            (0x83, 7, "rw", "DefaultValue=1000000"),
            (0x84, 7, "rw", "DefaultValue=1000000"),
            (0xFF, 4, "rw", ""),
        ];
        let objects =
            objects.map(|(at, kind, access, value)| object((base + at, kind, access, value)));
        let record =
            format!("[{:04X}]\nParameterName=turn\nObjectType=9\nSubNumber=3\n", base + 0x8F);
        objects.concat() + &record + &turn(1, 10_000) + &turn(2, 1)
    };
    let text = object((0x1000, 7, "ro", "DefaultValue=0x20192")) + &axis(0x6000) + &axis(0x6800);
    std::fs::write(&sheet, text).expect("written");
    let sheet = sheet.to_str().expect("text");
    let served = Served::with(&["canopen:2", "--eds", sheet, "--udp", "239.74.163.34:43134"]);
    let second = format!("{}.2", served.url);
    let moved = polepair(&["move", &second, "1turn"]);
    assert!(moved.code == 0 && moved.out.starts_with("position = "), "{}{}", moved.out, moved.err);
    let both = format!("{},2.2", served.url);
    let shown = run::ok(&["get", &both, "position actual", "--raw"]);
    let within = |line: &str| line.rsplit(' ').next().and_then(|word| word.parse::<i32>().ok());
    let [first, second_position] = shown.lines().map(within).collect::<Vec<_>>()[..] else {
        panic!("{shown}")
    };
    assert!(
        first == Some(0) && second_position.is_some_and(|at| (at - 10_000).abs() < 20),
        "{shown}"
    );
    for url in [&served.url, &second] {
        run::ok(&["spin", url, "20rpm", "--detach"]);
    }
    let stopped = polepair(&["stop", &served.url]);
    assert!(stopped.code == 0, "{}{}", stopped.out, stopped.err);
    let told = format!("{}{}", stopped.out, stopped.err);
    assert!(told.contains("axis 2 is stopped") && told.contains("axis 2.2 is stopped"), "{told}");
    let speeds = run::ok(&["get", &both, "velocity actual", "--raw"]);
    assert!(speeds.lines().all(|line| within(line).is_some_and(|v| v.abs() < 100)), "{speeds}");
    served.end();
    std::fs::remove_dir_all(folder).expect("removed");
}

/// Manuals number registers from 1, behind a digit for the table.
#[test]
fn numbers_of_the_data_model_are_explained() {
    for (number, here) in [
        ("40001", "`R 0`"),
        ("30051", "`IR 50`"),
        ("10003", "`DI 2`"),
        ("00010", "`C 9`"),
        ("400100", "`R 99`"),
    ] {
        let wrong = polepair(&["get", "sim:modbus-rtu", number]);
        assert!(wrong.code == 2 && wrong.err.contains(here), "{number}: {}", wrong.err);
    }
    let named = polepair(&["get", "sim:canopen", "40001"]);
    assert!(!named.err.contains("manual"), "{}", named.err);
}

#[test]
fn a_number_that_no_float_holds_is_refused() {
    for (value, code) in [("1e39", 2), ("1e-50", 2), ("-1e39", 2), ("3.5", 0), ("1e-40", 0)] {
        let write = format!("0x40:f32={value}");
        let ran = polepair(&["set", "sim:modbus-rtu", &write, "--arm"]);
        assert_eq!(ran.code, code, "{value}: {}", ran.err);
        assert_eq!(code == 2, ran.err.contains("does not fit into a 32-bit float"), "{}", ran.err);
    }
}
