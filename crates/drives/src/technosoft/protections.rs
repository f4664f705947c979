//! Protections that switch the motor off, with limits, times and masks.
//!
//! Source: the help pages on MER, PCR and DER; drive manuals, chapter 6, for the units.

use super::addresses;
use super::drive::Drive;
use super::memory::Memory;
use super::status::{der, der2, isr, mer, set_bits, srh};
use super::units::{self, I2T_A2S};
use polepair_core::plant::TICK_S;

/// Winding temperature at which the motor's thermal switch opens, °C. \[I\]
const MOTOR_HOT_C: f64 = 130.0;
/// Share of the I2t limit that warns. \[I\]
const I2T_WARNS_AT: f64 = 0.8;
/// Turn of the shaft after which a broken encoder wire is noticed, rad. \[I\]
const BROKEN_WIRE_RAD: f64 = 0.1;

/// PCR: masks of the protections.
mod pcr {
    pub const OVER_CURRENT: u16 = 1 << 0;
    pub const I2T: u16 = 1 << 1;
    pub const MOTOR_HOT: u16 = 1 << 2;
    pub const DRIVE_HOT: u16 = 1 << 3;
    pub const OVER_VOLTAGE: u16 = 1 << 4;
    pub const UNDER_VOLTAGE: u16 = 1 << 5;
    pub const ENCODER: u16 = 1 << 6;
}

/// Settings as numbers to compare with, and how long each limit has been passed.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Protections {
    /// A setting was written since these were worked out.
    pub limits_stale: bool,
    masks: u16,
    current_limit: f64,
    current_limit_s: f64,
    nominal: f64,
    i2t_limit: f64,
    error_limit: f64,
    error_limit_s: f64,
    speed_limit: f64,
    speed_limit_s: f64,
    supply_limits: (f64, f64),
    temperature_limit: f64,
    over_current_s: f64,
    over_error_s: f64,
    over_speed_s: f64,
    /// The I2t integral, A²·s.
    i2t_integral: f64,
}

impl Protections {
    /// Limits still to be read.
    pub const NEW: Self = Self {
        limits_stale: true,
        masks: 0,
        current_limit: 0.0,
        current_limit_s: 0.0,
        nominal: 0.0,
        i2t_limit: 0.0,
        error_limit: 0.0,
        error_limit_s: 0.0,
        speed_limit: 0.0,
        speed_limit_s: 0.0,
        supply_limits: (0.0, 0.0),
        temperature_limit: 0.0,
        over_current_s: 0.0,
        over_error_s: 0.0,
        over_speed_s: 0.0,
        i2t_integral: 0.0,
    };

    /// The I2t integral in the drive's units (I2TINT_M).
    pub fn i2t_units(&self) -> i32 {
        (self.i2t_integral / I2T_A2S) as i32
    }
}

/// A limit that is passed for longer than allowed.
fn is_exceeded_too_long(passed: bool, since: &mut f64, allowed_s: f64) -> bool {
    *since = if passed { *since + TICK_S } else { 0.0 };
    *since > allowed_s
}

impl Drive {
    /// Watches a tick. \[I\] Which limit trips first is the order here.
    #[inline]
    pub fn check_protections(&mut self) {
        if self.protections.limits_stale {
            self.read_limits();
            self.read_limit_switches();
        }
        self.check_supply();
        if self.shaft.servo.is_enabled() {
            self.check_current();
            self.check_control_errors();
        } else {
            // An axis that is off follows nothing, so no error may add up meanwhile.
            (self.protections.over_error_s, self.protections.over_speed_s) = (0.0, 0.0);
        }
        self.check_i2t();
    }

    /// A fault: the motor goes off until FAULTR and AXISON.
    pub fn trip(&mut self, bit: u16, why: &'static str) {
        // A fault that lasts is reported once, so that FAULTR has something to clear.
        if self.status.mer & bit != 0 {
            return;
        }
        self.status.mer |= bit;
        self.status.isr |= match bit {
            mer::CONTROL => isr::CONTROL,
            mer::SHORT_CIRCUIT => isr::SHORT_CIRCUIT,
            _ => isr::PROTECTION,
        };
        set_bits(&mut self.status.srh, srh::FAULT, true);
        if self.shaft.servo.is_enabled() {
            self.notice = Some(why);
        }
        debug_assert!(self.status.mer != 0, "a trip leaves its bit");
        self.axis_off();
    }

    fn read_limits(&mut self) {
        let (m, slow_s) = (&self.memory, self.shaft.scale.slow_s);
        let per_rad = self.shaft.scale.per_rad;
        self.protections = Protections {
            limits_stale: false,
            masks: m.word(addresses::PCR),
            current_limit: units::amperes_of_units(m.int(addresses::IMAXPROT)),
            current_limit_s: slow_seconds(addresses::TIMAXPROT, slow_s, m),
            nominal: units::amperes_of_units(m.int(addresses::II2TPROT_M)),
            i2t_limit: f64::from(m.long(addresses::I2TINTLIM_M)) * I2T_A2S,
            error_limit: f64::from(m.word(addresses::ERRMAX)) / per_rad,
            error_limit_s: slow_seconds(addresses::TERRMAX, slow_s, m),
            speed_limit: self.shaft.scale.speed_of_counts(f64::from(m.word(addresses::SERRMAX))),
            speed_limit_s: slow_seconds(addresses::TSERRMAX, slow_s, m),
            supply_limits: (
                units::volts_of_units(m.word(addresses::UMINPROT)),
                units::volts_of_units(m.word(addresses::UMAXPROT)),
            ),
            temperature_limit: m.word(addresses::T2MAXPROT).into(),
            ..self.protections
        };
    }

    fn check_supply(&mut self) {
        let Protections { masks, supply_limits: (min, max), temperature_limit, .. } =
            self.protections;
        let supply = self.shaft.supply;
        // By the masks of PCR: a set-up may switch each protection off, and some do.
        if supply < min && masks & pcr::UNDER_VOLTAGE != 0 {
            self.trip(mer::UNDER_VOLTAGE, "under-voltage: motor off");
        } else if supply > max && masks & pcr::OVER_VOLTAGE != 0 {
            self.trip(mer::OVER_VOLTAGE, "over-voltage: motor off");
        }
        if self.shaft.stage.temperature() > temperature_limit && masks & pcr::DRIVE_HOT != 0 {
            self.trip(mer::DRIVE_HOT, "drive too hot: motor off");
        }
        if self.shaft.winding.temperature() > MOTOR_HOT_C && masks & pcr::MOTOR_HOT != 0 {
            self.trip(mer::MOTOR_HOT, "motor too hot: motor off");
        }
        if self.surroundings.hall_broken {
            self.status.der2 |= der2::HALL_MISSING;
            self.trip(mer::FEEDBACK, "hall sensors: motor off");
        }
    }

    fn check_current(&mut self) {
        let guard = &mut self.protections;
        let over = self.shaft.motor.current().abs() > guard.current_limit;
        let lasts = is_exceeded_too_long(over, &mut guard.over_current_s, guard.current_limit_s);
        if lasts && guard.masks & pcr::OVER_CURRENT != 0 {
            self.trip(mer::OVER_CURRENT, "over-current: motor off");
        }
        let broken =
            self.shaft.encoder.is_broken() && self.shaft.turn_since_break().abs() > BROKEN_WIRE_RAD;
        if broken && self.protections.masks & pcr::ENCODER != 0 {
            self.status.der |= der::ENCODER;
            self.trip(mer::FEEDBACK, "encoder: motor off");
        }
    }

    fn check_i2t(&mut self) {
        let guard = &mut self.protections;
        let (current, nominal) = (self.shaft.motor.current(), guard.nominal);
        let grown = guard.i2t_integral + (current * current - nominal * nominal) * TICK_S;
        // It cools below the nominal current, but never below cold.
        guard.i2t_integral = grown.max(0.0);
        if guard.i2t_limit <= 0.0 || guard.masks & pcr::I2T == 0 {
            return;
        }
        let (warns, trips) = (
            guard.i2t_integral > I2T_WARNS_AT * guard.i2t_limit,
            guard.i2t_integral > guard.i2t_limit,
        );
        set_bits(&mut self.status.srh, srh::I2T_WARNING, warns);
        if trips {
            self.trip(mer::I2T, "I2t: motor off");
        }
    }

    /// Control error: position error above ERRMAX for TERRMAX, in speed loops speed error above
    /// SERRMAX for TSERRMAX. Zero watches nothing. \[I\]
    fn check_control_errors(&mut self) {
        let (position, speed) = self.shaft.loop_errors();
        let guard = &mut self.protections;
        let far = guard.error_limit > 0.0 && position.abs() > guard.error_limit;
        let off = guard.speed_limit > 0.0 && speed.abs() > guard.speed_limit;
        let far = is_exceeded_too_long(far, &mut guard.over_error_s, guard.error_limit_s);
        let off = is_exceeded_too_long(off, &mut guard.over_speed_s, guard.speed_limit_s);
        if far || off {
            self.trip(mer::CONTROL, "control error: motor off");
        }
    }
}

fn slow_seconds(address: u16, slow_s: f64, m: &Memory) -> f64 {
    f64::from(m.word(address)) * slow_s
}
