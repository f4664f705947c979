//! How many data words follow an opcode: what the interpreter needs to walk through a program.

/// Data words of an instruction, `None` for an opcode that this firmware does not have.
///
/// A remote instruction (94xx) contains another; its words are counted by its own opcode.
pub(super) const fn words(opcode: u16) -> Option<usize> {
    Some(match opcode & 0xFC00 {
        0x0000 | 0x0400 => return control(opcode),
        0x0800 => return setting(opcode),
        0x1000 if opcode == 0x1000 => 0,
        0x1400 if opcode == 0x1401 || opcode == 0x1404 => 2,
        0x1800 => return point(opcode),
        0x1C00 => return call(opcode),
        0x2000 | 0x2800 | 0x2C00 | 0x3000 | 0x3400 | 0x3800 | 0x4000 | 0x4400 | 0x4800 | 0x5000
        | 0x5400 => 1,
        0x2400 | 0x3C00 | 0x4C00 | 0x5800 => 2,
        0x5C00 if opcode == 0x5C00 => 3,
        0x6400 if opcode == 0x649C => 0,
        0x7000 => return event(opcode),
        0x7400 => return jump(opcode),
        0x8000 => 0,
        0x8400 if opcode == 0x8400 => 2,
        0x8800 => {
            if opcode & 0x0140 == 0x0140 {
                2
            } else {
                return shift(opcode);
            }
        }
        0x8C00 => 2,
        0x9000 => return memory(opcode),
        0x9400 => return remote(opcode),
        0x9800 | 0x9C00 => 3,
        0xA000 | 0xA400 => 1,
        0xA800 => 2,
        0xAC00 => 3,
        0xB000 => 2,
        0xB400 => 3 + (opcode & 1) as usize,
        0xB800 | 0xBC00 | 0xE000 | 0xE400 => 2,
        0xC800 if opcode & 0x0380 == 0x0000 => 3,
        0xC800 if opcode & 0x0380 == 0x0100 => 2,
        0xD400 => return answer(opcode),
        0xD800 => return other(opcode),
        0xDC00 if opcode == 0xDC01 => 2,
        0xE800 | 0xEC00 => return ports(opcode),
        _ => return None,
    })
}

const fn control(opcode: u16) -> Option<usize> {
    match opcode {
        0x0000 | 0x0001 | 0x0002 | 0x0102 | 0x0020 | 0x0008 | 0x0108 | 0x00C4 | 0x0104 | 0x0144
        | 0x0184 | 0x01C4 | 0x0402 | 0x0404 | 0x0504 | 0x0410 | 0x0510 | 0x0408 | 0x0401
        | 0x0501 | 0x0481 | 0x0420 | 0x0520 | 0x04A0 | 0x0601 | 0x0701 | 0x0681 | 0x0620
        | 0x0720 | 0x06A0 => Some(0),
        0x0608 => Some(2),
        _ => None,
    }
}

const fn setting(opcode: u16) -> Option<usize> {
    match opcode {
        0x0801 | 0x0804 | 0x0810 | 0x0820 | 0x0840 | 0x0880 | 0x0901 | 0x0910 | 0x0920 | 0x0940
        | 0x0980 => Some(1),
        _ => None,
    }
}

const fn point(opcode: u16) -> Option<usize> {
    match opcode & 0x0380 {
        0x0000 => Some(4),
        0x0100 => Some(3),
        0x0080 if opcode == 0x1880 => Some(1),
        _ => None,
    }
}

const fn call(opcode: u16) -> Option<usize> {
    match opcode {
        0x1C01 | 0x1E01 => Some(1),
        0x1C02 | 0x1C04 | 0x1C08 | 0x1C81..=0x1C8A => Some(0),
        _ => None,
    }
}

const fn event(opcode: u16) -> Option<usize> {
    match opcode {
        0x700C..=0x700F => Some(0),
        0x70DA | 0x70DB => Some(1),
        _ => match opcode & 0xFF {
            0x81 | 0x83 | 0x85 | 0x87 | 0x90 | 0x92 | 0x94 | 0x96 | 0x98 | 0xB9 => {
                Some(if opcode & 0x100 == 0 { 3 } else { 2 })
            }
            _ => None,
        },
    }
}

const fn jump(opcode: u16) -> Option<usize> {
    match (opcode & 0xFF00, opcode & 0xFE) {
        (0x7400 | 0x7600, 0x00) => Some(1),
        (0x7400 | 0x7500, 0x82 | 0x84 | 0x88 | 0x90 | 0xA0 | 0xC0) => Some(2),
        _ => None,
    }
}

const fn shift(opcode: u16) -> Option<usize> {
    match opcode & 0x03E0 {
        0x0000 | 0x0020 | 0x0100 | 0x0120 => Some(1),
        0x0080 | 0x00A0 => Some(0),
        _ => None,
    }
}

/// 90xx writes, 91xx reads; bit 0 is 32 bits, bits 3 and 2 the space, bit 4 a variable as source.
const fn memory(opcode: u16) -> Option<usize> {
    match opcode {
        _ if opcode & 0x0C == 0x0C => None,
        0x9000..=0x90FF if opcode & 0x10 != 0 => Some(2),
        0x9000..=0x90FF => Some(2 + (opcode & 1) as usize),
        0x9100..=0x91FF => Some(2),
        _ => None,
    }
}

const fn remote(opcode: u16) -> Option<usize> {
    match opcode {
        0x9400..=0x9404 => Some(2 + (opcode & 7) as usize),
        0x9500 | 0x9600..=0x9603 => Some(0),
        _ => None,
    }
}

const fn answer(opcode: u16) -> Option<usize> {
    match opcode & 0xFF00 {
        0xD400 => Some(2),
        0xD500 => Some(3),
        0xD600 => Some(2),
        _ => None,
    }
}

const fn other(opcode: u16) -> Option<usize> {
    match opcode {
        0xD801 => Some(1),
        0xD840 | 0xD8C0 => Some(2),
        0xDA10 | 0xDA50 | 0xDB10 | 0xDB30 | 0xDB50 => Some(3),
        _ => None,
    }
}

const fn ports(opcode: u16) -> Option<usize> {
    match opcode {
        0xE800 | 0xEC00 | 0xED00 => Some(2),
        0xEE00 | 0xEF00 => Some(1),
        _ => None,
    }
}
