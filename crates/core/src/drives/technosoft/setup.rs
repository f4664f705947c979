//! What is in the set-up table from the factory.
//!
//! The values are a plausible set-up for the model's motor \[I\]; KPP is what the communication
//! manual's example 2 reads (chapter 3).

use super::at;
use super::memory::Memory;
use super::options::Options;
use super::units;

/// Fills the data pages and makes a valid table of them.
pub(super) fn deliver(memory: &mut Memory, options: &Options) {
    for (address, value) in WORDS {
        memory.put(address, value);
    }
    memory.put_fixed(at::CSPD, 1000.0 / 30.0);
    memory.put_fixed(at::CACC, 0.32);
    memory.put_fixed(at::CDEC, 0.64);
    memory.put_long(at::TJERK, 50);
    memory.put_long(at::I2TINTLIM_M, units::I2T_LIMIT);
    memory.put_fixed(at::GEAR, 1.0);
    memory.put(at::AAR_TABLE, options.axis.into());
    memory.put(at::SLPER, (options.slow_ns / 1000) as u16);
    memory.put_long(at::ENCRESLONG, options.counts.cast_signed());
    let kept = memory.save_table();
    debug_assert!(kept.is_ok());
    memory.writes = 0;
}

const WORDS: [(u16, u16); 23] = [
    (at::KPP, 288),
    (at::KIP, 12),
    (at::KDP, 640),
    (at::KPS, 1200),
    (at::KIS, 90),
    (at::CLPER, 100),
    (at::CADIN, 0x4000),
    (at::IMAXPROT, 32_760),
    (at::TIMAXPROT, 100),
    (at::II2TPROT_M, 16_380),
    (at::T2MAXPROT, 90),
    (at::UMAXPROT, 38_430),
    (at::UMINPROT, 7_686),
    (at::ERRMAX, 1000),
    (at::TERRMAX, 200),
    (at::SERRMAX, 0),
    (at::TSERRMAX, 0),
    (at::POSOKLIM, 10),
    (at::TONPOSOK, 10),
    (at::PVTBUFLEN, 7),
    (at::PCR, 0x00FF),
    (at::RINCTST, 20),
    (at::REFTST, 0),
];
