//! Tool drawer of the workspace: code generation, tidy checks, swarm and soak runs.
fn main() {}
