//! The description that is committed is the one that is served.

#[test]
fn the_committed_description_is_the_servers() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/reference/openapi.json");
    let committed = std::fs::read_to_string(file).unwrap();
    let again = "cargo run -p polepair-serve --example openapi > docs/reference/openapi.json";
    assert!(committed == polepair_serve::description(), "stale: {again}");
}
