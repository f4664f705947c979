"""Motors of other makers on Modbus RTU, as their public manuals describe them, behind a pseudo-terminal."""

import os
import pty
import select
import struct
import threading
import time
import tty

from faulty_drive import crc

COUNTS = 16384


def signed32(high, low):
    return struct.unpack(">i", struct.pack(">HH", high, low))[0]


class Motor:
    """Position in turns and speed in rpm, to a target or on and on; `ramp` in rpm a second, none is at once."""

    def __init__(self):
        self.position, self.speed, self.target, self.at = 0.0, 0.0, None, time.monotonic()
        self.wanted, self.ramp = 0.0, None

    def advance(self):
        now = time.monotonic()
        way, self.at = now - self.at, now
        change = float("inf") if self.ramp is None else self.ramp * way
        self.speed += max(-change, min(change, self.wanted - self.speed))
        step = self.speed / 60 * way
        if self.target is not None and abs(self.target - self.position) <= abs(step):
            self.position, self.speed, self.wanted, self.target = self.target, 0.0, 0.0, None
        else:
            self.position += step

    def run(self, rpm, ramp=None):
        self.target, self.wanted, self.ramp = None, rpm, ramp
        self.advance()

    def go(self, target, rpm):
        self.target, self.ramp = target, None
        self.wanted = abs(rpm) if target > self.position else -abs(rpm)
        self.advance()


class Servo42d:
    """MKS SERVO42D: readings are input registers, and motions are words of one request at F4h, F5h and F6h."""

    def __init__(self):
        self.motor, self.enabled, self.protected, self.positions = Motor(), 0, 0, False

    def status(self):
        """1 at standstill, 2 while it speeds up, 3 while it slows down, 4 at full speed (8.1, 10)."""
        speed, wanted = abs(self.motor.speed), abs(self.motor.wanted)
        if speed == wanted:
            return 4 if speed else 1
        return 2 if speed < wanted else 3

    def read(self, function, start, count):
        counts = round(self.motor.position * COUNTS) & 0xFFFF_FFFF_FFFF
        readings = {
            (0x31, 3): [counts >> 32, counts >> 16 & 0xFFFF, counts & 0xFFFF],
            (0x32, 1): [round(self.motor.speed) & 0xFFFF],
            (0x3A, 1): [self.enabled],
            (0x3E, 1): [self.protected],
            (0xF1, 1): [self.status()],
        }
        return readings.get((start, count)) if function == 4 else None

    def write(self, start, words):
        if (start, len(words)) == (0xF3, 1):
            self.enabled = words[0]
        elif (start, words) == (0x3D, [1]):
            self.protected = 0
        elif (start, words) == (0xF7, [1]):
            self.motor.run(0)
        elif (start, len(words)) == (0xF6, 2):
            speed = -words[1] if words[0] & 0x100 else words[1]
            # Chapter 6.1: every 50 us x (256 - acc) one rpm. A stop of the speed mode is not one of a move.
            if speed or not (self.positions and self.motor.target is not None):
                self.motor.run(speed, 20000 / (256 - (words[0] & 0xFF)))
            self.positions = self.positions and not speed
        elif start in (0xF4, 0xF5) and len(words) == 4:
            way = signed32(*words[2:]) / COUNTS
            self.motor.go(way + (self.motor.position if start == 0xF4 else 0), words[1])
            self.positions = True
        else:
            return False
        return True


class VfdEl:
    """Delta VFD-EL with a motor of four poles: speeds have no sign, and the direction is in bits beside them."""

    def __init__(self):
        self.motor, self.command, self.frequency, self.error = Motor(), 1, 0, 0

    def direction(self):
        """0 forward, 1 from reverse to forward, 2 from forward to reverse, 3 reverse."""
        goes_back, back = self.motor.speed < 0, self.command >> 4 & 3 == 2
        return (3 if back else 1) if goes_back else (2 if back and self.motor.speed > 0 else 3 if back else 0)

    def read(self, function, start, count):
        turning = 3 if self.command & 3 == 2 else 1 if self.motor.speed else 0
        words = {
            0x2000: self.command,
            0x2001: self.frequency,
            0x2100: self.error,
            0x2101: turning | self.direction() << 3,
            0x2102: self.frequency,
            0x2103: round(abs(self.motor.speed) / 0.3),
            0x2104: 12,
            0x2108: 3110,
        }
        wanted = [words.get(start + n) for n in range(count)]
        return wanted if function == 3 and None not in wanted else None

    def write(self, start, words):
        if (start, len(words)) not in [(0x2000, 1), (0x2001, 1), (0x2002, 1)]:
            return False
        if start == 0x2001:
            self.frequency = words[0]
        elif start == 0x2002 and words[0] & 2:
            self.error = 0
        elif start == 0x2000:
            self.command = words[0]
        back = self.command >> 4 & 3 == 2
        speed = self.frequency * 0.3 * (-1 if back else 1) if self.command & 3 == 2 and not self.error else 0
        self.motor.run(speed, 600)
        return True


class Az:
    """Oriental Motor AZ: a write of the trigger at 66h starts what the registers from 5Ah on hold."""

    def __init__(self):
        self.motor = Motor()
        self.words = {address: 0 for address in [*range(0x58, 0x68), 0x7D, 0x7F, 0x80, 0x81, *range(0xCC, 0xD0)]}

    def read(self, function, start, count):
        position, speed = round(self.motor.position * 1000), round(self.motor.speed)
        state = 0x2000 if self.motor.speed else 0x4020
        self.words[0x7F] = 0x80 if self.words[0x81] else state
        for address, value in [(0xCC, position), (0xCE, speed)]:
            self.words[address], self.words[address + 1] = struct.unpack(">HH", struct.pack(">i", value))
        wanted = [self.words.get(start + n) for n in range(count)]
        return wanted if function == 3 and None not in wanted else None

    def write(self, start, words):
        if any(start + n not in self.words for n in range(len(words))):
            return False
        self.words.update((start + n, word) for n, word in enumerate(words))
        number = lambda at: signed32(self.words[at], self.words[at + 1])
        if self.words[0x7D] & 0x80:
            self.words[0x81] = 0
        if self.words[0x7D] & 0x20 or self.words[0x81]:
            self.motor.run(0)
        elif start <= 0x67 < start + len(words) and number(0x66) == 1:
            kind, rpm = number(0x5A), number(0x5E) * 0.06
            way = number(0x5C) / 1000
            if kind == 16:
                self.motor.run(rpm)
            else:
                self.motor.go(way + (self.motor.position if kind == 2 else 0), rpm)
        return True


class Zlac8015d:
    """ZLTECH ZLAC8015D: two motors behind one address, with one control word and one operating mode."""

    def __init__(self):
        self.motors = [Motor(), Motor()]
        self.words = {0x200D: 0, 0x200E: 0, 0x200F: 0}
        self.words.update({address: 0 for address in range(0x2080, 0x2092)})
        self.faults, self.enabled = [0, 0], False

    @property
    def motor(self):
        """Both motors, for a station that lets time pass."""
        return self

    def advance(self):
        for motor in self.motors:
            motor.advance()

    def read(self, function, start, count):
        words = dict(self.words)
        for n, motor in enumerate(self.motors):
            counts = round(motor.position * COUNTS) & 0xFFFF_FFFF
            words[0x20A5 + n], words[0x20AB + n] = self.faults[n], round(10 * motor.speed) & 0xFFFF
            words[0x20A7 + 2 * n], words[0x20A8 + 2 * n] = counts >> 16, counts & 0xFFFF
        wanted = [words.get(start + n) for n in range(count)]
        return wanted if function == 3 and None not in wanted else None

    def write(self, start, words):
        if any(start + n not in self.words for n in range(len(words))):
            return False
        self.words.update((start + n, word) for n, word in enumerate(words))
        control = words[0] if start == 0x200E else None
        if control == 6:
            self.faults = [0, 0]
        elif control in (5, 7):
            self.enabled = False
        elif control == 8:
            self.enabled = not any(self.faults)
        for n, motor in enumerate(self.motors):
            speed = struct.unpack(">h", struct.pack(">H", self.words[0x2088 + n]))[0]
            if not self.enabled:
                motor.run(0)
            elif self.words[0x200D] == 3:
                motor.run(speed)
            elif control == 0x11 + n or control == 0x10:
                way = signed32(self.words[0x208A + 2 * n], self.words[0x208B + 2 * n]) / COUNTS
                relative = self.words[0x200D] == 1
                motor.go(way + (motor.position if relative else 0), self.words[0x208E + n])
        return True


class Ihsv57:
    """JMC iHSV57: holding registers of a servo that moves by pulses; values of 32 bits have the high word first."""

    def __init__(self):
        self.motor, self.written = Motor(), {}
        self.words = {1: 3000, 2: 32, 3: 71, 23: 1, 101: 0, 102: 1, 103: 10, 305: 0, 306: 10, 315: 3000, 510: 300}
        self.words[511] = -300 & 0xFFFF
        self.words.update({0x0834: 0xFFFF, 0x0835: -70_000 & 0xFFFF, 0x0836: 0xFFFE, 0x0837: -70_010 & 0xFFFF})
        self.words[0x0834] = -70_000 >> 16 & 0xFFFF
        self.words.update({0x0838: 0, 0x0839: 10, 0x0843: 12, 0x0844: -11 & 0xFFFF})

    def read(self, function, start, count):
        words = [self.words.get(start + n) for n in range(count)]
        return words if function == 3 and None not in words else None

    def write(self, start, words):
        self.written.update((start + n, word) for n, word in enumerate(words))
        self.words.update((start + n, word) for n, word in enumerate(words))
        return True


class Station(threading.Thread):
    """A drive at address 1 of a pseudo-terminal."""

    def __init__(self, drive):
        super().__init__(daemon=True)
        self.drive, self.requests, self.is_open = drive, [], True
        self.end, self.other_end = pty.openpty()
        tty.setraw(self.end)
        tty.setraw(self.other_end)
        self.path = os.ttyname(self.other_end)
        self.start()

    def run(self):
        frame = b""
        while self.is_open:
            if select.select([self.end], [], [], 0.003)[0]:
                frame += os.read(self.end, 300)
            elif frame:
                self.answer(frame)
                frame = b""

    def answer(self, frame):
        if frame[0] != 1 or crc(frame[:-2]) != frame[-2:]:
            return
        self.drive.motor.advance()
        function, start, third = struct.unpack(">BHH", frame[1:6])
        words = None
        if function in (3, 4):
            words = self.drive.read(function, start, third)
            pdu = words and bytes([function, 2 * third]) + struct.pack(f">{third}H", *words)
        elif function in (6, 16):
            words = [third] if function == 6 else list(struct.unpack(f">{third}H", frame[7:-2]))
            self.requests.append((start, words))
            pdu = frame[1:6] if self.drive.write(start, words) else None
        else:
            pdu = None
        reply = bytes([1]) + (pdu or bytes([function | 0x80, 2 if words is None else 1]))
        os.write(self.end, reply + crc(reply))

    def close(self):
        self.is_open = False
        self.join()
        os.close(self.end)
        os.close(self.other_end)
