"""Data files and model workspaces as values, the objects of parameters included."""

import os
import random
import signal
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import scipy

from kennfeld.matlab import mat_v73
from kennfeld.matlab.mat_nodes import MatFileError, MatStruct, MatUnreadable
from kennfeld.matlab.mat_reader import load_nodes, load_variables, read_nodes, to_value
from kennfeld.matlab.mat_v5 import read_elements
from kennfeld.matlab.mcos import read_workspace
from kennfeld.matlab.script_runner import run_script
from kennfeld.matlab.simulink_objects import to_calibration_parameter
from kennfeld.matlab.values import MatlabCell, OpaqueValue, class_name, text
from tests.importers.simulink.simulink_data import Thing, mxarray, pairs
from tests.measurement.matlab_files import save73

PLAIN = {
    "K": 2.5,
    "M": np.arange(6.0).reshape(2, 3),
    "small": np.array([[300, 2]], dtype=np.int16),
    "on": np.array([[True, False]]),
    "name": "turbo",
    "S": {"a": 1.0, "b": {"c": np.array([[1.0, 2.0]])}},
}


def saved(variables, **options):
    stream = BytesIO()
    scipy.io.savemat(stream, variables, **options)
    return stream.getvalue()


@pytest.mark.parametrize("options", [{}, {"do_compression": True}])
def test_values_of_a_data_file_have_their_class_and_size(options):
    variables = load_variables(saved({**PLAIN, "c": np.array([[1.0, "two"]], dtype=object)}, **options), "a.mat")
    assert variables["K"].tolist() == [[2.5]]
    assert variables["M"].tolist() == [[0, 1, 2], [3, 4, 5]]
    assert (class_name(variables["small"]), variables["small"].tolist()) == ("int16", [[300, 2]])
    assert (class_name(variables["on"]), variables["on"].tolist()) == ("logical", [[True, False]])
    assert text(variables["name"]) == "turbo"
    assert variables["S"].fields["b"].fields["c"].tolist() == [[1, 2]]
    assert isinstance(variables["c"], MatlabCell)
    assert variables["c"].values.shape == (1, 2)


def test_old_and_new_versions_are_read_alike(tmp_path):
    variables = load_variables(saved({"K": 2.5, "M": PLAIN["M"]}, format="4"), "a.mat")
    assert variables["M"].tolist() == [[0, 1, 2], [3, 4, 5]]
    save73(tmp_path / "a.mat", {"K": 2.5, "M": PLAIN["M"]})
    variables = load_variables((tmp_path / "a.mat").read_bytes(), "a.mat")
    assert variables["M"].tolist() == [[0, 1, 2], [3, 4, 5]]


def test_cells_and_struct_arrays_within_each_other_are_read_from_the_newest_version(tmp_path):
    save73(tmp_path / "a.mat", {"c": ((1.0, ("two", 3.0)), [{"a": (4.0, "5")}, {"a": 6.0}]), "d": (7.0,)})
    variables = load_variables((tmp_path / "a.mat").read_bytes(), "a.mat")
    first, second = variables["c"].values.ravel()
    assert first.values[0, 0].item() == 1.0
    assert [text(first.values[0, 1].values[0, 0]), first.values[0, 1].values[0, 1].item()] == ["two", 3.0]
    inner, last = (element["a"] for element in second.elements.ravel())
    assert [inner.values[0, 0].item(), text(inner.values[0, 1]), last.item()] == [4.0, "5", 6.0]
    assert variables["d"].values.item().item() == 7.0


def test_a_script_loads_a_data_file():
    files = {"a.mat": saved(PLAIN)}
    outcome = run_script("load a.mat\nL = M(2, :)*K + double(small(1));", "init.m", files=files.get)
    assert outcome.findings == ()
    assert outcome.variables["L"].tolist() == [[307.5, 310, 312.5]]


def test_loading_a_damaged_data_file_is_reported():
    content = saved(PLAIN)
    outcome = run_script("K = 1;\nload a.mat\nL = 2;", "init.m", files={"a.mat": content[:200]}.get)
    assert "a.mat: the MATLAB file is damaged" in str(outcome.findings[0])
    assert str(outcome.findings[0].location).startswith("init.m line 2")
    assert set(outcome.variables) == {"K", "L"}


def objects():
    limits = {"Value": np.arange(6.0).reshape(2, 3), "Min": -1.0, "Max": 9.5, "DocUnits": "Nm"}
    axis = Thing("Simulink.lookuptable.Breakpoint", {"Value": [[700.0, 1500.0]], "Unit": "rpm", "FieldName": "n"})
    table = Thing("Simulink.lookuptable.Table", {"Value": [[1.0, 2.0]], "Unit": "Nm", "Max": 5.0})
    return {
        "K": 2.5,
        "P": Thing("Simulink.Parameter", limits),
        "Q": Thing("Simulink.Parameter", {"Value": 4.0, "Description": "a factor"}),
        "L": Thing("Simulink.LookupTable", {"Table": table, "Breakpoints": [axis, axis]}),
    }


def values_of(workspace):
    """The values of the variables of a model workspace."""
    return {name: to_value(node) for name, node in read_workspace(workspace).whole().variables.items()}


@pytest.mark.parametrize("version", [2, 3, 4])
def test_objects_of_a_model_workspace_have_values_limits_and_units(version):
    variables = values_of(mxarray(objects(), {"Simulink.Parameter": {"Unit": "rad"}}, version))
    p, q, lookup = (to_calibration_parameter(variables[name]) for name in "PQL")
    assert (p.value.tolist(), p.min, p.max) == ([[0, 1, 2], [3, 4, 5]], -1.0, 9.5)
    assert (q.value.tolist(), q.unit, q.description) == ([[4.0]], "rad", "a factor")
    assert (lookup.value.tolist(), lookup.max, lookup.unit) == ([[1.0, 2.0]], 5.0, "Nm")
    assert [(axis.name, axis.unit, axis.value.tolist()) for axis in lookup.breakpoints] == [
        ("n", "rpm", [[700.0, 1500.0]])
    ] * 2
    assert class_name(variables["P"]) == "Simulink.Parameter"


def test_objects_are_used_like_their_values():
    variables = values_of(mxarray(objects()))
    outcome = run_script("a = P(2, 1)*Q + K; b = P.Max;", variables=variables)
    assert outcome.findings != ()
    outcome = run_script("a = P.Value(2, 1)*Q + K; b = P.Max;", variables=variables)
    assert (outcome.variables["a"].tolist(), outcome.variables["b"].tolist()) == ([[14.5]], [[9.5]])


def test_workspaces_of_older_releases_are_lists_of_names_and_values():
    variables = values_of(pairs({"K": 2.5, "name": "turbo"}))
    assert variables["K"].tolist() == [[2.5]]
    assert text(variables["name"]) == "turbo"


def test_objects_without_their_properties_stay_opaque():
    raw = mxarray({"K": 1.0, "P": Thing("Simulink.Parameter", {"Value": 1.0})})
    variables = values_of(raw[: 16 + int.from_bytes(raw[12:16], "little")])
    assert variables["K"].tolist() == [[1.0]]
    assert variables["P"] == OpaqueValue("Simulink.Parameter")
    outcome = run_script("x = P*2;", variables=variables)
    assert "a Simulink.Parameter is not a number" in str(outcome.findings[0])


def test_invalid_workspaces_are_rejected():
    with pytest.raises(MatFileError, match="unknown header"):
        values_of(b"abc")


def test_a_corrupt_workspace_gives_values_or_an_error_of_the_file():
    raw = bytearray(mxarray(objects()))
    chance = random.Random(3)
    for _ in range(300):
        broken = bytearray(raw)
        for _ in range(chance.randint(1, 6)):
            broken[chance.randrange(len(broken))] = chance.randrange(256)
        try:
            variables = values_of(bytes(broken[: chance.randint(8, len(broken))]))
        except MatFileError:
            continue
        assert all(to_calibration_parameter(value) is None or value.fields for value in variables.values())


def test_the_tree_distinguishes_objects_from_structs():
    content = saved({"K": 1.0})
    nodes = read_nodes(content + mxarray({"P": Thing("Simulink.Parameter", {"Value": 1.0})})[8:])
    assert "K" in nodes
    with pytest.raises(MatFileError):
        read_nodes(content[:150])
    assert not isinstance(nodes["K"], MatStruct | MatUnreadable)


REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "simulink"


@pytest.mark.skipif(not REAL.is_dir(), reason=f"the models are not at {REAL}")
@pytest.mark.parametrize("name", ["fuel_control.slx", "AbstractFuelControl_M1.slx"])
def test_arrays_that_simulink_wrote_are_read(name):
    with zipfile.ZipFile(REAL / name) as archive:
        parts = [part for part in archive.namelist() if part.endswith(".mxarray")]
        properties = [read_elements(memoryview(archive.read(part)), 8, "<").further for part in parts]
    assert len(properties) == 19
    assert all(isinstance(arrays[0], MatStruct) and arrays[0].fields for arrays in properties)


@pytest.mark.skipif(not REAL.is_dir(), reason=f"the models are not at {REAL}")
def test_data_that_matlab_wrote_are_values():
    variables = load_variables((REAL / "BreathData.mat").read_bytes(), "BreathData.mat")
    assert variables
    assert {class_name(value) for value in variables.values()} <= {
        "double",
        "struct",
        "cell",
        "char",
        "single",
        "logical",
    }


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="the fault is one of POSIX")
def test_a_file_of_version_7_3_that_crashes_the_library_is_damaged(monkeypatch):
    monkeypatch.setattr(mat_v73, "_load_content", _crash)
    loaded = load_nodes(b"\x89HDF\r\n\x1a\n")
    assert loaded.lost == "the library that reads it crashed (SIGSEGV)"


def _crash(*_):
    os.kill(os.getpid(), signal.SIGSEGV)
