//! Opcodes and statuses: two bytes with names, from two tables.
//!
//! Numbers and names: TMCL reference manuals, the vendor's host library and evaluation firmware. The
//! TMCM-170/171 manual prints 1, 6 and a few more. A module answers missing opcodes with
//! [`Status::InvalidCommand`].

/// A byte whose numbers have names: any byte is one, and none has to be looked up to be read, compared
/// or written.
macro_rules! named {
    ($(#[$doc:meta])* $name:ident { $($number:literal $variant:ident $word:literal $text:literal)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Hash)]
        #[repr(transparent)]
        pub struct $name(u8);

        #[allow(non_upper_case_globals, reason = "used and matched on as the variants of an enum are")]
        impl $name {
            $(#[doc = concat!($number, ": ", $text, ".")] pub const $variant: Self = Self($number);)+

            /// All that have names, by number.
            pub const NAMED: &'static [Self] = &[$(Self::$variant),+];

            /// A bit for each number that has a name: every reply is asked for its own.
            const NAMED_BITS: [u64; 4] = {
                let mut bits = [0; 4];
                $(bits[$number >> 6] |= 1 << ($number & 63);)+
                bits
            };

            /// The number on the wire.
            #[must_use]
            #[inline]
            pub const fn number(self) -> u8 {
                self.0
            }

            /// Returns whether the number has a name.
            #[must_use]
            #[inline]
            pub const fn is_named(self) -> bool {
                Self::NAMED_BITS[(self.0 >> 6) as usize] >> (self.0 & 63) & 1 != 0
            }

            /// The short name; empty for a number without one.
            #[must_use]
            pub const fn word(self) -> &'static str {
                match self.0 {
                    $($number => $word,)+
                    _ => "",
                }
            }

            /// Meaning of the status; empty for a number without a name.
            #[must_use]
            pub const fn text(self) -> &'static str {
                match self.0 {
                    $($number => $text,)+
                    _ => "",
                }
            }
        }

        impl From<u8> for $name {
            #[inline]
            fn from(number: u8) -> Self {
                Self(number)
            }
        }

        impl core::fmt::Debug for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match *self {
                    $(Self::$variant => f.write_str(stringify!($variant)),)+
                    Self(number) => write!(f, "Unknown({number})"),
                }
            }
        }
    };
}

named! {
    /// Instruction of a request.
    Opcode {
        1 Ror "ROR" "rotate right"
        2 Rol "ROL" "rotate left"
        3 Mst "MST" "stop the motor"
        4 Mvp "MVP" "move to position"
        5 Sap "SAP" "set axis parameter"
        6 Gap "GAP" "read axis parameter"
        7 Stap "STAP" "store axis parameter"
        8 Rsap "RSAP" "restore axis parameter"
        9 Sgp "SGP" "set global parameter"
        10 Ggp "GGP" "read global parameter"
        11 Stgp "STGP" "store global parameter"
        12 Rsgp "RSGP" "restore global parameter"
        13 Rfs "RFS" "reference search"
        14 Sio "SIO" "set output"
        15 Gio "GIO" "read input or output"
        16 Sapx "SAPX" "set axis parameter, axis from the X register"
        17 Gapx "GAPX" "read axis parameter, axis from the X register"
        18 Aapx "AAPX" "accumulator to axis parameter, axis from the X register"
        19 Calc "CALC" "calculate with the accumulator"
        20 Comp "COMP" "compare the accumulator"
        21 Jc "JC" "jump conditionally"
        22 Ja "JA" "jump"
        23 Csub "CSUB" "call subroutine"
        24 Rsub "RSUB" "return from subroutine"
        25 Ei "EI" "enable interrupt"
        26 Di "DI" "disable interrupt"
        27 Wait "WAIT" "wait for an event"
        28 Stop "STOP" "end of program"
        29 Sac "SAC" "SPI bus access"
        30 Sco "SCO" "set coordinate"
        31 Gco "GCO" "read coordinate"
        32 Cco "CCO" "capture coordinate"
        33 Calcx "CALCX" "calculate with the X register"
        34 Aap "AAP" "accumulator to axis parameter"
        35 Agp "AGP" "accumulator to global parameter"
        36 Cle "CLE" "clear error flags"
        37 Vect "VECT" "set interrupt vector"
        38 Reti "RETI" "return from interrupt"
        39 Aco "ACO" "accumulator to coordinate"
        40 Calcvv "CALCVV" "calculate with two user variables"
        41 Calcva "CALCVA" "calculate user variable with the accumulator"
        42 Calcav "CALCAV" "calculate the accumulator with a user variable"
        43 Calcvx "CALCVX" "calculate user variable with the X register"
        44 Calcxv "CALCXV" "calculate the X register with a user variable"
        45 Calcv "CALCV" "calculate user variable with a constant"
        46 Mvpa "MVPA" "move to the accumulator's position"
        47 Mvpxa "MVPXA" "move to the accumulator's position, axis from the X register"
        48 Rst "RST" "restart the program from"
        49 Djnz "DJNZ" "decrement and jump if not zero"
        50 Rola "ROLA" "rotate left with the accumulator's speed"
        51 Rora "RORA" "rotate right with the accumulator's speed"
        52 Rolxa "ROLXA" "rotate left with the accumulator's speed, axis from the X register"
        53 Rorxa "RORXA" "rotate right with the accumulator's speed, axis from the X register"
        54 Mstx "MSTX" "stop the motor, axis from the X register"
        55 Siv "SIV" "set indexed variable"
        56 Giv "GIV" "read indexed variable"
        57 Aiv "AIV" "accumulator to indexed variable"
        58 Pusha "PUSHA" "push the accumulator"
        59 Pushx "PUSHX" "push the X register"
        60 Pushv "PUSHV" "push a user variable"
        61 Popa "POPA" "pop the accumulator"
        62 Popx "POPX" "pop the X register"
        63 Popv "POPV" "pop a user variable"
        64 Uf0 "UF0" "user function 0"
        65 Uf1 "UF1" "user function 1"
        66 Uf2 "UF2" "user function 2"
        67 Uf3 "UF3" "user function 3"
        68 Uf4 "UF4" "user function 4"
        69 Uf5 "UF5" "user function 5"
        70 Uf6 "UF6" "user function 6"
        71 Uf7 "UF7" "user function 7"
        80 Call "CALL" "call subroutine conditionally"
        128 ProgramStop "STOP APPLICATION" "stop the program"
        129 ProgramRun "RUN APPLICATION" "run the program"
        130 ProgramStep "STEP APPLICATION" "run one instruction of the program"
        131 ProgramReset "RESET APPLICATION" "reset the program"
        132 DownloadStart "START DOWNLOAD" "start program download"
        133 DownloadEnd "QUIT DOWNLOAD" "end program download"
        134 ReadMemory "READ MEMORY" "read program memory"
        135 ProgramStatus "APPLICATION STATUS" "read the program's status"
        136 Version "GET VERSION" "read the firmware version"
        137 FactoryDefault "FACTORY DEFAULT" "restore factory settings"
        138 PositionReached "POSITION EVENT" "tell when the target position is reached"
        139 EnterAscii "ENTER ASCII" "enter ASCII mode"
        140 Security "SECURITY" "security code"
        141 Breakpoint "BREAKPOINT" "set breakpoint"
        142 RamDebug "RAM DEBUG" "RAM debugger"
        143 BoardIds "BOARD IDS" "read the board's ids"
        146 WriteMotionRegister "WRITEMC" "write motion-control register"
        147 WriteDriverRegister "WRITEDRV" "write driver register"
        148 ReadMotionRegister "READMC" "read motion-control register"
        149 ReadDriverRegister "READDRV" "read driver register"
        157 Info "GET INFO" "read module information"
        200 BootErase "BOOT ERASE" "bootloader: erase all"
        201 BootWriteBuffer "BOOT WRITE BUFFER" "bootloader: fill the page buffer"
        202 BootWritePage "BOOT WRITE PAGE" "bootloader: write a page"
        203 BootChecksum "BOOT CHECKSUM" "bootloader: read the checksum"
        204 BootReadMemory "BOOT READ MEMORY" "bootloader: read memory"
        205 BootStart "BOOT START" "bootloader: start the application"
        206 BootInfo "BOOT INFO" "bootloader: read information"
        208 BootWriteLength "BOOT WRITE LENGTH" "bootloader: write length and checksum"
        242 Boot "BOOT" "enter the bootloader"
        255 SoftwareReset "SOFTWARE RESET" "reset the module"
    }
}

named! {
    /// Status of a request.
    Status {
        1 WrongChecksum "WrongChecksum" "wrong checksum"
        2 InvalidCommand "InvalidCommand" "invalid command"
        3 WrongType "WrongType" "wrong type"
        4 InvalidValue "InvalidValue" "invalid value"
        5 EepromLocked "EepromLocked" "configuration EEPROM locked"
        6 NotAvailable "NotAvailable" "command not available"
        7 LoadError "LoadError" "load error"
        8 WriteProtected "WriteProtected" "write protected"
        9 MaximumExceeded "MaximumExceeded" "maximum exceeded"
        10 DownloadNotPossible "DownloadNotPossible" "download not possible"
        11 ChipReadFailed "ChipReadFailed" "reading the chip failed"
        100 Ok "Ok" "done"
        101 Loaded "Loaded" "loaded into program memory"
        128 Event "Event" "later event"
        129 Busy "Busy" "communication active"
    }
}

/// Type of RFS that reads whether a search is running.
pub const SEARCH_STATUS: u8 = 2;

impl Opcode {
    /// The opcode of that mnemonic, letter case ignored.
    #[must_use]
    pub fn of_word(word: &str) -> Option<Self> {
        Self::NAMED.iter().copied().find(|opcode| opcode.word().eq_ignore_ascii_case(word))
    }

    /// Returns whether the byte after the type is a motor.
    #[must_use]
    pub const fn has_motor(self) -> bool {
        matches!(
            self,
            Self::Ror
                | Self::Rol
                | Self::Mst
                | Self::Mvp
                | Self::Sap
                | Self::Gap
                | Self::Stap
                | Self::Rsap
                | Self::Rfs
                | Self::Sco
                | Self::Gco
                | Self::Cco
        )
    }

    /// Returns whether it only reads: a repetition has no effect.
    #[must_use]
    pub const fn only_reads(self) -> bool {
        matches!(
            self,
            Self::Gap
                | Self::Ggp
                | Self::Gio
                | Self::Gco
                | Self::Gapx
                | Self::Giv
                | Self::ReadMemory
                | Self::ProgramStatus
                | Self::Version
                | Self::BoardIds
                | Self::ReadMotionRegister
                | Self::ReadDriverRegister
                | Self::Info
                | Self::BootChecksum
                | Self::BootReadMemory
                | Self::BootInfo
        )
    }
}

impl Status {
    /// Returns whether the module executed the request. \[I\] 100 and above, as in the vendor's host library.
    #[must_use]
    #[inline]
    pub const fn is_good(self) -> bool {
        self.0 >= Self::Ok.0
    }

    /// Returns whether it is the final status of a request.
    #[must_use]
    #[inline]
    pub const fn ends_request(self) -> bool {
        matches!(self, Self::Ok) || (self.is_named() && !matches!(self, Self::Event | Self::Busy))
    }
}
