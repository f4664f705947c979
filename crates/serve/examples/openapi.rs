//! Prints the description of the REST interface:
//! `cargo run -p polepair-serve --example openapi > docs/reference/openapi.json`.
#![forbid(unsafe_code)]

fn main() {
    print!("{}", polepair_serve::openapi_json());
}
