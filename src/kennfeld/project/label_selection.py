"""Label lists that select parameters: `free = "@airpath.lab"`."""

import glob
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.formatting import count_labels, join_names, most_similar
from kennfeld.calfiles.label_list import LabelList, read_label_list
from kennfeld.domain.parameter_set import ParameterSet

MARK = "@"  # before the name of a label list
_MAX_COMPARED = 100  # names whose most similar one is looked for
_MAX_NAMED = 8  # names in a message
_MAX_OFFERED = 3  # names in a remedy


def listed_files(patterns: Iterable[str]) -> list[str]:
    """Return the label lists among patterns.

    >>> listed_files(["Map*", "@airpath.lab"])
    ['airpath.lab']
    """
    return [pattern.removeprefix(MARK) for pattern in patterns if pattern.startswith(MARK)]


def expand_lists(
    patterns: Iterable[str],
    folder: Path,
    parameters: ParameterSet,
    used: Collection[str],
    place: Location,
    findings: Findings,
) -> tuple[str, ...]:
    """Replace label lists by their labels, escaped as glob patterns.

    Args:
        patterns: patterns of names; `@` and a file, relative to the folder, is a label list.
        folder: the folder of the project file.
        parameters: known parameters, with the functions that they belong to.
        used: the parameters of the function.
        place: where the patterns are, for findings.
        findings: collects an error for a list that cannot be read or selects nothing, and one warning on each list
            with labels that the function does not use.
    """
    expanded: list[str] = []
    for pattern in patterns:
        # a parameter may itself be called @...
        if not pattern.startswith(MARK) or pattern in parameters:
            expanded.append(pattern)
            continue
        file = pattern.removeprefix(MARK)
        try:
            labels = read_label_list(folder / file)
        except InputError as error:
            findings.add(*(replace(each, location=place, message=f"{file}: {each.message}") for each in error.findings))
            continue
        selected = _selected(labels, parameters)
        chosen = [name for name in used if name in selected]
        expanded += map(glob.escape, chosen)
        findings.add(*_problems(file, labels, chosen, parameters, used, place))
    return tuple(expanded)


def _selected(labels: LabelList, parameters: ParameterSet) -> set[str]:
    """Return the names in a list, and those of the labels of its functions."""
    functions = set(labels.functions)
    return {*labels.labels, *(each.name for each in parameters.parameters if functions.intersection(each.functions))}


def _problems(
    file: str, labels: LabelList, chosen: list[str], parameters: ParameterSet, used: Collection[str], place: Location
) -> Iterator[Finding]:
    """Yield what is wrong with a list: that it selects nothing, or has names that the function does not use."""
    named = [*labels.labels, *labels.functions]
    if not named:
        measured = join_names(labels.measured, _MAX_NAMED)
        only = f", only measured variables under [RAMCELL]: {measured}" if measured else ""
        yield Finding(place, f"{file} lists no labels{only}", "Write the names under [LABEL].")
        return
    # lists of other tools name group axes and functions as well
    known = {*used, *(axis.name for axis in parameters.axes), *_functions(chosen, parameters)}
    unknown = [name for name in named if name not in known]
    if not chosen:
        remedy = _nearest(unknown, used) or f"The parameters are {join_names(used, _MAX_NAMED)}."
        yield Finding(place, f"{file} lists no parameter of the function: {join_names(named, _MAX_NAMED)}", remedy)
    elif unknown:
        others = [name for name in used if name not in chosen]
        message = f"{file} lists {count_labels(unknown)} that the function does not use"
        yield Finding(place, message, _nearest(unknown, others), severity="warning")


def _functions(names: Iterable[str], parameters: ParameterSet) -> set[str]:
    return {function for name in names if name in parameters for function in parameters[name].functions}


def _nearest(unknown: list[str], names: Collection[str]) -> str:
    """Return a question that offers the most similar names for the first unknown ones that have such."""
    pairs = ((name, most_similar(name, names)) for name in unknown[:_MAX_COMPARED])
    offers = list(islice((f"{similar} instead of {name}" for name, similar in pairs if similar), _MAX_OFFERED))
    return f"Did you mean {', '.join(offers)}?" if offers else ""
