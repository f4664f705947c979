"""The files in `dist/`, installed as users do: nothing of this repository and no Rust in sight.

`make dist` makes the files, `make try-dist` runs this.
"""

from __future__ import annotations

import fnmatch
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import time
import urllib.request
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
WHEEL_MAX = 15 << 20
"""Bytes of a wheel."""
CLEAN = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL": "C.UTF-8",
         "NO_COLOR": "1"}
FIRST_STEPS = (("polepair", "--version"), ("polepair", "demo", "--headless"),
               ("polepair", "spin", "sim:tmcl", "60rpm", "--for", "1s"))


def only(pattern: str) -> Path:
    found = sorted(DIST.glob(pattern))
    if not found:
        pytest.skip(f"dist/ has no {pattern}: make dist")
    assert len(found) == 1, found
    return found[0]


def ran(*command: str | Path, **more: object) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=CLEAN, **more)  # type: ignore[call-overload]
    assert done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
    return str(done.stdout)


def root_or_skip(*programs: str) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root makes a root")
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")


def test_a_wheel_has_what_its_page_shows() -> None:
    wheel = only("*manylinux*.whl")
    assert wheel.stat().st_size <= WHEEL_MAX
    assert "cp310-abi3-manylinux_2_28" in wheel.name
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        folder = next(name.partition("/")[0] for name in names if ".dist-info/" in name)
        metadata = archive.read(f"{folder}/METADATA").decode()
        scripts = archive.read(f"{folder}/entry_points.txt").decode()
    assert "polepair=polepair.__main__:main" in scripts.replace(" ", "")
    head, _, readme = metadata.partition("\n\n")
    assert readme.startswith("# Polepair")
    for part in ("License-Expression: MIT OR Apache-2.0", "Project-URL: Source", "Project-URL: Documentation",
                 "Requires-Python: >=3.10"):
        assert part in head
    needed = [line for line in head.splitlines() if line.startswith("Requires-Dist")]
    assert needed and all("extra ==" in line for line in needed), "it depends on nothing"
    for licence in ("LICENSE-MIT", "LICENSE-APACHE"):
        assert any(name.endswith(licence) for name in names)


def test_a_wheel_runs_on_the_systems_of_its_tag() -> None:
    shown = subprocess.run([sys.executable, "-m", "auditwheel", "show", only("*manylinux*.whl")], capture_output=True,
                           text=True, check=True).stdout
    tags = re.findall(r'"manylinux_(\d+)_(\d+)_', shown)
    assert tags and all((int(major), int(minor)) <= (2, 28) for major, minor in tags), shown


def test_a_wheel_is_installed_and_moves_a_motor(tmp_path: Path) -> None:
    wheel = only("*manylinux*.whl")
    began = time.monotonic()
    ran(sys.executable, "-m", "venv", tmp_path / "venv")
    bin = tmp_path / "venv" / "bin"
    ran(bin / "pip", "install", "--no-index", wheel)
    for name, *more in FIRST_STEPS:
        ran(bin / name, *more, cwd=tmp_path)
    assert ran(bin / "polepair", "move", "sim:tmcl", "1turn", cwd=tmp_path).startswith("position = ")
    ran(bin / "python", "-c", "import polepair", cwd=tmp_path)
    print(f"installed and moved in {time.monotonic() - began:.1f} s")
    shown = ran(bin / "polepair", "--version", cwd=tmp_path)
    assert re.fullmatch(r"polepair \S+ \(Python module \S+, CPython \S+\)\n", shown), shown
    assert ran(bin / "python", "-m", "polepair", "--version", cwd=tmp_path) == shown
    page(tmp_path, [bin / "polepair", "serve"])


def page(folder: Path, command: list[str | Path]) -> None:
    """The server of an installed package has the page."""
    server = subprocess.Popen([*command, "--bind", "127.0.0.1:0", "--state", folder / "state"], env=CLEAN,
                              stdout=subprocess.PIPE, text=True, cwd=folder)
    try:
        assert server.stdout is not None
        url = server.stdout.readline().removeprefix("ready ").strip()
        # The first page admits the browser by a cookie.
        browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        with browser.open(url, timeout=30) as response:
            text = response.read().decode()
        assert "<title>" in text and ".js" in text, text[:300]
    finally:
        server.terminate()
        server.wait(60)


def test_sums_and_parts_are_those_of_the_files() -> None:
    for line in only("SHA256SUMS").read_text().splitlines():
        expected, name = line.split()
        assert hashlib.sha256((DIST / name).read_bytes()).hexdigest() == expected, name
    for file, some in (("polepair-[0-9]*", {"tokio", "clap", "polepair-core"}), ("libpolepair-*", {"polepair-core"}),
                       ("polepair-python-*", {"pyo3", "polepair-core"})):
        parts = json.loads(only(f"{file}.cdx.json").read_text())
        names = {part["name"] for part in parts["components"]}
        assert some <= names, (file, names)


def test_the_guide_lists_every_file() -> None:
    guide = (ROOT / "docs" / "guides" / "releasing.md").read_text()
    listed = [line.split("`")[1].replace("VERSION", "[0-9]*") for line in guide.splitlines() if line.startswith("| `")]
    files = sorted(file.name for file in DIST.iterdir())
    if not files:
        pytest.skip("dist/ is empty: make dist")
    assert [name for name in files if not any(fnmatch.fnmatchcase(name, pattern) for pattern in listed)] == []


@pytest.mark.parametrize("libc", ["gnu", "musl"])
def test_an_archive_has_a_program_that_runs(libc: str, tmp_path: Path) -> None:
    archive = only(f"polepair-*-linux-{libc}.tar.gz")
    with tarfile.open(archive) as files:
        files.extractall(tmp_path, filter="data")
    (folder,) = tmp_path.iterdir()
    for part in ("README.md", "LICENSE-MIT", "man/polepair-spin.1", "completions/zsh"):
        assert (folder / part).is_file(), part
    if libc == "musl":
        root_or_skip("chroot")
        # Nothing else is there: no libc, no shell.
        shown = ran("chroot", folder, "/polepair", "encode", "tmcl", "ROR 0, 350")
        assert shown.strip() == "01 01 00 00 00 00 01 5E 61"
    else:
        for _, *more in FIRST_STEPS:
            ran(folder / "polepair", *more, cwd=tmp_path)
        page(tmp_path, [folder / "polepair", "serve"])


SPIN = "fault_and_recover"
"""An example in C that ends by itself, and prints what `expected.txt` has for it."""


def printed_as_expected(shown: str) -> None:
    lines = (ROOT / "examples" / "expected.txt").read_text().splitlines()
    (expected,) = (line.partition(": ")[2] for line in lines if line.startswith(f"{SPIN}: "))
    position = 0
    for part in expected.split(" | "):
        position = shown.index(part, position) + len(part)


CMAKE = """cmake_minimum_required(VERSION 3.16)
project(try C)
find_package(polepair 0.1 REQUIRED)
add_executable(try "${SOURCE}")
target_link_libraries(try polepair::polepair)
"""


@pytest.mark.parametrize("kind", ["shared", "static"])
def test_an_archive_has_a_c_library(kind: str, tmp_path: Path) -> None:
    root_or_skip("gcc", "pkg-config", "cmake")
    with tarfile.open(only("libpolepair-*-linux-gnu.tar.gz")) as files:
        files.extractall(tmp_path, filter="data")
    (folder,) = (path for path in tmp_path.iterdir())
    source = folder / "examples" / f"{SPIN}.c"
    if kind == "static":
        for library in folder.glob("lib/*.so*"):
            library.unlink()
    # By pkg-config, from wherever it was unpacked.
    found = subprocess.run(["pkg-config", "--cflags", "--libs", *(["--static"] if kind == "static" else []), "polepair"],
                           env=CLEAN | {"PKG_CONFIG_PATH": str(folder / "lib" / "pkgconfig")}, text=True,
                           capture_output=True, check=True)
    ran("gcc", "-Wall", "-Werror", source, *found.stdout.split(), f"-Wl,-rpath,{folder / 'lib'}", "-o", tmp_path / "try")
    printed_as_expected(ran(tmp_path / "try"))
    # By CMake.
    (tmp_path / "CMakeLists.txt").write_text(CMAKE)
    ran("cmake", "-S", tmp_path, "-B", tmp_path / "built", f"-DCMAKE_PREFIX_PATH={folder}", f"-DSOURCE={source}")
    ran("cmake", "--build", tmp_path / "built")
    printed_as_expected(ran(tmp_path / "built" / "try"))
    # A later series than the one that is installed is refused.
    (tmp_path / "CMakeLists.txt").write_text(CMAKE.replace("0.1", "9.0"))
    refused = subprocess.run(["cmake", "-S", tmp_path, "-B", tmp_path / "later", f"-DCMAKE_PREFIX_PATH={folder}"],
                             capture_output=True, text=True, env=CLEAN)
    assert refused.returncode != 0 and "9.0" in refused.stderr, refused.stderr


def test_the_zip_has_a_c_library_for_windows(tmp_path: Path) -> None:
    compiler = "x86_64-w64-mingw32-gcc"
    root_or_skip(compiler, "wine")
    with zipfile.ZipFile(only("libpolepair-*-windows-gnu.zip")) as files:
        files.extractall(tmp_path)
    (folder,) = tmp_path.iterdir()
    program = folder / "bin" / "try.exe"
    ran(compiler, "-Wall", "-Werror", folder / "examples" / f"{SPIN}.c", f"-I{folder / 'include'}",
        f"-L{folder / 'lib'}", "-lpolepair", "-o", program)
    # Wine 8 has no such library, Windows has.
    ran(compiler, "-shared", ROOT / "interop" / "windows" / "prng.c", "-ladvapi32", "-o",
        folder / "bin" / "bcryptprimitives.dll")
    shown = subprocess.run(["wine", program], capture_output=True, text=True, timeout=300,
                           env=CLEAN | {"WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all"})
    assert shown.returncode == 0, shown
    printed_as_expected(shown.stdout)


class Root:
    """A Debian system of its own: what is installed there changes nothing here."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, *command: str | Path, user: str = "root") -> str:
        mounts = 'mount -t proc proc "$1/proc"; mount --rbind /dev "$1/dev"; mount -t tmpfs tmpfs "$1/run"; '
        enter = mounts + 'root=$1; user=$2; shift 2; exec chroot --userspec="$user" "$root" "$@"'
        return ran("unshare", "--mount", "sh", "-ec", enter, "sh", self.folder, user, *command)

    def files(self) -> set[str]:
        """Every file whose name tells that it is the package's."""
        return set(self.run("find", "/etc", "/usr", "/var/lib", "-name", "*polepair*").split())


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Root]:
    root_or_skip("mmdebstrap", "unshare", "chroot")
    folder = tmp_path_factory.mktemp("root")
    made = subprocess.run(["mmdebstrap", "--quiet", "--variant=minbase", "--include=adduser,systemd,udev,gcc,libc6-dev,pkgconf,cmake,make",
                           "bookworm", folder], capture_output=True, text=True)
    if made.returncode != 0:
        pytest.skip(f"no root can be made here: {made.stderr[-300:]}")
    yield Root(folder)
    shutil.rmtree(folder)


@pytest.mark.parametrize("name", ["polepair", "libpolepair0", "libpolepair-dev"])
def test_a_debian_package_has_no_errors(name: str) -> None:
    root_or_skip("lintian")
    package = only(f"{name}_*.deb")
    shown = subprocess.run(["lintian", "--allow-root", "--fail-on", "error", package], capture_output=True, text=True)
    print(shown.stdout)
    assert shown.returncode == 0, shown.stdout


def test_a_debian_package_is_installed_used_and_removed(root: Root) -> None:
    package = only("polepair_*.deb")
    (root.folder / "tmp" / "polepair.deb").write_bytes(package.read_bytes())
    began = time.monotonic()
    root.run("dpkg", "--install", "/tmp/polepair.deb")
    for command in FIRST_STEPS:
        root.run(*command)
    print(f"installed and moved in {time.monotonic() - began:.1f} s")
    assert {"/usr/bin/polepair", "/usr/share/man/man1/polepair-spin.1.gz", "/etc/default/polepair",
            "/usr/share/bash-completion/completions/polepair", "/usr/share/zsh/vendor-completions/_polepair",
            "/usr/share/fish/vendor_completions.d/polepair.fish", "/usr/lib/systemd/system/polepair.service",
            "/usr/lib/udev/rules.d/60-polepair.rules"} <= root.files()
    unit = "/lib/systemd/system/polepair.service"
    assert root.run("systemd-analyze", "verify", "--man=no", unit) == ""
    exposure = root.run("systemd-analyze", "security", "--offline=true", "--no-pager", unit)
    level = re.search(r"Overall exposure level for .*: ([\d.]+)", exposure)
    assert level and float(level[1]) < 2.5, exposure[-500:]
    # The command that the unit starts, as the user that the unit names.
    root.run("install", "-d", "-o", "polepair", "-g", "polepair", "-m", "700", "/var/lib/polepair")
    shown = root.run("sh", "-c", "polepair serve --state /var/lib/polepair --bind 127.0.0.1:0 >/tmp/served & "
                     "until grep -q ready /tmp/served; do sleep 0.1; done; kill $!; wait $!; cat /tmp/served",
                     user="polepair")
    assert shown.startswith("ready http://127.0.0.1:")
    root.run("dpkg", "--purge", "polepair")
    assert root.files() == set()


def test_the_c_library_of_debian_is_installed_used_and_removed(root: Root) -> None:
    packages = [only(f"{name}_*.deb") for name in ("libpolepair0", "libpolepair-dev")]
    for package in packages:
        (root.folder / "tmp" / package.name).write_bytes(package.read_bytes())
    for file in ("check.h", f"{SPIN}.c"):
        shutil.copy(ROOT / "examples" / "c" / file, root.folder / "tmp")
    (root.folder / "tmp" / "CMakeLists.txt").write_text(CMAKE)
    root.run("dpkg", "--install", *(f"/tmp/{package.name}" for package in packages))
    # The names that a user types, with no path.
    for program, library in (("try", "$(pkg-config --libs polepair)"), ("alone", "-l:libpolepair.a -lm")):
        options = f"-Wall -Werror $(pkg-config --cflags polepair) {SPIN}.c {library} -o {program}"
        root.run("sh", "-ec", f"cd /tmp; gcc {options}")
        printed_as_expected(root.run(f"/tmp/{program}"))
    root.run("cmake", "-S", "/tmp", "-B", "/tmp/built", f"-DSOURCE=/tmp/{SPIN}.c")
    root.run("cmake", "--build", "/tmp/built")
    printed_as_expected(root.run("/tmp/built/try"))
    # Programs run with the library alone.
    root.run("dpkg", "--purge", "libpolepair-dev")
    printed_as_expected(root.run("/tmp/try"))
    root.run("dpkg", "--purge", "libpolepair0")
    printed_as_expected(root.run("/tmp/alone"))
    assert root.files() == set()
