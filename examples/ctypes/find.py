"""Finds the drives on a link, by reads only: find.py tmcl+serial:///dev/ttyUSB0:9600 32"""

import sys

from polepair_c import scan

url = sys.argv[1] if len(sys.argv) > 1 else "sim:tmcl:1,3?time=virtual"
found = scan(url, 1, int(sys.argv[2]) if len(sys.argv) > 2 else 8)
for drive in found:
    print(f"{drive.number}: {drive.text('title')}, {drive.text('identity')}")
    if drive.clash:
        print(f"   {drive.text('clash')}")
if not found:
    print("nobody answered")
