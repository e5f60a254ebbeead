"""Hit Crossing and Merge blocks in a row, beside the statements of generated code."""

import numpy as np
import pytest

from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, imported, run

SIGNAL = np.array([0, 0, 1, 2, 1, 1, 1, 0, 1, 2, 1, 0, 0, 1, 0, 2, 0, 2, 2, 1, 2, 1, 0, 1, 1, 2], dtype=float)
EVENTS = {(-1, 0): 1, (-1, 1): 1, (0, 1): 1, (1, 0): -1, (1, -1): -1, (0, -1): -1}


def hits(column, offset, direction):
    """The output as generated code computes it: events of rt_ZCFcn, an output and a mode."""
    known = {"rising": (1,), "falling": (-1,), "either": (1, -1)}[direction]
    before, event_before, y, mode, outputs = None, 0, False, 0, []
    for u in column:
        sign = int(np.sign(u - offset))
        event = EVENTS.get((before, sign), 0)
        event = event if event in known else 0
        # leaving zero on the other side of an arrival that was an event is none
        event = 0 if before == 0 and event and event == event_before else event
        if mode == 0:
            rests = u == offset
            y, mode = (not y, 1) if event else ((rests if direction == "either" else y and rests), 0)
        else:
            y, mode = y and u == offset, 0
        before, event_before = sign, event
        outputs.append(float(y))
    return outputs


@pytest.mark.parametrize("direction", ["rising", "falling", "either"])
@pytest.mark.parametrize("offset", [1.0, 0.5, 0.0])
def test_a_hit_crossing_gives_the_outputs_of_generated_code(direction, offset, tmp_path):
    drawn = alone("HitCross", HitCrossingOffset=offset, HitCrossingDirection=direction)
    random = np.random.default_rng(5).integers(0, 3, 200).astype(float)
    column = np.concatenate([SIGNAL, random])
    outputs = run(imported(drawn, tmp_path), {"u1": column})
    expected = hits(column, offset, direction)
    assert 0 < sum(expected) < len(expected)
    np.testing.assert_array_equal(outputs["y1"], expected)


def test_a_hit_crossing_of_a_vector_treats_each_element_alone(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("Mux", "M", ports=(2, 1), Inputs="2")
    drawn.block("HitCross", "B", ports=(1, 1), HitCrossingOffset="[1 0.5]")
    drawn.between(["a", "b"], "M")
    drawn.line("M", "B")
    drawn.outport("y")
    drawn.line("B", "y")
    outputs = run(imported(drawn, tmp_path), {"a": SIGNAL, "b": SIGNAL[::-1].copy()})
    np.testing.assert_array_equal(outputs["y[1]"], hits(SIGNAL, 1.0, "either"))
    np.testing.assert_array_equal(outputs["y[2]"], hits(SIGNAL[::-1], 0.5, "either"))


def test_merges_in_a_row_pass_on_the_output_of_the_subsystem_that_ran_last(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    for at in range(1, 4):
        drawn.inport(f"on{at}")
    drawn.inport("u")
    drawn.block("Merge", "Inner", ports=(2, 1), Inputs="2")
    drawn.block("Merge", "Outer", ports=(2, 1), Inputs="2", InitialOutput="-7")
    for at, end in enumerate(("Inner:1", "Inner:2", "Outer:2"), 1):
        inner = drawn.subsystem(f"S{at}")
        inner.block("EnablePort", "E")
        inner.inport("u")
        inner.block("Gain", "K", Gain=str(10**at))
        inner.outport("y")
        inner.chain("u", "K", "y")
        drawn.line(f"on{at}", f"S{at}#enable")
        drawn.line(f"S{at}", end)
    drawn.line("u", "S1:1", "S2:1", "S3:1")
    drawn.line("Inner", "Outer:1")
    drawn.outport("y")
    drawn.line("Outer", "y")
    on = np.array([[0, 0, 1, 0, 0, 0, 1, 0], [0, 0, 0, 1, 0, 0, 0, 0], [0, 1, 0, 0, 0, 1, 0, 0]], dtype=float)
    u = np.arange(1.0, 9.0)
    outputs = run(imported(drawn, tmp_path), {"on1": on[0], "on2": on[1], "on3": on[2], "u": u})
    # at most one of them runs in a step; before the first one, the initial value of the last Merge
    last, expected = -7.0, []
    for at, x in enumerate(u):
        last = next((10.0**which * x for which in (1, 2, 3) if on[which - 1, at]), last)
        expected.append(last)
    np.testing.assert_array_equal(outputs["y"], expected)
