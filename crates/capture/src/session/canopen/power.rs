//! States of a CiA 402 drive, by its statusword and mode.

use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cia402::{DriveState, OperationMode, STATUSWORD};
use polepair_core::proto::canopen::explain::meanings;
use polepair_core::proto::canopen::sdo::ObjectIndex;

use super::emcy::{FaultText, NodeFaults};
use super::mapping::{ERROR_CODE, MODE_DISPLAY};
use crate::session::{ChangeNotice, InternedName, SessionNotice};

/// Mode that a host sets.
const MODE: ObjectIndex = ObjectIndex::new(0x6060, 0);

/// State machine of a drive as it reports it.
#[derive(Debug, Default)]
pub(super) struct PowerMonitor {
    statusword: Option<u16>,
    state: Option<DriveState>,
    mode: Option<i8>,
    /// The mode that was set last, or that the drive showed since.
    latest_mode: Option<i8>,
    error_code: u16,
}

impl PowerMonitor {
    /// An object has that value.
    #[inline]
    pub fn handle_value(
        &mut self,
        node: u8,
        object: ObjectIndex,
        raw: i64,
        faults: &mut NodeFaults,
        profile: Option<&'static Profile>,
        notices: &mut Vec<SessionNotice>,
    ) {
        match object {
            STATUSWORD if self.statusword != Some(raw as u16) => {
                self.statusword = Some(raw as u16);
                self.set_state(node, DriveState::of(raw as u16), faults, profile, notices);
            }
            MODE => self.latest_mode = Some(raw as i8),
            MODE_DISPLAY if self.mode == Some(raw as i8) => self.latest_mode = self.mode,
            MODE_DISPLAY => {
                self.latest_mode = Some(raw as i8);
                let from =
                    self.mode.map_or("", |mode| meanings::mode_name(OperationMode::from(mode)));
                let to = meanings::mode_name(OperationMode::from(raw as i8));
                self.mode = Some(raw as i8);
                notices.push(change_notice(node, "mode", from, to));
            }
            ERROR_CODE => self.error_code = raw as u16,
            _ => {}
        }
    }

    /// The mode of operation, as far as the capture shows it.
    pub fn mode(&self) -> OperationMode {
        self.latest_mode.map_or(OperationMode::None, OperationMode::from)
    }

    /// Takes a value by which no state changes; false of one that has to be [taken](Self::handle_value).
    #[inline]
    pub fn accept_unchanged(&mut self, object: ObjectIndex, raw: i64) -> bool {
        match object {
            STATUSWORD if self.statusword != Some(raw as u16) => {
                let state = DriveState::of(raw as u16);
                let same = self.state == Some(state) || matches!(state, DriveState::Other(_));
                if same {
                    self.statusword = Some(raw as u16);
                }
                return same;
            }
            MODE_DISPLAY => return self.mode == Some(raw as i8) && self.latest_mode == self.mode,
            ERROR_CODE => self.error_code = raw as u16,
            _ => {}
        }
        true
    }

    fn set_state(
        &mut self,
        node: u8,
        state: DriveState,
        faults: &mut NodeFaults,
        profile: Option<&'static Profile>,
        notices: &mut Vec<SessionNotice>,
    ) {
        if self.state == Some(state) || matches!(state, DriveState::Other(_)) {
            return;
        }
        let from = self.state.map_or("", DriveState::name);
        notices.push(change_notice(node, "power", from, state.name()));
        let (was, is) = (self.state.is_some_and(is_faulty), is_faulty(state));
        self.state = Some(state);
        if is && faults.is_empty() {
            let code = u32::from(self.error_code);
            let words = match code {
                0 => FaultText::UNNAMED,
                code => FaultText::lookup(code, false, profile),
            };
            faults.add(node, code, words, notices);
        }
        if was && !is {
            faults.clear(node, notices);
        }
    }
}

const fn is_faulty(state: DriveState) -> bool {
    matches!(state, DriveState::Fault | DriveState::FaultReaction)
}

fn change_notice(
    node: u8,
    what: InternedName,
    from: InternedName,
    to: InternedName,
) -> SessionNotice {
    SessionNotice::Change(ChangeNotice { axis: Some(node.into()), what, from, to })
}
