"""Functions in files: `name.m` beside the model, in its folders, or among the parameters; enumerations as well.

They are read, never run.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_script
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.variables.enumerations import beside, is_class
from kennfeld.models.simulink.variables.scopes import Variable

__all__ = ["FunctionFiles"]

_NAME = re.compile(r"[A-Za-z]\w{0,127}\Z")
_LARGEST = 2_000_000  # bytes


class FunctionFiles:
    """Functions and enumerations by the names of their files; `given` are files that are named one by one."""

    def __init__(self, folders: Iterable[Path], given: Iterable[Path] = ()) -> None:
        self._given = {path.stem: path for path in given if path.suffix == ".m"}
        self._folders = tuple(folders)
        self._read: dict[str, Mapping[str, m.FunctionDefinition]] = {}
        self._enumerations: dict[str, Variable | None] = {}

    def find(self, name: str) -> Mapping[str, m.FunctionDefinition]:
        """The functions of the file that is called `name.m`, its first one by that name; none of a script."""
        if name not in self._read:
            path = self._path(name)
            self._read[name] = _functions(path) if path is not None else {}
        return self._read[name]

    def enumeration(self, name: str) -> Variable | None:
        """The enumeration in the class file of a name; None where there is none."""
        if name not in self._enumerations:
            found = (beside(folder, name) for folder in self._folders)
            self._enumerations[name] = next((one for one in found if one is not None), None)
        return self._enumerations[name]

    def _path(self, name: str) -> Path | None:
        if not _NAME.match(name):
            return None
        places = [self._given[name]] if name in self._given else [folder / f"{name}.m" for folder in self._folders]
        return next((path for path in places if path.is_file()), None)


def _functions(path: Path) -> Mapping[str, m.FunctionDefinition]:
    try:
        if path.stat().st_size > _LARGEST:
            raise CodeError(f"the file {path.name} is too large for a function")
        text = path.read_bytes().decode("utf-8", "replace")
        if is_class(text):
            return {}
        script = parse_script(text, path.name)
    except OSError as error:
        raise CodeError(f"the file {path.name} cannot be read: {error.strerror or error}") from None
    except InputError as error:
        raise CodeError(str(error.findings[0])) from None
    if not script.functions or script.statements:
        return {}
    return {**{one.name: one for one in script.functions}, path.stem: script.functions[0]}
