//! The registers, the motor, and the end of the wire.

use super::motor::{MotorUnit, Registers};
use polepair_core::medium::{SerialLine, Stream};
use polepair_core::plant::{TICK_NS, TICKS_MAX};
use polepair_core::profile::Profile;
use polepair_core::proto::modbus::device::{Firmware, Framing, SerialEndpoint, SerialSettings};
use polepair_core::proto::modbus::wire::{Exception, Function, Space, WireFormat};
use polepair_core::station::{LineEvent, Station, Timed};
use polepair_core::time::{Instant, earliest};
use polepair_drives::surroundings::{Act, GroundTruth, SurroundingsControl};
use polepair_drives::{DeviceOptions, SimulatedDevice};

/// Time between two wake-ups of a turning motor.
const WAKE_MS: u32 = 10;

/// A simulated drive of a user's profile, at its end of a Modbus line.
#[derive(Debug)]
pub struct ProfileDrive {
    endpoint: SerialEndpoint,
    bank: Bank,
}

impl ProfileDrive {
    /// Protocol of the profiles that can be simulated so.
    pub const PROTOCOL: &'static str = "modbus";

    /// The drive, just powered. Without an address it has address 1.
    ///
    /// # Errors
    /// An option, because it has none.
    pub fn new<'a>(
        profile: &'static Profile,
        options: &DeviceOptions<'a>,
    ) -> Result<Self, &'a str> {
        if let Some((option, _)) = options.extra.first() {
            return Err(option);
        }
        let format = match options.wires.first() {
            Some(&"modbus-ascii") => WireFormat::Ascii,
            Some(&"modbus-tcp") => WireFormat::Tcp,
            _ => WireFormat::Rtu,
        };
        let baud = if options.untimed { 0 } else { profile.line.map_or(9600, |line| line.baud) };
        let wire = SerialSettings { format, line: SerialLine::new_8n1(baud) };
        let address = options.address.and_then(|address| u8::try_from(address).ok()).unwrap_or(1);
        let bank = Bank::new(profile, address, wire);
        Ok(Self { endpoint: SerialEndpoint::new(Framing::Length), bank })
    }
}

/// Everything but the protocol.
#[derive(Debug)]
struct Bank {
    address: u8,
    wire: SerialSettings,
    registers: Registers,
    /// One for each motor behind the address.
    motors: Vec<MotorUnit>,
    now: Instant,
    ticked_at: Instant,
}

impl Bank {
    fn new(profile: &'static Profile, address: u8, wire: SerialSettings) -> Self {
        let all = core::iter::once(profile).chain(profile.further_motors.iter().copied());
        let motors = all.map(MotorUnit::new).collect();
        let (now, ticked_at) = (Instant::ZERO, Instant::ZERO);
        let mut bank = Self { address, wire, registers: Registers::new(), motors, now, ticked_at };
        bank.power_up();
        bank
    }

    fn power_up(&mut self) {
        self.registers.clear();
        self.motors.iter_mut().for_each(|motor| motor.power_up(&mut self.registers));
    }

    fn advance(&mut self, now: Instant) {
        self.now = now.max(self.now);
        let ticks = (self.now.since(self.ticked_at).as_nanos() as u64 / TICK_NS).min(TICKS_MAX);
        self.ticked_at = self.ticked_at.plus_ns(ticks * TICK_NS);
        self.motors.iter_mut().for_each(|motor| motor.run(ticks));
    }

    /// Brings the registers up to date.
    fn measure(&mut self, now: Instant) {
        self.advance(now);
        self.motors.iter_mut().for_each(|motor| motor.show_signals(&mut self.registers));
    }

    fn is_readable(&self, space: Space, address: u16) -> bool {
        self.motors.iter().any(|motor| motor.is_readable(space, address))
    }
}

impl Firmware for Bank {
    fn address(&self) -> u8 {
        self.address
    }

    fn serial_settings(&self) -> SerialSettings {
        self.wire
    }

    fn supports(&self, function: Function) -> bool {
        matches!(function.code(), 1..=6 | 15 | 16 | 23)
    }

    fn read_bits(
        &mut self,
        now: Instant,
        space: Space,
        start: u16,
        count: u16,
        out: &mut [u8],
    ) -> Result<(), Exception> {
        self.measure(now);
        for n in 0..count {
            let at = start.checked_add(n).ok_or(Exception::IllegalAddress)?;
            let place = self.registers.get(&(space as u8, at));
            let word = place.filter(|_| self.is_readable(space, at));
            let word = word.ok_or(Exception::IllegalAddress)?;
            out[usize::from(n / 8)] |= u8::from(*word != 0) << (n % 8);
        }
        Ok(())
    }

    fn read_words(
        &mut self,
        now: Instant,
        space: Space,
        start: u16,
        out: &mut [u16],
    ) -> Result<(), Exception> {
        self.measure(now);
        for (word, at) in out.iter_mut().zip(start..=u16::MAX) {
            let place = self.registers.get(&(space as u8, at));
            let found = place.filter(|_| self.is_readable(space, at));
            *word = *found.ok_or(Exception::IllegalAddress)?;
        }
        Ok(())
    }

    fn write_bit(&mut self, now: Instant, address: u16, on: bool) -> Result<(), Exception> {
        self.advance(now);
        let mut is_there = false;
        for motor in &mut self.motors {
            if let Some(coil) = motor.coil(address) {
                motor.accept(&mut self.registers, &[(coil, i64::from(on))]);
                is_there = true;
            }
        }
        if is_there { Ok(()) } else { Err(Exception::IllegalAddress) }
    }

    fn write_words(
        &mut self,
        now: Instant,
        _function: Function,
        start: u16,
        words: &[u16],
    ) -> Result<(), Exception> {
        self.advance(now);
        let written: Vec<_> =
            self.motors.iter().map(|motor| motor.written_parameters(start, words)).collect();
        let covers = |at: u16| {
            self.motors.iter().zip(&written).any(|(motor, written)| motor.covers(written, at))
        };
        if !(start..).take(words.len()).all(covers) {
            return Err(Exception::IllegalAddress);
        }
        if !self.motors.iter().zip(&written).all(|(motor, written)| motor.allows(written)) {
            return Err(Exception::IllegalValue);
        }
        for (motor, written) in self.motors.iter_mut().zip(&written) {
            motor.accept(&mut self.registers, written);
        }
        Ok(())
    }
}

impl Timed for ProfileDrive {
    fn handle_timeout(&mut self, now: Instant) {
        self.bank.advance(now);
        self.endpoint.handle_timeout(now, &mut self.bank);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let turning = self.bank.motors.iter().any(|motor| !motor.shaft.is_resting());
        earliest(self.endpoint.poll_timeout(), turning.then(|| self.bank.now.plus_ms(WAKE_MS)))
    }
}

impl SimulatedDevice for ProfileDrive {
    fn serial_station(&mut self) -> Option<&mut dyn Station<Stream>> {
        Some(self)
    }
}

impl Station<Stream> for ProfileDrive {
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.bank.advance(now);
        self.endpoint.handle_input(now, unit, &mut self.bank);
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        self.endpoint.handle_line(event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        self.endpoint.poll_transmit(now, out)
    }

    fn line(&self) -> SerialLine {
        self.bank.wire.line
    }
}

impl SurroundingsControl for ProfileDrive {
    fn ground_truth(&mut self, now: Instant) -> GroundTruth {
        self.motor_truth(now, 0).unwrap_or_default()
    }

    fn act(&mut self, now: Instant, act: Act) -> bool {
        self.act_on_motor(now, 0, act)
    }

    fn motor_truth(&mut self, now: Instant, motor: u8) -> Option<GroundTruth> {
        self.bank.advance(now);
        let unit = self.bank.motors.get(usize::from(motor))?;
        let shaft = &unit.shaft;
        Some(GroundTruth {
            position: shaft.motor().position(),
            velocity: shaft.motor().velocity(),
            current: shaft.motor().current(),
            torque: shaft.motor().torque(),
            winding: shaft.winding(),
            enabled: shaft.is_powered(),
            fault: unit.fault as u32,
            starts: unit.starts,
            bounds: shaft.bounds(),
            setpoint: shaft.active_setpoint(),
            ..GroundTruth::default()
        })
    }

    fn act_on_motor(&mut self, now: Instant, motor: u8, act: Act) -> bool {
        self.bank.advance(now);
        if act == Act::PowerCycle {
            self.bank.power_up();
            self.endpoint.clear();
            return true;
        }
        let Some(unit) = self.bank.motors.get_mut(usize::from(motor)) else { return false };
        match act {
            Act::Load(torque) => unit.shaft.load = torque,
            Act::Jam(jammed) => unit.shaft.jam(jammed),
            Act::Supply(volts) => unit.shaft.supply = volts,
            Act::Ambient(celsius) => unit.shaft.set_ambient(celsius),
            Act::Temperature(celsius) => unit.shaft.set_temperature(celsius),
            Act::EncoderBroken(broken) => unit.shaft.break_encoder(broken),
            Act::Fault(code) => {
                unit.shaft.power_off();
                unit.fault = code.into();
            }
            _ => return false,
        }
        true
    }
}
