"""Controls motor drives of several makers, simulates them, and decodes captures of their buses.

>>> import polepair
>>> with polepair.connect("sim:tmcl?time=virtual") as link:
...     for axis in link.axes:
...         print(axis.product)
tmcm-171
"""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Callable, Iterable
from os import PathLike
from typing import TYPE_CHECKING

from . import _polepair as _native
from ._link import Simulation, opened
from ._polepair import Codec, Event, Layout, Parameter, Truth, __version__
from ._records import Fault, Found, Losses, Reading, State
from ._sync import (
    Armed,
    Axis,
    Group,
    GroupMotion,
    Link,
    Motion,
    Parameters,
    RawParameters,
    Watch,
)
from .errors import DriveFault, NoReply, PolepairError, ProtocolError, Refused, Unsupported
from .quantity import Amount, PositionUnit, Quantity, Signal, TorqueUnit, VelocityUnit

if TYPE_CHECKING:
    import can

    from . import aio as aio
    from . import events as events
    from . import lss as lss
    from . import paths as paths
    from ._adapters import SerialPort
    from .captures import Capture, decode
    from .columns import Arrays, Table, Tables
    from .events import Events, Happening, Subscription
    from .explained import Explained, Meaning, Part, explain
    from .paths import PathFinding, PathTable
    from .trace import StepResponse, Trace

__all__ = [
    "Amount",
    "Armed",
    "Arrays",
    "Axis",
    "Capture",
    "Codec",
    "DriveFault",
    "Event",
    "Events",
    "Explained",
    "Fault",
    "Found",
    "Group",
    "GroupMotion",
    "Happening",
    "Layout",
    "Link",
    "Losses",
    "Meaning",
    "Motion",
    "NoReply",
    "Parameter",
    "Parameters",
    "Part",
    "PathFinding",
    "PathTable",
    "PolepairError",
    "PositionUnit",
    "ProtocolError",
    "Quantity",
    "RawParameters",
    "Reading",
    "Refused",
    "Signal",
    "Simulation",
    "State",
    "StepResponse",
    "Subscription",
    "Table",
    "Tables",
    "TorqueUnit",
    "Trace",
    "Truth",
    "Unsupported",
    "VelocityUnit",
    "Watch",
    "__version__",
    "aio",
    "connect",
    "decode",
    "encode",
    "events",
    "explain",
    "lss",
    "paths",
    "profiles",
    "scan",
]


def connect(
    url: str | can.BusABC | SerialPort,
    *,
    protocol: str | None = None,
    axes: Iterable[int] = (),
    options: str = "",
    profile: str | PathLike[str] | None = None,
    trace: bool = False,
    token_file: str | PathLike[str] | None = None,
    certificate: str | PathLike[str] | None = None,
    client_cert: str | PathLike[str] | None = None,
    client_key: str | PathLike[str] | None = None,
) -> Link:
    """Opens a link: `connect("tmcl+serial:///dev/ttyUSB0:9600#1")`, `connect("canopen+socketcan://can0#2")`,
    `connect("sim:tmcl")`.

    The URL of a `polepair serve` uses its links: `ws://127.0.0.1:7365`, `wss://HOST:7365`. The token is
    the first of `token_file`, else `POLEPAIR_TOKEN`, else that of your own server on this machine.
    `certificate` is the file or SHA-256 of an encrypted server's certificate, default: that of your own
    server. `client_cert` and `client_key` are the client certificate.

    An open bus of python-can, or port of pyserial, can be given instead of a string. `protocol` and
    `axes` are then needed, and `options` has the keys (`timeout=50&profile=tmcm-171`).

    `profile` is a TOML file that describes a drive of your own. `trace` records the last frames for
    `Link.trace`. Errors: `PolepairError`, each with a note of what to try.
    """
    if isinstance(url, str):
        if protocol is not None or axes or options:
            raise TypeError("a connection string says protocol, axes and options itself")
        return Link(
            opened(url, profile, trace, token_file, certificate, client_cert, client_key)
        )
    if protocol is None:
        raise TypeError("an opened adapter does not say its protocol: name it, protocol='canopen'")
    from ._adapters import adapter

    taken, name, can_bus = adapter(url)
    return Link(
        _native.connect_over(taken, name, can_bus, protocol, list(axes), options, profile)
    )


def scan(
    url: str,
    first: int | None = None,
    last: int | None = None,
    *,
    profile: str | PathLike[str] | None = None,
    progress: Callable[[int, int, int], bool | None] | None = None,
) -> list[Found]:
    """Finds the drives on a link, by reads only. Nothing moves. `scan("tmcl+serial:///dev/ttyUSB0")`

    `first` and `last` limit the addresses. `progress(address, done, of)` is called before each address,
    and ends the scan by returning False; the drives found so far are returned.

    A scan of all addresses warns about a CANopen device without node-ID: `polepair.lss.LssMaster` finds
    it.
    """
    found, has_unconfigured = _native.scan(url, first, last, profile, progress)
    if has_unconfigured:
        import warnings

        text = "a CANopen device without node-ID answers: use polepair.lss.LssMaster to find it"
        warnings.warn(text, stacklevel=2)
    return [Found(*row) for row in found]


def encode(
    protocol: str,
    text: str,
    *,
    axis: int | None = None,
    host: int | None = None,
    via: str | None = None,
) -> bytes:
    """Converts a request from text to bytes. Sends nothing. For many requests, a `Codec` is faster.

    >>> import polepair
    >>> polepair.encode("tmcl", "ROR 0, 350", axis=1).hex(" ")
    '01 01 00 00 00 00 01 5e 61'
    """
    return _native.Codec(protocol, axis, host, via).encode(text)


def profiles() -> list[tuple[str, str, str]]:
    """All known products: name, full name, protocol."""
    return _native.profiles()


# Axes that are still armed by a daemon thread at the end of the interpreter.
atexit.register(_native.stop_armed)

if hasattr(os, "register_at_fork"):
    # A fork's child has none of the threads that serve its parent's links.
    os.register_at_fork(after_in_child=_native.forked)


# Modules that take long to import, and that few programs use.
_LATER = {
    "Arrays": "columns",
    "Capture": "captures",
    "Events": "events",
    "Explained": "explained",
    "Happening": "events",
    "Meaning": "explained",
    "Part": "explained",
    "PathFinding": "paths",
    "PathTable": "paths",
    "StepResponse": "trace",
    "Subscription": "events",
    "Table": "columns",
    "Tables": "columns",
    "Trace": "trace",
    "aio": "aio",
    "decode": "captures",
    "events": "events",
    "explain": "explained",
    "lss": "lss",
    "paths": "paths",
}


def __getattr__(name: str) -> object:
    module = _LATER.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    found = importlib.import_module(f".{module}", __name__)
    value: object = found if name == module else getattr(found, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


def _load_in_ipython() -> None:
    """Adds Tab completion of names to the IPython shell that imports this package, if one does."""
    shell = sys.modules.get("IPython")
    instance = None if shell is None else getattr(shell, "get_ipython", lambda: None)()
    if instance is not None:
        from ._ipython import load

        load(instance)


_load_in_ipython()
