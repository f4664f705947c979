"""The native part. The public interface is in the other modules of the package."""

from collections.abc import Callable
from os import PathLike
from typing import Any, final

__version__: str

def connect(
    url: str,
    profile: str | PathLike[str] | None = None,
    trace: bool = False,
    token_file: str | PathLike[str] | None = None,
    certificate: str | None = None,
    client_cert: str | PathLike[str] | None = None,
    client_key: str | PathLike[str] | None = None,
) -> Link: ...
def connect_over(
    adapter: object,
    name: str,
    can: bool,
    protocol: str,
    axes: list[int],
    query: str,
    profile: str | PathLike[str] | None = None,
) -> Link: ...
def scan(
    url: str,
    first: int | None = None,
    last: int | None = None,
    profile: str | PathLike[str] | None = None,
    progress: Callable[[int, int, int], bool | None] | None = None,
) -> tuple[list[tuple[int, str, str, str, str | None]], bool]: ...
def run_command(command_line: list[str], python: str) -> int: ...
def is_capture_name(name: str) -> bool: ...
def fingerprint(path: str) -> str: ...
def decode_inputs(options: list[str]) -> str: ...
def decode_to_dataset(path: str, name: str, root: str, options: list[str]) -> tuple[bool, list[str]]: ...
def profiles() -> list[tuple[str, str, str]]: ...
def rack_of_word(word: str) -> tuple[bool, str, list[tuple[str, int | None]]]: ...
def explain(
    subject: str,
    frame: str | tuple[bytes, int | None, bool, bool],
    to_drive: bool | None = None,
) -> tuple[
    bytes, str, int | None, str, str | None, list[tuple[int, int, str, Any, str]]
]: ...
def explain_code(
    subject: str, code: int
) -> tuple[str | None, list[tuple[str, tuple[int, str, str, str, str, bool]]]]: ...
def begin_together(
    moves: list[tuple[Axis, str, float | str | None, float | str | None, float | str | None]],
) -> None: ...
def is_signal(name: str) -> bool: ...
def forked() -> None: ...
def stop_armed() -> None: ...
def stop_owed(axes: list[Axis]) -> None: ...
@final
class Link:
    @property
    def url(self) -> str: ...
    @property
    def is_remote(self) -> bool: ...
    @property
    def simulation(self) -> Simulation | None: ...
    def axes(self) -> list[Axis]: ...
    def axis(self, number: int) -> Axis: ...
    def named(self, name: str) -> Axis: ...
    def stop_all(self) -> None: ...
    def stop_armed(self) -> None: ...
    def events(self) -> Events: ...
    def losses(self) -> list[tuple[str, int, int, int, int]]: ...
    def trace(self) -> list[str] | None: ...
    def close(self) -> None: ...

@final
class Axis:
    @property
    def is_remote(self) -> bool: ...
    @property
    def number(self) -> int: ...
    @property
    def name(self) -> str: ...
    @property
    def label(self) -> str: ...
    @property
    def protocol(self) -> str: ...
    @property
    def product(self) -> tuple[str, str]: ...
    @property
    def caution(self) -> str: ...
    @property
    def watchdog(self) -> tuple[str, float | None, str | None]: ...
    @property
    def is_armed(self) -> bool: ...
    @property
    def now(self) -> float: ...
    @property
    def is_known(self) -> bool: ...
    def parameters(self) -> list[Parameter]: ...
    def find(self, name: str) -> int: ...
    def has(self, name: str) -> bool: ...
    def read_raw(self, name: str) -> int: ...
    def read_data(self, id: int) -> list[int]: ...
    def write_data(self, id: int, data: bytes) -> None: ...
    def write_raw(self, name: str, raw: int) -> None: ...
    def raw(self, said: str | bytes, id: int | None = None) -> int: ...
    def in_si(self, verb: str, argument: str, amount: float | str) -> float: ...
    def arm(self, armed: bool) -> None: ...
    def events(self) -> Events: ...
    def verbs(self) -> list[str]: ...
    def signals(self) -> list[tuple[str, str]]: ...
    def signal_units(self, names: list[str]) -> list[str]: ...
    def read_signals(self, names: list[str]) -> list[float]: ...
    def faults(self) -> list[tuple[int, str, str, str, str, bool]]: ...
    def state(
        self,
    ) -> tuple[
        str | None,
        bool | None,
        bool,
        bool | None,
        list[tuple[str, float, float]],
        str | None,
    ]: ...
    def sleep(self, seconds: float) -> None: ...

    def set_watchdog(self, seconds: float) -> list[tuple[str, int]]: ...
    def start_read(self, id: int) -> Request: ...
    def start_write(self, id: int, raw: int | WriteAmount, keep: bool) -> Request: ...
    def start_raw(self, said: str | bytes, id: int | None = None) -> Request: ...
    def raw_of(self, id: int, amount: float | str) -> int | WriteAmount: ...
    def value(self, id: int, read: int | Reading) -> tuple[float, str, str | None, str]: ...
    def start(
        self,
        verb: str,
        target: float | str | None = None,
        velocity: float | str | None = None,
        acceleration: float | str | None = None,
        torque: float | str | None = None,
        jerk_time: float | str | None = None,
        deceleration: float | str | None = None,
    ) -> Request: ...
    def start_own(self, verb: str) -> Request | None: ...
    def learn(self) -> None: ...
    def watch(self, names: list[str], period: float) -> SampleStream: ...

@final
class Reading:
    def __index__(self) -> int: ...

@final
class WriteAmount: ...

@final
class SampleStream:
    @property
    def patience(self) -> float | None: ...
    @property
    def lost(self) -> int: ...
    def result(self, timeout: float | None = None) -> tuple[float, list[float]] | None: ...
    def tell(self, wake: Callable[[], object]) -> bool: ...

@final
class Events:
    @property
    def lost(self) -> int: ...
    @property
    def in_virtual_time(self) -> bool: ...
    @property
    def closed(self) -> bool: ...
    def result(
        self, timeout: float | None = None
    ) -> (
        tuple[
            float,
            int | None,
            str,
            str,
            float,
            int,
            str,
            tuple[int, str, str, str, str, bool] | None,
        ]
        | None
    ): ...
    def tell(self, wake: Callable[[], object]) -> bool: ...
    def close(self) -> None: ...

@final
class Parameter:
    """What a drive has, as its profile says it."""

    @property
    def name(self) -> str:
        """The name that users type."""
    @property
    def symbol(self) -> str:
        """What the manual calls it."""
    @property
    def about(self) -> str:
        """What it does; empty where no source says."""
    @property
    def unit(self) -> str:
        """Its unit; empty for none."""
    @property
    def raw_range(self) -> tuple[int, int]:
        """Least and greatest raw value."""
    @property
    def raw_default(self) -> int | None:
        """Raw value from the factory, where known."""
    @property
    def readable(self) -> bool: ...
    @property
    def writable(self) -> bool: ...
    @property
    def persistence(self) -> str:
        """What a written value survives: volatile, storable, always, unless-ram."""
    @property
    def moves(self) -> bool:
        """Writing it may move the motor: the axis must be armed."""
    @property
    def words(self) -> list[tuple[int, str]]:
        """Names of raw values."""
    @property
    def section(self) -> str:
        """Its section in the manual."""

@final
class Request:
    def result(self, timeout: float | None = None) -> int | Reading | None: ...
    def tell(self, wake: Callable[[], object]) -> bool: ...

@final
class LssMaster:
    def __new__(cls, url: str, profile: str | PathLike[str] | None = None) -> LssMaster: ...
    def close(self) -> None: ...
    def identity_of(self, node_id: int) -> tuple[int, int, int, int]: ...
    def node_answers(self, node_id: int) -> bool: ...
    def has_unconfigured(self) -> bool: ...
    def find_unconfigured(self) -> tuple[int, int, int, int] | None: ...
    def select(self, vendor: int, product: int, revision: int, serial: int) -> bool: ...
    def select_only_device(self) -> tuple[int, int, int, int]: ...
    def selected_identity(self) -> tuple[int, int, int, int]: ...
    def node_id(self) -> int | None: ...
    def set_node_id(self, node_id: int | None) -> None: ...
    def set_bit_rate(self, bit_per_s: int) -> None: ...
    def store(self) -> None: ...
    def leave_configuration(self) -> None: ...
    def restart_communication(self, node_id: int) -> None: ...

@final
class Simulation:
    @property
    def now(self) -> float: ...
    @property
    def is_virtual(self) -> bool: ...
    def run(self, seconds: float) -> None: ...
    def act(self, link: int, drive: int, what: str, value: float, motor: int) -> bool: ...
    def truth(self, link: int, drive: int, motor: int) -> Truth: ...

@final
class Truth:
    """The real state of a motor, independent of the drive's reports."""

    @property
    def position(self) -> float:
        """Shaft position since power-on, rad."""
    @property
    def velocity(self) -> float:
        """Shaft speed, rad/s."""
    @property
    def current(self) -> float:
        """Motor current, A."""
    @property
    def torque(self) -> float:
        """Air-gap torque, N·m."""
    @property
    def winding(self) -> float:
        """Winding temperature, degC."""
    @property
    def enabled(self) -> bool:
        """The power stage is on."""
    @property
    def fault(self) -> int:
        """The drive's fault code or bits, zero for none."""
    @property
    def flash_writes(self) -> int:
        """Writes to flash or EEPROM since it was made."""

@final
class Decoder:
    def __new__(
        cls,
        path: str | PathLike[str],
        rules: str | None = None,
        profile: str | None = None,
        format: str | None = None,
    ) -> Decoder: ...
    @property
    def verdicts(self) -> list[str]: ...
    @property
    def damage(self) -> list[str]: ...
    def tables(self, names: list[str]) -> list[Columns]: ...
    def read(self) -> list[Event]: ...

@final
class Columns:
    @property
    def name(self) -> str: ...
    def __len__(self) -> int: ...
    def fields(self) -> list[tuple[str, str]]: ...
    def __arrow_c_schema__(self) -> object: ...
    def __arrow_c_stream__(self, requested_schema: object = None) -> object: ...
    def lend(self, column: str) -> tuple[Lent, Lent | None, list[str] | None]: ...
    def lend_bytes(self, column: str) -> tuple[Lent, Lent]: ...
    def byte_strings(self, column: str) -> list[bytes]: ...
    def cells(self, column: str, count: int) -> list[str]: ...
    def texts(self, column: str) -> list[str]: ...

@final
class Lent:
    @property
    def __array_interface__(self) -> dict[str, Any]: ...

@final
class Codec:
    """A protocol's texts as bytes, and its frames as values: for many of them, without their words.

    `via` is serial, rs485 or can. Errors: `Unsupported` E203 for an unknown protocol.

    >>> import polepair
    >>> codec = polepair.Codec("modbus-rtu", axis=1)
    >>> request = codec.encode("read 0x0100 2")
    >>> codec.value(bytes.fromhex("01 03 04 00 07 00 08 4A 35"), "values", request)
    (7, 8)
    """

    def __new__(
        cls, protocol: str, axis: int | None = None, host: int | None = None, via: str | None = None
    ) -> Codec: ...
    @property
    def protocol(self) -> str: ...
    def encode(self, text: str) -> bytes:
        """The bytes of a text; earlier texts are cached.

        Errors: `Unsupported` E241 for what is not of the language, E222 for what cannot be sent.
        """
    def make(self, text: str) -> tuple[bytes, int | None, bool]: ...
    def value(
        self, frame: bytes, field: str, request: bytes | None = None, id: int | None = None
    ) -> Any:
        """One field of a drive's frame: int, float, str, or a tuple of 16-bit words.

        `field` is a name that `explain` has for it, `request` what the frame answers, `id` its CAN
        identifier. Errors: `ProtocolError` for a frame that breaks the protocol, `Unsupported` E213
        for a field that it has not.
        """

@final
class Layout:
    """Values packed into a frame bit by bit, the least significant first, as CANopen maps them.

    `u16 status, i32 position, f32 torque, u1 ready, 7`: a type with its bits and a name each; a
    number alone leaves so many bits out.

    >>> import polepair
    >>> layout = polepair.Layout("u16 status, i32 position")
    >>> layout.unpack(layout.pack(0x1237, -5))
    (4663, -5)
    """

    def __new__(cls, text: str) -> Layout: ...
    @property
    def names(self) -> list[str]:
        """The values' names, in order."""
    @property
    def size(self) -> int:
        """Bytes that it takes."""
    def unpack(self, data: bytes | bytearray) -> tuple[Any, ...]:
        """The values of a frame, in order. Errors: ValueError for too few bytes."""
    def pack(self, *values: float) -> bytes:
        """The bytes of a frame with these values. Errors: OverflowError for what does not fit."""

@final
class Event:
    """One frame of a capture, or bytes that are none."""

    @property
    def number(self) -> int:
        """Its number in the capture, from 1."""
    @property
    def time_ns(self) -> int | None:
        """Nanoseconds since the capture's epoch; None where the capture does not say."""
    @property
    def link(self) -> str: ...
    @property
    def direction(self) -> str | None:
        """`tx` from the host, `rx` to it; None where the capture does not say."""
    @property
    def protocol(self) -> str | None:
        """The protocol that decodes it; None if there is none."""
    @property
    def bytes(self) -> bytes: ...
    @property
    def id(self) -> int | None:
        """CAN identifier."""
    @property
    def extended(self) -> bool:
        """A CAN identifier of 29 bits."""
    @property
    def remote(self) -> bool:
        """A CAN remote request."""
    @property
    def echo(self) -> bool:
        """The host's own request, echoed by its adapter."""
    @property
    def kind(self) -> str:
        """The protocol's word for it: `GAP`, `SDO read`."""
    @property
    def axis(self) -> int | None:
        """The axis, station or module that it concerns."""
    @property
    def fields(self) -> dict[str, Any]:
        """Its fields by name."""
    @property
    def text(self) -> str:
        """The one-line meaning."""
    @property
    def error(self) -> str | None:
        """What is wrong with it."""
    @property
    def notices(self) -> list[tuple[str, dict[str, Any]]]:
        """What its conversation tells at this frame: a kind, and its facts by name."""

@final
class CanWire:
    def __new__(cls, url: str) -> CanWire: ...
    def describe(self) -> str: ...
    def send(self, id: int, extended: bool, remote: bool, len: int, bytes: bytes) -> None: ...
    def now(self) -> float: ...
    def wake(self) -> None: ...
    def receive(
        self, timeout: float
    ) -> tuple[tuple[float, int, bool, bool, int, bytes] | None, bool]: ...
