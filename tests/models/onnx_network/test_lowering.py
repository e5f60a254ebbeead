"""The test networks of the package onnx give the outputs that come with them."""

import importlib.util
import sys
from pathlib import Path

import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

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


@pytest.mark.parametrize(
    ("group", "least"), [("node", 900), ("simple", 5), ("pytorch-converted", 30), ("pytorch-operator", 28)]
)
def test_networks_of_the_package_give_their_stated_outputs(table, tmp_path, group, least):
    cases = [case for case in table.cases(group) if case.name not in DIFFERENT]
    if not cases:
        pytest.skip("this package onnx has no stored networks")
    verdicts = {case.name: table.verdict(case, tmp_path) for case in cases if 0 < case.size <= LARGEST}
    assert [name for name, verdict in verdicts.items() if verdict == table.WRONG] == []
    assert sum(verdict in (table.EQUAL, table.BOUND) for verdict in verdicts.values()) >= least


def test_large_networks_of_the_package_are_refused_by_name(table, tmp_path):
    for case in table.cases("light"):
        verdict = table.verdict(case, tmp_path)
        assert verdict not in (table.EQUAL, table.WRONG)
        assert len(verdict) < 1000
