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

from fuzz_networks import damaged_network
from fuzz_sample import Sample
from fuzz_samples import samples

LONGEST = 20.0  # s, for one file; half of it of computing, which other programs do not prolong
STARTING = 60.0  # s more for the imports
MOST_MEMORY = 1 << 30  # bytes above what the process had before its first file
ADDRESSES = 16 << 30  # bytes of address space, so that a bomb ends in an error and not the machine
LONGEST_MESSAGE = 2000  # characters
REPORT = 5.0  # s between lines of progress
_NUMBER = re.compile(rb"\d+(?:\.\d+)?")
_ABSURD = [*b"0 -1 1000000000 99999999999999999999 1e308 -1e999 nan 65535 0x7fffffff".split(), b""]
_EXTREME = (b"\x00", b"\xff", b"\x7f", b"\x80", b"\x01")


def damaged(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    """A copy of a file with one to four kinds of damage; `other` is a file of the same kind."""
    if raw.startswith(b"PK\x03\x04") and draw.random() < 0.7:
        return _repack(raw, draw)
    if raw.startswith(b"\x1f\x8b") and draw.random() < 0.5:
        content = gzip.decompress(raw)
        return gzip.compress(draw.choice(_DAMAGES)(content, content, draw), mtime=0)
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        raw = draw.choice(_DAMAGES)(raw, other, draw)
    return raw


def _truncate(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    return raw[: draw.randrange(len(raw) + 1)]


def _change_bytes(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    content = bytearray(raw)
    for _ in range(draw.choice((1, 2, 8, 64))):
        if content:
            content[draw.randrange(len(content))] = draw.randrange(256)
    return bytes(content)


def _insert_extreme(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    """A field of 1, 2, 4 or 8 bytes, early in the file as a rule, with the largest or the smallest number."""
    width, near = draw.choice((1, 2, 4, 8)), draw.choice((64, 512, len(raw) or 1))
    at = draw.randrange(min(near, len(raw)) + 1)
    return raw[:at] + draw.choice(_EXTREME) * width + raw[at + width :]


def _scale_integer(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    """An aligned integer made larger by a power of two: sizes that are wrong, but not absurd."""
    width = draw.choice((2, 4, 8))
    slots = len(raw) // width
    if not slots:
        return raw
    at = width * draw.randrange(min(slots, draw.choice((64, 1024, slots))))
    order = draw.choice(("little", "little", "big"))
    number = max(int.from_bytes(raw[at : at + width], order), 1) << draw.randrange(1, 24)
    return raw[:at] + (number % (1 << 8 * width)).to_bytes(width, order) + raw[at + width :]


def _replace_number(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    """A number of a text replaced."""
    chosen = list(_NUMBER.finditer(raw[: 1 << 16]))
    if not chosen:
        return _change_bytes(raw, other, draw)
    process = draw.choice(chosen)
    return raw[: process.start()] + draw.choice(_ABSURD) + raw[process.end() :]


def _remove_lines(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    lines = raw.splitlines(keepends=True)
    at = draw.randrange(len(lines) + 1)
    return b"".join(lines[:at] + lines[at + draw.choice((1, 1, 5)) :])


def _repeat(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    begin, end = sorted((draw.randrange(len(raw) + 1), draw.randrange(len(raw) + 1)))
    return raw[:end] + raw[begin:end] * draw.choice((1, 1, 20)) + raw[end:]


def _delete(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    begin = draw.randrange(len(raw) + 1)
    return raw[:begin] + raw[begin + draw.choice((1, 4, 100)) :]


def _splice(raw: bytes, other: bytes, draw: random.Random) -> bytes:
    return raw[: draw.randrange(len(raw) + 1)] + other[draw.randrange(len(other) + 1) :]


def _repack(raw: bytes, draw: random.Random) -> bytes:
    """An archive with one member damaged, whose sums are right all the same."""
    repacked = BytesIO()
    try:
        with zipfile.ZipFile(BytesIO(raw)) as before, zipfile.ZipFile(repacked, "w", zipfile.ZIP_DEFLATED) as after:
            names = before.namelist()
            chosen = draw.choice(names)
            for name in names:
                content = before.read(name)
                after.writestr(name, draw.choice(_DAMAGES)(content, content, draw) if name == chosen else content)
    except (zipfile.BadZipFile, ValueError):
        return _change_bytes(raw, raw, draw)
    return repacked.getvalue()


_DAMAGES: tuple[Callable[[bytes, bytes, random.Random], bytes], ...] = (
    _truncate,
    _change_bytes,
    _change_bytes,
    _insert_extreme,
    _insert_extreme,
    _scale_integer,
    _scale_integer,
    _replace_number,
    _replace_number,
    _remove_lines,
    _repeat,
    _delete,
    _splice,
)


def put(samples: Sequence[Sample], seed: int, number: int, folder: Path) -> tuple[str, Path]:
    """Write damaged file number so and so with the files beside it; its kind and its path."""
    draw = random.Random(f"{seed}/{number}")
    kinds = sorted({sample.kind for sample in samples})
    kind = kinds[number % len(kinds)]
    same = [sample for sample in samples if sample.kind == kind]
    chosen, other = draw.choice(same), draw.choice(same)
    for name, content in chosen.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    target, content = folder / chosen.name, chosen.files[chosen.name]
    if target.suffix == ".onnx" and draw.random() < 0.7:
        target.write_bytes(damaged_network(content, folder, draw))
    else:
        target.write_bytes(damaged(content, other.files[other.name], draw))
    return kind, target


def read(damaged: Path) -> bool:
    """Read a damaged file, and those beside it that may refer to it; whether it holds something."""
    good = _read(damaged)
    for other in sorted(damaged.parent.iterdir()):
        if other != damaged and other.is_file():
            _read(other)
    return good


def _read(path: Path) -> bool:
    """Read a file as the commands do. Whatever is no finding is raised."""
    from kennfeld import calfiles, measurement
    from kennfeld.base.errors import InputError
    from kennfeld.terminal.file_info import describe_file, text_lines

    good = False
    databases = sorted(path.parent.glob("*.dbc"))
    for work in (
        lambda: text_lines(describe_file(path, dbc=[str(database) for database in databases])),
        *([lambda: _import_model(path)] if path.suffix in (".slx", ".mdl") else []),
        *([lambda: _import_classes(path)] if path.suffix in (".esdl", ".axl", ".amd") else []),
        *([lambda: _import_tasks(path)] if path.suffix == ".app" else []),
        *([lambda: _read_functions(path)] if path.suffix in (".c", ".py") else []),
        *([lambda: _evaluate_network(path)] if path.suffix == ".onnx" else []),
        *([lambda: _import_fmu(path)] if path.suffix == ".fmu" else []),
        *([lambda: _check_project(path)] if path.suffix == ".toml" else []),
        lambda: calfiles.read_with_findings(path),
        lambda: measurement.read(path, raster=0.1, dbc=databases),
        lambda: measurement.read(path, dbc=databases),
    ):
        try:
            work()
            good = True
        except InputError as error:
            if not error.findings or not all(finding.message for finding in error.findings):
                raise AssertionError("an error without findings") from error
            if any("\n" in finding.message or len(finding.message) > LONGEST_MESSAGE for finding in error.findings):
                raise AssertionError("a message that is not one short line") from error
    return good


def _check_project(path: Path) -> None:
    """Check a project with all its files."""
    from kennfeld.project import Project

    Project.read(path).check()


def _evaluate_network(path: Path) -> None:
    """Read a network and evaluate it at one point."""
    from kennfeld.graph.interpreter import evaluate
    from kennfeld.importers.onnx.importing import onnx

    model = onnx(path)
    evaluate(model.graph, {name: [0.5] for name in model.graph.inputs} or {"none": [0.0]}, model.values)


def _import_fmu(path: Path) -> None:
    """Import an FMU with each interface, which runs none of its code."""
    from kennfeld.base.errors import InputError
    from kennfeld.importers.fmu.importing import INTERFACES, fmu

    for interface in INTERFACES:
        with suppress(InputError):
            fmu(path, interface=interface)


def _read_functions(path: Path) -> None:
    """Read each function of a file, as a project does."""
    from kennfeld.base.errors import InputError
    from kennfeld.models.function_files import list_functions, read_function_file

    for function in list_functions(path):
        with suppress(InputError):
            read_function_file(f"{path.name}:{function.name}", path.parent)


def _import_model(path: Path) -> None:
    """Import a model as a project does, with the script beside it."""
    from kennfeld.importers.simulink.importing import simulink

    simulink(path, parameters=sorted(path.parent.glob("*.m")))


def _import_classes(path: Path) -> None:
    """Import each class of a file with all of its methods."""
    from kennfeld.base.errors import InputError
    from kennfeld.importers.ascet.importing import classes_of, import_esdl

    for item in classes_of(path):
        with suppress(InputError):  # a class that cannot be chosen by its name alone
            import_esdl(path, item.name, [method.name for method in item.methods], startup=[])


def _import_tasks(path: Path) -> None:
    """Import all periodic tasks of an application."""
    from kennfeld.importers.ascet.importing import import_esdl

    import_esdl(path, task="*")


@dataclass
class Outcome:
    """Numbers of files of a kind, and the failures among them."""

    files: int = 0
    read: int = 0
    slowest: float = 0.0
    failures: list[tuple[int, str]] = field(default_factory=list)


def work(seed: int, numbers: Sequence[int], samples: Sequence[Sample], at: "object", queue: "object") -> None:
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
            began, wrong, good = time.process_time(), "", False
            try:
                good = read(path)
            except BaseException as error:
                last = traceback.extract_tb(error.__traceback__)[-1]
                wrong = f"{type(error).__name__}: {str(error)[:200]} ({Path(last.filename).name}:{last.lineno})"
            spent = time.process_time() - began
            before = before or _most_memory()
            if not wrong and _most_memory() > before + MOST_MEMORY:
                wrong, before = "more than a gigabyte of memory", _most_memory()
            if not wrong and spent > LONGEST / 2:
                wrong = f"took {spent:.1f} s"
            queue.put((number, kind, good, spent, wrong))  # type: ignore[attr-defined]
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
        queue = self.context.Queue()
        running = [self._start(share, queue) for share in self.shares]
        reported = time.monotonic()
        while any(running):
            self._hear(queue)
            pairs = zip(running, self.shares, strict=True)
            running = [self._watch(process, share, queue) for process, share in pairs]
            if time.monotonic() - reported > REPORT:
                reported = time.monotonic()
                done = sum(outcome.files for outcome in self.outcomes.values())
                failed = sum(len(outcome.failures) for outcome in self.outcomes.values())
                print(f"{done} files, {failed} failures", file=sys.stderr, flush=True)
        self._hear(queue)
        return self.outcomes

    def _start(self, share: range, queue: object) -> "Running | None":
        """A process for what is left of a share; what a crashed one had not reported yet is read again."""
        remaining = tuple(number for number in share if number not in self.done)
        if not remaining:
            return None
        at = self.context.Value("q", remaining[0])
        process = self.context.Process(target=work, args=(self.seed, remaining, self.samples, at, queue), daemon=True)
        process.start()
        return Running(process, at, remaining[0], time.monotonic() + STARTING)

    def _watch(self, running: "Running | None", share: range, queue: object) -> "Running | None":
        if running is None:
            return None
        number = running.at.value
        if not running.process.is_alive():
            self._hear(queue)
            if number < 0:
                return None
            self._add_failure(number, f"crash, exit status {running.process.exitcode}")
            return self._start(share, queue)
        if number != running.number:
            return Running(running.process, running.at, number, time.monotonic())
        if number >= 0 and time.monotonic() - running.since > LONGEST:
            running.process.kill()
            running.process.join()
            self._hear(queue)
            self._add_failure(number, "hangs")
            return self._start(share, queue)
        return running

    def _add_failure(self, number: int, wrong: str) -> None:
        with tempfile.TemporaryDirectory() as folder:
            kind, _ = put(self.samples, self.seed, number, Path(folder))
        self._take(number, kind, False, 0.0, wrong)

    def _hear(self, queue: "object") -> None:
        with suppress(Exception):
            while True:
                self._take(*queue.get(timeout=0.2))  # type: ignore[attr-defined]

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
    options = parser.parse_args(arguments)
    chosen = [
        sample for sample in samples(options.seed, options.files) if not options.kinds or sample.kind in options.kinds
    ]
    if options.only is not None:
        return _read_one(chosen, options)
    began = time.monotonic()
    outcomes = Campaign(options.seed, options.count, options.workers, chosen).run()
    return _print_outcomes(chosen, options, outcomes, time.monotonic() - began)


def _read_one(chosen: Sequence[Sample], options: argparse.Namespace) -> int:
    folder = options.keep or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    kind, path = put(chosen, options.seed, options.only, folder)
    print(f"{kind}: {path}")
    print("read" if read(path) else "refused")
    return 0


def _print_outcomes(
    chosen: Sequence[Sample], options: argparse.Namespace, outcomes: Mapping[str, Outcome], seconds: float
) -> int:
    print(f"{'kind':20} {'files':>7} {'read':>7} {'refused':>7} {'slowest':>8} failures")
    for kind, outcome in sorted(outcomes.items()):
        failed = len(outcome.failures)
        refused = outcome.files - outcome.read - failed
        print(f"{kind:20} {outcome.files:7} {outcome.read:7} {refused:7} {outcome.slowest:7.2f}s {failed}")
    failures = [(number, kind, wrong) for kind, outcome in outcomes.items() for number, wrong in outcome.failures]
    for (kind, wrong), count in Counter((kind, wrong) for _, kind, wrong in failures).most_common():
        first = min(number for number, its, same in failures if (its, same) == (kind, wrong))
        print(f"FAILED {count} times, {kind}: {wrong}; first with --only {first}")
        if options.keep:
            folder = options.keep / str(first)
            folder.mkdir(parents=True, exist_ok=True)
            put(chosen, options.seed, first, folder)
    total = sum(outcome.files for outcome in outcomes.values())
    print(f"seed {options.seed}: {total} damaged files, {len(failures)} failures, {seconds:.0f} s")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
