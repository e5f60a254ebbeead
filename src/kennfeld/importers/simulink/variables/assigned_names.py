"""Names of the variables that files define, read without running or loading the files."""

import re
from collections.abc import Collection, Iterator
from dataclasses import field
from pathlib import Path

from kennfeld.base.errors import InputError
from kennfeld.base.file_state import note_opened
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from kennfeld.importers.simulink.variables.file_search import FileSearch
from kennfeld.matlab.enumerations import enumeration_of, is_class
from kennfeld.matlab.mat_reader import load_nodes
from kennfeld.matlab.parser import parse_leniently
from kennfeld.program import tree as m
from kennfeld.program.traversal import assigned_path, calls_in, expressions_in, paths_assigned

DATA_ENDINGS = (".m", ".mat", ".sldd")
_MAX_SCRIPT, _MAX_DATA = 500_000, 20_000_000  # bytes of a file
_MAX_READ = 60_000_000  # bytes of all files
_MAX_FOLLOWED = 100  # files that a script and those that it runs may run
# at the beginning of a statement: `run('x')`, `run x`, `load x.mat`, `S = load("x")`, `x;` and `x()`
_RUN = re.compile(r"^[ \t]*run\b[ \t]*\(?[ \t]*['\"]?([^'\"();%\n]+)", re.MULTILINE)
_LOAD = re.compile(r"^[^%'\"\n]*\bload\b[ \t]*\(?[ \t]*['\"]?([^'\"(),;%\s]+)", re.MULTILINE)
_BARE = re.compile(r"^[ \t]*([A-Za-z]\w*)[ \t]*(?:\([ \t]*\))?[ \t]*;?[ \t]*(?:%.*)?$", re.MULTILINE)


@dataclass
class AssignedNames:
    """The variables that files define.

    `wanted` are the names that count: a script that contains none of them is not parsed. `search` finds what scripts
    run and load, in their own folder and in `folder`, that of the model. `classes` are files of classes among those
    that have been read.
    """

    wanted: Collection[str]
    search: FileSearch
    folder: Path
    classes: set[Path] = field(default_factory=set)
    _texts: dict[Path, str] = field(default_factory=dict, repr=False)
    _own: dict[Path, frozenset[str]] = field(default_factory=dict, repr=False)
    _run: dict[Path, tuple[Path, ...]] = field(default_factory=dict, repr=False)
    _room: int = _MAX_READ

    def of(self, path: Path) -> frozenset[str]:
        """Return what a file defines: variables, and fields `a.b` of structs; for a script, also what it runs."""
        files = {path: self._of_file(path)}
        waiting = [path]
        while waiting and len(files) < _MAX_FOLLOWED:
            for file in self._run_by(waiting.pop()):
                if file not in files:
                    files[file] = self._of_file(file)
                    waiting.append(file)
        return frozenset().union(*files.values())

    def _of_file(self, path: Path) -> frozenset[str]:
        if path not in self._own:
            note_opened(path)
            ending = path.suffix.casefold()
            read = self._of_script if ending == ".m" else _of_dictionary if ending == ".sldd" else _of_data_file
            try:
                self._own[path] = read(path) if self._has_room(path, ending) else frozenset()
            except (OSError, InputError):
                self._own[path] = frozenset()
        return self._own[path]

    def _has_room(self, path: Path, ending: str) -> bool:
        size = path.stat().st_size
        self._room -= size
        return self._room >= 0 and size <= (_MAX_SCRIPT if ending == ".m" else _MAX_DATA)

    def _of_script(self, path: Path) -> frozenset[str]:
        text = self._texts[path] = path.read_bytes().decode("utf-8", "replace")
        if is_class(text):
            self.classes.add(path)
            enumeration = enumeration_of(text)
            # models find a class by the name of its file
            if enumeration is None or enumeration.name != path.stem:
                return frozenset()
            return frozenset(f"{enumeration.name}.{member}" for member in enumeration.members)
        words = "|".join(sorted({re.escape(name.partition(".")[0]) for name in self.wanted}))
        if not re.search(rf"\b(?:{words})\b", text):
            return frozenset()
        script, _ = parse_leniently(text, path.name)
        return frozenset(_assigned(script))

    def _run_by(self, path: Path) -> tuple[Path, ...]:
        """Return the files that a script runs and loads; several candidates may run the same script."""
        if path not in self._run:
            self._run[path] = tuple(self._find_run(path))
        return self._run[path]

    def _find_run(self, path: Path) -> Iterator[Path]:
        text = self._texts.get(path, "")
        names = [f"{name.strip().removesuffix('.m')}.m" for name in (*_RUN.findall(text), *_BARE.findall(text))]
        names += [f"{name.removesuffix('.mat')}.mat" for name in _LOAD.findall(text)]
        for name in dict.fromkeys(names):
            file = self.search.find(name, path.parent, self.folder)
            if file is not None:
                yield file


def _assigned(script: m.Script) -> Iterator[str]:
    """Yield what a script leaves in the workspace, as the evaluator runs it."""
    first = script.functions[0] if script.functions else None
    alone = not script.statements and first is not None and not first.parameters
    yield from paths_assigned(first.body if alone and first is not None else script.statements)
    whole = (script.statements, *(function.body for function in script.functions))
    for name, arguments in calls_in(whole):
        if name == "assignin" and len(arguments) == 3 and isinstance(arguments[1], m.Text):
            yield arguments[1].value
    yield from _described_buses(whole)


def _described_buses(tree: object) -> Iterator[str]:
    """Yield the buses that `Simulink.Bus.cellToObject` defines from `{name, ..., elements}`."""
    expressions = list(expressions_in(tree))
    calls = (node.of for node in expressions if isinstance(node, m.Call))
    if "Simulink.Bus.cellToObject" not in map(assigned_path, calls):
        return
    for node in expressions:
        for row in node.rows if isinstance(node, m.CellArray) else ():
            if row and isinstance(row[0], m.Text) and isinstance(row[-1], m.CellArray):
                yield row[0].value


def _of_data_file(path: Path) -> frozenset[str]:
    return frozenset(load_nodes(path.read_bytes()).variables)


def _of_dictionary(path: Path) -> frozenset[str]:
    return frozenset(read_dictionary(path, follow=False).data.entries)


def defines(names: Collection[str], wanted: str) -> bool:
    """Return whether names of variables and fields include a variable or field, a struct around it, or a part of it.

    >>> defines(["par", "x.a"], "par.K"), defines(["par.L"], "par.K"), defines(["par.K.x"], "par.K")
    (True, False, True)
    """
    parts = wanted.split(".")
    around = (".".join(parts[:count]) for count in range(1, len(parts) + 1))
    return any(name in names for name in around) or any(name.startswith(f"{wanted}.") for name in names)
