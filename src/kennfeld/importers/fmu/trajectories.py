"""FMUs for co-simulation in this process: their trajectories, each in an instance, and the functions that run them."""

import ctypes
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.call_record import CallRecord
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.external import provide
from kennfeld.base.threads import computed_once
from kennfeld.importers.fmu.chosen_outputs import SEPARATOR, digest_with_outputs
from kennfeld.importers.fmu.description import FmuDescription, FmuVariable
from kennfeld.importers.fmu.fmu_archive import read_unchanged
from kennfeld.importers.fmu.instance_calls import REUSED
from kennfeld.importers.fmu.library import LOADING, READING, FmuLibrary, thread_address, yield_address
from kennfeld.importers.fmu.number_access import NumberGroup, group_numbers
from kennfeld.importers.fmu.reset_check import StartedValues, is_repeated, other_starts
from kennfeld.importers.fmu.spin_lock import YIELD
from kennfeld.importers.fmu.stop_reports import StopReports
from kennfeld.importers.fmu.trajectory_code import (
    INSTANCE,
    NO_INSTANCE,
    RECORD,
    SLOTS,
    THREAD,
    TrajectoryLayout,
    trajectory_functions,
    write_start,
    write_step,
)

_TRIAL_SAMPLES, _TRIAL_STEP = 4, 0.1


@dataclass(frozen=True)
class TrajectoryFunction:
    """A compiled function in this process, which it keeps there."""

    call: NativeFunction
    address: int
    fmu: "FmuTrajectories"

    @property
    def trajectories(self) -> int:
        """Number of trajectories that may run at once."""
        return self.fmu.layout.slots


def load_start(path: str, digest: str, outputs: str = "") -> TrajectoryFunction:
    """Load (place, t, inputs, parameters) -> ticket of an FMU; its code runs from now on.

    Raises:
        InputError: the file has changed, or its code cannot be used.
    """
    return load_trajectories(path, digest, outputs).start


def load_step(path: str, digest: str, outputs: str = "") -> TrajectoryFunction:
    """Load (ticket, t, inputs) -> outputs of an FMU; its code runs from now on."""
    return load_trajectories(path, digest, outputs).step


def load_trajectories(path: str, digest: str, outputs: str = "") -> "FmuTrajectories":
    """Load an FMU for trajectories in this process; `outputs` are names of variables in addition, a line each."""
    return _load(path, digest, outputs)


@computed_once
def _load(path: str, digest: str, outputs: str) -> "FmuTrajectories":
    source = Path(path)
    description = read_unchanged(source, digest).with_outputs(outputs.split(SEPARATOR))
    return FmuTrajectories(source, description, digest_with_outputs(digest, outputs))


class FmuTrajectories:
    """The instances of an FMU in this process, and the functions that start trajectories and advance them."""

    def __init__(self, source: Path, description: FmuDescription, digest: str) -> None:
        self.source, self.description = source, description
        self.layout = trajectory_layout(description, f"fmu_steps_{digest}")
        # before anything of the library runs: loading it may crash as well
        functions = [*trajectory_functions(self.layout), LOADING, READING]
        self.record = CallRecord(source.name, functions, self.layout.slots)
        self._memory: dict[str, Any] = {}
        self.library = self._load()
        self._started = StartedValues(description, self.library)
        self.reports = StopReports(source, self.library)
        self._provide_memory()
        self.start = self._compile(write_start(self.layout), "start")
        self.step = self._compile(write_step(self.layout), "step")
        self._check_reset()

    def _load(self) -> FmuLibrary:
        interface = self.description.co_simulation
        assert interface is not None  # checked by whoever reads the FMU
        library = FmuLibrary(self.source, self.description, interface, self.record)
        library.prepare()
        library.provide(trajectory_functions(self.layout), self.layout.prefix)
        library.provide_creation(self.layout.prefix)
        return library

    def _provide_memory(self) -> None:
        layout = self.layout
        self._keep("control", np.zeros(16, dtype=np.int64))
        # on trial, see `_check_reset`
        self._keep(REUSED, np.ones(1, dtype=np.int64))
        # words of 8 bytes, in which the code keeps integers, doubles and addresses
        slots = np.zeros((layout.slots, layout.words), dtype=np.int64)
        slots[:, RECORD] = [self.record.address(slot) for slot in range(layout.slots)]
        self._keep("slots", slots)
        self._keep_references(layout.parameters, set_at_start(self.description))
        self._keep_references(layout.inputs, inputs_of(self.description))
        self._keep_references(layout.outputs, outputs_of(self.description))
        self._provide("report", self.reports.address)
        provide(YIELD, yield_address())
        provide(THREAD, thread_address())

    def _keep_references(self, groups: Sequence[NumberGroup], variables: Sequence[FmuVariable]) -> None:
        remaining = iter(variables)
        for group in groups:
            references = [variable.reference for variable in islice(remaining, group.references)]
            self._keep(group.name, np.array(references, dtype=np.uint32))

    def _keep(self, name: str, array: NDArray[Any]) -> None:
        self._memory[name] = array if array.size else np.zeros(1, dtype=array.dtype)
        self._provide(name, self._memory[name].ctypes.data)

    def _provide(self, name: str, address: int) -> None:
        provide(f"{self.layout.prefix}_{name}", address)

    def _compile(self, functions: Sequence[Any], name: str) -> TrajectoryFunction:
        call = compile_functions(*functions)[name]
        return TrajectoryFunction(call, ctypes.cast(call, ctypes.c_void_p).value or 0, self)  # type: ignore[arg-type]

    def _check_reset(self) -> None:
        """Check on a few steps if an instance is as new after a reset; otherwise each trajectory needs a new one."""
        inputs = inputs_of(self.description)
        starts = np.array([v.start_of(k) for v in inputs for k in range(v.size)])
        with self.reports.muted():
            # the third trial leaves other inputs and states behind, which the reset before the fourth one has to remove
            others = other_starts(inputs)
            first, second, _, last = (self._trial(values) for values in (others, others, starts, others))
            if NO_INSTANCE in self.reports.reasons:
                reasons = f": {'; '.join(self.library.messages)}" if self.library.messages else ""
                message = f"its code does not create an instance{reasons}"
                raise InputError.of(Location.of_file(self.source), message, "Try the FMU in the tool that exported it.")
        # outputs and started values apart, as each has its own scale
        pairs = zip(first, second, last, strict=True)
        self._memory[REUSED][0] = all(is_repeated(new, *again) for new, *again in pairs)

    def _trial(self, inputs: Float) -> tuple[Float, Float]:
        """Run the first samples with constant inputs.

        Returns:
            Outputs, Float[samples, outputs], and the values after them of variables that state a start value.
        """
        description, size = self.description, self.layout.results
        parameters = [v.start_of(k) for v in set_at_start(description) for k in range(v.size)]
        ticket, outputs = np.zeros(1), np.empty((_TRIAL_SAMPLES, size))
        start = np.array([0.0, 0.0, *inputs, *parameters])
        self.start.call(start.ctypes.data, ticket.ctypes.data, None)
        # sample 0 is at the start time, which returns the outputs that the initialization left
        for number, result in enumerate(outputs):
            point = np.array([ticket[0], number * (description.step or _TRIAL_STEP), *inputs])
            self.step.call(point.ctypes.data, result.ctypes.data, None)
        # one thread at one place of a model: all trials run in the first slot
        return outputs, self._started.read(int(self._memory["slots"][0, INSTANCE]))

    @property
    def resets(self) -> bool:
        """True if instances are used again after a reset."""
        return bool(self._memory[REUSED][0])


def trajectory_layout(description: FmuDescription, prefix: str) -> TrajectoryLayout:
    """Count the values that the code of an FMU takes and returns."""
    interface, version = description.co_simulation, description.version
    assert interface is not None
    return TrajectoryLayout(
        version=version,
        prefix=prefix,
        parameters=group_numbers("parameters", version, set_at_start(description)),
        inputs=group_numbers("inputs", version, inputs_of(description)),
        outputs=group_numbers("outputs", version, outputs_of(description)),
        even=not interface.variable_step,
        slots=1 if interface.single else SLOTS,
    )


def set_at_start(description: FmuDescription) -> tuple[FmuVariable, ...]:
    """List the parameters, and the states whose values at the start can be set; all of them are doubles."""
    return (*description.parameters, *description.started_states)


def inputs_of(description: FmuDescription) -> tuple[FmuVariable, ...]:
    """Sort the inputs as the code takes them."""
    return description.sorted_by_type(description.number_inputs)


def outputs_of(description: FmuDescription) -> tuple[FmuVariable, ...]:
    """Sort the outputs as the code returns them."""
    return description.sorted_by_type(description.number_outputs)
