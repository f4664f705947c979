"""The `polepair` program: `polepair`, or `python -m polepair`."""

from __future__ import annotations

import platform
import signal
import sys

from . import _polepair as native

__all__ = ["main"]


def main() -> int:
    """Runs the program with the words of `sys.argv`, and gives its exit code."""
    # The program stops motors itself on Ctrl-C. Where it was started with Ctrl-C ignored, it stays so.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if sys.argv[1:2] == ["fleet"]:
        from .fleet._command import main as fleet

        return fleet(sys.argv[2:] or ["--help"])
    python = f"{platform.python_implementation()} {platform.python_version()}"
    return native.run_command(["polepair", *sys.argv[1:]], python)


if __name__ == "__main__":
    sys.exit(main())
