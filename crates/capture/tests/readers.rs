//! Every reader, and all that is made of what it reads, on mutated files: no panic, no memory without
//! bound, and every record accounted for.
//!
//! Each gets `POLEPAIR_READER_SECONDS` (default 1; 600 in `make soak`, 0.5 in `make check`), as many at
//! once as there are processors.
//!
//! A program of its own: the most memory that the process ever had is measured.

use std::fmt::Write as _;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use polepair_capture::{
    CaptureDecoder, CaptureFormat, CaptureReader, CaptureWriter, Compression, DecodedFrame,
    ProtocolDetector, Record, RecordData, Rules, Timestamp,
};
use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

/// The longest input.
const INPUT_MAX: usize = 20_000;
/// Inputs that are kept to go on from.
const KEPT_MAX: usize = 32;
/// Most memory that the process may have had, bytes, beside what each thread may have: a window of
/// zstd is 128 MB.
const PEAK_MAX: u64 = 256 << 20;
const PEAK_OF_THREAD: u64 = 160 << 20;
/// Threads at once.
const THREADS_MAX: usize = 8;

/// A name, and captures to begin with.
type Target = (&'static str, Option<CaptureFormat>, Vec<Vec<u8>>);

#[test]
fn every_reader_takes_whatever_comes() {
    let targets = targets();
    assert_eq!(targets.len(), 19);
    let queue = Mutex::new(targets.iter());
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(THREADS_MAX);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let next = queue.lock().expect("no thread has panicked").next();
                    let Some((name, format, seeds)) = next else { return };
                    let tried = attack(name, *format, seeds);
                    assert!(tried > 0, "{name}: no time for one input");
                }
            });
        }
    });
    if let Some(peak) = peak() {
        let max = PEAK_MAX + PEAK_OF_THREAD * threads as u64;
        assert!(peak < max, "{peak} bytes of memory at the peak");
    }
}

fn budget() -> Duration {
    let seconds = std::env::var("POLEPAIR_READER_SECONDS").ok();
    Duration::from_secs_f64(seconds.and_then(|text| text.parse().ok()).unwrap_or(1.0))
}

/// Highest memory use of this process, where the system reports it.
fn peak() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes << 10)
}

fn targets() -> Vec<Target> {
    let written = |format, packing| vec![capture(format, packing)];
    let text = |text: String| vec![text.into_bytes()];
    vec![
        ("candump", Some(CaptureFormat::Text), text(candump())),
        ("serial log", Some(CaptureFormat::Text), text(serial())),
        ("pcap", Some(CaptureFormat::Pcap), written(CaptureFormat::Pcap, None)),
        ("pcapng", Some(CaptureFormat::Pcapng), written(CaptureFormat::Pcapng, None)),
        ("ASC", Some(CaptureFormat::Asc), written(CaptureFormat::Asc, None)),
        ("TRC", Some(CaptureFormat::Trc), written(CaptureFormat::Trc, None)),
        ("BLF", Some(CaptureFormat::Blf), written(CaptureFormat::Blf, None)),
        ("CSV", Some(CaptureFormat::Csv), written(CaptureFormat::Csv, None)),
        ("other programs", Some(CaptureFormat::Text), text(TOOL_LOG.repeat(4))),
        ("logs of many programs", None, program_logs()),
        ("candump -td -i", None, text(DELTA_LOG.to_owned())),
        (
            "CSV tables",
            Some(CaptureFormat::Csv),
            TABLES.map(|table| table.as_bytes().to_vec()).into(),
        ),
        ("BUSMASTER", Some(CaptureFormat::Busmaster), text(BUSMASTER.to_owned())),
        ("TCP in pcap", Some(CaptureFormat::Pcap), vec![tcp()]),
        ("SQLite", Some(CaptureFormat::Sqlite), vec![database()]),
        ("CRTD", Some(CaptureFormat::Crtd), text(CRTD.to_owned())),
        ("JSONL", Some(CaptureFormat::Jsonl), text(jsonl())),
        ("gzip", None, written(CaptureFormat::Text, Some(Compression::Gzip))),
        ("zstd", None, written(CaptureFormat::Pcapng, Some(Compression::Zstd))),
    ]
}

/// The logs that the readers' tests have, and one in UTF-16.
fn program_logs() -> Vec<Vec<u8>> {
    let sections = include_str!("../src/read/tests/program_logs.txt").split("=== ").skip(1);
    let mut logs: Vec<Vec<u8>> = sections
        .map(|section| {
            let (_, log) = section.split_once('\n').expect("a name");
            log.replace("\\r", "\r").replace("\\t", "\t").into_bytes()
        })
        .collect();
    let units = "\u{FEFF}12:00:01 TX 01 03 00 33\n".repeat(4);
    logs.push(units.encode_utf16().flat_map(u16::to_le_bytes).collect());
    logs
}

/// A database with two pages of rows.
fn database() -> Vec<u8> {
    let mut connection = rusqlite::Connection::open_in_memory().expect("in memory");
    connection
        .execute_batch(
            "PRAGMA page_size = 512;
             CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER,
                 error INTEGER, dlc INTEGER, data BLOB);
             WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 40)
             INSERT INTO messages SELECT i / 1000.0, 1409, 0, 0, 0, 8, x'4B41600037020000' FROM n;",
        )
        .expect("valid statements");
    connection.serialize("main").expect("serialized").to_vec()
}

/// Frames of every protocol on CAN.
fn frames() -> Vec<Frame> {
    let standard = |id, data: &[u8]| Frame::standard(id, data);
    let mut extended = standard(0, &[0x34, 0x12]);
    (extended.id, extended.extended) = (0x0400_A05E, true);
    vec![
        standard(1, &[6, 1, 0, 0, 0, 0, 0]),
        standard(2, &[1, 100, 6, 0, 0, 2, 0xC7]),
        standard(0x30B, b"TC\0\0\0\0\0\x05"),
        standard(0x28B, b"TC\0\0\0\0\0\x05"),
        standard(0x605, &[0x40, 0x41, 0x60, 0, 0, 0, 0, 0]),
        standard(0x585, &[0x4B, 0x41, 0x60, 0, 0x37, 2, 0, 0]),
        standard(0x705, &[5]),
        standard(0x085, &[0x10, 0x23, 1, 0, 0, 0, 0, 0]),
        standard(0x123, &[4, 1, 0xE8, 3]),
        extended,
    ]
}

/// Lines of serial traffic, written in turns.
const SERIAL: [(char, &str); 8] = [
    ('>', "01 06 01 00 00 00 00 00 08"),
    ('<', "02 01 64 06 00 00 02 C7 36"),
    ('>', "01 06 00 33 00 C8 78 53"),
    ('<', "01 06 00 33 00 C8 78 53"),
    ('>', "08 0F F1 D8 01 0F F1 D8"),
    ('<', "4F 08 0F F1 D8 01 35 31 34 4C C7"),
    ('>', "3A 30 31 30 33 30 30 30 30 30 30 30 31 46 42 0D 0A"),
    ('<', "3A 30 31 30 33 30 32 30 30 30 43 45 45 0D 0A"),
];

/// Lines that libraries print.
const TOOL_LOG: &str = "\
[01][03][00][33][00][02][34][04]
<01><03><04><00><05><00><06><2A><31>
2026-11-27 12:34:56,500 DEBUG logging:103 recv: 0x1 0x83 0x2 old_data: addr=None
MinimalModbus debug mode. Response from instrument: b'\\x01\\x03A\\r' (4 bytes)
TMCL_Request: 01,06,01,00,00000000,08 -> GAP(type=1, idx=0, value=0x00000000)
Timestamp: 1700000000.000500    ID: 0581    S Rx    DL:  2    43 41     Channel: can0
60C  40 02 65
583#4B 41 60 00 18 02 00 00
";

/// Screen output of candump with differences and binary digits.
const DELTA_LOG: &str = "\
 (000.000000)  can0  701   [1]  00000101
 (000.095000)  can0  701   {1}  00000101
 (000.005000)  can0  701   [1]  05
\u{1B}[31m (000.005000)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME
\tcontroller-problem{rx-error-warning}
";

/// Tables of SavvyCAN and of Saleae Logic.
const TABLES: [&str; 3] = [
    "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n\
     1000,00000601,false,Tx,0,8,40,41,60,00,00,00,00,00,\n2500,0400A05E,true,Rx,1,2,34,12,\n",
    "Time [s],Value,Parity Error,Framing Error\n0.000012,0x01,,\n0.001,0xFF,,\n",
    "name,type,start_time,duration,data\n\"Async Serial\",data,1.2e-05,8.7e-05,0x4B\n",
];

const BUSMASTER: &str = "\
***BUSMASTER Ver 3.2.2***
***START DATE AND TIME 27:11:2026 23:59:58:500***
***HEX***
***SYSTEM MODE***
23:59:59:7890 Tx 1 0x601 s 8 40 41 60 00 00 00 00 00
00:00:00:0001 Rx 2 0x0400A05E x 2 34 12
00:00:01:0000 Rx 1 0x123 sr 4
";

const CRTD: &str = "\
100.602 CXX Info Type:crtd
1542473901.020305 1T11 7DF 02 01 0C
1542473901.021 2R29 0400A05E 34 12
";

/// A pcap file of Ethernet packets with the bytes of a serial line in a TCP connection.
fn tcp() -> Vec<u8> {
    let mut file = vec![0xD4, 0xC3, 0xB2, 0xA1, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0];
    file.extend_from_slice(&1u32.to_le_bytes());
    let (mut sent, mut received) = (1, 1);
    for (n, (arrow, bytes)) in SERIAL.iter().cycle().take(16).enumerate() {
        let data: Vec<u8> =
            bytes.split(' ').map(|byte| u8::from_str_radix(byte, 16).expect("a byte")).collect();
        let (client, server) = (([10, 0, 0, 2], 50_000), ([10, 0, 0, 5], 4001));
        let (from, to, sequence) = match arrow {
            '>' => (client, server, &mut sent),
            _ => (server, client, &mut received),
        };
        let builder = etherparse::PacketBuilder::ethernet2([1; 6], [2; 6])
            .ipv4(from.0, to.0, 64)
            .tcp(from.1, to.1, *sequence, 1024);
        *sequence += data.len() as u32;
        let mut packet = Vec::new();
        builder.write(&mut packet, &data).expect("written");
        let len = (packet.len() as u32).to_le_bytes();
        file.extend_from_slice(&1_700_000_000u32.to_le_bytes());
        file.extend_from_slice(&(n as u32 * 1000).to_le_bytes());
        file.extend_from_slice(&len);
        file.extend_from_slice(&len);
        file.extend_from_slice(&packet);
    }
    file
}

fn candump() -> String {
    let mut text = String::new();
    for (n, frame) in frames().iter().cycle().take(60).enumerate() {
        let digits = if frame.extended { 8 } else { 3 };
        let _ = write!(text, "(1700000000.{:06}) can{} {:0digits$X}#", n * 700, n % 2, frame.id);
        frame.bytes().iter().for_each(|byte| {
            let _ = write!(text, "{byte:02X}");
        });
        text.push('\n');
    }
    text + "(1700000001.0) can0 123#R4\n(1700000001.1) can0 123##1112233\n"
}

fn serial() -> String {
    let mut text = String::new();
    for (n, (arrow, bytes)) in SERIAL.iter().cycle().take(64).enumerate() {
        let port = n / 2 % 4;
        let _ = writeln!(text, "(1700000000.{:06}) ttyUSB{port} {arrow} {bytes}", n * 5000);
    }
    text
}

fn jsonl() -> String {
    let mut out = Vec::new();
    let mut decoder = CaptureDecoder::new(Rules::default());
    let text = candump() + &serial();
    decoder
        .feed(text.as_bytes(), &mut |event| polepair_capture::jsonl::write_frame(event, &mut out));
    decoder.finish(&mut |event| polepair_capture::jsonl::write_frame(event, &mut out));
    String::from_utf8(out).expect("text")
}

fn capture(format: CaptureFormat, packing: Option<Compression>) -> Vec<u8> {
    let mut writer = CaptureWriter::new(format, packing, Vec::new()).expect("a writer");
    for (n, frame) in frames().iter().cycle().take(60).enumerate() {
        let time = Some(Timestamp(1_700_000_000_000_000_000 + n as u64 * 700_000));
        let direction = [Some(Direction::ToDrive), Some(Direction::ToHost), None][n % 3];
        let one = n % 2 == 0 || matches!(format, CaptureFormat::Pcap | CaptureFormat::Csv);
        let link = if one { "can0" } else { "can1" };
        let record = Record { time, link, direction, data: RecordData::Frame(*frame), offset: 0 };
        writer.write(&record).expect("a frame fits");
    }
    writer.finish().expect("written")
}

/// A small generator: the same inputs each time.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// Prints the input at the end of an attempt, also after a panic.
struct Tried<'a>(&'a str, u64, &'a [u8]);

impl Drop for Tried<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("{}, input {}: {:02X?}", self.0, self.1, self.2);
        }
    }
}

/// Tries mutated captures for the given time, and returns their number.
fn attack(name: &str, format: Option<CaptureFormat>, seeds: &[Vec<u8>]) -> u64 {
    let mut dice = Dice(name.bytes().map(u64::from).sum());
    let mut stored = seeds.to_vec();
    let end = Instant::now() + budget();
    let mut tried = 0;
    while Instant::now() < end {
        let input = match tried {
            0 => stored[0].clone(),
            _ => mutate(&mut dice, &stored),
        };
        let noted = Tried(name, tried, &input);
        read(&input, format, 1 + dice.below(4096));
        if tried % 16 == 0 {
            judge(&input, format);
        }
        drop(noted);
        tried += 1;
        // Now and then the seeds are left further behind.
        if stored.len() < KEPT_MAX && tried % 64 == 0 && !input.is_empty() {
            stored.push(input);
        }
    }
    tried
}

fn mutate(dice: &mut Dice, stored: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = stored[dice.below(stored.len())].clone();
    for _ in 0..1 + dice.below(6) {
        let at = dice.below(bytes.len() + 1);
        match dice.below(8) {
            0 if at < bytes.len() => bytes[at] ^= 1 << dice.below(8),
            1 if at < bytes.len() => bytes[at] = dice.next() as u8,
            2 if at < bytes.len() => drop(bytes.remove(at)),
            3 => bytes.insert(at, dice.next() as u8),
            4 if dice.below(4) == 0 => bytes.truncate(at),
            5 => {
                let other = &stored[dice.below(stored.len())];
                let from = dice.below(other.len() + 1);
                bytes.truncate(at);
                bytes.extend(&other[from..]);
            }
            6 => {
                let to = (at + dice.below(200)).min(bytes.len());
                let again = bytes[at..to].to_vec();
                bytes.splice(at..at, again);
            }
            _ => {
                let words =
                    ["0", "-1", "65536", "4294967296", "1e99", "\u{e9}", "\n", "\"", "(", ")"];
                bytes.splice(at..at, words[dice.below(words.len())].bytes());
            }
        }
    }
    bytes.truncate(INPUT_MAX);
    bytes
}

/// Frames and bytes of serial lines that came out.
#[derive(Default, PartialEq, Eq, Debug)]
struct Account {
    frames: u64,
    bytes: u64,
}

impl Account {
    fn record(&mut self, record: &Record<'_>) {
        match record.data {
            RecordData::Bytes(bytes) => self.bytes += bytes.len() as u64,
            _ => self.frames += 1,
        }
    }

    fn event(&mut self, event: &DecodedFrame<'_>) {
        match event.id {
            Some(_) => self.frames += 1,
            None => self.bytes += event.bytes.len() as u64,
        }
    }
}

/// Reads the input in pieces, and checks that the decoder explains every byte that the reader returned.
fn read(input: &[u8], format: Option<CaptureFormat>, piece: usize) {
    let mut records = Account::default();
    let mut reader = CaptureReader::new(format.into());
    for piece in input.chunks(piece) {
        reader.feed(piece, &mut |record| records.record(record));
    }
    reader.finish(&mut |record| records.record(record));
    let mut events = Account::default();
    let mut decoder = CaptureDecoder::new(everything()).with_read_options(format.into());
    for piece in input.chunks(piece) {
        decoder.feed(piece, &mut |event| events.event(event));
    }
    decoder.finish(&mut |event| events.event(event));
    decoder.finish_sessions(&mut |_| ());
    assert_eq!(decoder.statistics().records, reader.statistics().records);
    if decoder.untracked_records() == 0 {
        assert_eq!(events, records);
    }
}

fn judge(input: &[u8], format: Option<CaptureFormat>) {
    let mut judge = ProtocolDetector::with_read_options(format.into());
    judge.feed(input);
    let (verdicts, mut decoder) = judge.decide();
    verdicts.iter().for_each(|verdict| drop(verdict.to_string()));
    decoder.feed(input, &mut |_| ());
    decoder.finish(&mut |_| ());
}

fn everything() -> Rules {
    let rules = "canopen,thruster@11,technocan,tmlcan,tmcl@ttyUSB0,modbus-rtu@ttyUSB1,tml@ttyUSB2,\
                 modbus-ascii@ttyUSB3";
    Rules::parse(rules).expect("rules")
}
