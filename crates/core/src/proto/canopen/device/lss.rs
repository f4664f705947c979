//! Layer setting services: node-ID and bit rate, by the four numbers of 1018h (CiA 305).

use super::{CanEnd, Firmware};
use crate::medium::Frame;
use crate::proto::canopen::NODE_MAX;
use crate::proto::canopen::lss::{Bound, FAST_SCAN_BEGIN, KBIT_PER_S, Number, Reply, Request};
use crate::time::Instant;

/// Node-ID that stands for none.
const NO_NODE: u8 = 255;
/// Error codes of the replies.
const OUT_OF_RANGE: u8 = 1;

/// What is known of an LSS master's doings.
#[derive(Clone, Debug)]
pub(super) struct Slave {
    configuring: bool,
    /// Numbers that agreed so far, a bit each, of a switch selective.
    selected: u8,
    /// The same of an identification, a bit for each bound.
    bounds: u8,
    /// Which number a fast scan is at.
    scanning: u8,
    bit_rate: Option<u32>,
    /// When the bit rate changes.
    switch_at: Instant,
}

impl Default for Slave {
    fn default() -> Self {
        Self {
            configuring: false,
            selected: 0,
            bounds: 0,
            scanning: 0,
            bit_rate: None,
            switch_at: Instant::FAR,
        }
    }
}

impl Slave {
    pub(super) const fn due(&self) -> Instant {
        self.switch_at
    }
}

impl<const N: usize> CanEnd<N> {
    pub(super) fn lss_request(
        &mut self,
        now: Instant,
        frame: &Frame,
        firmware: &mut impl Firmware,
    ) {
        let Ok(request) = Request::parse(frame.bytes()) else { return };
        let reply = match request {
            Request::SwitchGlobal(on) => return self.switch(now, on, firmware),
            Request::SwitchSelective(number, value) => self.select(number, value, firmware),
            Request::Identify(bound, value) => self.identify(bound, value, firmware),
            Request::IdentifyUnconfigured => (self.node == 0).then_some(Reply::Unconfigured),
            Request::FastScan { number, bit, sub, next } => {
                self.fast_scan(number, bit, sub, next, firmware)
            }
            _ if self.lss.configuring => self.configure(now, request, firmware),
            _ => None,
        };
        if let Some(reply) = reply {
            self.mail.lss(reply.bytes());
        }
    }

    /// One of 1018h's four numbers.
    fn number(&mut self, number: Number, firmware: &mut impl Firmware) -> u32 {
        self.own_value(0x1018, number as u8 + 1, firmware).unwrap_or(0) as u32
    }

    /// Back to waiting a node that got its first node-ID begins to live.
    fn switch(&mut self, now: Instant, on: bool, firmware: &mut impl Firmware) {
        let leaves = self.lss.configuring && !on;
        self.lss.configuring = on;
        if leaves && self.node == 0 && (1..=NODE_MAX).contains(&firmware.node_id()) {
            self.boot(now, firmware);
        }
    }

    fn select(
        &mut self,
        number: Number,
        value: u32,
        firmware: &mut impl Firmware,
    ) -> Option<Reply> {
        let place = number as u8;
        let before = (1 << place) - 1;
        let agrees = self.number(number, firmware) == value;
        let in_order = self.lss.selected & before == before;
        self.lss.selected = if agrees && in_order { before | 1 << place } else { 0 };
        self.lss.configuring |= self.lss.selected == 0x0F;
        (self.lss.selected == 0x0F).then_some(Reply::Selected)
    }

    fn identify(
        &mut self,
        bound: Bound,
        value: u32,
        firmware: &mut impl Firmware,
    ) -> Option<Reply> {
        let place = bound as u8;
        let fits = match bound {
            Bound::Vendor => self.number(Number::Vendor, firmware) == value,
            Bound::Product => self.number(Number::Product, firmware) == value,
            Bound::RevisionLow => self.number(Number::Revision, firmware) >= value,
            Bound::RevisionHigh => self.number(Number::Revision, firmware) <= value,
            Bound::SerialLow => self.number(Number::Serial, firmware) >= value,
            Bound::SerialHigh => self.number(Number::Serial, firmware) <= value,
        };
        let before = (1 << place) - 1;
        let in_order = self.lss.bounds & before == before;
        self.lss.bounds = if fits && in_order { before | 1 << place } else { 0 };
        (self.lss.bounds == 0x3F).then_some(Reply::Identified)
    }

    /// Nodes without node-ID tell whether they agree so far, bit by bit, number by number.
    fn fast_scan(
        &mut self,
        value: u32,
        bit: u8,
        sub: Number,
        next: Number,
        firmware: &mut impl Firmware,
    ) -> Option<Reply> {
        if self.node != 0 || self.lss.configuring {
            return None;
        }
        if bit == FAST_SCAN_BEGIN {
            self.lss.scanning = 0;
            return Some(Reply::Identified);
        }
        if bit > 31 || self.lss.scanning != sub as u8 {
            return None;
        }
        if (self.number(sub, firmware) ^ value) >> bit != 0 {
            return None;
        }
        if bit == 0 {
            self.lss.scanning = next as u8;
            // After the last number the only node that agreed in all four is configured.
            self.lss.configuring = next < sub;
        }
        Some(Reply::Identified)
    }

    fn configure(
        &mut self,
        now: Instant,
        request: Request,
        firmware: &mut impl Firmware,
    ) -> Option<Reply> {
        Some(match request {
            Request::SetNode(node) if (1..=NODE_MAX).contains(&node) || node == NO_NODE => {
                firmware.set_node_id(node);
                Reply::SetNode(0, 0)
            }
            Request::SetNode(_) => Reply::SetNode(OUT_OF_RANGE, 0),
            Request::SetBitTiming(table, index) => self.set_bit_timing(table, index, firmware),
            Request::ActivateBitTiming(ms) => {
                self.activate(now, ms);
                return None;
            }
            Request::Store if firmware.store_link() => Reply::Store(0, 0),
            Request::Store => Reply::Store(OUT_OF_RANGE, 0),
            Request::Inquire(number) => Reply::Number(number, self.number(number, firmware)),
            Request::InquireNode if self.node == 0 => Reply::Node(NO_NODE),
            Request::InquireNode => Reply::Node(self.node),
            _ => return None,
        })
    }

    fn set_bit_timing(&mut self, table: u8, index: u8, firmware: &mut impl Firmware) -> Reply {
        let kbit = KBIT_PER_S.get(usize::from(index)).copied().unwrap_or(0);
        let rate = u32::from(kbit) * 1000;
        if table != 0 || rate == 0 || !firmware.set_bit_rate(rate) {
            return Reply::SetBitTiming(OUT_OF_RANGE, 0);
        }
        self.lss.bit_rate = Some(rate);
        Reply::SetBitTiming(0, 0)
    }

    /// Silence for `ms` with the old bit rate, then as long with the new one.
    fn activate(&mut self, now: Instant, ms: u16) {
        if self.lss.bit_rate.is_some() {
            self.lss.switch_at = now.plus_ms(ms.into());
            self.mail.quiet_until = now.plus_ms(2 * u32::from(ms));
            self.arm(self.lss.switch_at);
            self.arm(self.mail.quiet_until);
        }
    }

    pub(super) fn lss_timers(&mut self, now: Instant) {
        if now >= self.lss.switch_at {
            self.lss.switch_at = Instant::FAR;
            self.bit_rate = self.lss.bit_rate.unwrap_or(self.bit_rate);
        }
    }
}
