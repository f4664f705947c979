"""Object dictionaries for python canopen, made from a short list: no data sheet is needed."""

import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes

U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
I8, I16, I32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
TEXT, DOMAIN = datatypes.VISIBLE_STRING, datatypes.DOMAIN

SINGLE = {
    0x1000: U32, 0x1001: U8, 0x1005: U32, 0x1006: U32, 0x1008: TEXT, 0x1017: U16, 0x1019: U8,
    0x2000: U16, 0x2033: U16, 0x2095: U16, 0x3000: I16, 0x3012: U16, 0x2F00: DOMAIN,
    0x603F: U16, 0x6040: U16, 0x6041: U16, 0x6060: I8, 0x6061: I8, 0x6062: I32, 0x6064: I32,
    0x606C: I32, 0x6071: I16, 0x6077: I16, 0x607A: I32, 0x6081: U32, 0x6083: U32, 0x6084: U32,
    0x6087: U32, 0x6098: I8, 0x609A: U32, 0x60FF: I32, 0x6502: U32,
}
RECORDS = {
    0x1003: [U8, U32, U32, U32, U32],
    0x1010: [U8, U32, U32, U32],
    0x1016: [U8, U32],
    0x1018: [U8, U32, U32, U32, U32],
    0x2F01: [U8, U32, DOMAIN, U32, U16],
    0x6099: [U8, U32, U32],
}
COMMUNICATION = [U8, U32, U8, U16, None, U16, U8]


def variable(index, sub, kind):
    made = ODVariable(f"o{index:04X}_{sub}", index, sub)
    made.data_type = kind
    return made


def dictionary():
    """The objects of both simulated drives."""
    od = canopen.ObjectDictionary()
    for index, kind in SINGLE.items():
        od.add_object(variable(index, 0, kind))
    for base in (0x1400, 0x1800):
        for n in range(4):
            RECORDS[base + n] = COMMUNICATION[: 6 if base == 0x1400 else 7]
            # Records, because the client finds no entry of an array whose length is 0.
            RECORDS[base + 0x200 + n] = [U8] + 8 * [U32]
    for index, kinds in RECORDS.items():
        record = ODRecord(f"o{index:04X}", index)
        for sub, kind in enumerate(kinds):
            if kind is not None:
                record.add_member(variable(index, sub, kind))
        od.add_object(record)
    return od
