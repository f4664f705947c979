//! The language as people write it, and what is refused.

use super::{BARE, F514L, FA00G, text};
use polepair_core::explain::TextError;
use polepair_core::proto::tml::instruction::{LanguageScope, assemble};
use polepair_core::proto::tml::wire::Instruction;

fn words(text: &str) -> Instruction {
    assemble(text, &F514L).unwrap_or_else(|error| panic!("{text}: {error:?}"))
}

fn error(text: &str) -> TextError {
    assemble(text, &F514L).expect_err(text)
}

#[test]
fn numbers_in_every_dress() {
    assert_eq!(words("KPP=0x1234"), Instruction::of(0x205E, [0x1234]));
    assert_eq!(words("  kpp =  -1 ;  // gain"), Instruction::of(0x205E, [0xFFFF]));
    assert_eq!(words("KPP = 65535U"), Instruction::of(0x205E, [0xFFFF]));
    assert_eq!(words("CPOS=-1000L"), Instruction::of(0x249E, [0xFC18, 0xFFFF]));
    assert_eq!(words("CPOS = 4294966296"), Instruction::of(0x249E, [0xFC18, 0xFFFF]));
    assert_eq!(words("CSPD=16.5"), Instruction::of(0x24A0, [0x8000, 0x0010]));
    assert_eq!(words("CSPD = 16"), Instruction::of(0x24A0, [0, 0x0010]), "units");
    assert_eq!(words("CSPD = 0x00108000"), Instruction::of(0x24A0, [0x8000, 0x0010]), "raw");
    assert_eq!(words("CSPD = -.5"), Instruction::of(0x24A0, [0x8000, 0xFFFF]));
    assert_eq!(words("!ALPO -1000L"), Instruction::of(0x7092, [0x0228, 0xFC18, 0xFFFF]));
    assert_eq!(words("!MSO 2.5"), Instruction::of(0x7096, [0x022C, 0x8000, 0x0002]));
    assert_eq!(words("!TRU 0x12"), Instruction::of(0x7081, [0x02AE, 0, 0x0012]));
}

#[test]
fn a_fixed_number_keeps_every_bit_through_its_decimals() {
    for raw in (0..=0xFFFF_u32).chain([0x7FFF_FFFF, 0x8000_0000, 0xFFFF_0001, 0xFFFF_FFFF]) {
        let move_at = Instruction::of(0x24A0, [raw as u16, (raw >> 16) as u16]);
        assert_eq!(words(&text(&move_at, &F514L)), move_at);
    }
    assert_eq!(text(&words("cspd=16.5"), &F514L), "CSPD = 16.5");
    assert_eq!(text(&words("CSPD=0xFFFF8000"), &F514L), "CSPD = -0.5");
}

#[test]
fn points_of_a_path() {
    let point = Instruction::of(0x1800, [0xFC18, 0xFF00, 0xFFF6, 0x01F4]);
    assert_eq!(words("pvtp -1000L, -10, 500U, 0"), point, "the manual's example");
    assert_eq!(text(&point, &F514L), "PVTP -1000, -10.0, 500, 0");
    assert_eq!(words("PTP apos, var_i2,-99").opcode, 0xC963, "the sign is dropped");
    assert_eq!(error("PVTP 8388608, 0, 1, 0").at, 5);
    assert_eq!(error("PVTP 0, 32768, 1, 0").at, 8);
    assert_eq!(error("PVTP 0, 0, 512, 0").at, 11);
    assert_eq!(error("PVTP 0, 0, 1, 128").at, 14);
}

#[test]
fn variables_by_name_half_and_address() {
    assert_eq!(words("@0x025E = 5"), words("KPP = 5"));
    assert_eq!(words("@0x0228L = CPOS"), words("APOS = cpos"));
    assert_eq!(words("var_lf ( h ) = 0x12"), Instruction::of(0x2169, [0x12]));
    assert_eq!(words("var_i1 = var_lf(L)"), Instruction::of(0x2966, [0x0368]));
    assert_eq!(text(&words("var_i1 = var_lf(H)"), &F514L), "VAR_I1 = VAR_LF(H)");
    assert_eq!(text(&words("KPP = 5"), &BARE), "@0x025E = 0x0005");
    assert_eq!(text(&Instruction::of(0x255E, [1, 0]), &F514L), "@0x035EL = 1");
    assert_eq!(error("KPPP = 5").expected, "an instruction, or a variable that the profile names");
    assert_eq!(error("KPP = APOS").at, 6);
    assert!(error("KPP = APOS").expected.contains("16 bits"));
}

#[test]
fn firmware_has_its_own_addresses() {
    assert_eq!(words("SRL_MASK = 0x8400"), Instruction::of(0x2362, [0x8400]));
    let far = assemble("SRL_MASK = 0x8400", &FA00G).unwrap();
    assert_eq!(far, Instruction::of(0x9004, [0xA3CD, 0x8400]), "no short page reaches it");
    assert_eq!(text(&far, &FA00G), "SRL_MASK,dm = 0x8400");
    let masks = assemble("SRB SRL_MASK, 0xFFFF, 0x8000", &FA00G).unwrap();
    assert_eq!(masks, Instruction::of(0x5C00, [0xA3CD, 0xFFFF, 0x8000]));
    let sum = assemble("SRL_MASK += 1", &FA00G).unwrap_err();
    assert_eq!(sum.at, 0);
    assert!(sum.expected.contains("NAME,dm"), "{}", sum.expected);
}

#[test]
fn masks_on_mcr_by_meaning() {
    assert_eq!(words("mode  pp"), Instruction::of(0x5909, [0xBFC1, 0x8701]));
    assert_eq!(words("SRB MCR, 0xBFC1, 0x8701"), words("MODE PP"));
    assert_eq!(words("EXTREF1"), words("EXTREF 1"));
    assert_eq!(text(&words("SRB MCR, 0xDFFF, 0"), &F514L), "CPR");
    assert_eq!(text(&words("SRB MCR, 0x1234, 0"), &F514L), "SRB MCR, 0x1234, 0x0000");
}

#[test]
fn products_and_shifts() {
    assert_eq!(words("PROD<<=3"), Instruction::of(0x88A3, []));
    assert_eq!(words("cpos = var_i1<<2"), Instruction::of(0x8962, [0x029E, 0x0366]));
    assert_eq!(words("cpos = var_i1<<16").opcode, 0x8970);
    let variable = Instruction::of(0x8923, [0x030E]);
    assert_eq!(text(&variable, &F514L), "@0x030EL <<= 3", "the variable, not the product");
    assert_eq!(error("var_i1 <<= 16").at, 11);
}

#[test]
fn memory_and_other_axes() {
    assert_eq!(words("var_i1 = (var_i2+),spi"), Instruction::of(0x9108, [0x0367, 0x0366]));
    assert_eq!(words("(var_i1),pm = 5L"), Instruction::of(0x90A1, [0x0366, 5, 0]));
    assert_eq!(words("[G2]{STOP}"), Instruction::of(0x9400, [0x1020, 0x01C4]));
    let target = Instruction::of(0x9402, [0x0050, 0x249E, 0xFC18, 0xFFFF]);
    assert_eq!(words("[A5] { CPOS = -1000L; };"), target);
    assert_eq!(text(&target, &F514L), "[5] {CPOS = -1000}");
    assert_eq!(words("var_i1=[A3]var_i2"), Instruction::of(0xE167, [0x0030, 0x0366]));
    assert_eq!(words("[G1+3] APOS=CPOS").word(0), 0x1050);
    assert_eq!(words("[*]{UPD}").word(0), 0x1000);
    assert!(error("[5]{[6]{STOP}}").expected.contains("carries out itself"));
    assert!(error("[5]{?APOS}").expected.contains("carries out itself"));
    assert!(error("[5]{SRBL MCR, 1, 2}").expected.contains("two data words"));
}

#[test]
fn requests_and_answers_name_who_asks() {
    assert_eq!(words("?APOS"), Instruction::of(0xB005, [0x0FF1, 0x0228]));
    assert_eq!(words("?KPP FROM 7"), Instruction::of(0xB004, [0x0070, 0x025E]));
    assert_eq!(words("??poserr"), Instruction::of(0xB204, [0x0FF1, 0x022A]));
    assert_eq!(words("?TML apos"), Instruction::of(0xA428, [0x0FF1]));
    assert_eq!(words("?@0x4000,spi"), Instruction::of(0xB008, [0x0FF1, 0x4000]));
    assert_eq!(words("KPP == 288 FROM 255"), Instruction::of(0xB404, [0x0FF0, 0x025E, 288]));
    assert_eq!(
        words("?CHECKSUM,spi 0x4000, 0x4100"),
        Instruction::of(0xDA50, [0x0FF1, 0x4000, 0x4100])
    );
    assert_eq!(words("VERSION == 514L"), Instruction::of(0xD801, [0x3531, 0x344C]));
    assert_eq!(words("PONG 5 == 514L").opcode, 0xD605);
    let unasked = Instruction::of(0xD5FF, [0x090E, 0x8400, 0x0201]);
    assert_eq!(text(&unasked, &F514L), "??SR32 == 0x02018400 FROM 255");
}

#[test]
fn inputs_outputs_and_events() {
    assert_eq!(words("!IN#3 1"), Instruction::of(0x70DA, [8]));
    assert_eq!(words("var_i1 = IN#3"), words("var_i1 = IN(3)"));
    assert_eq!(words("OUT(3, 4) = 0x18"), Instruction::of(0xEC00, [0x18, 0x18]));
    assert_eq!(words("STOP !"), words("STOP!"));
    assert_eq!(words("!RPO 5"), words("!rlpo 5"));
}

#[test]
fn an_instruction_without_a_documented_code_is_refused() {
    let error = error("SOUT#3");
    assert_eq!((error.at, error.expected.contains("no source gives")), (0, true));
}

#[test]
fn unknown_words_stay_words() {
    let unknown = Instruction::of(0x7777, [1, 2]);
    assert_eq!(text(&unknown, &F514L), ".word 0x7777, 0x0001, 0x0002");
    assert_eq!(words(".word 0x7777, 1, 2"), unknown);
    assert_eq!(error(".word 1, 2, 3, 4, 5, 6").expected, "at most five words");
    assert_eq!(error(".word 0x10000").at, 6);
}

#[test]
fn errors_tell_the_place_that_made_no_sense() {
    for (text, at) in [
        ("", 0),
        ("KPP = ", 6),
        ("KPP = 70000", 6),
        ("KPP = 5 6", 8),
        ("KPP = 5x", 6),
        ("CPOS = 1.5", 7),
        ("MODE XX", 5),
        ("GOTO 0x4000, var_i1, XX", 21),
        ("OUT(16) = 1", 4),
        ("[G9]{STOP}", 2),
        ("ADDGRID (9)", 9),
    ] {
        assert_eq!(error(text).at, at, "{text}: {:?}", error(text));
    }
}

#[test]
fn no_text_whatever_is_more_than_refused() {
    let scope = LanguageScope { profile: F514L.profile, ..LanguageScope::default() };
    for text in ["é = 5", "KPP = é", "@", "@0x", "0x", "-", "?", "[", "[]", "{", "(", "!", ".word"]
    {
        assert!(assemble(text, &scope).is_err(), "{text}");
    }
}
