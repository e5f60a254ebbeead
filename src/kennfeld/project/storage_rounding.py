"""The rounding of a project's result, to the steps of an A2L file, of an image, or of its parameters."""

from kennfeld.base.errors import Finding, Findings, InputError
from kennfeld.base.formatting import count_more
from kennfeld.calfiles.a2l.origin import FlashOrigin
from kennfeld.domain.free_axes import AxisKey
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.storage import Storage, rounding_of, with_rounding
from kennfeld.project.axes import axis_location
from kennfeld.project.schema import ProjectFile

MAX_REMARKS = 5  # on labels that are not rounded and breakpoints that are


def add_rounding(file: ProjectFile, problem: Problem, origin: object, findings: Findings) -> Problem:
    """Return the problem with the rounding of its result, as it is, with findings, if it has none that is valid.

    Args:
        file: the project file.
        problem: the problem.
        origin: the image that the initial values are from, if any.
        findings: collects what is wrong, and what is not rounded.
    """
    method, steps, axes = file.calibration.rounding, _steps(file), _axis_steps(file)
    if method is None:
        places = [file.location("parameters", name, "step") for name in steps]
        for location in (*places, *(axis_location(file, key) for key in axes)):
            findings.error(location, "step requires rounding", 'Write rounding = "joint" in [calibration].')
        return problem
    storage = _storage(file, origin)
    if storage is None and not (steps or axes):
        remedy = 'Write storage = "....a2l", or step = ... in the section of a parameter.'
        findings.error(file.location("calibration", "rounding"), "no step is known to round to", remedy)
        return problem
    try:
        rounding = rounding_of(method, storage, steps, file.calibration.max_shift, axes)
    except InputError as error:
        findings.add(*error.findings)
        return problem
    rounded, own = with_rounding(problem, rounding, lambda name: file.location("parameters", name))
    remarks = [finding for finding in own if finding.severity == "remark"]
    findings.add(*(finding for finding in own if finding.severity != "remark"), *remarks[:MAX_REMARKS])
    for line in count_more(len(remarks) - MAX_REMARKS, " that are not rounded, or whose breakpoints are"):
        findings.add(Finding(file.location("calibration", "rounding"), line, severity="remark"))
    return rounded


def _steps(file: ProjectFile) -> dict[str, float]:
    return {name: entry.step for name, entry in file.parameters.items() if entry.step is not None}


def _axis_steps(file: ProjectFile) -> dict[AxisKey, float]:
    own = {
        AxisKey(name, direction): axis.step
        for name, entry in file.parameters.items()
        for direction, axis in entry.axes.items()
    }
    steps = {**own, **{AxisKey(name): axis.step for name, axis in file.axes.items()}}
    return {key: step for key, step in steps.items() if step is not None}


def _storage(file: ProjectFile, origin: object) -> Storage | None:
    """Return the A2L file, or the description of the image that the initial values are from."""
    if file.calibration.storage:
        return file.folder / file.calibration.storage
    return origin.a2l if isinstance(origin, FlashOrigin) else None
