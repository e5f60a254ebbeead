"""A model that has a graph, whatever it was read from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from kennfeld.graph import Graph
from kennfeld.parameters import ParameterSet

if TYPE_CHECKING:  # most models call none
    from kennfeld.surrogate import Surrogate

__all__ = ["Model", "started"]


def _nothing() -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True)
class Model:
    """The graph of one time step, and what its source says about it.

    `step` is the model's own step in s, None where the data decide. `declared` are the parameters that the source
    declares, each with its number of axes; `graph.parameters` are those that are looked up. `source` is the path,
    or "formula". `places` says where a node, a parameter or an input stands in the source, for later checks.
    `surrogates` are the data-driven models that it calls. `values` are the parameters that the source gives values.
    `remarks` are sentences on what runs in another way than in the source.

    >>> from kennfeld.models.formula import formula
    >>> model = formula("y[Nm] = Gain(u) * k", name="demo", parameters=["Gain", "k"])
    >>> model.graph.inputs, dict(model.graph.parameters), model.places["y"]
    (('u',), {'Gain': 1, 'k': 0}, 'demo line 1')
    """

    graph: Graph
    name: str = "model"
    step: float | None = None
    declared: Mapping[str, int] = field(default_factory=_nothing)
    source: str = ""
    places: Mapping[str, str] = field(default_factory=_nothing)
    surrogates: "tuple[Surrogate, ...]" = ()
    values: ParameterSet = field(default_factory=ParameterSet)
    remarks: tuple[str, ...] = ()

    @property
    def carried(self) -> ParameterSet:
        """The parameters that come with it: those it gives values, and the expansions of its surrogates."""
        if not self.surrogates:
            return self.values
        from kennfeld.surrogate import expansions

        return expansions(self.surrogates).merged(self.values)


def started(own: ParameterSet, read: ParameterSet) -> ParameterSet:
    """The parameters of a model with what was read from calibration files in their place.

    Most formats do not say whether a table goes on beyond its ends: it does where that of the model does.
    """
    kept = [
        one.changed(extrapolation=own[name].extrapolation)
        for name, one in read.items()
        if name in own and one.axes and len(one.axes) == len(own[name].axes) and own[name].extrapolation != "clip"
    ]
    return own.merged(read.with_parameters(*kept))
