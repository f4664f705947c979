"""libpolepair by ctypes: for a Python without the package `polepair`, or as a pattern for other languages.

    from polepair_c import Link
    with Link("sim:tmcl") as link, link.axis("1") as axis, axis.armed():
        axis.velocity("60 rpm")
        link.sleep(2)

`POLEPAIR_LIBRARY` names the library's file. polepair.h documents the rules of each function.
"""

import contextlib
import ctypes
import os
import sys
from ctypes import POINTER, byref, c_char, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint32, c_void_p

OK, USAGE, DRIVE_FAULT, PENDING, NOTHING, BUFFER = 0, 2, 8, 64, 65, 66
ENABLE, DISABLE, CLEAR, VELOCITY, TORQUE, MOVE_TO, MOVE_BY, MOVE_ON, CURVE_TO, CURVE_BY, HOME, STORE = range(12)
SIGNALS = ["position", "velocity", "torque", "current", "voltage", "temperature", "target position",
           "target velocity", "fault", "enabled", "moving", "reached", "mode", "time",
           "positive limit", "negative limit"]

_NAMES = {"win32": "polepair.dll", "darwin": "libpolepair.dylib"}
_LIBRARY = os.environ.get("POLEPAIR_LIBRARY", _NAMES.get(sys.platform, "libpolepair.so"))
_native = ctypes.CDLL(_LIBRARY)


class _Sized(ctypes.Structure):
    """A struct that begins with its size."""

    def __init__(self):
        super().__init__(size=ctypes.sizeof(self))

    def text(self, field):
        return getattr(self, field).decode()


class _Error(_Sized):
    _fields_ = [("size", c_uint32), ("status", c_int), ("executed", c_int), ("may_turn", c_int),
                ("code", c_char * 32), ("message", c_char * 1024), ("hint", c_char * 512)]


class AxisInfo(_Sized):
    _fields_ = [("size", c_uint32), ("number", c_uint32), ("kind", c_uint32), ("is_simulated", c_uint32),
                ("name", c_char * 64), ("label", c_char * 64), ("protocol", c_char * 32), ("profile", c_char * 64),
                ("title", c_char * 128), ("caution", c_char * 512), ("watchdog", c_char * 256)]


class Parameter(_Sized):
    _fields_ = [("size", c_uint32), ("readable", c_uint32), ("writable", c_uint32), ("moves", c_uint32),
                ("raw_min", c_int64), ("raw_max", c_int64), ("name", c_char * 128), ("symbol", c_char * 64),
                ("unit", c_char * 32), ("kind", c_char * 16), ("persistence", c_char * 32), ("about", c_char * 512)]


class Found(_Sized):
    _fields_ = [("size", c_uint32), ("number", c_uint32), ("profile", c_char * 64), ("title", c_char * 128),
                ("identity", c_char * 256), ("clash", c_char * 256)]


class PolepairError(Exception):
    """What a failed call raises."""

    def __init__(self, error):
        super().__init__(error.text("message"))
        self.status, self.code, self.hint = error.status, error.text("code"), error.text("hint")
        self.executed = None if error.executed < 0 else bool(error.executed)
        self.may_turn = bool(error.may_turn)


_TEXT = [c_char_p, c_size_t]
_BUFFER = [c_char_p, c_size_t, POINTER(c_size_t)]
for _name, _arguments in {
    "pp_link_open": [*_TEXT, POINTER(c_void_p)],
    "pp_link_close": [c_void_p, POINTER(_Error)],
    "pp_link_error": [c_void_p, POINTER(_Error)],
    "pp_link_axis_count": [c_void_p, POINTER(c_size_t)],
    "pp_link_axis_at": [c_void_p, c_size_t, POINTER(c_void_p)],
    "pp_link_axis": [c_void_p, *_TEXT, POINTER(c_void_p)],
    "pp_link_stop_all": [c_void_p],
    "pp_link_sleep": [c_void_p, c_double],
    "pp_simulation_act": [c_void_p, c_size_t, *_TEXT],
    "pp_axis_close": [c_void_p],
    "pp_axis_error": [c_void_p, POINTER(_Error)],
    "pp_axis_get_info": [c_void_p, POINTER(AxisInfo)],
    "pp_axis_get": [c_void_p, *_TEXT, POINTER(c_double)],
    "pp_axis_get_raw": [c_void_p, *_TEXT, POINTER(c_int64)],
    "pp_axis_get_text": [c_void_p, *_TEXT, *_BUFFER],
    "pp_axis_set": [c_void_p, *_TEXT, c_double],
    "pp_axis_set_raw": [c_void_p, *_TEXT, c_int64, c_int],
    "pp_axis_set_text": [c_void_p, *_TEXT, *_TEXT, c_int],
    "pp_axis_parameter_count": [c_void_p, POINTER(c_size_t)],
    "pp_axis_parameter_at": [c_void_p, c_size_t, POINTER(Parameter)],
    "pp_axis_has_signal": [c_void_p, c_int, POINTER(c_int)],
    "pp_axis_read": [c_void_p, c_int, POINTER(c_double)],
    "pp_axis_trace": [c_void_p, POINTER(c_int), c_size_t, c_double, POINTER(c_void_p)],
    "pp_trace_read": [c_void_p, c_double, POINTER(c_double), POINTER(c_double)],
    "pp_trace_error": [c_void_p, POINTER(_Error)],
    "pp_trace_close": [c_void_p],
    "pp_axis_arm": [c_void_p],
    "pp_axis_release": [c_void_p],
    "pp_axis_stop": [c_void_p],
    "pp_axis_wait": [c_void_p, c_double],
    "pp_axis_run": [c_void_p, c_int, c_double, c_void_p],
    "pp_axis_run_text": [c_void_p, c_int, *_TEXT, c_void_p],
    "pp_axis_begin": [c_void_p, c_int, c_double, c_void_p, POINTER(c_void_p)],
    "pp_request_wait": [c_void_p, c_double],
    "pp_request_error": [c_void_p, POINTER(_Error)],
    "pp_request_close": [c_void_p],
    "pp_scan_open": [*_TEXT, c_uint32, c_uint32, POINTER(c_void_p)],
    "pp_scan_error": [c_void_p, POINTER(_Error)],
    "pp_scan_count": [c_void_p, POINTER(c_size_t)],
    "pp_scan_at": [c_void_p, c_size_t, POINTER(Found)],
    "pp_scan_close": [c_void_p],
}.items():
    _function = getattr(_native, _name)
    _function.argtypes, _function.restype = _arguments, None if _name.endswith("_close") else c_int
_native.pp_link_close.restype = c_int


def _text(text):
    encoded = text.encode()
    return encoded, len(encoded)


class _Handle:
    """A handle, which closes itself at the end of its block."""

    def __init__(self, handle, kind):
        self._handle, self._kind = handle, kind

    def _call(self, name, *arguments):
        status = getattr(_native, f"pp_{self._kind}_{name}")(self._handle, *arguments)
        if status != OK:
            error = _Error()
            getattr(_native, f"pp_{self._kind}_error")(self._handle, byref(error))
            raise PolepairError(error)

    def _result(self, kind, name, *arguments):
        value = kind()
        self._call(name, *arguments, byref(value))
        return value.value

    def close(self):
        handle, self._handle = self._handle, None
        getattr(_native, f"pp_{self._kind}_close")(handle)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


class Axis(_Handle):
    """One axis: a motor."""

    def __init__(self, handle):
        super().__init__(handle, "axis")

    def info(self):
        info = AxisInfo()
        self._call("get_info", byref(info))
        return info

    def get(self, name):
        return self._result(c_double, "get", *_text(name))

    def get_raw(self, name):
        return self._result(c_int64, "get_raw", *_text(name))

    def get_text(self, name):
        room, needed = 128, c_size_t()
        while True:
            buffer = ctypes.create_string_buffer(room)
            status = _native.pp_axis_get_text(self._handle, *_text(name), buffer, room, byref(needed))
            if status != BUFFER:
                break
            room = needed.value + 1
        if status != OK:
            error = _Error()
            _native.pp_axis_error(self._handle, byref(error))
            raise PolepairError(error)
        return buffer.value.decode()

    def set(self, name, value, store=False):
        """A number in the parameter's unit, or text with a unit."""
        if isinstance(value, str):
            self._call("set_text", *_text(name), *_text(value), store)
        else:
            self._call("set", *_text(name), value)

    def set_raw(self, name, value, store=False):
        self._call("set_raw", *_text(name), value, store)

    def parameters(self):
        for at in range(self._result(c_size_t, "parameter_count")):
            parameter = Parameter()
            self._call("parameter_at", at, byref(parameter))
            yield parameter

    def has_signal(self, signal):
        return self._result(c_int, "has_signal", SIGNALS.index(signal)) != 0

    def read(self, signal):
        return self._result(c_double, "read", SIGNALS.index(signal))

    @contextlib.contextmanager
    def trace(self, signals, period):
        """Yields a function that returns the next row: its time and its values, or None after so many seconds."""
        numbers = (c_int * len(signals))(*map(SIGNALS.index, signals))
        trace = c_void_p()
        self._call("trace", numbers, len(signals), period, byref(trace))
        row, time = (c_double * len(signals))(), c_double()

        def read(seconds):
            status = _native.pp_trace_read(trace, seconds, byref(time), row)
            if status == NOTHING:
                return None
            if status != OK:
                error = _Error()
                _native.pp_trace_error(trace, byref(error))
                raise PolepairError(error)
            return time.value, list(row)

        try:
            yield read
        finally:
            _native.pp_trace_close(trace)

    def run(self, verb, target=float("nan")):
        """A target in SI, or as text with a unit."""
        if isinstance(target, str):
            self._call("run_text", verb, *_text(target), None)
        else:
            self._call("run", verb, target, None)

    def arm(self):
        self._call("arm")

    def release(self):
        """Stops, disables and disarms."""
        self._call("release")

    def stop(self):
        self._call("stop")

    def enable(self):
        self.run(ENABLE)

    def clear(self):
        self.run(CLEAR)

    def velocity(self, speed):
        self.run(VELOCITY, speed)

    def move_to(self, position):
        self.run(MOVE_TO, position)

    def move_by(self, distance):
        self.run(MOVE_BY, distance)

    def home(self, seconds):
        """False if it has not ended within so many seconds."""
        request = c_void_p()
        self._call("begin", HOME, 0, None, byref(request))
        try:
            status = _native.pp_request_wait(request, seconds)
            if status not in (OK, PENDING):
                error = _Error()
                _native.pp_request_error(request, byref(error))
                raise PolepairError(error)
            return status == OK
        finally:
            _native.pp_request_close(request)

    def wait(self, seconds):
        """Waits until a move has reached its target."""
        self._call("wait", seconds)

    @contextlib.contextmanager
    def armed(self):
        """Arms and enables the axis, and releases it at the end of the block."""
        self.arm()
        try:
            try:
                self.enable()
            except PolepairError as error:
                if error.code != "E218":  # a drive without a switch for its power is only armed
                    raise
            yield self
        finally:
            self.release()


class Link(_Handle):
    """A link: a wire, a simulation, or the axes of a running server."""

    def __init__(self, url):
        super().__init__(c_void_p(), "link")
        if _native.pp_link_open(*_text(url), byref(self._handle)) != OK:
            error = _Error()
            _native.pp_link_error(self._handle, byref(error))
            _native.pp_link_close(self._handle, None)
            raise PolepairError(error)

    def axes(self):
        return [self.axis_at(at) for at in range(self._result(c_size_t, "axis_count"))]

    def axis_at(self, index):
        return Axis(c_void_p(self._result(c_void_p, "axis_at", index)))

    def axis(self, name):
        return Axis(c_void_p(self._result(c_void_p, "axis", *_text(name))))

    def stop_all(self):
        self._call("stop_all")

    def sleep(self, seconds):
        """Waits on the link's clock."""
        self._call("sleep", seconds)

    def act(self, drive, act):
        """Does something to a simulated drive: "supply=18"."""
        _native.pp_simulation_act(self._handle, drive, *_text(act))

    def close(self):
        """Stops what is armed, and closes the link."""
        handle, self._handle = self._handle, None
        error = _Error()
        if _native.pp_link_close(handle, byref(error)) != OK:
            raise PolepairError(error)


def scan(url, first, last):
    """Scans a wire for drives, by reads only."""
    handle = c_void_p()
    status = _native.pp_scan_open(*_text(url), first, last, byref(handle))
    try:
        if status != OK:
            error = _Error()
            _native.pp_scan_error(handle, byref(error))
            raise PolepairError(error)
        count = c_size_t()
        _native.pp_scan_count(handle, byref(count))
        drives = [Found() for _ in range(count.value)]
        for at, drive in enumerate(drives):
            _native.pp_scan_at(handle, at, byref(drive))
        return drives
    finally:
        _native.pp_scan_close(handle)
