"""Counts the `.axl` archives and `.amd` files of public repositories for `ascet_table.py`.

A component counts once for each content of its files. It is imported with all of its public methods. Parameters are
those that `kennfeld info` lists for an archive, or for a `.data.amd` file.
"""

import hashlib
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from kennfeld.ascet.amd.components import AscetComponent
from kennfeld.ascet.amd.files import ARCHIVE, DATA, MAIN, SPECIFICATION
from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe
from kennfeld.importers.ascet.component_tree import ComponentTree, code_components, open_components
from kennfeld.importers.ascet.importing import import_esdl

HEAD = "| repository | files | read | parameters | components | graphs | why others do not |"
MARKS = re.compile(r"(<!-- public components -->\n).*?(<!-- end of public components -->)", re.DOTALL)
_VARYING = re.compile(r"\S+\.\w+ (?=is implemented in C)")
_NAMES = re.compile(r"(?<=type )\S+|(?<=literal )\S+|line \d+|\S+(?=, whose class)")
_PARTS = (DATA, ".implementation.amd", SPECIFICATION)


@dataclass
class Counts:
    """What became of the files and components of a repository."""

    files: int = 0
    read: int = 0
    parameters: int = 0
    components: int = 0
    graphs: int = 0
    reasons: Counter[str] = field(default_factory=Counter)


def distinct_files(folder: Path, endings: tuple[str, ...], seen: set[str]) -> Iterator[Path]:
    """Yield the files of a folder with these endings whose content was not seen yet."""
    for path in sorted(path for ending in endings for path in folder.rglob(f"*{ending}")):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        if content not in seen:
            seen.add(content)
            yield path


def count(path: Path, counts: Counts, seen: set[str]) -> None:
    """Count an archive, or the component of a `.main.amd` file."""
    counts.files += 1
    data = path if path.suffix == ARCHIVE else path.with_name(path.name.removesuffix(MAIN) + DATA)
    try:
        counts.parameters += len(describe(data).parameters) + len(describe(data).texts)
        tree = open_components(path)
        components = code_components(tree)
    except InputError as error:
        counts.reasons[_general(error.findings[0].message)] += 1
        return
    counts.read += 1
    for own, component in components.items():
        if (not tree.main or own == tree.main) and (digest := _digest(tree, own)) not in seen:
            seen.add(digest)
            _count_component(path, own, component, counts)


def _digest(tree: ComponentTree, path: str) -> str:
    files = tree.library.files
    parts = [files.read(path + part) for part in (MAIN, *_PARTS) if path + part in files]
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


def _count_component(path: Path, own: str, component: AscetComponent, counts: Counts) -> None:
    methods = [method.name for method in component.methods if method.is_public]
    if not methods:
        return
    counts.components += 1
    try:
        result = import_esdl(path, own, methods, startup=[])
    except InputError as error:
        counts.reasons[_general(error.findings[0].message)] += 1
        return
    counts.graphs += result.model is not None
    if result.model is None:
        counts.reasons[_reason([finding.message for finding in result.report.findings])] += 1


def _reason(messages: list[str]) -> str:
    """Return the reason of a component: that its classes are missing or in C, if one of them is, or the first."""
    for part in ("unknown type", "is implemented in C"):
        for message in messages:
            if part in message:
                return "a class is missing" if part == "unknown type" else _general(message)
    return _general(messages[0])


def _general(message: str) -> str:
    return _NAMES.sub("...", _VARYING.sub("a method ", message))


def table(folders: list[Path]) -> str:
    """Return the table, a line for each folder that has such files."""
    files: set[str] = set()
    seen: set[str] = set()
    lines = [HEAD, "|---" * 7 + "|"]
    for folder in folders:
        counts = Counts()
        for path in distinct_files(folder, (ARCHIVE, MAIN), files):
            count(path, counts, seen)
        if counts.files:
            reasons = "; ".join(f"{text} ({number})" for text, number in counts.reasons.most_common())
            numbers = (counts.files, counts.read, counts.parameters, counts.components, counts.graphs)
            lines.append(f"| {folder.name} | {' | '.join(map(str, numbers))} | {reasons} |")
    return "\n".join([*lines, ""])
