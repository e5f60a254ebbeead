"""Named memories that blocks read and write without lines."""

from collections.abc import Iterable

from kennfeld.models.simulink.expressions.signals import Signal, Wired
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site, resized


@block("DataStoreMemory", needs=lambda site: (), DataStoreName="A", InitialValue="0", Dimensions="-1")
def data_store_memory(site: Site) -> Wired:
    """What the memory holds at the beginning of the step."""
    init = site.parameter("InitialValue")
    dimensions = [int(n) for n in site.numbers("Dimensions").ravel()]
    if init.size == 1 and min(dimensions, default=-1) > 0:
        init = Signal(resized(init.nodes, tuple(dimensions)), init.period)
    return site.weaver.contents.stored(site.atom, init)


def _memory(site: Site) -> Site:
    if site.text("DataStoreElements", "") or site.on("EnableIndexing"):
        raise UnsupportedError("it takes elements of its data store")
    if site.atom.store is None:
        raise UnsupportedError(f"there is no memory for the data store {site.text('DataStoreName')}")
    return site.weaver.site(site.atom.store)


def _none(_: Site) -> Iterable[int]:
    return ()


@block("DataStoreRead", needs=_none, DataStoreName="A", SampleTime="-1")
def data_store_read(site: Site) -> Wired:
    """What the memory holds when the block runs: what the writers before it in the step have left."""
    memory = _memory(site)
    content = data_store_memory(memory)
    assert isinstance(content, Signal)
    return site.weaver.contents.written(content, site.weaver.stores.before(site.atom))


@block("DataStoreWrite", DataStoreName="A", SampleTime="-1")
def data_store_write(site: Site) -> Wired:
    """The signal that is written."""
    _memory(site)
    return site.input()
