//! Registers that say how the drive works.

use super::{Bits, Register, field, set};

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

const MCR: &[Bits] = &[
    set(15, "MMODE", &["", "new motion mode"]),
    set(14, "MODECHG", &["starts from where the motor is (TUM0)", "starts from the target (TUM1)"]),
    set(13, "POSTYPE", &["positions relative", "positions absolute"]),
    set(12, "REGMODE", &["", "a second motion is superposed"]),
    set(11, "ELGEAR", &["", "master of gear and cam"]),
    set(10, "POSLP", &["", "position loop closed"]),
    set(9, "SPDLP", &["", "speed loop closed"]),
    set(8, "CRTLP", &["", "current loop closed"]),
    field(
        7,
        6,
        "EXTREF",
        &["reference over the line", "reference analogue", "reference digital", ""],
    ),
    set(5, "REFLOC", &["", "torque reference read in the fast loop"]),
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

const ACR: &[Bits] = &[
    set(15, "HALLST", &["", "hall start by PMSM control alone"]),
    set(14, "SPDFWD", &["", "speed feed-forward without a speed loop"]),
    set(13, "SOLCTR", &["", "open-loop stepper follows the analogue reference in speed"]),
    set(12, "CAMTYPE", &["cam relative", "cam absolute"]),
    set(11, "RPOSTYPE", &["", "relative moves add up"]),
    set(10, "POSCTR", &["", "position control"]),
    set(9, "SPDCTR", &["", "speed control"]),
    set(8, "TCTR", &["", "torque control"]),
    set(7, "DIGREF", &["", "digital reference from power-on"]),
    set(6, "AREF", &["", "analogue reference from power-on"]),
    set(5, "RDAREF", &["", "torque reference read in the fast loop"]),
    set(4, "FRZOPT", &["", "freeze control with limits of its own"]),
    set(3, "AXISEN", &["", "AXISON when the ENABLE input comes"]),
    set(
        2,
        "DIGTYPE",
        &["digital reference is a second encoder", "digital reference is pulse and direction"],
    ),
    set(1, "ASTART", &["", "starts by itself after power-on"]),
    set(0, "STPSC", &["stops on an S-curve", "stops on a trapezoid"]),
];

const ASR: &[Bits] = &[
    set(15, "ACTSPDEST", &["", "speed estimator"]),
    set(13, "I2TFRA", &["", "no fault reset until the I2t integral is zero"]),
    set(12, "SWLEN", &["", "software limits"]),
    set(11, "RMDIR", &["", "direction reversed"]),
    set(10, "SWAD25", &["", "analogue inputs 2 and 5 exchanged"]),
    set(9, "EERES", &["", "encoder resolution beyond 65535"]),
    set(8, "COIM", &["", "CANopen interpolation as the standard has it"]),
    set(7, "NMNT", &["", "negative transmission treated the new way"]),
    set(6, "RSTPCHY", &["", "position controller starts afresh"]),
    set(5, "RSTSCHY", &["", "speed controller starts afresh"]),
    set(4, "RSTCCHY", &["", "current controller starts afresh"]),
    set(3, "TUM0TSSV", &["", "with TUM0 the next motion begins at speed zero"]),
    set(2, "INPOL", &["inputs are PNP", "inputs are NPN"]),
    set(1, "I2TINT", &["", "I2t limits the current and is no fault"]),
    set(0, "SIQREG", &["", "no current controller"]),
];

const ASR2: &[Bits] = &[
    set(15, "OUTPOL", &["outputs are NPN", "outputs are PNP"]),
    set(14, "SFFAACDEC", &["", "feed-forward of its own for braking"]),
    set(13, "AICSAR5I", &["", "reference input takes -10 to 10 V"]),
    set(12, "DNESAPEHP", &["", "homing does not set the position"]),
    set(11, "SOLSLDCU", &["", "open-loop stepper shows the encoder in its own units"]),
    set(10, "BISSWFE", &["", "a BiSS warning is a fault"]),
    set(9, "SOLSLDFCE", &["", "a motor moved while off is a fault"]),
    set(8, "SOLSLDRTP", &["", "after AXISOFF the target follows the position"]),
    set(7, "AOCOOE", &["", "CANopen powers the axis at operation enabled"]),
    set(6, "COSTPOS", &["", "CANopen starts from the actual position"]),
    set(5, "COUT3RL", &["output 3 is the ready lamp", "output 3 is free"]),
    set(4, "COUT2EL", &["output 2 is the error lamp", "output 2 is free"]),
    set(3, "NPIDPCI", &["", "new position controller"]),
];

const ASR3: &[Bits] = &[
    set(13, "MODEDISP", &["", "CANopen shows a new mode at once"]),
    set(9, "RFCSP", &["", "CANopen position references are filtered"]),
    set(8, "SOLPIDEN", &["", "open-loop stepper closes the loop at rest"]),
    set(7, "LSM", &["", "load sensor only watches"]),
    set(6, "SYMFBKIN", &["", "feedback input takes -10 to 10 V"]),
    set(5, "SYMREFIN", &["", "reference input takes -10 to 10 V"]),
    set(4, "SMOOTHRG", &["", "smooth reference at AXISON and AXISOFF"]),
    set(3, "NFGS", &["", "CANopen factor group of CiA 402-2"]),
    set(1, "FBKREAD", &["", "feedback input is read"]),
    set(0, "REFREAD", &["", "reference input is read"]),
];

const ATR: &[Bits] = &[
    set(7, "", &["", "signal added to the voltage"]),
    set(6, "", &["", "signal added to the current"]),
    field(5, 4, "", &[]),
    set(3, "", &["", "white noise in the slow loop"]),
    set(2, "", &["", "white noise added to the current"]),
    set(1, "", &["", "white noise repeats"]),
    set(0, "", &["", "white noise in the fast loop"]),
];

const OSR: &[Bits] = &[
    set(15, "ELGMD", &["master sends its position", "master sends its target"]),
    set(14, "SINCTRL", &["", "sinusoidal current"]),
    set(13, "STEPMODE", &["", "sinusoidal stepper control"]),
    set(12, "PSPLC", &["position sensor on the motor", "position sensor on the load"]),
    set(11, "LOGGER", &["", "logs while the motor starts"]),
    set(10, "STEPCTRL", &["stepper in open loop", "stepper in closed loop"]),
    set(9, "BKCMD", &["", "brake"]),
    set(8, "UDQSAT", &["", "voltages saturate together"]),
    set(5, "EEDACFSOL", &["", "open-loop stepper is corrected by the load encoder"]),
    field(4, 2, "", &[]),
];

const SCR: &[Bits] = &[
    set(15, "DRL", &["digital reference at feedback 1", "digital reference at feedback 2"]),
    field(14, 12, "MOTOR", &[]),
    set(11, "SSL", &["speed sensor at feedback 1", "speed sensor at feedback 2"]),
    set(10, "PSL", &["position sensor at feedback 1", "position sensor at feedback 2"]),
    set(8, "TSNS2", &["", "drive temperature sensor"]),
    set(7, "TSNS1", &["", "motor temperature sensor"]),
    field(6, 3, "SSNS", &[]),
    field(2, 0, "PSNS", &[]),
];

const UPGRADE: &[Bits] = &[
    set(15, "STPTBL", &["", "a valid set-up table is needed"]),
    set(14, "DHSF", &["", "hall signals filtered"]),
    set(13, "TXBUFF", &["", "CAN sends from a buffer of five"]),
    set(12, "TINTQSTP", &["", "time interrupt, and quick stop at limit switches"]),
    set(11, "MCM", &["complete when the target arrives", "complete when the motor settles"]),
    set(10, "I2TPRT", &["", "I2t of motor and drive apart"]),
    set(9, "IPOS", &["", "initial positioning may take long"]),
    set(8, "IORW", &["", "dedicated lines read and set with the others"]),
    set(7, "ATIME", &["time counts from ENDINIT", "time counts from power-on"]),
    set(6, "FSTSLW", &["", "position and speed in the fast loop"]),
    set(5, "STBCRT", &["", "standby current"]),
    set(4, "SPDCTR", &["", "speed error watched apart"]),
    set(3, "REG", &["", "registration"]),
    set(2, "LMTSPDACC", &["", "external references limited"]),
    set(1, "STPMD", &["", "stepper stop mode"]),
    set(0, "AREFLMT", &["", "limits of the analogue reference apart"]),
];

const ICR: &[Bits] = &[
    set(15, "GIM", &["interrupts disabled", "interrupts enabled"]),
    set(12, "PTCDIM", &["", "a position trigger changed"]),
    set(11, "EVNIM", &["", "the event occurred"]),
    set(10, "TPIM", &["", "the time period elapsed"]),
    set(9, "MOTIM", &["", "motion complete"]),
    set(8, "PCAPIM", &["", "position captured"]),
    set(7, "LSWNIM", &["", "negative limit switch"]),
    set(6, "LSWPIM", &["", "positive limit switch"]),
    set(5, "WRPIM", &["", "position wrapped around"]),
    set(4, "CMERIM", &["", "communication error"]),
    set(3, "CTRERIM", &["", "control error"]),
    set(2, "SWPRIM", &["", "software protection"]),
    set(1, "PDPIM", &["", "short circuit"]),
    set(0, "DSLBIM", &["", "ENABLE input changed"]),
];

const PCR: &[Bits] = &[
    set(15, "I2TDPRS", &["", "I2t of the drive: acted"]),
    set(14, "EBWPRS", &["", "broken encoder wire: acted"]),
    set(13, "UVPRS", &["", "under-voltage: acted"]),
    set(12, "OVPRS", &["", "over-voltage: acted"]),
    set(11, "OT2PRS", &["", "drive temperature: acted"]),
    set(10, "OT1PRS", &["", "motor temperature: acted"]),
    set(9, "I2TMPRS", &["", "I2t of the motor: acted"]),
    set(8, "IMAXPRS", &["", "over-current: acted"]),
    set(7, "I2TDPRM", &["", "I2t of the drive: enabled"]),
    set(6, "EBWPRM", &["", "broken encoder wire: enabled"]),
    set(5, "UVPRM", &["", "under-voltage: enabled"]),
    set(4, "OVPRM", &["", "over-voltage: enabled"]),
    set(3, "OT2PRM", &["", "drive temperature: enabled"]),
    set(2, "OT1PRM", &["", "motor temperature: enabled"]),
    set(1, "I2TMPRM", &["", "I2t of the motor: enabled"]),
    set(0, "IMAXPRM", &["", "over-current: enabled"]),
];

const CBR: &[Bits] = &[field(15, 8, "BTR1", &[]), field(7, 0, "BTR0", &[])];
