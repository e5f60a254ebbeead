"""Running code of the files that a project names: said once for each content of a file, or refused."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from kennfeld.errors import Finding, InputError, Location
from kennfeld.formatting import join_names
from kennfeld.graph.external_function import CodeNotRunError, ExternalFunction, code_gate
from kennfeld.graph.node import Node
from kennfeld.models.code_consent import allow, code_files, content_digest, is_allowed
from kennfeld.models.function_files import kind_of, read_function_file
from kennfeld.models.model_function import as_model
from kennfeld.project.schema import ProjectFile
from kennfeld.terminal.output import print_always

MAX_NAMES = 4


@contextmanager
def announced_code() -> Iterator[None]:
    """Print a remark before code of a file runs in the block that this user has not run before."""
    with code_gate(_announce):
        yield


@contextmanager
def refused_code() -> Iterator[None]:
    """Let no code of a file run in the block: what would run it raises `CodeNotRunError`."""
    with code_gate(_refuse):
        yield


def announce_code(nodes: Iterable[Node]) -> None:
    """Print the remark now for all files whose code nodes of a graph call."""
    for function in dict.fromkeys(node.payload.function for node in nodes if node.op == "external"):
        _announce(function)


def announce_files(file: ProjectFile) -> None:
    """Print the remark now for all functions that a project file names: other processes may be the first that run them.

    A file that cannot be read is reported later.
    """
    for reference in (file.model.file, *file.functions.values()):
        kind = kind_of(reference)
        if kind is not None and kind.runs:
            with suppress(InputError):
                announce_code(as_model(read_function_file(reference, file.folder)).graph.nodes)


def unchecked_code(nodes: Iterable[Node], path: Path) -> Iterator[Finding]:
    """Yield a remark on the files of a project whose code was not run."""
    names = [file.name for file in code_files(nodes)]
    if names:
        message = f"not checked, because code of {join_names(names, MAX_NAMES, ' and ')} was not run: its values"
        yield Finding(Location(path.name), message, severity="remark")


def _refuse(function: ExternalFunction) -> None:
    if function.file is not None:
        raise CodeNotRunError([Finding(Location(function.file.name), "its code was not run")])


def _announce(function: ExternalFunction) -> None:
    if function.file is None:
        return
    try:
        digest = content_digest(function.file)
    except OSError:
        return  # its loader reports it
    if not is_allowed(digest):
        message = f"runs code of {function.file.name}"
        print_always(Finding(Location(), message, "Said once for each content of the file.", severity="remark"))
        allow(digest)
