"""Code of other tools that the function of a project runs, and whether the user has allowed it."""

from collections.abc import Iterator
from pathlib import Path

from kennfeld.app.code_consent import content_digest, is_allowed
from kennfeld.errors import Finding, Location
from kennfeld.graph import Graph
from kennfeld.lazy_dataclass import dataclass
from kennfeld.models.function_files import split_reference
from kennfeld.project.schema import ProjectFile

_REMEDY = "Allow it if you trust this file."


@dataclass(frozen=True)
class ForeignCode:
    """A file whose code runs with the function: its name for messages, its digest, and the key that names it."""

    file: str
    digest: str
    location: Location

    @property
    def finding(self) -> Finding:
        """The error that the function cannot be evaluated before the user has decided."""
        return Finding(self.location, f"runs code of {self.file}, which has not been allowed", _REMEDY)


def undecided_code(graph: Graph, file: ProjectFile) -> tuple[ForeignCode, ...]:
    """Return the files whose code the graph runs and that the user has not allowed, with their present contents."""
    codes = [_foreign_code(path, file) for path in dict.fromkeys(_sources(graph))]
    return tuple(code for code in codes if not is_allowed(code.digest))


def _sources(graph: Graph) -> Iterator[Path]:
    """Yield the files of external functions, whose first argument is the path by convention."""
    for node in graph.nodes:
        if node.op == "external":
            yield Path(str(node.payload.function.arguments[0]))


def _foreign_code(path: Path, file: ProjectFile) -> ForeignCode:
    try:
        digest = content_digest(path)
    except OSError:
        digest = ""  # nobody has allowed that
    return ForeignCode(path.name, digest, _location(path, file))


def _location(path: Path, file: ProjectFile) -> Location:
    """Return the place of the project file that names a file of code."""
    references = [("model", "file", file.model.file), *(("functions", *item) for item in file.functions.items())]
    for section, key, reference in references:
        if (file.folder / split_reference(reference)[0]).resolve() == path:
            return file.location(section, key)
    return file.location("functions")
