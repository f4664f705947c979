//! Names of programs in the first lines of their files.

/// Words of the first lines, in lower case, and the program that writes them.
const PROGRAMS: [(&str, &str); 18] = [
    ("***busmaster", "BUSMASTER"),
    ("vehicle spy", "Vehicle Spy"),
    ("vspy", "Vehicle Spy"),
    ("canking", "Kvaser CanKing"),
    ("kvaser", "a program of Kvaser"),
    ("pcan-explorer", "PCAN-Explorer"),
    ("pcan-view", "PCAN-View"),
    ("ixxat", "a program of IXXAT"),
    ("canalyzer", "CANalyzer"),
    ("canopen magic", "CANopen Magic"),
    ("zcanpro", "ZCANPRO"),
    ("usb_can tool", "USB_CAN Tool"),
    ("qmodmaster", "QModMaster"),
    ("modbus poll", "Modbus Poll"),
    ("modbus doctor", "Modbus Doctor"),
    ("docklight", "Docklight"),
    ("realterm", "RealTerm"),
    ("serial port monitor", "Serial Port Monitor"),
];

/// The program that a file's head names.
pub(super) fn find_name(head: &[u8]) -> Option<&'static str> {
    let text = String::from_utf8_lossy(head).to_lowercase();
    PROGRAMS.iter().find(|(word, _)| text.contains(word)).map(|(_, name)| *name)
}
