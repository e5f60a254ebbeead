"""A model that has a graph, whatever it was read from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.graph import Graph
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter

if TYPE_CHECKING:
    from kennfeld.surrogate import Surrogate

__all__ = ["Model", "merge_start_values"]


def _nothing() -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True)
class Model:
    """The graph of one time step, and what its source says about it.

    `step` is the model's own step in s, None where the data decide. `declared` are the parameters that the source
    declares, each with its number of axes; `graph.parameters` are those that are looked up. `source` is the path,
    or "formula". `places` says where a node, a parameter or an input stands in the source, for later checks.
    `surrogates` are the data-driven models that it calls. `values` are the parameters that the source gives values.
    `remarks` are sentences on what runs in another way than in the source. `stepped` says that continuous states run
    with a fixed step that is not the source's own, so that a shorter step may give other values.

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
    stepped: bool = False

    @property
    def carried(self) -> ParameterSet:
        """The parameters that come with it: those it gives values, and the expansions of its surrogates."""
        if not self.surrogates:
            return self.values
        from kennfeld.surrogate import expansions

        return expansions(self.surrogates).merged(self.values)


def merge_start_values(own: ParameterSet, given: ParameterSet, *, continued: bool = True) -> ParameterSet:
    """The parameters of a model with given ones, mostly those of calibration files, in their place.

    Limits are the given ones, where a parameter has any, else those of the model. With `continued`, a table goes on
    beyond its ends where that of the model does, which most formats do not say.
    """
    kept = [one.changed(**_from_model(own[name], one, continued)) for name, one in given.items() if name in own]
    return own.merged(given.with_parameters(*kept))


def _from_model(own: Parameter, given: Parameter, continued: bool) -> dict[str, Any]:
    """What a model says of a parameter, and the one that is given does not."""
    said: dict[str, Any] = {}
    if continued and given.axes and len(given.axes) == len(own.axes) and own.extrapolation != "clip":
        said["extrapolation"] = own.extrapolation
    if not given.limited:
        said |= {side: bound for side in ("lower", "upper") if (bound := _bound(own, side, given)) is not None}
    return said


def _bound(own: Parameter, side: str, given: Parameter) -> Float | None:
    """A model's bound for given values; None where they have another shape and it is not the same for all."""
    bound: Float = getattr(own, side)
    if bound.shape == given.values.shape:
        return bound
    return bound.ravel()[0] if bound.size and np.all(bound == bound.ravel()[0]) else None
