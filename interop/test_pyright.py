"""Microsoft's type checker, strict, on the Python examples: what editors tell who writes such code."""

import json
import shutil
import subprocess
import sys

import pytest
from conftest import BUILD, ROOT, need

PACKAGE = "pyright@1.1.414"


@pytest.fixture(scope="module")
def checked():
    """A function that checks programs, and gives the number of files and the errors."""
    need("node")
    need("npm")
    folder = BUILD / "pyright"
    program = folder / "node_modules" / "pyright" / "index.js"
    if not program.exists():
        folder.mkdir(parents=True, exist_ok=True)
        words = ["npm", "install", "--prefix", str(folder), "--ignore-scripts", "--no-audit", "--no-fund"]
        done = subprocess.run([*words, PACKAGE], capture_output=True, text=True, timeout=300, check=False)
        if done.returncode:
            pytest.skip(f"npm cannot install {PACKAGE}: {done.stderr.strip()[-200:]}")

    def check(programs):
        place = folder / "programs"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        for name, text in programs.items():
            (place / name).write_text(text)
        config = {"include": ["programs"], "typeCheckingMode": "strict"}
        config["extraPaths"] = [str(ROOT / "crates" / "python" / "python")]
        (folder / "pyrightconfig.json").write_text(json.dumps(config))
        words = ["node", str(program), "-p", str(folder), "--outputjson", "--pythonpath", sys.executable]
        done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
        told = json.loads(done.stdout)
        errors = [d["message"] for d in told["generalDiagnostics"] if d["severity"] == "error"]
        return told["summary"]["filesAnalyzed"], errors

    return check


def test_examples_have_nothing_to_complain_of(checked):
    examples = {path.name: path.read_text() for path in (ROOT / "examples" / "python").glob("*.py")}
    assert len(examples) == 6
    assert checked(examples) == (6, [])


def test_wrong_settings_are_reported(checked):
    wrong = "import polepair as pp\nwith pp.connect('sim:tmcl') as link:\n    link.axis(1.5)\n"
    files, errors = checked({"wrong.py": wrong})
    assert files == 1 and len(errors) == 1 and "float" in errors[0]
