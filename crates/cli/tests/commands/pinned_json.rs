//! Scripts rely on the fields of JSON output: `tests/golden/json.txt` pins them, each with its types.
//! `POLEPAIR_GOLDEN=write cargo test -p polepair-cli --test commands pinned_json::` writes the file anew.
#![cfg(unix)]

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::run;

/// A CANopen node that is read, sends a value, has a fault, and reports another value in the second capture.
const LOG: &str = "\
(1700000000.000000) can0 605#4041600000000000
(1700000000.001000) can0 585#4B41600037020000
(1700000000.002000) can0 605#2B40600006000000
(1700000000.003000) can0 585#6040600000000000
(1700000000.004000) can0 085#1081010000000000
(1700000000.005000) can0 605#40FF600000000000
(1700000000.006000) can0 585#80FF600000000206
";

/// Types of each field, by its path.
type Fields = BTreeMap<String, BTreeSet<&'static str>>;

fn collect(path: &str, value: &Value, fields: &mut Fields) {
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "bool",
        Value::Number(_) => "number",
        Value::String(_) => "string",
        Value::Array(items) => {
            items.iter().for_each(|item| collect(&format!("{path}[]"), item, fields));
            "array"
        }
        Value::Object(entries) => {
            for (name, entry) in entries {
                collect(&format!("{path}.{name}"), entry, fields);
            }
            "object"
        }
    };
    fields.entry(path.to_owned()).or_default().insert(kind);
}

/// Fields of a command's output: one JSON object for each line, or one for all.
fn fields_of(arguments: &[&str]) -> Fields {
    let ran = run::polepair(arguments);
    assert!(ran.code <= 1, "{arguments:?}: {}", ran.err);
    let mut fields = Fields::new();
    let values = serde_json::Deserializer::from_str(&ran.out).into_iter::<Value>();
    for value in values {
        collect("", &value.expect("JSON"), &mut fields);
    }
    assert!(fields.len() > 1, "{arguments:?}: {}", ran.out);
    fields
}

#[test]
fn every_json_field_is_pinned() {
    let written = |name: &str, text: &str| {
        let path = format!("{}/json-{}-{name}", env!("CARGO_TARGET_TMPDIR"), std::process::id());
        std::fs::write(&path, text).expect("a file");
        path
    };
    let (before, after) = (written("a.log", LOG), written("b.log", &LOG.replace("3702", "1F02")));
    let commands: [(&str, &[&str]); 9] = [
        ("scan", &["scan", "sim:tmcl?axes=2&time=virtual", "--format", "jsonl"]),
        ("get", &["get", "sim:tmcl?time=virtual", "actual position", "--format", "jsonl"]),
        (
            "watch",
            &["watch", "sim:tmcl?time=virtual", "position", "--for", "100ms", "--format", "jsonl"],
        ),
        ("doctor", &["doctor", "sim:tmcl?time=virtual", "--format", "jsonl"]),
        ("send", &["send", "sim:tmcl?time=virtual", "GAP 1", "--format", "jsonl"]),
        ("encode", &["encode", "tmcl", "GAP 1", "--axis", "1", "--format", "json"]),
        ("decode", &["decode", &before, "--as", "canopen", "--format", "jsonl"]),
        ("summary", &["summary", &before, "--as", "canopen", "--format", "json"]),
        ("diff", &["diff", &before, &after, "--as", "canopen", "--format", "jsonl"]),
    ];
    let mut text = String::new();
    for (verb, arguments) in commands {
        for (path, kinds) in fields_of(arguments) {
            let kinds: Vec<_> = kinds.into_iter().collect();
            text += &format!(
                "{verb} {}: {}\n",
                if path.is_empty() { "." } else { &path },
                kinds.join(" | ")
            );
        }
    }
    let golden = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/json.txt");
    if std::env::var_os("POLEPAIR_GOLDEN").is_some() {
        std::fs::write(golden, &text).expect("the golden file");
    }
    let pinned = std::fs::read_to_string(golden).expect("the golden file");
    assert_eq!(text, pinned, "JSON output differs from {golden}");
}
