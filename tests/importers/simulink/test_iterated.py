"""Subsystems that run several times in a step: For Iterator, While Iterator and For Each."""

import re

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.flattening import hierarchy
from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

U = np.random.default_rng(11).normal(size=15)


def loop(content, kind="ForIterator", inputs=1, **settings):
    """A model around a subsystem that iterates; `content` fills it."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    inner = drawn.subsystem("Loop")
    inner.block(kind, "Iterator", **settings)
    content(inner)
    names = [block.name for block in inner.blocks if block.kind == "Inport"]
    drawn.between(names[:inputs], "Loop", [block.name for block in inner.blocks if block.kind == "Outport"])
    return drawn


def summing(inner, start="start"):
    """Adds gain * u + number of the pass to what the pass before has left."""
    inner.inport("u")
    inner.block("Gain", "K", Gain="gain")
    inner.block("Sum", "S", ports=(3, 1), Inputs="+++")
    inner.block("UnitDelay", "Z", SampleTime="-1", InitialCondition=start)
    inner.outport("y")
    inner.line("u", "K")
    inner.line("K", "S:1")
    inner.line("Z", "S:2")
    inner.line("Iterator", "S:3")
    inner.line("S", "Z", "y")


GIVEN = {"gain": 0.5, "start": 2.0}


def summed(passes, reset, base=1, u=U):
    x, sums = 2.0, []
    for one in u:
        x = 2.0 if reset else x
        for number in range(passes):
            x += 0.5 * one + number + base
        sums.append(x)
    return sums


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
@pytest.mark.parametrize("reset", [False, True])
def test_a_for_iterator_hands_its_memory_from_pass_to_pass(layout, reset, tmp_path):
    drawn = loop(summing, IterationLimit="4", ResetStates="reset" if reset else "held")
    model = imported(drawn, tmp_path, layout, parameters=[GIVEN])
    np.testing.assert_allclose(run(model, {"u": U})["y"], summed(4, reset), atol=1e-12)
    assert len(model.graph.states) == (0 if reset else 1)
    for name in GIVEN:
        exact, differences = slopes(model, {"u": U}, name, "y")
        np.testing.assert_allclose(exact, differences, atol=1e-6)


def test_the_iteration_may_be_counted_from_0_and_by_a_variable(tmp_path):
    drawn = loop(summing, IterationLimit="n+1", IndexMode="Zero-based")
    output = run(imported(drawn, tmp_path, parameters=[{**GIVEN, "n": 2}]), {"u": U})["y"]
    np.testing.assert_allclose(output, summed(3, False, base=0), atol=1e-12)


@pytest.mark.parametrize("feed", ["Constant", "Gain"])
def test_the_limit_may_come_from_a_constant_outside(feed, tmp_path):
    def content(inner):
        summing(inner)
        inner.inport("limit")
        inner.line("limit", "Iterator")

    drawn = loop(content, IterationSource="external", ports=(1, 1))
    drawn.block("Constant", "N", Value="n")
    drawn.block("Gain", "G", Gain="1")
    drawn.chain(*(["N"] if feed == "Constant" else ["N", "G"]), "Loop:2")
    path = drawn.write(tmp_path)
    result = import_simulink(path, parameters=[{**GIVEN, "n": 5}])
    if feed == "Constant":
        np.testing.assert_allclose(run(result.model, {"u": U})["y"], summed(5, False), atol=1e-12)
    else:
        with pytest.raises(InputError, match="its iteration count is not constant"):
            imported(drawn, tmp_path, parameters=[{**GIVEN, "n": 5}])


def test_the_report_counts_each_block_once(tmp_path):
    report = import_simulink(loop(summing, IterationLimit="50").write(tmp_path), parameters=[GIVEN]).report
    assert (report.supported, report.total) == (6, 6)


def test_a_literal_in_a_loop_is_promoted_once(tmp_path):
    def content(inner):
        summing(inner, "2")
        inner.blocks[2].parameters["Gain"] = "0.5"

    model = imported(loop(content, IterationLimit="4"), tmp_path, promote=["Loop/K:Gain"])
    assert set(model.graph.parameters) == {"Loop/K:Gain"}
    np.testing.assert_allclose(run(model, {"u": U})["y"], summed(4, False), atol=1e-12)


def search(inner):
    """Halves the way to u until it is near, Newton's way of a square root."""
    inner.inport("u")
    inner.block("Memory", "M", InheritSampleTime="on", InitialCondition="1")
    inner.block("Fcn", "Step", Expr="0.5*(u(1) + u(2)/u(1))", ports=(1, 1))
    inner.block("Mux", "Both", ports=(2, 1), Inputs="2")
    inner.block("Fcn", "Far", Expr="abs(u(1)*u(1) - u(2)) > 1e-6", ports=(1, 1))
    inner.block("Mux", "Check", ports=(2, 1), Inputs="2")
    inner.outport("root")
    inner.outport("passes")
    inner.line("M", "Both:1")
    inner.line("u", "Both:2", "Check:2")
    inner.line("Both", "Step")
    inner.line("Step", "M", "Check:1", "root")
    inner.line("Check", "Far")
    inner.line("Far", "Iterator:1")
    inner.line("Iterator", "passes")


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
def test_a_do_while_iterator_ends_when_its_condition_fails(layout, tmp_path):
    drawn = loop(search, "WhileIterator", WhileBlockType="do-while", MaxIters="20", ShowIterationPort="on",
                 ResetStates="reset", ports=(1, 1))  # fmt: skip
    u = np.array([4.0, 1.0, 100.0, 2.0, 9.0])
    outputs = run(imported(drawn, tmp_path, layout), {"u": u})
    for k, one in enumerate(u):
        x, count = 1.0, 0
        while count < 20:
            x, count = 0.5 * (x + one / x), count + 1
            if abs(x * x - one) <= 1e-6:
                break
        assert outputs["root"][k] == pytest.approx(x, rel=1e-14)
        assert outputs["passes"][k] == count


def counting(inner):
    """Counts while what it has counted is below u; begins only where the second inport lets it."""
    inner.inport("u")
    inner.inport("go")
    inner.block("Sum", "S", ports=(2, 1))
    inner.block("Constant", "One", Value="step")
    inner.block("UnitDelay", "Z", SampleTime="-1")
    inner.block("RelationalOperator", "Below", ports=(2, 1), Operator="<")
    inner.outport("y")
    inner.line("One", "S:1")
    inner.line("Z", "S:2")
    inner.line("S", "Z", "Below:1", "y")
    inner.line("u", "Below:2")
    inner.line("Below", "Iterator:1")
    inner.line("go", "Iterator:2")


@pytest.mark.parametrize("reset", [False, True])
def test_a_while_iterator_needs_a_condition_to_begin_and_holds_its_output(reset, tmp_path):
    drawn = loop(counting, "WhileIterator", 2, MaxIters="6", ResetStates="reset" if reset else "held", ports=(2, 0))
    u = np.array([3.0, 5.5, 50.0, 0.0, -2.0, 7.0, 2.2, 100.0])
    go = np.array([0.0, 1, 1, 1, 0, 1, 0, 1])
    model = imported(drawn, tmp_path, parameters=[{"step": 0.9}])
    output = run(model, {"u": u, "go": go})["y"]
    z, y = 0.0, 0.0
    for k, limit in enumerate(u):
        z = 0.0 if reset else z
        on, count = bool(go[k]), 0
        while on and count < 6:
            z += 0.9
            y, count, on = z, count + 1, z < limit
        assert output[k] == pytest.approx(y, abs=1e-12), k
    exact, differences = slopes(model, {"u": u, "go": go}, "step", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-7)


def test_the_error_for_an_endless_loop_explains_how_to_bound_it(tmp_path):
    drawn = loop(search, "WhileIterator", WhileBlockType="do-while", MaxIters="-1", ShowIterationPort="on",
                 ResetStates="reset", ports=(1, 1))  # fmt: skip
    with pytest.raises(InputError, match=r'iterations is unbounded; set "Loop/Iterator:MaxIters"'):
        imported(drawn, tmp_path)
    outputs = run(imported(drawn, tmp_path, parameters=[{"Loop/Iterator:MaxIters": 30}]), {"u": [16.0]})
    assert outputs["root"][0] == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("kind", "settings", "reason"),
    [
        ("ForIterator", {"IterationLimit": "1001"}, "1001 iterations in a step; it must be between 1 and 1000"),
        ("ForIterator", {"IterationLimit": "0"}, "0 iterations"),
        ("ForIterator", {"IterationLimit": "2.5"}, "must be an integer"),
        ("ForIterator", {"ExternalIncrement": "on"}, "sets its iteration variable externally"),
        ("WhileIterator", {"WhileBlockType": "until"}, "WhileBlockType 'until'"),
        ("ForEach", {"NeedActiveIterationSignal": "on"}, "NeedActiveIterationSignal"),
    ],
)
def test_loops_that_cannot_be_unrolled_are_reported(kind, settings, reason, tmp_path):
    with pytest.raises(InputError, match=f"Loop: .*{reason}"):
        imported(loop(summing, kind, **settings), tmp_path, parameters=[GIVEN])


def test_a_limit_without_a_value_is_reported_by_name(tmp_path):
    with pytest.raises(InputError, match="variable lost: undefined; used by Loop"):
        imported(loop(summing, IterationLimit="lost"), tmp_path, parameters=[GIVEN])


@pytest.mark.slow
def test_loops_within_loops_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(hierarchy, "_MAX_BLOCKS", 5000)
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    here = drawn
    for _ in range(4):
        here = here.subsystem("Loop")
        here.block("ForIterator", "Iterator", IterationLimit="1000")
    here.block("Constant", "C")
    here.outport("y")
    here.line("C", "y")
    drawn.outport("y")
    drawn.line("Loop", "y")
    with pytest.raises(InputError, match="more than 5000 blocks"):
        imported(drawn, tmp_path)


def test_continuous_states_have_no_place_in_a_loop(tmp_path):
    def content(inner):
        inner.inport("u")
        inner.block("Integrator", "I", ports=(1, 1))
        inner.outport("y")
        inner.chain("u", "I", "y")

    with pytest.raises(InputError, match="I: it integrates over time in an iterated subsystem"):
        imported(loop(content), tmp_path)


@pytest.mark.parametrize("inner_reset", [False, True])
@pytest.mark.parametrize("outer_reset", [False, True])
def test_loops_within_loops_hand_on_their_memory(inner_reset, outer_reset, tmp_path):
    def content(inner):
        inner.inport("u")
        nested = inner.subsystem("Within")
        nested.block("ForIterator", "Iterator", IterationLimit="3", ResetStates="reset" if inner_reset else "held")
        summing(nested)
        inner.block("UnitDelay", "O", SampleTime="-1")
        inner.block("Sum", "T", ports=(2, 1))
        inner.outport("y")
        inner.line("u", "Within")
        inner.line("Within", "T:1")
        inner.line("O", "T:2")
        inner.line("T", "O", "y")

    drawn = loop(content, IterationLimit="2", ResetStates="reset" if outer_reset else "held")
    output = run(imported(drawn, tmp_path, parameters=[GIVEN]), {"u": U})["y"]
    x, o = 2.0, 0.0
    for k, u in enumerate(U):
        x, o = (2.0, 0.0) if outer_reset else (x, o)
        for _ in range(2):
            x = 2.0 if inner_reset else x
            for number in (1, 2, 3):
                x += 0.5 * u + number
            o += x
        assert output[k] == pytest.approx(o, abs=1e-11), k


def test_a_conditional_subsystem_in_a_loop_holds_its_output_from_pass_to_pass(tmp_path):
    def content(inner):
        inner.inport("u")
        inner.block("Math", "Mod", ports=(2, 1), Operator="mod")
        inner.block("Constant", "Two", Value="2")
        inner.line("Iterator", "Mod:1")
        inner.line("Two", "Mod:2")
        odd = inner.subsystem("Odd")
        odd.block("EnablePort", "E")
        odd.inport("n")
        odd.inport("u")
        odd.block("UnitDelay", "Z", SampleTime="-1", InitialCondition="1")
        odd.block("Sum", "S", ports=(3, 1), Inputs="+++")
        odd.outport("y")
        odd.line("n", "S:1")
        odd.line("u", "S:2")
        odd.line("Z", "S:3")
        odd.line("S", "Z", "y")
        inner.line("Mod", "Odd#enable")
        inner.line("Iterator", "Odd:1")
        inner.line("u", "Odd:2")
        inner.outport("y")
        inner.line("Odd", "y")

    output = run(imported(loop(content, IterationLimit="4"), tmp_path), {"u": U})["y"]
    z = 1.0
    for k, u in enumerate(U):
        for number in (1, 3):
            z += number + u
        assert output[k] == pytest.approx(z, abs=1e-12), k


def test_a_loop_that_is_enabled_holds_all_while_it_is_not(tmp_path):
    def content(inner):
        summing(inner)
        inner.block("EnablePort", "E", StatesWhenEnabling="reset")

    drawn = loop(content, IterationLimit="3")
    drawn.inport("c")
    drawn.line("c", "Loop#enable")
    c = np.array([0, 1, 1, 0, 0, 1, 1, 1, 0, 1, 1, 1, 1, 0, 1], dtype=float)
    output = run(imported(drawn, tmp_path, parameters=[GIVEN]), {"u": U, "c": c})["y"]
    x, y, was = 2.0, 0.0, 0.0
    for k, u in enumerate(U):
        if c[k]:
            x = x if was else 2.0
            for number in (1, 2, 3):
                x += 0.5 * u + number
            y = x
        was = c[k]
        assert output[k] == pytest.approx(y, abs=1e-12), k


def test_a_data_store_is_written_and_read_from_pass_to_pass(tmp_path):
    def content(inner):
        inner.inport("u")
        inner.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="m", Priority="1")
        inner.block("Sum", "S", ports=(3, 1), Inputs="+++")
        inner.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="m", Priority="2")
        inner.outport("y")
        inner.line("R", "S:1")
        inner.line("u", "S:2")
        inner.line("Iterator", "S:3")
        inner.line("S", "W", "y")

    drawn = loop(content, IterationLimit="3")
    drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="m", InitialValue="1")
    output = run(imported(drawn, tmp_path), {"u": U})["y"]
    np.testing.assert_allclose(output, 1 + np.cumsum(3 * U + 6), atol=1e-12)


def test_a_loop_without_its_surroundings_is_refused(tmp_path):
    drawn = loop(summing)
    with pytest.raises(InputError, match="Loop: it is in an iterated subsystem; import the enclosing system"):
        imported(drawn, tmp_path, subsystem="Loop")


# for each


def lags(inner):
    """First-order lags: x = x + k (u - x), with a common k."""
    inner.inport("u")
    inner.inport("k")
    inner.block("Sum", "D", ports=(2, 1), Inputs="+-")
    inner.block("Product", "P", ports=(2, 1))
    inner.block("Sum", "S", ports=(2, 1))
    inner.block("UnitDelay", "Z", SampleTime="-1", InitialCondition="1")
    inner.outport("y")
    inner.line("u", "D:1")
    inner.line("D", "P:1")
    inner.line("k", "P:2")
    inner.line("P", "S:1")
    inner.line("Z", "D:2", "S:2")
    inner.line("S", "Z", "y")


def each(content=lags, mask=None, lists=None, **settings):
    """Three channels side by side into a For Each subsystem, and a constant."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("Mux", "M", ports=(3, 1), Inputs="3")
    for at in (1, 2, 3):
        drawn.inport(f"u{at}")
        drawn.line(f"u{at}", f"M:{at}")
    drawn.block("Constant", "C", Value="k")
    inner = drawn.subsystem("Each", mask=mask)
    inner.block("ForEach", "For Each", lists={"InputPartition": ["on", "off"], **(lists or {})}, **settings)
    content(inner)
    drawn.line("M", "Each:1")
    drawn.line("C", "Each:2")
    drawn.outport("y")
    drawn.line("Each", "y")
    return drawn


WAVES = {f"u{at}": np.random.default_rng(at).normal(size=15) for at in (1, 2, 3)}


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json"]))
def test_each_element_has_memories_of_its_own(layout, tmp_path):
    lists = {"InputPartitionDimension": ["1", "1"], "InputPartitionWidth": ["1", "1"]}
    model = imported(each(lists=lists), tmp_path, layout, parameters=[{"k": 0.3}])
    outputs = run(model, WAVES)
    x = np.ones(3)
    for k in range(15):
        x = x + 0.3 * (np.array([WAVES[f"u{at}"][k] for at in (1, 2, 3)]) - x)
        assert [outputs[f"y[{at}]"][k] for at in (1, 2, 3)] == pytest.approx(x)
    assert len(model.graph.states) == 3
    exact, differences = slopes(model, WAVES, "k", "y[2]")
    np.testing.assert_allclose(exact, differences, atol=1e-7)


def test_the_parameters_of_a_mask_can_be_parted_as_well(tmp_path):
    def content(inner):
        inner.inport("u")
        inner.inport("k")
        inner.block("Gain", "G", Gain="g*h")
        inner.block("Sum", "S", ports=(3, 1), Inputs="+++")
        inner.outport("y")
        inner.line("u", "G")
        inner.line("G", "S:1")
        inner.line("k", "S:2")
        inner.line("For Each", "S:3")
        inner.line("S", "y")

    drawn = each(content, Mask({"g": "gains", "h": "2"}), {"SubsysMaskParameterPartition": ["on", "off"]},
                 ShowIterationIndex="on", IndexMode="One-based")  # fmt: skip
    model = imported(drawn, tmp_path, parameters=[{"k": 0.5, "gains": [1.0, 10.0, 100.0]}])
    outputs = run(model, WAVES)
    for at, gain in ((1, 2.0), (2, 20.0), (3, 200.0)):
        np.testing.assert_allclose(outputs[f"y[{at}]"], gain * WAVES[f"u{at}"] + 0.5 + at)
    exact, differences = slopes(model, WAVES, "gains", "y[3]")
    np.testing.assert_allclose(exact, differences, atol=1e-6)


def matrices(width, dimension, concatenation, size):
    """A constant matrix that is parted, each part doubled."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("Constant", "A", Value="A", VectorParams1D="off")
    inner = drawn.subsystem("Each")
    lists = {"InputPartitionWidth": [width], "InputPartitionDimension": [dimension],
             "OutputConcatenationDimension": [concatenation]}  # fmt: skip
    inner.block("ForEach", "F", lists=lists)
    inner.inport("u")
    inner.block("Gain", "G", Gain="2")
    inner.outport("y")
    inner.chain("u", "G", "y")
    drawn.outport("y")
    drawn.chain("A", "Each", "y")
    return drawn


@pytest.mark.parametrize(
    ("width", "dimension", "concatenation"), [("1", "1", "1"), ("2", "1", "2"), ("1", "2", "1"), ("3", "2", "2")]
)
def test_matrices_are_parted_and_put_together_along_their_dimensions(width, dimension, concatenation, tmp_path):
    A = np.arange(24.0).reshape(4, 6)
    model = imported(matrices(width, dimension, concatenation, 4), tmp_path, parameters=[{"A": A}])
    outputs = run(model, samples=1)
    axis = int(dimension) - 1
    parts = np.split(2 * A, A.shape[axis] // int(width), axis=axis)
    expected = np.concatenate(parts, axis=int(concatenation) - 1).ravel(order="F")
    assert [outputs[name][0] for name in model.graph.outputs] == expected.tolist()


@pytest.mark.parametrize(
    ("lists", "settings", "reason"),
    [
        ({"InputPartitionWidth": ["2", "1"]}, {}, "its 3 elements cannot be partitioned into parts of 2"),
        ({"InputPartitionDimension": ["2", "1"]}, {}, "partitioned along dimension 2"),
        ({"InputPartitionOffset": ["1", "0"]}, {}, "its partitions overlap"),
        ({"OutputConcatenation": ["off"]}, {}, "its elements are not concatenated"),
        ({"InputPartition": ["on", "on"]}, {}, "its inputs require 3 and 1 iterations"),
        ({}, {"SpecifiedNumIters": "4"}, "it has 3 elements, fewer than the iterations"),
        ({}, {"StateHandling": "Common"}, "share their states"),
    ],
)
def test_impossible_parts_are_reported(lists, settings, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(each(lists=lists, **settings), tmp_path, parameters=[{"k": 0.3}])


def test_the_number_of_elements_can_be_stated(tmp_path):
    model = imported(each(SpecifiedNumIters="2"), tmp_path, parameters=[{"k": 0.3}])
    assert model.graph.outputs == ("y[1]", "y[2]")


def test_different_numbers_of_inputs_and_parameters_are_reported(tmp_path):
    mask = Mask({"g": "[1 2]"})
    drawn = each(mask=mask, lists={"SubsysMaskParameterPartition": ["on"]})
    message = "model.slx Each/For Each: its inputs and its parameters require different iteration counts."
    with pytest.raises(InputError, match=f"^{re.escape(message)} Bind it: [^\n]*$"):
        imported(drawn, tmp_path, parameters=[{"k": 0.3}])
