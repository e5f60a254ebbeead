"""Results of functions of small graphs, kept for the next call: fits of one model to other data repeat them."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from pickle import PicklingError
from typing import Any, ParamSpec, TypeVar, cast

from kennfeld.base.machine_code.fingerprint import content_of
from kennfeld.graph.node import Graph

SMALL, RECENT = 200, 32  # nodes of a graph, whose result takes as long as a step of a small fit; results that are kept

_Arguments = ParamSpec("_Arguments")
_Outcome = TypeVar("_Outcome")


def kept_for_small_graphs(work: Callable[_Arguments, _Outcome]) -> Callable[_Arguments, _Outcome]:
    """Keep the last results of a pure function whose first argument is a graph, and whose result nobody changes.

    Equal arguments are those that are equal bit for bit: 0.0 and -0.0 are one number, but not one constant.
    """
    kept: OrderedDict[bytes, _Outcome] = OrderedDict()  # the most recently used last
    lock = threading.Lock()

    @wraps(work)
    def look_up(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Outcome:
        key = _key(cast(Graph, arguments[0]), arguments, named)
        if key is None:
            return work(*arguments, **named)
        with lock:
            if key in kept:
                kept.move_to_end(key)
                return kept[key]
        outcome = work(*arguments, **named)
        with lock:
            kept[key] = outcome
            while len(kept) > RECENT:
                kept.popitem(last=False)
        return outcome

    return look_up


def _key(graph: Graph, *arguments: Any) -> bytes | None:
    # functions of the session and the weights of layers are more than their names
    if len(graph.nodes) > SMALL or any(node.op in ("external", "dense") for node in graph.nodes):
        return None
    try:
        return content_of(arguments)
    except (PicklingError, TypeError, AttributeError):
        return None
