"""The files that a script loads or calls: scripts, files of functions, and data files."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from kennfeld.base.errors import InputError
from kennfeld.matlab.parser import parse_leniently
from kennfeld.matlab.values import MatlabValueError, Value, from_python, text
from kennfeld.program import tree as m

# The content of a file by its name: the text of `x.m`, the bytes or the variables of `x.mat`, None if there is none.
Files: TypeAlias = Callable[[str], "bytes | str | Mapping[str, Any] | None"]


class ScriptFiles:
    """Reads the files of a script; files of functions are parsed once.

    `missing` are the names of files that the script needs and that do not exist.
    """

    def __init__(self, files: Files) -> None:
        self._files = files
        self.missing: dict[str, None] = {}
        self._parsed: dict[str, m.Script | None] = {}

    def text(self, name: str) -> str | None:
        """Return the text of a script file; None if there is no such file."""
        content = self._files(name)
        return _decode(content) if isinstance(content, bytes | str) else None

    def not_found(self, name: str) -> MatlabValueError:
        """Record a file that the script needs and that does not exist; return the error to raise."""
        self.missing[name] = None
        return MatlabValueError(f"file {name} not found")

    def functions(self, name: str) -> tuple[m.FunctionDefinition, ...]:
        """Return the functions that `name.m` defines; none if it is a script or does not exist."""
        if name not in self._parsed:
            content = self.text(f"{name}.m")
            self._parsed[name] = None if content is None else parse_leniently(content, f"{name}.m")[0]
        script = self._parsed[name]
        return () if script is None or script.statements else script.functions

    def load(self, arguments: Sequence[Value]) -> dict[str, Value]:
        """Return the variables that `load(arguments)` reads from a data file.

        Raises:
            MatlabValueError: There is no such file, it is damaged, or it lacks a requested variable.
        """
        words = [word for word in map(text, arguments) if not word.startswith("-")]
        if not words:
            raise MatlabValueError("load requires a file name")
        name = words[0] if words[0].casefold().endswith(".mat") else f"{words[0]}.mat"
        variables = self._variables(name)
        missing = [word for word in words[1:] if word not in variables and "*" not in word]
        if missing:
            raise MatlabValueError(f"{name} does not contain the variable {missing[0]}")
        return {key: value for key, value in variables.items() if len(words) == 1 or key in words}

    def _variables(self, name: str) -> dict[str, Value]:
        content = self._files(name)
        if content is None:
            raise self.not_found(name)
        if isinstance(content, Mapping):
            return {key: from_python(value) for key, value in content.items()}
        if isinstance(content, str):
            raise MatlabValueError(f"{name} is not a data file")
        from kennfeld.matlab.mat_reader import load_variables

        try:
            return load_variables(content, name)
        except InputError as error:
            raise MatlabValueError(f"{name}: {error.findings[0].message}") from None


def _decode(content: bytes | str) -> str:
    if isinstance(content, str):
        return content
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")
