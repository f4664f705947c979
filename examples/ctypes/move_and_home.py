"""Finds the reference position, then moves there and back:
move_and_home.py modbus-rtu+serial:///dev/ttyUSB0:115200#1"""

import sys

from polepair_c import USAGE, Link, PolepairError

AT_MOST = 60

with Link(sys.argv[1] if len(sys.argv) > 1 else "sim:tmcl?time=virtual") as link, link.axis_at(0) as axis:
    if axis.info().is_simulated:
        link.act(0, "home=0.5turn")  # a switch, as a mechanic would fit one
    with axis.armed():
        try:
            print("home found" if axis.home(AT_MOST) else "no home in time")
        except PolepairError as error:
            if error.status != USAGE:
                raise
            print(error)  # a drive that cannot home is moved from where it stands
        for target in ["90 deg", "0 deg"]:
            axis.move_to(target)
            axis.wait(AT_MOST)
            print(f"at {target}: {axis.read('position'):.4f} rad")
        axis.move_by("-45 deg")  # never sent twice
        axis.wait(AT_MOST)
        print(f"45 degrees back: {axis.read('position'):.4f} rad")
