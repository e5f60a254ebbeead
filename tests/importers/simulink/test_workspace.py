import io
import random
from pathlib import Path

import numpy as np
import pytest
import scipy

from kennfeld.importers.simulink.reader.document import document
from kennfeld.importers.simulink.variables.stored_variables import (
    StoredVariable,
    mat_variables,
    mxarray_variables,
    workspace_variables,
)
from tests.importers.simulink.simulink_data import Thing, mxarray, numbers, pairs
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.measurement.matlab_files import save73


def parameters():
    limits = {"Value": np.arange(6.0).reshape(2, 3), "Min": -1.0, "Max": 9.5, "DocUnits": "Nm", "DataType": "single"}
    axis = Thing("Simulink.lookuptable.Breakpoint", {"Value": [[700.0, 1500.0]], "Unit": "rpm", "FieldName": "n"})
    table = Thing("Simulink.lookuptable.Table", {"Value": [[1.0, 2.0]], "Unit": "Nm", "Max": 5.0})
    return {
        "K": 2.5,
        "M": np.arange(12.0).reshape(3, 4),
        "name": "turbo",
        "S": {"a": 1.0, "b": {"c": [[1.0, 2.0]]}},
        "P": Thing("Simulink.Parameter", limits),
        "Q": Thing("Simulink.Parameter", {"Value": 4.0, "Description": "a factor"}),
        "L": Thing("Simulink.LookupTable", {"Table": table, "Breakpoints": [axis, axis]}),
    }


def test_plain_values_are_read():
    entries = mxarray_variables(mxarray(parameters())).entries
    assert entries["K"].value.tolist() == [[2.5]]
    np.testing.assert_array_equal(entries["M"].value, np.arange(12.0).reshape(3, 4))
    assert (entries["name"].value, entries["name"].kind) == ("turbo", "char")
    assert entries["S"].value["b"]["c"].tolist() == [[1.0, 2.0]]


@pytest.mark.parametrize("version", [2, 3, 4])
def test_parameter_objects_are_read_with_their_limits(version):
    workspace = mxarray_variables(mxarray(parameters(), {"Simulink.Parameter": {"DataType": "auto"}}, version))
    p, q = workspace.entries["P"], workspace.entries["Q"]
    assert workspace.unreadable == {}
    np.testing.assert_array_equal(p.value, np.arange(6.0).reshape(2, 3))
    assert (p.name, p.kind, p.unit, p.minimum, p.maximum, p.type) == (
        "P", "Simulink.Parameter", "Nm", -1.0, 9.5, "single",
    )  # fmt: skip
    assert (q.value.tolist(), q.description, q.minimum, q.type) == ([[4.0]], "a factor", None, "auto")


def test_lookup_table_objects_are_read_with_their_axes():
    lookup = mxarray_variables(mxarray(parameters())).entries["L"]
    assert (lookup.value.tolist(), lookup.unit, lookup.maximum) == ([[1.0, 2.0]], "Nm", 5.0)
    assert [(axis.name, axis.unit, axis.value.tolist()) for axis in lookup.breakpoints] == [
        ("n", "rpm", [[700.0, 1500.0]])
    ] * 2


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_workspace_of_a_model_is_read_in_every_layout(layout):
    read = document(Model(workspace=mxarray(parameters())).written(layout), Path("m.slx"))
    assert read.workspace.kind == "mxarray"
    workspace = workspace_variables(read.workspace)
    assert (workspace.entries["P"].maximum, workspace.unreadable) == (9.5, {})


def test_a_model_without_a_workspace_has_no_variables():
    assert workspace_variables(document(Model().written("mdl"), Path("m.mdl")).workspace).entries == {}


def test_objects_without_their_properties_are_reported_by_name():
    raw = mxarray({"K": 1.0, "P": Thing("Simulink.Parameter", {"Value": 1.0})})
    size = int.from_bytes(raw[12:16], "little")
    workspace = mxarray_variables(raw[: 16 + size])
    assert list(workspace.entries) == ["K"]
    assert workspace.unreadable == {"P": "Simulink.Parameter: the file does not contain its properties"}


def test_a_property_that_cannot_be_decoded_does_not_take_the_value_with_it():
    z = Thing("Simulink.Parameter", {"Value": 3.0, "Extra": Thing("A.B", {"Value": 1.0})})
    raw = bytearray(mxarray({"P": z}))
    tag = np.array([0xDD000000], "<u4").tobytes()
    at = raw.rindex(tag)
    raw[at + 16 : at + 20] = (99).to_bytes(4, "little")
    workspace = mxarray_variables(bytes(raw))
    assert (workspace.entries["P"].value.tolist(), "Extra" in workspace.entries["P"].properties) == ([[3.0]], False)


@pytest.mark.parametrize("variables", [{"K": 3.0}, {"K": 3.0, "name": "x", "M": [[1.0, 2.0]]}])
def test_variables_kept_as_pairs_of_name_and_value_are_read(variables):
    read = document(Model(workspace=pairs(variables)).written("mdl"), Path("m.mdl"))
    workspace = workspace_variables(read.workspace)
    assert list(workspace.entries) == list(variables)
    assert workspace.entries["K"].value.tolist() == [[3.0]]


def test_two_variables_that_are_called_name_and_value_are_two():
    entries = mxarray_variables(mxarray({"Name": 1.0, "Value": 2.0})).entries
    assert [entry.value.item() for entry in entries.values()] == [1.0, 2.0]


def test_files_of_scipy_are_read():
    stream = io.BytesIO()
    sparse = scipy.sparse.csc_array(np.array([[0.0, 2.0], [3.0, 0.0]]))
    variables = {
        "a": np.arange(6.0).reshape(2, 3),
        "s": {"x": 1, "y": "no"},
        "c": np.array([1, "b"], dtype=object),
        "z": sparse,
    }
    scipy.io.savemat(stream, variables, do_compression=True)
    entries = mat_variables(stream.getvalue()).entries
    np.testing.assert_array_equal(entries["a"].value, variables["a"])
    assert entries["s"].value["y"] == "no"
    assert [np.size(part) if not isinstance(part, str) else part for part in entries["c"].value] == [1, "b"]
    np.testing.assert_array_equal(entries["z"].value, sparse.toarray())


def test_unusable_variables_are_reported_by_name():
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"z": np.array([1 + 2j]), "a": 1.0})
    workspace = mat_variables(stream.getvalue())
    assert list(workspace.entries) == ["a"]
    assert workspace.unreadable == {"z": "it is complex"}


def test_an_unusable_field_is_reported_by_its_path():
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"S": {"a": 1.0, "z": np.array([1 + 2j]), "t": {"z": np.array([2j]), "b": 3.0}}})
    workspace = mat_variables(stream.getvalue())
    assert workspace.entries["S"].value["a"].item() == 1.0
    assert workspace.entries["S"].value["t"].keys() == {"b"}
    assert workspace.unreadable == {"S.z": "it is complex", "S.t.z": "it is complex"}


def test_a_cell_array_with_an_unusable_cell_is_reported_as_a_whole():
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"c": np.array([1.0, np.array([2j])], dtype=object), "a": 1.0})
    workspace = mat_variables(stream.getvalue())
    assert (list(workspace.entries), workspace.unreadable) == (["a"], {"c": "it is complex"})


def test_arrays_of_structs_and_rows_of_characters_are_tuples():
    stream = io.BytesIO()
    structs = np.array([(1.0, "x"), (2.0, "y")], dtype=[("a", object), ("b", object)])
    scipy.io.savemat(stream, {"S": structs, "rows": np.array(["ab", "cd"])})
    entries = mat_variables(stream.getvalue()).entries
    assert [(one["a"].item(), one["b"]) for one in entries["S"].value] == [(1.0, "x"), (2.0, "y")]
    assert (entries["rows"].value, entries["rows"].kind, entries["S"].kind) == (("ab", "cd"), "char", "struct")


def test_integers_and_logical_values_are_numbers_that_nobody_can_change():
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"i": np.array([[300, -2]], dtype=np.int16), "on": np.array([[True]])})
    entries = mat_variables(stream.getvalue()).entries
    assert (entries["i"].kind, entries["i"].value.dtype, entries["i"].value.tolist()) == ("int16", float, [[300, -2]])
    assert (entries["on"].kind, entries["on"].value.tolist()) == ("logical", [[1.0]])
    with pytest.raises(ValueError, match="read-only"):
        entries["i"].value[0, 0] = 1


@pytest.mark.parametrize("version", ["4", "7.3"])
def test_files_of_the_oldest_and_the_newest_version_are_read(version, tmp_path):
    if version == "4":
        scipy.io.savemat(tmp_path / "a.mat", {"K": 2.5, "name": "x"}, format="4")
    else:
        save73(tmp_path / "a.mat", {"K": 2.5, "name": "x"})
    workspace = mat_variables((tmp_path / "a.mat").read_bytes())
    assert (workspace.entries["K"].value.tolist(), workspace.entries["name"].value, workspace.unreadable) == (
        [[2.5]],
        "x",
        {},
    )


def test_every_not_a_number_of_single_precision_is_one():
    odd = np.array([0x7F800001, 0x3F800000], np.uint32).view(np.float32)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"
    entry = mat_variables(head + numbers(odd, 7, "<f4", 7, "K")).entries["K"]
    assert (entry.kind, np.isnan(entry.value[0, 0]), entry.value[0, 1]) == ("single", True, 1.0)


def test_a_file_that_is_cut_off_gives_what_stands_before_the_cut():
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"a": 1.0, "b": np.arange(100.0)})
    workspace = mat_variables(stream.getvalue()[:-50])
    assert list(workspace.entries) == ["a"]
    assert "the MAT-file cannot be read whole: the element at byte" in workspace.unreadable[""]


@pytest.mark.parametrize("raw", [b"", b"short", b"version https://git-lfs.github.com/spec/v1"])
def test_a_file_other_than_a_mat_file_is_reported(raw):
    workspace = mat_variables(raw)
    assert not workspace.entries
    assert "the MAT-file cannot be read: " in workspace.unreadable[""]


def test_an_object_without_a_readable_value_is_reported_with_its_class():
    raw = bytearray(mxarray({"P": Thing("Simulink.Parameter", {"Value": Thing("A.B", {"Value": 1.0})})}))
    at = raw.rindex(np.array([0xDD000000], "<u4").tobytes())
    raw[at + 16 : at + 20] = (99).to_bytes(4, "little")
    workspace = mxarray_variables(bytes(raw))
    assert workspace.unreadable == {"P": "object: object 99 not found"}


@pytest.mark.parametrize("raw", [b"", b"\0\1IM", b"no workspace at all", b"\0\1IM\0\0\0\0" + b"\1" * 90])
def test_content_other_than_a_workspace_is_reported(raw):
    workspace = mxarray_variables(raw)
    assert not workspace.entries
    assert set(workspace.unreadable) <= {""}


@pytest.mark.parametrize("garbled", [pytest.param(100, id="few"), pytest.param(600, id="many", marks=pytest.mark.slow)])
def test_garbled_workspaces_are_read_or_reported_but_never_crash(garbled):
    whole, chance = mxarray(parameters()), random.Random(3)
    for _ in range(garbled):
        raw = bytearray(whole)
        for _ in range(chance.choice((1, 2, 8))):
            raw[chance.randrange(8, len(raw))] = chance.choice((0, 1, 2, 255, chance.randrange(256)))
        if chance.random() < 0.2:
            del raw[chance.randrange(len(raw)) :]
        workspace = mxarray_variables(bytes(raw))
        assert all(isinstance(entry, StoredVariable) for entry in workspace.entries.values())


def test_objects_that_hold_each_other_end():
    raw = bytearray(mxarray({"P": Thing("A.B", {"Value": Thing("A.B", {"Value": 1.0})})}))
    tag = np.array([0xDD000000], "<u4").tobytes()
    at = raw.rindex(tag)
    raw[at + 16 : at + 20] = (2).to_bytes(4, "little")  # the inner object, from now on the outer one itself
    workspace = mxarray_variables(bytes(raw))
    assert "too deeply" in workspace.unreadable["P"]
