"""Parameters with a value for each recording, such as an offset that differs from day to day.

`per = "recording"` turns a scalar of the function into a curve over the number of the recording, a channel that the
recordings have without being recorded. It has a breakpoint for each, and is read at these alone.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding
from kennfeld.domain.dataset import Dataset
from kennfeld.graph import GraphBuilder
from kennfeld.graph.traversal import coordinates_of, rewrite
from kennfeld.preprocessing.recordings import RECORDING
from kennfeld.project.model import ProjectModel
from kennfeld.project.schema import ProjectFile


def names_per_recording(file: ProjectFile) -> set[str]:
    """Return the parameters that have a value for each recording."""
    return {name for name, entry in file.parameters.items() if entry.per}


def with_values_per_recording(function: ProjectModel, names: set[str]) -> ProjectModel:
    """Return the function with lookups over the number of the recording in place of scalars."""
    graph = function.graph
    scalars = {name for name in names if name in graph.parameters and not coordinates_of(graph, name)}
    if not scalars:
        return function

    def resolve(b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        op, _, payload = graph.nodes[at]
        if op == "lookup" and payload in scalars:
            return b.lookup(payload, b.input(RECORDING))
        return b.node(op, args, payload)

    return replace(function, model=replace(function.model, graph=rewrite(graph, resolve)))


def check_recording_parameters(file: ProjectFile, function: ProjectModel) -> Iterator[Finding]:
    """Yield an error for each table of the function that is to have a value for each recording."""
    for name in sorted(names_per_recording(file)):
        coordinates = coordinates_of(function.graph, name) if name in function.graph.parameters else []
        if coordinates and coordinates != [RECORDING]:
            message = f"{name} is a table of the function; only scalars can have a value for each recording"
            remedy = 'Multiply or add a scalar in the function, and give that one per = "recording".'
            yield Finding(file.location("parameters", name, "per"), message, remedy)


def recording_numbers(datasets: Sequence[Dataset]) -> Float:
    """Return the numbers of the recordings of some datasets, Float[recordings]."""
    columns = [data[RECORDING].values for data in datasets if RECORDING in data]
    values = np.concatenate([*columns, np.zeros(0)])
    return np.unique(values[np.isfinite(values)])
