"""Reads and writes parameters by name, with units.

    python parameters.py "tmcl+serial:///dev/ttyUSB0:9600#1" "max current"

It writes back the value that it read: a drive keeps the settings it had.
"""

import sys

import polepair as pp


def main(url: str = "sim:tmcl?time=virtual", name: str = "max current") -> None:
    with pp.connect(url) as link:
        axis = link.axes[0]
        print(f"{axis.label} is a {axis.title}")

        before = axis.params[name]
        print(f"{name} = {before} (on the wire {before.raw})")
        info = axis.params.info(name)
        print(f"{info.about} In the manual: {info.symbol}, {info.section}")

        # In the parameter's own unit; text may carry another one: "1200 mA".
        axis.params[name] = before

        # Outside the limits nothing is sent.
        try:
            axis.params.raw[name] = info.raw_range[1] + 1
        except pp.Unsupported as error:
            print(f"{error.code}: {error}")


if __name__ == "__main__":
    main(*sys.argv[1:])
