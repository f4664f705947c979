//! Column positions of printed lines.

use crate::timestamp::Timestamp;

/// The time from which lines count, and the widths of their first columns.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct LineLayout {
    pub first: Option<Timestamp>,
    pub link_width: usize,
    pub protocol_width: usize,
}

impl LineLayout {
    /// Makes room for a line with these columns.
    pub fn include(&mut self, time: Option<Timestamp>, link: &str, protocol: Option<&'static str>) {
        self.first = self.first.or(time);
        self.link_width = self.link_width.max(link.len());
        self.protocol_width = self.protocol_width.max(protocol_word(protocol).len());
    }
}

/// A protocol's name, or a question mark.
pub(crate) fn protocol_word(protocol: Option<&'static str>) -> &'static str {
    protocol.unwrap_or("?")
}
