//! The description that is committed is the one that is served.

use serde_json::Value;

#[test]
fn the_committed_description_is_the_servers() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/reference/openapi.json");
    let committed = std::fs::read_to_string(file).unwrap();
    let again = "cargo run -p polepair-serve --example openapi > docs/reference/openapi.json";
    assert!(committed == polepair_serve::openapi_json(), "stale: {again}");
}

/// Parts of the interface that clients use: paths, operations, parameters, and each schema's properties and words.
/// Schemas are not named, for their names go over no wire.
fn interface() -> String {
    let description: Value = serde_json::from_str(&polepair_serve::openapi_json()).unwrap();
    let mut lines = Vec::new();
    for (path, operations) in description["paths"].as_object().unwrap() {
        for (method, operation) in operations.as_object().unwrap() {
            lines.push(format!("{method} {path}: {}", bare(operation)));
        }
    }
    let schemas = description["components"]["schemas"].as_object().unwrap();
    let mut bodies: Vec<String> = schemas.values().map(|schema| bare(schema).to_string()).collect();
    bodies.sort();
    lines.extend(bodies);
    lines.join("\n") + "\n"
}

/// A part of the description without prose and without names of schemas.
fn bare(value: &Value) -> Value {
    match value {
        Value::Object(map) => {
            let prose = |key: &str, value: &Value| {
                matches!(key, "description" | "summary") && value.is_string()
            };
            let stored = map.iter().filter(|(key, value)| !prose(key, value));
            let remaining = stored.map(|(key, value)| match key.as_str() {
                "$ref" => (key.clone(), Value::from("schema")),
                _ => (key.clone(), bare(value)),
            });
            Value::Object(remaining.collect())
        }
        Value::Array(items) => Value::Array(items.iter().map(bare).collect()),
        other => other.clone(),
    }
}

/// `POLEPAIR_GOLDEN=write cargo test -p polepair-serve --test integration openapi::` writes it anew.
#[test]
fn every_path_and_field_is_pinned() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/interface.txt");
    let now = interface();
    if std::env::var_os("POLEPAIR_GOLDEN").is_some() {
        std::fs::write(path, &now).unwrap();
    }
    let golden = std::fs::read_to_string(path).unwrap();
    let only = |of: &str, other: &str| {
        let lines = of.lines().filter(|line| !other.lines().any(|l| l == *line));
        lines.collect::<Vec<_>>().join("\n")
    };
    assert!(
        golden == now,
        "the interface differs from {path}:\n- {}\n+ {}",
        only(&golden, &now),
        only(&now, &golden)
    );
}

#[test]
fn every_operation_has_a_name_of_its_own() {
    let description = polepair_serve::openapi_json();
    let mut names: Vec<&str> =
        description.lines().filter(|line| line.contains("\"operationId\"")).collect();
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert!(count > 15 && names.len() == count, "{names:?}");
}
