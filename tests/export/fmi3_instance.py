"""An exported FMU as a simulation tool calls it, by the functions of FMI 3.0; arrays are set and read as a whole."""

import ctypes
import zipfile
from pathlib import Path
from xml.etree.ElementTree import fromstring

import numpy as np

from kennfeld.base.fmi_platform import LIBRARY_SUFFIX, platform_folder

OK = 0
_Real, _Size, _Flag = ctypes.c_double, ctypes.c_size_t, ctypes.c_bool


class Fmi3:
    """One instance in co-simulation, initialised at time 0."""

    def __init__(self, path: Path, folder: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
        description = fromstring((folder / "modelDescription.xml").read_text(encoding="utf-8"))
        variables = description.find("ModelVariables")
        self.references = {v.get("name"): int(v.get("valueReference")) for v in variables}
        self.library = ctypes.CDLL(str(folder / "binaries" / platform_folder("3.0") / (path.stem + LIBRARY_SUFFIX)))
        create = self.library.fmi3InstantiateCoSimulation
        create.restype = ctypes.c_void_p
        token, log = description.get("instantiationToken").encode(), ctypes.c_void_p()
        flags = (_Flag(False),) * 4
        self.pointer = ctypes.c_void_p(create(b"one", token, None, *flags, None, _Size(0), None, log, None))
        assert self.pointer

    def begin(self, values) -> None:
        assert (
            self.call("EnterInitializationMode", _Flag(False), _Real(0.0), _Real(0.0), _Flag(False), _Real(0.0)) == OK
        )
        self.set(values)
        assert self.call("ExitInitializationMode") == OK

    def call(self, name: str, *arguments) -> int:
        return getattr(self.library, f"fmi3{name}")(self.pointer, *arguments)

    def set(self, values) -> None:
        names, numbers = self._references(values), _numbers(values)
        assert self.call("SetFloat64", names, _Size(len(names)), numbers, _Size(len(numbers))) == OK

    def get(self, *names: str) -> list[float]:
        references, values = self._references(names), (_Real * len(names))()
        assert self.call("GetFloat64", references, _Size(len(names)), values, _Size(len(names))) == OK
        return list(values)

    def step(self, time: float, step: float) -> None:
        flags, last = [ctypes.byref(_Flag()) for _ in range(3)], ctypes.byref(_Real())
        assert self.call("DoStep", _Real(time), _Real(step), _Flag(True), *flags, last) == OK

    def derivative(self, output: str, direction) -> float:
        known, unknown, seed = self._references(direction), self._references([output]), _numbers(direction)
        result = _Real()
        sizes = _Size(1), _Size(len(known)), _Size(len(seed))
        arguments = unknown, sizes[0], known, sizes[1], seed, sizes[2], ctypes.byref(result), _Size(1)
        assert self.call("GetDirectionalDerivative", *arguments) == OK
        return result.value

    def _references(self, names):
        return (ctypes.c_uint * len(names))(*(self.references[name] for name in names))


def _numbers(values):
    flat = np.concatenate([np.ravel(np.asarray(value, dtype=np.float64)) for value in values.values()])
    return (_Real * flat.size)(*flat)
