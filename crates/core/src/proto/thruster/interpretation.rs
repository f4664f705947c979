//! Ambiguous parts of the manual, selected by the profile.
//!
//! Example traces of section 2.4 have bit 0 of VM's flags as "no header" and bit 1 as "no reply"; its table has them
//! swapped. The names of VM's values in the profile decide. The third report has six bytes for two positions: 16 and 32
//! bits if the profile's absolute position has 16 bits, 24 and 24 if it has 32.

use super::wire::{CommandWord, ReportFrame};
use crate::profile::{Encoding, Parameter, Profile};

/// The readings of a profile; by default those of the examples.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Interpretation {
    /// VM's flags are as in the table, not as in the examples.
    pub table_flags: bool,
    /// Both positions of the third report have 24 bits.
    pub even_positions: bool,
}

/// Format of the replies to TC and VC.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum ReplyFormat {
    /// The command again: as from power-up.
    #[default]
    Echo,
    /// One frame without a header.
    Headerless,
    /// Nothing.
    Silent,
    /// Up to three frames with headers; bit n is frame n + 1. Never none.
    Frames(u8),
}

impl Interpretation {
    /// The format in a profile.
    #[must_use]
    pub fn of(profile: &Profile) -> Self {
        let of_command = |command: CommandWord| move |p: &&Parameter| is_command(p, command);
        let find = |command| profile.parameters.iter().find(of_command(command));
        Self {
            table_flags: find(CommandWord::VM).is_some_and(is_silent_table),
            even_positions: find(CommandWord::QA).is_some_and(|p| p.encoding == Encoding::I32),
        }
    }

    /// Bits of VM's first byte: no header, no reply.
    #[must_use]
    pub const fn flags(self) -> (u16, u16) {
        if self.table_flags { (0x0200, 0x0100) } else { (0x0100, 0x0200) }
    }

    /// The format in a value of VM, flags above frames.
    #[must_use]
    pub const fn reply_format(self, value: u16) -> ReplyFormat {
        let (headerless, silent) = self.flags();
        match value as u8 & 0x07 {
            _ if value & silent != 0 => ReplyFormat::Silent,
            _ if value & headerless != 0 => ReplyFormat::Headerless,
            0 => ReplyFormat::Echo,
            frames => ReplyFormat::Frames(frames),
        }
    }

    /// Absolute and relative position of a third report, tenths of a degree.
    #[must_use]
    pub const fn positions(self, report: &ReportFrame) -> (i32, i32) {
        let [a, b, c] = report.words;
        if self.even_positions {
            let all = (a as u64) << 48 | (b as u64) << 32 | (c as u64) << 16;
            let all = all.cast_signed();
            return ((all >> 40) as i32, (all << 24 >> 40) as i32);
        }
        (a.cast_signed() as i32, ((b as u32) << 16 | c as u32).cast_signed())
    }

    /// The words of a third report.
    #[must_use]
    pub const fn position_words(self, absolute: i32, relative: i32) -> [u16; 3] {
        let relative = relative.cast_unsigned();
        if self.even_positions {
            let absolute = absolute.cast_unsigned();
            let middle = absolute << 8 & 0xFF00 | relative >> 16 & 0xFF;
            return [(absolute >> 8) as u16, middle as u16, relative as u16];
        }
        [absolute as u16, (relative >> 16) as u16, relative as u16]
    }
}

fn is_silent_table(vm: &Parameter) -> bool {
    vm.values.iter().any(|(raw, name)| *raw == 0x0100 && *name == "silent")
}

/// Returns whether a command of the manual reads or writes a parameter.
#[must_use]
pub const fn is_command(parameter: &Parameter, command: CommandWord) -> bool {
    parameter.space == 0 && parameter.index == command.0
}
