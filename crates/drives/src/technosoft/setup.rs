//! The factory set-up table.
//!
//! The values are a plausible set-up for the model's motor \[I\]. KPP is the value that example 2 of the communication
//! manual reads (chapter 3).

use super::addresses;
use super::memory::Memory;
use super::options::Options;
use super::units;

/// Fills the data pages and makes a valid table of them.
pub(super) fn load_factory_setup(memory: &mut Memory, options: &Options) {
    for (address, value) in FACTORY_WORDS {
        memory.set(address, value);
    }
    memory.set_fixed(addresses::CSPD, 1000.0 / 30.0);
    memory.set_fixed(addresses::CACC, 0.32);
    memory.set_fixed(addresses::CDEC, 0.64);
    memory.set_long(addresses::TJERK, 50);
    memory.set_long(addresses::I2TINTLIM_M, units::I2T_LIMIT);
    memory.set_fixed(addresses::GEAR, 1.0);
    memory.set_fixed(addresses::CAMX, 1.0);
    memory.set_fixed(addresses::CAMY, 1.0);
    memory.set(addresses::AAR_TABLE, options.axis.into());
    memory.set(addresses::SLPER, (options.slow_ns / 1000) as u16);
    memory.set_long(addresses::ENCRESLONG, options.counts.cast_signed());
    let recorded = memory.save_table();
    debug_assert!(recorded.is_ok());
    memory.writes = 0;
}

const FACTORY_WORDS: [(u16, u16); 23] = [
    (addresses::KPP, 288),
    (addresses::KIP, 12),
    (addresses::KDP, 640),
    (addresses::KPS, 1200),
    (addresses::KIS, 90),
    (addresses::CLPER, 100),
    (addresses::CADIN, 0x4000),
    (addresses::IMAXPROT, 32_760),
    (addresses::TIMAXPROT, 100),
    (addresses::II2TPROT_M, 16_380),
    (addresses::T2MAXPROT, 90),
    (addresses::UMAXPROT, 38_430),
    (addresses::UMINPROT, 7_686),
    (addresses::ERRMAX, 1000),
    (addresses::TERRMAX, 200),
    (addresses::SERRMAX, 0),
    (addresses::TSERRMAX, 0),
    (addresses::POSOKLIM, 10),
    (addresses::TONPOSOK, 10),
    (addresses::PVTBUFLEN, 7),
    (addresses::PCR, 0x00FF),
    (addresses::RINCTST, 20),
    (addresses::REFTST, 0),
];
