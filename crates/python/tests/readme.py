"""Runs the Python program of README.md, as somebody does who has just installed the package."""

import re
from pathlib import Path

README = Path(__file__).parents[3] / "README.md"

if __name__ == "__main__":
    programs = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert programs, "README.md shows no program"
    for program in programs:
        exec(compile(program, str(README), "exec"), {})
    print(f"programs that ran: {len(programs)}")
