"""Finds the drives on a link, by reads only.

    python find.py tmcl+serial:///dev/ttyUSB0:9600 32

The second word is the highest address that is tried (8).
"""

import sys

import polepair as pp


def show(address: int, done: int, of: int) -> None:
    print(f"\raddress {address} ({done + 1} of {of}) ", end="", file=sys.stderr)


def main(url: str = "sim:tmcl:1,3?time=virtual", last: str = "8") -> None:
    found = pp.scan(url, 1, int(last), progress=show)
    print(file=sys.stderr)
    for drive in found:
        print(f"{drive.number}: {drive.title}, {drive.known}")
        if drive.clash:
            print(f"   {drive.clash}")
    if not found:
        print("nobody answered")


if __name__ == "__main__":
    main(*sys.argv[1:])
