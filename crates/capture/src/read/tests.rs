//! Files as other people's tools write them.

use crate::{CaptureReader, Record};

mod programs;

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
        "(1506783973.206991) can0 20000204#0030000000008400",
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
         \x20     5      1063.900 DT 1      0300 Rx -  2    00\n\
         \x20     6      1064.900 ST 1         - Rx -  4    00 00 00 10\n\
         \x20     7      1065.900 EC 1         - Rx -  2    80 04\n\
         \x20     8      1066.900 EV 1 a note\n";
    let (found, damage) = read(third);
    assert_eq!(damage, ["line 9: it has fewer bytes than its length says"]);
    let expected = [
        "(0000000001.059900) can0 300#0011 R",
        "(0000000001.060900) can1 00000301##1000102030405060708090A0B T",
        "(0000000001.061900) can0 302#R4 R",
        "(0000000001.062900) can0 20000004#0040000000000000",
        "(0000000001.064900) can0 20000040#0000000000000000",
        "(0000000001.065900) can0 20000204#0010000000000480",
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
fn the_output_of_decode_is_read_back() {
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
    reader.feed(&pcap(1, &frame), &mut |_| panic!("no TCP"));
    assert_eq!(reader.statistics().skipped, [("packets that are not TCP", 1)]);
    let mut reader = CaptureReader::default();
    reader.feed(&pcap(195, &frame), &mut |_| panic!("another link type"));
    let others =
        "packets of another link type than CAN (227), serial bytes (147) or a network with TCP";
    assert_eq!(reader.statistics().skipped, [(others, 1)]);
}

/// The private link type is also used for frames without a byte of direction.
#[test]
fn serial_packets_with_and_without_a_direction() {
    let (rtu, tmcl) = ([1, 3, 1, 0x80, 0, 0x0A, 0xC5, 0xD9], [2, 6, 1, 0, 0, 0, 0, 0, 9]);
    let directed = [&[1][..], &rtu].concat();
    for (packet, expected, notes) in [
        (&rtu[..], "- 01 03 01 80 00 0A C5 D9", 1),
        (&tmcl, "- 02 06 01 00 00 00 00 00 09", 1),
        (&directed, "- > 01 03 01 80 00 0A C5 D9", 0),
    ] {
        let (found, statistics) = read_all(&pcap(147, packet));
        assert_eq!(
            found,
            [format!("(0000000001.500000) {}", expected.replacen('-', "serial0", 1))]
        );
        assert_eq!((statistics.notes.len(), statistics.damaged), (notes, 0), "{expected}");
    }
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

/// The positions of records are found, however the file is cut.
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

/// The records, and the objects that were passed over.
fn read_all(file: &[u8]) -> (Vec<String>, crate::ReadStatistics) {
    let (mut found, mut reader) = (Vec::new(), CaptureReader::default());
    let mut keep = |record: &Record<'_>| found.push(shown(record));
    reader.feed(file, &mut keep);
    reader.finish(&mut keep);
    (found, reader.statistics().clone())
}

/// The records of a file without damage.
fn read_whole(file: &str) -> Vec<String> {
    let (found, statistics) = read_all(file.as_bytes());
    assert_eq!(statistics.damage, [], "{file}");
    found
}

#[test]
fn candump_with_all_its_options() {
    // -tA, -c, -S, -8, -i, -e.
    let file = " (2026-11-27 12:34:56.123456)  can0  701   [1]  05\n\
        \x20\u{1B}[32m can0 \u{1B}[1m 123 \u{1B}[0m  [2]  01 02\u{1B}[0m\n\
        \x20 can0  123   [3]  33`22`11\n\
        \x20 can0  123   {B}  00 11 22 33 44 55 66 77\n\
        \x20 can0  123   {2}  00 11\n\
        \x20 can0  123   [2]  00000001 11000010\n\
        \x20 can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME\n\
        \tcontroller-problem{rx-error-warning}\n\
        \x20 can0  124   [1]  00\n";
    let expected = [
        "(1795782896.123456) can0 701#05",
        "can0 123#0102",
        "can0 123#112233",
        "can0 123#0011223344556677",
        "can0 123#0011",
        "can0 123#01C2",
        "can0 20000004#0004000000000000",
        "can0 124#00",
    ];
    assert_eq!(read_whole(file), expected);
    let (found, damage) = read("  can0  123   [2]  0102 0304\n  can0  123   [1]  01`02\n");
    assert_eq!(found, [] as [&str; 0]);
    assert_eq!(damage.len(), 2, "{damage:?}");
}

#[test]
fn times_that_fall_are_differences() {
    let line = |time: &str| format!(" ({time})  can0  701   [1]  05\n");
    let file: String = ["000.000000", "000.095000", "000.005000", "000.100000"].map(line).concat();
    let (found, statistics) = read_all(file.as_bytes());
    assert!(statistics.has_delta_times);
    let times =
        ["0000000000.000000", "0000000000.095000", "0000000000.100000", "0000000000.200000"];
    assert_eq!(found, times.map(|time| format!("({time}) can0 701#05")));
    // Times from zero that rise are absolute, and so are those of a log that does not begin at zero.
    for times in [["000.000000", "000.095000", "000.100000"], ["000.5", "000.095000", "000.005000"]]
    {
        let (_, statistics) = read_all(times.map(line).concat().as_bytes());
        assert!(!statistics.has_delta_times, "{times:?}");
    }
    let mut reader = CaptureReader::new(crate::ReadOptions {
        times: crate::LogTimes::Absolute,
        ..crate::ReadOptions::default()
    });
    let mut count = 0;
    reader.feed(file.as_bytes(), &mut |_| count += 1);
    assert!(count == 4 && !reader.statistics().has_delta_times);
    // A log that grows is not held back for long.
    let (mut reader, mut count) = (CaptureReader::default(), 0);
    for n in 0..17 {
        reader.feed(line(&format!("{n}.000000")).as_bytes(), &mut |_| count += 1);
    }
    assert_eq!(count, 17);
}

#[test]
fn logs_of_modbus_libraries() {
    let file = "Opening /dev/ttyUSB0 at 9600 bauds (N, 8, 1)\n\
        [01][03][00][33][00][02][34][04]\nWaiting for a confirmation...\n<01><03><04><00>\n\
        2026-11-27 12:00:00,000 DEBUG logging:103 SEND: 0x1 0x6 0x0\n\
        2026-11-27 12:00:00,001 DEBUG logging:103 Processing: 0x1 0x6 0x0\n";
    let (found, statistics) = read_all(file.as_bytes());
    let expected =
        ["- > 01 03 00 33 00 02 34 04", "- < 01 03 04 00", "(1795780800.000000) - > 01 06 00"];
    assert_eq!(found, expected);
    assert_eq!(statistics.damage, []);
    assert_eq!(statistics.skipped, [("lines of text", 2), ("repeated lines", 1)]);
}

#[test]
fn savvycan_and_saleae_tables() {
    let gvret = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n\
        1000,00000601,false,Tx,0,8,40,41,60,00,00,00,00,00,\n\
        2500,0400A05E,true,Rx,1,2,34,12,\n";
    let expected = [
        "(0000000000.001000) can0 601#4041600000000000 T",
        "(0000000000.002500) can1 0400A05E#3412 R",
    ];
    assert_eq!(read_whole(gvret), expected);
    let old = "Time Stamp,ID,Extended,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n7,00000081,false,0,1,05,\n";
    assert_eq!(read_whole(old), ["(0000000000.000007) can0 081#05"]);
    let bytes = "Time [s],Value,Parity Error,Framing Error\n0.000012,0x01,,\n0.001,0xFF,,\n";
    let expected = ["(0000000000.000012) uart > 01", "(0000000000.001000) uart > FF"];
    assert_eq!(read_whole(bytes), expected.map(|line| line.replace("> ", "")));
    let table = "name,type,start_time,duration,\"data\"\n\
        \"Async Serial\",\"data\",1.2e-05,8.7e-05,0x4B\n";
    assert_eq!(read_whole(table), ["(0000000000.000012) Async_Serial 4B"]);
}

#[test]
fn busmaster() {
    let head = "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n\
        ***START DATE AND TIME 27:11:2026 23:59:58:500***\n***HEX***\n";
    let lines = "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***\n\
        23:59:59:7890 Tx 1 0x601 s 8 40 41 60 00 00 00 00 00\n\
        00:00:00:0001 Rx 2 0x0400A05E x 2 34 12\n\
        00:00:01:0000 Rx 1 0x123 sr 4\n\
        ***[STOP LOGGING SESSION]***\n";
    let expected = [
        "(1795823999.789000) can0 601#4041600000000000 T",
        "(1795824000.000100) can1 0400A05E#3412 R",
        "(1795824001.000000) can0 123#R4 R",
    ];
    assert_eq!(read_whole(&format!("{head}***SYSTEM MODE***\n{lines}")), expected);
    // As SavvyCAN's examples have it.
    let converted =
        read_whole(&format!("{head}***SYSTEM MODE***\n00:00:00:992 Rx 0 00000210 s 1 07\n"));
    assert_eq!(converted, ["(1795824000.992000) can0 210#07 R"]);
    let short = "0:0:1:5000 Rx 1 291 s 1 16\n0:0:0:5000 Rx 1 291 s 1 16\n";
    let relative = read_whole(&format!("{head}***DEC***\n***RELATIVE MODE***\n{short}"));
    assert_eq!(
        relative,
        ["(1795824000.000000) can0 123#10 R", "(1795824000.500000) can0 123#10 R"]
    );
    let absolute = read_whole(&format!("{head}***DEC***\n***ABSOLUTE MODE***\n{short}"));
    assert_eq!(absolute[1], "(1795823999.000000) can0 123#10 R");
}

#[test]
fn crtd() {
    let (found, statistics) = read_all(
        b"100.602 CXX Info Type:crtd\n1542473901.020305 1T11 7DF 02 01 0C\n\
          1542473901.021 2R29 0400A05E 34 12\n1542473902.0 CEV Event vehicle.on\n",
    );
    let expected =
        ["(1542473901.020305) can0 7DF#02010C T", "(1542473901.021000) can1 0400A05E#3412 R"];
    assert_eq!(found, expected);
    assert_eq!((statistics.damaged, &*statistics.skipped), (0, &[("comments and events", 2)][..]));
}

#[test]
fn files_of_other_kinds_are_named() {
    for (head, name) in [
        (&b"MDF     4.10    "[..], "an MDF file (MF4)"),
        (b"PK\x03\x04\x14\0", "a zip archive"),
        (
            b"//------\r\n//\r\nMicrochip Technology Inc.\r\n",
            "a log of Microchip's CAN BUS Analyzer",
        ),
    ] {
        let (found, statistics) = read_all(head);
        assert_eq!(found, [] as [&str; 0]);
        assert_eq!(statistics.unsupported.map(|file| file.name), Some(name));
        assert_eq!(statistics.damaged, 0);
    }
}

/// An object of a BLF file.
fn blf_object(kind: u32, ns: u64, body: &[u8]) -> Vec<u8> {
    let mut object = Vec::from(*b"LOBJ");
    object.extend_from_slice(&[32, 0, 1, 0]);
    object.extend_from_slice(&(32 + body.len() as u32).to_le_bytes());
    object.extend_from_slice(&kind.to_le_bytes());
    object.extend_from_slice(&[2, 0, 0, 0, 0, 0, 0, 0]);
    object.extend_from_slice(&ns.to_le_bytes());
    object.extend_from_slice(body);
    object.resize(object.len().next_multiple_of(4), 0);
    object
}

#[test]
fn blf_errors_states_and_short_frames() {
    let mut file = vec![0; 144];
    file[..4].copy_from_slice(b"LOGG");
    file[4] = 144;
    file.extend(blf_object(31, 1_000_000, &[1, 0, 0, 96, 0, 0, 0, 0]));
    file.extend(blf_object(74, 2_000_000, &[[2, 0, 200, 0], [0; 4], [0; 4], [0; 4]].concat()));
    file.extend(blf_object(104, 3_000_000, &[1; 40]));
    file.extend(blf_object(4, 4_000_000, &[0; 32]));
    // A CAN FD frame of twelve bytes, of which three are stored.
    let mut body = [0; 43];
    (body[0], body[1], body[2], body[4], body[5]) = (1, 9, 12, 0x23, 1);
    body[13] = 0x10;
    body[40..].copy_from_slice(&[1, 2, 3]);
    file.extend(blf_object(101, 5_000_000, &body));
    let (found, statistics) = read_all(&file);
    let expected = [
        "(0000000000.001000) can0 20000204#0004000000000060",
        "(0000000000.002000) can1 20000204#002000000000C800",
        "(0000000000.003000) can0 20000080#0000000000000000",
        "(0000000000.005000) can0 123##0010203000000000000000000 R",
    ];
    assert_eq!(found, expected);
    assert_eq!((statistics.damaged, &*statistics.skipped), (0, &[("bus statistics", 1)][..]));
}
