//! `polepair serve` as a process, with drives that are not in it: what it carries, and what is left of
//! it when it is killed, held up, or loses a link.
#![cfg(unix)]

mod dead;
mod heartbeat;
mod killed;
mod limited;
mod load;
mod lost;
mod many;
pub mod site;
mod wire;
