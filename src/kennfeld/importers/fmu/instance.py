"""Instances of FMUs in this process, one for each file, and the functions that machine code calls."""

import ctypes
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError, Location
from kennfeld.base.finite_differences import difference_step
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.call_record import CallRecord
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.external import provide
from kennfeld.base.threads import computed_once
from kennfeld.importers.fmu.chosen_outputs import SEPARATOR, digest_with_outputs
from kennfeld.importers.fmu.description import FmuDescription, FmuVariable
from kennfeld.importers.fmu.evaluation_code import (
    DIFFERENCES,
    DIRECTIONAL,
    NEW,
    RESET,
    SKIPPED,
    TIMED,
    TUNED,
    USED,
    CallLayout,
    equation_functions,
    recorded_functions,
    write_equations,
    write_events,
    write_start,
)
from kennfeld.importers.fmu.fmu_archive import read_unchanged
from kennfeld.importers.fmu.instance_calls import REUSED
from kennfeld.importers.fmu.library import LOADING, READING, FmuLibrary, yield_address
from kennfeld.importers.fmu.number_access import group_numbers
from kennfeld.importers.fmu.reset_check import StartedValues, is_repeated, other_starts
from kennfeld.importers.fmu.slope_selection import agreeing_columns, noise_near
from kennfeld.importers.fmu.spin_lock import YIELD

_TIME_EVENTS = 4  # to be checked
_OTHER_TIMES = (0.37, 1.0, 12.3, 4567.0, 0.0)  # in s, back to the start
_CONTINUOUS = "Export the continuous part of the model."
_MOST_NAMES = 6  # in a remark
_REPEATED = 1e-4  # tolerance of repeated results, for FMUs that solve equations by iteration
_SMALLEST = 0.1  # of the order of magnitude of an argument, below which steps no longer shrink with it


@dataclass(frozen=True)
class FmuFunction:
    """A compiled function in this process, which it keeps there."""

    call: NativeFunction
    address: int
    instance: "FmuInstance"

    @property
    def remarks(self) -> tuple[str, ...]:
        """The way in which slopes are computed, as sentences."""
        return (self.instance.slope_remark,)


class _Argument(NamedTuple):
    """An argument of the equations: an element of a variable, `position` within it."""

    name: str
    variable: FmuVariable | None
    position: int

    @property
    def start(self) -> float:
        return 0.0 if self.variable is None else self.variable.start_of(self.position)

    @property
    def magnitude(self) -> float:
        nominal = self.variable.nominal if self.variable is not None else 0.0
        return nominal or abs(self.start) or 1.0


def load_equations(path: str, digest: str, outputs: str = "", timed: int = 1) -> FmuFunction:
    """Load (t, states, inputs, parameters) -> (derivatives, outputs) of an FMU; its code runs from now on.

    Args:
        path: the `.fmu` file.
        digest: digest of its contents.
        outputs: names of variables to return in addition to the outputs, a line each.
        timed: 0 if it is always evaluated at time 0.

    Raises:
        InputError: the file has changed, or its code cannot be used.
    """
    instance = load_instance(path, digest, outputs)
    if not timed:
        instance.check_independence_of_time()
    return instance.equations


def load_start(path: str, digest: str, outputs: str = "") -> FmuFunction:
    """Load (t, inputs, parameters, start values) -> states at the start of an FMU; its code runs from now on."""
    return load_instance(path, digest, outputs).start


def load_events(path: str, digest: str, outputs: str = "") -> FmuFunction:
    """Load (t, states, inputs, parameters) -> states after events of an FMU; its code runs from now on."""
    return load_instance(path, digest, outputs).events


def load_instance(path: str, digest: str, outputs: str = "") -> "FmuInstance":
    """Load an FMU into this process; see `load_equations`."""
    return _load(path, digest, outputs)


@computed_once
def _load(path: str, digest: str, outputs: str) -> "FmuInstance":
    source = Path(path)
    description = read_unchanged(source, digest).with_outputs(outputs.split(SEPARATOR))
    return FmuInstance(source, description, digest_with_outputs(digest, outputs))


class FmuInstance:
    """An FMU in this process: its instances in continuous-time mode, and the functions that call them."""

    def __init__(self, source: Path, description: FmuDescription, digest: str) -> None:
        self.source, self.description = source, description
        self.layout = layout_of(description, f"fmu_{digest}")
        self.record = CallRecord(source.name, [*recorded_functions(self.layout), LOADING, READING])
        self._memory: dict[str, Any] = {}
        self.arguments = _arguments(description)
        states = set(description.states)
        start = [a for a in self.arguments if a.variable is None or a.variable not in states]
        # the arguments of the start: (t, inputs, parameters, start values of states)
        start += _elements(description.started_states)
        self.library = self._load()
        self._started = StartedValues(description, self.library)
        self._provide_variables()
        self._provide_tables("equations", self.arguments)
        self._provide_tables("start", start)
        self._provide_tables("events", self.arguments)
        self.equations = self._compile(write_equations(self.layout), "equations")
        self.start = self._compile(write_start(self.layout), "start") if self.layout.states else self.equations
        self.events = self._compile(write_events(self.layout), "events") if self.layout.jumps else self.equations
        self._memory["control"][USED] = self.layout.instances  # no others: those are for parameters that are fitted
        self._check_reset(start)
        self._choose_slopes(np.array([argument.start for argument in start]))
        self._memory["control"][USED] = 0

    @property
    def slopes(self) -> dict[str, str]:
        """Kind of the slopes along each argument but the time, by its name."""
        words = {DIRECTIONAL: "directional derivatives", DIFFERENCES: "differences", SKIPPED: "0"}
        kinds = self._memory["equations_kinds"]
        return {a.name: words[int(kind)] for a, kind in zip(self.arguments[1:], kinds[1:], strict=True)}

    @property
    def slope_remark(self) -> str:
        """A sentence that names the arguments along which slopes are directional derivatives or differences."""
        kinds = dict.fromkeys(self.slopes.values())
        groups = {kind: [name for name, own in self.slopes.items() if own == kind] for kind in kinds}
        parts = [f"{kind} along {join_names(names, _MOST_NAMES)}" for kind, names in groups.items()]
        return f"slopes of {self.source.name}: {'; '.join(parts)}"

    @property
    def resets(self) -> bool:
        """True if instances are used again after a reset."""
        return bool(self._memory[REUSED][0])

    @property
    def further_instances(self) -> int:
        """Number of instances that differences along parameters use, in addition to the first one."""
        slots: NDArray[Any] = self._memory["slots"]
        return int(np.count_nonzero(slots))

    def check_independence_of_time(self) -> None:
        """Check that outputs do not depend on the time.

        Raises:
            InputError: they do, which the description does not say.
        """
        start = np.array([argument.start for argument in self.arguments])
        results = self._evaluate(start)[0]
        for time in _OTHER_TIMES:
            start[0] = time
            if self._memory["control"][TIMED] or not self._is_repeated(self._evaluate(start)[0], results):
                message = "its outputs depend on the time, which its description does not say"
                remedy = "Give a step, such as `step` of [model], so that it is evaluated at the times of the data."
                raise InputError.of(Location.of_file(self.source), message, remedy)

    def _load(self) -> FmuLibrary:
        interface = self.description.model_exchange
        assert interface is not None  # checked by whoever reads the FMU
        library = FmuLibrary(self.source, self.description, interface, self.record)
        prefix = self.layout.prefix
        if not library.address(f"fmi{self.description.version[0]}GetDirectionalDerivative"):
            # a description may promise a function that the library does not have
            self.layout = self.layout._replace(directional=False)
        provide(f"{prefix}_record", self.record.address())
        library.provide(equation_functions(self.layout), prefix)  # before its code runs
        self._provide("instances", [library.instantiate()] + [0] * (self.layout.instances - 1), np.uint64)
        library.provide_creation(prefix)
        provide(YIELD, yield_address())
        return library

    def _provide(self, name: str, values: Any, kind: type) -> None:
        array: NDArray[Any] = np.array(values, dtype=kind) if len(values) else np.zeros(1, dtype=kind)
        self._memory[name] = array
        provide(f"{self.layout.prefix}_{name}", array.ctypes.data)

    def _provide_variables(self) -> None:
        description = self.description
        parameters = description.parameters
        # a fixed parameter takes effect at initialization only
        levels = [TUNED if v.variability == "tunable" else RESET for v in parameters for _ in range(v.size)]
        unknowns = [d.variable for d in description.derivatives]
        unknowns += [output for output in description.computed_outputs if output.is_real]
        self._provide("control", [0, 0, 0], np.int32)
        self._provide(REUSED, [1], np.int64)  # on trial, see `_check_reset`
        self._provide("stale", [NEW] * self.layout.instances, np.int32)
        self._provide("changed", [0] * self.layout.instances, np.int32)
        # [parameters, 2]: the instance of each side of a difference; 0 for none
        self._provide("slots", [0] * (2 * len(levels)), np.int64)
        # [instances, parameters]; NaN differs from every value, so that the first call sets all of them
        self._provide("cache", np.full(len(levels) * self.layout.instances, np.nan), np.float64)
        self._provide("levels", levels, np.int32)
        self._provide("next_event", [np.nan], np.float64)
        inputs, outputs = description.sorted_by_type(description.number_inputs), description.computed_outputs
        for groups, variables in ((self.layout.input_groups, inputs), (self.layout.output_groups, outputs)):
            references = iter([variable.reference for variable in variables])
            for group in groups:
                self._provide(group.name, list(islice(references, group.references)), np.uint32)
        self._provide("starts", [v.reference for v in description.started_states], np.uint32)
        self._provide("parameters", [v.reference for v in parameters], np.uint32)
        self._provide("unknowns", [v.reference for v in unknowns], np.uint32)
        named = [argument.variable for argument in self.arguments]
        self._provide("known", [0 if v is None else v.reference for v in named], np.uint32)
        self._provide("positions", [argument.position for argument in self.arguments], np.int64)
        sizes = [1 if v is None else v.size for v in named]
        self._provide("sizes", sizes, np.int64)
        self._provide("seed", np.zeros(max(sizes)), np.float64)

    def _provide_tables(self, name: str, arguments: Sequence[_Argument]) -> None:
        limited = [a.variable if a.variable is not None else None for a in arguments]
        # integers and booleans are piecewise constant in the doubles that are rounded to them
        kinds = [DIFFERENCES if v is not None and v.is_real else SKIPPED for v in limited]
        self._provide(f"{name}_kinds", kinds, np.int32)
        self._provide(f"{name}_steps", [difference_step(0.0)] * len(arguments), np.float64)
        self._provide(f"{name}_least", [_SMALLEST * a.magnitude for a in arguments], np.float64)
        self._provide(f"{name}_lower", [-np.inf if v is None else v.minimum for v in limited], np.float64)
        self._provide(f"{name}_upper", [np.inf if v is None else v.maximum for v in limited], np.float64)

    def _compile(self, functions: Sequence[Any], name: str) -> FmuFunction:
        call = compile_functions(*functions)[name]
        return FmuFunction(call, ctypes.cast(call, ctypes.c_void_p).value or 0, self)  # type: ignore[arg-type]

    def _evaluate(self, x: Float) -> tuple[Float, Float]:
        x = np.clip(x, self._memory["equations_lower"], self._memory["equations_upper"])
        # the ones ask for the slopes along all arguments
        results, slopes = np.empty(self.layout.results), np.ones((self.layout.results, len(x)))
        self.equations.call(x.ctypes.data, results.ctypes.data, slopes.ctypes.data)
        return results, slopes

    def _check_reset(self, start: Sequence[_Argument]) -> None:
        """Check if an instance is as new after a reset; otherwise each initialization needs a new one."""
        first = self._trial(start)
        # leaves other inputs and states behind, which the reset has to remove
        self._evaluate(np.array([a.start + a.magnitude * (a.variable is not None) for a in self.arguments]))
        self._memory["stale"][0] = RESET
        self._memory[REUSED][0] = is_repeated(first, self._trial(start))
        self._memory["stale"][0] = RESET

    def _trial(self, start: Sequence[_Argument]) -> Float:
        """Return states at the start, results there, and the values of variables that state a start value, [values]."""
        inputs = self.description.sorted_by_type(self.description.number_inputs)
        moved = dict(zip((a.name for a in _elements(inputs)), other_starts(inputs), strict=True))
        states, results = np.zeros(self.layout.states), np.empty(self.layout.results)
        if self.layout.states:
            values = np.array([moved.get(argument.name, argument.start) for argument in start])
            self.start.call(values.ctypes.data, states.ctypes.data, None)
        point = np.array([moved.get(argument.name, argument.start) for argument in self.arguments])
        point[1 : 1 + len(states)] = states
        # without slopes: differences along parameters would initialize the instance again
        self.equations.call(point.ctypes.data, results.ctypes.data, None)
        return np.concatenate([states, results, self._started.read(int(self._memory["instances"][0]))])

    def _choose_slopes(self, start: Float) -> None:
        """Check that the code works at the start, and choose how slopes are computed."""
        point = np.array([argument.start for argument in self.arguments])
        states = slice(1, 1 + self.layout.states)
        if self.layout.states:
            values = np.empty(self.layout.states)
            # initial equations may give other states than the start attributes
            self.start.call(start.ctypes.data, values.ctypes.data, None)
            point[states] = values
        results = self._evaluate(point)[0]
        if not np.all(np.isfinite(results)):
            reasons = f": {'; '.join(self.library.messages)}" if self.library.messages else ""
            message = f"its code cannot be evaluated with its start values{reasons}"
            raise InputError.of(Location.of_file(self.source), message, "Try the FMU in the tool that exported it.")
        magnitudes = np.array([argument.magnitude for argument in self.arguments])
        if self._memory["control"][TIMED]:
            # events at times show at run time only: a description counts those of states alone
            results = self._include_time_events(point)
        noise = noise_near(lambda x: self._evaluate(x)[0], point, magnitudes)
        self._check_memory(point, magnitudes, results)
        for name in ("equations", "start", "events"):
            self._memory[f"{name}_steps"][:] = difference_step(noise)
        if self.layout.directional:
            kinds = self._memory["equations_kinds"]
            kinds[agreeing_columns(self._evaluate, kinds, point, magnitudes)] = DIRECTIONAL

    def _include_time_events(self, point: Float) -> Float:
        """Process events at each evaluation, check that they depend on the time alone, and return the results."""
        self.layout = self.layout._replace(events=True)
        self.equations = self._compile(write_equations(self.layout), "equations")
        results, later = self._evaluate(point)[0], point.copy()
        # each event announces the next one; returning to the start must give the results of the start again
        for _ in range(_TIME_EVENTS):
            following = float(self._memory["next_event"][0])
            if not later[0] < following < np.inf:
                break
            later[0] = following
            finite = np.all(np.isfinite(self._evaluate(later)[0]))
            if not finite or not self._is_repeated(self._evaluate(point)[0], results):
                message = "has events at times, such as those of a sampled part, that change more than conditions"
                raise InputError.of(Location.of_file(self.source), message, self._other_interface or _CONTINUOUS)
            self._evaluate(later)  # announces the following event
        return results

    def _check_memory(self, point: Float, magnitudes: Float, results: Float) -> None:
        """Check that results do not depend on earlier evaluations, which would make slopes and sums wrong."""
        for side in (1.0, -1.0):
            # far enough to pass thresholds such as those of a hysteresis; the time stays
            self._evaluate(point + side * magnitudes * (np.arange(len(point)) > 0))
        if not self._is_repeated(self._evaluate(point)[0], results):
            message = "its equations depend on earlier evaluations, such as a hysteresis does"
            remedy = self._other_interface or "Use an FMU whose memory is in its states."
            raise InputError.of(Location.of_file(self.source), message, remedy)

    @property
    def _other_interface(self) -> str:
        """The remedy for what model exchange cannot do, if the FMU also offers co-simulation; else empty."""
        if self.description.co_simulation is None:
            return ""
        return f'Choose its co-simulation: "{self.source.name}:co-simulation", kf.fmu(path, interface="co-simulation").'

    def _is_repeated(self, again: Float, results: Float) -> bool:
        return np.allclose(again, results, rtol=_REPEATED, atol=_REPEATED * np.max(np.abs(results), initial=0.0))


def layout_of(description: FmuDescription, prefix: str) -> CallLayout:
    """Count the values that the code of an FMU takes and returns."""
    inputs, parameters = description.sorted_by_type(description.number_inputs), description.parameters
    outputs, starts = description.computed_outputs, description.started_states
    # discrete inputs are constant between events: a change needs event mode, also without an indicator (FMI 2.0, 2.2.7)
    events = description.indicators > 0 or any(v.variability == "discrete" for v in inputs)
    interface = description.model_exchange
    return CallLayout(
        version=description.version,
        prefix=prefix,
        states=sum(v.size for v in description.states),
        inputs=sum(v.size for v in inputs),
        parameters=sum(v.size for v in parameters),
        outputs=sum(v.size for v in outputs),
        starts=sum(v.size for v in starts),
        input_groups=group_numbers("inputs", description.version, inputs),
        output_groups=group_numbers("outputs", description.version, outputs),
        parameter_references=len(parameters),
        start_references=len(starts),
        unknowns=len(description.derivatives) + sum(output.is_real for output in outputs),
        single=interface is not None and interface.single,
        directional=interface is not None and interface.directional and not description.has_further_outputs,
        events=events,
        jumps=events and bool(description.states),
    )


def _arguments(description: FmuDescription) -> tuple[_Argument, ...]:
    inputs = description.sorted_by_type(description.number_inputs)
    return (_Argument("time", None, 0), *_elements((*description.states, *inputs, *description.parameters)))


def _elements(variables: Sequence[FmuVariable]) -> list[_Argument]:
    return [_Argument(name, variable, k) for variable in variables for k, name in enumerate(variable.elements)]
