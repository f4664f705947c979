extern crate std;

mod checks;
mod codec;
mod doubt;
mod driver;
mod pair;
mod round_trip;
mod tcp;
mod world;

use super::rtu;

#[test]
fn crc_of_the_manuals_frame() {
    assert_eq!(rtu::crc16(&[0x01, 0x06, 0x00, 0x33, 0x00, 0xC8]), 0x5378);
    assert_eq!(rtu::crc16(b"123456789"), 0x4B37);
}
