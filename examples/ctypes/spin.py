"""Turns a motor for a while: spin.py "tmcl+serial:///dev/ttyUSB0:9600#1" "60 rpm" 3
It is stopped and switched off however this ends."""

import math
import sys

from polepair_c import Link

url, speed, seconds = [*sys.argv[1:], *["sim:tmcl?time=virtual", "60 rpm", "2"][len(sys.argv) - 1:]]
with Link(url) as link, link.axis_at(0) as axis:
    print(f"{axis.info().text('title')}: {axis.info().text('caution')}")
    with axis.armed():  # enabled where it stands
        axis.velocity(speed)
        for _ in range(4):
            link.sleep(float(seconds) / 4)
            print(f"{axis.read('velocity') * 30 / math.pi:.1f} rpm")
    # stopped, switched off, disarmed
