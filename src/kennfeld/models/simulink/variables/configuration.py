"""What a model says of itself: the settings of its solver, and the names under which a mask asks for them."""

from typing import Final

from kennfeld.models.simulink.files.tree import Document, Solver
from kennfeld.models.simulink.variables.scopes import Value, Variable
from kennfeld.models.simulink.variables.variables import Variables

__all__ = ["asked", "settings_of"]

_NAMES: Final = ("bdroot", "gcs", "gcb")


def settings_of(document: Document, variables: Variables) -> tuple[Solver, str]:
    """The settings of the solver, those of the file or of the configuration that it refers to, and what is missing."""
    settings, seen = document.solver, set[str]()
    while settings.reference:
        name = settings.reference
        if name in seen or name not in variables.solvers:
            why = "leads back to itself" if name in seen else "was not found"
            return settings, f"the configuration {name[:60]} {why}: give the dictionary that holds it"
        seen.add(name)
        settings = variables.solvers[name]
    return settings, ""


def asked(document: Document, variables: Variables) -> dict[str, Variable]:
    """What `get_param` can ask of a model, under the names that stand for it: a struct of its settings as texts."""
    settings, _ = settings_of(document, variables)
    said = {"SolverName": settings.name, "Solver": settings.name, "FixedStep": settings.fixed_step}
    said |= {"StartTime": settings.start, "StopTime": settings.stop, "MaxStep": settings.max_step}
    value: dict[str, Value] = {"Name": document.name, **{key: text for key, text in said.items() if text}}
    return {name: Variable(value, source="the model itself", fixed=True) for name in _NAMES if name not in variables}
