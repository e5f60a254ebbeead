"""Writes objects of MATLAB's own types into files of versions 5 and 7.3, as files of MATLAB hold them."""

import h5py
import numpy as np

from kennfeld.matlab.mat_v5 import read_elements
from tests.importers.simulink.simulink_data import Store, Thing, matfile
from tests.measurement.matlab_files import save73


def string(*texts):
    """A string, or a column of several."""
    lengths = [len(text.encode("utf-16-le")) // 2 for text in texts]
    letters = "".join(texts).encode("utf-16-le")
    letters += b"\0" * (-len(letters) % 8)
    head = np.array([1, 2, len(texts), 1, *lengths], np.uint64)
    return Thing("string", {"any": np.concatenate([head, np.frombuffer(letters, "<u8")])[None, :]})


def datetime(milliseconds, low=None):
    """Dates in ms since 1970; `low` is what a double lacks of them."""
    data = np.array([milliseconds], dtype=float).T
    return Thing("datetime", {"tz": "", "fmt": "", "data": data if low is None else data + 1j * np.array([low]).T})


def duration(seconds):
    return Thing("duration", {"millis": 1e3 * np.array([seconds], dtype=float).T, "fmt": "s"})


def categorical(names, codes):
    return Thing("categorical", {"categoryNames": tuple(names), "codes": np.array([codes], np.uint8).T})


def table(columns, units=(), descriptions=(), continuity=()):
    props = {"VariableUnits": units, "VariableDescriptions": descriptions, "VariableContinuity": continuity}
    stored = {"data": tuple(columns.values()), "nrows": 3.0, "varnames": tuple(columns), "rownames": ()}
    return Thing("table", stored | {"props": props})


def timetable(times, columns, units=(), descriptions=(), continuity=(), rows=3):
    saved = {"data": tuple(columns.values()), "varNames": tuple(columns), "rowTimes": times, "numRows": float(rows)}
    notes = {"varUnits": units, "varDescriptions": descriptions, "varContinuity": continuity}
    return Thing("timetable", {"any": saved | notes})


def even_times(origin, *, step=None, rate=0.0):
    """The row times of a timetable with an origin and a step or a rate."""
    step = duration([0.0]) if step is None else step
    return {"origin": origin, "stepSize": step, "sampleRate": rate, "specifiedAsRate": np.array([[rate > 0]])}


def save5(path, variables):
    path.write_bytes(matfile(variables))
    return path


class _Store73(Store):
    """The objects of a file of version 7.3: their values stay values, with references to other objects."""

    def value(self, value, name=""):
        if isinstance(value, Thing):
            return np.array([self.reference([value])], np.uint32)
        if isinstance(value, dict):
            return {key: self.value(inner) for key, inner in value.items()}
        if isinstance(value, tuple):
            return tuple(map(self.value, value))
        return value


def save_objects73(path, variables):
    """Write variables, some of them objects, as MATLAB lays them out in HDF5."""
    store = _Store73()
    stored = {name: store.value(value) for name, value in variables.items()}
    references = {name: stored[name] for name, value in variables.items() if isinstance(value, Thing)}
    values, store.cells = store.cells, []
    written = _plain(store).written()
    wrapper = read_elements(memoryview(written), 8, "<").further[0].fields["MCOS"].reference
    cells = (wrapper.cells[0].values, np.zeros((1, 1)), *values, *[np.zeros((1, 1))] * 3)
    plain = {name: value for name, value in stored.items() if name not in references}
    save73(path, {"cells": cells, **plain})
    with h5py.File(path, "r+") as file:
        file.move("cells", "#subsystem#/MCOS")
        file["#subsystem#/MCOS"].attrs["MATLAB_class"] = np.bytes_("FileWrapper__")
        file["#subsystem#/MCOS"].attrs["MATLAB_object_decode"] = np.int32(3)
        for name, numbers in references.items():
            file[name] = numbers
            file[name].attrs["MATLAB_class"] = np.bytes_(variables[name].kind)
            file[name].attrs["MATLAB_object_decode"] = np.int32(3)
    return path


def _plain(store):
    """A store with the same table and no values."""
    plain = Store()
    plain.names, plain.classes, plain.objects, plain.blocks = store.names, store.classes, store.objects, store.blocks
    return plain
