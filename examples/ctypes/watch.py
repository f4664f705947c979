"""Shows position, speed and current of every axis on a link, without moving any:
watch.py "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10"""

import sys

from polepair_c import Link

url, readings = [*sys.argv[1:], *["sim:tmcl:1,3?time=virtual", "5"][len(sys.argv) - 1:]]
with Link(url) as link:
    for axis in link.axes():
        print(f"{axis.info().text('label')} ({axis.info().text('title')})")
        # Only what this drive can tell.
        signals = [signal for signal in ["position", "velocity", "current"] if axis.has_signal(signal)]
        with axis.trace(signals, 0.1) as read:
            for _ in range(int(readings)):
                _, row = read(10)
                print("".join(f"  {signal} {value:.4f}" for signal, value in zip(signals, row)))
        axis.close()
