//! The description that is committed is the one that is served.

#[test]
fn the_committed_description_is_the_servers() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/reference/openapi.json");
    let committed = std::fs::read_to_string(file).unwrap();
    let again = "cargo run -p polepair-serve --example openapi > docs/reference/openapi.json";
    assert!(committed == polepair_serve::description(), "stale: {again}");
}

#[test]
fn every_operation_has_a_name_of_its_own() {
    let description = polepair_serve::description();
    let mut names: Vec<&str> =
        description.lines().filter(|line| line.contains("\"operationId\"")).collect();
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert!(count > 15 && names.len() == count, "{names:?}");
}
