//! Messages between drives: instructions for others, and their variables.
//!
//! Source: the vendor's viewer, which gives text and bytes of each form. The messages on the wire are
//! inferred \[I\]: an instruction is sent unchanged, an assignment as an assignment of the value, a reading
//! as a request whose reply is awaited.

use super::drive::Drive;
use super::execute::ExecuteError;
use polepair_core::proto::tml::online::{Cell, MemorySpace as Space, OnlineMessage};
use polepair_core::proto::tml::wire::{IdCode, Instruction, low_first, operand_address};

type ExecuteResult = Result<(), ExecuteError>;

impl Drive {
    /// `[ag]{instruction}`: the words behind a 94xx.
    pub fn send_instruction(&mut self, words: &[u16]) {
        let done = match words {
            [to, opcode, data @ ..] => {
                match (IdCode::from_word(*to), Instruction::new(*opcode, data)) {
                    (Some(to), Some(instruction)) => self.send_or_execute(to, &instruction),
                    _ => Err(ExecuteError::NotPossible),
                }
            }
            _ => Err(ExecuteError::Unknown),
        };
        self.record_error(done);
    }

    /// B800, BC00: `[ag] V = V`.
    pub fn assign_remote(&mut self, i: &Instruction) -> ExecuteResult {
        let (to, operand) = (addressee(i)?, i.opcode & 0x3FF);
        let instruction = match i.opcode & 0x400 {
            0 => Instruction::of(0x2000 | operand, [self.memory.word(i.word(1))]),
            _ => {
                let value = self.memory.long(i.word(1)).cast_unsigned();
                Instruction::of(0x2400 | operand, low_first(value))
            }
        };
        self.send_or_execute(to, &instruction)
    }

    /// 98xx: `[ag] V,mem = V` and `[ag] (P),mem = V`.
    pub fn store_remote(&mut self, i: &Instruction) -> ExecuteResult {
        let (to, variable) = (addressee(i)?, i.word(1));
        let opcode = 0x9000 | i.opcode & 0xEF;
        let [low, high] = low_first(self.read_memory(Space::Data, i.word(2), opcode & 1 != 0));
        let instruction = match opcode & 1 {
            0 => Instruction::of(opcode, [variable, low]),
            _ => Instruction::of(opcode, [variable, low, high]),
        };
        self.send_or_execute(to, &instruction)
    }

    /// 9Cxx: `V = [ag] V,mem`. The message for access through a pointer (9Dxx) is not documented.
    pub fn fetch_remote(&mut self, i: &Instruction) -> ExecuteResult {
        if i.opcode & 0x100 != 0 {
            return Err(ExecuteError::Unknown);
        }
        let (to, long) = (addressee(i)?, i.opcode & 1 != 0);
        let memory = super::execute::space_of_opcode(i.opcode).ok_or(ExecuteError::Unknown)?;
        let cell = Cell { memory, address: i.word(1), long };
        self.request_value(
            to,
            &OnlineMessage::GiveMeData { sender: self.own_id(), cell },
            i.word(2),
            long,
        )
    }

    /// E000, E400: `V = [ag] V`.
    pub fn read_remote(&mut self, i: &Instruction) -> ExecuteResult {
        let (to, long) = (addressee(i)?, i.opcode & 0x400 != 0);
        let address = operand_address(i.opcode);
        self.request_value(
            to,
            &OnlineMessage::GetData { sender: self.own_id(), address, long },
            i.word(1),
            long,
        )
    }

    /// An instruction for others, or for this drive itself.
    fn send_or_execute(&mut self, to: IdCode, instruction: &Instruction) -> ExecuteResult {
        if !to.group && to.id == self.axis {
            return self.execute_instruction(instruction);
        }
        self.send(to, *instruction);
        Ok(())
    }

    fn request_value(
        &mut self,
        to: IdCode,
        request: &OnlineMessage,
        variable: u16,
        long: bool,
    ) -> ExecuteResult {
        self.send(to, request.emit());
        self.wait_for_answer(variable, long);
        Ok(())
    }
}

fn addressee(i: &Instruction) -> Result<IdCode, ExecuteError> {
    IdCode::from_word(i.word(0)).ok_or(ExecuteError::NotPossible)
}
