//! The part of the demo behind a relay: a host on a serial port turns two drives on the relay's CAN bus.

use std::sync::PoisonError;
use std::time::Duration;

use polepair::simulate;
use polepair::{Error, LocalAxis};
use polepair_core::profile::Signal;

use super::{FrameLines, recording_connector};
use crate::local_wire;
use crate::outcome;
use crate::problem::{Problem, Result};
use crate::session::read_signal;
use crate::terminal::print_note;

const RACK: &str = r#"
[[link]]
name = "host"
protocol = "tml"
baud = 115200

[[link.drive]]
name = "relay"
profile = "technosoft-f514l"
address = 255
on = ["host", "bus"]

[[link]]
name = "bus"
protocol = "tmlcan"

[[link.drive]]
name = "x"
profile = "technosoft-f514l"
address = 1

[[link.drive]]
name = "y"
profile = "technosoft-f514l"
address = 2
"#;

/// Plays it. Returns what failed.
pub(super) fn run_relay_scene() -> Result<Option<String>> {
    let description = simulate::rack_of_text("demo", RACK, 1).map_err(outcome::to_problem)?;
    let lines = simulate::drive_lines(&description, 1).map_err(outcome::to_problem)?;
    let Some(line) = lines.into_iter().next() else {
        return Err(Problem::usage("E244", "the demo's rack has no link."));
    };
    let (wire, place) = local_wire::open(None).map_err(|error| outcome::link_problem(&error))?;
    let url = description.urls(0, &place).remove(0);
    let _served = line.serve(wire);
    print_note("== Two axes on CAN behind a relay ==");
    print_note(&format!("  opening {url}: axis 255 is the relay, 1 and 2 are on its bus"));
    let frames = FrameLines::default();
    let link =
        recording_connector(&url, &frames).connect_local(&url).map_err(outcome::to_problem)?;
    let behind = &link.axes()[1..];
    let ended = turn_axes(behind, &frames);
    for frame in frames.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        print_note(&format!("      {frame}"));
    }
    for axis in behind {
        if let Ok(Some(position)) = read_signal(axis, Signal::Position) {
            print_note(&format!("  axis {:<3} {position}", axis.number()));
        }
    }
    print_note(if ended.is_ok() { "  both turned at once           ok" } else { "  FAILED\n" });
    drop(link);
    let ended = ended.and_then(|()| turn_one_alone(&url));
    print_note(if ended.is_ok() { "  axis 2 turned alone           ok\n" } else { "  FAILED\n" });
    Ok(ended.err().map(|error| format!("behind the relay: {error}")))
}

/// One axis, named with the relay that it is reached through.
fn turn_one_alone(url: &str) -> std::result::Result<(), Error> {
    let (line, _) = url.split_once('#').unwrap_or((url, ""));
    let alone = format!("{line}?through=255#2");
    print_note(&format!("  opening {alone}"));
    let frames = FrameLines::default();
    let link = recording_connector(&alone, &frames).connect_local(&alone)?;
    turn_axes(link.axes(), &frames)?;
    for axis in link.axes() {
        if let Ok(Some(position)) = read_signal(axis, Signal::Position) {
            print_note(&format!("  axis {:<3} {position}", axis.number()));
        }
    }
    Ok(())
}

/// All of them at once, two turns. The frames that are kept are those of the move.
fn turn_axes(axes: &[LocalAxis], frames: &FrameLines) -> std::result::Result<(), Error> {
    for axis in axes {
        axis.arm(true);
        axis.enable()?;
    }
    frames.lock().unwrap_or_else(PoisonError::into_inner).clear();
    for axis in axes {
        axis.move_by("2 turn")?;
    }
    for axis in axes {
        axis.wait(Duration::from_secs(10))?;
        axis.disable()?;
        axis.arm(false);
    }
    Ok(())
}
