//! Settings in RAM and EEPROM, with access and ranges from the profile.

use super::program::ProgramMemory;
use crate::profile::{Access, Parameter, Persistence, Profile};
use crate::proto::tmcl::Status;

/// Motors of a module at most.
pub const MOTORS_MAX: usize = 6;
/// User variables of bank 2.
pub const VARIABLES: usize = 256;

/// Value of global parameter 64 that means "the EEPROM holds settings".
pub const MAGIC: i32 = 228;

/// Memory that survives a power cycle.
#[derive(Clone, Debug)]
struct Eeprom {
    axis: [[i32; 256]; MOTORS_MAX],
    global: [i32; 256],
    variables: [i32; VARIABLES],
    locked: bool,
}

/// Settings of a module.
#[derive(Clone, Debug)]
pub struct Memory {
    profile: &'static Profile,
    axis_index: [u16; 256],
    /// Axis parameters as from the factory.
    factory_axis: [i32; 256],
    global_index: [u16; 256],
    /// Axis parameters of each motor, by number.
    pub axis: [[i32; 256]; MOTORS_MAX],
    /// Global parameters of bank 0 by number.
    pub global: [i32; 256],
    /// User variables.
    pub variables: [i32; VARIABLES],
    /// Periods of timers and edges of inputs that interrupt a program (bank 3).
    pub interrupt_settings: [i32; 256],
    eeprom: Eeprom,
    /// The stand-alone program, in EEPROM.
    pub program: ProgramMemory,
    /// Writes to the EEPROM since the module was made.
    pub writes: u64,
}

const NONE: u16 = u16::MAX;

impl Memory {
    /// Creates a memory with factory values.
    #[must_use]
    pub fn new(profile: &'static Profile) -> Self {
        let (mut axis_at, mut global_at) = ([NONE; 256], [NONE; 256]);
        let mut factory_axis = [0; 256];
        for (at, parameter) in profile.parameters.iter().enumerate() {
            let factory = factory_axis.get_mut(usize::from(parameter.index));
            if let (0, Some(factory)) = (parameter.space, factory) {
                *factory = parameter.default.unwrap_or(0) as i32;
            }
            let table = match parameter.space {
                0 => &mut axis_at,
                1 => &mut global_at,
                _ => continue,
            };
            if let Some(slot) = table.get_mut(usize::from(parameter.index)) {
                *slot = at as u16;
            }
        }
        let axis = [[0; 256]; MOTORS_MAX];
        let eeprom = Eeprom { axis, global: [0; 256], variables: [0; VARIABLES], locked: false };
        let mut new = Self {
            profile,
            axis_index: axis_at,
            factory_axis,
            global_index: global_at,
            axis,
            global: [0; 256],
            variables: [0; VARIABLES],
            interrupt_settings: [0; 256],
            eeprom,
            program: ProgramMemory::EMPTY,
            writes: 0,
        };
        new.write_factory_settings();
        new.load();
        new
    }

    /// The profile's description of an axis parameter.
    #[must_use]
    pub fn axis_parameter(&self, number: u8) -> Option<&'static Parameter> {
        self.profile.parameters.get(usize::from(self.axis_index[usize::from(number)]))
    }

    /// The profile's description of a global parameter of bank 0.
    #[must_use]
    pub fn global_parameter(&self, number: u8) -> Option<&'static Parameter> {
        self.profile.parameters.get(usize::from(self.global_index[usize::from(number)]))
    }

    /// Returns whether the EEPROM is locked (global parameter 73).
    #[must_use]
    pub const fn is_locked(&self) -> bool {
        self.eeprom.locked
    }

    /// Locks or unlocks the EEPROM.
    pub const fn lock(&mut self, locked: bool) {
        self.eeprom.locked = locked;
        self.writes += 1;
    }

    /// Writes the factory settings to the EEPROM. RAM does not change.
    pub fn write_factory_settings(&mut self) {
        self.eeprom.axis = [self.factory_axis; MOTORS_MAX];
        for parameter in self.profile.parameters.iter().filter(|parameter| parameter.space == 1) {
            let value = parameter.default.unwrap_or(0) as i32;
            self.eeprom.global[usize::from(parameter.index) % 256] = value;
        }
        self.eeprom.variables = [0; VARIABLES];
        self.eeprom.locked = false;
        self.writes += 1;
    }

    /// Power-up: RAM from EEPROM, which is made anew if its magic is not there.
    pub fn load(&mut self) {
        // The mark of a written EEPROM; any other value means a new one (global parameter 64).
        if self.eeprom.global[64] != MAGIC {
            self.write_factory_settings();
        }
        self.axis = self.eeprom.axis;
        self.global = self.eeprom.global;
        self.variables = self.eeprom.variables;
    }

    /// STAP.
    ///
    /// # Errors
    /// [`Status::WrongType`], [`Status::EepromLocked`].
    pub fn store_axis(&mut self, motor: usize, number: u8) -> Result<(), Status> {
        self.check_storable(number)?;
        self.check_unlocked()?;
        debug_assert!(motor < MOTORS_MAX);
        self.eeprom.axis[motor][usize::from(number)] = self.axis[motor][usize::from(number)];
        self.writes += 1;
        Ok(())
    }

    /// The value that RSAP restores.
    ///
    /// # Errors
    /// [`Status::WrongType`].
    pub fn stored_axis(&self, motor: usize, number: u8) -> Result<i32, Status> {
        self.check_storable(number)?;
        Ok(self.eeprom.axis[motor][usize::from(number)])
    }

    /// Writes a global parameter of bank 0 that is kept at once.
    ///
    /// # Errors
    /// [`Status::EepromLocked`].
    pub fn store_global(&mut self, number: u8, value: i32) -> Result<(), Status> {
        self.check_unlocked()?;
        self.global[usize::from(number)] = value;
        self.eeprom.global[usize::from(number)] = value;
        self.writes += 1;
        Ok(())
    }

    /// Sets a global parameter of bank 0 before delivery: no write is counted.
    pub const fn preset_global(&mut self, number: u8, value: i32) {
        self.global[number as usize] = value;
        self.eeprom.global[number as usize] = value;
    }

    /// Sets an axis parameter of all motors as it is from the factory: no write is counted.
    pub fn preset_axis(&mut self, number: u8, value: i32) {
        let number = usize::from(number);
        self.factory_axis[number] = value;
        for motor in 0..MOTORS_MAX {
            self.axis[motor][number] = value;
            self.eeprom.axis[motor][number] = value;
        }
    }

    /// The kept value of a global parameter of bank 0.
    #[must_use]
    pub fn stored_global(&self, number: u8) -> i32 {
        self.eeprom.global[usize::from(number)]
    }

    /// STGP of a user variable.
    ///
    /// # Errors
    /// [`Status::EepromLocked`].
    pub fn store_variable(&mut self, number: u8) -> Result<(), Status> {
        self.check_unlocked()?;
        self.eeprom.variables[usize::from(number)] = self.variables[usize::from(number)];
        self.writes += 1;
        Ok(())
    }

    /// RSGP of a user variable.
    pub fn restore_variable(&mut self, number: u8) {
        self.variables[usize::from(number)] = self.eeprom.variables[usize::from(number)];
    }

    fn check_storable(&self, number: u8) -> Result<(), Status> {
        match self.axis_parameter(number) {
            Some(p) if p.persistence == Persistence::Storable => Ok(()),
            _ => Err(Status::WrongType),
        }
    }

    fn check_unlocked(&self) -> Result<(), Status> {
        if self.eeprom.locked { Err(Status::EepromLocked) } else { Ok(()) }
    }
}

/// Checks whether `value` may be written.
///
/// # Errors
/// [`Status::WrongType`] for a missing or read-only parameter, [`Status::InvalidValue`].
pub fn check_writable(parameter: Option<&Parameter>, value: i32) -> Result<&Parameter, Status> {
    let parameter = parameter.ok_or(Status::WrongType)?;
    if parameter.access == Access::Read {
        return Err(Status::WrongType);
    }
    if i64::from(value) < parameter.min || i64::from(value) > parameter.max {
        return Err(Status::InvalidValue);
    }
    Ok(parameter)
}

/// Checks whether a parameter may be read.
///
/// # Errors
/// [`Status::WrongType`] for a missing or write-only parameter.
pub fn check_readable(parameter: Option<&Parameter>) -> Result<&Parameter, Status> {
    match parameter {
        Some(p) if p.access != Access::Write => Ok(p),
        _ => Err(Status::WrongType),
    }
}
