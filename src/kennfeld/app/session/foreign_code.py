"""Code of other tools that the function of a project runs, and whether the user has allowed it."""

from collections.abc import Iterator

from kennfeld.app.session.function_source import FunctionSource
from kennfeld.errors import Finding, Location
from kennfeld.lazy_dataclass import dataclass
from kennfeld.models.code_consent import content_digest, is_allowed
from kennfeld.models.function_files import kind_of
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


def undecided_code(file: ProjectFile, text: str | None) -> tuple[ForeignCode, ...]:
    """Return the files whose code the function may run and that the user has not allowed, with their present contents.

    Args:
        file: the project file. Its problem is not built, because that can evaluate nodes.
        text: the formula text; functions whose names it does not contain are not called. None if it is unknown.
    """
    codes = {source.path.resolve(): code for source, code in _codes(file, text) if not is_allowed(code.digest)}
    return tuple(codes.values())


def _codes(file: ProjectFile, text: str | None) -> Iterator[tuple[FunctionSource, ForeignCode]]:
    for source in _sources(file, text):
        if source.runs:
            location = file.location("functions", source.name) if source.name else file.location("model", "file")
            yield source, ForeignCode(source.path.name, _digest(source), location)


def _sources(file: ProjectFile, text: str | None) -> Iterator[FunctionSource]:
    step = file.model.step
    if kind_of(file.model.file) is not None:
        yield FunctionSource(file.folder, file.model.file, step=step)
        return
    for name, reference in file.functions.items():
        if text is None or name in text:
            yield FunctionSource(file.folder, reference, name, step)


def _digest(source: FunctionSource) -> str:
    try:
        return content_digest(source.path)
    except OSError:
        return ""  # nobody has allowed that
