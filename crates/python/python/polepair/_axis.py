"""Methods of an axis, shared by threads and event loops."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeAlias

from . import _polepair as native
from ._records import Fault, Reading, State
from ._steps import Call, Steps, Urgent, Wait, Whole
from .errors import NoReply, PolepairError, Unsupported
from .quantity import Amount, Quantity, Signal, TorqueUnit, VelocityUnit, given

if TYPE_CHECKING:
    from .trace import StepResponse, Trace

TIMEOUT = 60.0
"""Default time limit of a move or a homing, in seconds."""


LOOK = 0.05
"""Seconds between two checks whether the move of another client has arrived."""

NEAR = {"rad": 0.0088, "m": 5e-5}
"""Greatest distance from the target at which the move of another client has arrived, by the unit of the
position: 0.5 deg, 0.05 mm."""

STOPS = ("stop", "quick-stop")
"""Verbs that wait for no other request."""

ANSWER = 0.05
"""Time limit of a server for the reply whether a move has arrived, in seconds."""

Asked: TypeAlias = list[native.Request]
"""An open request whether a move has arrived."""

Settings: TypeAlias = list[tuple[str, int]]
"""Parameters and their earlier raw values."""

ELSEWHERE = "what is open belongs to this process; pass the connection string, and connect there"
"""The error text for pickling an open object."""

STEPS = {
    "velocity": ("velocity", "velocity"),
    "position": ("move-to", "target"),
    "torque": ("torque", "torque"),
}
"""Signals of a step response, each with its verb and argument."""


class AxisSteps:
    """Base of `Axis` and `aio.Axis`: the verbs as steps."""

    __slots__ = ("_native",)

    def __init__(self, axis: native.Axis) -> None:
        self._native = axis

    @property
    def number(self) -> int:
        """The address on the wire."""
        return self._native.number

    @property
    def name(self) -> str:
        """The name in the rack file, or empty."""
        return self._native.name

    @property
    def label(self) -> str:
        """The label in messages."""
        return self._native.label

    @property
    def protocol(self) -> str:
        """Name of the protocol in connection strings."""
        return self._native.protocol

    @property
    def product(self) -> str:
        """Name of the product in profiles."""
        return self._native.product[0]

    @property
    def title(self) -> str:
        """The product's full name."""
        return self._native.product[1]

    @property
    def caution(self) -> str:
        """Checks to make before the first motion."""
        return self._native.caution

    @property
    def signals(self) -> dict[str, str]:
        """The signals, each with the unit of the drive's parameter; on a server in SI."""
        return dict(self._native.signals())

    @property
    def verbs(self) -> list[str]:
        """The supported verbs."""
        return self._native.verbs()

    def __repr__(self) -> str:
        return f"<Axis {self.label}: {self.title}>"

    def _repr_html_(self) -> str:
        from ._html import table

        rows = [
            ("product", self.title),
            ("protocol", self.protocol),
            ("armed", "yes" if self._native.is_armed else "no"),
            ("signals", ", ".join(self.signals)),
            ("verbs", ", ".join(self.verbs)),
            ("caution", self.caution),
        ]
        return table(["", self.label], rows)

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError(f"an axis cannot be pickled: {ELSEWHERE}")

    def _run(self, verb: str, **arguments: float | str | None) -> Steps[None]:
        started = yield from self._begin(verb, **arguments)
        yield Wait(started)

    def _begin(
        self, verb: str, **arguments: float | str | None
    ) -> Steps[native.Request]:
        order = (
            "target",
            "velocity",
            "acceleration",
            "torque",
            "jerk_time",
            "deceleration",
        )
        values = [arguments.get(name) for name in order]
        call = Urgent if verb in STOPS else Call
        return (yield call(self._native.start, verb, *values))  # type: ignore[no-any-return]

    def _begin_own(
        self, verb: str
    ) -> Steps[native.Request | None]:
        """Starts `stop` or `disable` of axes armed here; None if there are none."""
        return (yield Urgent(self._native.start_own, verb))  # type: ignore[no-any-return]

    def _enable(self) -> Steps[None]:
        """Powers the motor. It holds its actual position. The axis must be armed."""
        return self._run("enable")

    def _disable(self) -> Steps[None]:
        """Removes power from the motor."""
        return self._run("disable")

    def _stop(self) -> Steps[None]:
        """Stops the motor along its ramp. A stop has priority over all other requests.

        It ends the drive's program (TMCL, TML), which could move the motor again.
        """
        return self._run("stop")

    def _quick_stop(self) -> Steps[None]:
        """Stops the motor with the drive's fastest deceleration."""
        return self._run("quick-stop")

    def _clear(self) -> Steps[None]:
        """Clears faults."""
        return self._run("clear")

    def _spin(
        self,
        speed: Amount,
        unit: VelocityUnit | None = None,
        *,
        acceleration: Amount | None = None,
        deceleration: Amount | None = None,
    ) -> Steps[None]:
        """rad/s (m/s) or with a unit: turns at a constant speed.

        `axis.spin(60, "rpm")`, `axis.spin("60 rpm", acceleration="600 rpm/s")`
        """
        return self._run(
            "velocity",
            velocity=given(speed, unit),
            acceleration=given(acceleration),
            deceleration=given(deceleration),
        )

    def _press(self, torque: Amount, unit: TorqueUnit | None = None) -> Steps[None]:
        """N·m or with a unit: turns with a constant torque.

        `axis.torque(0.2)`, `axis.torque(200, "mNm")`
        """
        return self._run("torque", torque=given(torque, unit))

    def _set_out(
        self,
        verb: str,
        target: Amount,
        unit: str | None,
        velocity: Amount | None,
        acceleration: Amount | None,
        deceleration: Amount | None,
    ) -> Steps[None]:
        return self._run(
            verb,
            target=given(target, unit),
            velocity=given(velocity),
            acceleration=given(acceleration),
            deceleration=given(deceleration),
        )

    def _home(self, *, velocity: Amount | None = None, timeout: float = TIMEOUT) -> Steps[None]:
        """Searches the reference position, and waits for it, at most `timeout` seconds.

        `axis.home()`, `axis.home(velocity="30 rpm", timeout=120)`
        """
        started = yield from self._begin("home", velocity=given(velocity))
        if (yield Wait(started, timeout)) is None:
            what = f"{self.label}: homing did not end within {timeout:g} s"
            raise PolepairError(what, "E101", False, "it goes on until a stop; look at the switch")

    def _reached(self, timeout: float = TIMEOUT) -> Steps[bool]:
        """Waits until the last move has arrived, at most `timeout` seconds; False if it has not.

        `axis.reached(5.0)`

        Errors: E106 with both positions if it ended elsewhere. On a server, an axis that this program has not
        armed has arrived when the drive reports it and its position is at the target that the drive reports; a
        drive that reports no target is believed."""
        return (yield from self._arrived([], timeout))

    def _arrived(self, asked: Asked, timeout: float) -> Steps[bool]:
        """The same. An open request is awaited again instead of being repeated."""
        # Other threads may ask as well.
        going = next(iter(asked), None)
        if going is None:
            try:
                going = yield from self._begin("reached")
            except Unsupported as error:
                # On a server only the client that armed an axis commands it; others watch.
                if error.code != "E219" or "reached" not in self.signals:
                    raise
                return (yield from self._looked(timeout))
            asked[:] = [going]
        try:
            if (yield Wait(going, timeout)) is None:
                return False
            asked.clear()
        except PolepairError as error:
            asked.clear()
            if isinstance(error, NoReply):
                # The question was not answered, but the move it asks after had been sent.
                error.executed = None
            elif error.code == "E101":
                return False
            raise
        return True

    def _looked(self, timeout: float) -> Steps[bool]:
        began = self._native.now
        units = self.signals
        window = NEAR.get(units.get("position", ""), 0.0)
        compared = ("position", "target position")
        shown = [name for name in compared if name in units and window > 0.0]
        while True:
            seen = yield from self._read("reached", *shown)
            away = abs(seen["position"] - seen["target position"]) if len(shown) == 2 else 0.0
            if seen["reached"] and away <= window:
                return True
            left = timeout - (self._native.now - began)
            if left <= 0.0:
                return False
            yield Call(self._native.sleep, min(LOOK, left))

    def _done(self, asked: Asked) -> Steps[bool]:
        """True if the axis has arrived."""
        return self._arrived(asked, ANSWER if self._native.is_remote else 0.0)

    def _arrive(self, timeout: float = TIMEOUT, asked: Asked | None = None) -> Steps[None]:
        """Waits until the last move has arrived. Errors: `PolepairError` E101 after the time limit."""
        if not (yield from self._arrived([] if asked is None else asked, timeout)):
            what = f"{self.label}: the move has not arrived within {timeout:g} s"
            hint = "look for a limit, a fault or a load; the axis goes on until it is stopped"
            raise PolepairError(what, "E101", False, hint)

    def _read(self, *signals: Signal | str) -> Steps[dict[str, float]]:
        """Reads signals now, in SI: rad (m), rad/s, N·m, A, V; temperatures in degC.

        Any other name is a parameter, or an address such as `0x2030:1:u16`, in the parameter's unit.

        `axis.read("position", "velocity")` returns `{"position": 1.57, "velocity": 0.0}`.
        """
        named = [name for name in signals if native.is_signal(name)]
        values: dict[str, float] = {}
        if named:
            values.update(zip(named, (yield Call(self._native.read_signals, named)), strict=True))
        for name in signals:
            if name not in values:
                values[name] = yield from self._read_parameter(name)
        return {name: values[name] for name in signals}

    def _read_parameter(self, name: str) -> Steps[float]:
        try:
            yield from self._find(name)
        except Unsupported as none:
            known = ", ".join(signal for signal, _ in self._native.signals())
            hint = f"signals are {known}; {none.hint}"
            raise Unsupported(str(none), none.code, none.executed, hint) from None
        return float((yield from self._get(name)))

    def _capture(
        self, signals: Sequence[Signal | str], *, rate: float = 100.0, seconds: float = 1.0
    ) -> Steps[Trace]:
        """Reads signals `rate` times a second for `seconds`, and returns the trace.

        A slower drive gives fewer samples, each with its own time.

        `axis.capture(["position", "velocity"], rate=200, seconds=2).plot()`
        """
        return self._sampled(signals, rate, self._native.now, seconds)

    def _record_in_drive(
        self,
        variables: Sequence[Signal | str],
        *,
        rate: float = 1000.0,
        seconds: float = 0.2,
        on: str | None = None,
        buffer: tuple[int, int] | None = None,
        inferred: bool = False,
        start: Callable[[], object] | None = None,
    ) -> Steps[Trace]:
        """Records variables in the drive's own control loop, all at one instant, and returns the trace in SI.

        TML drives have such a recorder; their memory limits the points. `on` is a condition of the start, such
        as "APOS > 1turn". `start` is a plain function, called when the recording runs or waits for `on`: it may start
        a motion. `buffer` is memory of the drive that nothing else uses, first and last address. The layout of the
        buffer is inferred, and `inferred=True` accepts that. Errors: `Unsupported` for another drive; E216 for what
        does not fit.

        `axis.record_in_drive(["APOS", "IQ"], rate=1000, seconds=0.3, inferred=True).plot()`
        """
        request = {
            "variables": list(variables),
            "rate": rate,
            "seconds": seconds,
            "on": on,
            "buffer": buffer,
            "inferred": inferred,
        }
        interval, recorded = yield Whole(self._native.record_in_drive, request, start)
        from .trace import Trace

        count = len(recorded[0][2]) if recorded else 0
        times = [point * interval for point in range(count)]
        columns = {name: values for name, _, values in recorded}
        return Trace(self.label, times, columns, {name: unit for name, unit, _ in recorded if unit})

    def _couple(
        self,
        master: AxisSteps,
        ratio: tuple[int, int] | None = None,
        *,
        cam: Sequence[tuple[float, float]] | None = None,
        buffer: tuple[int, int] | None = None,
        inferred: bool = False,
    ) -> Steps[None]:
        """Lets the axis follow another one of its bus, in the drives, until it is stopped or uncoupled.

        `ratio` is turns of this axis to turns of the master; `(-1, 3)` turns the other way. `cam` is a table of
        positions in rad, `(master, follower)`, ascending; its layout in the drive is inferred, and `inferred=True`
        accepts that. `buffer` is memory of the drive that nothing else uses. The axis must be armed and powered, the
        master at rest. Errors: `Unsupported` for drives that cannot; E217 and E245 for what does not fit; E101 if
        the drive does not receive the master's position.

        `axis.couple(master, (1, 3))`
        """
        if (ratio is None) == (cam is None):
            raise TypeError("a coupling has either a ratio or a cam")
        if ratio is not None:
            yield Whole(native.follow_gear, self._native, master._native, *ratio)
        else:
            table = {"points": list(cam or ()), "buffer": buffer, "inferred": inferred}
            yield Whole(native.follow_cam, self._native, master._native, table)

    def _uncouple(self, master: AxisSteps) -> Steps[None]:
        """Ends a coupling: stops this axis, and the messages of the master, which must be at rest.

        `axis.uncouple(master)`
        """
        yield Whole(native.uncouple, self._native, master._native)

    def _sampled(
        self, signals: Sequence[str], rate: float, began: float, seconds: float
    ) -> Steps[Trace]:
        times: list[float] = []
        columns: dict[str, list[float]] = {signal: [] for signal in signals}
        while (asked := self._native.now) - began < seconds:
            row = yield from self._read(*signals)
            answered = self._native.now
            # The drive looked somewhere between question and answer.
            times.append((asked + answered) / 2 - began)
            for signal, value in row.items():
                columns[signal].append(value)
            yield Call(self._native.sleep, max(0.0, 1.0 / rate - (answered - asked)))
        from .trace import Trace

        units = dict(zip(signals, self._native.signal_units(list(signals)), strict=True))
        return Trace(self.label, times, columns, units)

    def _step(
        self,
        signal: str,
        target: Amount,
        unit: str | None = None,
        *,
        rate: float = 200.0,
        seconds: float = 1.0,
        band: float = 0.02,
    ) -> Steps[StepResponse]:
        """Commands a step of `velocity`, `position` or `torque`, and evaluates the response.

        The axis must be armed, and keeps the new set-point. It is read `rate` times a second for
        `seconds`. `band` is the tolerance of settling, as a share of the step. Errors: `Unsupported`
        E213 for another signal; ValueError if it did not move.

        `axis.step("velocity", 60, "rpm").rise_time`
        """
        if signal not in STEPS:
            what = f"a step is of {', '.join(STEPS)}, not of `{signal}`"
            raise Unsupported(what, "E213", False, "capture() reads any signal")
        verb, argument = STEPS[signal]
        wanted = given(target, unit)
        goal = self._native.in_si(verb, argument, wanted)  # type: ignore[arg-type]
        before = yield from self._read(signal)
        yield from self._run(verb, **{argument: wanted})
        began = self._native.now
        trace = yield from self._sampled([signal], rate, began, seconds)
        times, values = [0.0, *trace.times], [before[signal], *trace[signal]]
        from .trace import Trace

        whole = Trace(trace.axis, times, {signal: values}, trace.units)
        return whole.step(signal, goal, band=band)

    def _faults(self) -> Steps[list[Fault]]:
        """Active faults and warnings."""
        rows = yield Call(self._native.faults)
        return [Fault(*row) for row in rows]

    def _state(self) -> Steps[State]:
        """The known state, without a request to the drive. Every value has its age."""
        mode, enabled, armed, moving, rows, owner = yield Call(self._native.state)
        readings = {name: Reading(value, age) for name, value, age in rows}
        return State(mode, enabled, armed, moving, readings, owner)

    def _raw(self, said: str | bytes, id: int | None = None) -> Steps[int]:
        """Sends a request as text or bytes of the protocol, and returns the value of the reply."""
        return (yield Wait(self._native.start_raw(said, id)))  # type: ignore[no-any-return]

    def _find(self, name: str) -> Steps[int]:
        # A server is asked for its parameters once.
        if self._native.is_known:
            return self._native.find(name)
        return (yield Call(self._native.find, name))  # type: ignore[no-any-return]

    def _get(self, name: str) -> Steps[Quantity]:
        """Reads a parameter by name, in its unit."""
        at = yield from self._find(name)
        read = yield Wait(self._native.start_read(at))
        value, unit, word, text = yield Call(self._native.value, at, read)
        return Quantity(value, unit, raw=int(read), word=word, text=text)

    def _get_raw(self, name: str) -> Steps[int]:
        """Reads a parameter by name, as raw number."""
        at = yield from self._find(name)
        return int((yield Wait(self._native.start_read(at))))

    def _set(self, name: str, amount: Amount, *, keep: bool = False) -> Steps[None]:
        """Writes a parameter by name: a number in its unit, `"1200 mA"`, or a value name.

        Behind the maker's symbol (`"AP 6"`, `"CSPD"`, `"0x6083"`) text without a unit is the drive's own number.
        There a number is refused where it could be meant in either way (`Unsupported` E217).
        The limits are checked before a byte is sent. Permanent memory is written only with `keep`.
        """
        at = yield from self._find(name)
        raw = yield Call(self._native.raw_of, name, at, given(amount))
        yield Wait(self._native.start_write(at, raw, keep))

    def _read_bytes(self, name: str) -> Steps[bytes]:
        """Reads a parameter that holds bytes, such as a domain of CANopen, by name or address.

        `axis.read_bytes("0x1F50:1")`
        """
        at = yield from self._find(name)
        return bytes((yield Call(self._native.read_data, at)))

    def _read_text(self, name: str) -> Steps[str]:
        """Reads a parameter that holds text, such as `1008h` of CANopen, by name or address.

        `axis.read_text("0x1008")`
        """
        return (yield from self._read_bytes(name)).decode("utf-8", "replace")

    def _write_bytes(self, name: str, data: bytes) -> Steps[None]:
        """Writes all bytes of a parameter by name or address, by block transfer if the drive supports it.

        It is not repeated after a lost reply, because the drive may have stored a part.

        `axis.write_bytes("0x1F50:1", firmware)`
        """
        at = yield from self._find(name)
        yield Whole(self._native.write_data, at, data)

    def _set_raw(self, name: str, raw: int, *, keep: bool = False) -> Steps[None]:
        """Writes a parameter by name, as raw number."""
        at = yield from self._find(name)
        yield Wait(self._native.start_write(at, raw, keep))

    def _arm(self, watchdog: float | None) -> Steps[Settings]:
        """Arms and enables the axis. Returns the earlier watchdog setting, if it can be read.

        A watchdog that cannot be read keeps the new setting.
        """
        try:
            yield Whole(self._native.arm, True)
        except PolepairError:
            # Without an arming of its own there is nothing to undo, and an earlier arming stays.
            raise
        except BaseException:
            yield from self._disarm()
            raise
        try:
            before = yield from self._guard(watchdog)
            if "enable" in self.verbs:
                yield from self._enable_or_disable()
        except BaseException:
            yield from self._disarm()
            raise
        return before

    def _enable_or_disable(self) -> Steps[None]:
        """Enables the axis. Removes the power again if this is interrupted, such as by a cancelled task."""
        try:
            yield from self._enable()
        except PolepairError as error:
            # A group that no drive may answer for would otherwise never be armed.
            if error.code != "E901":
                yield from self._power_off()
                raise
            warnings.warn(str(error), RuntimeWarning, stacklevel=2)
        except BaseException:
            yield from self._power_off()
            raise

    def _power_off(self) -> Steps[None]:
        if "disable" in self.verbs:
            # The earlier error is the one that the caller needs.
            with suppress(PolepairError):
                begun = yield from self._begin_own("disable")
                if begun is not None:
                    yield Wait(begun)

    def _disarm(self) -> Steps[None]:
        # The earlier error is the one that the caller needs.
        with suppress(PolepairError):
            yield Whole(self._native.arm, False)

    def _guard(self, seconds: float | None) -> Steps[Settings]:
        if seconds is None:
            return []
        kind, fixed, parameter = self._native.watchdog
        if kind == "fixed" and fixed is not None and fixed <= seconds:
            return []
        if parameter is None:
            what = f"{self.label} has no watchdog that stops it within {seconds:g} s"
            hint = "leave watchdog out, and have something else that stops the motor"
            if kind == "heartbeat":
                hint = f"add heartbeat=100 to the connection: its drive watches a heartbeat; or {hint}"
            raise Unsupported(what, "E218", False, hint)
        return (yield Whole(self._native.set_watchdog, seconds))  # type: ignore[no-any-return]

    def _stop_own(self) -> Steps[bool]:
        """Stops axes armed here. Returns False if another client has the lease now.

        On a local link, a lost stop is repeated for ten seconds. A server repeats its stops itself.
        """
        if not self._native.is_remote:
            yield Urgent(native.stop_axes, [self._native])
            return True
        begun = yield from self._begin_own("stop")
        if begun is not None:
            yield Wait(begun)
        return begun is not None

    def _release(self, before: Settings, *, stop: bool = True) -> Steps[None]:
        """Stops, disables and disarms. Every step is tried, even after an error. Without `stop`, the stop
        was already sent.

        An axis whose lease another client has was stopped by the take-over, and may move again.
        """
        try:
            failed = yield from self._ended(before, stop)
        except BaseException:
            yield from self._disarm()
            raise
        try:
            yield Whole(self._native.arm, False)
        except PolepairError as error:
            failed = failed or error
        if failed is not None:
            raise failed

    def _ended(self, before: Settings, stop: bool) -> Steps[PolepairError | None]:
        failed: PolepairError | None = None
        interrupt: KeyboardInterrupt | None = None
        try:
            if stop and "stop" in self.verbs and not (yield from self._stop_own()):
                # Another caller has taken it.
                return None
        except PolepairError as error:
            failed = error
        except KeyboardInterrupt as error:
            # The stop went to its end, or was not waited for: its power is taken all the same.
            interrupt = error
        try:
            if "disable" in self.verbs:
                begun = yield from self._begin_own("disable")
                if begun is None and interrupt is None:
                    return failed
                if begun is not None:
                    yield Wait(begun)
        except PolepairError as error:
            failed = failed or error
        if interrupt is not None:
            raise interrupt
        if failed is not None:
            return failed
        # So that `state()` has values from after the block.
        told = [name for name in ("enabled", "moving") if name in self.signals]
        try:
            for name, raw in before:
                yield from self._set_raw(name, raw)
            # The drives of a group may not be asked.
            with suppress(Unsupported):
                yield from self._read(*told)
        except PolepairError as error:
            return error
        return None
