"""CiA 402 drives as they are in the field: units of their own, faults without a message, odd homing."""

import json
import time

import pytest

from conftest import polepair

NANOTEC = {(0x6091, 1): 1, (0x6091, 2): 1, (0x6092, 1): 1, (0x6092, 2): 1}


def last(drive, index):
    return [value for written, value in drive.writes if written == index][-1]


# Objects with a drive's units, units a turn, units of 1 rpm.
UNITS = [
    ({(0x60A8, 0): 0xFF410000, (0x60A9, 0): 0x00B44700, (0x608F, 1): 2000} | NANOTEC, 3600, 1),
    ({(0x60A8, 0): 0xFDB40000, (0x60A9, 0): 0xFEB40300}, 1000, 100 / 60),
    ({(0x60A9, 0): 0xFDB44700}, 10_000, 1000),
    ({(0x6092, 1): 720, (0x6092, 2): 2, (0x6091, 1): 5, (0x6091, 2): 1}, 360, 6),
    ({(0x6091, 1): 3, (0x6091, 2): 1}, 30_000, 500),
    ({(0x6096, 1): 60, (0x6096, 2): 10_000}, 10_000, 1),
    ({(0x6094, 1): 10_000, (0x6094, 2): 60}, 10_000, 1),
    ({(0x6093, 1): 10_000, (0x6093, 2): 512}, 512, 512 / 60),
]


@pytest.mark.parametrize(("objects", "per_turn", "per_rpm"), UNITS)
def test_a_turn_and_a_speed_are_what_the_drive_counts(odd, objects, per_turn, per_rpm):
    drive = odd(per_turn=per_turn, per_rpm=per_rpm, objects={(0x608F, 1): 10_000} | objects)
    polepair("spin", drive.url, "60rpm", "--for", "0.2s")
    speeds = [value for written, value in drive.writes if written == 0x60FF and value != 0]
    assert speeds == [round(60 * per_rpm)]
    before = drive.position
    polepair("move", drive.url, "1turn", "--rel")
    assert last(drive, 0x607A) == per_turn and abs(drive.position - before - per_turn) <= 1
    shown = polepair("get", drive.url, "position actual").stdout
    # The drive tells whole units, and the command line as many digits as these have.
    assert abs(float(shown.split()[3]) - drive.position / per_turn) <= 1 / per_turn + 1e-4, shown
    assert "unit" in polepair("info", drive.url).stdout


def test_contradictory_scales_have_no_unit(odd):
    objects = {(0x60A8, 0): 0xFF410000, (0x6092, 1): 10_000, (0x6092, 2): 1}
    drive = odd(objects=objects)
    refused = polepair("spin", drive.url, "60rpm", "--for", "0.2s", check=False)
    assert refused.returncode == 2 and "60A8h and 6092h contradict" in refused.stderr, refused
    assert "60A8h = FF410000h" in refused.stderr and not drive.writes, drive.writes
    polepair("move", drive.url, "500", "--rel", "--raw")
    assert last(drive, 0x607A) == 500
    shown = polepair("get", drive.url, "position actual", "target position")
    assert shown.stdout.splitlines()[0] == "position actual = 500", shown
    assert shown.stderr.count("has no unit") == 1, shown


def test_a_count_of_zero_is_none(odd):
    drive = odd(objects={(0x608F, 1): 0})
    for words in (["get", drive.url, "position actual"], ["watch", drive.url, "--for", "0.1s"]):
        for form in ([], ["--format", "csv"], ["--format", "jsonl"]):
            shown = polepair(*words, *form)
            assert "NaN" not in shown.stdout and "turn" not in shown.stdout, shown
    assert "has no unit" in polepair("get", drive.url, "position actual").stderr
    polepair("move", drive.url, "500", "--rel", "--raw")
    assert last(drive, 0x607A) == 500
    refused = polepair("move", drive.url, "1turn", check=False)
    assert refused.returncode == 2 and "--raw" in refused.stderr, refused


@pytest.mark.parametrize("at", [1000, 4000])
def test_a_fault_in_a_move_is_reported_at_once(odd, at):
    drive = odd()
    drive.fault_at = at
    failed = polepair("move", drive.url, "1turn", "--rel", check=False)
    assert failed.returncode == 8 and "E801" in failed.stderr, failed
    assert "following error" in failed.stderr, failed


def test_loss_of_power_in_a_move_is_reported_at_once(odd):
    drive = odd()
    drive.sto_at = 2500
    failed = polepair("move", drive.url, "1turn", "--rel", check=False)
    assert failed.returncode == 1 and "lost its power" in failed.stderr, failed


def test_a_fault_in_homing_is_reported_at_once(odd):
    drive = odd()
    drive.homing_s, drive.fault_homing_after = 300, 0.2
    failed = polepair("home", drive.url, check=False)
    assert failed.returncode == 8 and "E801" in failed.stderr, failed


@pytest.mark.parametrize("stale", [0, 1, 4])
def test_bits_of_an_earlier_homing_are_no_success(odd, stale):
    drive = odd()
    drive.ack, drive.stale_reads, drive.homing_s = True, stale, 1.0
    begun = time.monotonic()
    polepair("home", drive.url)
    assert drive.homed == 1 and time.monotonic() - begun >= 1.0


def test_bits_that_never_go_are_taken_if_the_axis_moved(odd):
    drive = odd()
    drive.position = 4000.0
    drive.ack, drive.stale_reads, drive.homing_s = True, 1_000_000, 0.0
    polepair("home", drive.url)
    assert drive.homed == 1
    # Where it is already, they are all that is left, and prove nothing.
    failed = polepair("home", drive.url, check=False)
    assert failed.returncode == 1 and "E106" in failed.stderr, failed
    assert "was not seen to start" in failed.stderr, failed


def test_a_time_out_replaces_the_plans_own(odd):
    drive = odd()
    drive.homing_s = 300
    failed = polepair("home", drive.url, "--timeout", "1s", check=False)
    assert failed.returncode == 1 and "in time" in failed.stderr and drive.homed == 0, failed


SHEET = """[DeviceInfo]
ProductName=Small
[OptionalObjects]
SupportedObjects={count}
{list}
{sections}"""
KINDS = {1: 5, 2: 6, 4: 7}


def sheet(drive, folder, without=()):
    """An EDS of what a drive has."""
    keys = [key for key in drive.sizes if key[1] == 0 and key[0] not in without]
    listed = "\n".join(f"{n}=0x{index:04X}" for n, (index, _) in enumerate(keys, 1))
    sections = "".join(
        f"[{index:04X}]\nParameterName=O{index:04X}\nObjectType=0x7\n"
        f"DataType=0x{KINDS[drive.sizes[index, sub]]:04X}\nAccessType=rw\n"
        for index, sub in keys
    )
    path = folder / "small.eds"
    path.write_text(SHEET.format(count=len(keys), list=listed, sections=sections))
    return path


def test_a_missing_object_costs_its_option_alone(odd, tmp_path):
    drive = odd(without=(0x6099, 0x60FF))
    url = drive.url.replace("#", f"?eds={sheet(drive, tmp_path)}#")
    polepair("home", url)
    assert drive.homed == 1
    refused = polepair("home", url, "--vel", "10", check=False)
    assert refused.returncode == 2 and "6099h:1" in refused.stderr, refused
    refused = polepair("spin", url, "10", "--raw", check=False)
    assert refused.returncode == 2 and "60FFh" in refused.stderr, refused


def test_a_mode_that_a_drive_does_not_take_is_named_with_what_to_do(odd):
    drive = odd()
    drive.values[0x6061, 0], drive.keeps_mode = 3, True
    refused = polepair("move", drive.url, "1turn", "--rel", check=False)
    assert refused.returncode == 1 and "`mode display` stayed 3" in refused.stderr, refused
    assert "not 1 (profile position)" in refused.stderr and "polepair disable" in refused.stderr, refused
    # No new set-point is started.
    assert not [value for written, value in drive.writes if written == 0x6040 and value & 0x10]


def test_the_mode_is_written_before_an_axis_is_enabled(odd):
    drive = odd()
    drive.locks_mode = True
    polepair("move", drive.url, "0.1turn")
    polepair("spin", drive.url, "10", "--raw", "--for", "100ms")
    polepair("move", drive.url, "0.2turn", "--rel")
    assert (0x60FF, 10) in drive.writes
    # Enabled in another mode it has to be disabled first.
    polepair("enable", drive.url)
    refused = polepair("spin", drive.url, "10", "--raw", check=False)
    assert refused.returncode == 1 and "polepair disable" in refused.stderr, refused


def test_the_second_axis_of_a_node_is_an_axis(odd):
    drive = odd(second={"per_turn": 4000})
    second = f"{drive.url}.2"
    assert polepair("info", second).stdout.startswith("axis 5.2: "), polepair("info", second)
    rows = polepair("scan", drive.url, "--format", "csv").stdout.splitlines()
    assert [row.split(",")[0] for row in rows] == ["axis", "5", "5.2"], rows
    polepair("move", second, "1turn")
    assert drive.second.position == 4000 and drive.position == 0
    assert not drive.writes and (0x607A, 4000) in drive.second.writes
    shown = polepair("get", f"{drive.url},5.2", "position actual", "0x6064:0:i32", "--raw").stdout
    assert [line.split()[-1] for line in shown.splitlines()] == ["0", "0", "4000", "4000"], shown
    refused = polepair("get", f"{drive.url}.9", "0x6041", check=False)
    assert refused.returncode == 2 and "has no such axis" in refused.stderr, refused
    row = json.loads(polepair("get", second, "0x6041", "--format", "jsonl").stdout)
    assert row["axis"] == "5.2", row
    missing = polepair("get", f"{drive.url}.3", "0x6041", check=False)
    assert missing.returncode == 6, missing


@pytest.mark.parametrize("named", [False, True])
def test_stop_reaches_the_second_axis(odd, named):
    drive = odd(second={"per_turn": 4000})
    for url in [drive.url, f"{drive.url}.2"]:
        polepair("spin", url, "10", "--raw", "--detach")
    assert drive.state == drive.second.state == 0x27
    told = polepair("stop", drive.url if named else drive.url.split("#")[0])
    for one in [drive, drive.second]:
        assert one.old & 0x100 and one.values[0x60FF, 0] == 0, one.writes
    assert "axis 5.2" in told.stdout + told.stderr, told


def test_doctor_lists_what_a_drive_lacks_of_its_profile(odd):
    whole = polepair("doctor", odd().url)
    assert "objects that its profile uses" in whole.stdout, whole.stdout
    objects = {(0x6071, 0): 0, (0x6076, 0): 0, (0x6077, 0): 0, (0x6078, 0): 0, (0x6079, 0): 0, (0x1016, 1): 0}
    drive = odd(without=[0x607A], objects=objects)
    shown = polepair("doctor", drive.url, check=False).stdout
    (line,) = [line for line in shown.splitlines() if "lacks" in line]
    assert line.startswith("look") and "607Ah (target position)" in line, line
    assert "there is no `move`;" in line, line
    assert not drive.writes
    # Nearly nothing fits: another drive.
    far = polepair("doctor", odd(without=range(0x6060, 0x6600)).url, check=False).stdout
    assert "is it this drive?" in far, far


def test_settings_that_a_drive_lacks_are_listed_and_nothing_is_written(odd, tmp_path):
    file = tmp_path / "settings.toml"
    polepair("config", "save", odd().url, str(file))
    drive = odd(without=[0x6083, 0x6084])
    refused = polepair("config", "apply", drive.url, str(file), "--yes", check=False)
    assert "lacks 2 of these" in refused.stderr, refused.stderr
    assert "profile acceleration, profile deceleration; remove them, and `count`" in refused.stderr, refused.stderr
    assert refused.returncode == 2 and not drive.writes, drive.writes
    absent = ("profile acceleration", "profile deceleration", "count")
    kept = [line for line in file.read_text().splitlines() if not any(word in line for word in absent)]
    file.write_text("\n".join(kept))
    polepair("config", "apply", drive.url, str(file), "--yes")
