"""Machine code that calls an FMU: its equations at one point with their slopes, and its states at the start.

All memory belongs to `FmuInstance`, whose addresses the code knows by name. A lock lets one thread at a time use it.

The equations take (t, states, inputs, parameters) and return (derivatives, outputs); events take the same and return
the states, which an event may have changed; the start takes (t, inputs, parameters, start values) and returns the
states. Of inputs and outputs, doubles come first. Parameters that differ from those of the last call are set first:
`tunable` ones in event mode, `fixed` ones by a reset, because they take effect at initialization only. So that
differences along a parameter do not set it at each sample, further instances keep its two other values; they are
created when first needed, up to `MOST_INSTANCES`, or less if there are very many parameters.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from kennfeld.base.machine_code.call_record import write_end, write_place
from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import ZERO, FunctionWriter, literal
from kennfeld.importers.fmu.instance_calls import DISCARD, WARNING, InstanceCalls
from kennfeld.importers.fmu.number_access import NumberGroup, get_numbers, real_count, set_numbers
from kennfeld.importers.fmu.spin_lock import write_acquire, write_release

NONE, TUNED, RESET, NEW, FAILED = range(5)  # what parameters require; the instance is new, or has failed
SKIPPED, DIRECTIONAL, DIFFERENCES = 0, 1, 2  # how the slopes of an argument are computed
LOCK, TIMED, USED = range(3)  # places in the memory `control`; USED counts further instances
MOST_INSTANCES = 257  # the first one, and two for each of 128 parameters
_LEAST_INSTANCES = 17
_MOST_KEPT = 8_000_000  # values of parameters that the instances have
_MOST_UPDATES = 100  # of discrete states until they must be stable
_MOVED, _ENDED = 1, 2  # what an event did: changed states, ended the simulation
_NAN = literal(float("nan"))


class CallLayout(NamedTuple):
    """Numbers of values and of value references, and how the names of memory and functions begin."""

    version: str
    prefix: str
    states: int
    inputs: int
    parameters: int
    outputs: int
    starts: int
    input_groups: tuple[NumberGroup, ...]
    output_groups: tuple[NumberGroup, ...]
    parameter_references: int
    start_references: int
    unknowns: int
    events: bool
    jumps: bool  # events may change states, at samples
    single: bool
    directional: bool

    @property
    def instances(self) -> int:
        """Largest number of instances."""
        if self.single:
            return 1
        return min(MOST_INSTANCES, max(_LEAST_INSTANCES, _MOST_KEPT // max(self.parameters, 1)))

    @property
    def arguments(self) -> int:
        """Number of arguments of the equations."""
        return 1 + self.states + self.inputs + self.parameters

    @property
    def results(self) -> int:
        """Number of results of the equations."""
        return self.states + self.outputs

    @property
    def start_arguments(self) -> int:
        """Number of arguments of the start."""
        return 1 + self.inputs + self.parameters + self.starts

    @property
    def real_results(self) -> int:
        """Number of results that are doubles, which come first; the slopes of others are 0."""
        return self.states + real_count(self.output_groups)


def write_equations(layout: CallLayout) -> list[FunctionWriter]:
    """Write the functions for the equations of an FMU; the last one is to be called."""
    shape = _FunctionShape("equations", layout.arguments, layout.results)
    parts = [_iterate(layout), _renew(layout), _reset(layout), _equations_point(layout), _choose_instance(layout)]
    return [*parts, _evaluate(layout, shape)]


def write_events(layout: CallLayout) -> list[FunctionWriter]:
    """Write the functions for the states after events; the last one is to be called."""
    shape = _FunctionShape("events", layout.arguments, layout.states)
    parts = [_iterate(layout), _renew(layout), _reset(layout), _events_point(layout), _choose_instance(layout)]
    return [*parts, _evaluate(layout, shape)]


def write_start(layout: CallLayout) -> list[FunctionWriter]:
    """Write the functions for the states at the start; the last one is to be called."""
    shape = _FunctionShape("start", layout.start_arguments, layout.states)
    return [_iterate(layout), _renew(layout), _reset(layout), _start_point(layout), _evaluate(layout, shape)]


class _FunctionShape(NamedTuple):
    name: str
    arguments: int
    results: int


class _InstanceCalls(InstanceCalls):
    """Calls of the functions of an instance by its number; the worst status is kept in the memory at `worst`."""

    def __init__(self, f: FunctionWriter, layout: CallLayout, worst: str, number: str) -> None:
        places, record = (c_pointer(f, f"{layout.prefix}_{name}") for name in ("instances", "record"))
        place, functions = f.at(places, number, "i64"), recorded_functions(layout)
        super().__init__(f, layout.version, layout.prefix, functions, place, record, worst)
        self.layout, self.number = layout, number

    def numbers(self, access: str, group: str, references: int, values: str, count: int) -> None:
        """Get or set the values of a group of variables."""
        if count:
            # FMI 3.0 passes the number of values as well, which arrays make larger than that of references
            lengths = () if self.second else (f"i64 {count}",)
            name = f"{access}{'Real' if self.second else 'Float64'}"
            self(name, f"ptr {self.memory(group)}", f"i64 {references}", f"ptr {values}", *lengths)

    def set_inputs(self, values: str) -> None:
        """Set the inputs; NaN for an integer or boolean counts as a value that is refused."""
        undefined = set_numbers(self.f, self.layout.input_groups, values, self.set)
        if undefined != "false":
            with self.f.when(undefined):
                self.f.store(str(DISCARD), self.worst, kind="i32")

    def get_outputs(self, values: str) -> None:
        """Read the outputs."""
        get_numbers(self.f, self.layout.output_groups, values, self.get)

    def initialize(self, parameters: str, inputs: str | None, starts: str | None = None) -> None:
        """Initialize the instance anew with parameters, inputs and start values; enter continuous-time mode."""
        layout = self.layout
        # (tolerance defined, tolerance, start time, stop time defined, stop time)
        times = [self.false, f"double {ZERO}", f"double {ZERO}", self.false, f"double {ZERO}"]
        # an instance that was never initialized needs no reset, after which some FMUs are not as new
        stale = self.f.load(self.memory("stale"), self.number, "i32")
        with self.f.when(self.f.new(f"icmp ne i32 {stale}, {NEW}")):
            self.f.call("renew", [("i64", self.number)])
        if self.second:
            self("SetupExperiment", *times)
        self.numbers("Set", "parameters", layout.parameter_references, parameters, layout.parameters)
        if starts is not None:
            self.numbers("Set", "starts", layout.start_references, starts, layout.starts)
        self("EnterInitializationMode", *(() if self.second else times))
        if inputs is not None:
            self.set_inputs(inputs)
        self("ExitInitializationMode")
        self.update()

    def update(self) -> None:
        """Update discrete states until they are stable, and enter continuous-time mode."""
        self.f.call("iterate", [("ptr", self.worst), ("i64", self.number)])
        self("EnterContinuousTimeMode")


def _iterate(layout: CallLayout) -> FunctionWriter:
    f = FunctionWriter("iterate", [("ptr", "worst"), ("i64", "number")], "noinline")
    calls = _InstanceCalls(f, layout, "%worst", "%number")
    kind = "i32" if calls.second else "i8"
    flags, at = f.slot("i64", 6), f.slot("double")  # the structure of FMI 2.0: five integers, and a double at byte 24
    control, change = calls.memory("control"), calls.memory("changed")
    with f.walk(_MOST_UPDATES) as (index, position):
        for number in range(6):
            f.store("0", flags, number, "i64")
        if calls.second:
            calls("NewDiscreteStates", f"ptr {flags}")
        else:
            calls("UpdateDiscreteStates", *(f"ptr {f.at(flags, k, kind)}" for k in range(5)), f"ptr {at}")
        # needed again, terminate, nominals changed, values of states changed, next event time defined
        needed, terminate, _, changed, timed = (_is_set(f, f.at(flags, k, kind), kind) for k in range(5))
        _mark(f, change, "%number", changed, _MOVED)
        _mark(f, change, "%number", terminate, _ENDED)
        _mark(f, control, TIMED, timed)
        with f.when(timed):
            f.store(f.load(flags, 3) if calls.second else f.load(at), calls.memory("next_event"))
        # the walk ends when states are stable, the simulation ended, or after `_MOST_UPDATES`
        needed = f.new(f"and i1 {needed}, {f.new(f'xor i1 {terminate}, true')}")
        position.set(f.new(f"select i1 {needed}, i64 {f.add(index, 1)}, i64 {_MOST_UPDATES}"))
    return f


def _is_set(f: FunctionWriter, pointer: str, kind: str) -> str:
    return f.new(f"icmp ne {kind} {f.new(f'load {kind}, ptr {pointer}, align 1')}, 0")


def _mark(f: FunctionWriter, flags: str, place: int | str, condition: str, value: int = 1) -> None:
    with f.when(condition):
        f.store(str(value), flags, place, "i32")


def _renew(layout: CallLayout) -> FunctionWriter:
    """Write `renew(number)`: the instance is as new; it is reset if that works, otherwise replaced."""
    f = FunctionWriter("renew", [("i64", "number")], "noinline")
    calls = _InstanceCalls(f, layout, f.slot("i32"), "%number")
    running = f.new(f"icmp ne i32 {f.load(calls.memory('stale'), '%number', 'i32')}, {FAILED}")
    calls.renew(running, *_creation(calls))
    return f


def _reset(layout: CallLayout) -> FunctionWriter:
    f = FunctionWriter("reset", [("ptr", "parameters"), ("ptr", "worst"), ("i64", "number")], "noinline")
    _InstanceCalls(f, layout, "%worst", "%number").initialize("%parameters", None)
    return f


def _equations_point(layout: CallLayout) -> FunctionWriter:
    f, calls = _enter_point(layout, layout.events)
    if layout.jumps:  # the step goes on with its own states; events change them at samples only
        changed = f.load(calls.memory("changed"), "%number", "i32")
        with f.when(f.new(f"icmp ne i32 {changed}, 0")):
            calls("SetContinuousStates", f"ptr {f.at('%x', 1)}", f"i64 {layout.states}")
    if layout.states:
        derivatives = "GetDerivatives" if calls.second else "GetContinuousStateDerivatives"
        calls(derivatives, "ptr %y", f"i64 {layout.states}")
    calls.get_outputs(f.at("%y", layout.states))
    _finish_point(calls, layout.results)
    return f


def _events_point(layout: CallLayout) -> FunctionWriter:
    f, calls = _enter_point(layout, True)
    calls("GetContinuousStates", "ptr %y", f"i64 {layout.states}")
    _finish_point(calls, layout.states)
    return f


def _enter_point(layout: CallLayout, events: bool) -> tuple[FunctionWriter, _InstanceCalls]:
    """Begin a function that sets parameters, time, states and inputs, and processes events at this time."""
    f = FunctionWriter("point", [("ptr", "x"), ("ptr", "y"), ("i64", "number")], "noinline")
    worst = f.slot("i32")
    f.store("0", worst, kind="i32")
    calls = _InstanceCalls(f, layout, worst, "%number")
    write_place(f, calls.record, f.load("%x"), "%number")
    _set_parameters(calls, f.at("%x", 1 + layout.states + layout.inputs))
    calls("SetTime", f"double {f.load('%x')}")
    if layout.states:
        calls("SetContinuousStates", f"ptr {f.at('%x', 1)}", f"i64 {layout.states}")
    f.store("0", calls.memory("changed"), "%number", "i32")
    if events:
        calls("EnterEventMode")
    calls.set_inputs(f.at("%x", 1 + layout.states))
    if events:
        calls.update()
    return f, calls


def _start_point(layout: CallLayout) -> FunctionWriter:
    f = FunctionWriter("point", [("ptr", "x"), ("ptr", "y"), ("i64", "number")], "noinline")
    worst = f.slot("i32")
    f.store("0", worst, kind="i32")
    calls = _InstanceCalls(f, layout, worst, "%number")
    write_place(f, calls.record, f.load("%x"), "%number")
    parameters = f.at("%x", 1 + layout.inputs)
    starts = f.at("%x", 1 + layout.inputs + layout.parameters) if layout.starts else None
    calls.initialize(parameters, f.at("%x", 1), starts)
    calls("GetContinuousStates", "ptr %y", f"i64 {layout.states}")
    _keep_parameters(calls, parameters)
    f.store("0", calls.memory("changed"), "%number", "i32")
    _finish_point(calls, layout.states)
    return f


def _set_parameters(calls: _InstanceCalls, parameters: str) -> None:
    """Set the parameters if they differ from those of the last call."""
    f, layout = calls.f, calls.layout
    needed = f.variable("i32", f.load(calls.memory("stale"), calls.number, "i32"))
    cache, levels = _cache(calls), calls.memory("levels")
    with f.loop(0, layout.parameters) as j:
        # une: true for NaN as well
        differs = f.new(f"fcmp une double {f.load(parameters, j)}, {f.load(cache, j)}")
        level = f.load(levels, j, "i32")
        higher = f.new(f"icmp sgt i32 {level}, {needed.get()}")
        with f.when(f.new(f"and i1 {differs}, {higher}")):
            needed.set(level)
    # a reset sets the tunable parameters as well, so that the highest level decides
    with f.when(f.new(f"icmp eq i32 {needed.get()}, {TUNED}")):
        calls("EnterEventMode")
        calls.numbers("Set", "parameters", layout.parameter_references, parameters, layout.parameters)
        calls.update()
    with f.when(f.new(f"icmp sge i32 {needed.get()}, {RESET}")):
        f.call("reset", [("ptr", parameters), ("ptr", calls.worst), ("i64", calls.number)])
    with f.when(f.new(f"icmp ne i32 {needed.get()}, {NONE}")):
        _keep_parameters(calls, parameters)


def _keep_parameters(calls: _InstanceCalls, parameters: str) -> None:
    cache = _cache(calls)
    with calls.f.loop(0, calls.layout.parameters) as j:
        calls.f.store(calls.f.load(parameters, j), cache, j)
    calls.f.store(str(NONE), calls.memory("stale"), calls.number, "i32")


def _cache(calls: _InstanceCalls) -> str:
    """Return the address of the parameters that an instance has."""
    return calls.f.at(calls.memory("cache"), calls.f.mul(calls.number, calls.layout.parameters))


def _finish_point(calls: _InstanceCalls, results: int) -> None:
    """Return NaN after an error or the end of the simulation; reset before the next use after these and events."""
    f = calls.f
    status = f.load(calls.worst, kind="i32")
    failed = f.new(f"icmp sgt i32 {status}, {WARNING}")
    change = f.load(calls.memory("changed"), calls.number, "i32")
    changed = f.new(f"icmp ne i32 {change}, 0")
    # without a function for events, a state that one of them changes would be lost
    ended = f.new(f"icmp eq i32 {change}, {_ENDED}") if calls.layout.jumps else changed
    unusable = f.new(f"or i1 {failed}, {ended}")
    with f.when(unusable), f.loop(0, results) as i:
        f.store(_NAN, "%y", i)
    damaged = f.new(f"icmp sgt i32 {status}, {DISCARD}")
    for condition, level in ((changed, RESET), (damaged, FAILED)):
        _mark(f, calls.memory("stale"), calls.number, condition, level)


def _evaluate(layout: CallLayout, shape: _FunctionShape) -> FunctionWriter:
    f = FunctionWriter(shape.name, [("ptr", "x"), ("ptr", "y"), ("ptr", "slopes")])
    worst = f.slot("i32")
    f.store("0", worst, kind="i32")
    calls = _InstanceCalls(f, layout, worst, "0")
    lock = calls.memory("control")
    write_acquire(f, lock, "i32")
    # the first instance alone has the values of x; the others differ from it in one parameter each
    f.call("point", [("ptr", "%x"), ("ptr", "%y"), ("i64", "0")])
    with f.when(f.new("icmp ne ptr %slopes, null")):
        # before differences, which leave the instance at another point
        if shape.name == "equations" and layout.directional:
            _directional_slopes(calls, shape)
        if shape.name == "events":
            _slopes_of_events(calls, shape)
        else:
            _difference_slopes(calls, shape)
        if shape.name == "equations" and layout.real_results < shape.results:
            with f.loop(layout.real_results * shape.arguments, shape.results * shape.arguments) as i:
                f.store(ZERO, "%slopes", i)
    write_end(f, calls.record)
    write_release(f, lock, "i32")
    return f


def _directional_slopes(calls: _InstanceCalls, shape: _FunctionShape) -> None:
    """Write the columns of slopes that the FMU computes itself, at the point that was evaluated last."""
    f, second = calls.f, calls.second
    column = f.slot("double", max(shape.results, 1))
    seed, unknowns = calls.memory("seed"), calls.memory("unknowns")
    known, positions, sizes = (calls.memory(name) for name in ("known", "positions", "sizes"))
    with _columns(calls, shape, DIRECTIONAL) as j:
        size, place = f.load(sizes, j, "i64"), f.load(positions, j, "i64")
        # the derivative along one element of an array: the seed is a unit vector
        f.store(literal(1.0), seed, place)
        f.store("0", calls.worst, kind="i32")
        lengths = ("", "") if second else (f", i64 {size}", f", i64 {calls.layout.real_results}")
        calls(
            "GetDirectionalDerivative",
            *(f"ptr {unknowns}", f"i64 {calls.layout.unknowns}", f"ptr {f.at(known, j, 'i32')}", "i64 1"),
            *(f"ptr {seed}{lengths[0]}", f"ptr {column}{lengths[1]}"),
        )
        f.store(ZERO, seed, place)
        failed = f.new(f"icmp sgt i32 {f.load(calls.worst, kind='i32')}, {WARNING}")
        with f.loop(0, calls.layout.real_results) as i:
            value = f.select(failed, _NAN, f.load(column, i))
            f.store(value, "%slopes", f.add(f.mul(i, shape.arguments), j))


def _slopes_of_events(calls: _InstanceCalls, shape: _FunctionShape) -> None:
    """Write the slopes of the states after events: those of the identity if there was none."""
    f = calls.f
    changed = f.new(f"icmp ne i32 {f.load(calls.memory('changed'), 0, 'i32')}, 0")
    with f.when(changed):
        _difference_slopes(calls, shape)
    with f.unless(changed):
        with f.loop(0, shape.results * shape.arguments) as i:
            f.store(ZERO, "%slopes", i)
        with f.loop(0, shape.results) as i:
            # slopes[i, 1 + i] = 1: argument 0 is the time, state i follows at 1 + i
            f.store(literal(1.0), "%slopes", f.add(f.mul(i, shape.arguments + 1), 1))


def _difference_slopes(calls: _InstanceCalls, shape: _FunctionShape) -> None:
    """Write the columns of slopes from differences over three points.

    They are central, unless a point would be beyond a limit of the argument. With the results at x, x + a and x + b,

        slope = (b (f(x + a) - f(x)) / a - a (f(x + b) - f(x)) / b) / (b - a)
    """
    f = calls.f
    near = f.slot("double", shape.arguments)
    results = [f.slot("double", max(shape.results, 1)) for _ in range(2)]
    tables = [calls.memory(f"{shape.name}_{name}") for name in ("steps", "least", "lower", "upper")]
    with f.loop(0, shape.arguments) as j:
        f.store(f.load("%x", j), near, j)
    with _columns(calls, shape, DIFFERENCES) as j:
        step, least, lower, upper = (f.load(table, j) for table in tables)
        x = f.load("%x", j)
        size = f.new(f"call double @llvm.fabs.f64(double {x})")
        # step * max(|x|, least): at 0, a relative step alone would vanish
        distance = f.fmul(step, f.select(f.new(f"fcmp ogt double {size}, {least}"), size, least))
        offsets = []
        sides = ((1.0, upper, "ogt", results[0]), (-1.0, lower, "olt", results[1]))
        for number, (side, limit, beyond, values) in enumerate(sides):
            end = f.new(f"fadd double {x}, {f.fmul(literal(side), distance)}")
            # beyond the upper limit, x - 2 d instead of x + d; beyond the lower one, x + 2 d instead of x - d
            other = f.new(f"fadd double {x}, {f.fmul(literal(-2 * side), distance)}")
            end = f.select(f.new(f"fcmp {beyond} double {end}, {limit}"), other, end)
            f.store(end, near, j)
            f.call("point", [("ptr", near), ("ptr", values), ("i64", _instance_for(calls, shape, j, number))])
            offsets.append(f.new(f"fsub double {end}, {x}"))
        f.store(x, near, j)
        a, b = offsets
        # a difference in the exact distances end - x, not d, which x + d rounds
        ratio, width = f.new(f"fdiv double {b}, {a}"), f.new(f"fsub double {b}, {a}")
        with f.loop(0, shape.results) as i:
            start = f.load("%y", i)
            first, second = (f.new(f"fsub double {f.load(values, i)}, {start}") for values in results)
            first, second = f.new(f"fmul double {ratio}, {first}"), f.new(f"fdiv double {second}, {ratio}")
            slope = f.new(f"fdiv double {f.new(f'fsub double {first}, {second}')}, {width}")
            f.store(slope, "%slopes", f.add(f.mul(i, shape.arguments), j))
    with _columns(calls, shape, SKIPPED) as j, f.loop(0, shape.results) as i:
        f.store(ZERO, "%slopes", f.add(f.mul(i, shape.arguments), j))


def _instance_for(calls: _InstanceCalls, shape: _FunctionShape, argument: str, side: int) -> str:
    """Return the number of the instance that evaluates one side of a difference."""
    f = calls.f
    if shape.name == "start":
        return "0"
    number = f.variable("i64", "0")
    # parameters are the last arguments of equations and events
    index = f.add(argument, calls.layout.parameters - shape.arguments)
    with f.when(f.new(f"icmp sge i64 {index}, 0")):
        f.call("choose", [("i64", f.add(f.mul(index, 2), side)), ("ptr", number.pointer)])
    return number.get()


def _choose_instance(layout: CallLayout) -> FunctionWriter:
    """Write the number of the instance for one side of a difference along a parameter, created if there is room."""
    f = FunctionWriter("choose", [("i64", "index"), ("ptr", "number")], "noinline")
    calls = _InstanceCalls(f, layout, f.slot("i32"), "0")
    slots, control, instances = (calls.memory(name) for name in ("slots", "control", "instances"))
    # 0 is the first instance, which no slot has: it stands for none, and for the instance to use if there is no room
    known = f.load(slots, "%index", "i64")
    f.store(known, "%number", kind="i64")
    used = f.load_index(control, USED)
    new = f.new(f"icmp eq i64 {known}, 0")
    with f.when(f.new(f"and i1 {new}, {_has_room(f, layout, used)}")):
        instance = calls.create(*_creation(calls))
        following = f.add(used, 1)
        usable = f.new(f"icmp ne ptr {instance}, null")
        with f.when(usable):
            f.store(instance, instances, following, "ptr")
            f.store(following, slots, "%index", "i64")
            f.store(following, "%number", kind="i64")
        # a library that refuses once is not asked again: all instances count as used
        last = f.new(f"select i1 {usable}, i64 {following}, i64 {layout.instances - 1}")
        f.store(f.new(f"trunc i64 {last} to i32"), control, USED, "i32")
    return f


def _has_room(f: FunctionWriter, layout: CallLayout, used: str) -> str:
    return f.new(f"icmp slt i64 {used}, {layout.instances - 1}")


def _creation(calls: _InstanceCalls) -> tuple[str, Sequence[str]]:
    """Return the function that creates an instance, and its arguments."""
    name, token, resources, log = calls.creation_arguments()
    if calls.second:
        # 0 is fmi2ModelExchange; not visible, no log
        return "fmi2Instantiate", (name, "i32 0", token, resources, log, calls.false, calls.false)
    return "fmi3InstantiateModelExchange", (name, token, resources, calls.false, calls.false, "ptr null", log)


@contextmanager
def _columns(calls: _InstanceCalls, shape: _FunctionShape, kind: int) -> Iterator[str]:
    """Run the body for each argument along which slopes are needed, and computed in one way."""
    f = calls.f
    kinds = calls.memory(f"{shape.name}_kinds")
    with f.loop(0, shape.arguments) as j:
        # the first row says which columns the caller needs, see `ExternalFunction`
        needed = f.new(f"fcmp one double {f.load('%slopes', j)}, {ZERO}")
        same = f.new(f"icmp eq i32 {f.load(kinds, j, 'i32')}, {kind}")
        with f.when(f.new(f"and i1 {needed}, {same}")):
            yield j


def recorded_functions(layout: CallLayout) -> Sequence[str]:
    """List the functions in the order of their numbers in records of calls."""
    return equation_functions(layout._replace(directional=True))


def equation_functions(layout: CallLayout) -> Sequence[str]:
    """List the functions of the library that the code calls, by name."""
    second, number = layout.version == "2.0", layout.version[0]
    names = ["Terminate", "Reset", "FreeInstance", "EnterInitializationMode", "ExitInitializationMode"]
    names += ["EnterEventMode", "EnterContinuousTimeMode"]
    names += ["SetTime", "SetContinuousStates", "GetContinuousStates"]
    names += ["GetDirectionalDerivative"] if layout.directional else []
    names += ["Instantiate" if second else "InstantiateModelExchange"]
    names += ["SetupExperiment", "NewDiscreteStates", "GetDerivatives", "SetReal", "GetReal"] if second else []
    names += [] if second else ["UpdateDiscreteStates", "GetContinuousStateDerivatives", "SetFloat64", "GetFloat64"]
    names += [f"Set{group.type.access}" for group in layout.input_groups if not group.type.is_real]
    names += [f"Get{group.type.access}" for group in layout.output_groups if not group.type.is_real]
    return [f"fmi{number}{name}" for name in names]
