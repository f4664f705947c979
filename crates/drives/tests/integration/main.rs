//! One program for all tests of this crate from outside (BUILD-1).

mod bare_metal;
mod canopen_explain;
mod canopen_pair;
mod effects;
mod mux;
mod new_protocol;
mod tmcl_effect;
mod tml_explain;
mod tml_instructions;
mod tml_program;
mod toy;
