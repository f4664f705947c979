//! LSS: one node found among many, and given its number.

use super::*;
use crate::proto::canopen::lss::{IdentifyBound, IdentityNumber, LssReply, LssRequest as Lss};

fn lss(desk: &mut NodeFixture, request: Lss) -> Option<LssReply> {
    let answers = desk.answers(request.emit());
    let reply = answers.first()?;
    assert_eq!((answers.len(), reply.id), (1, 0x7E4));
    Some(LssReply::parse(reply.bytes()).unwrap())
}

#[test]
fn a_node_is_selected_by_its_four_numbers() {
    let mut desk = NodeFixture::new();
    assert_eq!(lss(&mut desk, Lss::InquireNode), None, "not in configuration");
    let numbers = [0x11, 0x22, 0x33, 0x44];
    let select = |n: usize, value| Lss::SwitchSelective(IdentityNumber::ALL[n], value);
    for (n, value) in numbers.into_iter().enumerate() {
        let wrong = select(n, value + u32::from(n == 2));
        assert_eq!(lss(&mut desk, wrong), None);
    }
    for (n, value) in numbers.into_iter().enumerate() {
        let selected = (n == 3).then_some(LssReply::Selected);
        assert_eq!(lss(&mut desk, select(n, value)), selected);
    }
    assert_eq!(lss(&mut desk, Lss::InquireNode), Some(LssReply::Node(5)));
    let serial = Lss::Inquire(IdentityNumber::Serial);
    assert_eq!(lss(&mut desk, serial), Some(LssReply::Number(IdentityNumber::Serial, 0x44)));
    assert_eq!(lss(&mut desk, Lss::SetNode(128)), Some(LssReply::SetNode(1, 0)));
    assert_eq!(lss(&mut desk, Lss::SetNode(9)), Some(LssReply::SetNode(0, 0)));
    assert_eq!(lss(&mut desk, Lss::Store), Some(LssReply::Store(0, 0)));
    assert_eq!(lss(&mut desk, Lss::SwitchGlobal(false)), None);
    assert_eq!((desk.end.node(), desk.toy.kept_node), (5, 9));
    assert_eq!(desk.answers(frame(0, &[130, 5])), [frame(0x709, &[0])], "after a reset");
}

#[test]
fn a_node_without_number_is_found_by_a_fast_scan() {
    let mut desk = NodeFixture::at(255, Quirks::STRICT);
    assert_eq!(desk.advance(10), [], "it says nothing");
    assert_eq!(lss(&mut desk, Lss::IdentifyUnconfigured), Some(LssReply::Unconfigured));
    let scan = |number, bit, sub, next| Lss::FastScan { number, bit, sub, next };
    let begin = scan(0, 128, IdentityNumber::Vendor, IdentityNumber::Vendor);
    assert_eq!(lss(&mut desk, begin), Some(LssReply::Identified));
    let mut found = [0; 4];
    for (n, sub) in IdentityNumber::ALL.into_iter().enumerate() {
        for bit in (0..32).rev() {
            if lss(&mut desk, scan(found[n], bit, sub, sub)).is_none() {
                found[n] |= 1 << bit;
            }
        }
        let next = IdentityNumber::ALL[(n + 1) % 4];
        assert_eq!(lss(&mut desk, scan(found[n], 0, sub, next)), Some(LssReply::Identified));
    }
    assert_eq!(found, [0x11, 0x22, 0x33, 0x44]);
    assert_eq!(lss(&mut desk, Lss::InquireNode), Some(LssReply::Node(255)));
    assert_eq!(lss(&mut desk, Lss::SetNode(7)), Some(LssReply::SetNode(0, 0)));
    let booted = desk.answers(Lss::SwitchGlobal(false).emit());
    assert_eq!(booted, [frame(0x707, &[0])]);
}

#[test]
fn ranges_of_numbers_identify() {
    let mut desk = NodeFixture::new();
    let bounds = [
        Lss::Identify(IdentifyBound::Vendor, 0x11),
        Lss::Identify(IdentifyBound::Product, 0x22),
        Lss::Identify(IdentifyBound::RevisionLow, 0),
        Lss::Identify(IdentifyBound::RevisionHigh, 0x33),
        Lss::Identify(IdentifyBound::SerialLow, 0x44),
        Lss::Identify(IdentifyBound::SerialHigh, 0x100),
    ];
    let answers = bounds.map(|bound| lss(&mut desk, bound));
    assert_eq!(answers[5], Some(LssReply::Identified));
    assert_eq!(answers[..5], [None; 5]);
    lss(&mut desk, bounds[0]);
    lss(&mut desk, Lss::Identify(IdentifyBound::Product, 0x23));
    assert_eq!(lss(&mut desk, bounds[5]), None);
}

#[test]
fn the_bit_rate_changes_after_a_silence() {
    let mut desk = NodeFixture::new();
    lss(&mut desk, Lss::SwitchGlobal(true));
    assert_eq!(lss(&mut desk, Lss::SetBitTiming(0, 5)), Some(LssReply::SetBitTiming(1, 0)));
    assert_eq!(lss(&mut desk, Lss::SetBitTiming(0, 4)), Some(LssReply::SetBitTiming(0, 0)));
    desk.write(0x1017, 0, 10, 2).unwrap();
    desk.receive(Lss::ActivateBitTiming(50).emit());
    assert_eq!(desk.advance(49), [], "no heartbeat either");
    assert_eq!(desk.end.line().bit_rate, 500_000);
    desk.advance(2);
    assert_eq!(desk.end.line().bit_rate, 125_000);
    assert_eq!(desk.advance(48), []);
    assert!(!desk.advance(20).is_empty());
}
