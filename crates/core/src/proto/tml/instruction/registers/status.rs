//! Registers that tell how the drive is.

use super::{Bits, Register, field, set};

pub(super) const REGISTERS: &[Register] = &[
    Register { name: "SRL", about: "state of the axis", bits: SRL },
    Register { name: "SRH", about: "state of the drive", bits: SRH },
    Register { name: "MER", about: "what went wrong, one bit each", bits: MER },
    Register { name: "DER", about: "what is behind a command error", bits: DER },
    Register { name: "DER2", about: "errors of encoders and sensors", bits: DER2 },
    Register { name: "CER", about: "errors of the communication", bits: CER },
    Register { name: "MSR", about: "state of the motion, kept until handled", bits: MSR },
    Register { name: "ISR", about: "interrupts that are pending", bits: ISR },
    Register { name: "PVTSTS", about: "state of the buffer of points", bits: PVTSTS },
    Register { name: "AAR", about: "axis ID and groups", bits: AAR },
    Register { name: "CSR", about: "state of the communication", bits: CSR },
    Register { name: "CCR", about: "what the communication has", bits: CCR },
    Register { name: "SSR", about: "state of the slaves of a controller", bits: SSR },
];

const SRL: &[Bits] = &[
    set(15, "AXISST", &["axis off", "axis on"]),
    set(14, "EVNS", &["", "the last event has occurred"]),
    set(10, "MOTS", &["in motion", "motion complete"]),
    set(8, "CALLSST", &["", "a function of CALLS runs"]),
    set(7, "CALLWRG", &["", "a CALLS came while another function ran"]),
];

const SRH: &[Bits] = &[
    set(15, "FAULT", &["", "fault"]),
    set(14, "INCAM", &["", "position of the cam reached"]),
    set(13, "INFRZC", &["", "freeze control holds the motor"]),
    set(12, "INGEAR", &["", "gear ratio reached"]),
    set(11, "I2TWRGD", &["", "I2t of the drive near its limit"]),
    set(10, "I2TWRGM", &["", "I2t of the motor near its limit"]),
    set(9, "TRGR", &["", "target command reached"]),
    set(8, "PCAPS", &["", "position captured"]),
    set(7, "LSWNS", &["", "negative limit switch event"]),
    set(6, "LSWPS", &["", "positive limit switch event"]),
    set(5, "AUTORUN", &["", "runs its program from power-on"]),
    set(4, "PTRG4", &["", "position trigger 4"]),
    set(3, "PTRG3", &["", "position trigger 3"]),
    set(2, "PTRG2", &["", "position trigger 2"]),
    set(1, "PTRG1", &["", "position trigger 1"]),
    set(0, "ENDINIT", &["not initialised: ENDINIT is missing", "initialised"]),
];

const MER: &[Bits] = &[
    set(15, "ENST", &["", "disabled by the ENABLE input or STO"]),
    set(14, "CMDER", &["", "command error: DER tells which"]),
    set(13, "UVER", &["", "under-voltage"]),
    set(12, "OVER", &["", "over-voltage"]),
    set(11, "OTERD", &["", "drive too hot"]),
    set(10, "OTERM", &["", "motor too hot"]),
    set(9, "I2TER", &["", "I2t of drive or motor"]),
    set(8, "OCER", &["", "over-current"]),
    set(7, "LSNST", &["", "negative limit switch active"]),
    set(6, "LSPST", &["", "positive limit switch active"]),
    set(5, "WRPSER", &["", "hall sensor, resolver or encoder error, or position wrapped around"]),
    set(4, "SCIER", &["", "communication error: CER tells which"]),
    set(3, "CTRER", &["", "control error: position or speed error too great for too long"]),
    set(2, "STPTBL", &["", "set-up table invalid"]),
    set(1, "SCER", &["", "short circuit"]),
    set(0, "CANBER", &["", "CAN bus error"]),
];

const DER: &[Bits] = &[
    set(15, "EELOCK", &["", "the EEPROM is locked"]),
    set(14, "STOHW", &["", "hardware error of STO or ENABLE"]),
    set(13, "SLFCHKERR", &["", "self-check failed"]),
    set(12, "TMLHBIGN", &["", "TML heartbeat asked for while CANopen is active"]),
    set(11, "SMS", &["", "the start method failed"]),
    set(10, "EBW", &["", "encoder wire broken"]),
    set(9, "UPDWOMC", &["", "UPD of an S-curve came before motion complete"]),
    set(8, "SCINV", &["", "impossible S-curve: UPD ignored"]),
    set(7, "SWLSNST", &["", "negative software limit reached"]),
    set(6, "SWLSPST", &["", "positive software limit reached"]),
    set(5, "CCALLI", &["", "CALLS ignored: another one runs"]),
    set(4, "UPDAX", &["", "UPD ignored: AXISON was not finished"]),
    set(3, "FCTNA", &["", "no such function"]),
    set(2, "HOMNA", &["", "no such homing routine"]),
    set(1, "STUF", &["", "RET without a call"]),
    set(0, "STOF", &["", "too many calls within calls"]),
];

const DER2: &[Bits] = &[
    set(15, "OUTFREQ", &["", "output frequency beyond the export limit"]),
    set(14, "POLARITY", &["", "inputs and outputs of different polarity"]),
    set(10, "FB1MISS", &["", "feedback 1 missing"]),
    set(9, "FB1ERR", &["", "feedback 1: error bit"]),
    set(8, "FB1WRN", &["", "feedback 1: warning bit"]),
    set(7, "FB1CRC", &["", "feedback 1: checksum"]),
    set(6, "POSWRP", &["", "position wrapped around"]),
    set(5, "HSME", &["", "hall sensor missing"]),
    set(4, "AEICE", &["", "absolute encoder does not answer"]),
    set(3, "FB2MISS", &["", "feedback 2 missing"]),
    set(2, "FB2ERR", &["", "feedback 2: error bit"]),
    set(1, "FB2WRN", &["", "feedback 2: warning bit"]),
    set(0, "FB2CRC", &["", "feedback 2: checksum"]),
];

const CER: &[Bits] = &[
    set(11, "OFWRER", &["", "EnDat: offset not written"]),
    set(10, "OFRDER", &["", "EnDat: offset not read"]),
    set(9, "ALRSER", &["", "EnDat: alarm not reset"]),
    set(8, "ALRDER", &["", "EnDat: alarm not read"]),
    set(7, "SPITTO", &["", "EEPROM write timed out"]),
    set(6, "CANBER", &["", "CAN bus off"]),
    set(5, "CANTER", &["", "CAN: messages to send were lost"]),
    set(4, "CANRER", &["", "CAN: messages received were lost"]),
    set(3, "CANRTO", &["", "CAN: reception timed out"]),
    set(2, "SCIRTO", &["", "serial: reception timed out"]),
    set(1, "SCITTO", &["", "serial: transmission timed out"]),
    set(0, "SCIRER", &["", "serial: reception error"]),
];

const MSR: &[Bits] = &[
    set(15, "UPDATE", &["", "motion mode updated"]),
    set(14, "EVNRS", &["", "the event was set by an update"]),
    set(13, "AXISST", &["axis off", "axis on"]),
    set(11, "EVNS", &["", "the last event has occurred"]),
    set(10, "CNTSGS", &["", "a contour segment is due"]),
    set(9, "MOTS", &["in motion", "motion complete"]),
    set(8, "PCAPS", &["", "position captured"]),
    set(7, "LSWNS", &["", "negative limit switch event"]),
    set(6, "LSWPS", &["", "positive limit switch event"]),
    set(5, "WRPS", &["", "position wrapped around"]),
    set(3, "CTRERS", &["", "control error"]),
    set(2, "SWPRS", &["", "a software protection acted"]),
    set(1, "SCUPD", &["", "S-curve update denied"]),
    set(0, "ENDINIT", &["not initialised: ENDINIT is missing", "initialised"]),
];

const ISR: &[Bits] = &[
    set(12, "PTCDIF", &["", "a position trigger changed"]),
    set(11, "EVNIF", &["", "the event occurred"]),
    set(10, "TPIF", &["", "the time period elapsed"]),
    set(9, "MOTIF", &["", "motion complete"]),
    set(8, "PCAPIF", &["", "position captured"]),
    set(7, "LSWNIF", &["", "negative limit switch"]),
    set(6, "LSWPIF", &["", "positive limit switch"]),
    set(5, "WRPIF", &["", "position wrapped around"]),
    set(4, "CMERIF", &["", "communication error"]),
    set(3, "CTRERIF", &["", "control error"]),
    set(2, "SWPRIF", &["", "software protection"]),
    set(1, "PDPIF", &["", "short circuit"]),
    set(0, "DSLBIF", &["", "ENABLE input changed"]),
];

const PVTSTS: &[Bits] = &[
    set(15, "EMPTY", &["", "buffer empty"]),
    set(14, "LOW", &["", "buffer low"]),
    set(13, "FULL", &["", "buffer full"]),
    set(12, "CNTERR", &["", "integrity counter wrong: a point is missing"]),
    set(11, "QSTOP", &["", "quick stop: the buffer ran empty at speed"]),
    field(6, 0, "COUNTER", &[]),
];

const AAR: &[Bits] = &[
    set(15, "GR8", &["", "group 8"]),
    set(14, "GR7", &["", "group 7"]),
    set(13, "GR6", &["", "group 6"]),
    set(12, "GR5", &["", "group 5"]),
    set(11, "GR4", &["", "group 4"]),
    set(10, "GR3", &["", "group 3"]),
    set(9, "GR2", &["", "group 2"]),
    set(8, "GR1", &["", "group 1"]),
    field(7, 0, "AXISID", &[]),
];

const CSR: &[Bits] = &[
    set(15, "ELGEAR", &["", "gearing data to send"]),
    set(14, "AXISDSTP", &["axis ID from the set-up", "axis ID from switches"]),
    set(0, "SCITYPE", &["RS-232", "RS-485"]),
];

const CCR: &[Bits] = &[set(0, "SPIMEM", &["no EEPROM", "EEPROM there"])];

const SSR: &[Bits] = &[
    set(31, "HIERR", &["", "slave H: initialisation failed"]),
    set(30, "HIFW", &["", "slave H: firmware does not fit"]),
    set(29, "HISTP", &["", "slave H: set-up table invalid"]),
    set(28, "HDET", &["", "slave H: not there"]),
    set(27, "GIERR", &["", "slave G: initialisation failed"]),
    set(26, "GIFW", &["", "slave G: firmware does not fit"]),
    set(25, "GISTP", &["", "slave G: set-up table invalid"]),
    set(24, "GDET", &["", "slave G: not there"]),
    set(23, "FIERR", &["", "slave F: initialisation failed"]),
    set(22, "FIFW", &["", "slave F: firmware does not fit"]),
    set(21, "FISTP", &["", "slave F: set-up table invalid"]),
    set(20, "FDET", &["", "slave F: not there"]),
    set(19, "EIERR", &["", "slave E: initialisation failed"]),
    set(18, "EIFW", &["", "slave E: firmware does not fit"]),
    set(17, "EISTP", &["", "slave E: set-up table invalid"]),
    set(16, "EDET", &["", "slave E: not there"]),
    set(15, "DIERR", &["", "slave D: initialisation failed"]),
    set(14, "DIFW", &["", "slave D: firmware does not fit"]),
    set(13, "DISTP", &["", "slave D: set-up table invalid"]),
    set(12, "DDET", &["", "slave D: not there"]),
    set(11, "CIERR", &["", "slave C: initialisation failed"]),
    set(10, "CIFW", &["", "slave C: firmware does not fit"]),
    set(9, "CISTP", &["", "slave C: set-up table invalid"]),
    set(8, "CDET", &["", "slave C: not there"]),
    set(7, "BIERR", &["", "slave B: initialisation failed"]),
    set(6, "BIFW", &["", "slave B: firmware does not fit"]),
    set(5, "BISTP", &["", "slave B: set-up table invalid"]),
    set(4, "BDET", &["", "slave B: not there"]),
    set(3, "AIERR", &["", "slave A: initialisation failed"]),
    set(2, "AIFW", &["", "slave A: firmware does not fit"]),
    set(1, "AISTP", &["", "slave A: set-up table invalid"]),
    set(0, "ADET", &["", "slave A: not there"]),
];
