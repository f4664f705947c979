//! Registers with status.

use super::{Register, RegisterField, field, flag};

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

const SRL: &[RegisterField] = &[
    flag(15, "AXISST", &["axis off", "axis on"]),
    flag(14, "EVNS", &["", "the last event has occurred"]),
    flag(10, "MOTS", &["in motion", "motion complete"]),
    flag(8, "CALLSST", &["", "a function of CALLS runs"]),
    flag(7, "CALLWRG", &["", "a CALLS came while another function ran"]),
];

const SRH: &[RegisterField] = &[
    flag(15, "FAULT", &["", "fault"]),
    flag(14, "INCAM", &["", "position of the cam reached"]),
    flag(13, "INFRZC", &["", "freeze control holds the motor"]),
    flag(12, "INGEAR", &["", "gear ratio reached"]),
    flag(11, "I2TWRGD", &["", "I2t of the drive near its limit"]),
    flag(10, "I2TWRGM", &["", "I2t of the motor near its limit"]),
    flag(9, "TRGR", &["", "target command reached"]),
    flag(8, "PCAPS", &["", "position captured"]),
    flag(7, "LSWNS", &["", "negative limit switch event"]),
    flag(6, "LSWPS", &["", "positive limit switch event"]),
    flag(5, "AUTORUN", &["", "runs its program from power-on"]),
    flag(4, "PTRG4", &["", "position trigger 4"]),
    flag(3, "PTRG3", &["", "position trigger 3"]),
    flag(2, "PTRG2", &["", "position trigger 2"]),
    flag(1, "PTRG1", &["", "position trigger 1"]),
    flag(0, "ENDINIT", &["not initialised: ENDINIT is missing", "initialised"]),
];

const MER: &[RegisterField] = &[
    flag(15, "ENST", &["", "disabled by the ENABLE input or STO"]),
    flag(14, "CMDER", &["", "command error: DER tells which"]),
    flag(13, "UVER", &["", "under-voltage"]),
    flag(12, "OVER", &["", "over-voltage"]),
    flag(11, "OTERD", &["", "drive too hot"]),
    flag(10, "OTERM", &["", "motor too hot"]),
    flag(9, "I2TER", &["", "I2t of drive or motor"]),
    flag(8, "OCER", &["", "over-current"]),
    flag(7, "LSNST", &["", "negative limit switch active"]),
    flag(6, "LSPST", &["", "positive limit switch active"]),
    flag(5, "WRPSER", &["", "hall sensor, resolver or encoder error, or position wrapped around"]),
    flag(4, "SCIER", &["", "communication error: CER tells which"]),
    flag(3, "CTRER", &["", "control error: position or speed error too great for too long"]),
    flag(2, "STPTBL", &["", "set-up table invalid"]),
    flag(1, "SCER", &["", "short circuit"]),
    flag(0, "CANBER", &["", "CAN bus error"]),
];

const DER: &[RegisterField] = &[
    flag(15, "EELOCK", &["", "the EEPROM is locked"]),
    flag(14, "STOHW", &["", "hardware error of STO or ENABLE"]),
    flag(13, "SLFCHKERR", &["", "self-check failed"]),
    flag(12, "TMLHBIGN", &["", "TML heartbeat asked for while CANopen is active"]),
    flag(11, "SMS", &["", "the start method failed"]),
    flag(10, "EBW", &["", "encoder wire broken"]),
    flag(9, "UPDWOMC", &["", "UPD of an S-curve came before motion complete"]),
    flag(8, "SCINV", &["", "impossible S-curve: UPD ignored"]),
    flag(7, "SWLSNST", &["", "negative software limit reached"]),
    flag(6, "SWLSPST", &["", "positive software limit reached"]),
    flag(5, "CCALLI", &["", "CALLS ignored: another one runs"]),
    flag(4, "UPDAX", &["", "UPD ignored: AXISON was not finished"]),
    flag(3, "FCTNA", &["", "no such function"]),
    flag(2, "HOMNA", &["", "no such homing routine"]),
    flag(1, "STUF", &["", "RET without a call"]),
    flag(0, "STOF", &["", "too many calls within calls"]),
];

const DER2: &[RegisterField] = &[
    flag(15, "OUTFREQ", &["", "output frequency beyond the export limit"]),
    flag(14, "POLARITY", &["", "inputs and outputs of different polarity"]),
    flag(10, "FB1MISS", &["", "feedback 1 missing"]),
    flag(9, "FB1ERR", &["", "feedback 1: error bit"]),
    flag(8, "FB1WRN", &["", "feedback 1: warning bit"]),
    flag(7, "FB1CRC", &["", "feedback 1: checksum"]),
    flag(6, "POSWRP", &["", "position wrapped around"]),
    flag(5, "HSME", &["", "hall sensor missing"]),
    flag(4, "AEICE", &["", "absolute encoder does not answer"]),
    flag(3, "FB2MISS", &["", "feedback 2 missing"]),
    flag(2, "FB2ERR", &["", "feedback 2: error bit"]),
    flag(1, "FB2WRN", &["", "feedback 2: warning bit"]),
    flag(0, "FB2CRC", &["", "feedback 2: checksum"]),
];

const CER: &[RegisterField] = &[
    flag(11, "OFWRER", &["", "EnDat: offset not written"]),
    flag(10, "OFRDER", &["", "EnDat: offset not read"]),
    flag(9, "ALRSER", &["", "EnDat: alarm not reset"]),
    flag(8, "ALRDER", &["", "EnDat: alarm not read"]),
    flag(7, "SPITTO", &["", "EEPROM write timed out"]),
    flag(6, "CANBER", &["", "CAN bus off"]),
    flag(5, "CANTER", &["", "CAN: messages to send were lost"]),
    flag(4, "CANRER", &["", "CAN: messages received were lost"]),
    flag(3, "CANRTO", &["", "CAN: reception timed out"]),
    flag(2, "SCIRTO", &["", "serial: reception timed out"]),
    flag(1, "SCITTO", &["", "serial: transmission timed out"]),
    flag(0, "SCIRER", &["", "serial: reception error"]),
];

const MSR: &[RegisterField] = &[
    flag(15, "UPDATE", &["", "motion mode updated"]),
    flag(14, "EVNRS", &["", "the event was set by an update"]),
    flag(13, "AXISST", &["axis off", "axis on"]),
    flag(11, "EVNS", &["", "the last event has occurred"]),
    flag(10, "CNTSGS", &["", "a contour segment is due"]),
    flag(9, "MOTS", &["in motion", "motion complete"]),
    flag(8, "PCAPS", &["", "position captured"]),
    flag(7, "LSWNS", &["", "negative limit switch event"]),
    flag(6, "LSWPS", &["", "positive limit switch event"]),
    flag(5, "WRPS", &["", "position wrapped around"]),
    flag(3, "CTRERS", &["", "control error"]),
    flag(2, "SWPRS", &["", "a software protection acted"]),
    flag(1, "SCUPD", &["", "S-curve update denied"]),
    flag(0, "ENDINIT", &["not initialised: ENDINIT is missing", "initialised"]),
];

const ISR: &[RegisterField] = &[
    flag(12, "PTCDIF", &["", "a position trigger changed"]),
    flag(11, "EVNIF", &["", "the event occurred"]),
    flag(10, "TPIF", &["", "the time period elapsed"]),
    flag(9, "MOTIF", &["", "motion complete"]),
    flag(8, "PCAPIF", &["", "position captured"]),
    flag(7, "LSWNIF", &["", "negative limit switch"]),
    flag(6, "LSWPIF", &["", "positive limit switch"]),
    flag(5, "WRPIF", &["", "position wrapped around"]),
    flag(4, "CMERIF", &["", "communication error"]),
    flag(3, "CTRERIF", &["", "control error"]),
    flag(2, "SWPRIF", &["", "software protection"]),
    flag(1, "PDPIF", &["", "short circuit"]),
    flag(0, "DSLBIF", &["", "ENABLE input changed"]),
];

const PVTSTS: &[RegisterField] = &[
    flag(15, "EMPTY", &["", "buffer empty"]),
    flag(14, "LOW", &["", "buffer low"]),
    flag(13, "FULL", &["", "buffer full"]),
    flag(12, "CNTERR", &["", "integrity counter wrong: a point is missing"]),
    flag(11, "QSTOP", &["", "quick stop: the buffer ran empty at speed"]),
    field(6, 0, "COUNTER", &[]),
];

const AAR: &[RegisterField] = &[
    flag(15, "GR8", &["", "group 8"]),
    flag(14, "GR7", &["", "group 7"]),
    flag(13, "GR6", &["", "group 6"]),
    flag(12, "GR5", &["", "group 5"]),
    flag(11, "GR4", &["", "group 4"]),
    flag(10, "GR3", &["", "group 3"]),
    flag(9, "GR2", &["", "group 2"]),
    flag(8, "GR1", &["", "group 1"]),
    field(7, 0, "AXISID", &[]),
];

const CSR: &[RegisterField] = &[
    flag(15, "ELGEAR", &["", "gearing data to send"]),
    flag(14, "AXISDSTP", &["axis ID from the set-up", "axis ID from switches"]),
    flag(0, "SCITYPE", &["RS-232", "RS-485"]),
];

const CCR: &[RegisterField] = &[flag(0, "SPIMEM", &["no EEPROM", "EEPROM there"])];

const SSR: &[RegisterField] = &[
    flag(31, "HIERR", &["", "slave H: initialisation failed"]),
    flag(30, "HIFW", &["", "slave H: firmware does not fit"]),
    flag(29, "HISTP", &["", "slave H: set-up table invalid"]),
    flag(28, "HDET", &["", "slave H: not there"]),
    flag(27, "GIERR", &["", "slave G: initialisation failed"]),
    flag(26, "GIFW", &["", "slave G: firmware does not fit"]),
    flag(25, "GISTP", &["", "slave G: set-up table invalid"]),
    flag(24, "GDET", &["", "slave G: not there"]),
    flag(23, "FIERR", &["", "slave F: initialisation failed"]),
    flag(22, "FIFW", &["", "slave F: firmware does not fit"]),
    flag(21, "FISTP", &["", "slave F: set-up table invalid"]),
    flag(20, "FDET", &["", "slave F: not there"]),
    flag(19, "EIERR", &["", "slave E: initialisation failed"]),
    flag(18, "EIFW", &["", "slave E: firmware does not fit"]),
    flag(17, "EISTP", &["", "slave E: set-up table invalid"]),
    flag(16, "EDET", &["", "slave E: not there"]),
    flag(15, "DIERR", &["", "slave D: initialisation failed"]),
    flag(14, "DIFW", &["", "slave D: firmware does not fit"]),
    flag(13, "DISTP", &["", "slave D: set-up table invalid"]),
    flag(12, "DDET", &["", "slave D: not there"]),
    flag(11, "CIERR", &["", "slave C: initialisation failed"]),
    flag(10, "CIFW", &["", "slave C: firmware does not fit"]),
    flag(9, "CISTP", &["", "slave C: set-up table invalid"]),
    flag(8, "CDET", &["", "slave C: not there"]),
    flag(7, "BIERR", &["", "slave B: initialisation failed"]),
    flag(6, "BIFW", &["", "slave B: firmware does not fit"]),
    flag(5, "BISTP", &["", "slave B: set-up table invalid"]),
    flag(4, "BDET", &["", "slave B: not there"]),
    flag(3, "AIERR", &["", "slave A: initialisation failed"]),
    flag(2, "AIFW", &["", "slave A: firmware does not fit"]),
    flag(1, "AISTP", &["", "slave A: set-up table invalid"]),
    flag(0, "ADET", &["", "slave A: not there"]),
];
