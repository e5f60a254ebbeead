"""Numbers of the documents that no command prints are those of the fits that they describe.

What documents show below a command is compared in `test_examples.py`.
"""

import re
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.project.demo import write
from kennfeld.project.demo.petrol_engine import best_spark, drag, torque

DOCS = Path(__file__).parents[1] / "docs"
MAPS = ("MapOptTorque", "MapDragTorque")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The folder of the torque demo."""
    return write("torque", tmp_path_factory.mktemp("torque") / "demo").parent


@pytest.fixture(scope="module")
def known(demo):
    """The fit of the torque demo."""
    return kf.Project.read(demo / "kennfeld.toml").calibrate()


@pytest.fixture(scope="module")
def load_only(demo):
    """The fit to the points under load."""
    return kf.Project.read(demo / "load-only.toml").calibrate()


def page(name):
    return " ".join((DOCS / name).read_text(encoding="utf-8").split())


def rows(name, first):
    """Return the rows of the table of a page whose head begins with a cell, as lists of cells."""
    table = (DOCS / name).read_text(encoding="utf-8").partition(f"\n| {first} |")[2].partition("\n\n")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def extremes(result, name):
    """Return the smallest and the largest standard deviation of the values of a table."""
    return np.min(result.trust.deviation[name]), np.max(result.trust.deviation[name])


def test_the_method_states_noise_and_freedom_of_the_torque_demo(known):
    text = page("method.md")
    noise = float(re.search(r"noise of the torque is estimated as ([\d.]+) Nm", text)[1])
    values = int(re.search(r"determine: (\d+) of the 519 values", text)[1])
    assert known.trust.noise["TorquePredict"] == pytest.approx(noise, rel=2e-3)
    assert sum(np.sum(leverage) for leverage in known.trust.leverage.values()) == pytest.approx(values, abs=1)


def test_the_method_states_the_values_of_the_efficiency(known):
    name = "CurveEtaDeltaSpark"
    at = list(known.parameters[name].axes[0].breakpoints)
    for point, value, samples, deviation, scatter, leverage in rows("method.md", "breakpoint"):
        i = at.index(float(point.removesuffix(" deg")))
        assert known.parameters[name].values[i] == pytest.approx(float(value), abs=1e-3)
        assert known.trust.samples[name][i] == int(samples)
        assert known.trust.deviation[name][i] == pytest.approx(float(deviation), rel=0.05)
        assert known.trust.scatter[name][i] == pytest.approx(float(scatter), rel=0.05)
        assert known.trust.leverage[name][i] == pytest.approx(float(leverage), abs=0.01)


def test_the_method_states_the_descents_of_the_torque_demo(known):
    costs = {}
    for line in known.trace:
        costs[line.stage] = line.cost
    for stages, _, shown in rows("method.md", "`stage`"):
        names = re.findall(r"`([^`]+)`", stages)
        names = [names[0], *(f"smooth {name}" for name in names[1:])]
        assert [costs[name] for name in names] == pytest.approx([float(cost) for cost in shown.split(",")], rel=1e-3)


def test_the_page_on_trust_states_the_deviations_of_both_projects(demo, load_only, known):
    project = (demo / "load-only.toml").read_text(encoding="utf-8")
    pin = "pin = [{ at = [0], value = 1 }"
    assert project.count(pin) == 1
    (demo / "pinned.toml").write_text(project.replace(pin, f"{pin}, {{ at = [40], value = 0.68 }}"), encoding="utf-8")
    pinned = kf.Project.read(demo / "pinned.toml").calibrate()
    table = {
        row[0].split("`")[1]: row[1:]
        for row in rows("how-to/trust.md", "standard deviation of the values (smallest to largest)")
    }
    assert set(table) == set(MAPS)
    for name, ranges in table.items():
        for result, shown in zip((load_only, pinned, known), ranges, strict=True):
            assert extremes(result, name) == pytest.approx([float(end) for end in shown.split(" to ")], rel=0.1)


def test_the_first_steps_state_the_range_of_the_drag(load_only):
    low, high = map(float, re.search(r"ranges from (\d+) to (\d+) Nm", page("get-started.md")).groups())
    drag = load_only.parameters["MapDragTorque"].values
    assert [drag.min(), drag.max()] == pytest.approx([low, high], abs=1)


def test_the_first_steps_state_the_distance_of_the_maps_from_the_engine(load_only, known):
    engine = {
        "MapOptTorque": lambda speed, air: torque(speed, air, best_spark(speed, air)) + drag(speed),
        "MapDragTorque": lambda speed, air: drag(speed + 0 * air),
        "MapOptIgnition": best_spark,
    }
    table = {row[0].strip("`"): row[1:] for row in rows("get-started.md", "map")}
    assert set(table) == set(engine)
    for name, shown in table.items():
        for result, distance in zip((load_only, known), shown, strict=True):
            fitted = result.parameters[name]
            true = engine[name](*np.meshgrid(*(axis.breakpoints for axis in fitted.axes), indexing="ij"))
            rmse = np.sqrt(np.mean((fitted.values - true) ** 2))
            assert rmse == pytest.approx(float(distance.split()[0]), abs=0.06, rel=0.01)


def test_the_map_without_limits_falls_as_often_as_the_page_on_limits_says(demo):
    falling, steps = map(
        int, re.search(r"falls in (\d+) of its (\d+) steps", page("how-to/monotonic-maps.md")).groups()
    )
    points = kf.read(demo / "motored.csv")
    grid = kf.Map(
        "MapDrag",
        kf.Axis(np.linspace(700, 6200, 11), input="Speed"),
        kf.Axis(np.linspace(20, 100, 5), input="Rel_Airmass"),
        np.full((11, 5), 20.0),
    )
    result = kf.calibrate("drag = MapDrag(Speed, Rel_Airmass)", points, grid, target="MotoringTorque", smoothness=0.01)
    slopes = np.diff(result.parameters["MapDrag"].values, axis=0)
    assert (int(np.sum(slopes < 0)), slopes.size) == (falling, steps)
