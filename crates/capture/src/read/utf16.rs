//! Text in UTF-16, as PowerShell redirects output.

use core::char::REPLACEMENT_CHARACTER;

/// Converts a stream to UTF-8.
#[derive(Debug)]
pub(super) struct Utf16Decoder {
    big_endian: bool,
    /// First byte of a unit that was cut.
    half: Option<u8>,
    /// First half of a character outside the basic plane.
    surrogate: Option<u16>,
}

impl Utf16Decoder {
    /// A decoder for a text that begins with a byte order mark.
    pub fn detect(head: &[u8]) -> Option<Self> {
        let big_endian = match head {
            [0xFF, 0xFE, ..] => false,
            [0xFE, 0xFF, ..] => true,
            _ => return None,
        };
        Some(Self { big_endian, half: None, surrogate: None })
    }

    /// Converts a piece.
    pub fn decode(&mut self, piece: &[u8]) -> Vec<u8> {
        let mut text = String::with_capacity(piece.len() / 2);
        for byte in piece {
            let Some(first) = self.half.replace(*byte) else { continue };
            self.half = None;
            let pair = [first, *byte];
            let unit =
                if self.big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) };
            let units = self.surrogate.take().into_iter().chain([unit]);
            if matches!(unit, 0xD800..0xDC00) && units.clone().count() == 1 {
                self.surrogate = Some(unit);
                continue;
            }
            text.extend(char::decode_utf16(units).map(|c| c.unwrap_or(REPLACEMENT_CHARACTER)));
        }
        text.into_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::Utf16Decoder;

    #[test]
    fn text_in_either_order_cut_anywhere() {
        let text = "\u{FEFF}(1.5) can0 601#40 発→◇ \u{1F600}\r\n";
        for big in [false, true] {
            let order = |unit: u16| if big { unit.to_be_bytes() } else { unit.to_le_bytes() };
            let file: Vec<u8> = text.encode_utf16().flat_map(order).collect();
            for cut in 0..=file.len() {
                let mut decoder = Utf16Decoder::detect(&file).expect("a mark");
                let mut found = decoder.decode(&file[..cut]);
                found.extend(decoder.decode(&file[cut..]));
                assert_eq!(found, text.as_bytes(), "cut at {cut}");
            }
        }
    }
}
