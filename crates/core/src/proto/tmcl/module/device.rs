//! A module with its serial and CAN ends.

use super::super::device::{CanEndpoint, ChecksumErrorReply, Quirks, SerialEndpoint};
use super::state::TmclModule;
use crate::medium::{Can, CanLine, Frame, SerialLine, Stream};
use crate::station::{LineEvent, Station, Timed};
use crate::time::{Instant, earliest};

/// Time limit of a datagram whose bytes may come in pieces at any time (pty, TCP), ms.
const UNTIMED_BYTE_TIMEOUT_MS: u32 = 200;

/// Options of the wire: differences between firmware versions.
#[derive(Clone, Copy, Debug)]
pub struct WireOptions(Quirks);

impl WireOptions {
    /// On a wire without byte timing (pty, TCP) if `untimed`.
    #[must_use]
    pub fn new(untimed: bool) -> Self {
        let mut quirks = Quirks::default();
        if untimed {
            quirks.byte_timeout_ms = Some(UNTIMED_BYTE_TIMEOUT_MS);
        }
        Self(quirks)
    }

    /// Gives the module an address, as serial address and CAN identifier.
    pub fn set_address(module: &mut impl TmclModule, address: Option<u32>) {
        let memory = &mut module.state_mut().memory;
        if let Some(address) = address {
            memory.preset_global(66, i32::from(address as u8));
            memory.preset_global(71, i32::from(address as u16 & 0x7FF));
        }
    }

    /// Takes an option of the wires; `false` for another.
    ///
    /// # Errors
    /// A value that the option does not have.
    pub fn read_option<'a>(
        &mut self,
        module: &mut impl TmclModule,
        option: (&'a str, &'a str),
    ) -> Result<bool, &'a str> {
        let (key, value) = option;

        let quirks = &mut self.0;
        match (key, value) {
            ("dlc", "7") => quirks.eight_bytes = false,
            ("dlc", "8") => quirks.eight_bytes = true,
            ("bad-sum", "mine") => quirks.checksum_error_reply = ChecksumErrorReply::IfAddressed,
            ("bad-sum", "always") => quirks.checksum_error_reply = ChecksumErrorReply::Always,
            ("bad-sum", "ignore") => quirks.checksum_error_reply = ChecksumErrorReply::Never,
            ("usb", "true") => quirks.any_address = true,
            ("usb", "false") => quirks.any_address = false,
            ("settings", "before-reply") => quirks.settings_before_reply = true,
            ("settings", "after-reply") => quirks.settings_before_reply = false,
            ("host", host) => {
                let host = host.parse::<u16>().ok().filter(|id| *id <= 0x7FF).ok_or(host)?;
                let memory = &mut module.state_mut().memory;
                if host <= 0xFF {
                    memory.preset_global(76, i32::from(host));
                }
                memory.preset_global(70, i32::from(host));
            }
            ("deaf-ms", ms) => quirks.ignore_after_foreign_ms = ms.parse().map_err(|_| ms)?,
            ("dlc" | "bad-sum" | "settings" | "usb", value) => return Err(value),
            _ => return Ok(false),
        }
        Ok(true)
    }
}

/// A simulated module with its motors.
#[derive(Debug)]
pub struct ModuleDevice<M> {
    /// The module.
    pub module: M,
    serial: SerialEndpoint,
    can: CanEndpoint,
}

impl<M: TmclModule> ModuleDevice<M> {
    /// A module after power-up.
    #[must_use]
    pub fn new(module: M, WireOptions(quirks): WireOptions) -> Self {
        let (serial, can) =
            (SerialEndpoint::new(quirks, &module), CanEndpoint::new(quirks, &module));
        Self { module, serial, can }
    }
}

impl<M: TmclModule> Timed for ModuleDevice<M> {
    fn handle_timeout(&mut self, now: Instant) {
        self.module.advance(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.serial.poll_timeout(), self.module.next_due())
    }
}

impl<M: TmclModule> Station<Stream> for ModuleDevice<M> {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.module.advance(now);
        if self.module.state().is_unresponsive(now) {
            // It missed half a datagram at most: the next byte begins a new one.
            return self.serial.handle_break();
        }
        self.module.state_mut().last_requests.serial = Some(now);
        self.serial.handle_input(now, unit, &mut self.module);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.module.advance(now);
        if matches!(event, LineEvent::Break | LineEvent::Down) {
            self.serial.handle_break();
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.serial.poll_transmit(now, out, &mut self.module)
    }

    fn line(&self) -> SerialLine {
        self.serial.line()
    }
}

impl<M: TmclModule> Station<Can> for ModuleDevice<M> {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.module.advance(now);
        if self.module.state().is_unresponsive(now) {
            return;
        }
        self.module.state_mut().last_requests.can = Some(now);
        self.can.handle_input(now, unit, &mut self.module);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        let _ = event;
        self.module.advance(now);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        *out = self.can.poll_transmit(now, &mut self.module)?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        self.can.line()
    }
}
