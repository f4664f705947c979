//! LSS: one node found among many, and given its number.

use super::*;
use crate::proto::canopen::lss::{IdentifyBound, IdentityNumber, LssReply, LssRequest as Lss};

fn lss(fixture: &mut NodeFixture, request: Lss) -> Option<LssReply> {
    let answers = fixture.answers(request.emit());
    let reply = answers.first()?;
    assert_eq!((answers.len(), reply.id), (1, 0x7E4));
    Some(LssReply::parse(reply.bytes()).unwrap())
}

#[test]
fn a_node_is_selected_by_its_four_numbers() {
    let mut fixture = NodeFixture::new();
    assert_eq!(lss(&mut fixture, Lss::InquireNode), None, "not in configuration");
    let numbers = [0x11, 0x22, 0x33, 0x44];
    let select = |n: usize, value| Lss::SwitchSelective(IdentityNumber::ALL[n], value);
    for (n, value) in numbers.into_iter().enumerate() {
        let wrong = select(n, value + u32::from(n == 2));
        assert_eq!(lss(&mut fixture, wrong), None);
    }
    for (n, value) in numbers.into_iter().enumerate() {
        let selected = (n == 3).then_some(LssReply::Selected);
        assert_eq!(lss(&mut fixture, select(n, value)), selected);
    }
    assert_eq!(lss(&mut fixture, Lss::InquireNode), Some(LssReply::Node(5)));
    let serial = Lss::Inquire(IdentityNumber::Serial);
    assert_eq!(lss(&mut fixture, serial), Some(LssReply::Number(IdentityNumber::Serial, 0x44)));
    assert_eq!(lss(&mut fixture, Lss::SetNode(128)), Some(LssReply::SetNode(1, 0)));
    assert_eq!(lss(&mut fixture, Lss::SetNode(9)), Some(LssReply::SetNode(0, 0)));
    assert_eq!(lss(&mut fixture, Lss::Store), Some(LssReply::Store(0, 0)));
    assert_eq!(lss(&mut fixture, Lss::SwitchGlobal(false)), None);
    assert_eq!((fixture.end.node(), fixture.toy.kept_node), (5, 9));
    assert_eq!(fixture.answers(frame(0, &[130, 5])), [frame(0x709, &[0])], "after a reset");
}

#[test]
fn a_node_without_number_is_found_by_a_fast_scan() {
    let mut fixture = NodeFixture::at(255, Quirks::STRICT);
    assert_eq!(fixture.advance(10), [], "it says nothing");
    assert_eq!(lss(&mut fixture, Lss::IdentifyUnconfigured), Some(LssReply::Unconfigured));
    let scan = |number, bit, sub, next| Lss::FastScan { number, bit, sub, next };
    let begin = scan(0, 128, IdentityNumber::Vendor, IdentityNumber::Vendor);
    assert_eq!(lss(&mut fixture, begin), Some(LssReply::Identified));
    let mut found = [0; 4];
    for (n, sub) in IdentityNumber::ALL.into_iter().enumerate() {
        for bit in (0..32).rev() {
            if lss(&mut fixture, scan(found[n], bit, sub, sub)).is_none() {
                found[n] |= 1 << bit;
            }
        }
        let next = IdentityNumber::ALL[(n + 1) % 4];
        assert_eq!(lss(&mut fixture, scan(found[n], 0, sub, next)), Some(LssReply::Identified));
    }
    assert_eq!(found, [0x11, 0x22, 0x33, 0x44]);
    assert_eq!(lss(&mut fixture, Lss::InquireNode), Some(LssReply::Node(255)));
    assert_eq!(lss(&mut fixture, Lss::SetNode(7)), Some(LssReply::SetNode(0, 0)));
    let booted = fixture.answers(Lss::SwitchGlobal(false).emit());
    assert_eq!(booted, [frame(0x707, &[0])]);
}

#[test]
fn ranges_of_numbers_identify() {
    let mut fixture = NodeFixture::new();
    let bounds = [
        Lss::Identify(IdentifyBound::Vendor, 0x11),
        Lss::Identify(IdentifyBound::Product, 0x22),
        Lss::Identify(IdentifyBound::RevisionLow, 0),
        Lss::Identify(IdentifyBound::RevisionHigh, 0x33),
        Lss::Identify(IdentifyBound::SerialLow, 0x44),
        Lss::Identify(IdentifyBound::SerialHigh, 0x100),
    ];
    let answers = bounds.map(|bound| lss(&mut fixture, bound));
    assert_eq!(answers[5], Some(LssReply::Identified));
    assert_eq!(answers[..5], [None; 5]);
    lss(&mut fixture, bounds[0]);
    lss(&mut fixture, Lss::Identify(IdentifyBound::Product, 0x23));
    assert_eq!(lss(&mut fixture, bounds[5]), None);
}

#[test]
fn the_bit_rate_changes_after_a_silence() {
    let mut fixture = NodeFixture::new();
    lss(&mut fixture, Lss::SwitchGlobal(true));
    assert_eq!(lss(&mut fixture, Lss::SetBitTiming(0, 5)), Some(LssReply::SetBitTiming(1, 0)));
    assert_eq!(lss(&mut fixture, Lss::SetBitTiming(0, 4)), Some(LssReply::SetBitTiming(0, 0)));
    fixture.write(0x1017, 0, 10, 2).unwrap();
    fixture.receive(Lss::ActivateBitTiming(50).emit());
    assert_eq!(fixture.advance(49), [], "no heartbeat either");
    assert_eq!(fixture.end.line().bit_rate, 500_000);
    fixture.advance(2);
    assert_eq!(fixture.end.line().bit_rate, 125_000);
    assert_eq!(fixture.advance(48), []);
    assert!(!fixture.advance(20).is_empty());
}
