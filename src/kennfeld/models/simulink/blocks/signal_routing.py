"""Signals put together, taken apart and passed on.

Named memories that blocks read and write without lines.
"""

import re
from collections.abc import Iterable, Sequence

import numpy as np

from kennfeld.models.imperative.node_arrays import Nodes, truncate
from kennfeld.models.simulink.blocks.bit_operations import fitted, stored
from kennfeld.models.simulink.flattening.connections import bus_member_names
from kennfeld.models.simulink.flattening.integer_signals import integer_type_of, stated_word
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.parameter_fields import case_values, length_of, listed, selected_indices
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import (
    Bus,
    ExternalBus,
    Signal,
    SignalOrBus,
    fastest_sample_time,
    fit_to_shape,
    leaf_signals,
    scalar,
)

_LONGEST_PICK = 10_000
_MOST_COMPARISONS = 100_000


@block("SignalConversion", "SignalSpecification")
def passed(site: BlockContext) -> SignalOrBus:
    """The signal itself."""
    return site.wired(0)


@block("DataTypeConversion", OutDataTypeStr="Inherit: Inherit via back propagation", SampleTime="-1",
       ConvertRealWorld="Real World Value (RWV)")  # fmt: skip
def conversion(site: BlockContext) -> SignalOrBus:
    """The signal itself, since values are physical; as a truth value 1 wherever it is not 0."""
    wanted = _wanted_type(site)
    if site.text("ConvertRealWorld").startswith("Stored"):
        return _by_bits(site, wanted)
    if wanted in ("boolean", "logical"):
        return site.call("ne", site.input(), site.constant(0.0))
    return site.wired(0)


def _by_bits(site: BlockContext, wanted: str) -> SignalOrBus:
    """The number that the stored bits of the input are in another type."""
    if not (_is_plain(wanted) and integer_type_of(site.source())):
        message = "it takes a number by its stored bits, and types of fixed point are left aside"
        raise UnsupportedError(message, "Put a Gain of the scaling in its place, or bind it.")
    word = stated_word(site.atom)
    return stored(site, 0) if word is None else fitted(site, stored(site, 0), word)


def _wanted_type(site: BlockContext) -> str:
    """The type that a conversion makes, which older files state under other names; one that is inherited is none."""
    for key in ("OutDataTypeStr", "OutDataTypeMode", "DataType"):
        written = (site.atom.block.value(key) or "").strip()
        if written and written != "auto" and not written.startswith(("Inherit", "Specify")):
            return written
    return ""


def _is_plain(name: str) -> bool:
    return re.fullmatch(r"u?int(8|16|32|64)|double|single|half", name) is not None


@block("Mux", Inputs="4")
def mux(site: BlockContext) -> SignalOrBus:
    """All elements of all inputs in one vector."""
    parts = [signal for at in range(site.count) for _, signal in leaf_signals(site.wired(at))]
    nodes = [node for part in parts for node in part.flat]
    return Signal(np.array(nodes, dtype=np.int64), fastest_sample_time([part.period for part in parts]))


@block("Demux", Outputs="4")
def demux(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """The elements of a vector, each output as many as it is wide."""
    wired = site.wired(0)
    if isinstance(wired, Bus):
        members = list(wired.members.values())
        if len(members) == _outputs(site):
            return tuple(members)
        nodes = [node for _, signal in leaf_signals(wired) for node in signal.flat]
        wired = Signal(np.array(nodes, dtype=np.int64), wired.period)
    if wired.size == 1 < _outputs(site) and site.numbers("Outputs").size == 1:
        site.wish(0, (_outputs(site),))
    widths = _widths(site, wired.size)
    ends = np.cumsum(widths)
    flat = np.array(wired.flat, dtype=np.int64)
    return tuple(Signal(part, wired.period) for part in np.split(flat, ends[:-1]))


def _outputs(site: BlockContext) -> int:
    given = _stated(site)
    return given[0] if len(given) == 1 else len(given)


def _stated(site: BlockContext) -> list[int]:
    """The number of outputs, or the width of each of them."""
    given = site.numbers("Outputs").ravel()
    if not (given.size and all(n.is_integer() for n in given.tolist())):
        raise UnsupportedError(f"its Outputs is {site.text('Outputs')[:60]}, no whole numbers")
    return [int(n) for n in given]


def _widths(site: BlockContext, size: int) -> list[int]:
    given = _stated(site)
    if len(given) > 1:
        free = [at for at, width in enumerate(given) if width <= 0]
        rest = size - sum(width for width in given if width > 0)
        for at, width in zip(free, _shares(rest, len(free)), strict=True):
            given[at] = width
        if sum(given) != size or min(given) < 1:
            raise UnsupportedError(f"a vector of {size} elements does not fit its outputs {str(given)[:100]}")
        return given
    count = given[0] if given else 0
    if not 1 <= count <= size:
        raise UnsupportedError(f"a vector of {size} elements does not fit its {count} outputs")
    return _shares(size, count)


def _shares(size: int, count: int) -> list[int]:
    """A number of elements shared out; the first get one more where it does not go up evenly."""
    return [size // count + (at < size % count) for at in range(count)] if count else []


@block("BusCreator", Inputs="2")
def bus_creator(site: BlockContext) -> SignalOrBus:
    """A bus of its inputs, called by the names of their lines."""
    names = bus_member_names([site.atom.taken.get(at, "") for at in range(site.count)], site.text("Inputs"))
    return Bus({name: site.wired(at) for at, name in enumerate(names)})


@block("BusSelector", OutputSignals="signal1", OutputAsBus="off")
def bus_selector(site: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """Signals of a bus by their names."""
    wired = site.bus()
    ways = [way.strip() for way in site.text("OutputSignals").split(",")]
    found = [member_of(site, wired, way) for way in ways]
    if site.on("OutputAsBus"):
        return Bus({way.rpartition(".")[2]: one for way, one in zip(ways, found, strict=True)})
    return tuple(found)


def member_of(site: BlockContext, wired: SignalOrBus, way: str) -> SignalOrBus:
    """The part of a bus at the end of a way "a.b"."""
    for name in way.split("."):
        if not isinstance(wired, Bus):
            raise UnsupportedError(f"it selects {way} of a signal that is no bus")
        found = wired.member(name)
        if found is None:
            known = ", ".join(wired.members)
            raise UnsupportedError(f"it selects {way}, but the bus has {known[:200]}")
        wired = found
    return wired


@block("BusAssignment", AssignedSignals="")
def bus_assignment(site: BlockContext) -> SignalOrBus:
    """A bus with some of its signals replaced."""
    bus = site.bus()
    for at, way in enumerate(site.text("AssignedSignals").split(","), 1):
        member_of(site, bus, way.strip())
        bus = _assigned(bus, way.strip().split("."), site.wired(at))
    return bus


def _assigned(wired: SignalOrBus, way: list[str], new: SignalOrBus) -> SignalOrBus:
    inner = wired.member(way[0]) if way and isinstance(wired, Bus) else None
    if inner is None or not isinstance(wired, Bus):
        return new
    return wired.assigned(way[0], _assigned(inner, way[1:], new))


@block("BusElement")
def bus_element(site: BlockContext) -> SignalOrBus:
    """An element of the bus that a subsystem takes; the bus itself where none is named."""
    if site.atom.why:
        raise UnsupportedError(f"it is {site.atom.why}")
    way = site.atom.ways[0] if site.atom.ways else ""
    return member_of(site, site.wired(0), way) if way else site.wired(0)


@block("BusElements")
def bus_of_elements(site: BlockContext) -> SignalOrBus:
    """The bus that a subsystem gives, of the elements that its blocks name."""
    if site.atom.why:
        raise UnsupportedError(f"it is {site.atom.why}")
    bus: SignalOrBus = Bus()
    for at, way in enumerate(site.atom.ways):
        if not way:
            return site.wired(at)
        bus = _set(bus, way.split("."), site.wired(at))
    return bus


def _set(wired: SignalOrBus, way: list[str], new: SignalOrBus) -> SignalOrBus:
    """A bus with a signal put in, and buses on the way to it where there are none."""
    if not way:
        return new
    members = dict(wired.members) if isinstance(wired, Bus) else {}
    members[way[0]] = _set(members.get(way[0], Bus()), way[1:], new)
    return Bus(members)


@block("Concatenate", Mode="Vector", ConcatenateDimension="1")
def concatenate(site: BlockContext) -> SignalOrBus:
    """Vectors behind each other, or matrices along a dimension."""
    inputs = site.inputs
    period = fastest_sample_time([one.period for one in inputs])
    if site.chosen("Mode", "Vector", "Multidimensional array") == "Vector":
        return Signal(_joined(inputs), period)
    axis = site.whole("ConcatenateDimension", 1, 2) - 1
    parts = [one.nodes if one.nodes.ndim == 2 else one.nodes.reshape(-1, 1) for one in inputs]
    try:
        return Signal(np.concatenate(parts, axis=axis), period)
    except ValueError:
        raise UnsupportedError(f"its inputs of the sizes {[p.shape for p in parts]} do not fit each other") from None


def _joined(inputs: Sequence[Signal]) -> Nodes:
    """The elements of vectors behind each other; a row or a column where one of them is."""
    made = np.array([node for one in inputs for node in one.flat], dtype=np.int64)
    shapes = {one.shape for one in inputs if one.nodes.ndim == 2 and one.size > 1}
    if not shapes:
        return made
    if all(rows == 1 for rows, _ in shapes):
        return made.reshape(1, -1)
    if all(columns == 1 for _, columns in shapes):
        return made.reshape(-1, 1)
    raise UnsupportedError(f"it puts vectors together, and its inputs have the sizes {[one.shape for one in inputs]}")


@block("Reshape", OutputDimensionality="1-D array", OutputDimensions="[1,1]")
def reshape(site: BlockContext) -> SignalOrBus:
    """The same elements in another shape, columns first."""
    x = site.input()
    kind = site.chosen(
        "OutputDimensionality",
        "1-D array",
        "Column vector (2-D)",
        "Row vector (2-D)",
        "Customize",
        "Derive from reference input port",
    )
    shapes = {"1-D array": (-1,), "Column vector (2-D)": (-1, 1), "Row vector (2-D)": (1, -1)}
    if kind == "Derive from reference input port":
        shape: tuple[int, ...] = site.input(1).shape
    else:
        shape = shapes.get(kind) or tuple(int(n) for n in site.numbers("OutputDimensions").ravel())
    try:
        return Signal(x.nodes.reshape(shape, order="F"), x.period)
    except ValueError:
        raise UnsupportedError(f"{x.size} elements do not fit the shape {list(shape)}") from None


@block("Selector", NumberOfDimensions="1", IndexMode="One-based")
def selector(site: BlockContext) -> SignalOrBus:
    """Elements of a vector or matrix by their places."""
    x = site.input()
    dimensions = site.whole("NumberOfDimensions", 1, 2)
    options = listed(site, "IndexOptions", "IndexOptionArray") or _old_options(site, dimensions)
    given = listed(site, "Indices", "IndexParamArray") or [site.text("Elements", "")]
    nodes = np.array(x.flat, dtype=np.int64) if dimensions == 1 else x.nodes
    if nodes.ndim != dimensions:
        raise UnsupportedError(f"it selects from {dimensions} dimensions of a signal that has {nodes.ndim}")
    port = 1
    for axis, option in enumerate(options[:dimensions]):
        text = given[axis] if axis < len(given) else ""
        if option in ("Index vector (port)", "Starting index (port)"):
            nodes = _picked(site, nodes, axis, _running(site, option, axis, site.input(port)))
            port += 1
        else:
            nodes = np.take(nodes, selected_indices(site, option, text, nodes.shape[axis], axis), axis=axis)
    return Signal(nodes, fastest_sample_time([one.period for one in site.inputs]))


def _old_options(site: BlockContext, dimensions: int) -> list[str]:
    source = site.text("IndexIsStartValue", "off")
    if site.text("ElementSrc", "Internal") != "Internal" or source == "on":
        raise UnsupportedError("its places come from an input in a way that is not supported")
    return ["Index vector (dialog)"] * dimensions


def _running(site: BlockContext, option: str, axis: int, index: Signal) -> Signal:
    """The places that an input gives; from a starting index, as many as the file says."""
    if option != "Starting index (port)":
        return index
    count = length_of(site, axis)
    if index.size != 1 or not 1 <= count <= _LONGEST_PICK:
        raise UnsupportedError(f"it selects {count} elements from {index.size} starting places")
    return site.call("add", index, site.constant(*map(float, range(count))))


def _picked(site: BlockContext, nodes: Nodes, axis: int, places: Signal) -> Nodes:
    """Elements whose places are signals: one of all, chosen by comparison."""
    if places.size * nodes.size > _MOST_COMPARISONS:
        raise UnsupportedError(f"{places.size} places that change among {nodes.size} elements are too many")
    first = 0.0 if site.text("IndexMode").startswith("Zero") else 1.0
    slices = [np.take(nodes, at, axis=axis) for at in range(nodes.shape[axis])]
    picked = []
    for place in places.flat:
        made = Signal(np.atleast_1d(slices[-1]))
        for at in reversed(range(len(slices) - 1)):
            limit = site.builder.const(at + 1.0 + first)
            here = scalar(site.builder.call("lt", place, limit))
            made = site.select(here, Signal(np.atleast_1d(slices[at])), made)
        picked.append(made.nodes)
    return np.stack([one.reshape(np.take(nodes, 0, axis=axis).shape) for one in picked], axis=axis)


@block("ManualSwitch", CurrentSetting="1", sw="1")
def manual_switch(site: BlockContext) -> SignalOrBus:
    """The input that the switch was left at."""
    key = "CurrentSetting" if site.atom.block.value("CurrentSetting") is not None else "sw"
    upper = site.number(key) != 0
    return site.wired(0 if upper else 1)


@block("Switch", Criteria="u2 >= Threshold", Threshold="0", SampleTime="-1")
def switch(site: BlockContext) -> SignalOrBus:
    """The first input where the second meets the criterion, else the third."""
    criterion = site.chosen("Criteria", "u2 >= Threshold", "u2 > Threshold", "u2 ~= 0")
    u = site.input(1)
    if criterion == "u2 ~= 0":
        condition = site.call("ne", u, site.constant(0.0))
    else:
        condition = site.call("ge" if ">=" in criterion else "gt", u, site.parameter("Threshold"))
    return select_signal(site, condition, site.wired(0), site.wired(2))


def select_signal(site: BlockContext, condition: Signal, yes: SignalOrBus, no: SignalOrBus) -> SignalOrBus:
    """One of two signals or buses."""
    yes, no = (one.signal if isinstance(one, ExternalBus) else one for one in (yes, no))
    if isinstance(yes, Signal) and isinstance(no, Signal):
        return site.select(condition, yes, no)
    if isinstance(yes, Bus) and isinstance(no, Bus) and yes.members.keys() == no.members.keys():
        return Bus({name: select_signal(site, condition, yes.members[name], no.members[name]) for name in yes.members})
    raise UnsupportedError("it chooses between a bus and what is none, or between different buses")


@block("MultiPortSwitch", Inputs="3", DataPortOrder="One-based contiguous", DataPortIndices="{1,2,3}", SampleTime="-1",
       DataPortForDefault="Last data port", zeroidx="off")  # fmt: skip
def multiport_switch(site: BlockContext) -> SignalOrBus:
    """One of several inputs by the number at the first; the last one for any number that is none of theirs."""
    order = site.chosen("DataPortOrder", "One-based contiguous", "Zero-based contiguous", "Specify indices")
    index = site.input(0)
    index = Signal(truncate(site.builder, index.nodes), index.period)
    data = [site.wired(at) for at in range(1, site.count)]
    if len(data) == 1 and isinstance(data[0], Signal):  # a single data port: its elements are the choices
        data = list(data[0].elements)
    if not data:
        raise UnsupportedError("it has no data port")
    if order == "Specify indices":
        numbers = case_values(site, "DataPortIndices")
        if len(data) != len(numbers) + (site.text("DataPortForDefault") == "Additional data port"):
            raise UnsupportedError(f"it has {len(data)} data ports for {len(numbers)} indices")
    else:
        first = 0 if order.startswith("Zero") or site.on("zeroidx") else 1
        numbers = [[float(first + at)] for at in range(len(data))]
    made = data[-1]
    for at in reversed(range(len(data) - 1)):
        here = site.fold("or", [site.call("eq", index, site.constant(number)) for number in numbers[at]])
        made = select_signal(site, here, data[at], made)
    return made


@block("Inactive", needs=lambda site: ())
def inactive(site: BlockContext) -> SignalOrBus:
    """An output of a variant source or sink that is not active."""
    raise UnsupportedError("what it gives here belongs to a variant that is not active")


@block("DataStoreMemory", needs=lambda site: (), DataStoreName="A", InitialValue="0", Dimensions="-1")
def data_store_memory(site: BlockContext) -> SignalOrBus:
    """What the memory holds at the beginning of the step."""
    init = site.parameter("InitialValue")
    dimensions = [int(n) for n in site.numbers("Dimensions").ravel()]
    if init.size == 1 and min(dimensions, default=-1) > 0:
        init = Signal(fit_to_shape(init.nodes, tuple(dimensions)), init.period)
    return site.compiler.contents.stored(site.atom, init)


def _memory(site: BlockContext) -> BlockContext:
    if site.text("DataStoreElements", "") or site.on("EnableIndexing"):
        raise UnsupportedError("it takes elements of its data store")
    if site.atom.store is None:
        raise UnsupportedError(f"there is no memory for the data store {site.text('DataStoreName')}")
    return site.compiler.site(site.atom.store)


def _none(_: BlockContext) -> Iterable[int]:
    return ()


@block("DataStoreRead", needs=_none, DataStoreName="A", SampleTime="-1")
def data_store_read(site: BlockContext) -> SignalOrBus:
    """What the memory holds when the block runs: what the writers before it in the step have left."""
    memory = _memory(site)
    content = data_store_memory(memory)
    assert isinstance(content, Signal)
    return site.compiler.contents.written(content, site.compiler.stores.before(site.atom))


@block("DataStoreWrite", DataStoreName="A", SampleTime="-1")
def data_store_write(site: BlockContext) -> SignalOrBus:
    """The signal that is written."""
    _memory(site)
    return site.input()
