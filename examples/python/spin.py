"""Turns a motor for a while. It is stopped and switched off however this ends.

    python spin.py "tmcl+serial:///dev/ttyUSB0:9600#1" "60 rpm" 3
"""

import math
import sys

import polepair as pp


def main(url: str = "sim:tmcl?time=virtual", speed: str = "60 rpm", seconds: str = "2") -> None:
    with pp.connect(url) as link:
        axis = link.axes[0]
        print(f"{axis.title}: {axis.caution}")

        with axis.armed():  # enabled where it stands
            axis.spin(speed)
            for _ in range(4):
                link.sleep(float(seconds) / 4)
                velocity = axis.read("velocity")["velocity"]
                print(f"{velocity * 60 / math.tau:.1f} rpm")
        # stopped, switched off, disarmed


if __name__ == "__main__":
    main(*sys.argv[1:])
