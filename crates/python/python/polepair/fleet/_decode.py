"""Decodes many captures to one data set: on threads of this machine, or as tasks of a Ray cluster."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import posixpath
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from .. import _polepair as native
from ..columns import extra
from ..errors import PolepairError, Unsupported

__all__ = ["Capture", "Job", "Outcome", "Progress", "Report", "decode"]

BATCH_BYTES = 64 << 20
"""Longest captures of one task, bytes: a lost node costs the work of its tasks."""
BATCH_CAPTURES = 200
TASKS_PER_CORE = 4
"""Tasks for each core where there are enough captures, so that all cores end at about the same time."""
RAY_TASKS = 2_000
"""Tasks that a Ray cluster is given at once."""
RAY_RETRIES = 3
"""Number of times Ray repeats a task whose node was lost."""
DONE = "_done"
"""The folder with a note for each decoded capture, named by its content."""
BEGUN = "_begun"
"""Note of a capture whose parts are being placed: the leftovers of a killed task are found by it."""
SOURCES = "_sources"
"""The folder with a note for each capture, named by its name, of the contents that it had."""
SEEN = "_captures"
"""The folder with a note for each file of a decoded capture, so that the file is not read again."""
VERSION_KEYS = ("ETag", "etag", "md5Hash", "content_md5", "mtime", "LastModified", "last_modified", "updated")
"""The identity of a file's version on its file system."""


class Capture(NamedTuple):
    """A file in the folder or bucket of captures."""

    name: str
    """The path below the folder, with `/`."""
    size: int
    """Bytes."""
    version: str
    """Changes with the file; empty if the file system has none."""


class Outcome(NamedTuple):
    """The result of decoding a capture."""

    capture: Capture
    state: Literal["decoded", "present", "failed"]
    reason: str = ""
    """Why it was not decoded."""
    notes: tuple[str, ...] = ()
    """Warnings: the protocol is a guess, lines are damaged."""
    retry: bool = False
    """Another attempt can succeed: a file could not be read or written."""
    content: str = ""
    """BLAKE3 of its bytes, where they were read."""


class Progress(NamedTuple):
    """Progress of a run."""

    captures: int
    """Captures that are done, with those that failed."""
    of_captures: int
    size: int
    """Their bytes."""
    of_size: int
    failed: int


class Report(NamedTuple):
    """The results of all captures."""

    decoded: int
    present: int
    """Captures that the data set had before, decoded with the same options."""
    failed: tuple[Outcome, ...]
    """In the order of their names. The next run tries them again."""
    notes: tuple[tuple[str, str], ...]
    """Names of captures, each with its doubts and omissions."""

    def __str__(self) -> str:
        return f"{self.decoded} decoded, {self.present} were decoded earlier, {len(self.failed)} failed"


@dataclass(frozen=True)
class Job:
    """Source of captures, destination of their rows, and options of the decoder. It can be pickled.

    A cluster of another kind decodes with three calls: `captures` lists, `batches` makes tasks of the list, and
    `decode` does one task, on any machine. A task may run twice, and on two machines at once: the parts of a
    capture are named by its content, and the note that ends it is written last.
    """

    source: str
    """Folder or bucket of captures, as fsspec reads it."""
    out: str
    """Folder or bucket of the data set."""
    options: tuple[str, ...] = ()
    """Options of `polepair decode`: `("--as", "canopen", "--site", "hall-2")`.

    In the values of `--site` and `--gateway`, `{0}` is the first folder of a capture below the source, `{1}` the
    second, `{folder}` all of them.
    """
    storage_options: Mapping[str, Any] = field(default_factory=dict)
    """Options for fsspec: keys, an endpoint."""

    def captures(self) -> list[Capture]:
        """The captures by name: files whose ending is a capture's, but for hidden ones and the data set itself."""
        files, root = _file_system(self.source, self.storage_options)
        if files.isfile(root):
            return [_capture(posixpath.basename(root), files.info(root))]
        own, out = _file_system(self.out, self.storage_options)
        inside = f"{out}/" if own == files else None
        found: list[Capture] = []
        for path, info in files.find(root, detail=True).items():
            name = path[len(root) :].lstrip("/")
            hidden = any(part.startswith(".") for part in name.split("/"))
            if not hidden and not (inside and path.startswith(inside)) and native.is_capture_name(name):
                found.append(_capture(name, info))
        if not found:
            raise FileNotFoundError(
                f"there is no capture in {self.source}: captures are recognised by the ending of their names "
                "(log, pcap, blf and so on)"
            )
        return sorted(found)

    def batches(self, captures: Iterable[Capture], cores: int = 1) -> list[list[Capture]]:
        """Tasks of some captures each, for that many cores."""
        ordered = sorted(captures)
        tasks = TASKS_PER_CORE * cores
        most_bytes = min(BATCH_BYTES, sum(capture.size for capture in ordered) // tasks)
        most_captures = min(BATCH_CAPTURES, -(-len(ordered) // tasks))
        batches: list[list[Capture]] = []
        space, room = 0, 0
        for capture in ordered:
            if not batches or space < capture.size or not room:
                batches.append([])
                space, room = most_bytes, most_captures
            batches[-1].append(capture)
            space -= capture.size
            room -= 1
        return batches

    def decode(self, captures: Sequence[Capture]) -> list[Outcome]:
        """Decodes some captures and stores their rows. An exception of one does not end the others."""
        outcomes: list[Outcome] = []
        for capture in captures:
            try:
                outcomes.append(self._decode(capture))
            except PolepairError as error:
                hint = f" Try: {error.hint}" if error.hint else ""
                outcomes.append(Outcome(capture, "failed", f"{error} ({error.code}){hint}"))
            except Exception as error:  # file systems of fsspec have exceptions of their own
                outcomes.append(Outcome(capture, "failed", f"{type(error).__name__}: {error}", retry=True))
        return outcomes

    def options_for(self, capture: Capture) -> list[str]:
        """The options with the folders of a capture in them."""
        folders = capture.name.split("/")[:-1]
        words = list(self.options)
        for at, word in enumerate(words):
            if at and words[at - 1] in ("--site", "--gateway"):
                try:
                    words[at] = word.format(*folders, folder="/".join(folders))
                except (IndexError, KeyError, ValueError) as error:
                    hint = "{0} is the first folder below the source, {1} the second, {folder} all of them"
                    raise Unsupported(
                        f"`{word}` names a folder that {capture.name} does not have", "E250", False, hint
                    ) from error
        return words

    def remaining(self, captures: Iterable[Capture]) -> list[Capture]:
        """The captures whose listed files are not in the data set with these options."""
        files, root = _file_system(self.out, self.storage_options)
        folder = f"{root}/{SEEN}"
        seen = {posixpath.basename(path) for path in files.find(folder)} if files.isdir(folder) else set()
        return [capture for capture in captures if self._seen_name(capture) not in seen]

    def _seen_name(self, capture: Capture) -> str:
        """The name of its note in SEEN; empty if changes of the file cannot be detected."""
        if not capture.version:
            return ""
        words = [capture.name, str(capture.size), capture.version, _inputs(tuple(self.options_for(capture)))]
        return hashlib.blake2b("\n".join(words).encode(), digest_size=16).hexdigest()

    def decode_again(self, capture: Capture) -> Outcome:
        """Decodes a capture though the data set has it."""
        return self._decode(capture, again=True)

    def _decode(self, capture: Capture, again: bool = False) -> Outcome:
        source, folder = _file_system(self.source, self.storage_options)
        files, root = _file_system(self.out, self.storage_options)
        with tempfile.TemporaryDirectory(prefix="polepair-") as scratch:
            path = folder if source.isfile(folder) else f"{folder}/{capture.name}"
            if not _is_local(source):
                remote, path = path, os.path.join(scratch, posixpath.basename(capture.name))
                _copy(source, remote, path)
            place = f"{self.source}/{capture.name}"
            content = native.capture_content(path, place)
            blake3 = _hash_of(content)
            note = f"{root}/{DONE}/{blake3}"
            made = os.path.join(scratch, "made")
            earlier = _text(files, note)
            if earlier and not again:
                _write(os.path.join(made, DONE, blake3), earlier.encode())
            is_new, notes = native.decode_to_dataset(path, capture.name, made, self.options_for(capture))
            published = _Published(files, root, scratch)
            with native.DatasetLock(root) if _is_local(files) else contextlib.nullcontext():
                if is_new:
                    published.replace((path, place), capture.name, content, made)
                else:
                    published.note_copy(capture.name, content)
                if seen := self._seen_name(capture):
                    published.write(f"{SEEN}/{seen}", f"{capture.name}\n{blake3}\n")
        return Outcome(capture, "decoded" if is_new else "present", notes=tuple(notes), content=blake3)


class _Published:
    """The parts and notes of a data set, which may be in a bucket.

    The notes are those of `crates/columns/src/dataset/notes.rs`. Two tasks that decode one capture write the same.
    """

    def __init__(self, files: Any, root: str, scratch: str) -> None:
        self._files, self._root, self._scratch = files, root, scratch

    def replace(self, file: tuple[str, str], name: str, content: str, made: str) -> None:
        """Stores the parts of a capture from the folder `made`. Removes those of what it has grown from.

        `file` is the path of the capture on this machine, and its place.
        """
        blake3 = _hash_of(content)
        done = _read(os.path.join(made, DONE, blake3)).decode()
        parts = set(_parts(done.splitlines()[1:]))
        earlier = self._parts(blake3)
        known = [line for line in self._contents(name) if _hash_of(line) != blake3]
        grown = set(native.grown_from(*file, known))
        self._write_contents(name, [*known, content])
        self.write(f"{BEGUN}/{blake3}", "".join(f"{part}\n" for part in sorted(parts | earlier)))
        for part in sorted(parts):
            _store(self._files, os.path.join(made, *part.split("/")), f"{self._root}/{part}")
        self._remove(earlier - parts)
        for old in map(_hash_of, grown):
            if not self._is_shared(old, name):
                self._remove(self._parts(old) - parts)
                self._remove({f"{DONE}/{old}", f"{BEGUN}/{old}"})
        self.write(f"{DONE}/{blake3}", done)
        self._remove({f"{BEGUN}/{blake3}"})
        self._write_contents(name, [line for line in [*known, content] if line not in grown])

    def note_copy(self, name: str, content: str) -> None:
        """Notes a capture whose content the data set has under another name."""
        known = self._contents(name)
        if _hash_of(content) not in map(_hash_of, known):
            self._write_contents(name, [*known, content])

    def write(self, name: str, text: str) -> None:
        """Writes a note."""
        _write(os.path.join(self._scratch, "note"), text.encode())
        _store(self._files, os.path.join(self._scratch, "note"), f"{self._root}/{name}")

    def _parts(self, blake3: str) -> set[str]:
        done = _text(self._files, f"{self._root}/{DONE}/{blake3}").splitlines()[1:]
        begun = _text(self._files, f"{self._root}/{BEGUN}/{blake3}").splitlines()
        return set(_parts([*done, *begun]))

    def _contents(self, name: str) -> list[str]:
        return _text(self._files, self._source_note(name)).splitlines()

    def _write_contents(self, name: str, contents: list[str]) -> None:
        self.write(f"{SOURCES}/{_note_name(name)}", "".join(f"{line}\n" for line in contents))

    def _source_note(self, name: str) -> str:
        return f"{self._root}/{SOURCES}/{_note_name(name)}"

    def _is_shared(self, blake3: str, name: str) -> bool:
        own = _note_name(name)
        others = [note for note in self._files.find(f"{self._root}/{SOURCES}") if posixpath.basename(note) != own]
        return any(blake3 in map(_hash_of, _text(self._files, note).splitlines()) for note in others)

    def _remove(self, names: set[str]) -> None:
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                self._files.rm_file(f"{self._root}/{name}")


def _hash_of(content: str) -> str:
    return content.split(" ", 1)[0]


def _note_name(name: str) -> str:
    return native.text_hash(name)


def decode(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    ray: str | None = None,
    workers: int | None = None,
    protocols: str | None = None,
    profile: str | None = None,
    format: str | None = None,
    site: str | None = None,
    gateway: str | None = None,
    tables: Sequence[str] = (),
    retries: int = 2,
    storage_options: Mapping[str, Any] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Report:
    """Decodes a folder or bucket of captures to a partitioned data set of Parquet files.

    Each capture's rows are in the data set exactly once. Captures that are already decoded with the same options are
    left as they are, so the same call continues after an interruption. A capture that fails is tried again `retries` times if
    its files could not be read or written, and is named in the report.

    `ray` is the address of a Ray cluster (`auto` for the one of this machine or job, `local` to start one here);
    without it `workers` threads decode here (default: one for each core). On a cluster source and out have to be
    reachable from each node. `protocols`, `profile`, `format`, `site`, `gateway` and `tables` are the options of
    `polepair decode`; in site and gateway, `{0}` is the first folder of a capture below the source, `{1}` the second.
    `storage_options` are fsspec's.

    Errors: `FileNotFoundError` where there is no capture, `Unsupported` for options that do not hold.
    """
    words: list[str] = []
    for option, value in (
        ("--as", protocols),
        ("--profile", profile),
        ("--from", format),
        ("--site", site),
        ("--gateway", gateway),
        ("--tables", ",".join(tables) or None),
    ):
        words += [] if value is None else [option, value]
    native.decode_inputs(words)
    job = Job(os.fspath(source), os.fspath(out), tuple(words), dict(storage_options or {}))
    return _run(job, ray, workers or os.cpu_count() or 1, retries, progress)


def _run(
    job: Job, ray: str | None, workers: int, retries: int, progress: Callable[[Progress], None] | None
) -> Report:
    captures = job.captures()
    outcomes: dict[str, Outcome] = {each.name: Outcome(each, "present") for each in captures}
    left = job.remaining(captures)
    done = set(outcomes) - {each.name for each in left}
    of_size = sum(each.size for each in captures)

    def tell() -> None:
        if progress:
            failed = sum(outcomes[name].state == "failed" for name in done)
            size = sum(outcomes[name].capture.size for name in done)
            progress(Progress(len(done), len(captures), size, of_size, failed))

    tell()
    cores, run = _on_threads(job, workers) if ray is None else _on_ray(job, ray)
    for attempt in range(retries + 1):
        # One that ends its worker must not take others with it again.
        batches = job.batches(left, cores) if attempt == 0 else [[each] for each in left]
        for batch in run(batches):
            for outcome in batch:
                outcomes[outcome.capture.name] = outcome
                done.add(outcome.capture.name)
            tell()
        left = [each.capture for each in outcomes.values() if each.retry]
        if not left:
            break
    _settle_copies(job, outcomes)
    states = [each.state for each in outcomes.values()]
    failed = tuple(sorted(each for each in outcomes.values() if each.state == "failed"))
    notes = tuple((name, note) for name, each in sorted(outcomes.items()) for note in each.notes)
    return Report(states.count("decoded"), states.count("present"), failed, notes)


def _settle_copies(job: Job, outcomes: dict[str, Outcome]) -> None:
    """Copies of one capture may have been decoded at once: its rows are called by the first name."""
    copies: dict[str, list[Outcome]] = {}
    for _, outcome in sorted(outcomes.items()):
        if outcome.content:
            copies.setdefault(outcome.content, []).append(outcome)
    for first, *others in copies.values():
        decoded = [other for other in others if other.state == "decoded"]
        if decoded:
            outcomes[first.capture.name] = job.decode_again(first.capture)
        for other in decoded:
            outcomes[other.capture.name] = other._replace(state="present", notes=())


Runner = Callable[[list[list[Capture]]], Iterator[list[Outcome]]]
"""Decodes batches, and yields the outcome of each as it ends."""


def _lost(batch: Sequence[Capture], error: Exception) -> list[Outcome]:
    reason = f"{type(error).__name__}: {error}".strip().splitlines()[0]
    return [Outcome(capture, "failed", reason, retry=True) for capture in batch]


def _on_threads(job: Job, workers: int) -> tuple[int, Runner]:
    def run(batches: list[list[Capture]]) -> Iterator[list[Outcome]]:
        pool = ThreadPoolExecutor(workers, thread_name_prefix="polepair-decode")
        try:
            for ended in as_completed([pool.submit(job.decode, batch) for batch in batches]):
                yield ended.result()
        finally:
            # After Ctrl-C what is under way ends, and nothing else begins.
            pool.shutdown(cancel_futures=True)

    return workers, run


def _on_ray(job: Job, address: str) -> tuple[int, Runner]:
    ray = extra("ray", "ray")
    if not ray.is_initialized():
        ray.init(address=None if address == "local" else address, log_to_driver=False)
    task = ray.remote(num_cpus=1, max_retries=RAY_RETRIES)(_decode_batch)

    def run(batches: list[list[Capture]]) -> Iterator[list[Outcome]]:
        waiting = list(reversed(batches))
        pending: dict[Any, list[Capture]] = {}
        try:
            while waiting or pending:
                while waiting and len(pending) < RAY_TASKS:
                    batch = waiting.pop()
                    pending[task.remote(job, batch)] = batch
                ended, _ = ray.wait(list(pending), num_returns=1)
                for each in ended:
                    batch = pending.pop(each)
                    try:
                        yield ray.get(each)
                    except ray.exceptions.RayError as error:
                        yield _lost(batch, error)
        finally:
            for each in pending:
                ray.cancel(each, force=True)

    return int(ray.cluster_resources().get("CPU", 1)) or 1, run


def _decode_batch(job: Job, batch: list[Capture]) -> list[Outcome]:
    return job.decode(batch)


def _file_system(url: str, options: Mapping[str, Any]) -> tuple[Any, str]:
    """The file system of a URL or path, and the path in it."""
    core = extra("fsspec.core", "polepair[fleet]")
    files, root = core.url_to_fs(url, **(options if "://" in url else {}))
    return files, str(root).rstrip("/")


@functools.lru_cache(maxsize=4096)
def _inputs(options: tuple[str, ...]) -> str:
    return native.decode_inputs(list(options))


def _is_local(files: Any) -> bool:
    return "file" in ([files.protocol] if isinstance(files.protocol, str) else files.protocol)


def _capture(name: str, info: Mapping[str, Any]) -> Capture:
    versions = (str(info[key]) for key in VERSION_KEYS if info.get(key) is not None)
    return Capture(name, int(info["size"] or 0), next(versions, ""))


def _parts(lines: Iterable[str]) -> list[str]:
    """The parts that lines of a note name, below the data set."""
    return [part.replace("\\", "/") for part in lines if ".." not in part]


def _copy(source: Any, remote: str, local: str) -> None:
    """Copies a capture that does not change meanwhile."""
    before = _capture(remote, source.info(remote))
    source.get_file(remote, local)
    source.invalidate_cache()
    if _capture(remote, source.info(remote)) != before:
        raise OSError("the capture changed while it was read (E307)")


def _text(files: Any, path: str) -> str:
    """A note; empty where there is none."""
    try:
        return str(files.cat_file(path).decode())
    except FileNotFoundError:
        return ""


def _read(path: str) -> bytes:
    with open(path, "rb") as file:
        return file.read()


def _write(path: str, content: bytes) -> None:
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "wb") as file:
        file.write(content)


def _store(files: Any, local: str, target: str) -> None:
    """Puts a file in its place in one step: readers see the old one or the whole new one."""
    if not _is_local(files):
        files.put_file(local, target)
        return
    folder, name = os.path.split(target)
    os.makedirs(folder, exist_ok=True)
    temporary = os.path.join(folder, f".{name}.{uuid.uuid4().hex}.part")
    try:
        shutil.copyfile(local, temporary)
        os.replace(temporary, target)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.remove(temporary)
        raise
