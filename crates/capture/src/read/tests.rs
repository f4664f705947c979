//! Files as other people's tools write them.

use crate::{CaptureReader, Record};

/// The records of a file as `time link way data`, and the damage.
fn read(file: &str) -> (Vec<String>, Vec<String>) {
    let (mut found, mut reader) = (Vec::new(), CaptureReader::default());
    let mut keep = |record: &Record<'_>| found.push(shown(record));
    reader.feed(file.as_bytes(), &mut keep);
    reader.finish(&mut keep);
    (found, reader.statistics().damage.iter().map(ToString::to_string).collect())
}

/// A record as the text that we write.
fn shown(record: &Record<'_>) -> String {
    let mut writer =
        crate::CaptureWriter::new(crate::CaptureFormat::Text, None, Vec::new()).expect("text");
    writer.write(record).expect("fits");
    let text = String::from_utf8(writer.finish().expect("written")).expect("text");
    text.trim_end().to_owned()
}

#[test]
fn candump_on_the_screen() {
    let (found, damage) = read(
        "  can0  123   [2]  01 02\n\
         \x20can1  0400A05E   [2]  34 12                     '4.'\n\
         \x20(001.500000)  can0  TX - -  123   [0] \n\
         \x20(1700000000.500000)  can0  RX B -  123   [3]  remote request\n\
         \x20 can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME\n\
         \x20 can0  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B\n",
    );
    assert_eq!(damage, [] as [&str; 0]);
    let expected = [
        "can0 123#0102",
        "can1 0400A05E#3412",
        "(0000000001.500000) can0 123# T",
        "(1700000000.500000) can0 123#R3 R",
        "can0 20000004#0004000000000000",
        "can0 123##0000102030405060708090A0B",
    ];
    assert_eq!(found, expected);
}

#[test]
fn vector_asc() {
    let (found, damage) = read(
        "date Sat Sep 30 15:06:13.191 2017\r\n\
         base hex  timestamps absolute\r\n\
         internal events logged\r\n\
         // version 9.0.0\r\n\
         Begin Triggerblock Sat Sep 30 15:06:13.191 2017\r\n\
         \x20  0.000000 Start of measurement\r\n\
         \x20  0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0\r\n\
         \x20  2.501000 1  ErrorFrame\r\n\
         \x20  2.510001 2  100             Rx   r\r\n\
         \x20  2.520002 3  200             Tx   r Length = 1704000 BitCount = 145\r\n\
         \x20  2.584921 4  300             Tx   r 8 Length = 1704000 BitCount = 145\r\n\
         \x20  3.098426 1  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910\r\n\
         \x20  4.000000 1  Statistic: D 1 R 1 XD 0 XR 0 E 0 O 0 B 0.02%\r\n\
         \x20  5.000000 CANFD   1 Rx        300          1 0 9 12 01 02 03 04 05 06 07 08 09 0A 0B 0C   102203\r\n\
         \x20  6.000000 1  Engine          Rx   d 1 01\r\n\
         End TriggerBlock\r\n",
    );
    assert_eq!(damage, ["line 15: expected an identifier; names of messages are not read"]);
    let expected = [
        "(1506783975.692000) can0 20000080#0000000000000000",
        "(1506783975.701001) can1 100#R R",
        "(1506783975.711002) can2 200#R T",
        "(1506783975.775921) can3 300#R8 T",
        "(1506783976.289426) can0 18EBFF00#01A00FA6603BD140 R",
        "(1506783978.191000) can0 300##10102030405060708090A0B0C R",
    ];
    assert_eq!(found, expected);
}

#[test]
fn vector_asc_decimal_and_relative() {
    let (found, damage) = read(
        "date Mon Jan 1 00:00:01 1970\nbase dec  timestamps relative\n\
         0.500000 1  291 Rx d 2 17 255\n0.250000 1  292 Rx d 0\n",
    );
    assert_eq!(damage, [] as [&str; 0]);
    assert_eq!(found, ["(0000000001.500000) can0 123#11FF R", "(0000000001.750000) can0 124# R"]);
}

#[test]
fn peak_trc() {
    let first = ";##########\n;   Start time: 30.09.2017\n\
         \x20    1)      1841      0001  8  00 11 22 33 44 55 66 77\n\
         \x20    2)      1842.5    18EBFF00  1  AA\n\
         \x20    3)      1843      0002  3  RTR\n";
    let (found, damage) = read(first);
    assert_eq!(damage, [] as [&str; 0]);
    let expected = [
        "(0000000001.841000) can0 001#0011223344556677",
        "(0000000001.842500) can0 18EBFF00#AA",
        "(0000000001.843000) can0 002#R3",
    ];
    assert_eq!(found, expected);
    let second = ";$FILEVERSION=1.1\n;$STARTTIME=25569.0\n;\n\
         \x20    1)      1841.2  Rx         0001  2  00 11\n\
         \x20    2)      1842.0  Warng  FFFFFFFF  4  00 00 00 08  BUSHEAVY\n";
    let (found, damage) = read(second);
    assert_eq!(damage, [] as [&str; 0]);
    let expected = [
        "(0000000001.841200) can0 001#0011 R",
        "(0000000001.842000) can0 20000004#0030000000000000",
    ];
    assert_eq!(found, expected);
    let third = ";$FILEVERSION=2.1\n;$STARTTIME=25569.0\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n\
         \x20     1      1059.900 DT 1      0300 Rx -  2    00 11\n\
         \x20     2      1060.900 FB 2  00000301 Tx -  9    00 01 02 03 04 05 06 07 08 09 0A 0B\n\
         \x20     3      1061.900 RR 1      0302 Rx -  4\n\
         \x20     4      1062.900 ST 1         - Rx -  4    00 00 00 00\n\
         \x20     5      1063.900 DT 1      0300 Rx -  2    00\n";
    let (found, damage) = read(third);
    assert_eq!(damage, ["line 9: it has fewer bytes than its length says"]);
    let expected = [
        "(0000000001.059900) can0 300#0011 R",
        "(0000000001.060900) can1 00000301##1000102030405060708090A0B T",
        "(0000000001.061900) can0 302#R4 R",
    ];
    assert_eq!(found, expected);
    let fourth = ";$FILEVERSION=2.0\n;$COLUMNS=N,O,T,I,d,l,D\n\
         \x20     1      1059.900 DT     0300 Rx 2  00 11\n";
    assert_eq!(read(fourth).0, ["(0000000001.059900) can0 300#0011 R"]);
}

#[test]
fn python_cans_csv() {
    let (found, damage) = read(
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n\
         1483389946.197,0xdadada,1,0,0,6,WzQyLCA5\n\
         1483389946.25,0x123,0,1,0,4,\n\
         1483389946.5,0x123,0,0,0,4,AAA=\n",
    );
    assert_eq!(damage, ["line 4: it has fewer bytes than its length says"]);
    let expected =
        ["(1483389946.197000) can0 00DADADA#5B34322C2039", "(1483389946.250000) can0 123#R4"];
    assert_eq!(found, expected);
}

#[test]
fn what_decode_prints_is_read_back() {
    let lines = [
        "(1700000000.000500) can0 30B#5443000000000005",
        "(1700000000.000501) ttyUSB0 > 01 0A FF",
        "(1700000000.000501) ttyUSB0 < 01",
        "(1700000000.000501) can0 123#R",
        "(1700000000.123456789) can0 20000040#0000000000000000",
    ];
    let mut printed = Vec::new();
    let mut decoder = crate::CaptureDecoder::new(crate::Rules::default());
    let mut write =
        |event: &crate::DecodedFrame<'_>| crate::jsonl::write_frame(event, &mut printed);
    decoder.feed(lines.join("\n").as_bytes(), &mut write);
    decoder.finish(&mut write);
    let (found, damage) = read(std::str::from_utf8(&printed).expect("text"));
    assert_eq!(damage, [] as [&str; 0]);
    assert_eq!(found, lines);
}

/// A pcap file of one packet of that link type.
fn pcap(kind: u32, packet: &[u8]) -> Vec<u8> {
    let size = packet.len() as u32;
    let words = [0xA1B2_C3D4, 2 | 4 << 16, 0, 0, 0xFFFF, kind, 1, 500_000, size, size];
    words.iter().flat_map(|word: &u32| word.to_le_bytes()).chain(packet.iter().copied()).collect()
}

#[test]
fn packets_of_every_interface_at_once() {
    let frame = [0x80, 0, 0x12, 0x34, 2, 0, 0, 0, 0xAA, 0xBB];
    let cooked = |way: u8| {
        let header = [0, way, 1, 0x18, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x0C];
        [&header[..], &frame].concat()
    };
    let cooked_2 = |way: u8| {
        let header = [0, 0x0C, 0, 0, 0, 0, 0, 3, 1, 0x18, way, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        [&header[..], &frame].concat()
    };
    for (kind, packet, way) in [
        (227, frame.to_vec(), ""),
        (113, cooked(4), " T"),
        (113, cooked(0), " R"),
        (276, cooked_2(4), " T"),
        (276, cooked_2(0), " R"),
    ] {
        let (mut found, mut reader) = (Vec::new(), CaptureReader::default());
        reader.feed(&pcap(kind, &packet), &mut |record| found.push(shown(record)));
        reader.finish(&mut |record| found.push(shown(record)));
        assert_eq!(found, [format!("(0000000001.500000) can0 00001234#AABB{way}")], "{kind}");
        assert_eq!(reader.statistics().damaged, 0, "{kind}");
    }
    let mut reader = CaptureReader::default();
    reader.feed(&pcap(1, &frame), &mut |_| panic!("Ethernet"));
    assert_eq!(reader.statistics().damaged, 1);
}

#[test]
fn peak_trc_between_the_versions() {
    let second = ";$FILEVERSION=1.2\n;$STARTTIME=25569.0\n\
         \x20    1)      1059.900 2  Rx         0300  2  00 11\n";
    assert_eq!(read(second), (vec!["(0000000001.059900) can1 300#0011 R".to_owned()], vec![]));
    let third = ";$FILEVERSION=1.3\n;$STARTTIME=25569.0\n\
         \x20    1)      1059.900 1  Tx         0300 -  2  00 11\n";
    assert_eq!(read(third), (vec!["(0000000001.059900) can0 300#0011 T".to_owned()], vec![]));
}

/// Where records begin is told, however the file is cut.
#[test]
fn places_of_lines() {
    let file = b"# a comment\n(1.5) can0 123#01\nnonsense\n(1.5) can0 123#02\n01 02";
    for cut in 0..file.len() {
        let (mut found, mut reader) = (Vec::new(), CaptureReader::default());
        let mut keep = |record: &Record<'_>| found.push(record.offset);
        reader.feed(&file[..cut], &mut keep);
        reader.feed(&file[cut..], &mut keep);
        reader.finish(&mut keep);
        assert_eq!(found, [12, 39, 57], "cut at {cut}");
    }
}
