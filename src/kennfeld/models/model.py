"""`Model`: the graph of one time step together with the name, step and parameters of its source."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.graph import Graph
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.traversal import rewrite

if TYPE_CHECKING:
    from kennfeld.surrogate.surrogate_file import Surrogate


T = TypeVar("T")  # Python 3.11
MAX_NAMES = 6  # of inputs and the like that a text shows


def _nothing() -> Mapping[str, Any]:
    return FrozenDict({})


@dataclass(frozen=True)
class Model:
    """The graph of one time step, and the information its source provides.

    Attributes:
        graph: inputs, parameters, states and outputs of one time step.
        name: name of the model.
        step: the model's own step in s; None if the data define it.
        declared: parameters that the source declares, with their numbers of axes; `graph.parameters` are those looked
            up.
        source: path of the source, or "formula".
        locations: location of nodes, parameters and inputs in the source, by name.
        surrogates: data-driven models that the model calls.
        values: parameters for which the source provides values.
        remarks: what runs differently from the source.
        stepped: True if continuous states use a fixed step that the source does not define; a shorter step may then
            give other values.
        equations: the graph before the solver is applied, with the derivatives of continuous states; None if there are
            none.
        solver: solver of the continuous states, `ode1` to `ode5` or `ode8`; "" if the source declares none.
        undeclared: names of formula text that are a parameter if one of that name is known, and else an input.

    >>> from kennfeld import formula
    >>> model = formula("y[Nm] = Gain(u) * k", name="demo", parameters=["Gain", "k"])
    >>> model.graph.inputs, dict(model.graph.parameters), str(model.locations["y"])
    (('u',), {'Gain': 1, 'k': 0}, 'demo line 1')
    """

    graph: Graph
    name: str = "model"
    step: float | None = None
    declared: Mapping[str, int] = field(default_factory=_nothing)
    source: str = ""
    locations: Mapping[str, Location] = field(default_factory=_nothing)
    surrogates: tuple["Surrogate", ...] = ()
    values: ParameterSet = field(default_factory=ParameterSet)
    remarks: tuple[Finding, ...] = ()
    stepped: bool = False
    equations: Graph | None = None
    solver: str = ""
    undeclared: frozenset[str] = frozenset()

    def __repr__(self) -> str:
        graph = self.graph
        shown = {"inputs": graph.inputs, "parameters": list(graph.parameters), "outputs": graph.outputs}
        parts = [f"{label}: {join_names(names, MAX_NAMES)}" for label, names in shown.items() if names]
        return f"Model({self.name!r}, {'; '.join(parts)})"

    def __getstate__(self) -> dict[str, Any]:
        # without what is kept for the next fit, compiled code among it
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @cached_property
    def _kept(self) -> dict[str, tuple[Any, Any]]:
        """The last value of each kind that `once` has made, and its source."""
        return {}

    def once(self, kind: str, source: Any, make: Callable[[], T]) -> T:
        """Return `make()`, or the last value of its kind if that was made from an equal source.

        Args:
            kind: tells what is made from other such things.
            source: all that the value follows from besides the model, comparable by `==`; None to keep nothing.
            make: makes the value, which nobody changes.
        """
        kept = self._kept.get(kind)
        if kept is None or source is None or kept[0] != source:
            kept = source, make()
            if source is not None:
                self._kept[kind] = kept
        value: T = kept[1]
        return value

    @property
    def carried(self) -> ParameterSet:
        """The parameters that the model provides: `values`, and the expansions of its surrogates."""
        if not self.surrogates:
            return ParameterSet().merged(self.values)
        from kennfeld.surrogate.surrogate_file import as_parameters

        return as_parameters(self.surrogates).merged(self.values)


def merge_start_values(own: ParameterSet, other: ParameterSet, *, continued: bool = True) -> ParameterSet:
    """Replace the parameters of a model by others of the same name, mostly from calibration files.

    Args:
        own: parameters of the model.
        other: replacements and additional parameters. Their limits apply; a parameter without limits takes the model's.
            Values that the model locks stay locked. Value blocks take the model's shape if only dimensions of size 1
            differ, since some formats leave them out.
        continued: take the extrapolation of tables from the model, since most calibration formats do not store it.
    """
    shaped = [_in_shape_of(own[name], parameter) for name, parameter in other.items() if name in own]
    replaced = [parameter.changed(**_from_model(own[parameter.name], parameter, continued)) for parameter in shaped]
    return own.merged(other.with_parameters(*replaced))


def _in_shape_of(own: Parameter, other: Parameter) -> Parameter:
    shapes = own.values.shape, other.values.shape
    long = [tuple(count for count in shape if count > 1) for shape in shapes]
    if not own.kind == other.kind == "block" or shapes[0] == shapes[1] or long[0] != long[1]:
        return other
    arrays = {name: getattr(other, name) for name in ("values", "lower", "upper", "locked")}
    return other.changed(**{name: array.reshape(shapes[0]) for name, array in arrays.items()})


def _from_model(own: Parameter, other: Parameter, continued: bool) -> dict[str, Any]:
    """Return the attributes that the model defines and the other parameter does not."""
    attributes: dict[str, Any] = {}
    if continued and other.axes and len(other.axes) == len(own.axes) and own.extrapolation != "clip":
        attributes["extrapolation"] = own.extrapolation
    if own.locked.any() and own.locked.shape == other.locked.shape:
        attributes["locked"] = own.locked | other.locked
    if not other.limited:
        attributes |= {side: bound for side in ("lower", "upper") if (bound := _bound(own, side, other)) is not None}
    return attributes


def _bound(own: Parameter, side: str, other: Parameter) -> Float | None:
    """Return the model's bound for other values; None if the shapes differ and the bound is not uniform."""
    bound: Float = getattr(own, side)
    if bound.shape == other.values.shape:
        return bound
    # a bound that is the same everywhere fits tables of any shape
    return bound.ravel()[0] if bound.size and np.all(bound == bound.ravel()[0]) else None


def bind_scalars(model: Model, parameters: ParameterSet, channels: Collection[str] = ()) -> Model:
    """Turn inputs of the model that are scalar parameters of the set into lookups.

    Args:
        model: the model.
        parameters: its parameters, perhaps among all those of a control unit.
        channels: inputs that the data hold, which stay inputs.
    """
    # formula text that was read without known parameters takes a bare name for an input
    known = (name for name in model.graph.inputs if name not in channels)
    names = sorted({name for name in known if name in parameters and not parameters[name].coordinates})
    if not names:
        return model
    return model.once("scalars", names, lambda: replace(model, graph=_with_lookups(model.graph, names)))


def _with_lookups(graph: Graph, names: Sequence[str]) -> Graph:
    def resolve(b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        op, _, payload = graph.nodes[at]
        if op == "input" and payload in names:
            return b.lookup(payload)
        return b.node(op, args, payload)

    return rewrite(graph, resolve)


def ambiguous_names(model: Model, parameters: ParameterSet, channels: Collection[str]) -> list[str]:
    """Return the names of formula text that are scalar parameters as well as channels of the data, and not declared.

    >>> from kennfeld import Scalar, formula
    >>> ambiguous_names(formula("y = a * x"), ParameterSet([Scalar("a", 1.0), Scalar("x", 2.0)]), ["x", "y"])
    ['x']
    """
    scalars = (name for name in model.undeclared if name in parameters and not parameters[name].coordinates)
    return sorted(name for name in scalars if name in channels)


def ambiguity(model: Model, name: str, parameters: str, data: str) -> Finding:
    """Return the error about an ambiguous name; `parameters` and `data` say where it is a parameter and a channel."""
    location = model.locations.get(name, Location.of_file(model.source))
    remedy = f"Declare what it is, `input {name}` or `scalar {name}`; a text that declares inputs declares all of them."
    return Finding(location, f"{name} is both a parameter of {parameters} and a channel of {data}", remedy)
