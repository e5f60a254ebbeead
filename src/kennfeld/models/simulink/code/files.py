"""Functions in files: `name.m` beside the model, in its folders, or among the parameters. They are read, never run."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_script
from kennfeld.models.simulink.code.errors import CodeError

__all__ = ["FunctionFiles"]

_NAME = re.compile(r"[A-Za-z]\w{0,127}\Z")
_LARGEST = 2_000_000  # bytes


class FunctionFiles:
    """The functions of files by the names of the files; `given` are files that are named one by one."""

    def __init__(self, folders: Iterable[Path], given: Iterable[Path] = ()) -> None:
        self._given = {path.stem: path for path in given if path.suffix == ".m"}
        self._folders = tuple(folders)
        self._read: dict[str, Mapping[str, m.FunctionDefinition]] = {}

    def find(self, name: str) -> Mapping[str, m.FunctionDefinition]:
        """The functions of the file that is called `name.m`, its first one by that name; none of a script."""
        if name not in self._read:
            path = self._path(name)
            self._read[name] = _functions(path) if path is not None else {}
        return self._read[name]

    def _path(self, name: str) -> Path | None:
        if not _NAME.match(name):
            return None
        places = [self._given[name]] if name in self._given else [folder / f"{name}.m" for folder in self._folders]
        return next((path for path in places if path.is_file()), None)


def _functions(path: Path) -> Mapping[str, m.FunctionDefinition]:
    try:
        if path.stat().st_size > _LARGEST:
            raise CodeError(f"the file {path.name} is too large for a function")
        script = parse_script(path.read_bytes().decode("utf-8", "replace"), path.name)
    except OSError as error:
        raise CodeError(f"the file {path.name} cannot be read: {error.strerror or error}") from None
    except InputError as error:
        raise CodeError(str(error.findings[0])) from None
    if not script.functions or script.statements:
        return {}
    return {**{one.name: one for one in script.functions}, path.stem: script.functions[0]}
