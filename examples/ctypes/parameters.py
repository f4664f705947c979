"""Reads and writes parameters by name, with units:
parameters.py "tmcl+serial:///dev/ttyUSB0:9600#1" "max current"
It writes back the value that it read: a drive keeps the settings it had."""

import sys

from polepair_c import Link, PolepairError

url, name = [*sys.argv[1:], *["sim:tmcl?time=virtual", "max current"][len(sys.argv) - 1:]]
with Link(url) as link, link.axis_at(0) as axis:
    print(f"{axis.info().text('label')} is a {axis.info().text('title')}")
    print(f"{name} = {axis.get_text(name)} (on the wire {axis.get_raw(name)})")
    parameter = next(its for its in axis.parameters() if its.text("name") == name)
    print(f"{parameter.text('about')} In the manual: {parameter.text('symbol')}")

    # In the parameter's own unit; text may carry another one: axis.set(name, "1200 mA").
    axis.set(name, axis.get(name))

    # Outside the limits nothing is sent.
    try:
        axis.set_raw(name, parameter.raw_max + 1)
        print("the limit is not where the profile says")
    except PolepairError as error:
        if error.executed is not False:
            raise
        print(f"{error.code}: {error}")
