//! Addresses of the firmware's variables, equal in both families unless noted.
//!
//! Source: variable maps of firmware F514L and FA00G from the vendor's set-up archives.

macro_rules! addresses {
    ($($name:ident = $address:literal;)*) => {
        $(pub(super) const $name: u16 = $address;)*
    };
}

addresses! {
    ASR = 0x0201;
    APOS = 0x0228;
    POSERR = 0x022A;
    SPDREF = 0x022B;
    ASPD = 0x022C;
    IQREF = 0x022F;
    IQ = 0x0230;
    AD4 = 0x0240;
    AD7 = 0x0243;
    CLPER = 0x0250;
    SLPER = 0x0251;
    CADIN = 0x025C;
    KPP = 0x025E;
    KIP = 0x0260;
    KDP = 0x0262;
    KPS = 0x0267;
    KIS = 0x0269;
    RINCTST = 0x0280;
    REFTST = 0x0281;
    IMAXPROT = 0x0295;
    T2MAXPROT = 0x0299;
    UMAXPROT = 0x029A;
    UMINPROT = 0x029B;
    CPOS = 0x029E;
    CSPD = 0x02A0;
    CACC = 0x02A2;
    EREF = 0x02A8;
    EREFT = 0x02A9;
    MREF = 0x02AA;
    GEAR = 0x02AC;
    TREF = 0x02AE;
    TPOS = 0x02B2;
    TSPD = 0x02B4;
    TACC = 0x02B6;
    POS0 = 0x02B8;
    RPOS = 0x02BA;
    CAPPOS = 0x02BC;
    ATIME = 0x02C0;
    RTIME = 0x02C2;
    TIMAXPROT = 0x02C4;
    ERRMAX = 0x02C5;
    TERRMAX = 0x02C6;
    CER = 0x0301;
    PCR = 0x0303;
    ICR = 0x0304;
    DER2 = 0x0305;
    ISR = 0x0306;
    INTTABLE = 0x0307;
    MSR = 0x0308;
    MCR = 0x0309;
    CSR = 0x030B;
    AAR = 0x030C;
    PROD = 0x030E;
    DER = 0x03AD;
    CAMSTART = 0x03AE;
    POSOKLIM = 0x036A;
    TONPOSOK = 0x036B;
    I2TINTLIM_M = 0x0814;
    I2TINT_M = 0x0816;
    II2TPROT_M = 0x0818;
    ENCRESLONG = 0x084C;
    UPGRADE = 0x0857;
    CDEC = 0x0858;
    PVTSTS = 0x0863;
    PVTBUFLEN = 0x0865;
    PVTMODE = 0x0869;
    PVTPOS0 = 0x086A;
    SERRMAX = 0x0879;
    TSERRMAX = 0x087A;
    SWNEGLS = 0x088A;
    SWPOSLS = 0x088C;
    TJERK = 0x08D2;
    MER = 0x08FC;
    INSTATUS = 0x0908;
    SRL = 0x090E;
    SRH = 0x090F;
    ACR = 0x0912;
    AAR_TABLE = 0x0913;
    POSTRIGG1 = 0x091A;
    MASTERID = 0x0927;
    PVTSENDOFF = 0x092B;
    SRH_MASK = 0x0963;
    MER_MASK = 0x0965;
    APOS_MT = 0x0988;
    ASPD_LD = 0x098A;
    DIGOUT_STATUS = 0x09B8;
    POSERRL = 0x09BA;
    FUNCTION_TABLE = 0x09C9;
}

/// Address of SRL_MASK in F514L: the one address here in which the families differ.
pub(super) const SRL_MASK_F514L: u16 = 0x0962;
/// Address of SRL_MASK in FA00G.
pub(super) const SRL_MASK_FA00G: u16 = 0xA3CD;
