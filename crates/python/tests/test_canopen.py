"""CANopen beyond one axis with a node-ID: LSS, second axes."""

from pathlib import Path

import polepair
import pytest
from polepair.lss import LssIdentity, LssMaster

BUS = "sim:canopen?axes=2&time=virtual"


def test_a_device_gets_another_node_id() -> None:
    with LssMaster(BUS) as lss:
        identity = lss.identity_of(2)
        assert identity == LssIdentity(0xFFFF, 0x402, 0x10000, 2)
        assert not lss.has_unconfigured()
        assert lss.find_unconfigured() is None
        with pytest.raises(polepair.Unsupported, match="several devices") as several:
            lss.select_only_device()
        assert several.value.code == "E220"
        assert not lss.select((1, 2, 3, 4))
        assert lss.select(identity)
        assert lss.node_id() == 2
        lss.set_node_id(None)
        lss.set_bit_rate(250_000)
        with pytest.raises(polepair.Unsupported, match="123456 bit/s"):
            lss.set_bit_rate(123_456)
        lss.store()
        lss.leave_configuration()
        lss.restart_communication(2)
        assert not lss.node_answers(2)
        assert lss.has_unconfigured()
        assert lss.find_unconfigured() == identity == lss.selected_identity()
        lss.set_node_id(9)
        lss.leave_configuration()
        assert lss.node_answers(9)
        with pytest.raises(polepair.Unsupported, match="200 is no node-ID"):
            lss.node_answers(200)
        with pytest.raises(polepair.NoReply):
            lss.identity_of(2)
    with pytest.raises(ValueError, match="closed"):
        lss.node_answers(9)
    with pytest.raises(polepair.Unsupported) as other:
        LssMaster("sim:tmcl")
    assert other.value.code == "E242"


def test_the_only_device_is_selected_without_its_identity() -> None:
    with LssMaster("sim:canopen:7?time=virtual") as lss:
        assert lss.select_only_device().serial == 7


def test_a_scan_warns_of_a_device_without_node_id(tmp_path: Path) -> None:
    rack = tmp_path / "rack.toml"
    drive = '[[link.drive]]\nprofile = "canopen"\naddress = {}\noptions = {{ {} }}\n'
    rack.write_text("[[link]]\n" + drive.format(3, "") + drive.format(4, 'node = "none"'))
    with pytest.warns(UserWarning, match="without node-ID"):
        found = polepair.scan(f"sim:{rack}?time=virtual")
    assert [drive.number for drive in found] == [3]


def test_a_second_axis_turns_alone(tmp_path: Path) -> None:
    sheet = tmp_path / "two.eds"
    text = "[1000]\nParameterName=device type\nDataType=7\nAccessType=ro\nDefaultValue=0x20192\n"
    # Controlword, statusword, modes, positions, speeds and ramps of CiA 402.
    objects = {0x40: (6, "rw"), 0x41: (6, "ro"), 0x60: (2, "rw"), 0x61: (2, "ro"), 0x64: (4, "ro"),
               0x6C: (4, "ro"), 0x7A: (4, "rw"), 0x81: (7, "rw"), 0x83: (7, "rw"), 0x84: (7, "rw"),
               0xFF: (4, "rw")}
    for base in (0x6000, 0x6800):
        for index, (kind, access) in objects.items():
            text += (f"[{base + index:X}]\nParameterName=o{base + index:X}\nObjectType=7\n"
                     f"DataType={kind}\nAccessType={access}\n")
        text += f"[{base + 0x8F:X}]\nParameterName=turn\nObjectType=9\nSubNumber=3\n"
        for sub, value in ((1, 10_000), (2, 1)):
            text += (f"[{base + 0x8F:X}sub{sub}]\nParameterName=s{sub}\nObjectType=7\n"
                     f"DataType=7\nAccessType=rw\nDefaultValue={value}\n")
    sheet.write_text(text)
    with polepair.connect(f"sim:canopen:5?eds={sheet}&time=virtual#5,5.2") as link:
        assert [axis.label for axis in link.axes] == ["axis 5", "axis 5.2"]
        second = link["5.2"]
        assert second.read("0x6041")["0x6041"] == link[5].read("0x6841")["0x6841"]
        with second.armed():
            second.enable()
            second.spin(50, "rpm")
            link.simulation.run(1.0)
            first_speed, second_speed = (axis.read("velocity")["velocity"] for axis in link.axes)
            second.stop()
        assert abs(first_speed) < 0.1
        assert second_speed == pytest.approx(5.236, rel=0.05)
