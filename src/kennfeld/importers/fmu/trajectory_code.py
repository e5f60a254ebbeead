"""Machine code that runs FMUs for co-simulation: the start of a trajectory, and a step of it.

Each trajectory has a ticket, a number that the start returns and that its steps state. It runs in an instance of the
FMU, which a slot holds: memory of `TrajectoryLayout.words` words of 8 bytes. A thread that starts a trajectory at the
same place of a model again has finished the last one, so that it gets the same slot; the others go to new slots, and
if there are no more, to that with the oldest step. The ticket of a slot that was given away no longer fits.

The start takes (place, t, inputs, parameters) and returns the ticket. A step takes (ticket, t, inputs) and returns the
outputs. At a later time than that of the last step, it sets the inputs, which are those of the sample before, lets the
FMU advance and reads the outputs, in this order, as FMI 2.0 demands. At the same time it returns the same outputs.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from kennfeld.base.machine_code.call_record import write_end, write_place
from kennfeld.base.machine_code.external import c_pointer
from kennfeld.base.machine_code.ir import ZERO, FunctionWriter, literal
from kennfeld.importers.fmu.instance_calls import DISCARD, FATAL, InstanceCalls
from kennfeld.importers.fmu.number_access import NumberGroup, get_numbers, set_numbers
from kennfeld.importers.fmu.spin_lock import write_acquire, write_release

SLOTS = 64  # a power of 2; a ticket is a multiple of it plus the number of the slot
LOCK, SERIAL, USED, DEAD = range(4)  # words of the memory `control`
ORDER, UNEVEN, NOT_A_NUMBER, EARLY, TERMINATED, LOST, NO_INSTANCE = range(10, 17)  # other reasons to stop
THREAD = "current_thread"
UNEVEN_SHARE = 1e-3  # of the step, by which the steps of an FMU that needs equal ones may differ

RECORD = 11  # word of a slot that holds the address of its record of calls
_LOCK, INSTANCE, _TICKET, _THREAD, _PLACE, _STATE, _LATEST, _TIME, _STEP, _BEGAN, _COUNT = range(RECORD)
_OUTPUTS = RECORD + 1
_RUNNING, _FAILED, _ENDED = range(3)  # states of a trajectory
_LAST_TIME, _TERMINATED = 2, 3  # kinds of status of FMI 2.0
_LINE = 16  # words of 8 bytes that no two processors should write at once
_NAN = literal(float("nan"))


class TrajectoryLayout(NamedTuple):
    """The numbers of values on which the code depends.

    Attributes:
        version: `2.0` or `3.0`.
        prefix: begin of the names of memory and functions.
        parameters: the parameters in the order of arguments.
        inputs: the inputs in the order of arguments.
        outputs: the outputs in the order of results.
        even: True if all steps must have the same length.
        slots: number of trajectories that can run at once.
    """

    version: str
    prefix: str
    parameters: tuple[NumberGroup, ...]
    inputs: tuple[NumberGroup, ...]
    outputs: tuple[NumberGroup, ...]
    even: bool
    slots: int

    @property
    def arguments(self) -> int:
        """Number of values of the inputs."""
        return sum(group.size for group in self.inputs)

    @property
    def results(self) -> int:
        """Number of values of the outputs."""
        return sum(group.size for group in self.outputs)

    @property
    def set_at_start(self) -> int:
        """Number of values of the parameters."""
        return sum(group.size for group in self.parameters)

    @property
    def words(self) -> int:
        """Number of words of a slot."""
        # rounded up, so that threads do not write to one cache line
        return -(-(_OUTPUTS + self.results) // _LINE) * _LINE


def write_start(layout: TrajectoryLayout) -> list[FunctionWriter]:
    """Write the functions for the start of a trajectory; the last one is to be called."""
    return [
        _read_outputs(layout),
        _write_inputs(layout),
        _renew(layout),
        _choose(layout),
        _begin(layout),
        _start(layout),
    ]


def write_step(layout: TrajectoryLayout) -> list[FunctionWriter]:
    """Write the functions for a step of a trajectory; the last one is to be called."""
    return [_read_outputs(layout), _write_inputs(layout), _move(layout), _advance(layout), _step(layout)]


def trajectory_functions(layout: TrajectoryLayout) -> Sequence[str]:
    """List the functions of the library that the code calls, by name."""
    second = layout.version == "2.0"
    names = ["Terminate", "Reset", "FreeInstance", "EnterInitializationMode", "ExitInitializationMode", "DoStep"]
    names += ["Instantiate", "SetupExperiment", "GetBooleanStatus", "GetRealStatus"] if second else []
    names += [] if second else ["InstantiateCoSimulation"]
    names += [f"Set{group.type.access}" for group in (*layout.parameters, *layout.inputs)]
    names += [f"Get{group.type.access}" for group in layout.outputs]
    return [f"fmi{layout.version[0]}{name}" for name in dict.fromkeys(names)]


class _SlotCalls(InstanceCalls):
    """Calls of the functions of the instance in a slot; the worst status is kept in the memory at `worst`."""

    def __init__(self, f: FunctionWriter, layout: TrajectoryLayout, slot: str, worst: str) -> None:
        place, functions = f.at(slot, INSTANCE, "i64"), trajectory_functions(layout)
        super().__init__(f, layout.version, layout.prefix, functions, place, _record(f, slot), worst)
        self.slot = slot

    def check(self, time: str) -> None:
        """Stop the trajectory after an error."""
        status = self.f.load(self.worst, kind="i32")
        with self.f.when(self.f.new(f"icmp sge i32 {status}, {DISCARD}")):
            self.stop(status, time)

    def stop(self, reason: str | int, time: str) -> None:
        """Stop the trajectory for a reason, which is reported; after a fatal error, no function is called any more."""
        f = self.f
        f.store(str(_FAILED), self.slot, _STATE, "i64")
        fatal = f.new(f"zext i1 {f.new(f'icmp eq i32 {reason}, {FATAL}')} to i64")
        control = self.memory("control")
        f.store(f.new(f"or i64 {f.load(control, DEAD, 'i64')}, {fatal}"), control, DEAD, "i64")
        self.report(reason, time)

    def report(self, reason: str | int, time: str) -> None:
        self.f.do(f"call void {self.memory('report')}(i32 {reason}, double {time})")

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the body unless the trajectory has stopped."""
        with self.f.when(self.f.new(f"icmp eq i64 {self.f.load(self.slot, _STATE, 'i64')}, {_RUNNING}")):
            yield


def _slot(f: FunctionWriter, layout: TrajectoryLayout, number: str) -> str:
    return f.at(c_pointer(f, f"{layout.prefix}_slots"), f.mul(number, layout.words), "i64")


def _record(f: FunctionWriter, slot: str) -> str:
    return f.load(slot, RECORD, "ptr")


def _read_outputs(layout: TrajectoryLayout) -> FunctionWriter:
    """Write `read(slot, worst)`: the outputs of the FMU are stored in the slot."""
    f = FunctionWriter("read", [("ptr", "slot"), ("ptr", "worst")], "noinline")
    calls = _SlotCalls(f, layout, "%slot", "%worst")
    get_numbers(f, layout.outputs, f.at("%slot", _OUTPUTS), calls.get)
    return f


def _write_inputs(layout: TrajectoryLayout) -> FunctionWriter:
    """Write `give(slot, x, worst)`: the FMU gets its inputs; one that is not a number stops the trajectory."""
    f = FunctionWriter("give", [("ptr", "slot"), ("ptr", "x"), ("ptr", "worst")], "noinline")
    calls = _SlotCalls(f, layout, "%slot", "%worst")
    with f.loop(2, 2 + layout.arguments) as i:
        value = f.load("%x", i)
        # the first one that is NaN is reported, not each
        with f.when(f.new(f"fcmp uno double {value}, {value}")), calls.running():
            calls.stop(NOT_A_NUMBER, f.load("%slot", _TIME))
    with calls.running():
        set_numbers(f, layout.inputs, f.at("%x", 2), calls.set)
    return f


def _load(f: FunctionWriter, pointer: str, index: str, kind: str) -> str:
    return f.new(f"load {kind}, ptr {f.at(pointer, index, kind)}, align 1")


def _start(layout: TrajectoryLayout) -> FunctionWriter:
    f = FunctionWriter("start", [("ptr", "x"), ("ptr", "y"), ("ptr", "slopes")])
    f.store(_NAN, "%y")
    number = f.variable("i64", "-1")
    control = c_pointer(f, f"{layout.prefix}_control")
    write_acquire(f, control, "i64")
    # after a fatal error of any instance, the standard forbids further calls
    with f.when(f.new(f"icmp eq i64 {f.load(control, DEAD, 'i64')}, 0")):
        f.call("choose", [("ptr", "%x"), ("ptr", number.pointer)])
    write_release(f, control, "i64")
    with f.when(f.new(f"icmp sge i64 {number.get()}, 0")):
        slot = _slot(f, layout, number.get())
        f.call("begin", [("ptr", slot), ("ptr", "%x")])
        failed = f.new(f"icmp eq i64 {f.load(slot, _STATE, 'i64')}, {_FAILED}")
        f.store(f.select(failed, _NAN, f.load(slot, _TICKET)), "%y")
        write_end(f, _record(f, slot))
        write_release(f, slot, "i64")
    _no_slopes(f, 1, 2 + layout.arguments + layout.set_at_start)
    return f


def _choose(layout: TrajectoryLayout) -> FunctionWriter:
    """Write `choose(x, number)`: a slot gets a new ticket and stays locked; the number stays -1 without an instance."""
    f = FunctionWriter("choose", [("ptr", "x"), ("ptr", "number")], "noinline")
    control = c_pointer(f, f"{layout.prefix}_control")
    thread = f.new(f"call i64 {c_pointer(f, THREAD)}()")
    used, place = f.load(control, USED, "i64"), f.load("%x")
    # 2^62 is above every serial number
    oldest, latest = f.variable("i64", "-1"), f.variable("i64", str(2**62))
    with f.loop(0, used) as i:
        slot = _slot(f, layout, i)
        same = f.new(f"icmp eq i64 {f.load(slot, _THREAD, 'i64')}, {thread}")
        here = f.new(f"fcmp oeq double {f.load(slot, _PLACE)}, {place}")
        with f.when(f.new(f"and i1 {same}, {here}")):
            f.store(i, "%number", kind="i64")
        with f.when(f.new(f"icmp slt i64 {f.load(slot, _LATEST, 'i64')}, {latest.get()}")):
            latest.set(f.load(slot, _LATEST, "i64"))
            oldest.set(i)
    new = f.new(f"icmp slt i64 {f.load('%number', kind='i64')}, 0")
    room = f.new(f"icmp slt i64 {used}, {layout.slots}")
    with f.when(f.new(f"and i1 {new}, {room}")):
        f.store(used, "%number", kind="i64")
        f.store(f.add(used, 1), control, USED, "i64")
    # all slots are used: the trajectory whose last step is the oldest loses its instance
    with f.when(f.new(f"icmp slt i64 {f.load('%number', kind='i64')}, 0")):
        f.store(oldest.get(), "%number", kind="i64")
    number = f.load("%number", kind="i64")
    slot = _slot(f, layout, number)
    write_acquire(f, slot, "i64")
    serial = f.add(f.load(control, SERIAL, "i64"), 1)
    # ticket = serial * SLOTS + number of the slot, exact as a double up to 2^53
    ticket = f.new(f"sitofp i64 {f.add(f.mul(serial, SLOTS), number)} to double")
    f.store(serial, control, SERIAL, "i64")
    f.store(serial, slot, _LATEST, "i64")
    f.store(ticket, slot, _TICKET)
    f.store(thread, slot, _THREAD, "i64")
    f.store(place, slot, _PLACE)
    return f


def _begin(layout: TrajectoryLayout) -> FunctionWriter:
    """Write `begin(slot, x)`: the instance of a slot is initialized."""
    f = FunctionWriter("begin", [("ptr", "slot"), ("ptr", "x")], "noinline")
    worst, time = f.slot("i32"), f.load("%x", 1)
    calls = _SlotCalls(f, layout, "%slot", worst)
    f.store("0", worst, kind="i32")
    write_place(f, _record(f, "%slot"), time)
    # before the state of the last trajectory is lost: how an instance ended decides what may be called
    f.call("renew", [("ptr", "%slot")])
    for word, value in ((_STATE, str(_RUNNING)), (_COUNT, "0")):
        f.store(value, "%slot", word, "i64")
    for word, value in ((_TIME, time), (_BEGAN, time), (_STEP, ZERO)):
        f.store(value, "%slot", word)
    with f.when(f.new(f"icmp eq ptr {f.load('%slot', INSTANCE, 'ptr')}, null")):
        calls.stop(NO_INSTANCE, time)
    with calls.running():
        times = [calls.false, f"double {ZERO}", f"double {time}", calls.false, f"double {ZERO}"]
        if calls.second:
            calls("SetupExperiment", *times)
        # before initialization, where both standards allow `fixed` and `tunable` parameters
        set_numbers(f, layout.parameters, f.at("%x", 2 + layout.arguments), calls.set)
        calls("EnterInitializationMode", *(() if calls.second else times))
        f.call("give", [("ptr", "%slot"), ("ptr", "%x"), ("ptr", worst)])
    with calls.running():
        calls("ExitInitializationMode")
        calls.check(time)
    with calls.running():
        f.call("read", [("ptr", "%slot"), ("ptr", worst)])
        calls.check(time)
    return f


def _renew(layout: TrajectoryLayout) -> FunctionWriter:
    """Write `renew(slot)`: the instance of a slot is as new; it is reset if that works, otherwise replaced."""
    f = FunctionWriter("renew", [("ptr", "slot")], "noinline")
    calls = _SlotCalls(f, layout, "%slot", f.slot("i32"))
    running = f.new(f"icmp ne i64 {f.load('%slot', _STATE, 'i64')}, {_FAILED}")
    name, token, resources, log = calls.creation_arguments()
    if calls.second:
        # 1 is fmi2CoSimulation; not visible, no log
        calls.renew(running, "fmi2Instantiate", [name, "i32 1", token, resources, log, calls.false, calls.false])
    else:
        # not visible, no log, no event mode, no early return, no intermediate variables
        flags = [*[calls.false] * 4, "ptr null", "i64 0"]
        arguments = [name, token, resources, *flags, "ptr null", log, "ptr null"]
        calls.renew(running, "fmi3InstantiateCoSimulation", arguments)
    return f


def _step(layout: TrajectoryLayout) -> FunctionWriter:
    f = FunctionWriter("step", [("ptr", "x"), ("ptr", "y"), ("ptr", "slopes")])
    ticket = f.load("%x")
    with f.loop(0, layout.results) as i:
        f.store(_NAN, "%y", i)
    # false for NaN, the ticket of a trajectory that could not start
    with f.when(f.new(f"fcmp oge double {ticket}, {ZERO}")):
        slot = _slot(f, layout, f.new(f"and i64 {f.new(f'fptosi double {ticket} to i64')}, {SLOTS - 1}"))
        write_acquire(f, slot, "i64")
        own = f.new(f"fcmp oeq double {f.load(slot, _TICKET)}, {ticket}")
        with f.when(own):
            with f.when(f.new(f"fcmp une double {f.load('%x', 1)}, {f.load(slot, _TIME)}")):
                f.call("advance", [("ptr", slot), ("ptr", "%x")])
                write_end(f, _record(f, slot))
            with f.loop(0, layout.results) as i:
                f.store(f.load(slot, f.add(i, _OUTPUTS)), "%y", i)
        write_release(f, slot, "i64")
        with f.unless(own):
            _SlotCalls(f, layout, slot, "null").report(LOST, f.load("%x", 1))
    _no_slopes(f, layout.results, 2 + layout.arguments)
    return f


def _no_slopes(f: FunctionWriter, results: int, arguments: int) -> None:
    # a step depends on all before it, so that slopes come from differences of whole simulations
    with f.when(f.new("icmp ne ptr %slopes, null")), f.loop(0, results * arguments) as i:
        f.store(_NAN, "%slopes", i)


def _advance(layout: TrajectoryLayout) -> FunctionWriter:
    """Write `advance(slot, x)`: the slot gets the outputs at a new time, NaN once the trajectory has stopped."""
    f = FunctionWriter("advance", [("ptr", "slot"), ("ptr", "x")], "noinline")
    calls = _SlotCalls(f, layout, "%slot", "null")
    # the state before the step: the outputs of the step in which an FMU ends still count
    before = f.load("%slot", _STATE, "i64")
    f.store(f.load(calls.memory("control"), SERIAL, "i64"), "%slot", _LATEST, "i64")
    with calls.running():
        f.call("move", [("ptr", "%slot"), ("ptr", "%x")])
    f.store(f.load("%x", 1), "%slot", _TIME)
    stopped = f.new(f"icmp ne i64 {before}, {_RUNNING}")
    failed = f.new(f"icmp eq i64 {f.load('%slot', _STATE, 'i64')}, {_FAILED}")
    with f.when(f.new(f"or i1 {stopped}, {failed}")), f.loop(0, layout.results) as i:
        f.store(_NAN, "%slot", f.add(i, _OUTPUTS))
    return f


def _move(layout: TrajectoryLayout) -> FunctionWriter:
    """Write `move(slot, x)`: the inputs of the FMU are set, it advances to the time of x, and its outputs are read."""
    f = FunctionWriter("move", [("ptr", "slot"), ("ptr", "x")], "noinline")
    worst, time, last = f.slot("i32"), f.load("%x", 1), f.load("%slot", _TIME)
    f.store("0", worst, kind="i32")
    write_place(f, _record(f, "%slot"), time)
    calls = _SlotCalls(f, layout, "%slot", worst)
    # unless, not ule: a time of NaN stops as well
    with f.unless(f.new(f"fcmp ogt double {time}, {last}")):
        calls.stop(ORDER, time)
    distance = f.new(f"fsub double {time}, {last}")
    dead = f.load(calls.memory("control"), DEAD, "i64")
    with f.when(f.new(f"icmp ne i64 {dead}, 0")):
        f.store(str(_FAILED), "%slot", _STATE, "i64")
    with calls.running():
        f.call("give", [("ptr", "%slot"), ("ptr", "%x"), ("ptr", worst)])
        calls.check(time)
    with calls.running():
        point, length = _even_step(calls, time, distance) if layout.even else (last, distance)
        with calls.running():
            _do_step(calls, point, length, time)
    with f.when(f.new(f"icmp ne i64 {f.load('%slot', _STATE, 'i64')}, {_FAILED}")):
        f.call("read", [("ptr", "%slot"), ("ptr", worst)])
        calls.check(time)
    return f


def _do_step(calls: _SlotCalls, point: str, length: str, time: str) -> None:
    f = calls.f
    if calls.second:
        # true: no earlier state will be restored
        calls("DoStep", f"double {point}", f"double {length}", "i32 1")
        _find_end(calls, length, time)
        calls.check(time)
        return
    flags, reached = f.slot("i8", 3), f.slot("double")
    for number in range(3):
        f.do(f"store i8 0, ptr {f.at(flags, number, 'i8')}, align 1")
    pointers = [f"ptr {f.at(flags, number, 'i8')}" for number in range(3)]
    calls("DoStep", f"double {point}", f"double {length}", "i1 zeroext true", *pointers, f"ptr {reached}")
    calls.check(time)
    # event handling needed, terminate, early return
    _, ended, early = (f.new(f"icmp ne i8 {_load(f, flags, str(number), 'i8')}, 0") for number in range(3))
    with calls.running(), f.when(early):
        calls.stop(EARLY, time)
    with calls.running(), f.when(ended):
        f.store(str(_ENDED), "%slot", _STATE, "i64")
        calls.report(TERMINATED, time)


def _find_end(calls: _SlotCalls, length: str, time: str) -> None:
    """End the trajectory if the FMU discarded the step because the simulation ends; FMI 2.0 has no other way."""
    f = calls.f
    ended, reached = f.slot("i32"), f.slot("double")
    with f.when(f.new(f"icmp eq i32 {f.load(calls.worst, kind='i32')}, {DISCARD}")):
        f.store("0", ended, kind="i32")
        f.store(_NAN, reached)
        instance = f"ptr {f.load(calls.slot, INSTANCE, 'ptr')}"
        f.new(f"call i32 {calls.function('fmi2GetBooleanStatus')}({instance}, i32 {_TERMINATED}, ptr {ended})")
        f.new(f"call i32 {calls.function('fmi2GetRealStatus')}({instance}, i32 {_LAST_TIME}, ptr {reached})")
        with f.when(f.new(f"icmp ne i32 {f.load(ended, kind='i32')}, 0")):
            # it may end within the step; the outputs count only if it reached the end
            least = f.new(f"fsub double {time}, {f.fmul(literal(UNEVEN_SHARE), length)}")
            complete = f.new(f"fcmp oge double {f.load(reached)}, {least}")
            f.store(f.new(f"select i1 {complete}, i64 {_ENDED}, i64 {_FAILED}"), calls.slot, _STATE, "i64")
            # no error: the caller must not report the discarded step once more
            f.store("0", calls.worst, kind="i32")
            calls.report(TERMINATED, time)


def _even_step(calls: _SlotCalls, time: str, distance: str) -> tuple[str, str]:
    """Return begin and length of a step of an FMU that needs steps of equal length."""
    f = calls.f
    count = f.load("%slot", _COUNT, "i64")
    with f.when(f.new(f"icmp eq i64 {count}, 0")):
        f.store(distance, "%slot", _STEP)
    length = f.load("%slot", _STEP)
    difference = f.new(f"call double @llvm.fabs.f64(double {f.new(f'fsub double {distance}, {length}')})")
    with f.unless(f.new(f"fcmp ole double {difference}, {f.fmul(literal(UNEVEN_SHARE), length)}")):
        calls.stop(UNEVEN, time)
    f.store(f.add(count, 1), "%slot", _COUNT, "i64")
    # begin + count * length instead of the time stamps, whose rounding makes steps differ in the last digits
    covered = f.fmul(f.new(f"sitofp i64 {count} to double"), length)
    return f.new(f"fadd double {f.load('%slot', _BEGAN)}, {covered}"), length
