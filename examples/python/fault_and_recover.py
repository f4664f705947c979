"""Meets a fault, says what it means, takes the cause away, clears it and goes on.

    python fault_and_recover.py "tmcl+serial:///dev/ttyUSB0:9600#1"

On a simulated drive it lets the supply sag; on a real one it reports what happens by itself.
"""

import sys

import polepair as pp


def main(url: str = "sim:tmcl?time=virtual") -> None:
    with pp.connect(url) as link:
        axis = link.axes[0]

        def supply(volts: float) -> None:
            if url.startswith("sim:"):
                link.simulation.act("supply", volts)

        with axis.armed():
            axis.spin("300 rpm")
            link.sleep(0.5)
            print("turning")

            supply(8.0)
            link.sleep(0.5)
            print(f"fault code {axis.read('fault')['fault']:.0f}")
            try:
                axis.enable()
                print("no fault")
            except pp.DriveFault as error:
                print(error)
                print(f"what to do: {error.hint}")

            supply(24.0)  # the cause goes first
            link.sleep(0.5)
            axis.clear()
            axis.enable()
            axis.spin("300 rpm")
            link.sleep(0.5)
            print(f"turning again at {axis.read('velocity')['velocity']:.1f} rad/s")


if __name__ == "__main__":
    main(*sys.argv[1:])
