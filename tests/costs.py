"""Measures what tests cost: `pytest --cost` writes CPU and wall of each one and shows the dearest.

CPU is that of the process of the tests, all threads, and of child processes that end in setup or call. What ends in a
teardown has mostly served several tests, a browser for example: it has a line of its own.
"""

import csv
import os
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any

import pytest

TABLE = "test-costs.csv"
DEAREST = 20


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("cost")
    group.addoption("--cost", action="store_true", help=f"write CPU and wall of each test to {TABLE}; show the dearest")
    group.addoption(
        "--most-cpu",
        type=float,
        metavar="SECONDS",
        help="fail if a test without the mark slow takes more CPU; implies --cost",
    )


def pytest_configure(config: pytest.Config) -> None:
    if config.option.cost or config.option.most_cpu:
        config.pluginmanager.register(CpuMeter())
        if not hasattr(config, "workerinput"):  # not in the processes of pytest-xdist
            config.pluginmanager.register(CostTable(config))


class CpuMeter:
    """Puts the CPU seconds of setup, call and teardown on their reports."""

    def __init__(self) -> None:
        self._before = os.times()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self) -> None:
        self._before = os.times()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Iterator[Any]:
        report = yield
        before, now = self._before, os.times()
        own = now.user + now.system - before.user - before.system
        children = now.children_user + now.children_system - before.children_user - before.children_system
        report.shared = children if report.when == "teardown" else 0.0
        report.cpu, self._before = own + children - report.shared, now
        report.slow = item.get_closest_marker("slow") is not None
        return report


class CostTable:
    """Collects the reports of all processes, and writes and prints what the tests cost."""

    def __init__(self, config: pytest.Config) -> None:
        self._path, self._limit = config.rootpath / TABLE, config.option.most_cpu
        self._cpu: Counter[str] = Counter()
        self._wall: Counter[str] = Counter()
        self._slow: set[str] = set()
        self._shared = 0.0  # CPU seconds of processes that ended in a teardown

    def pytest_runtest_logreport(self, report: Any) -> None:
        if not hasattr(report, "cpu"):  # of a process that died
            return
        self._cpu[report.nodeid] += report.cpu
        self._wall[report.nodeid] += report.duration
        self._shared += report.shared
        if report.slow:
            self._slow.add(report.nodeid)

    @property
    def _too_dear(self) -> list[str]:
        if self._limit is None:
            return []
        return [test for test, cpu in self._cpu.most_common() if cpu > self._limit and test not in self._slow]

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        if self._too_dear and exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        self._write()
        write = terminalreporter.write_line
        terminalreporter.section("cost")
        write("  tests    CPU s   wall s  folder")
        folders: dict[str, list[str]] = defaultdict(list)
        for test in self._cpu:
            folders[folder(test)].append(test)
        for name in sorted(folders, key=lambda name: -sum(self._cpu[test] for test in folders[name])):
            write(self._row(name, folders[name]))
        write(f"{self._shared:16.1f}           processes that ended in a teardown")
        write(self._row("all tests", list(self._cpu)))
        write("")
        write(f"The {DEAREST} dearest (CPU s, wall s):")
        for test, cpu in self._cpu.most_common(DEAREST):
            write(f"{cpu:8.2f} {self._wall[test]:8.2f}  {test}")
        for test in self._too_dear:
            seconds = f"{self._cpu[test]:.1f} s of CPU, at most {self._limit:g} s"
            write(f"{test} took {seconds}. Make it smaller or mark it slow.")

    def _row(self, name: str, tests: list[str]) -> str:
        cpu, wall = (sum(each[test] for test in tests) for each in (self._cpu, self._wall))
        return f"{len(tests):7} {cpu:8.1f} {wall:8.1f}  {name}"

    def _write(self) -> None:
        with self._path.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["test", "cpu", "wall"])
            rows.writerows([test, f"{cpu:.3f}", f"{self._wall[test]:.3f}"] for test, cpu in self._cpu.most_common())


def folder(test: str) -> str:
    """Return the folder by which a test is counted: two levels, as in `tests/optimize`.

    >>> folder("tests/importers/fmu/test_trajectories.py::test_one")
    'tests/importers'
    """
    return "/".join(PurePosixPath(test.split("::")[0]).parent.parts[:2])
