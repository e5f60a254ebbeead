"""The report of data in partitions shows the strips, the numbers and the samples that it shows of all data at once."""

import re
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import pytest

from kennfeld.analysis.residuals import residuals
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.partitions import split_files
from kennfeld.optimize.problem.problem import partitions_of
from kennfeld.project import Project, partitioned_loading
from kennfeld.report import document
from tests.draws import mostly_slow
from tests.project.partitioned_projects import (
    SHIFTED,
    STEADY,
    TIMED,
    in_partitions,
    write_shifted,
    write_steady,
    write_timed,
)
from tests.report.report_projects import Page

SHORT = '\n[optimizer]\ncontinuation = "off"\nmax_iterations = 4\n'
PAUSED = """
[model]
file = "line.kf"
[[dataset]]
name = "drives"
files = ["pause_*.csv"]
[parameters.a]
initial = 1.0
[[criterion]]
node = "y"
target = { channel = "m" }
"""


def write_steady_points(folder):
    return write_steady(folder, samples=320, text=STEADY + SHORT)


def write_drives(folder):
    return write_timed(folder, text=TIMED + SHORT)


def write_paused_drives(folder):
    """Recordings with pauses of a function without memory, whose errors are correlated; files are cut anywhere."""
    random = np.random.default_rng(4)
    (folder / "line.kf").write_text("y = a * x\n")
    for number, count in enumerate((600, 800)):
        time = 0.1 * np.arange(count) + 60 * (np.arange(count) > 400)
        x = np.sin(0.05 * time)
        m = 2 * x + 0.2 * np.sin(0.21 * time + number) + random.normal(0, 0.02, count)
        x[50:60] = np.nan
        rows = (f"{t:.1f},{a:.8g},{b:.8g}".replace("nan", "") for t, a, b in zip(time, x, m, strict=True))
        (folder / f"pause_{number}.csv").write_text("\n".join(["time [s],x,m", *rows]))
    (folder / "kennfeld.toml").write_text(PAUSED + SHORT)
    return folder / "kennfeld.toml"


def write_shifted_drives(folder):
    """Recordings of a function without memory with a shift to be estimated; cut parts lack no sample at their cuts."""
    return write_shifted(folder, "none", text=SHIFTED + SHORT, files=2, samples=420)


WRITERS = [write_steady_points, write_drives, write_paused_drives]


def same(first, second):
    """Compare figures; numbers may differ in their last digit, as sums over partitions are added in another order."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[key], second[key]) for key in first)
    if isinstance(first, list):
        return len(first) == len(second) and all(map(same, first, second))
    return first == pytest.approx(second, rel=2e-4, abs=1e-9) if isinstance(first, float) else first == second


@dataclass
class Plain:
    """A project whose data are all evaluated at once, and its result."""

    path: Path
    result: Result

    @cached_property
    def page(self) -> Page:
        return Page(document(Project.read(self.path), self.result))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return the result of a function that writes a project, made once."""

    def make(write):
        path = write(tmp_path_factory.mktemp(write.__name__))
        return Plain(path, Project.read(path).calibrate())

    return cache(make)


def page_of_partitions(plain, size, monkeypatch):
    """Return the report on the same result, of partitions of which the client holds little."""
    monkeypatch.setattr(partitioned_loading, "EXCERPT", 400)
    parted = in_partitions(plain.path, size)
    whole = Project.read(plain.path).problem().datasets
    assert sum(data.samples for data in parted.problem().datasets) < sum(data.samples for data in whole)
    return Page(document(parted, plain.result))


@pytest.mark.slow
@pytest.mark.parametrize("write", mostly_slow(WRITERS, [write_drives, write_paused_drives]))
@pytest.mark.parametrize("size", mostly_slow([300, 10**6], 1))
def test_figures_are_those_of_all_data(plain, write, size, monkeypatch):
    whole, parted = plain(write).page, page_of_partitions(plain(write), size, monkeypatch)
    assert len(parted.data["figures"]) == len(whole.data["figures"])
    for figure, other in zip(parted.data["figures"], whole.data["figures"], strict=True):
        for key in other:
            assert same(figure[key], other[key]), (other["kind"], key)
    kinds = {figure["kind"] for figure in whole.data["figures"]}
    assert {"strip", "scatter", "histograms"} <= kinds
    assert ("cells" in kinds) != (write is write_paused_drives)
    assert ("autocorrelation" in kinds) == (write is not write_steady_points)


@pytest.mark.parametrize("write", mostly_slow(WRITERS, [write_drives]))
def test_tables_are_those_of_all_data(plain, write, monkeypatch):
    texts = []
    for page in (plain(write).page, page_of_partitions(plain(write), 300, monkeypatch)):
        assert "excerpt" not in page.words_in_a_row
        below_contents = page.words_in_a_row.partition("Settings and files")[2]
        texts.append(re.search(r" Result .*? Search Cost", below_contents)[0])
    assert "The worst samples" in texts[0]
    assert texts[1] == texts[0]


@pytest.mark.parametrize("write", mostly_slow(WRITERS, [write_drives]))
def test_strips_and_dots_are_bounded(plain, write, monkeypatch):
    monkeypatch.setattr("kennfeld.report.drawings.TRACE_POINTS", (40, 100))
    monkeypatch.setattr("kennfeld.report.drawings.SCATTER_POINTS", (20, 50))
    pages = (replace(plain(write)).page, page_of_partitions(plain(write), 300, monkeypatch))
    for page in pages:
        for strip in page.figures("strip"):
            assert not strip["whole"]
            assert len(strip["x"]) == len(strip["measured"]) <= 102
    for kind in ("strip", "scatter", "histograms"):
        assert same(pages[1].figures(kind), pages[0].figures(kind)), kind


@pytest.mark.slow
def test_estimated_shifts_are_those_of_the_result(plain, monkeypatch):
    whole = plain(write_shifted_drives)
    parted = page_of_partitions(whole, 300, monkeypatch)
    for kind in ("strip", "scatter", "histograms", "autocorrelation", "cells"):
        assert whole.page.figures(kind)
        assert same(parted.figures(kind), whole.page.figures(kind)), kind


@pytest.mark.parametrize(("node", "sizes"), [("y", [900]), ("PT1(y, 0.5)", [400, 500])])
def test_a_recording_that_is_cut_at_its_pieces_is_not_joined(tmp_path, node, sizes):
    path = write_paused_drives(tmp_path)
    path.write_text(f'{PAUSED}\n[[limit]]\nnode = "{node}"\nmax = 2.0\n')
    problem = in_partitions(path, 300).problem()
    cut = split_files(0, [problem.partitions.training[0].parts[0].source], [[0, 400]], [900], 300)
    problem = replace(problem, partitions=replace(problem.partitions, training=tuple(cut)))
    assert [partition.samples for partition in partitions_of(problem, 0)] == sizes


@pytest.mark.slow
def test_ranges_of_limited_outputs_are_those_of_all_data(tmp_path, monkeypatch):
    limits = "".join(f'\n[[limit]]\nnode = "{node}"\nmax = 2.0\n' for node in ("y", "PT1(y, 0.5)"))
    path = write_paused_drives(tmp_path)
    path.write_text(PAUSED + limits + SHORT)
    pattern = r" range before range after beyond before beyond after y .*? PT1\(y, 0.5\) (\S+ ){10}"
    whole = Plain(path, Project.read(path).calibrate())
    pages = (whole.page, page_of_partitions(whole, 300, monkeypatch))
    tables = [re.search(pattern, page.words_in_a_row)[0] for page in pages]
    assert tables[1] == tables[0]


def test_a_changed_result_is_noticed(tmp_path):
    path = write_steady_points(tmp_path)
    result = Project.read(path).calibrate()
    quality = tuple(replace(row, rmse_after=2 * row.rmse_after) for row in result.quality)
    text = document(in_partitions(path, 600), replace(result, quality=quality))
    assert "have changed since this result was written" in text


def test_residuals_of_partitions_have_no_errors_of_samples(tmp_path):
    path = write_steady_points(tmp_path)
    (whole,), (parted,) = (
        residuals(p.problem(), p.problem().parameters) for p in (Project.read(path), in_partitions(path, 600))
    )
    assert [row.samples for row in parted.summaries] == [row.samples for row in whole.summaries]
    assert len(whole.errors) == 2
    assert parted.errors == ()
