//! The stop that a protocol sends to every drive at once, without a reply.

use polepair_core::axis::{Command, RehearsalAction};
use polepair_core::medium::{Can, Frame, Medium, Stream};
use polepair_core::profile::Profile;
use polepair_core::station::AxisIndex;
use polepair_link::{LinkIo as _, Received};

use crate::connect::Connector;
use crate::error::Error;
use crate::protocol_line::ProtocolLine;
use crate::url::Url;
use crate::wire::{CountedLink, SharedLink};

/// Silence after each frame to everybody: more than drives that end frames by silence need.
const BROADCAST_PAUSE_MS: u32 = 30;
/// Maximum number of units received in such a silence.
const UNITS_MAX: usize = 1_000;

/// Sends the requests of the stop that need no reply as broadcast. `false` if the protocol has no
/// broadcast, or the stop of these drives is unknown.
pub(super) fn broadcast_stop(
    connector: &Connector,
    url: &Url,
    line: &ProtocolLine,
    command: Command,
) -> Result<bool, Error> {
    let profile = connector.chosen_profile(url, &line.protocol)?.unwrap_or(line.protocol.generic);
    send_broadcast(line, profile, command)
}

pub(super) fn send_broadcast(
    line: &ProtocolLine,
    profile: &'static Profile,
    command: Command,
) -> Result<bool, Error> {
    let Some(address) = line.protocol.broadcast else { return Ok(false) };
    let connection = line.open_connection(&[(profile, address)])?;
    let (mut runs, mut frames, mut open) = (Vec::new(), Vec::new(), true);
    connection.with_axes(|axes, _| {
        // It ends at the first step that asks, which an address of everybody's cannot.
        let _ = axes.rehearse(AxisIndex(0), command, &mut |step| {
            open &= matches!(
                step.action,
                RehearsalAction::Write(..) | RehearsalAction::Send | RehearsalAction::EndProgram
            );
            match (open, step.frame) {
                (true, Some(frame)) => frames.push(*frame),
                (true, None) => runs.push(step.bytes.to_vec()),
                (false, _) => {}
            }
        });
    });
    match &line.link {
        SharedLink::Serial(link) => {
            for run in &runs {
                link.send(run)?;
                // A broadcast has no reply to wait for; a request right behind it would be lost in drives that are
                // busy with it.
                wait_silence::<Stream>(link, &mut [0; 64])?;
            }
        }
        SharedLink::Can(link) => {
            for frame in &frames {
                link.send(frame)?;
            }
            wait_silence::<Can>(link, &mut Frame::default())?;
        }
    }
    Ok(!runs.is_empty() || !frames.is_empty())
}

/// Lets the line be silent, whatever comes back.
fn wait_silence<M: Medium>(link: &CountedLink<M>, buffer: &mut M::Out) -> Result<(), Error> {
    let until = link.now().plus_ms(BROADCAST_PAUSE_MS);
    for _ in 0..UNITS_MAX {
        if matches!(link.receive(buffer, until)?, Received::TimedOut) {
            break;
        }
    }
    Ok(())
}
