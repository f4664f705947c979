//! Registers with settings.

use super::{Register, RegisterField, field, flag};

pub(super) const REGISTERS: &[Register] = &[
    Register { name: "MCR", about: "motion mode", bits: MCR },
    Register { name: "ACR", about: "kinds of start, reference and positioning", bits: ACR },
    Register { name: "ASR", about: "settings that came later", bits: ASR },
    Register { name: "ASR2", about: "more settings", bits: ASR2 },
    Register { name: "ASR3", about: "still more settings", bits: ASR3 },
    Register { name: "ATR", about: "auto-tuning", bits: ATR },
    Register { name: "OSR", about: "gearing, stepper and voltage", bits: OSR },
    Register { name: "SCR", about: "motor and sensors", bits: SCR },
    Register { name: "UPGRADE", about: "how later functions behave", bits: UPGRADE },
    Register { name: "ICR", about: "interrupts that are enabled", bits: ICR },
    Register { name: "PCR", about: "protections: which acted, which are enabled", bits: PCR },
    Register { name: "CBR", about: "CAN bit timing", bits: CBR },
];

const MCR: &[RegisterField] = &[
    flag(15, "MMODE", &["", "new motion mode"]),
    flag(
        14,
        "MODECHG",
        &["starts from where the motor is (TUM0)", "starts from the target (TUM1)"],
    ),
    flag(13, "POSTYPE", &["positions relative", "positions absolute"]),
    flag(12, "REGMODE", &["", "a second motion is superposed"]),
    flag(11, "ELGEAR", &["", "master of gear and cam"]),
    flag(10, "POSLP", &["", "position loop closed"]),
    flag(9, "SPDLP", &["", "speed loop closed"]),
    flag(8, "CRTLP", &["", "current loop closed"]),
    field(
        7,
        6,
        "EXTREF",
        &["reference over the line", "reference analogue", "reference digital", ""],
    ),
    flag(5, "REFLOC", &["", "torque reference read in the fast loop"]),
    field(
        4,
        0,
        "REFTYPE",
        &[
            "external reference",
            "trapezoidal profile",
            "contour of positions or speeds",
            "contour of torque or voltage",
            "pulse and direction",
            "gear slave",
            "cam slave",
            "S-curve profile",
            "test",
            "PVT",
            "PT",
            "sine",
            "vector mode",
        ],
    ),
];

const ACR: &[RegisterField] = &[
    flag(15, "HALLST", &["", "hall start by PMSM control alone"]),
    flag(14, "SPDFWD", &["", "speed feed-forward without a speed loop"]),
    flag(13, "SOLCTR", &["", "open-loop stepper follows the analogue reference in speed"]),
    flag(12, "CAMTYPE", &["cam relative", "cam absolute"]),
    flag(11, "RPOSTYPE", &["", "relative moves add up"]),
    flag(10, "POSCTR", &["", "position control"]),
    flag(9, "SPDCTR", &["", "speed control"]),
    flag(8, "TCTR", &["", "torque control"]),
    flag(7, "DIGREF", &["", "digital reference from power-on"]),
    flag(6, "AREF", &["", "analogue reference from power-on"]),
    flag(5, "RDAREF", &["", "torque reference read in the fast loop"]),
    flag(4, "FRZOPT", &["", "freeze control with limits of its own"]),
    flag(3, "AXISEN", &["", "AXISON when the ENABLE input comes"]),
    flag(
        2,
        "DIGTYPE",
        &["digital reference is a second encoder", "digital reference is pulse and direction"],
    ),
    flag(1, "ASTART", &["", "starts by itself after power-on"]),
    flag(0, "STPSC", &["stops on an S-curve", "stops on a trapezoid"]),
];

const ASR: &[RegisterField] = &[
    flag(15, "ACTSPDEST", &["", "speed estimator"]),
    flag(13, "I2TFRA", &["", "no fault reset until the I2t integral is zero"]),
    flag(12, "SWLEN", &["", "software limits"]),
    flag(11, "RMDIR", &["", "direction reversed"]),
    flag(10, "SWAD25", &["", "analogue inputs 2 and 5 exchanged"]),
    flag(9, "EERES", &["", "encoder resolution beyond 65535"]),
    flag(8, "COIM", &["", "CANopen interpolation as the standard has it"]),
    flag(7, "NMNT", &["", "negative transmission treated the new way"]),
    flag(6, "RSTPCHY", &["", "position controller starts afresh"]),
    flag(5, "RSTSCHY", &["", "speed controller starts afresh"]),
    flag(4, "RSTCCHY", &["", "current controller starts afresh"]),
    flag(3, "TUM0TSSV", &["", "with TUM0 the next motion begins at speed zero"]),
    flag(2, "INPOL", &["inputs are PNP", "inputs are NPN"]),
    flag(1, "I2TINT", &["", "I2t limits the current and is no fault"]),
    flag(0, "SIQREG", &["", "no current controller"]),
];

const ASR2: &[RegisterField] = &[
    flag(15, "OUTPOL", &["outputs are NPN", "outputs are PNP"]),
    flag(14, "SFFAACDEC", &["", "feed-forward of its own for braking"]),
    flag(13, "AICSAR5I", &["", "reference input takes -10 to 10 V"]),
    flag(12, "DNESAPEHP", &["", "homing does not set the position"]),
    flag(11, "SOLSLDCU", &["", "open-loop stepper shows the encoder in its own units"]),
    flag(10, "BISSWFE", &["", "a BiSS warning is a fault"]),
    flag(9, "SOLSLDFCE", &["", "a motor moved while off is a fault"]),
    flag(8, "SOLSLDRTP", &["", "after AXISOFF the target follows the position"]),
    flag(7, "AOCOOE", &["", "CANopen powers the axis at operation enabled"]),
    flag(6, "COSTPOS", &["", "CANopen starts from the actual position"]),
    flag(5, "COUT3RL", &["output 3 is the ready lamp", "output 3 is free"]),
    flag(4, "COUT2EL", &["output 2 is the error lamp", "output 2 is free"]),
    flag(3, "NPIDPCI", &["", "new position controller"]),
];

const ASR3: &[RegisterField] = &[
    flag(13, "MODEDISP", &["", "CANopen shows a new mode at once"]),
    flag(9, "RFCSP", &["", "CANopen position references are filtered"]),
    flag(8, "SOLPIDEN", &["", "open-loop stepper closes the loop at rest"]),
    flag(7, "LSM", &["", "load sensor only watches"]),
    flag(6, "SYMFBKIN", &["", "feedback input takes -10 to 10 V"]),
    flag(5, "SYMREFIN", &["", "reference input takes -10 to 10 V"]),
    flag(4, "SMOOTHRG", &["", "smooth reference at AXISON and AXISOFF"]),
    flag(3, "NFGS", &["", "CANopen factor group of CiA 402-2"]),
    flag(1, "FBKREAD", &["", "feedback input is read"]),
    flag(0, "REFREAD", &["", "reference input is read"]),
];

const ATR: &[RegisterField] = &[
    flag(7, "", &["", "signal added to the voltage"]),
    flag(6, "", &["", "signal added to the current"]),
    field(5, 4, "", &[]),
    flag(3, "", &["", "white noise in the slow loop"]),
    flag(2, "", &["", "white noise added to the current"]),
    flag(1, "", &["", "white noise repeats"]),
    flag(0, "", &["", "white noise in the fast loop"]),
];

const OSR: &[RegisterField] = &[
    flag(15, "ELGMD", &["master sends its position", "master sends its target"]),
    flag(14, "SINCTRL", &["", "sinusoidal current"]),
    flag(13, "STEPMODE", &["", "sinusoidal stepper control"]),
    flag(12, "PSPLC", &["position sensor on the motor", "position sensor on the load"]),
    flag(11, "LOGGER", &["", "logs while the motor starts"]),
    flag(10, "STEPCTRL", &["stepper in open loop", "stepper in closed loop"]),
    flag(9, "BKCMD", &["", "brake"]),
    flag(8, "UDQSAT", &["", "voltages saturate together"]),
    flag(5, "EEDACFSOL", &["", "open-loop stepper is corrected by the load encoder"]),
    field(4, 2, "", &[]),
];

const SCR: &[RegisterField] = &[
    flag(15, "DRL", &["digital reference at feedback 1", "digital reference at feedback 2"]),
    field(14, 12, "MOTOR", &[]),
    flag(11, "SSL", &["speed sensor at feedback 1", "speed sensor at feedback 2"]),
    flag(10, "PSL", &["position sensor at feedback 1", "position sensor at feedback 2"]),
    flag(8, "TSNS2", &["", "drive temperature sensor"]),
    flag(7, "TSNS1", &["", "motor temperature sensor"]),
    field(6, 3, "SSNS", &[]),
    field(2, 0, "PSNS", &[]),
];

const UPGRADE: &[RegisterField] = &[
    flag(15, "STPTBL", &["", "a valid set-up table is needed"]),
    flag(14, "DHSF", &["", "hall signals filtered"]),
    flag(13, "TXBUFF", &["", "CAN sends from a buffer of five"]),
    flag(12, "TINTQSTP", &["", "time interrupt, and quick stop at limit switches"]),
    flag(11, "MCM", &["complete when the target arrives", "complete when the motor settles"]),
    flag(10, "I2TPRT", &["", "I2t of motor and drive apart"]),
    flag(9, "IPOS", &["", "initial positioning may take long"]),
    flag(8, "IORW", &["", "dedicated lines read and set with the others"]),
    flag(7, "ATIME", &["time counts from ENDINIT", "time counts from power-on"]),
    flag(6, "FSTSLW", &["", "position and speed in the fast loop"]),
    flag(5, "STBCRT", &["", "standby current"]),
    flag(4, "SPDCTR", &["", "speed error watched apart"]),
    flag(3, "REG", &["", "registration"]),
    flag(2, "LMTSPDACC", &["", "external references limited"]),
    flag(1, "STPMD", &["", "stepper stop mode"]),
    flag(0, "AREFLMT", &["", "limits of the analogue reference apart"]),
];

const ICR: &[RegisterField] = &[
    flag(15, "GIM", &["interrupts disabled", "interrupts enabled"]),
    flag(12, "PTCDIM", &["", "a position trigger changed"]),
    flag(11, "EVNIM", &["", "the event occurred"]),
    flag(10, "TPIM", &["", "the time period elapsed"]),
    flag(9, "MOTIM", &["", "motion complete"]),
    flag(8, "PCAPIM", &["", "position captured"]),
    flag(7, "LSWNIM", &["", "negative limit switch"]),
    flag(6, "LSWPIM", &["", "positive limit switch"]),
    flag(5, "WRPIM", &["", "position wrapped around"]),
    flag(4, "CMERIM", &["", "communication error"]),
    flag(3, "CTRERIM", &["", "control error"]),
    flag(2, "SWPRIM", &["", "software protection"]),
    flag(1, "PDPIM", &["", "short circuit"]),
    flag(0, "DSLBIM", &["", "ENABLE input changed"]),
];

const PCR: &[RegisterField] = &[
    flag(15, "I2TDPRS", &["", "I2t of the drive: acted"]),
    flag(14, "EBWPRS", &["", "broken encoder wire: acted"]),
    flag(13, "UVPRS", &["", "under-voltage: acted"]),
    flag(12, "OVPRS", &["", "over-voltage: acted"]),
    flag(11, "OT2PRS", &["", "drive temperature: acted"]),
    flag(10, "OT1PRS", &["", "motor temperature: acted"]),
    flag(9, "I2TMPRS", &["", "I2t of the motor: acted"]),
    flag(8, "IMAXPRS", &["", "over-current: acted"]),
    flag(7, "I2TDPRM", &["", "I2t of the drive: enabled"]),
    flag(6, "EBWPRM", &["", "broken encoder wire: enabled"]),
    flag(5, "UVPRM", &["", "under-voltage: enabled"]),
    flag(4, "OVPRM", &["", "over-voltage: enabled"]),
    flag(3, "OT2PRM", &["", "drive temperature: enabled"]),
    flag(2, "OT1PRM", &["", "motor temperature: enabled"]),
    flag(1, "I2TMPRM", &["", "I2t of the motor: enabled"]),
    flag(0, "IMAXPRM", &["", "over-current: enabled"]),
];

const CBR: &[RegisterField] = &[field(15, 8, "BTR1", &[]), field(7, 0, "BTR0", &[])];
