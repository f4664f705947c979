"""Finds the reference position, then moves there and back.

    python move_and_home.py "modbus-rtu+serial:///dev/ttyUSB0:115200#1"

A drive that cannot home says so, and is moved from where it stands.
"""

import math
import sys

import polepair as pp


def main(url: str = "sim:tmcl?time=virtual") -> None:
    with pp.connect(url) as link:
        axis = link.axes[0]
        if url.startswith("sim:"):
            # A switch at half a turn, as a mechanic would fit one.
            link.simulation.act("home_switch", math.pi)

        with axis.armed():
            try:
                axis.home(timeout=60)
                print("home found")
            except pp.Unsupported as error:
                print(error)

            for target in ("90 deg", "0 deg"):
                axis.move(target).wait(60)
                print(f"at {target}: {axis.read('position')['position']:.4f} rad")
            axis.move_by("-45 deg").wait(60)  # never sent twice
            print(f"45 degrees back: {axis.read('position')['position']:.4f} rad")


if __name__ == "__main__":
    main(*sys.argv[1:])
