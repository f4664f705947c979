//! Layer setting services: node-ID and bit rate, by the four numbers of 1018h (CiA 305).

use super::{CanEndpoint, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::NODE_MAX;
use crate::proto::canopen::lss::{
    FAST_SCAN_BEGIN, IdentifyBound, IdentityNumber, KBIT_PER_S, LssReply, LssRequest,
};
use crate::time::Instant;

/// Node-ID of an unconfigured node.
const NO_NODE: u8 = 255;
/// Error codes of the replies.
const OUT_OF_RANGE: u8 = 1;

/// State of the LSS slave.
#[derive(Clone, Debug)]
pub(super) struct LssSlave {
    configuring: bool,
    /// Numbers that agreed so far, a bit each, of a switch selective.
    numbers_matched: u8,
    /// Met bounds of an identification, a bit for each.
    bounds_met: u8,
    /// Number of the identity that a fast scan is at.
    scan_number: u8,
    bit_rate: Option<u32>,
    /// Time at which the bit rate changes.
    switch_at: Instant,
}

impl Default for LssSlave {
    fn default() -> Self {
        Self {
            configuring: false,
            numbers_matched: 0,
            bounds_met: 0,
            scan_number: 0,
            bit_rate: None,
            switch_at: Instant::FAR_FUTURE,
        }
    }
}

impl LssSlave {
    pub(super) const fn due(&self) -> Instant {
        self.switch_at
    }
}

impl<const N: usize> CanEndpoint<N> {
    pub(super) fn handle_lss_request(
        &mut self,
        now: Instant,
        frame: &Frame,
        firmware: &mut impl Firmware,
    ) {
        let Ok(request) = LssRequest::parse(frame.bytes()) else { return };
        let reply = match request {
            LssRequest::SwitchGlobal(on) => return self.switch_lss_state(now, on, firmware),
            LssRequest::SwitchSelective(number, value) => {
                self.select_device(number, value, firmware)
            }
            LssRequest::Identify(bound, value) => self.identify_device(bound, value, firmware),
            LssRequest::IdentifyUnconfigured => (self.node == 0).then_some(LssReply::Unconfigured),
            LssRequest::FastScan { number, bit, sub, next } => {
                self.answer_fast_scan(number, bit, sub, next, firmware)
            }
            _ if self.lss.configuring => self.configure_lss(now, request, firmware),
            _ => None,
        };
        if let Some(reply) = reply {
            self.send_slots.set_lss(reply.bytes());
        }
    }

    /// One of 1018h's four numbers.
    fn identity_number(&mut self, number: IdentityNumber, firmware: &mut impl Firmware) -> u32 {
        self.protocol_value(0x1018, number as u8 + 1, firmware).unwrap_or(0) as u32
    }

    /// Back to waiting a node that got its first node-ID begins to live.
    fn switch_lss_state(&mut self, now: Instant, on: bool, firmware: &mut impl Firmware) {
        let leaves = self.lss.configuring && !on;
        self.lss.configuring = on;
        if leaves && self.node == 0 && (1..=NODE_MAX).contains(&firmware.node_id()) {
            self.boot(now, firmware);
        }
    }

    fn select_device(
        &mut self,
        number: IdentityNumber,
        value: u32,
        firmware: &mut impl Firmware,
    ) -> Option<LssReply> {
        let index = number as u8;
        let before = (1 << index) - 1;
        let agrees = self.identity_number(number, firmware) == value;
        let in_order = self.lss.numbers_matched & before == before;
        self.lss.numbers_matched = if agrees && in_order { before | 1 << index } else { 0 };
        self.lss.configuring |= self.lss.numbers_matched == 0x0F;
        (self.lss.numbers_matched == 0x0F).then_some(LssReply::Selected)
    }

    fn identify_device(
        &mut self,
        bound: IdentifyBound,
        value: u32,
        firmware: &mut impl Firmware,
    ) -> Option<LssReply> {
        let index = bound as u8;
        let fits = match bound {
            IdentifyBound::Vendor => {
                self.identity_number(IdentityNumber::Vendor, firmware) == value
            }
            IdentifyBound::Product => {
                self.identity_number(IdentityNumber::Product, firmware) == value
            }
            IdentifyBound::RevisionLow => {
                self.identity_number(IdentityNumber::Revision, firmware) >= value
            }
            IdentifyBound::RevisionHigh => {
                self.identity_number(IdentityNumber::Revision, firmware) <= value
            }
            IdentifyBound::SerialLow => {
                self.identity_number(IdentityNumber::Serial, firmware) >= value
            }
            IdentifyBound::SerialHigh => {
                self.identity_number(IdentityNumber::Serial, firmware) <= value
            }
        };
        let before = (1 << index) - 1;
        let in_order = self.lss.bounds_met & before == before;
        self.lss.bounds_met = if fits && in_order { before | 1 << index } else { 0 };
        (self.lss.bounds_met == 0x3F).then_some(LssReply::Identified)
    }

    /// Replies of nodes without node-ID to a fast scan: whether they match so far, bit by bit, number by
    /// number.
    fn answer_fast_scan(
        &mut self,
        value: u32,
        bit: u8,
        sub: IdentityNumber,
        next: IdentityNumber,
        firmware: &mut impl Firmware,
    ) -> Option<LssReply> {
        if self.node != 0 || self.lss.configuring {
            return None;
        }
        if bit == FAST_SCAN_BEGIN {
            self.lss.scan_number = 0;
            return Some(LssReply::Identified);
        }
        if bit > 31 || self.lss.scan_number != sub as u8 {
            return None;
        }
        if (self.identity_number(sub, firmware) ^ value) >> bit != 0 {
            return None;
        }
        if bit == 0 {
            self.lss.scan_number = next as u8;
            // After the last number the only node that agreed in all four is configured.
            self.lss.configuring = next < sub;
        }
        Some(LssReply::Identified)
    }

    fn configure_lss(
        &mut self,
        now: Instant,
        request: LssRequest,
        firmware: &mut impl Firmware,
    ) -> Option<LssReply> {
        Some(match request {
            LssRequest::SetNode(node) if (1..=NODE_MAX).contains(&node) || node == NO_NODE => {
                firmware.set_node_id(node);
                LssReply::SetNode(0, 0)
            }
            LssRequest::SetNode(_) => LssReply::SetNode(OUT_OF_RANGE, 0),
            LssRequest::SetBitTiming(table, index) => self.set_bit_timing(table, index, firmware),
            LssRequest::ActivateBitTiming(ms) => {
                self.activate_bit_timing(now, ms);
                return None;
            }
            LssRequest::Store if firmware.store_link() => LssReply::Store(0, 0),
            LssRequest::Store => LssReply::Store(OUT_OF_RANGE, 0),
            LssRequest::Inquire(number) => {
                LssReply::Number(number, self.identity_number(number, firmware))
            }
            LssRequest::InquireNode if self.node == 0 => LssReply::Node(NO_NODE),
            LssRequest::InquireNode => LssReply::Node(self.node),
            _ => return None,
        })
    }

    fn set_bit_timing(&mut self, table: u8, index: u8, firmware: &mut impl Firmware) -> LssReply {
        let kbit = KBIT_PER_S.get(usize::from(index)).copied().unwrap_or(0);
        let rate = u32::from(kbit) * 1000;
        if table != 0 || rate == 0 || !firmware.set_bit_rate(rate) {
            return LssReply::SetBitTiming(OUT_OF_RANGE, 0);
        }
        self.lss.bit_rate = Some(rate);
        LssReply::SetBitTiming(0, 0)
    }

    /// Silence for `ms` with the old bit rate, then as long with the new one.
    fn activate_bit_timing(&mut self, now: Instant, ms: u16) {
        if self.lss.bit_rate.is_some() {
            self.lss.switch_at = now.plus_ms(ms.into());
            self.send_slots.silenced_until = now.plus_ms(2 * u32::from(ms));
            self.schedule(self.lss.switch_at);
            self.schedule(self.send_slots.silenced_until);
        }
    }

    pub(super) fn run_lss_timers(&mut self, now: Instant) {
        if now >= self.lss.switch_at {
            self.lss.switch_at = Instant::FAR_FUTURE;
            self.bit_rate = self.lss.bit_rate.unwrap_or(self.bit_rate);
        }
    }
}
