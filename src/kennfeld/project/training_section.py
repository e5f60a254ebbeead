"""The section `[surrogate]` of a training file; every value that cannot be used is reported."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kennfeld.errors import ArgumentError, nearest
from kennfeld.project.schema import MOST_STARTS
from kennfeld.project.section import Section, numeric
from kennfeld.surrogate.training import SurrogateSettings

__all__ = ["read_settings"]

DYNAMIC = (
    *("step", "lags", "output_lags", "longest_lag", "limits"),
    *("free_run", "moves_centres", "hold", "iterations"),
)
METHODS = {"static": ("auto", "exact", "sparse", "expansion"), "dynamic": ("auto", "sparse")}


def read_settings(root: Section, path: Path) -> tuple[SurrogateSettings | None, str]:
    """The settings, and the name of the file to write; no settings where findings say why."""
    section = root.section("surrogate", 'Write [surrogate] with inputs = ["..."] and output = "...".')
    if section is None:
        return None, ""
    before = len(section.findings)
    inputs, output = _channels(section)
    name = section.text("name") or (path.stem if path.stem != "surrogate" else output)
    kind = section.choice("kind", "static", tuple(METHODS))
    given = {"kind": kind, "method": _method(section, kind), **_numbers(section), **_dynamic(section, kind, inputs)}
    target = section.text("file") or f"{name}.json"
    _check_target(section, path, target)
    section.end()
    if len(section.findings) > before:
        return None, target
    try:
        return SurrogateSettings(name, inputs, output, **given), target
    except ArgumentError as error:
        section.report("", str(error))
        return None, target


def _channels(section: Section) -> tuple[tuple[str, ...], str]:
    for key in ("inputs", "output"):
        if not section.has(key):
            section.report(key, "the key is missing", "Write the names of channels.")
    inputs, output = section.texts("inputs"), section.text("output")
    if section.get("inputs") == []:
        section.report("inputs", "the list is empty", "Write the names of channels.")
    if output and output in inputs:
        section.report("output", f"{output} is one of the inputs too", "Remove it there.")
    return inputs, output


def _method(section: Section, kind: str) -> str:
    method = section.choice("method", "auto", METHODS["static"])
    if method not in METHODS[kind]:
        section.report("method", f'"{method}" is for static surrogates', 'Write "auto" or "sparse".')
    return method


def _numbers(section: Section) -> dict[str, Any]:
    default = SurrogateSettings
    return {
        "centres": section.whole("centres", default.centres, 1),
        "seed": section.whole("seed", default.seed, 0),
        "starts": section.whole("starts", default.starts, 1, MOST_STARTS),
    }


def _dynamic(section: Section, kind: str, inputs: Sequence[str]) -> dict[str, Any]:
    """The keys of dynamic surrogates alone."""
    if kind == "static":
        for key in DYNAMIC:
            if section.has(key):
                mend = 'Write kind = "dynamic", or remove it.'
                section.report(key, f"{key} has no meaning for a static surrogate", mend)
        return {}
    default = SurrogateSettings
    given = {
        "step": section.number("step", 0.0, 0.0, above=True) or None,
        "lags": _lags(section, inputs),
        "output_lags": _whole_numbers(section, "output_lags", 1),
        "longest_lag": section.whole("longest_lag", default.longest_lag, 1),
        "free_run": section.flag("free_run") is not False,
        "moves_centres": section.flag("moves_centres") is True,
        "hold": section.number("hold", 0.0, 0.0) if section.has("hold") else None,
        "iterations": section.whole("iterations", default.iterations, 1),
    }
    limits = _limits(section)
    return given if limits is None else given | {"limits": limits}


def _lags(section: Section, inputs: Sequence[str]) -> Any:
    """Lags by input, or "auto"."""
    if section.get("lags") in (None, "auto"):
        return "auto"
    inner = section.inner("lags")
    if inner is None:
        return "auto"
    for name in inner.values:
        if inputs and name not in inputs:
            inner.report(name, f"{name} is no input", nearest(name, inputs) or f"Inputs are {', '.join(inputs)}.")
    for name in inputs:
        if name not in inner.values:
            inner.report(name, "the input is missing", f"Write {name} = [0], the present sample, or others.")
    return {name: _whole_numbers(inner, name, 0) for name in inner.values}


def _whole_numbers(section: Section, key: str, least: int) -> Any:
    value = section.get(key)
    if value is None or (value == "auto" and least):
        return "auto"
    numbers = value if isinstance(value, list) else [value]
    whole = all(isinstance(number, int) and not isinstance(number, bool) and number >= least for number in numbers)
    if not whole or not numbers:
        mend = f"Write {key} = [1, 2]" + (', or "auto".' if least else ".")
        section.report(key, f"{value!r} must be whole numbers of samples from {least} on", mend)
        return "auto"
    return tuple(numbers)


def _limits(section: Section) -> tuple[float, float] | None:
    """Two numbers, either of which may be infinite."""
    value = section.get("limits")
    if value is None:
        return None
    ends = [numeric(end) for end in value] if isinstance(value, list) else []
    if len(ends) != 2 or ends[0] is None or ends[1] is None or not ends[0] < ends[1]:
        section.report("limits", f"{value!r} is no pair of a lower and a higher number", "Write limits = [0, inf].")
        return None
    return ends[0], ends[1]


def _check_target(section: Section, path: Path, target: str) -> None:
    """What would make the file fail to be written after all the training."""
    file = path.parent / target
    if not file.parent.is_dir():
        section.report("file", f"there is no folder {Path(target).parent}", "Make it, or name another one.")
    elif file.is_dir():
        section.report("file", f"{target} is a folder", 'Write file = "....json".')
    elif file.resolve() == path.resolve():
        section.report("file", f"{target} is this training file itself", 'Write file = "....json".')
