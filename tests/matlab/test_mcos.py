"""Objects of classes in data files and model workspaces, as the tree shows them."""

import random
import struct
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest

from kennfeld.matlab.mat_nodes import MatCells, MatFileError, MatStruct, MatStructArray, MatText, MatUnreadable, Node
from kennfeld.matlab.mat_reader import load_nodes
from kennfeld.matlab.mat_v5 import read_elements
from kennfeld.matlab.mcos import read_workspace
from tests.importers.simulink.simulink_data import (
    OPAQUE,
    UINT8,
    Store,
    Thing,
    element,
    matfile,
    mxarray,
    numbers,
    struct_of,
)
from tests.measurement.matlab_files import save73

TAG = np.array([0xDD000000], "<u4").tobytes()
SIMULINK = "Simulink.Parameter"


def parameter(value, **properties):
    return Thing(SIMULINK, {"Value": value, **properties})


def axis(name, points):
    return Thing("Simulink.lookuptable.Breakpoint", {"Value": [points], "Unit": "rpm", "FieldName": name})


def table():
    values = Thing("Simulink.lookuptable.Table", {"Value": [[1.0, 2.0]], "Unit": "Nm", "Max": 5.0})
    return Thing("Simulink.LookupTable", {"Table": values, "Breakpoints": [axis("n", [700.0, 1500.0])] * 2})


@pytest.fixture(params=["workspace", "data file"])
def read(request):
    """Reads variables out of a model workspace, or out of a data file."""

    def of(variables):
        return read_workspace(mxarray(variables)) if request.param == "workspace" else load_nodes(matfile(variables))

    return of


def test_an_object_is_a_struct_with_the_name_of_its_class(read):
    variables = read({"K": 2.5, "P": parameter(3.0, Unit="Nm"), "S": Thing("Simulink.Signal", {"Min": -1.0})}).variables
    assert (variables["P"].kind, variables["P"].fields["Unit"]) == (SIMULINK, MatText("Nm"))
    assert variables["P"].fields["Value"].values.tolist() == [[3.0]]
    assert (variables["S"].kind, variables["S"].fields["Min"].values.item()) == ("Simulink.Signal", -1.0)
    assert variables["K"].values.item() == 2.5


def test_objects_within_objects_are_opened(read):
    points = Thing("Simulink.Breakpoint", {"Breakpoints": axis("n", [1.0, 2.0, 4.0])})
    variables = read({"L": table(), "B": points}).variables
    assert variables["L"].fields["Table"].fields["Value"].values.tolist() == [[1.0, 2.0]]
    assert isinstance(variables["L"].fields["Breakpoints"], MatStructArray)
    assert [one.fields["FieldName"] for one in variables["L"].fields["Breakpoints"].elements] == [MatText("n")] * 2
    assert variables["B"].fields["Breakpoints"].fields["Value"].values.tolist() == [[1.0, 2.0, 4.0]]


def test_objects_within_structs_are_opened(read):
    struct_node = read({"S": {"engine": {"K": parameter(4.0)}, "n": 1.0}}).variables["S"]
    assert struct_node.fields["engine"].fields["K"].kind == SIMULINK
    assert struct_node.fields["engine"].fields["K"].fields["Value"].values.item() == 4.0


def test_an_object_that_is_not_there_takes_no_other_with_it(read):
    whole = {"P": parameter(1.0), "Q": parameter(2.0)}
    raw = bytearray(mxarray(whole))
    at = raw.index(TAG)
    raw[at + 16 : at + 20] = (99).to_bytes(4, "little")
    variables = read_workspace(bytes(raw)).variables
    assert variables["P"] == MatUnreadable(SIMULINK, why="object 99 not found")
    assert variables["Q"].fields["Value"].values.item() == 2.0
    assert read(whole).variables["P"].fields["Value"].values.item() == 1.0


def test_a_table_of_an_unknown_version_leaves_the_plain_variables():
    raw = mxarray({"K": 1.0, "P": parameter(2.0)}, version=9)
    variables = read_workspace(raw).variables
    assert variables["K"].values.item() == 1.0
    assert (variables["P"].kind, variables["P"].why) == (SIMULINK, "the object table has an unknown version")


def test_an_object_without_its_properties_is_reported():
    raw = mxarray({"P": parameter(1.0)})
    node = read_workspace(raw[: 16 + int.from_bytes(raw[12:16], "little")]).variables["P"]
    assert (node.kind, node.why) == (SIMULINK, "the file does not contain its properties")


def test_an_enumeration_is_reported_as_an_unknown_object():
    kind = b"".join(element(1, part) for part in (b"Mode", b"MCOS", b"GearMode"))
    head = element(6, struct.pack("<II", OPAQUE, 0))
    enumeration = element(14, head + kind + struct_of({"ValueIndices": numbers([[0.0]])}))
    plain = matfile({"P": parameter(1.0)})
    variables = load_nodes(plain[:128] + enumeration + plain[128:]).variables
    assert variables["Mode"].kind == "GearMode"
    assert "enumeration" in variables["Mode"].why
    assert isinstance(variables["P"], MatStruct)


def test_objects_that_hold_each_other_end():
    raw = bytearray(mxarray({"P": Thing("A.B", {"Value": Thing("A.B", {"Value": 1.0})})}))
    at = raw.rindex(TAG)
    raw[at + 16 : at + 20] = (2).to_bytes(4, "little")  # the inner object, from now on the outer one itself
    node, depth = read_workspace(bytes(raw)).variables["P"], 0
    while isinstance(node, MatStruct):
        node, depth = node.fields["Value"], depth + 1
    assert depth < 100
    assert "too deeply" in node.why


def test_objects_that_know_each_other_in_many_ways_are_opened_once_each():
    inner = {name: Thing("A.B", {"K": 2.0}) for name in "abcd"}
    raw = bytearray(mxarray({"P": Thing("A.B", {"K": 1.0, **inner})}))
    outer, at = int.from_bytes(raw[raw.index(TAG) + 16 : raw.index(TAG) + 20], "little"), raw.index(TAG)
    while (at := raw.find(TAG, at + 1)) >= 0:
        raw[at + 16 : at + 20] = outer.to_bytes(4, "little")
    fields = read_workspace(bytes(raw)).variables["P"].fields
    assert fields["K"].values.item() == 1.0
    assert all("nested too deeply" in fields[name].why for name in "abcd")


def test_structs_may_be_as_deep_as_a_file_can_hold():
    inner = {"K": 1.0}
    for _ in range(40):
        inner = {"s": inner}
    node = read_workspace(mxarray({"S": inner, "P": parameter(1.0)})).variables["S"]
    while "s" in node.fields:
        node = node.fields["s"]
    assert node.fields["K"].values.item() == 1.0


def test_an_array_of_more_objects_than_the_file_holds_is_refused():
    store = Store()
    store.reference([parameter(1.0)])
    many = np.array([[0xDD000000, 2, 2**31, 2**31 - 1, 1, 1]]).T
    raw = b"\0\1IM\0\0\0\0" + struct_of({"P": numbers(many, 13, "<u4", 6)})
    raw += numbers(np.frombuffer(store.written(), np.uint8)[:, None], UINT8, "u1", 2)
    assert "are inconsistent" in read_workspace(raw).variables["P"].why


@pytest.mark.slow
def test_a_bomb_within_the_properties_is_refused():
    bomb = zlib.compress(struct.pack("<II", 14, 50_000_000) + bytes(50_000_000), 9)
    subsystem = b"\0\1IM\0\0\0\0" + struct.pack("<II", 15, len(bomb)) + bomb
    raw = mxarray({"K": 1.0}) + numbers(np.frombuffer(subsystem, np.uint8)[:, None], UINT8, "u1", 2)
    tracemalloc.start()
    try:
        variables = read_workspace(raw, 10_000_000).variables
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()
    assert variables["K"].values.item() == 1.0


@pytest.mark.slow
def test_thousands_of_objects_are_read():
    workspace = read_workspace(
        mxarray({f"P{n}": parameter(float(n), Min=0.0, Max=9e9, DocUnits="Nm") for n in range(1000)})
    )
    assert [node.fields["Value"].values.item() for node in workspace.variables.values()] == list(range(1000))
    assert not workspace.damage


def test_an_array_of_numbers_is_not_a_workspace():
    with pytest.raises(MatFileError, match="no variables found"):
        read_workspace(b"\0\1IM\0\0\0\0" + numbers([[1.0, 2.0]]))


def test_an_empty_workspace_holds_nothing():
    assert read_workspace(b"\0\1IM\0\0\0\0").variables == {}
    assert read_workspace(b"\0\1IM\0\0\0\0" + numbers(np.zeros((0, 0)))).variables == {}
    assert read_workspace(mxarray({})).variables == {}


def test_a_workspace_whose_only_array_is_damaged_is_reported():
    raw = mxarray({"K": 1.0})
    workspace = read_workspace(raw[:12] + b"\xff\xff" + raw[14:])
    assert workspace.variables == {}
    assert workspace.lost


def save_objects73(path, things):
    """Objects as MATLAB lays them out in HDF5: their properties, numbers and texts, in a cell array of their own."""
    store = Store()
    numbered = {name: store.reference([thing]) for name, thing in things.items()}
    subsystem = np.frombuffer(store.written(), np.uint8)
    wrapper = read_elements(memoryview(subsystem.tobytes()), 8, "<").further[0].fields["MCOS"].reference
    property_values = [value for thing in things.values() for value in thing.properties.values()]
    cells = (wrapper.cells[0].values, np.zeros((1, 1)), *property_values, *[np.zeros((1, 1))] * 3)
    save73(path, {"K": 2.5, "cells": cells})
    with h5py.File(path, "r+") as file:
        file.move("cells", "#subsystem#/MCOS")
        file["#subsystem#/MCOS"].attrs["MATLAB_class"] = np.bytes_("FileWrapper__")
        file["#subsystem#/MCOS"].attrs["MATLAB_object_decode"] = np.int32(3)
        for name, numbers_ in numbered.items():
            file[name] = np.array([numbers_], np.uint32)
            file[name].attrs["MATLAB_class"] = np.bytes_(things[name].kind)
            file[name].attrs["MATLAB_object_decode"] = np.int32(3)
    return path.read_bytes()


def test_objects_of_the_newest_version_are_opened(tmp_path):
    things = {"P": parameter(3.0, Unit="Nm", Max=9.0), "S": Thing("Simulink.Signal", {"Min": -1.0})}
    variables = load_nodes(save_objects73(tmp_path / "a.mat", things)).whole().variables
    assert (variables["P"].kind, variables["P"].fields["Unit"]) == (SIMULINK, MatText("Nm"))
    assert [variables["P"].fields[name].values.item() for name in ("Value", "Max")] == [3.0, 9.0]
    assert (variables["S"].kind, variables["S"].fields["Min"].values.item()) == ("Simulink.Signal", -1.0)
    assert (variables["K"].values.item(), set(variables)) == (2.5, {"K", "P", "S"})


def test_objects_of_the_newest_version_without_properties_leave_the_plain_variables(tmp_path):
    save_objects73(tmp_path / "a.mat", {"P": parameter(3.0)})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        del file["#subsystem#"]
    variables = load_nodes((tmp_path / "a.mat").read_bytes()).whole().variables
    assert (variables["K"].values.item(), variables["P"].why) == (2.5, "the file does not contain its properties")


@pytest.mark.parametrize(
    ("kind", "node"),
    [("cell", MatCells([], (0, 1))), ("struct", MatStructArray([], (0, 1))), ("char", MatText("")), ("double", (0, 1))],
)
def test_empty_arrays_of_the_newest_version_keep_their_kind_and_size(kind, node, tmp_path):
    save73(tmp_path / "a.mat", {"K": 1.0})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["e"] = np.array([0, 1], np.uint64)
        file["e"].attrs["MATLAB_class"], file["e"].attrs["MATLAB_empty"] = np.bytes_(kind), np.uint8(1)
    node_read = load_nodes((tmp_path / "a.mat").read_bytes()).variables["e"]
    assert (node_read.values.shape if kind == "double" else node_read) == node


def nodes(node: Node):
    yield node
    inner = node.cells if isinstance(node, MatCells) else node.elements if isinstance(node, MatStructArray) else ()
    for one in (*inner, *(node.fields.values() if isinstance(node, MatStruct) else ())):
        yield from nodes(one)


@pytest.mark.parametrize("count", [40, pytest.param(500, marks=pytest.mark.slow)])
def test_corrupt_workspaces_are_read_as_far_as_possible(count):
    plain = {"K": 2.5, "M": np.arange(12.0), "S": {"a": 1.0, "b": {"c": [[1.0, 2.0]]}}, "name": "turbo"}
    whole, chance, read = mxarray({**plain, "P": parameter(1.0, Min=0.0), "L": table()}), random.Random(3), 0
    for _ in range(count):
        raw = bytearray(whole)
        for _ in range(chance.choice((1, 2, 8))):
            raw[chance.randrange(8, len(raw))] = chance.choice((0, 1, 2, 255, chance.randrange(256)))
        if chance.random() < 0.2:
            del raw[chance.randrange(8, len(raw)) :]
        try:
            variables = read_workspace(bytes(raw), 10_000_000).variables
        except MatFileError:
            continue
        read += any(not isinstance(one, MatUnreadable) for node in variables.values() for one in nodes(node))
    assert read > 0.3 * count
