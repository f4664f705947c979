//! pcapng: a named interface for each link, times in nanoseconds, directions as flags.

use polepair_core::explain::Direction;

use super::FormatWriter;
use super::pcap::{SNAPLEN, append_packet, link_type};
use crate::record::Record;
use crate::timestamp::Timestamp;

/// Interfaces that a file describes at most.
const INTERFACES_MAX: usize = 256;
/// Options: the interface's name, the power of ten of its clock, a packet's flags.
const IF_NAME: u16 = 2;
const IF_TSRESOL: u16 = 9;
const EPB_FLAGS: u16 = 2;

/// The writer of such files.
#[derive(Debug, Default)]
pub(super) struct PcapngWriter {
    begun: bool,
    interfaces: Vec<(u32, String)>,
}

impl FormatWriter for PcapngWriter {
    fn append_record(
        &mut self,
        record: &Record<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), &'static str> {
        self.begin_file(out);
        let interface = self.interface_number(link_type(&record.data), record.link, out)?;
        let Timestamp(time) = record.time.unwrap_or(Timestamp(0));
        append_block(6, out, |out| {
            for word in [interface, (time >> 32) as u32, time as u32, 0, 0] {
                out.extend_from_slice(&word.to_le_bytes());
            }
            let at = out.len();
            append_packet(record, out);
            let size = ((out.len() - at) as u32).to_le_bytes();
            out[at - 8..at - 4].copy_from_slice(&size);
            out[at - 4..at].copy_from_slice(&size);
            pad_to_word(out, at);
            let flags = match record.direction {
                None => return,
                Some(Direction::ToHost) => 1u32,
                Some(Direction::ToDrive) => 2,
            };
            append_option(EPB_FLAGS, &flags.to_le_bytes(), out);
            append_option(0, &[], out);
        });
        Ok(())
    }

    fn append_end(&mut self, out: &mut Vec<u8>) {
        self.begin_file(out);
    }
}

impl PcapngWriter {
    fn begin_file(&mut self, out: &mut Vec<u8>) {
        if !core::mem::replace(&mut self.begun, true) {
            append_block(0x0A0D_0D0A, out, |out| {
                for word in [0x1A2B_3C4D_u32, 1, u32::MAX, u32::MAX] {
                    out.extend_from_slice(&word.to_le_bytes());
                }
            });
        }
    }

    fn interface_number(
        &mut self,
        kind: u32,
        link: &str,
        out: &mut Vec<u8>,
    ) -> Result<u32, &'static str> {
        if let Some(at) =
            self.interfaces.iter().position(|(other, name)| *other == kind && name == link)
        {
            return Ok(at as u32);
        }
        if self.interfaces.len() >= INTERFACES_MAX {
            return Err("more links than are followed at once");
        }
        append_block(1, out, |out| {
            out.extend_from_slice(&(kind & 0xFFFF).to_le_bytes());
            out.extend_from_slice(&SNAPLEN.to_le_bytes());
            append_option(IF_NAME, link.as_bytes(), out);
            append_option(IF_TSRESOL, &[9], out);
            append_option(0, &[], out);
        });
        self.interfaces.push((kind, link.to_owned()));
        Ok(self.interfaces.len() as u32 - 1)
    }
}

/// Appends a block, with its length at both ends.
fn append_block(kind: u32, out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let at = out.len();
    out.extend_from_slice(&kind.to_le_bytes());
    out.extend_from_slice(&[0; 4]);
    body(out);
    let size = ((out.len() - at + 4) as u32).to_le_bytes();
    out[at + 4..at + 8].copy_from_slice(&size);
    out.extend_from_slice(&size);
}

fn append_option(code: u16, value: &[u8], out: &mut Vec<u8>) {
    out.extend_from_slice(&code.to_le_bytes());
    out.extend_from_slice(&(value.len() as u16).to_le_bytes());
    let at = out.len();
    out.extend_from_slice(value);
    pad_to_word(out, at);
}

/// Fills what begins at `at` up to a whole number of words.
fn pad_to_word(out: &mut Vec<u8>, at: usize) {
    let size = (out.len() - at).next_multiple_of(4);
    out.resize(at + size, 0);
}
