"""Puts single faults into the package and counts those that the tests catch.

    python -m pytest --cost --cov --cov-context=test
    python scripts/mutants.py --count 100 --seed 0

Lines of the package are drawn at random. In a copy of the project, an operator, a constant or a condition of each is
changed; then the tests that execute the line run until one fails: those that mirror the module, then the others, the
cheapest first.
Which tests execute it is read from the data of the coverage run, and what they cost from its table. `--cpu` bounds what
the tests of a mutant cost in total.
"""

import argparse
import csv
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import accumulate, islice
from pathlib import Path, PurePosixPath
from queue import SimpleQueue
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from mutations import Mutation, candidates, is_fault

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "kennfeld"
SELECTED = "KENNFELD_SELECTED_TESTS"  # names the file that lists the tests to run, in this order
START = 300.0  # s until tests have been collected, on a busy machine
SLOWER = 10.0  # as many times what tests cost is waited for their end; an endless loop is caught
PASSED, NO_TESTS = 0, 5  # exit statuses of pytest


@dataclass(frozen=True)
class Mutant:
    """A mutation of a file of the package, and the tests of its line in the order in which they run.

    Args:
        path: of the file.
        mutation: the fault.
        tests: that execute the line, within the limit of CPU; those that mirror the module first.
        left_out: number of tests that execute the line, too, but exceed the limit.
    """

    path: Path
    mutation: Mutation
    tests: tuple[str, ...]
    left_out: int = 0

    @property
    def text(self) -> str:
        line = self.mutation.apply(self.path.read_text(encoding="utf-8")).splitlines()[self.mutation.line - 1]
        return f"{self.path.relative_to(ROOT).as_posix()}:{self.mutation.line}: {line.strip()}"


def draw(
    count: int, seed: int, tests_by_line: dict[Path, dict[int, list[str]]], costs: dict[str, float], cpu: float
) -> list[Mutant]:
    """Return mutants of lines drawn from all lines of the package that can be mutated."""
    mutants = []
    for path, mutation in islice(faults(seed), count):
        executing = tests_by_line.get(path, {}).get(mutation.line, [])
        tests = in_order(executing, path, costs, cpu)
        mutants.append(Mutant(path, mutation, tests, len(executing) - len(tests)))
    return mutants


def faults(seed: int) -> Iterator[tuple[Path, Mutation]]:
    """Yield one mutation of each line of the package that can be mutated, in random order."""
    by_line: dict[tuple[Path, int], list[Mutation]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for mutation in candidates(path.read_text(encoding="utf-8")):
            by_line.setdefault((path, mutation.line), []).append(mutation)
    generator = random.Random(seed)
    for path, line in generator.sample(sorted(by_line), len(by_line)):
        source = path.read_text(encoding="utf-8")
        if of_line := [mutation for mutation in by_line[path, line] if is_fault(mutation, source)]:
            yield path, generator.choice(of_line)


def in_order(tests: Sequence[str], path: Path, costs: dict[str, float], cpu: float) -> tuple[str, ...]:
    """Return the tests that mirror a file, then the others, the cheapest first, as many as cost at most `cpu` s."""
    order = sorted(tests, key=lambda test: (not mirrors(test, path), costs.get(test, 0.0), test))
    totals = accumulate(costs.get(test, 0.0) for test in order)
    return tuple(test for test, total in zip(order, totals, strict=True) if total <= cpu)


def mirrors(test: str, path: Path) -> bool:
    """Return whether a test is in the folder that mirrors that of a file of the package."""
    folder = path.parent.relative_to(PACKAGE).as_posix()
    return PurePosixPath(test.partition("::")[0]).parent.as_posix() == str(PurePosixPath("tests") / folder)


def executed(data_file: Path) -> dict[Path, dict[int, list[str]]]:
    """Return the tests that execute each line of each file, from the data of a run with `--cov-context=test`.

    Lines that run while a file is imported belong to all tests of the file.
    """
    from coverage import CoverageData

    data = CoverageData(str(data_file))
    data.read()
    root = next(Path(name.partition("/src/kennfeld/")[0]) for name in data.measured_files() if "/src/kennfeld/" in name)
    tests_by_line = {}
    for name in data.measured_files():
        contexts_by_line = data.contexts_by_lineno(name)
        everything = _tests(context for contexts in contexts_by_line.values() for context in contexts)
        tests_by_line[ROOT / Path(name).relative_to(root)] = {
            line: everything if "" in contexts else _tests(contexts) for line, contexts in contexts_by_line.items()
        }
    return tests_by_line


def _tests(contexts: Iterable[str]) -> list[str]:
    return sorted({context.partition("|")[0] for context in contexts if context})


def is_caught(mutant: Mutant, copy: Path, costs: dict[str, float]) -> bool:
    """Run the tests of a mutant on a copy of the project; a mutant that no test executes is not caught."""
    near = [test for test in mutant.tests if mirrors(test, mutant.path)]
    source = mutant.path.read_text(encoding="utf-8")
    target = copy / mutant.path.relative_to(ROOT)
    target.write_text(mutant.mutation.apply(source), encoding="utf-8")
    try:
        return any(fails(tests, copy, costs) for tests in (near, mutant.tests[len(near) :]) if tests)
    finally:
        target.write_text(source, encoding="utf-8")


def fails(tests: Sequence[str], copy: Path, costs: dict[str, float]) -> bool:
    """Return whether one of the tests of a copy of the project fails, or runs without end."""
    selected = copy / "tests.txt"
    selected.write_text("\n".join(tests), encoding="utf-8")
    paths = os.pathsep.join([str(copy / "src"), str(copy / "scripts")])
    environment = os.environ | {"PYTHONPATH": paths, SELECTED: str(selected), "KENNFELD_CACHE": str(copy / "cache")}
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-p", Path(__file__).stem, "-m", "slow or not slow"]
    files = sorted({test.partition("::")[0] for test in tests})
    try:
        run = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *files],
            cwd=copy,
            env=environment,
            timeout=START + SLOWER * sum(costs.get(test, 0.0) for test in tests),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return True
    return run.returncode not in (PASSED, NO_TESTS)


def pytest_collection_modifyitems(config: Any, items: list[Any]) -> None:
    """Keep the selected tests, in their order; this file is a plugin of the runs that it starts."""
    names = Path(os.environ[SELECTED]).read_text(encoding="utf-8").splitlines()
    order = {name: k for k, name in enumerate(names)}
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in order])
    items[:] = sorted((item for item in items if item.nodeid in order), key=lambda item: order[item.nodeid])


def outcome(mutant: Mutant, caught: bool) -> str:
    if caught:
        return "caught"
    if not mutant.tests and not mutant.left_out:
        return "not executed"
    limit = f", {mutant.left_out} beyond the limit of CPU" if mutant.left_out else ""
    return f"missed by {len(mutant.tests)} tests{limit}"


@contextmanager
def copies(count: int) -> Any:
    """Yield a queue of copies of the project, one for each process."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout
    with tempfile.TemporaryDirectory() as folder:
        queue: SimpleQueue[Path] = SimpleQueue()
        for k in range(count):
            copy = Path(folder) / str(k)
            for name in filter(None, listed.split("\0")):
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, copy / name)
            queue.put(copy)
        yield queue


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw mutants, test each, and print those that no test caught."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--coverage", type=Path, default=ROOT / ".coverage", help="data of a run with --cov-context=test"
    )
    parser.add_argument("--costs", type=Path, default=ROOT / "test-costs.csv", help="table of a run with --cost")
    parser.add_argument(
        "--cpu", type=float, default=300.0, metavar="SECONDS", help="what the tests of a mutant may cost in total"
    )
    options = parser.parse_args(arguments)
    with options.costs.open(encoding="utf-8", newline="") as file:
        costs = {row["test"]: float(row["cpu"]) for row in csv.DictReader(file)}
    mutants = draw(options.count, options.seed, executed(options.coverage), costs, options.cpu)

    with copies(options.processes) as queue, ThreadPoolExecutor(options.processes) as pool:

        def test(mutant: Mutant) -> bool:
            copy = queue.get()
            try:
                return is_caught(mutant, copy, costs)
            finally:
                queue.put(copy)

        caught = 0
        for mutant, result in zip(mutants, pool.map(test, mutants), strict=True):
            caught += result
            print(f"{outcome(mutant, result)}: {mutant.text}", flush=True)
    print(f"{caught} of {len(mutants)} caught")


if __name__ == "__main__":
    main()
