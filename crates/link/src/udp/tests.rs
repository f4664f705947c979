use super::*;
use crate::link::Link;

#[test]
fn one_hears_the_other_and_none_itself() {
    let group = Group { hops: 0, port: 43_117, ..Group::default() };
    let (one, other) = (open(group).unwrap(), open(group).unwrap());
    let sent = Frame { id: 0x1ABC_DEF0, extended: true, ..Frame::standard(0, &[1, 2, 3]) };
    one.send(&sent).unwrap();
    let mut got = Frame::default();
    let received = other.receive(&mut got, clock::now().plus_ms(2000)).unwrap();
    assert!(matches!(received, Received::Bytes { len: 1, .. }), "{received:?}");
    assert_eq!(got, sent);
    let received = one.receive(&mut got, clock::now().plus_ms(50)).unwrap();
    assert_eq!(received, Received::TimedOut);
}
