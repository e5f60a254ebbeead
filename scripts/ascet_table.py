"""Writes the tables of public ASCET projects in docs/ascet.md: files that parse, and classes that become graphs.

    python scripts/ascet_table.py FOLDER ... [--docs docs/ascet.md]

A folder is a copy of a repository. Files of the same content count once. Each class is imported with all of its public
methods, in the order of the file. The second table is that of `ascet_components.py`, on `.axl` and `.amd` files.
"""

import argparse
import re
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import ascet_components

from kennfeld.ascet import syntax as e
from kennfeld.ascet.parser import scan_esdl
from kennfeld.base.errors import InputError
from kennfeld.importers.ascet.declarations import read_source
from kennfeld.importers.ascet.importing import import_esdl

_MARKS = re.compile(r"(<!-- public projects -->\n).*?(<!-- end of public projects -->)", re.DOTALL)
_VARYING = re.compile(r"\b[\w.]+\.\w+ (?=is implemented in C)|(?<=unknown name )\w+|(?<=unknown type )\w+")


@dataclass
class Counts:
    """What became of the files and classes of a project."""

    files: int = 0
    parsed: int = 0
    classes: int = 0
    graphs: int = 0
    reasons: Counter[str] = field(default_factory=Counter)


def count(path: Path, counts: Counts) -> None:
    """Count a file and its classes."""
    parsed = scan_esdl(read_source(path), path.name)
    counts.files += 1
    counts.parsed += not parsed.findings
    for declaration in parsed.file.declarations:
        if isinstance(declaration, e.ClassDeclaration):
            methods = [item for item in declaration.methods if item.body is not None or item.triggers]
            public = [item.name for item in methods if "public" in item.modifiers] or [item.name for item in methods]
            if public:
                counts.classes += 1
                reason = _refusal(path, declaration.name, public)
                counts.graphs += not reason
                counts.reasons.update([reason] if reason else [])


def _refusal(path: Path, name: str, methods: list[str]) -> str:
    """Return why a class does not become a graph; empty if it does."""
    try:
        result = import_esdl(path, name, methods, startup=[])
    except InputError as error:
        return _general(error.findings[0].message)
    return "" if result.model is not None else _general(result.report.findings[0].message)


def _general(message: str) -> str:
    return _VARYING.sub(lambda match: "a method " if match[0].endswith(" ") else "of a missing file", message)


def table(folders: list[Path]) -> str:
    """Return the table, a line for each folder."""
    seen: set[str] = set()
    lines = ["| repository | files | parsed | classes | graphs | why others do not |", "|---|---|---|---|---|---|"]
    total = Counts()
    for folder in folders:
        counts = Counts()
        for path in ascet_components.distinct_files(folder, (".esdl",), seen):
            count(path, counts)
        lines.append(_row(folder.name, counts))
        for name in ("files", "parsed", "classes", "graphs"):
            setattr(total, name, getattr(total, name) + getattr(counts, name))
    return "\n".join([*lines, _row("all", total), ""])


def _row(name: str, counts: Counts) -> str:
    reasons = "; ".join(f"{text} ({number})" for text, number in counts.reasons.most_common())
    return f"| {name} | {counts.files} | {counts.parsed} | {counts.classes} | {counts.graphs} | {reasons} |"


def main() -> None:
    """Print the table, and write it into a document."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--docs", type=Path)
    options = parser.parse_args()
    texts = {_MARKS: table([folder for folder in options.folders if _has_classes(folder)])}
    texts[ascet_components.MARKS] = ascet_components.table(options.folders)
    print(*texts.values(), sep="\n")
    if options.docs is not None:
        document = options.docs.read_text(encoding="utf-8")
        for marks, text in texts.items():
            document = marks.sub(lambda match, text=text: f"{match[1]}{text}{match[2]}", document)  # type: ignore[misc]
        options.docs.write_text(document, encoding="utf-8")


def _has_classes(folder: Path) -> bool:
    return next(folder.rglob("*.esdl"), None) is not None


if __name__ == "__main__":
    main()
