//! Checks of a write to registers, before anything is changed.

use super::*;

impl DriveCore {
    pub(super) fn check_value(&self, number: u16, value: u16) -> Result<(), RegisterError> {
        if usize::from(number) >= FN_COUNT || !self.options.variant.has_register(number) {
            return Err(RegisterError::Address);
        }
        let (min, max, signed) = write_limits(self.profile, number);
        let new_value = if signed { i64::from(value as i16) } else { i64::from(value) };
        let fits = (min..=max).contains(&new_value);
        let listed = match number {
            fn_registers::FORMAT => self.options.accepts_format(value),
            fn_registers::MODE => self.options.variant.has_mode(value),
            _ => true,
        };
        if fits && listed { Ok(()) } else { Err(RegisterError::Value) }
    }

    /// Ta/2 must be greater than Ts (§2.6.1), by the values that the write would leave `[I]`.
    pub(super) fn check_s_times(&self, start: u16, values: &[u16]) -> Result<(), RegisterError> {
        let clash = (0..32).any(|path| {
            let (ta, ts) = (fn_registers::PATHS + 8 * path + 4, fn_registers::S_TIMES + path);
            (is_touched(ta, start, values) || is_touched(ts, start, values))
                && !s_time_fits(
                    self.register_after(ta, start, values),
                    self.register_after(ts, start, values),
                )
        });
        if clash { Err(RegisterError::Value) } else { Ok(()) }
    }

    fn register_after(&self, number: u16, start: u16, values: &[u16]) -> u16 {
        let written = number.checked_sub(start).and_then(|at| values.get(usize::from(at)));
        written.copied().unwrap_or_else(|| self.registers.value(number))
    }
}

fn is_touched(number: u16, start: u16, values: &[u16]) -> bool {
    number.checked_sub(start).is_some_and(|at| usize::from(at) < values.len())
}
