"""The function of a project, also if the project lacks data, parameters or criteria."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from kennfeld.app.session.function_source import imported_model, read_called
from kennfeld.app.session.initial_files import initial_names
from kennfeld.app.session.proposal import read_function
from kennfeld.base.errors import Finding, InputError
from kennfeld.models import Model
from kennfeld.models.formula import read as read_formula


def function_reference(settings: Mapping[str, Any]) -> str:
    """Return the function that a project names in `[model] file`; empty if it names none."""
    model = settings.get("model")
    name = model.get("file") if isinstance(model, dict) else None
    return name if isinstance(name, str) else ""


def formula_file(settings: Mapping[str, Any]) -> str:
    """Return the name of the formula file of a project; empty if the function is something else."""
    name = function_reference(settings)
    return name if name.lower().endswith(".kf") else ""


class FunctionReader:
    """Reads the function of a project by itself; one of another tool once for each version of the project file.

    Args:
        path: the project file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._imported: tuple[int, Model | None] | None = None  # by the revision of the texts

    def of_text(self, settings: Mapping[str, Any], text: str) -> Model | None:
        """Return the function of a formula text, also if its parameters are not defined yet; None if it has errors."""
        called = read_called(settings, self._path)
        # a text that declares its inputs leaves no other name open, but for parameters that are known
        return read_function(text, called) or read_function(text, called, self._parameter_names(settings))

    def imported(self, settings: Mapping[str, Any], text_revision: int) -> Model | None:
        """Return the function of another tool; None if it cannot be read."""
        if self._imported is None or self._imported[0] != text_revision:
            self._imported = text_revision, imported_model(settings, self._path)
        return self._imported[1]

    def errors(self, settings: Mapping[str, Any], text: str, known: Collection[Finding]) -> tuple[Finding, ...]:
        """Return what is wrong in formula text, which a project that lacks data is not checked for.

        Args:
            settings: the tables of the project file.
            text: the formula text.
            known: what is wrong in the project; if anything of it is about the text, nothing is added.
        """
        file = formula_file(settings)
        if any(finding.location.file.endswith(Path(file).name) for finding in known):
            return ()
        try:
            read_formula(self._path.parent / file, None, (), text, read_called(settings, self._path))
        except InputError as error:
            return error.findings
        return ()

    def _parameter_names(self, settings: Mapping[str, Any]) -> list[str]:
        """Return the names of the parameters that have a section, or that the initial files provide."""
        sections = settings.get("parameters")
        return [*(sections if isinstance(sections, dict) else ()), *initial_names(settings, self._path).names]
