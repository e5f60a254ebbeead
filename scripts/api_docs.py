"""Write the reference of the public names of the package, from their docstrings.

python scripts/api_docs.py docs
"""

import ast
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from docstrings import Docstring, parse

import kennfeld

__all__ = ["documents"]

_BLOCK = re.compile(r"(<!-- reference of ([^>]*) -->\n).*?(<!-- end of reference -->)", re.DOTALL)
_SHARED = {"Parameter": "kennfeld.domain.parameters.Parameter"}  # base classes, which are not called
_RETURNED = {
    "CrossValidation",
    "Graph",
    "Model",
    "Problem",
    "Project",
    "Quality",
    "RecordingQuality",
    "Result",
    "TraceLine",
    "Trust",
}  # not called
_INTERNAL = {  # members that only other parts of the package use
    "Block": {"index_axes"},
    "Criterion": {"internal"},
    "DynamicSurrogate": {"points", "longest"},
    "FilteredSurrogate": {"points"},
    "Parameter": {"packed", "index_axes", "coordinates", "limited"},
    "ParameterSet": {"chosen", "everything", "others_by_name", "from_origin"},
    "Problem": {
        *(
            "automatic",
            "automatic_names",
            "bind",
            "differences",
            "each",
            "excerpt",
            "factors",
            "gathered",
            "graph",
            "held",
        ),
        *(
            "idle_axes",
            "lowered",
            "once",
            "over",
            "parts",
            "partitions",
            "restraints",
            "skeleton",
            "target",
            "target_node",
        ),
        *("structure", "target_sources", "training", "unknown_shifts"),
    },
    "Project": {
        *("change_of_function", "cluster_address", "evaluated_by", "is_partitioned", "load", "on_cluster"),
        *("on_no_cluster", "prepared_files", "report", "saves", "seconds_read", "watch", "file", "formats"),
    },
    "Options": {"settings"},
    "RBF": {"value_slopes", "packed", "index_axes", "changed"},
    "Result": {"as_json", "inspection", "table", "recordings_table", "starts_table"},
    "RecordingQuality": {"as_json"},
    "Step": {"reduction"},
    "Trust": {"as_json", "estimate"},
    "report": {"document_safely"},
}


def documents(folder: Path) -> dict[Path, str]:
    """Return the pages of the public names, filled in; a name that none mentions comes last on the first."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(folder.glob("api*.md"))}
    mentioned = {name for text in texts.values() for match in _BLOCK.finditer(text) for name in match[2].split()}
    missing = [name for name in kennfeld.__all__ if name not in mentioned]
    if missing:
        names = f"\n## More names\n\n<!-- reference of {' '.join(missing)} -->\n<!-- end of reference -->\n"
        texts[folder / "api.md"] += names
    return {path: _BLOCK.sub(_fill, text) for path, text in texts.items()}


def _fill(match: re.Match[str]) -> str:
    parts = [line for name in match[2].split() for line in _Name.of(name).lines()]
    return "\n".join([match[1], *parts, match[3]])


class _Name:
    """A public name, or a member of one."""

    def __init__(self, name: str, value: Any) -> None:
        self.name, self.value = name, value
        self.text: Docstring = parse(inspect.getdoc(value) or "")

    @classmethod
    def of(cls, name: str) -> "_Name":
        if name not in _SHARED:
            return cls(name, inspect.unwrap(getattr(kennfeld, name)))  # a callable package is the function it wraps
        module, _, member = _SHARED[name].rpartition(".")
        return cls(name, getattr(import_module(module), member))

    def lines(self) -> Iterator[str]:
        """Yield the Markdown of the name, and of its members if it is a class."""
        yield from (f"### {self.name}", "")
        if inspect.ismodule(self.value):
            yield from self.body()
            for name in (name for name in self.value.__all__ if name not in _internal(self.name)):
                yield from _Name(f"{self.name}.{name}", getattr(self.value, name)).member_lines()
            return
        if self.name not in {*_RETURNED, *_SHARED} and not _is_exception(self.value):
            yield from self.signature()
        yield from self.body()
        if inspect.isclass(self.value):
            yield from self.members()

    def member_lines(self) -> Iterator[str]:
        """Yield the Markdown of a method whose docstring says more than what it returns."""
        yield from (f"#### {self.name}", "")
        yield from self.signature()
        yield from self.body()

    def body(self) -> Iterator[str]:
        """Yield description, tables and examples."""
        for paragraph in self.text.description:
            yield from (*_wrapped(paragraph), "")
        yield from self.table("Args", "argument")
        yield from self.table("Attributes", "attribute")
        if self.text.returns:
            yield from (*_wrapped(f"Returns: {self.text.returns}"), "")
        if raised := self.text.entries.get("Raises", {}):
            yield from (line for name, text in raised.items() for line in (*_wrapped(f"Raises `{name}`: {text}"), ""))
        if self.text.examples:
            yield from ("```pycon", *self.text.examples, "```", "")

    def table(self, section: str, heading: str) -> Iterator[str]:
        """Yield the table of arguments or attributes, the latter with their types."""
        entries = {k: v for k, v in self.text.entries.get(section, {}).items() if k not in _internal(self.name)}
        if not entries:
            return
        typed = section == "Attributes"
        yield f"| {heading} | type | meaning |" if typed else f"| {heading} | meaning |"
        yield "|---|---|---|" if typed else "|---|---|"
        for name, meaning in entries.items():
            kind = [f"`{self.annotations[name]}`" if name in self.annotations else ""] if typed else []
            yield _row(f"`{name}`", *kind, meaning)
        yield ""

    @cached_property
    def annotations(self) -> dict[str, str]:
        """The annotations of a class, with those of its bases, as its source spells them."""
        texts: dict[str, str] = {}
        for base in reversed(_bases(self.value)):
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
            assert isinstance(body, ast.ClassDef)
            fields = [node for node in body.body if isinstance(node, ast.AnnAssign)]
            texts |= {ast.unparse(node.target): _type(node.annotation) for node in fields}
        return texts

    def signature(self) -> Iterator[str]:
        """Yield how the name is called."""
        own = inspect.isclass(self.value) and "__init__" in vars(self.value) and _written(self.value.__init__)
        source = self.value.__init__ if own else self.value
        if inspect.isclass(source):
            arguments = self.fields()
        else:
            function = ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(_plain(source))))).body[0]
            assert isinstance(function, ast.FunctionDef)
            arguments = _arguments(function)
        returned = "" if inspect.isclass(self.value) else f" -> {_type(function.returns)}" if function.returns else ""
        line = f"{self.name}({', '.join(arguments)}){returned}"
        if len(line) <= 100:
            yield from ("```py", line, "```", "")
        else:
            yield from ("```py", f"{self.name}(", *(f"    {text}," for text in arguments), f"){returned}", "```", "")

    def fields(self) -> list[str]:
        """Return the fields of a dataclass as arguments."""
        texts = []
        for name, parameter in inspect.signature(self.value).parameters.items():
            default = "" if parameter.default is parameter.empty else f" = {_default(parameter.default)}"
            texts.append(f"{name}: {self.annotations.get(name, 'Any')}{default}")
        return texts

    def members(self) -> Iterator[str]:
        """Yield the table of properties and methods, and the methods that need more than a line."""
        members = list(_members(self.name, self.value))
        if not members:
            return
        yield from ("| member | meaning |", "|---|---|")
        longer = []
        for name, member in members:
            entry = _Name(f"{self.name}.{name}", member)
            if _is_property(member):
                yield _row(f"`{name}`", entry.text.summary)
                continue
            if {"Args", "Raises"} & set(entry.text.entries) or entry.text.examples or entry.text.returns:
                longer.append(entry)
                anchor = re.sub(r"[^\w\- ]", "", entry.name.lower())
                yield _row(f"[`{name}()`](#{anchor})", entry.text.summary)
            else:
                yield _row(f"`{name}({', '.join(_names(member))})`", " ".join(entry.text.description))
        yield ""
        for entry in longer:
            yield from entry.member_lines()


def _bases(value: type) -> list[type]:
    """Return a class and its bases of this package that are not public names of their own."""
    public = {id(getattr(kennfeld, name)) for name in kennfeld.__all__}
    own = [base for base in value.__mro__ if base.__module__.startswith("kennfeld")]
    return [base for base in own if base is value or id(base) not in public]


def _members(name: str, value: type) -> Iterator[tuple[str, Any]]:
    shared = {_SHARED[base].rpartition(".")[2] for base in _SHARED if base != name}
    for base in (base for base in _bases(value) if base.__name__ not in {*shared, "NotebookDisplay"}):
        for member, definition in vars(base).items():
            if member.startswith("_") or member in _internal(name) or not _is_member(definition):
                continue
            if inspect.getdoc(definition):
                yield member, definition


def _internal(name: str) -> set[str]:
    return _INTERNAL.get(name, set())


def _is_member(definition: Any) -> bool:
    return _is_property(definition) or inspect.isfunction(definition) or isinstance(definition, classmethod)


def _is_property(definition: Any) -> bool:
    return isinstance(definition, property | cached_property)


def _is_exception(value: Any) -> bool:
    return inspect.isclass(value) and issubclass(value, BaseException)


def _written(function: Any) -> bool:
    """Return True if a method has a source of its own, unlike those of dataclasses."""
    try:
        return inspect.getsource(function).lstrip().startswith("def __init__")
    except (OSError, TypeError):
        return False


def _plain(function: Any) -> Any:
    return function.__func__ if isinstance(function, classmethod) else function


def _names(function: Any) -> list[str]:
    parameters = inspect.signature(_plain(function)).parameters.values()
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    return [f"{stars.get(p.kind, '')}{p.name}" for p in parameters if p.name not in ("self", "cls")]


def _arguments(function: ast.FunctionDef) -> list[str]:
    """Return the arguments as they are written, without self."""
    given = function.args
    positional = [*given.posonlyargs, *given.args]
    defaults = [None] * (len(positional) - len(given.defaults)) + [ast.unparse(node) for node in given.defaults]
    texts = [_argument(arg, default) for arg, default in zip(positional, defaults, strict=True)]
    if given.vararg:
        texts.append(f"*{_argument(given.vararg, None)}")
    elif given.kwonlyargs:
        texts.append("*")
    for arg, node in zip(given.kwonlyargs, given.kw_defaults, strict=True):
        texts.append(_argument(arg, None if node is None else ast.unparse(node)))
    if given.kwarg:
        texts.append(f"**{_argument(given.kwarg, None)}")
    return [text for text in texts if text not in ("self", "cls")]


def _argument(argument: ast.arg, default: str | None) -> str:
    text = argument.arg if argument.annotation is None else f"{argument.arg}: {_type(argument.annotation)}"
    return text if default is None else f"{text} = {default.replace(chr(39), chr(34))}"


def _type(annotation: ast.expr) -> str:
    """Return an annotation without the quotes of names that are imported for type checkers only."""
    text = re.sub(r"""["']([A-Z][\w.| \[\],]*)["']""", r"\1", ast.unparse(annotation))
    return text.replace("'", '"')


def _default(value: Any) -> str:
    return "..." if "factory" in repr(value) else repr(value).replace("'", '"')


def _row(*cells: str) -> str:
    return "|" + "|".join(f" {cell.replace('|', chr(92) + '|')} " if cell else " " for cell in cells) + "|"


def _wrapped(paragraph: str) -> list[str]:
    return textwrap.wrap(paragraph, 120, break_long_words=False, break_on_hyphens=False)


if __name__ == "__main__":
    for path, text in documents(Path(sys.argv[1])).items():
        path.write_text(text, encoding="utf-8", newline="\n")
