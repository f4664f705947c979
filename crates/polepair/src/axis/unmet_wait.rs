//! Reasons of waits that ended without the expected state, in the words of the profile.

use super::LocalAxis;
use super::failure::value_word;
use polepair_core::axis::UnmetWait;
use polepair_core::plan::Compare;
use polepair_core::profile::{Parameter, Signal, bit_names};

/// Hint for a drive that another of its interfaces controls (CiA 402-2, bit 9 of the statusword).
const REMOTE_HINT: &str =
    "the drive is controlled by its panel or its inputs (bit `remote` is 0): switch it to the bus";
/// Hint for a drive that refuses another mode of operation.
pub(super) const MODE_HINT: &str =
    "some drives change their mode only without power: `polepair disable` first";

impl LocalAxis {
    /// The expected state of a wait, and the state that was read instead.
    pub(super) fn unmet_wait_reason(&self) -> (String, String) {
        const HINT: &str = "check whether something blocks it";
        let unmet = self.connection.with_axes(|axes, _| axes.unmet_wait(self.index));
        let unmet = unmet.and_then(|unmet| Some((unmet, self.parameter(unmet.parameter)?)));
        let Some((unmet, parameter)) = unmet else {
            return ("not reached in time".to_owned(), HINT.to_owned());
        };
        let UnmetWait { test, value, .. } = unmet;
        let (name, wanted) = (parameter.name, test.value);
        let reason = match (test.compare, test.mask) {
            (compare, mask) if mask != -1 && !parameter.bits.is_empty() => {
                unmet_bits_reason(parameter, compare == Compare::Equal, mask, wanted, value)
            }
            (Compare::Equal, -1) => {
                format!(
                    "`{name}` stayed {}, not {}",
                    value_word(value, parameter.values),
                    value_word(wanted, parameter.values)
                )
            }
            (Compare::Equal, mask) if mask != -1 => {
                format!("`{name}` stayed 0x{value:X}, its bits 0x{mask:X} not 0x{wanted:X}")
            }
            (Compare::NotEqual, mask) if mask != -1 => {
                format!("`{name}` stayed 0x{value:X}, its bits 0x{mask:X} still 0x{wanted:X}")
            }
            _ => format!("`{name}` stayed {}", value_word(value, parameter.values)),
        };
        let mode = self.profile.signal(Signal::Mode).map(|source| source.parameter);
        let remote = parameter.bits.iter().find(|known| known.name == "remote");
        let hint = match remote {
            _ if mode == Some(unmet.parameter) => MODE_HINT,
            Some(remote) if value & remote.mask != remote.value => REMOTE_HINT,
            _ => HINT,
        };
        (format!("not reached in time: {reason}"), hint.to_owned())
    }
}

/// A wait for bits that have names: the one that did not change, or the state that did not come.
fn unmet_bits_reason(
    parameter: &Parameter,
    equal: bool,
    mask: i64,
    wanted: i64,
    value: i64,
) -> String {
    let name = parameter.name;
    let names = bit_names(parameter.bits, value).collect::<Vec<_>>().join(", ");
    let now = format!("`{name}` stayed 0x{value:X} ({names})");
    if mask.count_ones() == 1 {
        let bit = mask.trailing_zeros();
        let own = parameter.bits.iter().find(|known| known.bit() == Some(bit));
        let own = own.map_or("", |known| known.name);
        let label = match own {
            "" => format!("bit {bit}"),
            own if own.starts_with("bit ") => own.to_owned(),
            own => format!("bit {bit} ({own})"),
        };
        let is_set = value & mask != 0;
        let what = if is_set { "stayed set" } else { "did not come" };
        return format!("{label} {what}; {now}");
    }
    let of_state = |raw: i64| {
        let mut states = parameter.bits.iter().filter(|known| known.mask & !mask == 0);
        states.find(|known| raw & known.mask == known.value).map(|known| known.name)
    };
    match (equal, of_state(wanted)) {
        (true, Some(state)) => format!("{state:?} did not come; {now}"),
        (false, Some(state)) => format!("{state:?} stayed; {now}"),
        (true, None) => format!("{now}, its bits 0x{mask:X} not 0x{wanted:X}"),
        (false, None) => format!("{now}, its bits 0x{mask:X} still 0x{wanted:X}"),
    }
}

#[cfg(test)]
mod tests {
    use super::unmet_bits_reason;
    use polepair_core::profile::Profile;

    #[test]
    fn a_bit_and_a_state_are_named() {
        let known = polepair_drives::profiles();
        let cia402: &Profile =
            known.iter().find(|profile| profile.name == "cia402").expect("known");
        let id = cia402.find_parameter("statusword").expect("known");
        let statusword = cia402.parameter(id).expect("known");
        let reason =
            |equal, mask, wanted, value| unmet_bits_reason(statusword, equal, mask, wanted, value);
        assert_eq!(
            reason(true, 0x400, 0x400, 0x0A37),
            "bit 10 (target reached) did not come; `statusword` stayed 0xA37 (operation enabled, \
             voltage enabled, remote, internal limit)"
        );
        assert_eq!(
            reason(true, 0x6F, 0x27, 0x0218),
            "\"operation enabled\" did not come; `statusword` stayed 0x218 (fault, voltage \
             enabled, remote)"
        );
        assert!(reason(true, 0x1000, 0, 0x1037).starts_with("bit 12 (set-point taken"));
        assert!(reason(true, 0x1000, 0, 0x1037).contains("stayed set"));
    }
}
