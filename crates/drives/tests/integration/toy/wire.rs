//! Frames ↔ values.

use polepair_core::medium::Frame;

const REQUESTS: u32 = 0x300;
const REPLIES: u32 = 0x380;

/// Contents of a frame, in both directions.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ToyMessage {
    pub address: u8,
    pub writes: bool,
    pub register: u8,
    pub value: i32,
}

impl ToyMessage {
    pub fn request(&self) -> Frame {
        self.frame(REQUESTS)
    }

    pub fn reply(&self) -> Frame {
        self.frame(REPLIES)
    }

    pub fn parse_request(frame: &Frame) -> Option<Self> {
        Self::parse(frame, REQUESTS)
    }

    pub fn parse_reply(frame: &Frame) -> Option<Self> {
        Self::parse(frame, REPLIES)
    }

    fn frame(&self, base: u32) -> Frame {
        let mut bytes = [u8::from(self.writes), self.register, 0, 0, 0, 0, 0, 0];
        bytes[4..].copy_from_slice(&self.value.to_le_bytes());
        Frame::standard((base + u32::from(self.address)) as u16, &bytes)
    }

    fn parse(frame: &Frame, base: u32) -> Option<Self> {
        let address = u8::try_from(frame.id.checked_sub(base)?).ok().filter(|a| *a < 0x80)?;
        let bytes: [u8; 8] = frame.bytes().try_into().ok()?;
        let value = i32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
        Some(Self { address, writes: bytes[0] == 1, register: bytes[1], value })
    }
}
