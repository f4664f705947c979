//! Addresses of the firmware's variables, equal in both families unless noted.
//!
//! Source: variable maps of firmware F514L and FA00G from the vendor's set-up archives, as the profiles have them.

use super::profile::TECHNOSOFT_F514L;

macro_rules! addresses {
    ($($symbol:ident),* $(,)?) => {
        $(pub(super) const $symbol: u16 = TECHNOSOFT_F514L.index_of(stringify!($symbol));)*
    };
}

addresses! {
    ASR, APOS, POSERR, SPDREF, ASPD, IQREF, IQ, AD4, AD7, CLPER, SLPER, CADIN, KPP, KIP, KDP, KPS,
    KIS, RINCTST, REFTST, IMAXPROT, T2MAXPROT, UMAXPROT, UMINPROT, CPOS, CSPD, CACC, EREF, EREFT,
    MREF, GEAR, TREF, TPOS, TSPD, TACC, POS0, RPOS, CAPPOS, ATIME, RTIME, TIMAXPROT, ERRMAX,
    TERRMAX, CER, PCR, ICR, DER2, ISR, INTTABLE, MSR, MCR, CSR, AAR, PROD, DER, CAMSTART, POSOKLIM,
    TONPOSOK, I2TINTLIM_M, I2TINT_M, II2TPROT_M, ENCRESLONG, UPGRADE, CDEC, PVTSTS, PVTBUFLEN,
    PVTMODE, PVTPOS0, SERRMAX, TSERRMAX, SWNEGLS, SWPOSLS, TJERK, MER, INSTATUS, SRL, SRH, ACR,
    POSTRIGG1, MASTERID, PVTSENDOFF, SRH_MASK, MER_MASK, APOS_MT, ASPD_LD, DIGOUT_STATUS, POSERRL,
    LOG_PTR, OSR, SLAVEID, GEARMASTER, GEARSLAVE, CAMOFF, CAMX, CAMY,
}

/// Address of the table with the axis addresses.
pub(super) const AAR_TABLE: u16 = 0x0913;
/// Address of the table of functions.
pub(super) const FUNCTION_TABLE: u16 = 0x09C9;

/// Address of SRL_MASK in F514L: the one address here in which the families differ.
pub(super) const SRL_MASK_F514L: u16 = 0x0962;
/// Address of SRL_MASK in FA00G.
pub(super) const SRL_MASK_FA00G: u16 = 0xA3CD;
