"""Samples of a zoomed strip, within the size of a page, with inputs and nodes; the same over partitions."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from kennfeld.base.trace_envelope import TraceEnvelope
from kennfeld.report import document, strip_details
from kennfeld.report.coded_numbers import decode_numbers
from kennfeld.report.strip_details import DetailRoom
from tests.report.report_projects import Page, Workshop

COUNT = 30_000
LAG = """[parameters.Lag]
initial = 0.5
bounds = [0.1, 5]
[parameters.C]
x = { input = "x", count = 4 }
initial = 0
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A recording of a lag, and its result; no test changes them."""
    random = np.random.default_rng(0)
    time = 0.1 * np.arange(COUNT)
    x = 5 + 4 * np.sin(0.03 * time)
    measured = 100 * x + random.normal(0, 0.3, COUNT)
    measured[500:600] = np.nan
    columns = {"time [s]": time.round(1), "x": x.round(4), "m": measured.round(3)}
    shop = Workshop(tmp_path_factory.mktemp("drive"))
    project = shop.project("settled[degC] = C(x)\ny = PT1(settled, Lag)\n", LAG, columns)
    return SimpleNamespace(project=project, result=project.calibrate())


@pytest.fixture(scope="module")
def report(drive):
    return Page(document(drive.project, drive.result))


def data_of(page):
    return json.loads(page.text.split('id="report-data">')[1].split("</script>")[0])


@pytest.mark.slow
def test_samples_of_a_strip_are_accurate_to_a_small_part_of_the_errors(drive, report):
    (strip,) = report.figures("strip")
    detail = strip["detail"]
    assert (detail["whole"], detail["size"]) == (True, 1)
    np.testing.assert_allclose(decode_numbers(detail["x"]), 0.1 * np.arange(COUNT), atol=1e-4)
    problem = drive.project.problem()
    bound = problem.bind(problem.datasets[0])
    measured = bound.channel("m")
    errors = strip_details._range(np.array([value for value in strip["error"] if value is not None]))
    decoded = decode_numbers(detail["traces"]["measured"])
    np.testing.assert_array_equal(np.isnan(decoded), np.isnan(measured))
    assert np.nanmax(np.abs(decoded - measured)) <= errors / 4000


def test_inputs_and_nodes_of_a_strip_have_their_units(report):
    signals = data_of(report)["signals"]
    (dataset,) = signals.values()
    offered = [(each["name"], each["unit"], each["kind"]) for each in dataset["signals"]]
    assert offered == [("x", "", "input"), ("settled", "degC", "node")]
    x = decode_numbers(dataset["signals"][0]["values"])
    np.testing.assert_allclose(x, 5 + 4 * np.sin(0.03 * 0.1 * np.arange(COUNT)), atol=2e-4)


def test_a_page_keeps_to_its_size_with_any_number_of_samples(drive, opened, monkeypatch):
    monkeypatch.setattr(strip_details, "TOTAL_NUMBERS", 50_000)
    page = opened(document(drive.project, drive.result))
    (strip,) = page.figures("strip")
    detail = strip["detail"]
    assert not detail["whole"]
    assert detail["size"] > 1
    assert {"errorBefore", "error"} <= set(detail["traces"])
    numbers = sum(trace["count"] for trace in detail["traces"].values())
    numbers += sum(signal["values"]["count"] for own in data_of(page)["signals"].values() for signal in own["signals"])
    assert numbers <= 50_000
    assert decode_numbers(detail["x"]).size == detail["traces"]["error"]["count"] / 2


def test_strips_have_samples_within_the_size_of_a_page():
    views = [TraceEnvelope(count, 4000) for count in (250_000, 250_000, 250_000, 1000, 5_000_000)]
    fits = [SimpleNamespace(data=SimpleNamespace(is_timed=True, count=view.count)) for view in views]
    room = DetailRoom.of(fits[:4], views[:4])
    assert [None if groups is None else groups.size for groups in room.groups] == [1, 1, 1, None]
    assert room.signals == pytest.approx((3e6 - 3 * 750_000) / 4)
    room = DetailRoom.of(fits, views)
    assert [None if groups is None else groups.size for groups in room.groups[:4]] == [1, 1, 1, None]
    assert 1 < room.groups[4].size < views[4].size / 2
    numbers = 3 * 750_000 + 5 * 2 * room.groups[4].groups
    assert numbers + 5 * room.signals <= 3_000_000


@pytest.mark.slow
def test_points_without_time_have_no_details(shop, opened):
    columns = {"x": np.arange(9000.0), "m": np.arange(9000.0)}
    project = shop.project("y = a * x\n", "[parameters.a]\ninitial = 0\n", columns)
    page = opened(document(project, project.calibrate()))
    assert all("detail" not in strip for strip in page.figures("strip"))
    assert data_of(page)["signals"] == {}
