"""CANopen frames by many, explained by us and by Wireshark's dissector, frame for frame.

Both read the same file. Where the two differ, REASONS says why; a difference that no reason covers
fails, and so does a reason that covers none (`make soak` tries a million). docs/protocols/canopen.md has them in words.
"""

import json
import os
import random
import struct
import subprocess
import threading

from conftest import POLEPAIR, need

FRAMES = int(os.environ.get("POLEPAIR_WIRESHARK_FRAMES", "200000"))
SEED = 20_261_121
REMOTE, EXTENDED = 1 << 30, 1 << 31
# Real block transfers go on with these; random service data never do.
BLOCK_NODES = range(120, 128)
COMMANDS = [0x40, 0x43, 0x47, 0x4B, 0x4F, 0x41, 0x42, 0x60, 0x70, 0x20, 0x21, 0x22, 0x23, 0x27, 0x2B,
            0x2F, 0x30, 0x00, 0x01, 0x0D, 0x10, 0x80, 0xA0, 0xA1, 0xA2, 0xA3, 0xA4, 0xC0, 0xC1, 0xC2,
            0xC4, 0xC5, 0xC6, 0xDD]
ABORTS = [0x05030000, 0x05040000, 0x06020000, 0x06090011, 0x08000022]


def data_of(dice, function, node, length):
    """Data of a frame: likely ones, and any at all."""
    data = bytearray(dice.randbytes(length))
    if function in (11, 12) and length and dice.random() < 0.7:
        data[0] = dice.choice(COMMANDS)
        if length == 8:
            index = dice.choice([0x1000, 0x1008, 0x1018, 0x1400, 0x1A00, 0x6040, 0x6041, 0x6064])
            data[1:4] = struct.pack("<HB", index, dice.randrange(5))
            if data[0] == 0x80:
                data[4:8] = struct.pack("<I", dice.choice(ABORTS))
    elif function == 0 and length == 2 and dice.random() < 0.8:
        data[0] = dice.choice([1, 2, 128, 129, 130])
        data[1] = dice.randrange(128)
    elif function == 14 and length == 1 and dice.random() < 0.8:
        data[0] = dice.choice([0, 4, 5, 127]) | dice.choice([0, 128])
    elif function == 15 and length and dice.random() < 0.8:
        data[0] = dice.choice([0x04, 0x11, 0x13, 0x15, 0x17, 0x40, 0x43, 0x44, 0x46, 0x4C, 0x4F, 0x50,
                               0x51, 0x5A, 0x5E])
    return bytes(data)


USUAL = {0: (2,), 1: (8, 2, 0, 1), 2: (6,), 11: (8,), 12: (8,), 14: (1,), 15: (8,)}
FUNCTIONS = [*range(16), 11, 12, 11, 12, 11, 12, 11, 12, 1, 14]


def any_frame(dice):
    """Any frame of any service, whole or not."""
    function = dice.choice(FUNCTIONS)
    node = dice.randrange(1, 120) if dice.random() < 0.9 else 0
    if function in (0, 2) and dice.random() < 0.95:
        node = 0
    if function == 15 and dice.random() < 0.95:
        node = dice.choice([0x64, 0x65])
    chance = dice.random()
    length = dice.choice(USUAL.get(function, range(9))) if chance < 0.93 else dice.randrange(9)
    flags = REMOTE if chance > 0.995 else EXTENDED if chance > 0.99 else 0
    data = b"" if flags == REMOTE else data_of(dice, function, node, length)
    return function << 7 | node | flags, length, data


def block_download(dice, node):
    """A block transfer as it should be, so that its segments are ones."""
    request, reply = 0x600 | node, 0x580 | node
    object_ = struct.pack("<HB", 0x1F50, 1)
    count = dice.randrange(1, 40)
    size = struct.pack("<I", 7 * count)
    yield request, 8, b"\xc2" + object_ + size
    yield reply, 8, b"\xa0" + object_ + bytes([127, 0, 0, 0])
    for number in range(1, count + 1):
        last = 0x80 if number == count else 0
        yield request, 8, bytes([number | last]) + dice.randbytes(7)
    yield reply, 8, bytes([0xA2, count, 127, 0, 0, 0, 0, 0])
    yield request, 8, bytes([0xC1, 0, 0, 0, 0, 0, 0, 0])
    yield reply, 8, bytes([0xA1, 0, 0, 0, 0, 0, 0, 0])


def frames():
    """The same every time."""
    dice = random.Random(SEED)
    made = []
    while len(made) < FRAMES:
        if dice.random() < 0.0005:
            made.extend(block_download(dice, dice.choice(BLOCK_NODES)))
        else:
            made.append(any_frame(dice))
    return made


def write_pcap(made, path):
    """A capture of SocketCAN, a frame every 100 us."""
    out = bytearray(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227))
    for at, (identifier, length, data) in enumerate(made):
        size = 8 + len(data)
        out += struct.pack("<IIII", 1 + at // 10_000, at % 10_000 * 100, size, size)
        out += struct.pack(">IB3x", identifier, length) + data
    path.write_bytes(out)


# One row a frame: service, node, whether it is whole, and what else both tell.
FIELDS = ["canopen.function_code", "canopen.node_id", "canopen.sdo.cmd", "canopen.sdo.main_idx",
          "canopen.sdo.sub_idx", "canopen.sdo.abort_code", "canopen.sdo.e", "canopen.sdo.s",
          "canopen.sdo.n", "canopen.sdo.toggle", "canopen.em.err_code", "canopen.em.err_reg",
          "canopen.nmt_ctrl.cd", "canopen.nmt_ctrl.node_id", "canopen.nmt_guard.state",
          "canopen.sync.counter", "canopen.time_stamp_ms", "canopen.time_stamp_days",
          "canopen.lss.cs", "canopen.pdo.data.bytes", "_ws.malformed"]
SERVICES = {0: "NMT", 2: "TIME", 11: "SDO", 12: "SDO", 14: "state",
            **{2 * n + 1: f"TPDO{n}" for n in range(1, 5)},
            **{2 * n + 2: f"RPDO{n}" for n in range(1, 5)}}


def whole_number(text):
    return int(text, 0) if text else None


def theirs(line):
    """Explanation of a frame by Wireshark."""
    row = line.rstrip("\n").split("\t")
    if not row[0]:
        return None
    function, node = int(row[0], 0), int(row[1], 0)
    (cmd, index, sub, abort, expedited, sized, unused, toggle, code, register, order, meant, state,
     counter, ms, days, lss) = map(whole_number, row[2:19])
    service = SERVICES.get(function, "?")
    if function == 1:
        service = "EMCY" if node else "SYNC"
    if function == 15:
        service = "LSS" if node in (0x64, 0x65) else "?"
    size = None
    if cmd is not None and expedited:
        size = 4 - unused if sized else 0
    told = {"command": cmd if lss is None else lss, "index": index, "sub": sub, "abort": abort,
            "size": size, "toggle": toggle, "code": code, "register": register, "order": order,
            "state": state, "counter": counter, "ms": ms, "days": days}
    if service == "NMT":
        node = meant or 0
    elif service in ("SYNC", "TIME", "LSS", "?"):
        node = None
    if row[19]:
        told["data"] = row[19].upper()
    return service, node, not row[20], {key: it for key, it in told.items() if it is not None}


KINDS = {"boot-up": "state", "heartbeat": "state", "guarding": "state", "canopen": "?"}
ALIKE = {"command": "command", "index": "index", "sub": "sub", "abort": "abort", "code": "code",
         "register": "register", "counter": "counter", "ms": "ms", "days": "days",
         "state": "state"}
SIZED = ("SDO write", "SDO value")
TOGGLED = ("SDO write segment", "SDO written segment", "SDO read segment", "SDO value segment")


def ours(line):
    """Explanation of a frame by polepair."""
    frame = json.loads(line)
    kind, fields, error = frame["kind"] or "canopen", frame["fields"], frame["error"]
    service = KINDS.get(kind) or kind.split(" ")[0]
    node = frame["axis"]
    told = {key: fields[name] for key, name in ALIKE.items() if name in fields}
    if service == "NMT":
        told = {"order": fields["command"]} if "command" in fields else {}
        node = fields.get("node", 0)
    if service == "LSS":
        told = {"command": fields["command"]} if "command" in fields else {}
    if service == "SDO":
        if kind in SIZED and "size" in fields:
            told["size"] = fields["size"]
        if kind in TOGGLED:
            told["toggle"] = fields["toggle"]
    if service.endswith(("PDO1", "PDO2", "PDO3", "PDO4")) and frame["bytes"]:
        told["data"] = frame["bytes"]
    if service in ("SYNC", "TIME", "LSS", "?"):
        node = None
    # A broken rule leaves a frame whole as long as its meaning is clear.
    whole = error is None or not error.startswith("length:")
    return service, node, whole, told, kind, error


def length_is_wrong(made, we, they):
    """Too short or too long: Wireshark reads what is there, we say that it is no such frame."""
    return we[5] is not None and we[5].startswith("length:")


def is_remote(made, we, they):
    """Remote requests: Wireshark leaves them to CAN, we read guarding and requests for PDOs."""
    return made[0] & REMOTE and they is None


def is_extended(made, we, they):
    """29 bits of identifier: none of CANopen's by default, which we say and Wireshark does not."""
    return made[0] & EXTENDED and they is None


def is_nobodys(made, we, they):
    """Identifiers that the predefined set leaves free: Wireshark reads the function code alone."""
    return we[0] == "?" and made[0] >> 7 & 15 not in (1, 15)


def is_short_emergency(made, we, they):
    """An emergency of the code alone, as TS drives send it: cut off, says Wireshark."""
    return we[0] == "EMCY" and made[1] == 2 and we[3]["code"] == they[3]["code"]


def is_segment(made, we, they):
    """Segments of a block: Wireshark, which does not follow transfers, reads commands."""
    return we[4] in ("SDO block write segment", "SDO block read segment") and made[1] == 8


def has_flags(made, we, they):
    """Commands of blocks with the flag for a check, or with bits that are reserved: Wireshark takes
    them for segments and reads no further."""
    head = made[2][0] if made[2] else 0
    return we[0] == "SDO" and head >> 5 in (5, 6) and they[3] == {}


def is_unknown_command(made, we, they):
    """Specifiers that the standard does not have: Wireshark shows nothing, we show the byte."""
    return (we[0] == "SDO" and they[3].keys() <= {"command"}
            and we[4] in ("SDO unknown request", "SDO unknown reply"))


def has_seven_bytes(made, we, they):
    """Service data of seven bytes, as the TS drive's manual prints some: cut off, says Wireshark."""
    return we[0] == "SDO" and made[1] == 7 and we[3] == they[3]


def has_reserved_time(made, we, they):
    """Milliseconds since midnight have 28 bits; Wireshark counts the four reserved ones above."""
    mask = (1 << 28) - 1
    return we[0] == "TIME" and they[3].get("ms", 0) & mask == we[3].get("ms")


def is_above_nodes(made, we, they):
    """A command to a node above 127: polepair names no addressee, Wireshark the number."""
    return we[0] == "NMT" and made[2][1] > 127


REASONS = [is_remote, is_extended, is_nobodys, length_is_wrong, is_short_emergency, is_segment,
           has_flags, is_unknown_command, has_seven_bytes, has_reserved_time, is_above_nodes]


def lines_of(words, found):
    """Runs a program and keeps its lines."""
    done = subprocess.run(words, capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 0, done.stderr
    found.extend(done.stdout.splitlines())


def test_many_frames_agree_with_wireshark(tmp_path):
    need("tshark")
    made = frames()
    path = tmp_path / "canopen.pcap"
    write_pcap(made, path)
    fields = [word for field in FIELDS for word in ("-e", field)]
    tshark = ["tshark", "-r", str(path), "-d", "can.subdissector,canopen", "-T", "fields", *fields]
    decode = [str(POLEPAIR), "decode", str(path), "--as", "canopen", "--format", "jsonl"]
    shown, explained = [], []
    running = threading.Thread(target=lines_of, args=(tshark, shown))
    running.start()
    lines_of(decode, explained)
    running.join()
    assert len(shown) == len(explained) == len(made)
    counts, unexplained = dict.fromkeys(REASONS, 0), []
    for frame, their_line, our_line in zip(made, shown, explained):
        they, we = theirs(their_line), ours(our_line)
        if they == we[:4]:
            continue
        reason = next((reason for reason in REASONS if reason(frame, we, they)), None)
        if reason:
            counts[reason] += 1
        else:
            unexplained.append((frame, we, they))
    for reason, count in counts.items():
        print(f"{count:>8} {reason.__name__}")
    assert not unexplained, (len(unexplained), unexplained[:10])
    assert all(counts.values()), counts
