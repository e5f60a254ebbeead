"""An exported FMU as a simulation tool calls it: its library, by the functions of FMI 2.0."""

import ctypes
import zipfile
from pathlib import Path
from xml.etree.ElementTree import fromstring

import numpy as np

from kennfeld.base.fmi_platform import LIBRARY_SUFFIX, platform_folder

OK, ERROR = 0, 3
LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


class Callbacks(ctypes.Structure):
    _fields_ = [("logger", LOGGER), *((name, ctypes.c_void_p) for name in ("allocate", "free", "finished", "place"))]


class Fmi2:
    """The library of an FMU; `messages` are what its instances have logged."""

    def __init__(self, path: Path, folder: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
        self.description = fromstring((folder / "modelDescription.xml").read_text(encoding="utf-8"))
        variables = self.description.findall("ModelVariables/ScalarVariable")
        self.references = {v.get("name"): int(v.get("valueReference")) for v in variables}
        library = folder / "binaries" / platform_folder("2.0") / (path.stem + LIBRARY_SUFFIX)
        self.library = ctypes.CDLL(str(library))
        self.library.fmi2Instantiate.restype = ctypes.c_void_p
        self.library.fmi2FreeInstance.restype = None
        self.messages: list[str] = []
        self._log = LOGGER(lambda place, name, status, category, message: self.messages.append(message.decode()))
        self._callbacks = Callbacks(self._log)

    def instance(self, token: str | None = None, kind: int = 1) -> "Instance | None":
        token = token or self.description.get("guid")
        arguments = (b"one", kind, token.encode(), None, ctypes.byref(self._callbacks), 0, 0)
        pointer = self.library.fmi2Instantiate(*arguments)
        return Instance(self, pointer) if pointer else None


class Instance:
    def __init__(self, fmu: Fmi2, pointer: int) -> None:
        self.fmu, self.pointer = fmu, ctypes.c_void_p(pointer)

    def call(self, name: str, *arguments) -> int:
        return getattr(self.fmu.library, f"fmi2{name}")(self.pointer, *arguments)

    def begin(self, start: float = 0.0, **values: float) -> "Instance":
        zero = ctypes.c_double(0.0)
        assert self.call("SetupExperiment", 0, zero, ctypes.c_double(start), 0, zero) == OK
        assert self.call("EnterInitializationMode") == OK
        self.set(**values)
        assert self.call("ExitInitializationMode") == OK
        return self

    def set(self, **values: float) -> None:
        assert self.set_all(values) == OK

    def set_all(self, values) -> int:
        references = self._references(values)
        return self.call("SetReal", references, len(references), (ctypes.c_double * len(references))(*values.values()))

    def get(self, *names: str) -> list[float]:
        references, values = self._references(names), (ctypes.c_double * len(names))()
        assert self.call("GetReal", references, len(names), values) == OK
        return list(values)

    def step(self, time: float, step: float) -> int:
        return self.call("DoStep", ctypes.c_double(time), ctypes.c_double(step), 1)

    def derivative(self, output: str, direction: dict[str, float]) -> float:
        known, unknown, result = self._references(direction), self._references([output]), ctypes.c_double()
        seed = (ctypes.c_double * len(direction))(*direction.values())
        arguments = (unknown, 1, known, len(direction), seed, ctypes.byref(result))
        assert self.call("GetDirectionalDerivative", *arguments) == OK
        return result.value

    def saved(self) -> bytes:
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        assert self.call("GetFMUstate", ctypes.byref(state)) == OK
        assert self.call("SerializedFMUstateSize", state, ctypes.byref(size)) == OK
        content = ctypes.create_string_buffer(size.value)
        assert self.call("SerializeFMUstate", state, content, size) == OK
        assert self.call("FreeFMUstate", ctypes.byref(state)) == OK
        return content.raw

    def restore(self, content: bytes) -> int:
        state = ctypes.c_void_p()
        status = self.call("DeSerializeFMUstate", content, ctypes.c_size_t(len(content)), ctypes.byref(state))
        if status == OK:
            assert self.call("SetFMUstate", state) == OK
            assert self.call("FreeFMUstate", ctypes.byref(state)) == OK
        return status

    def run(self, time, columns, outputs) -> np.ndarray:
        """Return outputs over samples, Float[outputs, samples], with inputs set for the end of each step."""
        names = list(columns)
        self.begin(time[0], **{name: columns[name][0] for name in names})
        rows = [self.get(*outputs)]
        for k in range(1, len(time)):
            self.set(**{name: columns[name][k] for name in names})
            assert self.step(time[k - 1], time[k] - time[k - 1]) == OK
            rows.append(self.get(*outputs))
        return np.transpose(rows)

    def _references(self, names):
        return (ctypes.c_uint * len(names))(*(self.fmu.references[name] for name in names))
