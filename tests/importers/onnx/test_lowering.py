"""The test networks of the package onnx give the outputs that come with them, and slopes of differences."""

import importlib.util
import pkgutil
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

from onnx import ModelProto, helper
from onnx.backend.test.case import base as exporter
from onnx.backend.test.case import node as operators

from kennfeld.graph import OPERATIONS
from tests.importers.onnx.networks import save

SCRIPT = Path(__file__).parents[3] / "scripts" / "onnx_table.py"
LARGEST = 400  # elements of the inputs; `scripts/onnx_table.py` runs all
SMALL = 36  # of single operators
SMALL_STORED = 80
MANY = 60  # up to which all are checked; beyond, the smallest of each operator
IMAGES = {"averagepool", "image_decoder", "lppool", "maxpool"}  # modules of onnx that compute large images for seconds
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


@cache
def single_operators(table, module):
    """The networks that a module of onnx makes when it is imported, which happens once in a process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operators, "_NodeTestCases", [])
        patch.setattr(operators, "import_recursive", lambda package: importlib.import_module(module))
        patch.setattr(exporter, "process_snippet", lambda *_: ("", ""))  # reads the source, for documents
        return list(table.cases("node"))


def modules():
    """The modules of single operators, and how their names begin."""
    start = f"{operators.__name__}."
    names = [module.name for module in pkgutil.walk_packages(operators.__path__, start)]
    return {name: name.removeprefix(start) for name in names}


def smallest(cases, largest):
    """The smallest network of each set of operators."""
    networks = {}
    for case in sorted(cases, key=lambda case: case.size):
        kinds = frozenset(node.op_type for node in ModelProto.FromString(case.model).graph.node)
        if 0 < case.size <= largest:
            networks.setdefault(kinds, case)
    return networks.values()


def check(table, tmp_path, cases, least, sloping):
    """No network is wrong; `least` have the stated outputs, `sloping` the slopes of differences."""
    verdicts = {case.name: table.verdict(case, tmp_path) for case in cases if case.name not in DIFFERENT}
    assert [name for name, verdict in verdicts.items() if verdict.outputs == table.WRONG] == []
    assert sum(verdict.outputs in (table.EQUAL, table.BOUND) for verdict in verdicts.values()) >= least
    assert [name for name, verdict in verdicts.items() if verdict.slopes == table.DIFFERENT] == []
    assert sum(verdict.slopes == table.SAME for verdict in verdicts.values()) >= sloping


@pytest.mark.parametrize(("initials", "least", "sloping"), [("cd", 12, 12), ("r", 6, 6)])
def test_the_smallest_networks_of_single_operators(table, tmp_path, initials, least, sloping):
    names = [name for name, short in modules().items() if short[0] in initials and short not in IMAGES]
    cases = [case for name in names for case in single_operators(table, name)]
    check(table, tmp_path, smallest(cases, SMALL), least, sloping)


@pytest.mark.parametrize(("group", "least", "sloping"), [("simple", 4, 4), ("pytorch-operator", 22, 21)])
def test_the_smallest_stored_networks(table, tmp_path, group, least, sloping):
    cases = list(table.cases(group))
    if not cases:
        pytest.skip("this package onnx has no stored networks")
    check(table, tmp_path, smallest(cases, SMALL_STORED), least, sloping)


@pytest.mark.slow
def test_all_networks_of_single_operators(table, tmp_path):
    """All small ones, and the smallest of operators that have only larger ones."""
    cases = [case for name in modules() for case in single_operators(table, name)]
    small = [case for case in cases if 0 < case.size <= MANY]
    check(table, tmp_path, {case.name: case for case in (*small, *smallest(cases, LARGEST))}.values(), 660, 520)


@pytest.mark.slow
@pytest.mark.parametrize(("group", "least", "sloping"), [("pytorch-converted", 30, 30), ("pytorch-operator", 28, 25)])
def test_all_stored_networks(table, tmp_path, group, least, sloping):
    cases = [case for case in table.cases(group) if 0 < case.size <= LARGEST]
    if not cases:
        pytest.skip("this package onnx has no stored networks")
    check(table, tmp_path, cases, least, sloping)


@pytest.mark.parametrize(
    ("kind", "pool", "attributes"),
    [
        ("MaxPool", np.nanmax, {}),
        ("AveragePool", np.nanmean, {}),
        ("AveragePool", lambda windows, axis: np.nansum(windows, axis) / 9, {"count_include_pad": 1}),
    ],
)
def test_pools_of_a_padded_image(table, tmp_path, kind, pool, attributes):
    image = np.random.default_rng(0).standard_normal((4, 5))
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(image, 1, constant_values=np.nan), (3, 3))[::2, ::2]
    expected = pool(windows, axis=(2, 3))[None, None]
    node = helper.make_node(kind, ["x"], ["y"], kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1], **attributes)
    path = save(tmp_path / "net.onnx", [node], {"x": [1, 1, 4, 5]}, {"y": list(expected.shape)})
    case = table.Case(kind, path.read_bytes(), [([image[None, None]], [expected])])
    assert table.verdict(case, tmp_path) == (table.EQUAL, table.SAME)


def test_the_number_of_largest_elements_is_an_input(table, tmp_path):
    node = helper.make_node("TopK", ["x", "count"], ["y", "places"])
    path = save(tmp_path / "net.onnx", [node], {"x": [1, 4]}, {"y": [1, 2]}, {"count": np.array([2])})
    case = table.Case("TopK", path.read_bytes(), [([np.array([[0.5, 2.0, -1.0, 1.0]])], [np.array([[2.0, 1.0]])])])
    assert table.verdict(case, tmp_path) == (table.EQUAL, table.SAME)


def slopes_of(table, tmp_path, kind, x):
    """The verdict on the slopes of one operator at one point."""
    path = save(tmp_path / "net.onnx", [helper.make_node(kind, ["x"], ["y"])], {"x": [1]}, {"y": [1]})
    function = {"Tanh": np.tanh, "Abs": np.abs, "Floor": np.floor, "Sqrt": np.sqrt}[kind]
    case = table.Case(kind, path.read_bytes(), [([np.array([x])], [function(np.array([x]))])])
    return table.verdict(case, tmp_path).slopes


def test_wrong_slopes_are_distinguished_from_kinks(table, tmp_path, monkeypatch):
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
