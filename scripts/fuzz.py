"""Reads damaged files of every format, many of them, and tells what did not end in data or in findings.

    python scripts/fuzz.py --count 100000 --seed 0

Files of every format are made from a seed, and damaged: cut, spliced, bytes turned, numbers replaced by absurd ones,
members of archives changed and packed again. Each is read as `kennfeld info`, `kennfeld diff` and a project would read
it. A traceback, a warning, a crash, more than a few seconds or more than a gigabyte is a failure. Every failure is kept
with the number that makes it again: `--only NUMBER`.
"""

import argparse
import gzip
import multiprocessing
import os
import random
import re
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from fuzz_samples import Sample, samples

LONGEST = 20.0  # s, for one file
STARTING = 60.0  # s more for the imports
MOST_MEMORY = 1 << 30  # bytes above what the process had before its first file
ADDRESSES = 16 << 30  # bytes of address space, so that a bomb ends in an error and not the machine
REPORT = 5.0  # s between lines of progress
_NUMBER = re.compile(rb"\d+(?:\.\d+)?")
_ABSURD = [*b"0 -1 1000000000 99999999999999999999 1e308 -1e999 nan 65535 0x7fffffff".split(), b""]
_EXTREME = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\x01")


def damaged(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    """A copy of a file with one to four kinds of damage; `other` is a file of the same kind."""
    if raw.startswith(b"PK\x03\x04") and draw.random() < 0.7:
        return _repacked(raw, draw)
    if raw.startswith(b"\x1f\x8b") and draw.random() < 0.5:
        content = gzip.decompress(raw)
        return gzip.compress(draw.choice(_DAMAGES)(content, content, draw), mtime=0)
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        raw = draw.choice(_DAMAGES)(raw, other, draw)
    return raw


def _cut(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    return raw[: draw.randrange(len(raw) + 1)]


def _turned(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    made = bytearray(raw)
    for _ in range(draw.choice((1, 2, 8, 64))):
        if made:
            made[draw.randrange(len(made))] = draw.randrange(256)
    return bytes(made)


def _extreme(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    """A field of 1, 2, 4 or 8 bytes, early in the file as a rule, with the largest or the smallest number."""
    width, near = draw.choice((1, 2, 4, 8)), draw.choice((64, 512, len(raw) or 1))
    at = draw.randrange(min(near, len(raw)) + 1)
    return raw[:at] + draw.choice(_EXTREME) * width + raw[at + width :]


def _absurd(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    """A number of a text replaced."""
    found = list(_NUMBER.finditer(raw[: 1 << 16]))
    if not found:
        return _turned(raw, other, draw)
    one = draw.choice(found)
    return raw[: one.start()] + draw.choice(_ABSURD) + raw[one.end() :]


def _without_lines(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    lines = raw.splitlines(keepends=True)
    at = draw.randrange(len(lines) + 1)
    return b"".join(lines[:at] + lines[at + draw.choice((1, 1, 5)) :])


def _doubled(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    begin, end = sorted((draw.randrange(len(raw) + 1), draw.randrange(len(raw) + 1)))
    return raw[:end] + raw[begin:end] * draw.choice((1, 1, 20)) + raw[end:]


def _deleted(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    begin = draw.randrange(len(raw) + 1)
    return raw[:begin] + raw[begin + draw.choice((1, 4, 100)) :]


def _spliced(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    return raw[: draw.randrange(len(raw) + 1)] + other[draw.randrange(len(other) + 1) :]


def _repacked(raw: bytes, draw: random.Random) -> bytes:
    """An archive with one member damaged, whose sums are right all the same."""
    made = BytesIO()
    try:
        with zipfile.ZipFile(BytesIO(raw)) as before, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as after:
            names = before.namelist()
            chosen = draw.choice(names)
            for name in names:
                content = before.read(name)
                after.writestr(name, draw.choice(_DAMAGES)(content, content, draw) if name == chosen else content)
    except (zipfile.BadZipFile, ValueError):
        return _turned(raw, raw, draw)
    return made.getvalue()


_DAMAGES: tuple[Callable[[bytes, bytes, random.Random], bytes], ...] = (
    _cut,
    _turned,
    _turned,
    _extreme,
    _extreme,
    _absurd,
    _absurd,
    _without_lines,
    _doubled,
    _deleted,
    _spliced,
)


def put(samples: Sequence[Sample], seed: int, number: int, folder: Path) -> tuple[str, Path]:
    """Write damaged file number so and so with the files beside it; its kind and its path."""
    draw = random.Random(f"{seed}/{number}")
    kinds = sorted({sample.kind for sample in samples})
    kind = kinds[number % len(kinds)]
    same = [sample for sample in samples if sample.kind == kind]
    chosen, other = draw.choice(same), draw.choice(same)
    for name, content in chosen.files.items():
        (folder / name).write_bytes(content)
    target = folder / chosen.name
    target.write_bytes(damaged(chosen.files[chosen.name], other.files[other.name], draw))
    return kind, target


def read(damaged: Path) -> bool:
    """Read a damaged file, and those beside it that may refer to it; whether it holds something."""
    good = _read(damaged)
    for other in sorted(damaged.parent.iterdir()):
        if other != damaged:
            _read(other)
    return good


def _read(path: Path) -> bool:
    """Read a file as the commands do. Whatever is no finding is raised."""
    from kennfeld import calfiles, measurement
    from kennfeld.errors import InputError
    from kennfeld.terminal.file_info import describe_file

    good = False
    for work in (
        lambda: describe_file(path).lines(),
        *([lambda: _imported(path)] if path.suffix in (".slx", ".mdl") else []),
        *([lambda: _checked(path)] if path.suffix == ".toml" else []),
        lambda: calfiles.read(path),
        lambda: measurement.read(path, raster=0.1),
        lambda: measurement.read(path),
    ):
        try:
            work()
            good = True
        except InputError as error:
            if not error.findings or not all(finding.message for finding in error.findings):
                raise AssertionError("an error without findings") from error
    return good


def _checked(path: Path) -> None:
    """Check a project with all its files."""
    from kennfeld.project import Project

    Project.read(path).check()


def _imported(path: Path) -> None:
    """Import a model as a project does, with the script beside it."""
    from kennfeld.models.simulink.importing import simulink

    simulink(path, parameters=sorted(path.parent.glob("*.m")))


@dataclass
class Outcome:
    """What became of the files of a kind."""

    files: int = 0
    read: int = 0
    slowest: float = 0.0
    failures: list[tuple[int, str]] = field(default_factory=list)


def work(seed: int, numbers: Sequence[int], samples: Sequence[Sample], at: "object", told: "object") -> None:
    """Read some of the files in a process that may crash; `at` says which one it reads."""
    _limit_memory()
    warnings.simplefilter("error")
    before = 0
    with tempfile.TemporaryDirectory() as place:
        for number in numbers:
            at.value = number  # type: ignore[attr-defined]
            folder = Path(place) / str(number)
            folder.mkdir()
            kind, path = put(samples, seed, number, folder)
            began, wrong, good = time.perf_counter(), "", False
            try:
                good = read(path)
            except BaseException as error:
                last = traceback.extract_tb(error.__traceback__)[-1]
                wrong = f"{type(error).__name__}: {str(error)[:200]} ({Path(last.filename).name}:{last.lineno})"
            spent = time.perf_counter() - began
            before = before or _most_memory()
            if not wrong and _most_memory() > before + MOST_MEMORY:
                wrong, before = "more than a gigabyte of memory", _most_memory()
            if not wrong and spent > LONGEST / 2:
                wrong = f"took {spent:.1f} s"
            told.put((number, kind, good, spent, wrong))  # type: ignore[attr-defined]
            shutil.rmtree(folder, ignore_errors=True)
    at.value = -1  # type: ignore[attr-defined]


def _limit_memory() -> None:
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))


def _most_memory() -> int:
    with suppress(ImportError):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return 0


@dataclass(frozen=True)
class Running:
    """A process that reads, the file it was seen at, and since when."""

    process: Any
    at: Any
    number: int
    since: float


class Campaign:
    """The processes that read, watched from outside: one that crashes or hangs is replaced."""

    def __init__(self, seed: int, count: int, workers: int, samples: Sequence[Sample]) -> None:
        self.seed, self.samples = seed, samples
        self.outcomes: dict[str, Outcome] = {}
        self.shares = [range(first, count, workers) for first in range(workers)]
        self.done: set[int] = set()
        self.context = multiprocessing.get_context("spawn")

    def run(self) -> Mapping[str, Outcome]:
        """Read all files."""
        told = self.context.Queue()
        running = [self._started(share, told) for share in self.shares]
        reported = time.monotonic()
        while any(running):
            self._hear(told)
            running = [self._watched(one, share, told) for one, share in zip(running, self.shares, strict=True)]
            if time.monotonic() - reported > REPORT:
                reported = time.monotonic()
                done = sum(outcome.files for outcome in self.outcomes.values())
                failed = sum(len(outcome.failures) for outcome in self.outcomes.values())
                print(f"{done} files, {failed} failures", file=sys.stderr, flush=True)
        self._hear(told)
        return self.outcomes

    def _started(self, share: range, told: object) -> "Running | None":
        """A process for what is left of a share; what one that crashed had not told yet is read again."""
        left = tuple(number for number in share if number not in self.done)
        if not left:
            return None
        at = self.context.Value("q", left[0])
        process = self.context.Process(target=work, args=(self.seed, left, self.samples, at, told), daemon=True)
        process.start()
        return Running(process, at, left[0], time.monotonic() + STARTING)

    def _watched(self, one: "Running | None", share: range, told: object) -> "Running | None":
        if one is None:
            return None
        number = one.at.value
        if not one.process.is_alive():
            self._hear(told)
            if number < 0:
                return None
            self._failed(number, f"crash, exit status {one.process.exitcode}")
            return self._started(share, told)
        if number != one.number:
            return Running(one.process, one.at, number, time.monotonic())
        if number >= 0 and time.monotonic() - one.since > LONGEST:
            one.process.kill()
            one.process.join()
            self._hear(told)
            self._failed(number, "hangs")
            return self._started(share, told)
        return one

    def _failed(self, number: int, wrong: str) -> None:
        with tempfile.TemporaryDirectory() as folder:
            kind, _ = put(self.samples, self.seed, number, Path(folder))
        self._take(number, kind, False, 0.0, wrong)

    def _hear(self, told: "object") -> None:
        with suppress(Exception):
            while True:
                self._take(*told.get(timeout=0.2))  # type: ignore[attr-defined]

    def _take(self, number: int, kind: str, good: bool, spent: float, wrong: str) -> None:
        if number in self.done:
            return
        self.done.add(number)
        outcome = self.outcomes.setdefault(kind, Outcome())
        outcome.files += 1
        outcome.read += good
        outcome.slowest = max(outcome.slowest, spent)
        if wrong:
            outcome.failures.append((number, wrong))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a campaign and print what came out; exit status 1 where something failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=100_000, help="damaged files (default: 100000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    parser.add_argument("--files", type=Path, help="a folder of real files to damage as well")
    parser.add_argument("--kinds", nargs="*", help="these kinds alone")
    parser.add_argument("--keep", type=Path, help="a folder for the files that failed")
    parser.add_argument("--only", type=int, help="one number: its traceback, and its file in --keep")
    given = parser.parse_args(arguments)
    found = [one for one in samples(given.seed, given.files) if not given.kinds or one.kind in given.kinds]
    if given.only is not None:
        return _only(found, given)
    began = time.monotonic()
    outcomes = Campaign(given.seed, given.count, given.workers, found).run()
    return _told(found, given, outcomes, time.monotonic() - began)


def _only(found: Sequence[Sample], given: argparse.Namespace) -> int:
    folder = given.keep or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    kind, path = put(found, given.seed, given.only, folder)
    print(f"{kind}: {path}")
    print("read" if read(path) else "refused")
    return 0


def _told(found: Sequence[Sample], given: argparse.Namespace, outcomes: Mapping[str, Outcome], seconds: float) -> int:
    print(f"{'kind':20} {'files':>7} {'read':>7} {'refused':>7} {'slowest':>8} failures")
    for kind, one in sorted(outcomes.items()):
        failed = len(one.failures)
        refused = one.files - one.read - failed
        print(f"{kind:20} {one.files:7} {one.read:7} {refused:7} {one.slowest:7.2f}s {failed}")
    failures = [(number, kind, wrong) for kind, one in outcomes.items() for number, wrong in one.failures]
    for (kind, wrong), count in Counter((kind, wrong) for _, kind, wrong in failures).most_common():
        first = min(number for number, its, same in failures if (its, same) == (kind, wrong))
        print(f"FAILED {count} times, {kind}: {wrong}; first with --only {first}")
        if given.keep:
            folder = given.keep / str(first)
            folder.mkdir(parents=True, exist_ok=True)
            put(found, given.seed, first, folder)
    total = sum(one.files for one in outcomes.values())
    print(f"seed {given.seed}: {total} damaged files, {len(failures)} failures, {seconds:.0f} s")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
