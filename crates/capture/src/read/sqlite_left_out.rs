//! Replaces the reader of SQLite databases in a program that was built without it.

use super::{CapturePosition, Damage, FormatReader, ReadError, RecordSink};

/// Reports once that it cannot read a database.
#[derive(Debug, Default)]
pub(super) struct SqliteReader {
    is_refused: bool,
}

impl FormatReader for SqliteReader {
    fn read(&mut self, bytes: &[u8], _ended: bool, taker: &mut dyn RecordSink) -> usize {
        if !core::mem::replace(&mut self.is_refused, true) {
            let reason = ReadError("this program was built without SQLite (feature `sqlite`)");
            taker.handle_damage(Damage { position: CapturePosition::Byte(0), reason });
        }
        bytes.len()
    }
}
