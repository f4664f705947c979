//! What switches the motor off: protections with their limits, times and masks.
//!
//! Source: the help pages on MER, PCR and DER; drive manuals, chapter 6, for the units.

use super::at;
use super::drive::Drive;
use super::status::{der, der2, isr, mer, put, srh};
use super::units::{self, I2T_A2S};
use crate::plant::TICK_S;

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
pub(super) struct Guard {
    /// A setting was written since these were worked out.
    pub old: bool,
    masks: u16,
    current: f64,
    current_s: f64,
    nominal: f64,
    i2t: f64,
    error: f64,
    error_s: f64,
    speed: f64,
    speed_s: f64,
    volts: (f64, f64),
    celsius: f64,
    over_current_s: f64,
    over_error_s: f64,
    over_speed_s: f64,
    /// The I2t integral, A²·s.
    heat: f64,
}

impl Guard {
    /// Limits still to be read.
    pub const NEW: Self = Self {
        old: true,
        masks: 0,
        current: 0.0,
        current_s: 0.0,
        nominal: 0.0,
        i2t: 0.0,
        error: 0.0,
        error_s: 0.0,
        speed: 0.0,
        speed_s: 0.0,
        volts: (0.0, 0.0),
        celsius: 0.0,
        over_current_s: 0.0,
        over_error_s: 0.0,
        over_speed_s: 0.0,
        heat: 0.0,
    };

    /// The I2t integral in the drive's units (I2TINT_M).
    pub fn i2t_units(&self) -> i32 {
        (self.heat / I2T_A2S) as i32
    }
}

/// A limit that is passed for longer than allowed.
fn lasts(passed: bool, since: &mut f64, allowed_s: f64) -> bool {
    *since = if passed { *since + TICK_S } else { 0.0 };
    *since > allowed_s
}

impl Drive {
    /// Watches a tick. \[I\] Which limit trips first is the order here.
    #[inline]
    pub fn watch(&mut self) {
        if self.guard.old {
            self.read_limits();
            self.read_limit_switches();
        }
        self.watch_supply();
        if self.shaft.servo.is_enabled() {
            self.watch_current();
            self.watch_errors();
        } else {
            (self.guard.over_error_s, self.guard.over_speed_s) = (0.0, 0.0);
        }
        self.watch_i2t();
    }

    /// A fault: the motor goes off until FAULTR and AXISON.
    pub fn trip(&mut self, bit: u16, why: &'static str) {
        if self.status.mer & bit != 0 {
            return;
        }
        self.status.mer |= bit;
        self.status.isr |= match bit {
            mer::CONTROL => isr::CONTROL,
            mer::SHORT_CIRCUIT => isr::SHORT_CIRCUIT,
            _ => isr::PROTECTION,
        };
        put(&mut self.status.srh, srh::FAULT, true);
        if self.shaft.servo.is_enabled() {
            self.notice = Some(why);
        }
        self.axis_off();
    }

    fn read_limits(&mut self) {
        let (m, slow_s) = (&self.memory, self.shaft.scale.slow_s);
        let seconds = |address| f64::from(m.word(address)) * slow_s;
        let per_rad = self.shaft.scale.per_rad;
        self.guard = Guard {
            old: false,
            masks: m.word(at::PCR),
            current: units::ampere(m.int(at::IMAXPROT)),
            current_s: seconds(at::TIMAXPROT),
            nominal: units::ampere(m.int(at::II2TPROT_M)),
            i2t: f64::from(m.long(at::I2TINTLIM_M)) * I2T_A2S,
            error: f64::from(m.word(at::ERRMAX)) / per_rad,
            error_s: seconds(at::TERRMAX),
            speed: self.shaft.scale.speed(f64::from(m.word(at::SERRMAX))),
            speed_s: seconds(at::TSERRMAX),
            volts: (units::volt(m.word(at::UMINPROT)), units::volt(m.word(at::UMAXPROT))),
            celsius: m.word(at::T2MAXPROT).into(),
            ..self.guard
        };
    }

    fn watch_supply(&mut self) {
        let Guard { masks, volts: (least, most), celsius, .. } = self.guard;
        let supply = self.shaft.supply;
        if supply < least && masks & pcr::UNDER_VOLTAGE != 0 {
            self.trip(mer::UNDER_VOLTAGE, "under-voltage: motor off");
        } else if supply > most && masks & pcr::OVER_VOLTAGE != 0 {
            self.trip(mer::OVER_VOLTAGE, "over-voltage: motor off");
        }
        if self.shaft.stage.temperature() > celsius && masks & pcr::DRIVE_HOT != 0 {
            self.trip(mer::DRIVE_HOT, "drive too hot: motor off");
        }
        if self.shaft.winding.temperature() > MOTOR_HOT_C && masks & pcr::MOTOR_HOT != 0 {
            self.trip(mer::MOTOR_HOT, "motor too hot: motor off");
        }
        if self.around.hall_broken {
            self.status.der2 |= der2::HALL_MISSING;
            self.trip(mer::FEEDBACK, "hall sensors: motor off");
        }
    }

    fn watch_current(&mut self) {
        let guard = &mut self.guard;
        let over = self.shaft.motor.current().abs() > guard.current;
        let lasts = lasts(over, &mut guard.over_current_s, guard.current_s);
        if lasts && guard.masks & pcr::OVER_CURRENT != 0 {
            self.trip(mer::OVER_CURRENT, "over-current: motor off");
        }
        let broken = self.shaft.encoder.is_broken() && self.shaft.missed().abs() > BROKEN_WIRE_RAD;
        if broken && self.guard.masks & pcr::ENCODER != 0 {
            self.status.der |= der::ENCODER;
            self.trip(mer::FEEDBACK, "encoder: motor off");
        }
    }

    fn watch_i2t(&mut self) {
        let guard = &mut self.guard;
        let (current, nominal) = (self.shaft.motor.current(), guard.nominal);
        let grown = guard.heat + (current * current - nominal * nominal) * TICK_S;
        guard.heat = grown.max(0.0);
        if guard.i2t <= 0.0 || guard.masks & pcr::I2T == 0 {
            return;
        }
        let (warns, trips) = (guard.heat > I2T_WARNS_AT * guard.i2t, guard.heat > guard.i2t);
        put(&mut self.status.srh, srh::I2T_WARNING, warns);
        if trips {
            self.trip(mer::I2T, "I2t: motor off");
        }
    }

    /// Control error: position error above ERRMAX for TERRMAX, in speed loops speed error above
    /// SERRMAX for TSERRMAX. Zero watches nothing. \[I\]
    fn watch_errors(&mut self) {
        let (position, speed) = self.shaft.errors();
        let guard = &mut self.guard;
        let far = guard.error > 0.0 && position.abs() > guard.error;
        let off = guard.speed > 0.0 && speed.abs() > guard.speed;
        let far = lasts(far, &mut guard.over_error_s, guard.error_s);
        let off = lasts(off, &mut guard.over_speed_s, guard.speed_s);
        if far || off {
            self.trip(mer::CONTROL, "control error: motor off");
        }
    }
}
