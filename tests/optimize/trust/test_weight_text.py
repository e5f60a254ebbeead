"""Weights of networks in words: one sentence for all layers, and locks that leave nothing undetermined."""

from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.dense_layer import DenseLayer
from kennfeld.models.model import Model, merge_start_values
from kennfeld.optimize import Problem, run
from kennfeld.optimize.trust.table_changes import WeakDirection
from kennfeld.optimize.trust.weight_text import describe_weights

RANDOM = np.random.default_rng(0)
U, V = RANDOM.uniform(-1, 1, (2, 300))
PLAIN = kf.Options(continuation="off")
BLOCKS = ParameterSet([Block(name, np.ones((3, 2))) for name in "ABCD"])


def network_problem():
    """A network whose first layer can grow while the second one shrinks."""
    b = GraphBuilder()
    hidden = b.dense(DenseLayer("first", 2, 3, "relu"), b.input("u"), b.input("v"))
    (y,) = b.dense(DenseLayer("last", 3, 1), *hidden)
    graph = b.finish({"y": y}, {}, ("y",))
    start = ParameterSet(
        [Block("first", RANDOM.standard_normal((3, 3))), Block("last", RANDOM.standard_normal((4, 1)))]
    )
    data = kf.Dataset.of("bench", {"u": U, "v": V, "t": np.abs(U) + V + 0.01 * RANDOM.standard_normal(300)})
    model = Model(graph=graph, name="network", declared=graph.parameters)
    return Problem(model, (data,), start, (kf.Criterion("y", "t"),))


def described(deviation, *, exact=False, alone=True):
    weak = WeakDirection(np.ones(1), np.ones(1), 0.0 if exact else 1e-4, 0.0 if exact else 1e-4, 1.0, ())
    parts = {name: np.full((3, 2), 0.1) for name in deviation}
    spread = {name: np.broadcast_to(np.asarray(each, dtype=float), (3, 2)) for name, each in deviation.items()}
    return describe_weights(weak, parts, spread, BLOCKS, alone=alone)


def test_uncertain_weights_are_counted_by_layer():
    (direction,) = described({"A": [[0.1, np.inf], [0.1, 0.1], [0.1, 0.1]], "B": np.nan})
    assert direction.sentence == (
        "The data hardly determine all 6 weights of B and 1 of 6 weights of A: "
        "their standard deviation exceeds the root mean square of their layer."
    )
    assert direction.remedy == "Record more samples, fit fewer layers, or use a network with fewer neurons."


def test_many_layers_are_not_listed():
    (direction,) = described(dict.fromkeys("ABCD", 9.0))
    assert "all 6 weights of A, all 6 weights of B, all 6 weights of C and 6 of other layers" in direction.sentence


@pytest.mark.parametrize(("exact", "alone", "count"), [(True, True, 1), (True, False, 0), (False, True, 0)])
def test_certain_weights_have_a_sentence_only_if_a_change_has_no_effect(exact, alone, count):
    assert len(described({"A": 0.1}, exact=exact, alone=alone)) == count


def test_locking_the_named_weights_determines_all_weights():
    problem = network_problem()
    result = run(problem, PLAIN)
    space = result.trust.null_space
    assert space.dimension >= 3
    assert not space.remedy.pins
    assert "smoothness" not in str(result.trust)
    assert "lock " in space.advice
    assert space.advice.endswith(", or fit fewer layers.")
    locked = [
        result.parameters[name].changed(locked=result.parameters[name].locked | where)
        for name, where in space.remedy.locks.items()
    ]
    settled = run(replace(problem, parameters=result.parameters.with_parameters(*locked)), PLAIN)
    assert settled.trust.null_space.dimension == 0


def test_a_block_of_a_file_takes_the_shape_of_the_layer():
    own = ParameterSet([Block("last", np.zeros((4, 1)), locked=True)])
    merged = merge_start_values(own, ParameterSet([Block("last", np.arange(4.0))]))
    assert merged["last"].values.tolist() == [[0.0], [1.0], [2.0], [3.0]]
    assert merged["last"].locked.all()
    assert merge_start_values(own, ParameterSet([Block("last", np.zeros((2, 2)))]))["last"].values.shape == (2, 2)
