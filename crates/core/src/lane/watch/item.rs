//! The readings of a wait, one bit for each.

/// Something that is read while a motion is waited for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(u8)]
pub enum Item {
    Flag,
    Position,
    Velocity,
    Fault,
    Enabled,
    PositiveLimit,
    NegativeLimit,
    Mode,
    TargetPosition,
    Window,
    Halted,
    Stalled,
}

impl Item {
    pub const ALL: [Self; 12] = [
        Self::Flag,
        Self::Position,
        Self::Velocity,
        Self::Fault,
        Self::Enabled,
        Self::PositiveLimit,
        Self::NegativeLimit,
        Self::Mode,
        Self::TargetPosition,
        Self::Window,
        Self::Halted,
        Self::Stalled,
    ];
    pub const BEFORE: u16 = bits(&[Self::Flag, Self::Position]);
    pub const MEASURED: u16 = bits(&[Self::Position, Self::Velocity]);
    pub const SAFETY: u16 =
        bits(&[Self::Fault, Self::Enabled, Self::PositiveLimit, Self::NegativeLimit, Self::Mode]);
    pub const REASONS: u16 = Self::SAFETY | bits(&[Self::Halted, Self::Stalled]);
}

pub const fn bits(items: &[Item]) -> u16 {
    let (mut mask, mut at) = (0, 0);
    while at < items.len() {
        mask |= 1 << items[at] as u16;
        at += 1;
    }
    mask
}
