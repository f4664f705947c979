//! Every golden vector through `polepair decode -` and back through `polepair encode`.

use crate::run;

use std::collections::BTreeMap;

use run::{command, hex, polepair, polepair_with, ran, text, vectors};
use serde_json::Value;

/// Decodes a capture, and groups the frames by link.
fn decode(capture: &str, arguments: &[&str]) -> BTreeMap<String, Vec<Value>> {
    let arguments = [&["decode", "-", "--format", "jsonl"], arguments].concat();
    let ran = polepair_with(&arguments, capture);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let mut links: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    for line in ran.out.lines() {
        let frame: Value = serde_json::from_str(line).expect("one object a line");
        links.entry(text(&frame, "link").to_owned()).or_default().push(frame);
    }
    links
}

/// A capture's line for a vector, on a link of its own.
fn line(vector: &Value) -> String {
    let (name, bytes) = (text(vector, "name"), text(vector, "bytes"));
    if let Some(id) = vector["can_id"].as_u64() {
        return format!("(1.0) {name} {id:03X}#{}\n", hex(vector));
    }
    let arrow = if text(vector, "direction").starts_with("host") { '>' } else { '<' };
    format!("(1.0) {name} {arrow} {bytes}\n")
}

fn ok(frame: &Value) -> bool {
    frame["ok"].as_bool().expect("ok is a flag")
}

#[test]
fn every_tmcl_vector_decodes() {
    let vectors = vectors("tmcl");
    let capture: String = vectors.iter().map(line).collect();
    let links = decode(&capture, &["--as", "tmcl"]);
    for vector in &vectors {
        let (name, transport) = (text(vector, "name"), text(vector, "transport"));
        let frames = &links[name];
        let bytes: String = frames.iter().map(|frame| text(frame, "bytes")).collect();
        assert_eq!(bytes, hex(vector), "{name}");
        let count = if transport == "serial-stream" { 2 } else { 1 };
        assert_eq!(frames.len(), count, "{name}: {frames:?}");
        assert_eq!(frames[0]["protocol"], "tmcl", "{name}");
        let whole = vector["valid"] == true && transport != "serial8-without-checksum";
        assert_eq!(ok(&frames[0]), whole, "{name}: {frames:?}");
        if let Some(fields) = vector["fields"].as_object() {
            for (field, value) in fields {
                assert_eq!(&frames[0]["fields"][field], value, "{name}: {field}");
            }
        }
    }
}

#[test]
fn every_modbus_vector_decodes() {
    for protocol in ["modbus-rtu", "modbus-ascii"] {
        let vectors = vectors("modbus");
        let vectors: Vec<&Value> = vectors.iter().filter(|v| text(v, "kind") == protocol).collect();
        let capture: String = vectors.iter().map(|vector| line(vector)).collect();
        let links = decode(&capture, &["--as", protocol]);
        for vector in vectors {
            let name = text(vector, "name");
            let frames = &links[name];
            let bytes: String = frames.iter().map(|frame| text(frame, "bytes")).collect();
            assert_eq!(bytes, hex(vector), "{name}");
            // The colon that restarts a frame leaves a piece before it.
            assert_eq!(frames.len(), if name == "o_ascii_restart" { 2 } else { 1 }, "{name}");
            let last = frames.last().expect("a frame");
            assert_eq!(ok(last), text(vector, "verdict") != "reject", "{name}: {last}");
            let request = text(vector, "direction").starts_with("host");
            if !ok(last) || !request || name.starts_with("c_") {
                continue;
            }
            let axis = last["axis"].to_string();
            // Words for people that are not part of the language.
            let words = text(last, "text").replace(" registers", "").replace(" bits", "");
            let words = if words.contains(", register ") {
                words.replace(", register 0x0031 =", ",").replace("write register", "write")
            } else {
                words
            };
            let ran = polepair(&["encode", protocol, &words, "--axis", &axis]);
            let lower = hex(vector).replace("6562", "4542");
            let again = ran.out.trim().replace(' ', "");
            assert!(lower.ends_with(&again) && !again.is_empty(), "{name}: {ran:?}");
        }
    }
}

#[test]
fn breakage_is_named() {
    let capture = "(1.0) a > 01 01 00 00 00 00 01 5E 60\n(1.0) b > 01 01 00 02 00 00 01 5E\n";
    let links = decode(capture, &["--as", "tmcl"]);
    assert_eq!(links["a"][0]["error"], "checksum: computed 61, found 60");
    assert_eq!(links["b"][0]["error"], "length: needed 9 bytes, found 8: 1 missing");
}

#[test]
fn frames_split_over_lines_and_glued_are_found() {
    let capture = "\
(1.000000) x > 01 06 01
(1.000400) x > 00 00 00 00 00 08
(1.001000) x < 02 01 64 06 00 00 02 C7 36 02 01 64 03 00
(1.001300) x < 00 00 00 6A
";
    let frames = &decode(capture, &["--as", "tmcl"])["x"];
    let found: Vec<&str> = frames.iter().map(|frame| text(frame, "bytes")).collect();
    let expected = ["010601000000000008", "0201640600 0002C736", "02016403000000006A"];
    assert_eq!(found, expected.map(|bytes| bytes.replace(' ', "")));
    assert!(frames.iter().all(ok), "{frames:?}");
    assert_eq!(frames[0]["time"].to_string(), "1.0");
}

#[test]
fn an_echo_is_distinguished_from_a_reply() {
    let capture = "\
(1.0) x > 01 06 01 00 00 00 00 00 08
(1.1) x < 01 06 01 00 00 00 00 00 08 02 01 64 06 00 00 02 C7 36
";
    let frames = &decode(capture, &["--as", "tmcl"])["x"];
    assert!(text(&frames[1], "text").starts_with("echo: "), "{frames:?}");
    assert_eq!(frames[1]["kind"], "GAP");
    assert_eq!(frames[2]["fields"]["value"], 711);
}

#[test]
fn without_a_word_the_capture_is_judged() {
    let capture = "(1.0) x > 01 06 01 00 00 00 00 00 08\n(1.1) x < 02 01 64 06 00 00 02 C7 36\n";
    let ran = polepair_with(&["decode", "-", "--format", "jsonl"], capture);
    assert_eq!(ran.out.matches(r#""protocol":"tmcl""#).count(), 2, "{}", ran.out);
    assert!(
        ran.err.starts_with("x: tmcl, ") && ran.err.contains("% sure (2 frames"),
        "{}",
        ran.err
    );
}

#[test]
fn the_order_of_the_fields_is_fixed() {
    let capture = "(1700000000.000500) ttyUSB0 > 01 01 00 00 00 00 01 5E 61\n";
    let ran = polepair_with(&["decode", "-", "--format", "jsonl", "--as", "tmcl"], capture);
    let expected = concat!(
        r#"{"time":1700000000.0005,"link":"ttyUSB0","direction":"tx","protocol":"tmcl","#,
        r#""bytes":"010100000000015E61","id":null,"extended":null,"kind":"ROR","axis":1,"#,
        r#""fields":{"address":1,"opcode":1,"type":0,"motor":0,"value":350,"checksum":97},"text":"#,
    );
    assert!(ran.out.starts_with(expected), "{}", ran.out);
    let rest = ",\"ok\":true,\"error\":null,\"number\":1,\"notices\":[{\"notice\":\"signal\"";
    assert!(ran.out.contains(rest) && ran.out.ends_with("]}\n"), "{}", ran.out);
}

#[test]
fn a_live_capture_is_explained_line_by_line() {
    use std::io::{BufRead as _, BufReader, Write as _};
    let mut command = run::command(&["decode", "-", "--as", "tmcl"]);
    let mut child = command.stdin(std::process::Stdio::piped()).spawn().expect("starts");
    let mut stdin = child.stdin.take().expect("a pipe");
    let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    for _ in 0..3 {
        stdin.write_all(b"(1.0) x > 01 03 00 00 00 00 00 00 04\n").expect("written");
        // The next line is not written before this one is explained.
        // Missing replies are reported on lines of their own.
        let mut frames = lines.by_ref().map(|line| line.expect("text"));
        let line = frames.find(|line| !line.contains("! "));
        assert!(line.is_some_and(|line| line.contains("MST 0")));
    }
    drop(stdin);
    assert!(child.wait().expect("ends").success());
}

#[test]
fn encode_understands_the_texts_of_decode() {
    let vectors = vectors("tmcl");
    let requests = vectors.iter().filter(|vector| {
        let serial = text(vector, "transport") == "serial9";
        serial && text(vector, "direction").starts_with("host") && vector["valid"] == true
    });
    let mut tried = 0;
    let requests: Vec<&Value> = requests.collect();
    let capture: String = requests.iter().map(|vector| line(vector)).collect();
    let links = decode(&capture, &["--as", "tmcl"]);
    for vector in requests {
        let frame = &links[text(vector, "name")][0];
        let output = text(frame, "text").split(':').next().unwrap_or("");
        let axis = frame["axis"].to_string();
        let ran = polepair(&["encode", "tmcl", output, "--axis", &axis]);
        assert_eq!(ran.out.trim().replace(' ', ""), hex(vector), "{output}: {}", ran.err);
        tried += 1;
    }
    assert!(tried > 10, "only {tried} requests");
}

#[test]
fn the_examples_of_the_help_are_true() {
    assert_eq!(
        polepair(&["encode", "tmcl", "ROR 0, 350", "--axis", "1"]).out,
        "01 01 00 00 00 00 01 5E 61\n"
    );
    assert_eq!(
        polepair(&["encode", "tmcl", "GAP 1, 0", "--via", "can"]).out,
        "001#06010000000000\n"
    );
    let json = polepair(&["encode", "tmcl", "GAP 1, 0", "--format", "json"]).out;
    let json: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(
        (&json["answer"]["bytes"], &json["fields"]["type"]),
        (&Value::from(9), &Value::from(1))
    );
}

/// The text that `decode` prints for a request is accepted by `encode`.
#[test]
fn every_request_encodes_from_its_text() {
    for (name, protocols) in [("modbus", &["modbus-rtu", "modbus-ascii"][..]), ("tmcl", &["tmcl"])]
    {
        let mut tried = 0;
        for vector in vectors(name) {
            let kind = text(&vector, "kind");
            let to_drive = text(&vector, "direction").starts_with("host->");
            let protocol = *protocols.iter().find(|p| **p == kind).unwrap_or(&protocols[0]);
            if !to_drive || !vector["can_id"].is_null() {
                continue;
            }
            let links = decode(&line(&vector), &["--as", protocol]);
            for frame in links.values().flatten().filter(|frame| ok(frame)) {
                let (output, axis) = (text(frame, "text"), frame["axis"].to_string());
                let ran = polepair(&["encode", protocol, output, "--axis", &axis]);
                let back = ran.out.trim().replace(' ', "");
                // Modbus ASCII may come in small letters; we write capitals.
                if !text(&vector, "name").ends_with("ascii_lower") {
                    assert_eq!(back, text(frame, "bytes"), "{output}: {}", ran.err);
                }
                tried += 1;
            }
        }
        assert!(tried >= 15, "{name}: {tried}");
    }
}

/// A bus of process data of two megabytes, with lines that are none.
fn bus() -> String {
    let mut log = String::new();
    for n in 0..40_000_u64 {
        let (us, data) = (n * 250, n.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let frame = match n % 1000 {
            500 => "no frame".to_owned(),
            501 => "601#4041600000000000".to_owned(),
            502 => "581#4B41600037160000".to_owned(),
            _ => format!("18{}#{data:016X}", 1 + n % 4),
        };
        log +=
            &format!("({}.{:06}) can0 {frame}\n", 1_700_000_000 + us / 1_000_000, us % 1_000_000);
    }
    log
}

/// One core or several, a file or a pipe: the same bytes.
#[test]
fn any_number_of_threads_decodes_the_same() {
    let folder = std::env::temp_dir().join(format!("polepair-jobs-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let (capture, log) = (folder.join("bus.log").display().to_string(), bus());
    std::fs::write(&capture, &log).expect("a capture");
    for format in ["text", "jsonl"] {
        let arguments = ["--as", "canopen", "--format", format];
        let mut piped = command(&[&["decode", "-"], &arguments[..]].concat());
        let piped = piped.stdin(std::fs::File::open(&capture).expect("the capture"));
        let piped = ran(piped.output().expect("the binary ends"));
        assert!(piped.code == 0 && piped.out.len() > log.len(), "{}", piped.err);
        for jobs in ["1", "2", "5"] {
            let ran = polepair(&[&["decode", &capture, "--jobs", jobs], &arguments[..]].concat());
            assert!(ran.out == piped.out, "{format}, {jobs} threads");
            assert_eq!((ran.code, ran.err), (0, piped.err.clone()));
        }
    }
    for format in ["parquet", "arrow"] {
        let files = ["1", "2", "5"].map(|jobs| {
            let out = folder.join(format!("{format}-{jobs}"));
            let to = out.display().to_string();
            let arguments = ["--as", "canopen", "--format", format, "-o", &to, "--jobs", jobs];
            let ran = polepair(&[&["decode", &capture], &arguments[..]].concat());
            assert_eq!(ran.code, 0, "{}", ran.err);
            ["frames", "signals", "transactions", "events"]
                .map(|table| std::fs::read(out.join(table).with_extension(format)).expect(table))
        });
        assert!(files[0] == files[1] && files[1] == files[2], "{format}");
        assert!(files[0][0].len() > 100_000, "{format}");
    }
    let refused = polepair(&["decode", &capture, "--jobs", "0"]);
    assert!(refused.code == 2 && refused.err.contains("--jobs"), "{}", refused.err);
    std::fs::remove_dir_all(&folder).expect("removed");
}

/// The format follows the extension of OUT unless one is stated; an unknown extension gives lines of text.
#[test]
fn the_format_is_what_the_output_ends_in() {
    let folder = std::env::temp_dir().join(format!("polepair-ending-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let capture = folder.join("bus.log");
    let request = "601#4064600000000000\n(1.1) can0 581#4364600001020304\n";
    let log = format!("(1.0) can0 {request}(1.2) can0 {request}(1.3) can0 581#4364600001020304\n");
    std::fs::write(&capture, log).expect("a capture");
    let decoded = |out: &str, stated: &[&str]| {
        let out = folder.join(out);
        let words = ["decode", &capture.display().to_string(), "--as", "canopen", "-o"];
        let ran = polepair(&[&words[..], &[&out.display().to_string()], stated].concat());
        assert_eq!(ran.code, 0, "{}", ran.err);
        out
    };
    let begins = |path: std::path::PathBuf, with: &[u8]| {
        let bytes = std::fs::read(&path).expect("written");
        assert!(bytes.starts_with(with), "{}: {bytes:?}", path.display());
    };
    begins(decoded("a.parquet", &[]).join("signals.parquet"), b"PAR1");
    begins(decoded("a.PARQUET", &[]).join("frames.parquet"), b"PAR1");
    begins(decoded("a.arrow", &[]).join("frames.arrow"), b"ARROW1");
    begins(decoded("a.jsonl", &[]), b"{");
    for out in ["a.txt", "a.csv", "a"] {
        let lines = std::fs::read_to_string(decoded(out, &[])).expect("text");
        assert!(!lines.starts_with('{') && lines.lines().count() >= 5, "{lines}");
    }
    begins(decoded("b.parquet", &["--format", "jsonl"]), b"{");
    begins(decoded("b.jsonl", &["--format", "arrow"]).join("events.arrow"), b"ARROW1");
    // A drawing has its own formats.
    let drawn = decoded("c.parquet", &["--plot", "*/Actual/Position"]);
    assert!(!drawn.is_dir(), "{}", drawn.display());
    std::fs::remove_dir_all(&folder).expect("removed");
}
