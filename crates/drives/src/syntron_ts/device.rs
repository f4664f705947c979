//! The TS on its wires: the Modbus and the CANopen end of one [`Drive`], and its environment.

use super::alarm::Alarm;
use super::drive::{Drive, RegisterError, register_numbers};
use super::objects::PDOS;
use super::options::Options;
use super::panel::PanelKey;
use super::registers::{DN_BASE, fn_registers};
use crate::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_core::medium::{Can, CanLine, Frame, SerialLine, Stream};
use polepair_core::profile::Profile;
use polepair_core::proto::canopen::device::CanEndpoint;
use polepair_core::proto::modbus::device::{Firmware, Framing, SerialEndpoint, SerialSettings};
use polepair_core::proto::modbus::wire::{Exception, Function, Space, WireFormat};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};

/// Words of an ASCII frame at most (TS manual V2 §2.4).
const ASCII_WORDS_MAX: u16 = 12;
/// Words of an RTU frame at most, by the standard.
const READ_WORDS_MAX: u16 = 125;
/// Words of one write at most.
const WRITE_WORDS_MAX: u16 = 123;
/// Baud rates by Fn_3C (§2.2, 192000 and 512000 as printed).
const BAUDS: [u32; 7] = [2400, 9600, 38_400, 57_600, 115_200, 192_000, 512_000];

/// A simulated TS on its wires.
#[derive(Debug)]
pub struct Device {
    endpoint: SerialEndpoint,
    can: CanEndpoint<PDOS>,
    modbus: ModbusSide,
}

/// The drive with what its Modbus side last took from Fn_3A, Fn_3C and Fn_3D.
#[derive(Debug)]
struct ModbusSide {
    drive: Drive,
    address: u8,
    wire: SerialSettings,
}

impl Device {
    /// A drive that just got power.
    #[must_use]
    pub fn new(profile: &'static Profile, options: Options) -> Self {
        let framing = match options.gap_ms {
            0 => Framing::Length,
            ms => Framing::Silence { us: ms.saturating_mul(1000) },
        };
        let wire = SerialSettings { format: WireFormat::Rtu, line: SerialLine::new_8n1(0) };
        let mut modbus = ModbusSide { drive: Drive::new(profile, options), address: 1, wire };
        modbus.apply_settings();
        let can = CanEndpoint::new(options.can, &mut modbus.drive);
        Self { endpoint: SerialEndpoint::new(framing), can, modbus }
    }

    /// The drive behind the line.
    #[must_use]
    pub const fn drive(&self) -> &Drive {
        &self.modbus.drive
    }
}

impl Timed for Device {
    fn handle_timeout(&mut self, now: Instant) {
        self.modbus.drive.advance(now);
        self.endpoint.handle_timeout(now, &mut self.modbus);
        self.can.handle_timeout(now, &mut self.modbus.drive);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let drive = &self.modbus.drive;
        // A change is to be reported on the bus within a tick.
        let due = drive
            .next_due()
            .map(|due| if self.can.is_active() { due.min(drive.next_tick()) } else { due });
        let ends = earliest(self.endpoint.poll_timeout(), self.can.poll_timeout());
        earliest(ends, due)
    }
}

impl crate::SimulatedDevice for Device {
    fn serial_station(&mut self) -> Option<&mut dyn Station<Stream>> {
        Some(self)
    }

    fn can_station(&mut self) -> Option<&mut dyn Station<Can>> {
        Some(self)
    }
}

impl Station<Can> for Device {
    fn handle_input(&mut self, now: Instant, unit: &Frame) {
        self.modbus.drive.advance(now);
        self.can.handle_input(now, unit, &mut self.modbus.drive);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.modbus.drive.advance(now);
        self.can.handle_line(now, event, &mut self.modbus.drive);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        self.can.poll_transmit(now, out, &mut self.modbus.drive)
    }

    fn line(&self) -> CanLine {
        self.can.line()
    }
}

impl Station<Stream> for Device {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.modbus.drive.advance(now);
        self.endpoint.handle_input(now, unit, &mut self.modbus);
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        self.endpoint.handle_line(event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.endpoint.poll_transmit(now, out)
    }

    fn line(&self) -> SerialLine {
        self.modbus.wire.line
    }
}

impl ModbusSide {
    /// Address, baud rate and framing as the registers now are.
    fn apply_settings(&mut self) {
        let registers = self.drive.registers();
        let at = usize::from(registers.value(fn_registers::BAUD));
        let baud = if self.drive.options().untimed { 0 } else { BAUDS[at.min(BAUDS.len() - 1)] };
        let format = match registers.value(fn_registers::FORMAT) & 0xFF {
            _ if self.drive.options().tcp => WireFormat::Tcp,
            2 | 102 => WireFormat::Ascii,
            _ => WireFormat::Rtu,
        };
        self.address = registers.value(fn_registers::ADDRESS) as u8;
        self.wire = SerialSettings { format, line: SerialLine::new_8n1(baud) };
    }
}

impl Firmware for ModbusSide {
    fn address(&self) -> u8 {
        self.address
    }

    fn serial_settings(&self) -> SerialSettings {
        self.wire
    }

    fn supports(&self, function: Function) -> bool {
        matches!(function.code(), 0x01 | 0x02 | 0x03 | 0x06 | 0x10)
    }

    fn words_max(&self, function: Function, format: WireFormat) -> u16 {
        match format {
            WireFormat::Ascii => ASCII_WORDS_MAX,
            WireFormat::Rtu | WireFormat::Tcp if function.read_space().is_some() => READ_WORDS_MAX,
            WireFormat::Rtu | WireFormat::Tcp => WRITE_WORDS_MAX,
        }
    }

    fn reads_whole_bytes(&self) -> bool {
        true
    }

    fn read_bits(
        &mut self,
        now: Instant,
        space: Space,
        start: u16,
        count: u16,
        out: &mut [u8],
    ) -> Result<(), Exception> {
        self.drive.advance(now);
        let (lines, there) = match space {
            Space::Coil => (self.drive.outputs(), 4),
            _ => (self.drive.inputs(), 8),
        };
        let [first, ..] = out else { return Err(Exception::IllegalValue) };
        if start >= there || count > 8 {
            return Err(Exception::IllegalAddress);
        }
        *first = lines >> start & (0xFF >> (8 - count));
        Ok(())
    }

    fn read_words(
        &mut self,
        now: Instant,
        _space: Space,
        start: u16,
        out: &mut [u16],
    ) -> Result<(), Exception> {
        self.drive.advance(now);
        for (address, word) in register_numbers(start).zip(out) {
            let value = match address.checked_sub(DN_BASE) {
                Some(number) => self.drive.dn_value(number),
                None => self.drive.fn_value(address),
            };
            *word = value.ok_or(Exception::IllegalAddress)?;
        }
        Ok(())
    }

    fn write_bit(&mut self, _now: Instant, _address: u16, _on: bool) -> Result<(), Exception> {
        Err(Exception::IllegalFunction)
    }

    fn write_words(
        &mut self,
        now: Instant,
        _function: Function,
        start: u16,
        words: &[u16],
    ) -> Result<(), Exception> {
        self.drive.advance(now);
        self.drive.write(start, words).map_err(|refusal| match refusal {
            RegisterError::Address => Exception::IllegalAddress,
            RegisterError::Value => Exception::IllegalValue,
            RegisterError::Failure => Exception::DeviceFailure,
        })?;
        if self.drive.options().applies_at_once {
            self.apply_settings();
        }
        Ok(())
    }
}

impl SurroundingsControl for Device {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        let drive = &mut self.modbus.drive;
        drive.advance(now);
        let motor = drive.shaft().motor();
        GroundTruth {
            position: motor.position(),
            velocity: motor.velocity(),
            current: motor.current(),
            torque: motor.torque(),
            winding: drive.shaft().winding(),
            enabled: drive.shaft().is_powered(),
            fault: u32::from(drive.alarm().0),
            flash_writes: drive.registers().wear(),
            unrepeatable: drive.unrepeatable(),
            starts: drive.starts(),
            bounds: drive.shaft().bounds(),
            setpoint: drive.shaft().active_setpoint(),
        }
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        let drive = &mut self.modbus.drive;
        drive.advance(now);
        match act {
            Act::Load(torque) => drive.shaft_mut().load = torque,
            Act::Jam(jammed) => drive.shaft_mut().jam(jammed),
            Act::Supply(volts) => drive.shaft_mut().supply = volts,
            Act::Ambient(celsius) => drive.shaft_mut().set_ambient(celsius),
            Act::Temperature(celsius) => drive.shaft_mut().set_temperature(celsius),
            Act::EepromDamaged(damaged) => {
                if damaged {
                    drive.raise_alarm(Alarm::PA);
                }
            }
            Act::Input(number, on) => {
                let at = usize::from(number).wrapping_sub(1);
                let Some(line) = drive.lines_mut().forced_closed.get_mut(at) else { return false };
                *line = on;
            }
            Act::Analog(0, volts) => drive.set_analog(volts),
            Act::Pulses(count) => drive.add_pulses(count),
            Act::Switch { which, at } => return set_switch(drive, which, at),
            Act::EncoderBroken(broken) => drive.shaft_mut().break_encoder(broken),
            Act::HallBroken(broken) => drive.shaft_mut().hall_broken = broken,
            Act::Fault(code) => match Alarm::of_code(code) {
                Some(alarm) => drive.raise_alarm(alarm),
                None => return false,
            },
            Act::PowerCycle => {
                drive.power_cycle();
                self.modbus.apply_settings();
                self.endpoint.clear();
                self.can.power_cycle(now, &mut self.modbus.drive);
            }
            Act::Key(number, down) => match PanelKey::of_number(number) {
                Some(key) => drive.handle_key(now, key, down),
                None => return false,
            },
            _ => return false,
        }
        true
    }

    fn panel_text(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.modbus.drive.advance(now);
        Some(self.modbus.drive.write_display(now, out))
    }

    fn take_notice(&mut self) -> Option<&'static str> {
        self.modbus.drive.take_notice()
    }
}

fn set_switch(drive: &mut Drive, which: u8, at: f64) -> bool {
    let lines = drive.lines_mut();
    let index = match which {
        0 => &mut lines.home_at,
        1 => &mut lines.forward_at,
        2 => &mut lines.reverse_at,
        _ => return false,
    };
    *index = (!at.is_nan()).then_some(at);
    true
}
