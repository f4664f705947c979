use super::Encoding;

#[test]
fn ranges_are_those_of_the_bits() {
    assert_eq!(Encoding::U8.raw_range(), (0, 255));
    assert_eq!(Encoding::I16.raw_range(), (-32_768, 32_767));
    assert_eq!(Encoding::U32LowFirst.raw_range(), (0, u32::MAX.into()));
    assert_eq!(Encoding::I64.raw_range(), (i64::MIN, i64::MAX));
    let (min, max) = Encoding::U64.raw_range();
    assert_eq!((min.cast_unsigned(), max.cast_unsigned()), (0, u64::MAX));
}

#[test]
fn values_of_64_bits_without_sign_are_compared_without_sign() {
    let (min, max) = Encoding::U64.raw_range();
    let greatest = u64::MAX.cast_signed();
    assert!(Encoding::U64.is_between(greatest, min, max));
    assert!(!Encoding::U64.is_between(greatest, min, i64::MAX));
    assert_eq!(Encoding::U64.number(greatest), u64::MAX as f64);
}

#[test]
fn real_numbers_are_compared_as_numbers() {
    for encoding in [Encoding::F32, Encoding::F64] {
        let (min, max) = encoding.raw_range();
        let raw = |number| encoding.raw(number).unwrap();
        assert!(encoding.is_between(raw(-1.5), min, max));
        assert!(encoding.is_between(raw(-1.5), raw(-2.0), raw(0.5)));
        assert!(!encoding.is_between(raw(-2.5), raw(-2.0), raw(0.5)));
        assert!(!encoding.is_between(raw(1.0), raw(-2.0), raw(0.5)));
        assert_eq!(encoding.number(raw(-1.5)), -1.5);
        assert_eq!(encoding.raw(f64::NAN), None);
    }
    assert_eq!(Encoding::F32.raw(1e300), None, "too great for 32 bits");
}
