//! Several motors behind one address, at places of their own: the profile is read once for each, with its value of
//! each list.

use crate::toml_file::{FileError, Located, TomlTable};

/// The motor for which a profile is read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct MotorChoice {
    /// Counted from 0.
    pub number: usize,
    /// Motors behind the address.
    pub count: usize,
}

impl MotorChoice {
    /// The place on the wire: one for all motors, or a list with one for each.
    pub(super) fn read_index(self, table: &TomlTable<'_, '_>) -> Result<u16, FileError> {
        let found = match self.read_integer(table, "index")? {
            Some(found) => found,
            None => table.required_integer("index")?,
        };
        found.try_map(|n| {
            u16::try_from(n).map_err(|_| format!("`index` is {n}; it must be 0 to 65535"))
        })
    }

    /// A number: one for all motors, or a list with one for each.
    pub(super) fn read_integer(
        self,
        table: &TomlTable<'_, '_>,
        key: &str,
    ) -> Result<Option<Located<i64>>, FileError> {
        if !table.is_list(key) {
            return table.integer(key);
        }
        let all = table.whole_numbers(key, u32::MAX)?;
        let value = *self.value_of(&all).map_err(|reason| table.location().error(reason))?;
        Ok(Some(Located { value: value.into(), location: table.location() }))
    }

    /// Steps with the value of this motor in place of each `[A, B]`.
    pub(super) fn choose_all(
        self,
        steps: Vec<Located<String>>,
    ) -> Result<Vec<Located<String>>, FileError> {
        let choose = |step: Located<String>| {
            let location = step.location.clone();
            let value = step.try_map(|text| self.choose(text))?;
            Ok(Located { value, location })
        };
        steps.into_iter().map(choose).collect()
    }

    /// The text keeps its length, so that what is wrong behind a list is still found at its place.
    fn choose(self, mut text: String) -> Result<String, String> {
        while let Some(start) = text.find('[') {
            let len = text[start..].find(']').ok_or("`[` has no `]`")? + 1;
            let list: Vec<&str> = text[start + 1..start + len - 1].split(',').collect();
            let value = self.value_of(&list)?.trim();
            text.replace_range(start..start + len, &format!("{value:len$}"));
        }
        Ok(text)
    }

    fn value_of<T>(self, list: &[T]) -> Result<&T, String> {
        let (found, motors) = (list.len(), self.count);
        let value = list.get(self.number).filter(|_| found == motors);
        value.ok_or_else(|| {
            format!("a list of {found} values, one for each motor: `motors` is {motors}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::parse;
    use polepair_core::axis::Verb;
    use polepair_core::plan::{Operand, Step};
    use polepair_core::profile::{ParameterId, Profile, Signal};

    #[test]
    fn motors_of_a_node_may_be_sub_indices() {
        let text = r#"
name = "can-wheels"
protocol = "canopen"
motors = 2

[[parameter]]
name = "speed"
index = 0x60FF
sub = [1, 2]
encoding = "i32"

[[parameter]]
name = "state"
index = 0x6041

[[fault]]
code = [0x10, 0x100000]
name = "hot"
text = "Too hot"

[signals]
enabled = { parameter = "state", mask = [0x6F, 0x6F0000], equals = [0x27, 0x270000] }
"#;
        let left = parse("can-wheels.toml", text).unwrap();
        let right = left.of_motor(1);
        let seen = |profile: &Profile| {
            let enabled = profile.signal(Signal::Enabled).unwrap();
            (profile.parameters[0].space, enabled.mask, enabled.equals, profile.faults[0].code)
        };
        assert_eq!(seen(left), (1, 0x6F, Some(0x27), 0x10));
        assert_eq!(seen(right), (2, 0x6F_0000, Some(0x27_0000), 0x10_0000));
        let wrong = text.replace("[1, 2]", "[1, 2, 3]");
        let error = parse("can-wheels.toml", &wrong).unwrap_err().to_string();
        assert!(error.contains("a list of 3 values, one for each motor: `motors` is 2"), "{error}");
    }

    #[test]
    fn each_motor_behind_an_address_has_its_own_registers() {
        let text = r#"
name = "wheels"
protocol = "modbus"
motors = 2

[[parameter]]
name = "speed"
index = [0x2088, 0x2089]
encoding = "i16"

[[parameter]]
name = "start"
index = 0x200E

[plans.stop]
steps = ["write speed = 0", "write start = [0x11, 0x12]"]
"#;
        let left = parse("wheels.toml", text).unwrap();
        let [right] = left.further_motors else { panic!("two motors") };
        let speed_of = |profile: &Profile| profile.parameters[0].index;
        assert_eq!((speed_of(left), speed_of(right)), (0x2088, 0x2089));
        let start_of = |profile: &Profile| profile.plan(Verb::Stop).unwrap().steps[1];
        let start = |raw| Step::Write(ParameterId(1), Operand::Constant(raw));
        assert_eq!((start_of(left), start_of(right)), (start(0x11), start(0x12)));
        assert!(std::ptr::eq(left.of_motor(1), *right) && std::ptr::eq(left.of_motor(0), left));
        for (from, to, error) in [
            ("[0x2088, 0x2089]", "[0x2088]", "a list of 1 values"),
            ("[0x11, 0x12]", "[0x11, 0x12, 0x13]", "a list of 3 values"),
            ("motors = 2\n", "", "`motors` is 1"),
            ("0x12]", "0x12", "`[` has no `]`"),
            ("[0x2088, 0x2089]", "[0x2088, 70000]", "must be 0 to 65535"),
            ("[0x11, 0x12]", "[0x11, left]", "`left`"),
        ] {
            let refused =
                parse("wheels.toml", &text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(refused.contains(error), "{to}: {refused}");
        }
    }
}
