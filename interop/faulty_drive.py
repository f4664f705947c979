"""A drive on a pty that replies well and misbehaves on demand.

TMCL: a read of parameter p gives 1000 p. Modbus RTU: register a holds a. Every write is counted,
and every other request that is no read.
A fault is a function (number of the request, request, reply) -> list of (delay in seconds, bytes),
or None for the plain reply at once.
"""

import os
import pty
import select
import struct
import threading
import time
import tty


def crc(data):
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return struct.pack("<H", value)


class Tmcl:
    # GAP, GGP, GIO, GCO, the program's status, the version: a host draws its probes among them.
    READS = (6, 10, 15, 31, 135, 136)

    @staticmethod
    def length(buffer):
        return 9

    @staticmethod
    def answer(request, writes):
        address, opcode, kind = request[:3]
        value = struct.unpack(">i", request[4:8])[0]
        status = 100
        if sum(request[:8]) & 255 != request[8]:
            status = 1  # wrong checksum: nothing is executed
        elif opcode == 136:
            value = 0x0063_0100
        elif opcode == 6:
            value = 1000 * kind
        elif opcode in Tmcl.READS:
            value = 0
        else:
            writes.append((opcode, kind, value))
        reply = bytes([2, address, status, opcode]) + struct.pack(">i", value)
        return reply + bytes([sum(reply) & 255])


class Rtu:
    @staticmethod
    def length(buffer):
        if len(buffer) < 7:
            return 8
        return 9 + buffer[6] if buffer[1] == 16 else 8

    @staticmethod
    def answer(request, writes):
        if crc(request[:-2]) != request[-2:]:
            return None
        function = request[1]
        start, count = struct.unpack(">HH", request[2:6])
        if function == 3:
            words = b"".join(struct.pack(">H", start + n & 0xFFFF) for n in range(count))
            reply = request[:2] + bytes([len(words)]) + words
        elif function in (1, 2):
            reply = request[:2] + bytes([(count + 7) // 8]) + bytes((count + 7) // 8)
        elif function == 6:
            writes.append((start, count))
            return request
        elif function == 16:
            writes.append((start, request[7:-2]))
            reply = request[:6]
        else:
            reply = bytes([request[0], function | 0x80, 1])
        return reply + crc(reply)


class FaultyDrive(threading.Thread):
    """Serves until `close`; `path` is what a client opens."""

    def __init__(self, protocol, fault=lambda number, request, reply: None):
        super().__init__(daemon=True)
        self.protocol, self.fault = protocol, fault
        self.requests, self.writes = [], []
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.ours)
        tty.setraw(self.theirs)
        self.path = os.ttyname(self.theirs)
        self.later, self.open = [], True
        self.start()

    def close(self):
        self.open = False
        self.join()
        os.close(self.ours)
        os.close(self.theirs)

    def run(self):
        buffer = b""
        while self.open:
            self.send_what_is_due()
            wait = min([0.02] + [max(0, at - time.monotonic()) for at, _ in self.later])
            if select.select([self.ours], [], [], wait)[0]:
                buffer = self.serve(buffer + os.read(self.ours, 4096))

    def serve(self, buffer):
        while len(buffer) >= (length := self.protocol.length(buffer)):
            request, buffer = buffer[:length], buffer[length:]
            reply = self.protocol.answer(request, self.writes)
            if reply is None:
                return b""
            self.requests.append(request)
            pieces = self.fault(len(self.requests), request, reply)
            for delay, piece in [(0, reply)] if pieces is None else pieces:
                # A drive answers in order: nothing overtakes what is already late.
                behind = self.later[-1][0] if self.later else 0
                self.later.append((max(time.monotonic() + delay, behind), piece))
            self.send_what_is_due()
        return buffer

    def send_what_is_due(self):
        while self.later and self.later[0][0] <= time.monotonic():
            os.write(self.ours, self.later.pop(0)[1])


def once(number, pieces):
    """The fault happens to that request only."""
    return lambda n, request, reply: pieces(request, reply) if n == number else None


LATE_BY = 0.05
# Long enough for a busy machine to answer in.
TIMEOUT = 0.4

FAULTS = {
    "none": lambda n, request, reply: None,
    "one reply 50 ms late": once(5, lambda request, reply: [(TIMEOUT + LATE_BY, reply)]),
    "four replies in a row 50 ms late": lambda n, request, reply: (
        [(TIMEOUT + LATE_BY, reply)] if 5 <= n < 9 else None
    ),
    "one reply lost": once(5, lambda request, reply: []),
    "one noise byte before a reply": once(5, lambda request, reply: [(0, b"\x55" + reply)]),
    "one byte of a reply lost": once(5, lambda request, reply: [(0, reply[:-1])]),
    "one reply duplicated": once(5, lambda request, reply: [(0, reply + reply)]),
    "one reply in two pieces, 5 ms apart": once(
        5, lambda request, reply: [(0, reply[:4]), (0.005, reply[4:])]
    ),
    "RS-485 echo of every request": lambda n, request, reply: [(0, request + reply)],
    "another drive's reply before ours": once(
        5, lambda request, reply: [(0, other_address(request, reply) + reply)]
    ),
}


def other_address(request, reply):
    """The same reply, as the drive at another address would give it."""
    if len(reply) == 9 and sum(reply[:8]) & 255 == reply[8]:
        body = bytes([reply[0], reply[1] + 1]) + reply[2:8]
        return body + bytes([sum(body) & 255])
    body = bytes([reply[0] + 1]) + reply[1:-2]
    return body + crc(body)
