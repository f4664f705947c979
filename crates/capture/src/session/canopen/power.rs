//! The states of a CiA 402 drive, by its statusword and mode, wherever they come from.

use polepair_core::profile::Profile;
use polepair_core::proto::canopen::cia402::{Mode, STATUSWORD, State};
use polepair_core::proto::canopen::explain::say;
use polepair_core::proto::canopen::sdo::Object;

use super::emcy::{Faults, Words};
use super::mapping::{ERROR_CODE, MODE_DISPLAY};
use crate::session::{Change, Name, Notice};

/// What a drive says of itself.
#[derive(Debug, Default)]
pub(super) struct Power {
    word: Option<u16>,
    state: Option<State>,
    mode: Option<i8>,
    code: u16,
}

impl Power {
    /// An object has that value.
    #[inline]
    pub fn take(
        &mut self,
        node: u8,
        object: Object,
        raw: i64,
        faults: &mut Faults,
        profile: Option<&'static Profile>,
        notices: &mut Vec<Notice>,
    ) {
        match object {
            STATUSWORD if self.word != Some(raw as u16) => {
                self.word = Some(raw as u16);
                self.enter(node, State::of(raw as u16), faults, profile, notices);
            }
            MODE_DISPLAY if self.mode != Some(raw as i8) => {
                let from = self.mode.map_or("", |mode| say::mode(Mode::from(mode)));
                let to = say::mode(Mode::from(raw as i8));
                self.mode = Some(raw as i8);
                notices.push(change(node, "mode", from, to));
            }
            ERROR_CODE => self.code = raw as u16,
            _ => {}
        }
    }

    /// Takes a value by which no state changes; false of one that has to be [taken](Self::take).
    #[inline]
    pub fn stays(&mut self, object: Object, raw: i64) -> bool {
        match object {
            STATUSWORD if self.word != Some(raw as u16) => {
                let state = State::of(raw as u16);
                let same = self.state == Some(state) || matches!(state, State::Other(_));
                if same {
                    self.word = Some(raw as u16);
                }
                return same;
            }
            MODE_DISPLAY => return self.mode == Some(raw as i8),
            ERROR_CODE => self.code = raw as u16,
            _ => {}
        }
        true
    }

    fn enter(
        &mut self,
        node: u8,
        state: State,
        faults: &mut Faults,
        profile: Option<&'static Profile>,
        notices: &mut Vec<Notice>,
    ) {
        if self.state == Some(state) || matches!(state, State::Other(_)) {
            return;
        }
        let from = self.state.map_or("", State::name);
        notices.push(change(node, "power", from, state.name()));
        let (was, is) = (self.state.is_some_and(faulty), faulty(state));
        self.state = Some(state);
        if is && faults.is_empty() {
            let code = u32::from(self.code);
            let words = match code {
                0 => Words::UNNAMED,
                code => Words::of(code, false, profile),
            };
            faults.open(node, code, words, notices);
        }
        if was && !is {
            faults.clear(node, notices);
        }
    }
}

const fn faulty(state: State) -> bool {
    matches!(state, State::Fault | State::FaultReaction)
}

fn change(node: u8, what: Name, from: Name, to: Name) -> Notice {
    Notice::Change(Change { axis: Some(node.into()), what, from, to })
}
