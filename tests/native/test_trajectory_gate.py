"""No more trajectories run at once than a function can hold."""

import ctypes
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native.simulator import Simulator
from kennfeld.native.trajectory_gate import TrajectoryGate
from tests.native.external_functions import POINTERS, Callback


class Single(Callback):
    """A function that holds one trajectory."""

    trajectories = 1


class Pair(Callback):
    """A function that holds two trajectories."""

    trajectories = 2


@ctypes.CFUNCTYPE(None, *POINTERS)
def _identity(x, y, slopes):
    y[0] = x[0]


def single(*_):
    return Single(_identity)


def pair(*_):
    return Pair(_identity)


SINGLE = ExternalFunction("single", 1, 1, "tests.native.test_trajectory_gate:single", sequential=True)
PAIR = ExternalFunction("pair", 1, 1, "tests.native.test_trajectory_gate:pair", sequential=True)


def nodes_of(*functions):
    builder = GraphBuilder()
    for number, function in enumerate(functions):
        builder.external(function, builder.input(f"u{number}"))
    return builder.nodes


def most_at_once(gates):
    inside, most, lock = 0, 0, threading.Lock()

    def pass_through(gate):
        nonlocal inside, most
        with gate.room():
            with lock:
                inside += 1
                most = max(most, inside)
            time.sleep(0.01)
            with lock:
                inside -= 1

    with ThreadPoolExecutor(len(gates)) as pool:
        list(pool.map(pass_through, gates))
    return most


def test_trajectories_wait_for_room():
    assert most_at_once([TrajectoryGate(nodes_of(SINGLE)) for _ in range(4)]) == 1
    assert most_at_once([TrajectoryGate(nodes_of(PAIR)) for _ in range(4)]) == 2


def test_several_calls_of_a_function_take_as_much_room():
    assert most_at_once([TrajectoryGate(nodes_of(PAIR, PAIR)) for _ in range(4)]) == 1


def test_graphs_that_call_the_same_functions_do_not_wait_for_each_other_in_turn():
    gates = [TrajectoryGate(nodes_of(*order)) for order in [(SINGLE, PAIR), (PAIR, SINGLE)] * 4]
    assert most_at_once(gates) == 1


def test_graphs_without_memory_do_not_wait():
    assert most_at_once([TrajectoryGate([])] * 4) > 1


def test_a_simulation_takes_room_and_gives_it_back():
    builder = GraphBuilder()
    [y] = builder.external(SINGLE, builder.input("u"))
    lowered = lower_lookups(builder.finish({"y": y}), ParameterSet())
    simulator = Simulator(lowered, [lowered.graph.names["y"]], ParameterSet())
    u = np.arange(5.0)
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda _: simulator.over({"u": u}, 5, ParameterSet(), [0, 2])[0], range(8)))
    assert all(np.array_equal(result, u) for result in results)
    assert simulator.last({"u": u}, 5, ParameterSet())[0] == 4.0
