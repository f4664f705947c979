//! The binary message: samples of one channel, little-endian.
//!
//! | at | what |
//! |---|---|
//! | 0 | `u8` kind, 1 |
//! | 1 | `u8` version, 1 |
//! | 2 | `u16` channel |
//! | 4 | `u32` count |
//! | 8 | `u64` t0, µs since the server's start |
//! | 16 | `u64` samples of this channel that were lost so far |
//! | 24 | count times `u32` µs after t0, `f64` value in SI |

/// Bytes before the samples.
pub const HEADER_LEN: usize = 24;
/// Bytes of a sample.
pub const SAMPLE_LEN: usize = 12;
/// Samples in a message at most: they fit into the 64 KiB that a message may have.
pub const SAMPLES_MAX: usize = 4096;

/// A value and when it was so.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// µs since the server's start.
    pub t_us: u64,
    /// SI.
    pub value: f64,
}

/// The message for samples in order of time; those beyond [`SAMPLES_MAX`] or too long after the
/// first for a `u32` are left for another message. Returns it, and how many samples it holds.
#[must_use]
pub fn encode(channel: u16, lost_total: u64, samples: &[Sample]) -> (Vec<u8>, usize) {
    let t0_us = samples.first().map_or(0, |sample| sample.t_us);
    let count =
        samples.iter().take(SAMPLES_MAX).take_while(|s| time_after(s, t0_us).is_some()).count();
    let mut bytes = Vec::with_capacity(HEADER_LEN + count * SAMPLE_LEN);
    bytes.extend([1, 1]);
    bytes.extend(channel.to_le_bytes());
    bytes.extend((count as u32).to_le_bytes());
    bytes.extend(t0_us.to_le_bytes());
    bytes.extend(lost_total.to_le_bytes());
    for sample in &samples[..count] {
        bytes.extend(time_after(sample, t0_us).unwrap_or_default().to_le_bytes());
        bytes.extend(sample.value.to_le_bytes());
    }
    (bytes, count)
}

fn time_after(sample: &Sample, t0_us: u64) -> Option<u32> {
    u32::try_from(sample.t_us.saturating_sub(t0_us)).ok()
}

/// Decodes a message: channel, number of lost samples, samples. `None` if it is invalid.
#[must_use]
pub fn decode(bytes: &[u8]) -> Option<(u16, u64, Vec<Sample>)> {
    let (head, samples) = bytes.split_at_checked(HEADER_LEN)?;
    let count = usize::try_from(head_field(4, 4, head)).ok()?;
    let (samples, rest) = samples.as_chunks::<SAMPLE_LEN>();
    if head[..2] != [1, 1] || samples.len() != count || !rest.is_empty() {
        return None;
    }
    let t0_us = head_field(8, 8, head);
    Some((
        head_field(2, 2, head) as u16,
        head_field(16, 8, head),
        samples
            .iter()
            .map(|bytes| {
                let [a, b, c, d, value @ ..] = *bytes;
                let dt_us = u32::from_le_bytes([a, b, c, d]);
                Sample {
                    t_us: t0_us.saturating_add(dt_us.into()),
                    value: f64::from_le_bytes(value),
                }
            })
            .collect(),
    ))
}

fn head_field(at: usize, length: usize, head: &[u8]) -> u64 {
    head[at..at + length].iter().rev().fold(0, |all, byte| all << 8 | u64::from(*byte))
}
