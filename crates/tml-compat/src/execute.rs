//! Instructions of TML for the selected axis or group.

use polepair::LocalAxis;
use polepair_core::convert::text_from;
use polepair_core::profile::Profile;
use polepair_core::proto::AxisNumber;
use polepair_core::proto::tml::instruction::{
    LanguageScope, Variable, VariableKind, assemble, find_by_name,
};
use polepair_core::proto::tml::wire::Instruction;

use crate::call::{CallResult, TmlError, note_sent};

/// The axis or group that commands are for.
pub struct Target {
    /// The axis of the link.
    pub axis: LocalAxis,
    /// Names of its variables.
    pub setup: &'static Profile,
    /// True if its wire lets drives send without being asked.
    pub may_send_unasked: bool,
}

impl Target {
    /// Sends instructions, separated by `;` or lines. All of them are checked before the first is sent.
    pub fn execute(&self, text: &str) -> CallResult<()> {
        let assembled: Vec<(&str, Instruction)> = statements(text)
            .into_iter()
            .map(|statement| Ok((statement, self.assemble(statement)?)))
            .collect::<CallResult<_>>()?;
        for (statement, instruction) in &assembled {
            self.send(statement, instruction)?;
            note_sent(statement);
        }
        Ok(())
    }

    /// Sends one instruction that asks, and returns what the drive answers.
    pub fn query(&self, text: &str) -> CallResult<i64> {
        self.check_single("a value")?;
        self.send(text, &self.assemble(text)?)
    }

    /// Refuses a group, which does not answer.
    pub fn check_single(&self, what: &str) -> CallResult<()> {
        let number = AxisNumber(self.axis.number());
        if number.is_group() {
            return Err(TmlError::new(format!(
                "{what} is read from one axis, and {number} is selected: call TS_SelectAxis first"
            )));
        }
        Ok(())
    }

    fn assemble(&self, statement: &str) -> CallResult<Instruction> {
        let scope = LanguageScope { profile: Some(self.setup), ..LanguageScope::default() };
        assemble(statement, &scope).map_err(|wrong| {
            let place = match text_from(statement, wrong.at).trim() {
                "" => "at its end".to_owned(),
                rest => format!("at `{rest}`"),
            };
            TmlError::new(format!("`{statement}`: expected {} {place}", wrong.expected))
        })
    }

    /// Words instead of text, because the link does not know the set-up's names.
    fn send(&self, statement: &str, instruction: &Instruction) -> CallResult<i64> {
        let mut words = format!(".word 0x{:04X}", instruction.opcode);
        for word in instruction.data() {
            words += &format!(", 0x{word:04X}");
        }
        self.arm();
        let answer = self.axis.raw(&words);
        answer.map_err(|error| TmlError::of_instruction(&error, &words, statement))
    }

    /// Arms the axis: the call is the program's order. A drive that restarted is not armed any more.
    pub fn arm(&self) {
        if !self.axis.state().armed {
            self.axis.arm(true);
        }
    }

    /// A variable of the set-up.
    pub fn variable(&self, name: &str) -> CallResult<Variable> {
        find_by_name(Some(self.setup), name.trim()).ok_or_else(|| {
            TmlError::new(format!("the set-up {} has no variable {name}", self.setup.name))
        })
    }

    /// Reads a variable of one of these kinds.
    pub fn read_variable(&self, name: &str, kinds: &[VariableKind]) -> CallResult<i64> {
        let variable = self.variable(name)?;
        if !kinds.contains(&variable.kind) {
            return Err(wrong_kind(name, variable.kind));
        }
        self.read(name, variable)
    }

    /// Reads a variable.
    pub fn read(&self, name: &str, variable: Variable) -> CallResult<i64> {
        self.check_single(name)?;
        // GiveMeData; the host fills in the sender.
        let opcode = if variable.kind.is_long() { 0xB005 } else { 0xB004 };
        let request = Instruction::new(opcode, &[0, variable.address]);
        let request = request.ok_or_else(|| TmlError::new("a request that does not exist"))?;
        self.send(&format!("?{name}"), &request)
    }

    /// Writes a variable of one of these kinds.
    pub fn write_variable(
        &self,
        name: &str,
        kinds: &[VariableKind],
        value: impl std::fmt::Display,
    ) -> CallResult<()> {
        let kind = self.variable(name)?.kind;
        if !kinds.contains(&kind) {
            return Err(wrong_kind(name, kind));
        }
        self.execute(&format!("{} = {value}", name.trim()))
    }

    /// The status register with these bits, read until `done`. A fault of the drive ends the wait.
    pub fn wait_for(&self, done: impl Fn(&Self) -> CallResult<bool>) -> CallResult<()> {
        loop {
            if done(self)? {
                return Ok(());
            }
            if self.read_variable("SRH", &WORDS)? & SRH_FAULT != 0 {
                let error = self.read_variable("MER", &WORDS)? as u16;
                return Err(TmlError::new(format!(
                    "the drive has a fault and the wait was ended: MER is 0x{error:04X}"
                )));
            }
            self.axis.sleep(POLL_INTERVAL);
        }
    }
}

/// SRH.15: the drive has a fault.
const SRH_FAULT: i64 = 1 << 15;
/// Pause between two reads of a status.
const POLL_INTERVAL: std::time::Duration = std::time::Duration::from_millis(5);

/// Variables of 16 bits.
pub const WORDS: [VariableKind; 2] = [VariableKind::Int, VariableKind::Uint];
/// Whole numbers of 32 bits.
pub const LONGS: [VariableKind; 2] = [VariableKind::Long, VariableKind::Ulong];

fn wrong_kind(name: &str, kind: VariableKind) -> TmlError {
    let function = match kind {
        VariableKind::Fixed => "Fixed",
        kind if kind.is_long() => "Long",
        _ => "Int",
    };
    let kind = kind.name();
    TmlError::new(format!(
        "{name} is {kind}: use TS_Get{function}Variable or TS_Set{function}Variable"
    ))
}

/// Statements of a text: `;` and line ends separate them, outside of braces; `//` begins a comment.
fn statements(text: &str) -> Vec<&str> {
    let mut found = Vec::new();
    for line in text.lines() {
        let line = line.split_once("//").map_or(line, |(code, _)| code);
        let (mut depth, mut begin) = (0_u32, 0);
        for (at, sign) in line.char_indices() {
            match sign {
                '{' => depth += 1,
                '}' => depth = depth.saturating_sub(1),
                ';' if depth == 0 => {
                    found.push(&line[begin..at]);
                    begin = at + 1;
                }
                _ => {}
            }
        }
        found.push(&line[begin..]);
    }
    found.retain_mut(|statement| {
        *statement = statement.trim();
        !statement.is_empty()
    });
    found
}

#[cfg(test)]
mod tests {
    use super::statements;

    #[test]
    fn semicolons_and_lines_separate_statements() {
        let text = "MODE PP; CPOS = 5 // far\n\n [G1]{STOP;} ;UPD;";
        assert_eq!(statements(text), ["MODE PP", "CPOS = 5", "[G1]{STOP;}", "UPD"]);
        assert!(statements(" ;; // nothing\n").is_empty());
    }
}
