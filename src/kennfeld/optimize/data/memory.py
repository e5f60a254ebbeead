"""The memory that long delays and many free values would take: better refused by a check than during a search."""

from kennfeld.errors import Finding
from kennfeld.graph.lowering import dependent
from kennfeld.models import Model

__all__ = ["delay_findings", "matrix_findings"]

MOST = 4e9  # bytes of all delays, or of one matrix, of which a fit and its account of trust keep several


def delay_findings(model: Model, values: int) -> list[Finding]:
    """Return an error if the delays of a model keep more numbers than fit into memory.

    Args:
        model: the model; each step of each delay keeps a value, and its slope with respect to each free value.
        values: how many values are free; 0 for a simulation.
    """
    graph = model.graph
    steps = sum(state.latency for state in graph.states)
    size = 8.0 * steps * (2 + values)
    if size <= MOST:
        return []
    longest = max(range(len(graph.states)), key=lambda i: graph.states[i].latency)
    behind = dependent(graph, lambda node: node.op == "state" and node.payload == longest)
    name = min((name for name, at in graph.names.items() if at in behind), key=graph.names.__getitem__, default="")
    what = f"a delay of {graph.states[longest].latency:.10g} steps needs {size / 1e9:.3g} GB of memory"
    return [
        Finding(model.places.get(name, model.source), what, "Delay by fewer steps, or give the model a longer step.")
    ]


def matrix_findings(place: str, values: int) -> list[Finding]:
    """Return an error if the matrix of a fit, with a row and a column for each free value, does not fit into memory.

    Args:
        place: where the parameters are said to be free.
        values: how many values are free.
    """
    size = 8.0 * values**2
    if size <= MOST:
        return []
    what = f"{values} values to fit need matrices of {size / 1e9:.3g} GB"
    return [Finding(place, what, "Use fewer breakpoints, or fit fewer parameters at once.")]
