"""Meets a fault, says what it means, takes the cause away, clears it and goes on:
fault_and_recover.py "tmcl+serial:///dev/ttyUSB0:9600#1"
On a simulated drive it lets the supply sag; on a real one it reports what happens by itself."""

import sys

from polepair_c import DRIVE_FAULT, Link, PolepairError

with Link(sys.argv[1] if len(sys.argv) > 1 else "sim:tmcl?time=virtual") as link, link.axis_at(0) as axis:
    simulated = axis.info().is_simulated
    with axis.armed():
        axis.velocity("300 rpm")
        link.sleep(0.5)
        print("turning")

        if simulated:
            link.act(0, "supply=8")
        link.sleep(0.5)
        print(f"fault code {axis.read('fault'):g}")
        try:
            axis.enable()
            print("no fault")
        except PolepairError as error:
            if error.status != DRIVE_FAULT:
                raise
            print(f"{error}\nwhat to do: {error.hint}")

        if simulated:
            link.act(0, "supply=24")  # the cause goes first
        link.sleep(0.5)
        axis.clear()
        axis.enable()
        axis.velocity("300 rpm")
        link.sleep(0.5)
        print(f"turning again at {axis.read('velocity'):.1f} rad/s")
