"""A CiA 402 drive with units of its own and with what goes wrong in the field, on a socketcand server.

It knows nothing of polepair: a dictionary, expedited SDO, the states, profile position, profile velocity and
homing. `writes` has every value that it was told, in its own numbers.
"""

import random
import socket
import struct
import threading
import time

ABORT = 0x80
NO_OBJECT, NO_SUB, BAD_LENGTH, NO_READING = 0x06020000, 0x06090011, 0x06070010, 0x06010001
TICK = 0.005


class OddDrive:
    SIZES = {
        (0x1000, 0): 4, (0x1001, 0): 1, (0x1017, 0): 2, (0x1018, 1): 4, (0x603F, 0): 2, (0x6040, 0): 2,
        (0x6041, 0): 2, (0x6060, 0): 1, (0x6061, 0): 1, (0x6064, 0): 4, (0x606C, 0): 4, (0x607A, 0): 4,
        (0x6081, 0): 4, (0x6083, 0): 4, (0x6084, 0): 4, (0x608F, 1): 4, (0x608F, 2): 4, (0x6098, 0): 1,
        (0x6099, 1): 4, (0x60FF, 0): 4, (0x6502, 0): 4,
    }  # fmt: skip

    def __init__(
        self, node=5, per_turn=10_000, per_rpm=None, objects=None, without=(), second=None, arrays=None
    ):
        # The second axis of the node, with objects 800h above.
        self.second = OddDrive(node, **second) if second is not None else None
        self.node, self.per_turn = node, per_turn
        self.per_rpm = per_rpm or per_turn / 60
        self.sizes = {key: size for key, size in self.SIZES.items() if key[0] not in without}
        self.values = dict.fromkeys(self.sizes, 0)
        self.values |= {(0x1000, 0): 0x20192, (0x608F, 1): per_turn, (0x608F, 2): 1, (0x6098, 0): 33}
        self.values[0x6502, 0] = 0x25
        self.values[0x6081, 0] = round(60 * self.per_rpm)
        for key, value in (objects or {}).items():
            self.sizes[key], self.values[key] = 4, value
        # Objects that are arrays here: their number of entries. Sub-index 0 is a byte.
        for index, count in (arrays or {}).items():
            self.sizes |= {(index, 0): 1} | {(index, sub): 4 for sub in range(1, count + 1)}
            self.values |= {(index, 0): count} | {(index, sub): 0 for sub in range(1, count + 1)}
        # Objects that cannot be read, and noise of the speed.
        self.write_only, self.noise = set(), 0
        # Each frame of the host comes again after so many seconds.
        self.doubled_after = None
        # The bit of an earlier arrival stays for so long; a limit holds the axis at this position.
        self.stale_reached_s, self.limit_at, self.at_limit = 0.0, None, False
        # It does not obey halt; its power comes after so many seconds; it looks at its controlword so often.
        self.ignores_halt, self.enable_s, self.sample_s = False, 0.0, 0.0
        # Bit 12 stays set after enabling, until bit 4 falls.
        self.keeps_ack = False
        # Reply to a frame in place of the drive: bytes, b"" for silence, None for the drive's own reply.
        self.hook = lambda frame: None
        # When each frame to the node came, and when each value of the controlword did.
        self.frames, self.controls = [], []
        self.writes = []
        self.state, self.old, self.ack, self.reached = 0x40, 0, False, True
        self.position, self.target, self.homing = 0.0, None, None
        self.power_at, self.sampled_at = None, 0.0
        self.fault_at, self.sto_at, self.fault_homing_after = None, None, None
        # It takes another mode never, or only while it is not enabled.
        self.keeps_mode = self.locks_mode = False
        # Number of readings of the statusword that still have the bits of an earlier homing.
        self.stale_reads, self.homing_s, self.homed = 0, 0.3, 0
        self.lock = threading.RLock()
        self.server = socket.create_server(("127.0.0.1", 0))
        self.url = f"canopen+socketcand://127.0.0.1:{self.server.getsockname()[1]}/can0#{node}"
        self.ended = False
        threading.Thread(target=self.accept, daemon=True).start()
        threading.Thread(target=self.move, daemon=True).start()

    def close(self):
        self.ended = True
        self.server.close()
        if self.second:
            self.second.close()

    # The wire.

    def accept(self):
        while not self.ended:
            try:
                client, _ = self.server.accept()
            except OSError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self.serve, args=(client,), daemon=True).start()

    def serve(self, client):
        client.sendall(b"< hi >")
        text = ""
        while data := self.heard(client):
            text += data.decode()
            while ">" in text:
                message, text = text.split(">", 1)
                words = message.replace("<", "").split()
                if words[:1] in (["open"], ["rawmode"]):
                    client.sendall(b"< ok >")
                elif words[:1] == ["send"]:
                    frame = bytes(int(word, 16) for word in words[3 : 3 + int(words[2])])
                    self.answer(client, int(words[1], 16), frame)
                    if self.doubled_after:
                        again = (client, int(words[1], 16), frame)
                        threading.Timer(self.doubled_after, self.answer, again).start()

    @staticmethod
    def heard(client):
        try:
            return client.recv(4096)
        except ConnectionResetError:
            return b""

    def answer(self, client, cob, frame):
        with self.lock:
            reply = self.receive(cob, frame)
            if reply and not self.ended:
                text = f"< frame {0x580 + self.node:X} {time.time():.6f} {reply.hex()} >"
                try:
                    client.sendall(text.encode())
                except OSError:
                    pass

    def receive(self, cob, frame):
        if cob != 0x600 + self.node or len(frame) != 8:
            return None
        self.frames.append((time.monotonic(), frame))
        hooked = self.hook(frame)
        if hooked is not None:
            return hooked
        command, index, sub = struct.unpack("<BHB", frame[:4])
        if self.second and 0x6800 <= index < 0x7000:
            first = frame[:1] + struct.pack("<H", index - 0x800) + frame[3:]
            with self.second.lock:
                reply = self.second.receive(cob, first)
            return reply[:1] + struct.pack("<H", index) + reply[3:]
        key = (index, sub)
        if key not in self.sizes:
            known = any(one[0] == index for one in self.sizes)
            return struct.pack("<BHBI", ABORT, index, sub, NO_SUB if known else NO_OBJECT)
        size = self.sizes[key]
        if command >> 5 == 2 and key in self.write_only:
            return struct.pack("<BHBI", ABORT, index, sub, NO_READING)
        if command >> 5 == 2:
            value = self.read(key) & ((1 << 8 * size) - 1)
            head = struct.pack("<BHB", 0x43 | (4 - size) << 2, index, sub)
            return head + value.to_bytes(4, "little")
        if command >> 5 == 1:
            if 4 - (command >> 2 & 3) != size:
                return struct.pack("<BHBI", ABORT, index, sub, BAD_LENGTH)
            signed = (index, sub) in ((0x607A, 0), (0x60FF, 0), (0x6060, 0))
            self.write(key, int.from_bytes(frame[4 : 4 + size], "little", signed=signed))
            return struct.pack("<BHBI", 0x60, index, sub, 0)
        return None

    # The drive.

    def read(self, key):
        if key == (0x6041, 0):
            if self.homing is not None:
                if self.stale_reads <= 0:
                    self.ack = self.reached = False
                self.stale_reads -= 1
            return self.state | 0x400 * self.reached | 0x800 * self.at_limit | 0x1000 * self.ack
        if key == (0x6064, 0) and self.sizes[key] == 4:
            return round(self.position)
        if key == (0x606C, 0) and self.sizes[key] == 4:
            return round(self.values[key] + random.uniform(-self.noise, self.noise))
        return self.values[key]

    def write(self, key, value):
        self.values[key] = value
        self.writes.append((key[0], value))
        locked = self.locks_mode and self.state == 0x27
        if key == (0x6060, 0) and not self.keeps_mode and not locked:
            self.values[0x6061, 0] = value
        if key != (0x6040, 0):
            return
        self.controls.append((time.monotonic(), value))
        if self.sample_s == 0.0:
            self.control(value)

    def control(self, value):
        rising, falling, self.old = value & ~self.old, self.old & ~value, value
        was = self.state
        if self.state == 0x08:
            self.state = 0x40 if rising & 0x80 else 0x08
        elif value & 0x0F in (0x06, 0x07, 0x0F) and not value & 0x80:
            self.state = {0x06: 0x21, 0x07: 0x23, 0x0F: 0x27}[value & 0x0F]
            if self.state == 0x27 and was != 0x27:
                self.ack |= self.keeps_ack
                if self.enable_s:
                    self.state, self.power_at = 0x23, time.monotonic() + self.enable_s
        elif not value & 0x02 or value & 0x06 == 0x02:
            self.state = 0x40
        if self.state != 0x27:
            self.target = self.homing = None
        elif self.values[0x6061, 0] == 1:
            if rising & 0x10:
                self.target = self.values[0x607A, 0] + (self.position if value & 0x40 else 0)
                self.reached = self.stale_reached_s > 0
                self.began = time.monotonic()
            self.ack = bool(value & 0x10) or self.ack and self.keeps_ack and not falling & 0x10
        elif self.values[0x6061, 0] == 6:
            if rising & 0x10:
                self.homing = time.monotonic()
            elif not value & 0x10:
                # Whoever takes the bit away ends the homing.
                self.homing = None

    def move(self):
        last = time.monotonic()
        while not self.ended:
            time.sleep(TICK)
            now = time.monotonic()
            span, last = now - last, now
            with self.lock:
                self.advance(now, span)

    def advance(self, now, span):
        if self.sample_s and now >= self.sampled_at + self.sample_s:
            self.sampled_at = now
            self.control(self.values[0x6040, 0])
        if self.power_at is not None and now >= self.power_at:
            self.state, self.power_at = 0x27, None
        halted = self.old & 0x100 and not self.ignores_halt
        mode = self.values[0x6061, 0] if self.state == 0x27 else 0
        turn = self.per_turn / self.per_rpm / 60
        before = self.position
        if mode == 3 and not halted:
            self.position += self.values[0x60FF, 0] * turn * span
        if mode == 1 and self.target is not None and not halted:
            way, step = self.target - self.position, self.values[0x6081, 0] * turn * span
            self.position += max(-step, min(step, way))
            self.reached &= now - self.began < self.stale_reached_s
            if self.limit_at is not None and self.position >= self.limit_at:
                self.target, self.reached, self.at_limit = None, True, True
            elif abs(way) <= step:
                self.target, self.reached = None, True
        if self.sizes.get((0x606C, 0)) == 4 and span > 0:
            self.values[0x606C, 0] = (self.position - before) / span / turn
        if mode == 6 and self.homing is not None:
            since = now - self.homing
            if since >= self.homing_s:
                self.homing, self.position, self.ack, self.reached = None, 0.0, True, True
                self.homed += 1
            if self.fault_homing_after is not None and since >= self.fault_homing_after:
                self.fail(0x08)
        if self.state == 0x27 and self.fault_at is not None and self.position >= self.fault_at:
            self.fail(0x08)
        if self.state == 0x27 and self.sto_at is not None and self.position >= self.sto_at:
            self.fail(0x40)

    def fail(self, state):
        self.state, self.target, self.homing, self.power_at = state, None, None, None
        if state == 0x08:
            self.values[0x603F, 0] = 0x8611
