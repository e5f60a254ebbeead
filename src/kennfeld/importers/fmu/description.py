"""`FmuDescription`: what the model description of an FMU states, in the terms of the standard."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.fmu.number_types import number_type, type_order

REAL_TYPES = ("Real", "Float64")


class FmuVariable(NamedTuple):
    """A variable.

    Attributes:
        name: name, such as `body.m` or `table[1,2]`.
        reference: value reference, by which the code knows it.
        type: its type as FMI 2.0 or 3.0 calls it: `Real`, `Float64`, `Int32`, ...
        causality: `input`, `output`, `parameter`, `local`, ...
        variability: `fixed`, `tunable`, `discrete`, `continuous`, ...
        start: start values in the order of rows; empty if there are none.
        shape: numbers of elements by dimension of an array of FMI 3.0; empty for a number.
        unit: unit, perhaps of its declared type.
        minimum: least value.
        maximum: largest value.
        nominal: its order of magnitude; 0 if it is not stated.
        derivative: value reference of the state of which it is the derivative, or None.
        initial: `exact` if its value at the start can be set, `approx`, `calculated`, or empty.
        line: line in the model description.
    """

    name: str
    reference: int
    type: str
    causality: str
    variability: str
    start: tuple[float, ...] = ()
    shape: tuple[int, ...] = ()
    unit: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    nominal: float = 0.0
    derivative: int | None = None
    initial: str = ""
    line: int = 0

    @property
    def size(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    def start_of(self, position: int) -> float:
        """Return the start value of an element; 0 if the FMU states none."""
        return self.start[position] if self.start else 0.0

    @property
    def is_real(self) -> bool:
        """True if its values are doubles."""
        return self.type in REAL_TYPES

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of its values in the order of rows, counted from 1.

        >>> FmuVariable("A", 4, "Float64", "parameter", "tunable", shape=(2, 2)).elements
        ('A[1,1]', 'A[1,2]', 'A[2,1]', 'A[2,2]')
        """
        names = [""]
        for count in self.shape:
            names = [f"{name},{number}" for name in names for number in range(1, count + 1)]
        return tuple(f"{self.name}[{name[1:]}]" if name else self.name for name in names)


class FmuInterface(NamedTuple):
    """Model exchange or co-simulation, as an FMU offers it.

    Attributes:
        identifier: name of the library without its extension.
        directional: True if it states that it provides directional derivatives.
        needs_tool: True if it runs only with the tool that exported it.
        single: True if a process can hold one instance only.
        variable_step: True if the steps of co-simulation may have different lengths.
    """

    identifier: str
    directional: bool
    needs_tool: bool
    single: bool
    variable_step: bool = False


class Dependency(NamedTuple):
    """An output or derivative, and the value references on which it depends; None if it does not say."""

    variable: FmuVariable
    references: frozenset[int] | None


@dataclass(frozen=True)
class FmuDescription:
    """The model description of an FMU.

    Attributes:
        version: `2.0` or `3.0`.
        name: name of the model.
        token: text by which the library knows that the description is its own.
        tool: the exporting tool.
        model_exchange: the interface for equations without solver, or None.
        co_simulation: the interface with a solver inside, or None.
        variables: all variables.
        outputs: outputs with their dependencies.
        derivatives: derivatives with their dependencies, in the order of the states.
        indicators: number of event indicators.
        step: step of the default experiment in s, or None.
        discrete: names of variables that hold discrete states, which FMI 3.0 declares.
        platforms: platforms for which there are libraries, such as `linux64` or `x86_64-linux`.
    """

    version: str
    name: str
    token: str
    tool: str
    model_exchange: FmuInterface | None
    co_simulation: FmuInterface | None
    variables: tuple[FmuVariable, ...]
    outputs: tuple[Dependency, ...]
    derivatives: tuple[Dependency, ...]
    indicators: int
    step: float | None
    discrete: tuple[str, ...]
    platforms: tuple[str, ...]

    @property
    def states(self) -> tuple[FmuVariable, ...]:
        """The continuous states, in the order of their derivatives."""
        real = sorted((v for v in reversed(self.variables) if v.is_real), key=lambda v: v.derivative is None)
        by_reference = {variable.reference: variable for variable in real}  # the first one that is not a derivative
        return tuple(by_reference[d.variable.derivative] for d in self.derivatives if d.variable.derivative is not None)

    @property
    def inputs(self) -> tuple[FmuVariable, ...]:
        """The inputs that are doubles."""
        return tuple(v for v in self.variables if v.causality == "input" and v.is_real)

    @property
    def clocks(self) -> tuple[FmuVariable, ...]:
        """The clocks of FMI 3.0."""
        return tuple(v for v in self.variables if v.type == "Clock")

    @property
    def numbers(self) -> tuple[FmuVariable, ...]:
        """The variables that are numbers or booleans."""
        return tuple(v for v in self.variables if self._is_number(v))

    @property
    def number_inputs(self) -> tuple[FmuVariable, ...]:
        """The inputs that are numbers or booleans."""
        return tuple(v for v in self.variables if v.causality == "input" and self._is_number(v))

    @property
    def number_outputs(self) -> tuple[FmuVariable, ...]:
        """The outputs that are numbers or booleans."""
        return tuple(output.variable for output in self.outputs if self._is_number(output.variable))

    @property
    def started_states(self) -> tuple[FmuVariable, ...]:
        """The states whose values at the start can be set."""
        return tuple(state for state in self.states if state.initial == "exact" and state.start)

    @property
    def parameters(self) -> tuple[FmuVariable, ...]:
        """The parameters that are doubles and may be set."""
        return tuple(v for v in self.variables if v.causality == "parameter" and v.is_real and v.start)

    @property
    def computed_outputs(self) -> tuple[FmuVariable, ...]:
        """The outputs that are numbers, and neither states nor derivatives, sorted by type; doubles come first."""
        # those that are one are read from its node, without a call
        others = {v.reference for v in (*self.states, *(d.variable for d in self.derivatives))}
        return self.sorted_by_type([v for v in self.number_outputs if not (v.is_real and v.reference in others)])

    @property
    def unused(self) -> tuple[FmuVariable, ...]:
        """Inputs and outputs that are not numbers."""
        return tuple(v for v in self.variables if v.causality in ("input", "output") and not self._is_number(v))

    @property
    def has_further_outputs(self) -> bool:
        """True if variables are read that are not outputs, of which the standards know no directional derivatives."""
        # a library may refuse the whole call for one unknown that it does not list
        return any(v.causality != "output" for v in self.computed_outputs)

    def with_outputs(self, names: Collection[str]) -> "FmuDescription":
        """Return the description with further variables among the outputs, whose dependencies are unknown."""
        chosen = frozenset(names)
        # unknown dependencies are those on everything, time included
        further = tuple(Dependency(v, None) for v in self.variables if v.name in chosen)
        return replace(self, outputs=(*self.outputs, *further)) if further else self

    def sorted_by_type(self, variables: Sequence[FmuVariable]) -> tuple[FmuVariable, ...]:
        """Sort variables so that those of one type follow each other, doubles first."""
        return tuple(sorted(variables, key=lambda v: type_order(self.version, v.type)))

    def _is_number(self, variable: FmuVariable) -> bool:
        return number_type(self.version, variable.type) is not None
