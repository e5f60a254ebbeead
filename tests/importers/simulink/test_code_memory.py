"""Persistent variables of MATLAB Functions, over several steps; against the same written in Python."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_code import U, V, body, check_slopes, function, outputs
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import imported, run


def over(step, u=U, v=V):
    """Return the results of a rule with a memory of its own, step by step."""
    memory = {}
    return np.array([float(step(memory, a, b)) for a, b in zip(u, v, strict=True)])


def total(s, u, v):
    s["x"] = s.get("x", 3.0) + u
    s["n"] = s.get("n", 0) + 1
    return s["x"] / s["n"]


def first_input(s, u, v):
    x = s.get("x", u)
    y = x
    if v > 0:
        x = 0.5 * x + u
    s["x"] = x
    return y


def from_first(s, u, v):
    s["x"] = s.get("x", u) + u
    s["n"] = s.get("n", 0) + 1
    return s["x"] / s["n"]


def ring(s, u, v):
    buffer, at = s.get("b", np.zeros(4)), s.get("i", 1)
    buffer = buffer.copy()
    buffer[at - 1] = u
    s["b"], s["i"] = buffer, at % 4 + 1
    return buffer.mean()


def shifted(s, u, v):
    s["b"] = np.append(s.get("b", np.zeros(3))[1:], u)
    return s["b"] @ [1, 2, 3]


def reset(s, u, v):
    if "x" not in s or v > 1:
        s["x"] = 1.0
    s["x"] += u
    return s["x"]


def after_else(s, u, v):
    if "x" not in s:
        s["x"] = 10.0
    else:
        s["x"] = s["x"] * 0.5 + u
    return s["x"]


def other_start(s, u, v):
    y = 0.0
    if "x" not in s:
        s["x"], y = 2.0, 100.0
    s["x"] += u
    return y + s["x"]


def lazily(s, u, v):
    if v > 0 and "x" not in s:
        s["x"] = u
    return s.get("x", -1.0)


def states(s, u, v):
    mode = s.get("mode", 1)
    if mode == 1 and u > 0.5:
        mode = 2
    elif mode == 2 and v < 0:
        mode = 3
    elif mode == 3:
        mode = 1
    s["mode"] = mode
    return mode


CASES = [
    ("persistent x n\nif isempty(x)\n x = 3; n = 0;\nend\nx = x + u; n = n + 1;\ny = x/n;", total, 2),
    ("persistent x\npersistent n\nif isempty(x) || isempty(n)\n x = 3;\n n = 0;\nend\nx = x + u; n = n + 1;\ny = x/n;",
     total, 2),
    ("persistent x n\nif isempty(x), x = 3; end\nif isempty(n), n = 0; end\nx = x + u; n = n + 1;\ny = x/n;", total, 2),
    ("persistent x n\nif isempty(x)\n x = u; n = 0;\nend\nx = x + u; n = n + 1;\ny = x/n;", from_first, 3),
    ("persistent x\nif isempty(x)\n x = u;\nend\ny = x;\nif v > 0\n x = 0.5*x + u;\nend", first_input, 2),
    ("persistent b i\nif isempty(b)\n b = zeros(1, 4); i = 1;\nend\nb(i) = u;\ni = mod(i, 4) + 1;\ny = mean(b);",
     ring, 5),
    ("persistent b\nif isempty(b)\n b = zeros(3, 1);\nend\nb = [b(2:end); u];\ny = [1 2 3]*b;", shifted, 2),
    ("persistent x\nif isempty(x) || v > 1\n x = 1;\nend\nx = x + u;\ny = x;", reset, 1),
    ("persistent x\nif isempty(x)\n x = 10;\nelse\n x = x*0.5 + u;\nend\ny = x;", after_else, 2),
    ("persistent x\ny = 0;\nif isempty(x)\n x = 2; y = 100;\nend\nx = x + u;\ny = y + x;", other_start, 2),
    ("persistent x\nif v > 0 && isempty(x)\n x = u;\nend\ny = -1;\nif ~isempty(x)\n y = x;\nend", lazily, 2),
    ("persistent mode\nif isempty(mode), mode = 1; end\nswitch mode\n case 1\n  if u > 0.5, mode = 2; end\n case 2\n"
     "  if v < 0, mode = 3; end\n otherwise\n  mode = 1;\nend\ny = mode;", states, 1),
    ("persistent s\nif isempty(s)\n s = struct('x', 3, 'n', 0);\nend\ns.x = s.x + u; s.n = s.n + 1;\ny = s.x/s.n;",
     total, 2),
    ("persistent s\nif isempty(s)\n s.x = 3;\n s.n = 0;\nend\ns.x = s.x + u; s.n = s.n + 1;\ny = s.x/s.n;", total, 2),
]  # fmt: skip


@pytest.mark.parametrize(("code", "step", "count"), CASES)
def test_persistent_variables_are_states(code, step, count, tmp_path):
    model = imported(function(body(code)), tmp_path)
    np.testing.assert_allclose(run(model, {"u": U, "v": V})["y1"], over(step), rtol=1e-12)
    assert len(model.graph.states) == count


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_memory_in_every_layout(layout, tmp_path):
    model = imported(function(body(CASES[0][0])), tmp_path, layout)
    np.testing.assert_allclose(run(model, {"u": U, "v": V})["y1"], over(total), rtol=1e-12)


def test_functions_keep_variables_of_their_own_and_all_calls_share_them(tmp_path):
    code = body(
        "persistent x\nif isempty(x), x = 0; end\nx = x + 1;\ny = x + count(u);\nif v > 0\n y = y + count(u);\nend"
    )
    code += "function n = count(a)\npersistent x\nif isempty(x)\n x = 100;\nend\nx = x + a;\nn = x;\nend\n"

    def step(s, u, v):
        s["a"] = s.get("a", 0) + 1
        s["b"] = s.get("b", 100) + u
        y = s["a"] + s["b"]
        if v > 0:
            s["b"] += u
            y += s["b"]
        return y

    np.testing.assert_allclose(outputs(code, tmp_path), over(step), rtol=1e-12)


@pytest.mark.parametrize(
    "code",
    [
        "persistent x\nif isempty(x)\n x = K;\nend\nx = 0.9*x + 0.1*u;\ny = x;",
        "persistent x\nif isempty(x)\n x = K*u;\nend\nx = 0.9*x + 0.1*u*K;\ny = x;",
        "persistent x\nif isempty(x), x = zeros(2, 1); end\nx = [0.5 K; -K 0.3]*x + [u; v];\ny = sum(x);",
    ],
)
def test_derivatives_go_through_memories(code, tmp_path):
    check_slopes(f"function y = f(u, v, K)\n{code}\nend\n", tmp_path, "K", 0.4)


def test_memories_of_a_later_call_are_kept_as_well(tmp_path):
    code = body("persistent x k\nif isempty(x)\n x = 0;\nelse\n x = count(u);\n if isempty(k)\n  k = u;\n end\nend\n"
                "y = x;\nif ~isempty(k)\n y = y + 100*k;\nend")  # fmt: skip
    code += "function n = count(a)\npersistent s\nif isempty(s), s = 10; end\ns = s + a;\nn = s;\nend\n"
    wanted = 10 + np.cumsum(U[1:]) + 100 * U[1]
    np.testing.assert_allclose(outputs(code, tmp_path), np.concatenate([[0.0], wanted]))


def enabled(reset_states):
    """A counter in a subsystem that is enabled while e > 0."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    inner = drawn.subsystem("S")
    inner.inport("u")
    inner.block("EnablePort", "E", StatesWhenEnabling="reset" if reset_states else "held")
    inner.function("F", "function y = f(u)\npersistent n\nif isempty(n), n = 5; end\nn = n + u;\ny = n;\n", ("u",))
    inner.outport("y")
    inner.chain("u", "F", "y")
    drawn.inport("u")
    drawn.inport("e")
    drawn.outport("out")
    drawn.line("u", "S:1")
    drawn.line("e", "S#enable")
    drawn.line("S:1", "out")
    return drawn


@pytest.mark.parametrize("reset_states", [False, True])
def test_a_memory_in_an_enabled_subsystem(reset_states, tmp_path):
    e = np.array([0, 0, 1, 1, 0, 0, 1, 1, 1, 0.0])
    u = np.arange(10.0)
    output = run(imported(enabled(reset_states), tmp_path), {"u": u, "e": e})["out"]
    n, stored, before, wanted = 5.0, 0.0, False, []
    for a, on in zip(u, e > 0, strict=True):
        if on:
            n = 5.0 if reset_states and not before else n
            n += a
            stored = n
        before = on
        wanted.append(stored)
    np.testing.assert_allclose(output, wanted)


def test_a_memory_at_the_sample_time_of_its_inputs(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("ZeroOrderHold", "Z", SampleTime="0.3")
    drawn.function("F", "function y = f(u)\npersistent n\nif isempty(n), n = 0; end\nn = n + u;\ny = n;\n", ("u",))
    drawn.outport("out")
    drawn.chain("u", "Z", "F", "out")
    u = np.arange(1.0, 11.0)
    wanted = np.repeat(np.cumsum(u[::3]), 3)[:10]
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": u})["out"], wanted)


def test_a_counter_without_inputs(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.function("F", "function y = f()\npersistent n\nif isempty(n), n = 0; end\nn = n + 1;\ny = n;\n", ())
    drawn.outport("out")
    drawn.chain("F", "out")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), samples=5)["out"], [1, 2, 3, 4, 5])


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("persistent x\ny = x + u;", "line 3: x is not assigned"),
        (
            "persistent x\nif isempty(x), x = 0; end\nx(end + 1) = u;\ny = x(1);",
            "size of the persistent variable x changes",
        ),
        ("persistent x\nif isempty(x), x = 'text'; end\ny = u;", "is a text"),
        ("global x\ny = u;", "global x"),
    ],
)
def test_unsupported_memories_are_reported(code, message, tmp_path):
    with pytest.raises(InputError, match=message):
        imported(function(body(code)), tmp_path)


def sharing(writer, reader):
    """A function that adds to a data store, and one that reads it; priorities as given."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="total", InitialValue="start")
    adding = "function y = f(u)\nglobal total\nif u > 0\n add(u);\nend\ny = total;\nend\n"
    adding += "function add(u)\nglobal total\ntotal = total + u;\nend\n"
    scopes = {"u": "INPUT_DATA", "y": "OUTPUT_DATA", "total": "DATA_STORE_MEMORY_DATA"}
    drawn.function("F", adding, data=scopes).parameters.update({"Priority": writer} if writer else {})
    reading = "function y = g(u)\nglobal total\ny = 10*total + u;\n"
    drawn.function("G", reading, data=scopes).parameters.update({"Priority": reader} if reader else {})
    drawn.inport("u")
    for at, name in enumerate("FG", 1):
        drawn.outport(f"y{at}")
        drawn.line(name, f"y{at}")
    drawn.line("u", "F", "G")
    return drawn


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
def test_functions_share_data_stores(layout, tmp_path):
    recorded = run(imported(sharing("1", "2"), tmp_path, layout, parameters=[{"start": 2.0}]), {"u": U})
    total = 2 + np.cumsum(np.maximum(U, 0))
    np.testing.assert_allclose(recorded["y1"], total)
    np.testing.assert_allclose(recorded["y2"], 10 * total + U)


def test_without_priorities_a_function_reads_what_the_step_before_has_left(tmp_path):
    report = import_simulink(sharing("", "").write(tmp_path), parameters=[{"start": 2.0}]).report
    assert sum("reads the data store before it is written in the step" in one for one in report.substitutions) == 1
    assert report.total == 6
    recorded = run(imported(sharing("", ""), tmp_path, parameters=[{"start": 2.0}]), {"u": U})
    total = np.concatenate([[2.0], 2 + np.cumsum(np.maximum(U, 0))])
    np.testing.assert_allclose(recorded["y1"], total[1:])
    np.testing.assert_allclose(recorded["y2"], 10 * total[:-1] + U)


def test_a_missing_data_store_is_reported(tmp_path):
    drawn = sharing("1", "2")
    drawn.blocks = [one for one in drawn.blocks if one.name != "M"]
    with pytest.raises(InputError, match="data store total not found"):
        imported(drawn, tmp_path)
