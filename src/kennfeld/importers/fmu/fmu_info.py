"""Description of an FMU, from its model description alone."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from kennfeld.base.formatting import join_names, number_text
from kennfeld.files.file_info import DescribedFile, FileInfo, Table
from kennfeld.importers.fmu.fmu_archive import read_archive
from kennfeld.models.importer import FileFacts
from kennfeld.models.quantities import PARAMETER_KINDS

if TYPE_CHECKING:
    from kennfeld.importers.fmu.description import FmuDescription
    from kennfeld.importers.fmu.fmu_parameters import ParameterGroup

_MOST_PLATFORMS = 8
_MOST_OTHERS = 50  # rows of variables that are not outputs


def facts(path: Path) -> FileFacts:
    """Return what an FMU says of itself. Raises `InputError` if the file is damaged."""
    description = read_archive(path)
    offered = {"model exchange": description.model_exchange, "co-simulation": description.co_simulation}
    words = [word for word, interface in offered.items() if interface is not None]
    rows = [
        ("standard", f"FMI {description.version} for {' and '.join(words)}"),
        ("model", description.name),
        ("exported by", description.tool),
        ("platforms", ", ".join(description.platforms)),
        ("variables", str(len(description.variables))),
    ]
    choices = [word.replace(" ", "-") for word in ("co-simulation", "model exchange") if word in words]
    states = [element for state in description.states for element in state.elements]
    return FileFacts(rows, choices if len(choices) > 1 else (), states)


def describe_fmu(file: DescribedFile) -> FileInfo:
    """Describe an FMU: its interfaces, inputs, outputs, states and parameters. None of its code runs.

    Args:
        file: the file, with the interface as its choice; by default the one that is used.

    Raises:
        InputError: the file is damaged.
    """
    from kennfeld.importers.fmu.chosen_outputs import choose_outputs
    from kennfeld.importers.fmu.importing import (
        CO_SIMULATION,
        INTERFACES,
        find_obstacles,
        find_remarks,
        interface_of,
        usable_interface,
    )

    path = file.path
    stated = read_archive(path)
    description = stated.with_outputs(choose_outputs(stated, (), path))
    used = file.choice or usable_interface(description, path)
    interfaces = [each for each in INTERFACES if interface_of(description, each) is not None]
    numbers = _FmuNumbers.of(description, stepped=used == CO_SIMULATION)
    obstacles = find_obstacles(description, path, used)
    remarks = [f"a command that evaluates it runs code of {path.name}"]
    remarks += [remark.message for remark in find_remarks(description, path, used)]
    # how it would run does not matter if it cannot
    notes = [finding.message for finding in obstacles] or remarks
    notes += _choice_notes(len(numbers.others))
    offered = " and ".join(INTERFACES[each] for each in interfaces) or "no interface"
    platforms = join_names(description.platforms, _MOST_PLATFORMS, " and ") or "no platform"
    step = "" if description.step is None else f", step {description.step:g} s"
    summary = f"{path.name}: FMI {description.version} for {offered}, {platforms}{step}"
    as_json = {
        "content": "fmu",
        "file": path.name,
        "version": description.version,
        "name": description.name,
        "tool": description.tool,
        "interfaces": interfaces,
        "interface": used,
        "platforms": list(description.platforms),
        "step": description.step,
        "event_indicators": description.indicators,
        **numbers.as_json(),
        "usable": not obstacles,
    }
    return FileInfo(summary, numbers.tables(), notes, as_json)


class _FmuNumbers(NamedTuple):
    """The numbers of an FMU: inputs, outputs and states with their units, and parameters."""

    inputs: "Sequence[tuple[str, str]]"
    parameters: "Sequence[ParameterGroup]"
    variability: "Mapping[str, str]"
    states: "Sequence[tuple[str, str, str]]"
    outputs: "Sequence[tuple[str, str]]"
    others: "Sequence[tuple[str, str, str]]"

    @classmethod
    def of(cls, description: "FmuDescription", *, stepped: bool) -> "_FmuNumbers":
        """Return those of an FMU; `stepped` for co-simulation, where start values replace states."""
        from kennfeld.importers.fmu.chosen_outputs import computed_variables
        from kennfeld.importers.fmu.fmu_parameters import parameter_groups, start_groups

        kept = description.started_states if stepped else description.states
        starts = start_groups(description.started_states)
        variability = {v.name: v.variability for v in description.parameters}
        outputs = description.number_outputs
        return cls(
            [(name, v.unit) for v in description.number_inputs for name in v.elements],
            (*parameter_groups(description.parameters), *starts),
            variability | dict.fromkeys((group.name for group in starts), "start value"),
            [(name, v.unit, _start(v.start, k)) for v in kept for k, name in enumerate(v.elements)],
            [(name, v.unit) for v in outputs for name in v.elements],
            [(v.name, v.unit, v.type) for v in computed_variables(description) if v not in outputs],
        )

    def tables(self) -> list[Table]:
        """Return a table for each kind of number."""
        rows = _parameter_rows(self.parameters, self.variability)
        return [
            [("input", "unit"), *self.inputs],
            [("parameter", "kind", "unit", "start", "minimum", "maximum", ""), *rows],
            [("state", "unit", "start"), *self.states],
            [("output", "unit"), *self.outputs],
            [("other variable", "unit", "type"), *self.others[:_MOST_OTHERS]],
        ]

    def as_json(self) -> dict[str, Any]:
        """Return the lists of `kennfeld info --json`."""
        return {
            "inputs": [{"name": name, "unit": unit} for name, unit in self.inputs],
            "parameters": [
                {
                    "name": p.name,
                    "kind": PARAMETER_KINDS[len(p.shape)],
                    "unit": p.unit,
                    "values": p.values if isinstance(p.values, float) else p.values.tolist(),
                }
                for p in self.parameters
            ],
            "states": [{"name": name, "unit": unit} for name, unit, _ in self.states],
            "outputs": [{"name": name, "unit": unit} for name, unit in self.outputs],
            "other_variables": [{"name": name, "unit": unit, "type": kind} for name, unit, kind in self.others],
        }


def _choice_notes(others: int) -> list[str]:
    """Return what the user can do with the variables that are no nodes, of which there are so many."""
    if not others:
        return []
    # thousands of variables would hide the tables above
    cut = f"; {others - _MOST_OTHERS} more are listed by --json" if others > _MOST_OTHERS else ""
    return [f"`outputs` under [model], or of kf.fmu, makes other variables nodes{cut}"]


def _start(values: tuple[float, ...], number: int) -> str:
    return number_text(values[number]) if number < len(values) else ""


def _parameter_rows(groups: "Sequence[ParameterGroup]", variability: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    number = cache(number_text)  # many parameters have the same limits
    for name, shape, values, unit, lower, upper in groups:
        start = number(values) if isinstance(values, float) else " x ".join(map(str, shape))
        least = lower if isinstance(lower, float) else float(lower.min())
        most = upper if isinstance(upper, float) else float(upper.max())
        shown = [number(limit) if math.isfinite(limit) else "" for limit in (least, most)]
        yield name, PARAMETER_KINDS[len(shape)], unit, start, *shown, variability.get(name, "")
