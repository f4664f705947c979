"""Parameters, verbs, arming: what a program does with an axis."""

from __future__ import annotations

import asyncio
import math
import pickle

import polepair
import polepair.aio
import pytest

FAMILIES = [
    "sim:tmcl?time=virtual",
    "sim:tmcl+can?time=virtual",
    "sim:modbus-rtu?time=virtual",
    "sim:modbus-ascii?time=virtual",
    "sim:tml?time=virtual",
    "sim:tmlcan?time=virtual",
    "sim:technocan?time=virtual",
    "sim:canopen?time=virtual",
    "sim:cia402?time=virtual",
    "sim:thruster-servo?time=virtual&ends=none",
]


@pytest.mark.parametrize("url", FAMILIES)
def test_every_family_moves_by_the_same_program(url: str) -> None:
    with polepair.connect(url) as link:
        axis = link.axes[0]
        if "modbus" in url:
            axis.params["Fn_00"] = "internal position"
        with axis.armed():
            if "move-to" in axis.verbs:
                axis.move(45, "deg").wait()
                assert axis.read("position")["position"] == pytest.approx(math.radians(45), abs=0.05)
        if "modbus" in url:
            axis.params["Fn_00"] = "internal speed"
        with axis.armed():
            if "velocity" in axis.verbs:
                axis.spin(120, "rpm")
                link.sleep(2.0)
                assert axis.read("velocity")["velocity"] == pytest.approx(4 * math.pi, rel=0.1)
                assert link.simulation.truth().velocity == pytest.approx(4 * math.pi, rel=0.1)
        link.sleep(3.0)
        assert abs(link.simulation.truth().velocity) < 0.2


def test_a_deceleration_of_its_own_where_the_drive_has_one(axis: polepair.Axis) -> None:
    with polepair.connect("sim:modbus-rtu?fn00=14&time=virtual") as link:
        ts = link.axes[0]
        with ts.armed():
            ts.move_by(
                1, "turn", velocity="600 rpm", acceleration="2000 rpm/s", deceleration="6000 rpm/s"
            ).wait()
        assert ts.params["path 32 acceleration time"].raw == 300
        assert ts.params["path 32 deceleration time"].raw == 100
    with axis.armed(), pytest.raises(polepair.PolepairError):
        axis.move(1, "turn", deceleration="100 rpm/s")


def test_parameters_are_a_mapping_with_units(axis: polepair.Axis) -> None:
    axis.params["max current"] = 1.2
    current = axis.params["max current"]
    assert current == pytest.approx(1.2)
    assert (current.unit, current.raw, str(current)) == ("A", 12, "1.2 A")
    axis.params["max current"] = "800 mA"
    assert axis.params["max current"] == pytest.approx(0.8)
    axis.params["max current"] = (0.5, "A")
    assert axis.params.raw["max current"] == 5
    axis.params.raw["max current"] = 7
    assert axis.params["Max_Current"] == pytest.approx(0.7)
    assert "max current" in axis.params and "nonsense" not in axis.params
    assert len(list(axis.params)) == len(axis.params) > 100
    info = axis.params.info("max current")
    assert (info.symbol, info.unit, info.writable) == ("AP 6", "A", True)


def test_an_impossible_value_is_refused_before_a_byte_is_sent(axis: polepair.Axis) -> None:
    cases = [
        (lambda: axis.params.__setitem__("max current", 99), "E216"),
        (lambda: axis.params["max curent"], "E213"),
        (lambda: axis.params.__setitem__("max current", "5 V"), "E217"),
        (lambda: axis.spin(10), "E219"),
        (lambda: axis.raw("XYZ"), "E221"),
        (lambda: axis.read("fuel"), "E213"),
    ]
    for act, code in cases:
        with pytest.raises(polepair.Unsupported) as raised:
            act()
        assert (raised.value.code, raised.value.executed) == (code, False)
        assert raised.value.__notes__ or code == "E217"


def test_an_exception_stops_and_disables(link: polepair.Link, axis: polepair.Axis) -> None:
    with pytest.raises(ZeroDivisionError), axis.armed():
        axis.spin(100, "rpm")
        link.sleep(1.0)
        assert link.simulation.truth().enabled
        1 / 0  # noqa: B018
    link.sleep(2.0)
    truth = link.simulation.truth()
    assert not truth.enabled and abs(truth.velocity) < 0.1
    with pytest.raises(polepair.Unsupported):
        axis.spin(100, "rpm")


def test_the_watchdog_is_set_for_as_long_as_it_is_armed() -> None:
    with polepair.connect("sim:thruster?time=virtual") as link:
        axis = link.axes[0]
        with axis.armed(watchdog=0.5):
            axis.spin(500, "rpm")
            link.sleep(0.2)
            assert link.simulation.truth().velocity > 1
            # Nobody talks to it: not even this program.
            link.simulation.run(5.0)
            assert abs(link.simulation.truth().velocity) < 1


def test_a_heartbeat_is_watched_for_as_long_as_it_is_armed() -> None:
    with polepair.connect("sim:cia402:5?time=virtual&heartbeat=100") as link:
        axis = link.axes[0]
        (watched,) = [name for name in axis.params if "heartbeat" in name and "consumer" in name]
        before = axis.params.raw[watched]
        with axis.armed(watchdog=0.5):
            assert axis.params.raw[watched] & 0xFFFF == 500
        assert axis.params.raw[watched] == before
        with pytest.raises(polepair.Unsupported) as refused, axis.armed(watchdog=0.1):
            pass
        assert refused.value.code == "E216" and not axis._native.is_armed


def test_a_heartbeat_without_a_producer_guards_nothing() -> None:
    with polepair.connect("sim:cia402:5?time=virtual") as link:
        axis = link.axes[0]
        with pytest.raises(polepair.Unsupported) as refused, axis.armed(watchdog=0.5):
            pass
        assert "heartbeat=100" in "".join(refused.value.__notes__)
        assert not axis._native.is_armed


def ready(axis: polepair.Axis) -> None:
    """Makes the axis obey: a TS obeys Modbus only in control mode 1."""
    if "control mode" in axis.params:
        axis.params["control mode"] = 1


@pytest.mark.parametrize("drive", ["tmcl", "cia402:5", "thruster", "modbus-rtu", "technosoft-f514l"])
def test_it_moves_while_it_turns_and_has_no_power_behind_the_block(drive: str) -> None:
    with polepair.connect(f"sim:{drive}?time=virtual") as link:
        axis = link.axes[0]
        ready(axis)
        with axis.armed():
            axis.spin(10)
            link.sleep(1.0)
            if "moving" in axis.signals:
                assert axis.read("moving")["moving"] == 1
                assert axis.state().moving
            axis.read("enabled") if "enabled" in axis.signals else None
        assert not axis.state().enabled and not axis.state().moving
        if "moving" in axis.signals:
            assert axis.read("moving")["moving"] == 0


def test_a_fault_has_words() -> None:
    with polepair.connect("sim:thruster?time=virtual") as link:
        axis = link.axes[0]
        with axis.armed():
            link.simulation.act("jam")
            axis.spin(800, "rpm")
            link.sleep(3.0)
            found = axis.faults()
            assert found and found[0].cause and found[0].remedy
            assert "stall" in str(found[0])
            link.simulation.act("jam", 0)


def test_homing_finds_a_switch(link: polepair.Link, axis: polepair.Axis) -> None:
    link.simulation.act("home_switch", 3.0)
    with axis.armed():
        axis.home(timeout=120)
    # Zero is where the module saw the switch, and it looks at it while it turns.
    beyond = link.simulation.truth().position - axis.read("position")["position"] - 3.0
    assert 0 <= beyond < 0.5


def test_a_trace_judges_a_step(axis: polepair.Axis, link: polepair.Link) -> None:
    with axis.armed():
        axis.spin(100, "rpm")
        trace = axis.capture(["velocity"], rate=200, seconds=1.0)
    assert len(trace) > 10
    step = trace.step("velocity", target=100 * math.tau / 60)
    assert 0 < step.rise < 1 and step.final == pytest.approx(100 * math.tau / 60, rel=0.1)


def test_errors_and_quantities_survive_pickling() -> None:
    error = polepair.NoReply("nobody answered", "E401", None, "check the cable")
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), copy.code, copy.hint) == (
        polepair.NoReply, "nobody answered", "E401", "check the cable",
    )
    value = pickle.loads(pickle.dumps(polepair.Quantity(1.5, "A", raw=15)))
    assert (value, value.unit, value.raw) == (1.5, "A", 15)


def test_a_closed_link_says_so(link: polepair.Link) -> None:
    link.close()
    with pytest.raises(ValueError, match="closed"):
        link.axis(1)


def test_a_scan_finds_drives() -> None:
    asked: list[int] = []

    def progress(address: int, done: int, of: int) -> bool:
        asked.append(address)
        return True

    found = polepair.scan("sim:tmcl:3,7?time=virtual", 1, 10, progress=progress)
    assert [(drive.number, drive.product) for drive in found] == [(3, "tmcm-171"), (7, "tmcm-171")]
    assert asked == list(range(1, 11))


def test_bytes_are_sent_as_they_are(axis: polepair.Axis) -> None:
    said = polepair.encode("tmcl", "GAP 6, 0", axis=1)
    assert axis.raw(said) == axis.raw("GAP 6, 0")
    with pytest.raises(polepair.Unsupported, match="for axis 2"):
        axis.raw(polepair.encode("tmcl", "GAP 6, 0", axis=2))


def test_the_end_of_a_block_closes_the_link_though_an_axis_is_held() -> None:
    with polepair.connect("sim:tmcl?time=virtual") as link:
        axis = link.axes[0]
        assert axis.params["max current"].unit == "A"
    with pytest.raises(polepair.PolepairError) as raised:
        axis.params["max current"]
    assert raised.value.code == "E322"


def test_text_for_a_motion_needs_a_unit(axis: polepair.Axis) -> None:
    with axis.armed(), pytest.raises(polepair.Unsupported) as raised:
        axis.move("4096")
    assert raised.value.code == "E217"


def test_text_behind_the_makers_symbol_is_the_drives_own_number(axis: polepair.Axis) -> None:
    axis.params["AP 6"] = "12"
    assert axis.params["max current"] == pytest.approx(1.2) and axis.params.raw["AP 6"] == 12
    axis.params["max current"] = "12"
    assert axis.params["AP 6"] == 12
    axis.params["AP 6"] = axis.params["AP 6"]  # what was read has its unit
    axis.params["AP 6"] = 1.5, "A"
    assert axis.params.raw["max current"] == 15
    for ambiguous in (12, 1.2):
        with pytest.raises(polepair.Unsupported, match="own number, or 1") as raised:
            axis.params["AP 6"] = ambiguous
        assert raised.value.code == "E217"
    assert axis.params.raw["AP 6"] == 15


def test_parameters_have_addresses() -> None:
    with polepair.connect("sim:canopen?time=virtual") as link:
        axis = link.axes[0]
        assert axis.params["0x1018:1"] == 65535
        assert axis.read("position", "6041h:u16").keys() == {"position", "6041h:u16"}
        assert axis.read_text("1008h") == "Polepair CiA 402 drive"
        with pytest.raises(polepair.PolepairError, match="text, bytes or not known"):
            axis.params["1008h"]
        with pytest.raises(polepair.Unsupported, match="not armed"):
            axis.params["0x2F01:1:u32"] = 9
        with pytest.raises(polepair.PolepairError, match="expected a sub-index"):
            axis.params["0x2F01:300"]
        with axis.armed():
            axis.params["0x2F01:1:u32"] = 9
            assert len(axis.read_bytes("0x2F01:2")) == 9
            axis.write_bytes("0x2F01:2", bytes(range(200)))
        with pytest.raises(polepair.PolepairError, match="at `x`"):
            axis.raw("read x")
    with polepair.connect("sim:tmcl?time=virtual") as link:
        axis = link.axes[0]
        assert axis.params.raw["AP 6:u32"] == axis.params.raw["max current"]
        axis.params.raw["GP 0.2"] = -7
        assert axis.params.raw["GP 0.2"] == -7


def test_parameters_have_addresses_in_tasks() -> None:
    async def program() -> None:
        async with await polepair.aio.connect("sim:canopen?time=virtual") as link:
            axis = link.axes[0]
            assert await axis.params.get("0x1018:1") == 65535
            assert await axis.read_text("1008h") == "Polepair CiA 402 drive"
            async with axis.armed():
                await axis.write_bytes("0x2F01:2", bytes(300))
                await axis.params.set("0x2F01:1:u32", 12)
            assert len(await axis.read_bytes("0x2F01:2")) == 12

    asyncio.run(program())


def test_each_motor_of_a_module_is_an_axis() -> None:
    with polepair.connect("sim:tmcm-6110?time=virtual") as link:
        axis = link["1.3"]
        assert axis.product == "tmcm-6110"
        with axis.armed():
            axis.move(0.5, "turn").wait()
        assert axis.read("position")["position"] == pytest.approx(math.pi, abs=0.01)
        simulation = link.simulation
        assert simulation is not None
        assert simulation.truth(motor=3).position == pytest.approx(math.pi, abs=0.05)
        assert simulation.truth(motor=2).position == 0
        simulation.act("jam", motor=3)
        with pytest.raises(polepair.PolepairError, match="no motor 6"):
            simulation.truth(motor=6)


def test_a_drive_records_in_its_own_loop() -> None:
    with polepair.connect("sim:tmlcan?time=virtual") as link, link.axes[0].armed() as axis:
        trace = axis.record_in_drive(
            ["actual position", "POSERR", "@0x0230:i16"],
            seconds=0.2,
            inferred=True,
            start=lambda: axis.move(0.1, "turn"),
        )
        names = ["actual position", "position error", "motor current"]
        assert len(trace) == 200 and list(trace.columns)[:2] == names[:2]
        assert trace.units["actual position"] == "rad"
        assert trace["actual position"][-1] == pytest.approx(0.1 * 2 * math.pi, abs=0.02)
        assert trace.times[1] == pytest.approx(0.001)
        with pytest.raises(ZeroDivisionError):
            axis.record_in_drive(["APOS"], inferred=True, start=lambda: 1 / 0)
        late = axis.record_in_drive(["APOS"], seconds=0.01, on="APOS > 0.05turn", inferred=True)
        assert len(late) == 10
        for wrong in ({"rate": 0}, {"seconds": 60.0}, {"buffer": (0x8271, 0x8300)}):
            with pytest.raises(polepair.Unsupported) as refused:
                axis.record_in_drive(["APOS"], inferred=True, **wrong)  # type: ignore[arg-type]
            assert refused.value.code == "E216"
        with pytest.raises(polepair.Unsupported, match="inferred"):
            axis.record_in_drive(["APOS"])


def test_an_axis_follows_another_one() -> None:
    with polepair.connect("sim:tmlcan:1,2?time=virtual") as link:
        master, follower = link.axes
        with master.armed(), follower.armed():
            follower.couple(master, (-1, 2))
            master.move(1, "turn").wait()
            link.sleep(0.3)
            assert follower.params["actual position"] == pytest.approx(-0.5, abs=0.01)
            follower.uncouple(master)
            table = [(0.0, 0.0), (2 * math.pi, 0.0), (4 * math.pi, math.pi)]
            with pytest.raises(polepair.Unsupported, match="inferred"):
                follower.couple(master, cam=table)
            follower.couple(master, cam=table, inferred=True)
            master.move(2, "turn").wait()
            link.sleep(0.3)
            assert follower.params["actual position"] == pytest.approx(0.0, abs=0.01)
            with pytest.raises(polepair.Unsupported, match="follow itself"):
                master.couple(master, (1, 1))
            with pytest.raises(TypeError):
                follower.couple(master)
            follower.uncouple(master)
