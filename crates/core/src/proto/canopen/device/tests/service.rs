//! SDO: every kind, every size, every refusal.

use super::*;
use crate::proto::canopen::sdo::{BLOCK_MAX, BlockSegment, SEGMENT, Segment};

const FILE: ObjectIndex = ObjectIndex::new(0x2006, 0);

/// Sizes around every boundary there is, and some.
const SIZES: [usize; 14] = [0, 1, 3, 4, 5, 7, 8, 14, 15, 888, 889, 890, 10_000, 2_000_000];

fn content(size: usize) -> Vec<u8> {
    (0..size).map(|n| (n * 7 + n / 256) as u8).collect()
}

fn upload(fixture: &mut NodeFixture, object: ObjectIndex) -> Vec<u8> {
    let size = match fixture.request(SdoRequest::Read(object)) {
        SdoReply::Value(_, short) => {
            let (bytes, len) = short.bytes();
            return bytes[..len].to_vec();
        }
        SdoReply::ValueLong(_, size) => size.unwrap(),
        other => panic!("{other:?}"),
    };
    let (mut all, mut toggle) = (Vec::new(), false);
    loop {
        let SdoReply::ValueSegment(segment) = fixture.request(SdoRequest::ReadSegment(toggle))
        else {
            panic!()
        };
        assert_eq!(segment.toggle, toggle);
        all.extend_from_slice(segment.bytes());
        toggle = !toggle;
        if segment.last {
            assert_eq!(all.len(), size as usize);
            return all;
        }
    }
}

fn download(
    fixture: &mut NodeFixture,
    object: ObjectIndex,
    data: &[u8],
    size: Option<u32>,
) -> Result<(), AbortCode> {
    match fixture.request(SdoRequest::WriteLong(object, size)) {
        SdoReply::Written(..) => {}
        SdoReply::Abort(_, abort) => return Err(abort),
        other => panic!("{other:?}"),
    }
    let count = data.len().div_ceil(SEGMENT).max(1);
    for n in 0..count {
        let piece = &data[n * SEGMENT..(n * SEGMENT + SEGMENT).min(data.len())];
        let mut segment = Segment {
            toggle: n % 2 == 1,
            last: n + 1 == count,
            len: piece.len() as u8,
            ..Segment::default()
        };
        segment.data[..piece.len()].copy_from_slice(piece);
        match fixture.request(SdoRequest::WriteSegment(segment)) {
            SdoReply::WrittenSegment(toggle) => assert_eq!(toggle, segment.toggle),
            SdoReply::Abort(_, abort) => return Err(abort),
            other => panic!("{other:?}"),
        }
    }
    Ok(())
}

#[test]
fn segments_carry_every_size_both_ways() {
    let mut fixture = NodeFixture::new();
    for size in SIZES {
        let data = content(size);
        assert_eq!(download(&mut fixture, FILE, &data, Some(size as u32)), Ok(()));
        assert_eq!(fixture.toy.file, data);
        assert_eq!(upload(&mut fixture, FILE), data);
    }
    assert_eq!(download(&mut fixture, FILE, &content(100), None), Ok(()), "size not told");
    assert_eq!(fixture.toy.file, content(100));
}

#[test]
fn a_fixed_value_can_come_in_segments() {
    let mut fixture = NodeFixture::new();
    let eight = 0x1122_3344_5566_7788_u64;
    let object = ObjectIndex::new(0x2004, 0);
    assert_eq!(download(&mut fixture, object, &eight.to_le_bytes(), Some(8)), Ok(()));
    assert_eq!(fixture.toy.values[usize::from(U64_AT)], eight);
    assert_eq!(upload(&mut fixture, object), eight.to_le_bytes());
    assert_eq!(download(&mut fixture, object, &[0; 9], Some(9)), Err(AbortCode::TOO_LONG));
    assert_eq!(download(&mut fixture, object, &[0; 7], Some(7)), Err(AbortCode::TOO_SHORT));
    assert_eq!(download(&mut fixture, object, &[0; 9], None), Err(AbortCode::TOO_LONG));
    assert_eq!(download(&mut fixture, object, &[0; 6], None), Err(AbortCode::TOO_SHORT));
    assert_eq!(fixture.toy.values[usize::from(U64_AT)], eight, "nothing of these was taken");
    assert_eq!(upload(&mut fixture, ObjectIndex::new(0x1008, 0)), NAME.as_bytes());
}

#[test]
fn a_toggle_that_does_not_alternate_ends_it() {
    let mut fixture = NodeFixture::new();
    fixture.toy.file = content(20);
    fixture.request(SdoRequest::Read(FILE));
    let refused = SdoReply::Abort(FILE, AbortCode::TOGGLE);
    assert_eq!(fixture.request(SdoRequest::ReadSegment(true)), refused);
    let over = SdoReply::Abort(ObjectIndex::default(), AbortCode::SPECIFIER);
    assert_eq!(fixture.request(SdoRequest::ReadSegment(false)), over);
    fixture.request(SdoRequest::WriteLong(FILE, None));
    let segment = Segment { toggle: true, len: 7, ..Segment::default() };
    assert_eq!(fixture.request(SdoRequest::WriteSegment(segment)), refused);
}

/// Reads in blocks of `segments`, losing every segment whose running number `loses` names.
fn read_block(fixture: &mut NodeFixture, segments: u8, loses: impl Fn(usize) -> bool) -> Vec<u8> {
    let start = SdoRequest::ReadBlock { object: FILE, crc: true, segments, threshold: 0 };
    let SdoReply::ReadBlockReady { crc: true, size: Some(size), .. } = fixture.request(start)
    else {
        panic!()
    };
    let (mut all, mut seen, mut ended) = (Vec::new(), 0, false);
    let mut request = SdoRequest::ReadBlockStart;
    while !ended {
        let frames = fixture.answers(request.emit(5));
        let mut arrived = 0;
        assert!(frames.len() <= usize::from(segments));
        for frame in &frames {
            let segment = BlockSegment::of(frame.data);
            seen += 1;
            if loses(seen) || segment.number != arrived + 1 {
                continue;
            }
            arrived += 1;
            all.extend_from_slice(&segment.data);
            ended = segment.last;
        }
        request = SdoRequest::ReadBlockAck { arrived, segments };
    }
    let SdoReply::ReadBlockEnd { unused, crc } = fixture.request(request) else { panic!() };
    all.truncate(all.len() - usize::from(unused));
    assert_eq!(all.len(), size as usize);
    assert_eq!(crc, sdo::crc(0, &all));
    assert_eq!(fixture.answers(SdoRequest::ReadBlockEnd.emit(5)), []);
    all
}

#[test]
fn blocks_are_read_whatever_is_lost() {
    let mut fixture = NodeFixture::new();
    for size in SIZES {
        fixture.toy.file = content(size);
        assert_eq!(read_block(&mut fixture, BLOCK_MAX, |_| false), fixture.toy.file, "{size}");
    }
    fixture.toy.file = content(3000);
    for segments in [1, 2, 5, 127] {
        let lossy = read_block(&mut fixture, segments, |n| n % 13 == 3);
        assert_eq!(lossy, fixture.toy.file, "{segments}");
    }
}

#[test]
fn few_bytes_may_go_the_ordinary_way() {
    let mut fixture = NodeFixture::new();
    let request =
        |threshold| SdoRequest::ReadBlock { object: FILE, crc: true, segments: 9, threshold };
    fixture.toy.file = content(4);
    assert!(matches!(
        fixture.request(request(4)),
        SdoReply::Value(FILE, ExpeditedData { len: 4, .. })
    ));
    fixture.toy.file = content(20);
    assert_eq!(fixture.request(request(20)), SdoReply::ValueLong(FILE, Some(20)));
    assert!(matches!(fixture.request(request(19)), SdoReply::ReadBlockReady { .. }));
}

/// Writes in blocks; `loses` as in [`read_block`].
fn write_block(fixture: &mut NodeFixture, data: &[u8], loses: impl Fn(usize) -> bool) -> SdoReply {
    let size = Some(data.len() as u32);
    let start = SdoRequest::WriteBlock { object: FILE, crc: true, size };
    let SdoReply::WriteBlockReady { crc: true, segments, .. } = fixture.request(start) else {
        panic!()
    };
    let count = data.len().div_ceil(SEGMENT).max(1);
    let (mut done, mut sent) = (0, 0);
    while done < count {
        let block = (count - done).min(usize::from(segments));
        let mut answer = Vec::new();
        for n in 0..block {
            let at = (done + n) * SEGMENT;
            let mut piece = [0; SEGMENT];
            let rest = &data[at.min(data.len())..];
            piece[..rest.len().min(SEGMENT)].copy_from_slice(&rest[..rest.len().min(SEGMENT)]);
            let last = done + n + 1 == count;
            let segment = BlockSegment { number: n as u8 + 1, last, data: piece };
            sent += 1;
            if n + 1 == block || !loses(sent) {
                answer = fixture.answers(frame(0x605, &segment.bytes()));
            }
        }
        let SdoReply::WriteBlockAck { arrived, .. } = SdoReply::of(answer[0].data) else {
            panic!()
        };
        done += usize::from(arrived);
    }
    let unused = (count * SEGMENT - data.len()) as u8;
    fixture.request(SdoRequest::WriteBlockEnd { unused, crc: sdo::crc(0, data) })
}

#[test]
fn blocks_are_written_whatever_is_lost() {
    let mut fixture = NodeFixture::new();
    for size in SIZES {
        let data = content(size);
        assert_eq!(write_block(&mut fixture, &data, |_| false), SdoReply::WriteBlockDone, "{size}");
        assert_eq!(fixture.toy.file, data);
    }
    let data = content(5000);
    assert_eq!(write_block(&mut fixture, &data, |n| n % 17 == 2), SdoReply::WriteBlockDone);
    assert_eq!(fixture.toy.file, data);
}

#[test]
fn a_block_with_a_wrong_check_is_refused() {
    let mut fixture = NodeFixture::new();
    fixture.request(SdoRequest::WriteBlock { object: FILE, crc: true, size: Some(7) });
    let segment = BlockSegment { number: 1, last: true, data: [1; 7] };
    fixture.answers(frame(0x605, &segment.bytes()));
    let end = SdoRequest::WriteBlockEnd { unused: 0, crc: 1 };
    assert_eq!(fixture.request(end), SdoReply::Abort(FILE, AbortCode::CRC));
    let start = SdoRequest::ReadBlock { object: FILE, crc: true, segments: 128, threshold: 0 };
    assert_eq!(fixture.request(start), SdoReply::Abort(FILE, AbortCode::BLOCK_SIZE));
    fixture.toy.file = content(30);
    fixture.request(SdoRequest::ReadBlock { object: FILE, crc: true, segments: 2, threshold: 0 });
    assert_eq!(fixture.answers(SdoRequest::ReadBlockStart.emit(5)).len(), 2);
    let ack = SdoRequest::ReadBlockAck { arrived: 3, segments: 2 };
    assert_eq!(fixture.request(ack), SdoReply::Abort(FILE, AbortCode::SEQUENCE));
}

#[test]
fn an_abort_ends_a_block_in_silence() {
    let mut fixture = NodeFixture::new();
    fixture.request(SdoRequest::WriteBlock { object: FILE, crc: true, size: None });
    assert_eq!(fixture.answers(SdoRequest::Abort(FILE, AbortCode::GENERAL).emit(5)), []);
    assert_eq!(fixture.read(0x2000, 0), Ok(0), "the next request is one");
}

#[test]
fn values_have_lengths_signs_limits_and_rights() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x2001, 0, 0xFFFE, 2).unwrap();
    assert_eq!(fixture.toy.values[usize::from(I16_AT)] as i64, -2, "with its sign");
    assert_eq!(fixture.read(0x2001, 0), Ok(0xFFFE), "without what lies above");
    assert_eq!(fixture.write(0x2001, 0, 1, 4), Err(AbortCode::LENGTH));
    assert_eq!(fixture.write(0x2002, 0, 1, 3), Err(AbortCode::LENGTH));
    assert_eq!(fixture.write(0x2002, 0, 0xAABB_CCDD, 0), Ok(()), "size not told");
    assert_eq!(fixture.read(0x2002, 0), Ok(0xAABB_CCDD));
    assert_eq!(fixture.write(0x2005, 0, 6, 2), Err(AbortCode::TOO_HIGH));
    assert_eq!(fixture.write(0x2005, 0, 0xFFFA, 2), Err(AbortCode::TOO_LOW));
    assert_eq!(fixture.write(0x2005, 0, 0xFFFB, 2), Ok(()));
    assert_eq!(fixture.write(0x2007, 0, 1, 2), Err(AbortCode::READ_ONLY));
    assert_eq!(fixture.read(0x2008, 0), Err(AbortCode::WRITE_ONLY));
    assert_eq!(fixture.read(0x2000, 1), Err(AbortCode::NO_SUB));
    assert_eq!(fixture.read(0x5000, 0), Err(AbortCode::NO_OBJECT));
    assert_eq!(fixture.read(0x1000, 0), Ok(0x1234_0192));
    let nothing = SdoReply::Abort(ObjectIndex::default(), AbortCode::SPECIFIER);
    assert_eq!(fixture.request(SdoRequest::Other(0xE0)), nothing);
}

#[test]
fn a_short_request_is_ignored_unless_lenient() {
    let short = frame(0x605, &[0x2F, 0x00, 0x20, 0, 7, 0, 0]);
    assert_eq!(NodeFixture::new().answers(short), []);
    let mut lenient =
        NodeFixture::with(Quirks { lenient: true, echoes_writes: true, ..Quirks::STRICT });
    let echoed = frame(0x585, &[0x60, 0x00, 0x20, 0, 7, 0, 0, 0]);
    assert_eq!(lenient.answers(short), [echoed]);
    // The lost part of a value is not zero.
    lenient.answers(frame(0x605, &[0x2B, 0x01, 0x20, 0, 0x0D, 0, 0, 0]));
    for cut in
        [&[0x2B, 0x01, 0x20][..], &[0x2B, 0x01, 0x20, 0], &[0x2F, 0x01, 0x20, 0, 1], &[0x40, 1]]
    {
        assert_eq!(lenient.answers(frame(0x605, cut)), [], "{cut:02X?}");
    }
    assert_eq!(lenient.toy.values[usize::from(I16_AT)], 13);
    // A size of one byte, two meant: 2F with an object of two bytes.
    lenient.answers(frame(0x605, &[0x2F, 0x01, 0x20, 0, 0xE8, 0x03, 0, 0]));
    assert_eq!(lenient.toy.values[usize::from(I16_AT)], 1000);
    let mut plain = NodeFixture::with(Quirks { segmented_sdo: false, ..Quirks::STRICT });
    let refused = SdoReply::Abort(FILE, AbortCode::SPECIFIER);
    assert_eq!(plain.request(SdoRequest::WriteLong(FILE, None)), refused);
}

#[test]
fn a_stopped_node_serves_no_request() {
    let mut fixture = NodeFixture::new();
    fixture.receive(frame(0, &[2, 0]));
    assert_eq!(fixture.answers(SdoRequest::Read(FILE).emit(5)), []);
    fixture.receive(frame(0, &[128, 5]));
    assert_eq!(fixture.read(0x2000, 0), Ok(0));
}

#[test]
fn a_transfer_that_was_left_is_forgotten() {
    let mut fixture = NodeFixture::new();
    fixture.toy.file = content(100);
    fixture.request(SdoRequest::Read(FILE));
    fixture.request(SdoRequest::ReadSegment(false));
    // The client died here; the next one begins anew.
    assert_eq!(fixture.read(0x2000, 0), Ok(0));
    let over = SdoReply::Abort(ObjectIndex::default(), AbortCode::SPECIFIER);
    assert_eq!(fixture.request(SdoRequest::ReadSegment(true)), over);
    assert_eq!(upload(&mut fixture, FILE), content(100));
    assert_eq!(download(&mut fixture, FILE, &content(20), Some(30)), Err(AbortCode::TOO_SHORT));
    assert_eq!(download(&mut fixture, FILE, &content(40), Some(30)), Err(AbortCode::TOO_LONG));
}

#[test]
fn every_entry_is_found_and_nothing_else() {
    let entries = DICTIONARY.entries();
    for entry in entries {
        let found = DICTIONARY.find(entry.index(), entry.sub());
        assert_eq!(found.map(ObjectEntry::key), Some(entry.key()));
    }
    let found = (0..=u16::MAX).flat_map(|index| DICTIONARY.object(index)).count();
    assert_eq!(found, entries.len());
    let by_key = (0x1000..0x2100).flat_map(|index| (0..=255).map(move |sub| (index, sub)));
    let found = by_key.filter(|(index, sub)| DICTIONARY.find(*index, *sub).is_some()).count();
    assert_eq!(found, entries.len());
}
