"""The test networks of the package onnx give the outputs that come with them, and slopes of differences."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

from onnx import helper

from kennfeld.graph import OPERATIONS
from tests.models.onnx_network.networks import save

SCRIPT = Path(__file__).parents[3] / "scripts" / "onnx_table.py"
LARGEST = 400  # elements of the inputs; `scripts/onnx_table.py` runs all
DIFFERENT = {
    # infinite numbers, which docs/functions.md states
    "test_mod_float_edge_cases_fmod_0_float16",
    "test_mod_float_edge_cases_fmod_0_float32",
    "test_mod_float_edge_cases_fmod_0_float64",
    # stated with 4 digits, or rounded to single precision
    "test_averagepool_2d_ceil_last_window_starts_on_pad",
    "test_l2normalization_axis_0",
}


@pytest.fixture(scope="module")
def table():
    spec = importlib.util.spec_from_file_location("onnx_table", SCRIPT)
    module = sys.modules["onnx_table"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["onnx_table"]
    sys.path.remove(str(SCRIPT.parent))


@pytest.mark.parametrize(
    ("group", "least", "sloping"),
    [("node", 900, 700), ("simple", 5, 5), ("pytorch-converted", 30, 30), ("pytorch-operator", 28, 25)],
)
def test_networks_of_the_package_give_their_stated_outputs_and_slopes_of_differences(
    table, tmp_path, group, least, sloping
):
    cases = [case for case in table.cases(group) if case.name not in DIFFERENT]
    if not cases:
        pytest.skip("this package onnx has no stored networks")
    verdicts = {case.name: table.verdict(case, tmp_path) for case in cases if 0 < case.size <= LARGEST}
    assert [name for name, verdict in verdicts.items() if verdict.outputs == table.WRONG] == []
    assert sum(verdict.outputs in (table.EQUAL, table.BOUND) for verdict in verdicts.values()) >= least
    assert [name for name, verdict in verdicts.items() if verdict.slopes == table.DIFFERENT] == []
    assert sum(verdict.slopes == table.SAME for verdict in verdicts.values()) >= sloping


def slopes_of(table, tmp_path, kind, x):
    """The verdict on the slopes of one operator at one point."""
    path = save(tmp_path / "net.onnx", [helper.make_node(kind, ["x"], ["y"])], {"x": [1]}, {"y": [1]})
    function = {"Tanh": np.tanh, "Abs": np.abs, "Floor": np.floor, "Sqrt": np.sqrt}[kind]
    case = table.Case(kind, path.read_bytes(), [([np.array([x])], [function(np.array([x]))])])
    return table.verdict(case, tmp_path).slopes


def test_wrong_slopes_are_told_from_kinks(table, tmp_path, monkeypatch):
    assert slopes_of(table, tmp_path, "Tanh", 0.5) == table.SAME
    assert slopes_of(table, tmp_path, "Floor", 0.5) == table.CONSTANT
    assert slopes_of(table, tmp_path, "Abs", 0.0) == table.SAME  # at a point nearby
    monkeypatch.setattr(sys.modules["onnx_slopes"], "STEPS", (2.0**-13,))
    assert slopes_of(table, tmp_path, "Abs", 0.0) == table.KINK
    assert slopes_of(table, tmp_path, "Floor", 1.0) == table.KINK
    assert slopes_of(table, tmp_path, "Sqrt", 0.0) == table.KINK
    monkeypatch.setitem(OPERATIONS, "tanh", replace(OPERATIONS["tanh"], partials=(lambda w, *_: w.const(0.786448),)))
    assert slopes_of(table, tmp_path, "Tanh", 0.5) == table.DIFFERENT  # by 3e-7 of 1 - tanh(0.5)^2


def test_large_networks_of_the_package_are_refused_by_name(table, tmp_path):
    for case in table.cases("light"):
        verdict = table.verdict(case, tmp_path).outputs
        assert verdict not in (table.EQUAL, table.WRONG)
        assert len(verdict) < 1000
