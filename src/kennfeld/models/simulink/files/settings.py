"""What a file says of the model as a whole: solver, callbacks, workspace, dictionaries, defaults."""

from collections.abc import Iterator

from kennfeld.models.simulink.files.section import Section
from kennfeld.models.simulink.files.tree import Solver

__all__ = ["active_configuration", "callbacks_of", "defaults_of", "setting", "solver_from", "solver_of"]

_CALLBACKS = (
    "PreLoadFcn",
    "PostLoadFcn",
    "InitFcn",
    "StartFcn",
    "PauseFcn",
    "ContinueFcn",
    "StopFcn",
    "PreSaveFcn",
    "PostSaveFcn",
    "CloseFcn",
    "SetupFcn",
    "CleanupFcn",
)
_SOLVER = "Simulink.SolverCC"
_ELSEWHERE = "Simulink.ConfigSetRef"


def setting(model: Section, key: str) -> str:
    """What the model says under a key, in itself or in one of its groups of settings; empty where it says nothing."""
    return next((group.keys[key] for group in _groups(model) if key in group.keys), "")


def callbacks_of(model: Section) -> dict[str, str]:
    """The code of the callbacks by their names, of those that have any."""
    found = {name: setting(model, name) for name in _CALLBACKS}
    return {name: code for name, code in found.items() if code.strip()}


def defaults_of(*holders: Section | None) -> dict[str, dict[str, str]]:
    """The parameters that a file states for all blocks of a type, by type."""
    found: dict[str, dict[str, str]] = {}
    for holder in holders:
        table = holder.first("BlockParameterDefaults") if holder is not None else None
        for block in table.all("Block") if table is not None else ():
            keys = {key: value for key, value in block.keys.items() if key != "BlockType"}
            found.setdefault(block.keys.get("BlockType", ""), {}).update(keys)
    return found


def active_configuration(model: Section) -> Section | None:
    """The configuration that a model without configuration parts uses: the one it calls active, else the first."""
    sets = [part for part in model.every() if _class(part) in ("Simulink.ConfigSet", _ELSEWHERE)]
    named = next((part for part in sets if part.keys.get("PropName") == "ActiveConfigurationSet"), None)
    full = [part for part in sets if part is not named or part.parts]
    if named is None:
        named = next((p for p in model.every() if p.keys.get("PropName") == "ActiveConfigurationSet"), None)
    number = named.keys.get("ObjectID") if named is not None else None
    active = next((part for part in full if number and part.keys.get("ObjectID") == number), None)
    return active or next(iter(full), None)


def solver_of(configuration: Section | None, model: Section) -> Solver:
    """The solver of a configuration; of files that have none, what the model says by itself."""
    if configuration is None:
        return _solver(model) if any(key in model.keys for key in ("Solver", "StopTime")) else Solver()
    elsewhere = next(configuration.classed(_ELSEWHERE), None)
    if elsewhere is not None:
        return Solver(reference=elsewhere.get("SourceName") or elsewhere.get("WSVarName"))
    found = next(configuration.classed(_SOLVER), None)
    return _solver(found if found is not None else model)


def solver_from(entry: Section) -> Solver:
    """The solver of a configuration in a data dictionary, whose properties are sections of their own."""
    found = next((part for part in entry.every() if part.keys.get("Class") in (_SOLVER, _ELSEWHERE)), entry)
    said = {part.keys.get("Name", ""): part.text for part in found.all("P")}
    name = said.get("SolverName") or said.get("Solver", "")
    step, start, stop, largest = (said.get(key, "") for key in ("FixedStep", "StartTime", "StopTime", "MaxStep"))
    tasks = said.get("EnableMultiTasking") or said.get("SolverMode", "")
    return Solver(name, step, start, stop, largest, said.get("SourceName") or said.get("WSVarName", ""), tasks)


def _solver(section: Section) -> Solver:
    return Solver(
        name=section.get("SolverName") or section.get("Solver"),
        fixed_step=section.get("FixedStep"),
        start=section.get("StartTime"),
        stop=section.get("StopTime"),
        max_step=section.get("MaxStep"),
        tasks=section.get("EnableMultiTasking") or section.get("SolverMode"),
    )


def _class(section: Section) -> str:
    return section.keys.get("ClassName") or section.kind


def _groups(model: Section) -> Iterator[Section]:
    yield model
    yield from (part for part in model.parts if part.kind not in ("System", "Object", "Array"))
