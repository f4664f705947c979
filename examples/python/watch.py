"""Shows position, speed and current of every axis on a link, without moving any.

    python watch.py "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10

The second word is how many readings are shown (5).
"""

import itertools
import sys

import polepair as pp


def main(url: str = "sim:tmcl:1,3?time=virtual", readings: str = "5") -> None:
    with pp.connect(url) as link:
        for axis in link.axes:
            print(f"{axis.label} ({axis.title})")
            # Only what this drive can tell.
            told = [name for name in ("position", "velocity", "current") if name in axis.signals]
            for _, values in itertools.islice(axis.watch(*told, period=0.1), int(readings)):
                print("  " + "  ".join(f"{name} {value:.4f}" for name, value in values.items()))


if __name__ == "__main__":
    main(*sys.argv[1:])
