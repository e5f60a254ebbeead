"""Delays with inputs of their own, tapped delays, resets of filters and integrators, against recurrences."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, crossings, imported, run, slopes

RNG = np.random.default_rng(11)
COUNT = 40
U = RNG.normal(size=COUNT)
ON = (RNG.random(COUNT) > 0.3).astype(float)
PULSE = np.array([0.0, 0, 1, 1, 0, -1, 1, 0] * 5)
T = 0.1


def delayed_output(drawn, folder, **columns):
    return run(imported(drawn, folder), columns)["y1"]


def controlled(steps, enabled, resets, first):
    """A delay by recurrence: enabling and a reset refill it, a disabled one holds its output and sees no reset."""
    content, y, was, seen, ys = [first] * steps, 0.0, 0.0, None, []
    for k in range(COUNT):
        if enabled[k]:
            if not was or resets(seen, PULSE[k]):
                content = [first] * steps
            seen = PULSE[k]
            y = content[-1]
            content = [U[k], *content[:-1]]
        elif seen is None:
            seen = PULSE[0]
        was = enabled[k]
        ys.append(y)
    return np.array(ys)


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize(
    ("kind", "resets"),
    [
        ("Rising", lambda before, now: before is not None and before <= 0 < now),
        ("Level hold", lambda before, now: now != 0),
        ("Level", lambda before, now: now != 0 or before not in (None, 0)),
    ],
)
def test_a_delay_with_an_enable_port_and_a_reset_port_is_reset_only_while_it_runs(kind, resets, steps, tmp_path):
    drawn = alone("Delay", 3, DelayLength=steps, ExternalReset=kind, ShowEnablePort="on", InitialCondition="9")
    enabled = np.array([1.0, 1, 1, 1, 1, 1, 1, 0, 0, 1] * 4)
    y = delayed_output(drawn, tmp_path, u1=U, u2=enabled, u3=PULSE)
    np.testing.assert_array_equal(y, controlled(steps, enabled, resets, 9.0))


@pytest.mark.parametrize("length", ["0", "0.0", "n", "n - 0"])
@pytest.mark.parametrize(("kind", "field"), [("Delay", "DelayLength"), ("Integer Delay", "NumDelays")])
def test_a_delay_by_no_sample_passes_its_input_on(kind, field, length, tmp_path):
    model = imported(alone(kind, **{field: length}), tmp_path, parameters=[{"n": 0.0}])
    np.testing.assert_array_equal(run(model, {"u1": U})["y1"], U)


@pytest.mark.parametrize("length", ["0", "n"])
def test_a_delay_by_no_sample_can_be_held_and_has_nothing_to_reset(length, tmp_path):
    drawn = alone("Delay", 3, DelayLength=length, ExternalReset="Level", ShowEnablePort="on", InitialCondition="9")
    y = run(imported(drawn, tmp_path, parameters=[{"n": 0.0}]), {"u1": U, "u2": ON, "u3": PULSE})["y1"]
    latest = np.maximum.accumulate(np.where(ON, np.arange(COUNT), -1))
    np.testing.assert_array_equal(y, np.where(latest >= 0, U[latest], 0.0))


@pytest.mark.parametrize(("kind", "field"), [("Delay", "DelayLength"), ("Integer Delay", "NumDelays")])
@pytest.mark.parametrize("length", ["-1", "1.5"])
def test_a_delay_by_part_of_a_sample_draws_a_remark(kind, field, length, tmp_path):
    with pytest.raises(InputError, match=f"its {field} must be an integer from 0 to 100000, got {length}"):
        imported(alone(kind, **{field: length}), tmp_path)


@pytest.mark.parametrize("kind", ["Falling", "Either"])
def test_a_delay_with_both_ports_knows_all_edges(kind, tmp_path):
    drawn = alone("Delay", 3, DelayLength="1", ExternalReset=kind, ShowEnablePort="on", InitialCondition="9")
    edges = crossings(PULSE)[1] if kind == "Falling" else np.logical_or(*crossings(PULSE))
    y = delayed_output(drawn, tmp_path, u1=U, u2=np.ones(COUNT), u3=PULSE)
    np.testing.assert_array_equal(y[1:], np.where(edges, 9.0, np.roll(U, 1))[1:])


@pytest.mark.parametrize("straight", ["off", "on"])
def test_the_length_of_a_delay_may_be_an_input(straight, tmp_path):
    length = np.array([0.0, 3.0, 1.9, 7.0, -2.0] * 8)
    drawn = alone("Delay", 2, DelayLengthSource="Input port", DelayLengthUpperLimit="5", InitialCondition="9",
                  PreventDirectFeedthrough=straight)  # fmt: skip
    y = delayed_output(drawn, tmp_path, u1=U, u2=length)
    for k in range(COUNT):
        steps = int(np.clip(np.floor(length[k]), 1 if straight == "on" else 0, 5))
        assert y[k] == (U[k - steps] if k >= steps else 9), k


def test_a_changing_delay_without_feedthrough_may_stand_in_a_loop(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Sum", "S", ports=(2, 1))
    drawn.block("Constant", "N", ports=(0, 1), Value="2")
    drawn.block("Delay", "D", ports=(2, 1), DelayLengthSource="Input port", DelayLengthUpperLimit="3",
                PreventDirectFeedthrough="on", InitialCondition="0")  # fmt: skip
    drawn.outport("y")
    drawn.line("u", "S:1")
    drawn.line("D", "S:2")
    drawn.line("N", "D:2")
    drawn.line("S", "D:1", "y")
    y = run(imported(drawn, tmp_path), {"u": U})["y"]
    expected = U.copy()
    for k in range(2, COUNT):
        expected[k] += expected[k - 2]
    np.testing.assert_allclose(y, expected, rtol=1e-12)


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
@pytest.mark.parametrize("kind", ["Rising", "Falling", "Either", "Level", "Level hold"])
def test_a_delay_is_reset_to_its_initial_value(kind, layout, tmp_path):
    drawn = alone("Delay", 2, DelayLength="3", InitialCondition="[5 6 7]", ExternalReset=kind)
    y = run(imported(drawn, tmp_path, layout), {"u1": U, "u2": PULSE})["y1"]
    line, before, (up, down) = [5.0, 6.0, 7.0], None, crossings(PULSE)
    for k in range(COUNT):
        now = PULSE[k]
        anew = {"Rising": up[k], "Falling": down[k], "Either": up[k] or down[k], "Level hold": now != 0,
                "Level": now != 0 or (before is not None and before != 0)}[kind]  # fmt: skip
        if anew:
            line = [5.0, 6.0, 7.0]
        assert y[k] == line[0], k
        line, before = [*line[1:], U[k]], now


def test_a_reset_takes_the_initial_value_of_an_input(tmp_path):
    drawn = alone("Delay", 3, DelayLength="1", InitialConditionSource="Input port", ExternalReset="Level hold")
    start = np.arange(COUNT, dtype=float)
    y = delayed_output(drawn, tmp_path, u1=U, u2=1 - ON, u3=start)
    state = start[0]
    for k in range(COUNT):
        state = start[k] if not ON[k] else state
        assert y[k] == state, k
        state = U[k]


def test_a_delay_that_is_not_enabled_keeps_its_output_and_begins_anew(tmp_path):
    enable = np.array([0, 0, 1, 1, 1, 0, 0, 1, 1, 1] * 4, dtype=float)
    drawn = alone("Delay", 2, DelayLength="2", InitialCondition="4", ShowEnablePort="on")
    y = delayed_output(drawn, tmp_path, u1=U, u2=enable)
    line, out, was = [4.0, 4.0], 0.0, False
    for k in range(COUNT):
        if enable[k]:
            line = line if was else [4.0, 4.0]
            out = line[0]
            line = [line[1], U[k]]
        was = bool(enable[k])
        assert y[k] == out, k


@pytest.mark.parametrize("order", ["Oldest", "Newest"])
@pytest.mark.parametrize("current", ["on", "off"])
def test_a_tapped_delay_shows_all_of_its_steps(order, current, tmp_path):
    drawn = alone("Reference", special="Tapped Delay Line", NumDelays="3", vinit="7", DelayOrder=order,
                  includeCurrent=current)  # fmt: skip
    y = run(imported(drawn, tmp_path), {"u1": U})
    padded = np.concatenate([[7.0] * 3, U])
    ages = [3, 2, 1, 0] if current == "on" else [3, 2, 1]
    for at, age in enumerate(ages if order == "Oldest" else ages[::-1], 1):
        np.testing.assert_array_equal(y[f"y1[{at}]"], padded[3 - age : 3 - age + COUNT])


def test_a_tapped_delay_runs_at_its_own_sample_time(tmp_path):
    drawn = alone("Reference", special="Tapped Delay Line", NumDelays="2", samptime="0.2")
    y = run(imported(drawn, tmp_path), {"u1": U})
    hits = np.concatenate([[0.0, 0.0], U[::2]])
    np.testing.assert_array_equal(y["y1[1]"], np.repeat(hits[:20], 2))
    np.testing.assert_array_equal(y["y1[2]"], np.repeat(hits[1:21], 2))


def unit_delay(kind, columns, folder, **parameters):
    drawn = alone("Reference", len(columns), special=kind, **parameters)
    return delayed_output(drawn, folder, **{f"u{at}": one for at, one in enumerate(columns, 1)})


START = np.arange(COUNT) + 100.0


@pytest.mark.parametrize("ports", ["E", "R", "IC", "E R", "E IC", "R IC", "E R IC"])
def test_delays_of_one_hit_are_enabled_reset_and_begun_by_inputs(ports, tmp_path):
    words = {"E": "Enabled", "R": "Resettable", "IC": "External IC"}
    signals = {"E": ON, "R": (PULSE > 0).astype(float), "IC": START}
    used = ports.split()
    kind = " ".join(["Unit Delay", *(words[one] for one in used)])
    y = unit_delay(kind, [U, *(signals[one] for one in used)], tmp_path, vinit="3")
    state = START[0] if "IC" in used else 3.0
    for k in range(COUNT):
        assert y[k] == state, k
        if "E" not in used or ON[k]:
            state = U[k]
        if "R" in used and PULSE[k] > 0:
            state = START[k] if "IC" in used else 3.0


def test_previews_show_what_a_delay_will_hold(tmp_path):
    reset = (PULSE > 0).astype(float)
    drawn = alone("Reference", 3, 2, special="Unit Delay With Preview Enabled Resettable", vinit="3")
    y = run(imported(drawn, tmp_path), {"u1": U, "u2": ON, "u3": reset})
    state = 3.0
    for k in range(COUNT):
        assert y["y2"][k] == state, k
        state = 3.0 if reset[k] else U[k] if ON[k] else state
        assert y["y1"][k] == state, k


@pytest.mark.parametrize("kind", ["DiscreteFilter", "DiscreteTransferFcn"])
def test_a_filter_is_reset_to_its_initial_states(kind, tmp_path):
    drawn = alone(kind, 2, Numerator="[0.2 0.3]", Denominator="[1 -0.9 0.1]", InitialStates="[0.5 -1]",
                  ExternalReset="Rising")  # fmt: skip
    y = delayed_output(drawn, tmp_path, u1=U, u2=PULSE)
    b = [0.2, 0.3, 0.0] if kind == "DiscreteFilter" else [0.0, 0.2, 0.3]
    w, before = [0.5, -1.0], None
    for k in range(COUNT):
        w = [0.5, -1.0] if before is not None and before <= 0 < PULSE[k] else w
        new = U[k] + 0.9 * w[0] - 0.1 * w[1]
        assert y[k] == pytest.approx(b[0] * new + b[1] * w[0] + b[2] * w[1], abs=1e-13), k
        w, before = [new, w[0]], PULSE[k]


@pytest.mark.parametrize("kind", ["TransferFcn", "DiscreteTransferFcn", "DiscreteFilter"])
def test_a_transfer_function_whose_leading_coefficient_is_a_parameter_may_stand_in_a_loop(kind, tmp_path):
    numerator = "[0 1]" if kind == "DiscreteFilter" else "1"
    drawn = Model(step="0.1", solver="ode1" if kind == "TransferFcn" else "FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="+-")
    drawn.block(kind, "F", Numerator=numerator, Denominator="[tau 1]")
    drawn.outport("y")
    drawn.line("u", "S:1")
    drawn.line("F", "S:2", "y")
    drawn.line("S", "F")
    model = imported(drawn, tmp_path, parameters=[{"tau": 0.5}])
    y, x = run(model, {"u": U})["y"], 0.0
    for k in range(COUNT):
        assert y[k] == pytest.approx(x, abs=1e-12), k
        x = x + T / 0.5 * (U[k] - 2 * x) if kind == "TransferFcn" else (U[k] - x - x) / 0.5
        if abs(x) > 1e6:
            break
    exact, differences = slopes(model, {"u": U[:6]}, "tau", "y")
    np.testing.assert_allclose(exact, differences, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("kind", ["DiscreteIntegrator", "Integrator"])
def test_an_integrator_outputs_which_limit_it_is_at(kind, tmp_path):
    drawn = alone(kind, 1, 2, LimitOutput="on", UpperSaturationLimit="0.25", LowerSaturationLimit="-0.1",
                  ShowSaturationPort="on", SampleTime="0.1",
                  model=Model(solver="ode1", step="0.1"))  # fmt: skip
    both = run(imported(drawn, tmp_path), {"u1": U})
    x, seen = 0.0, set()
    for k in range(COUNT):
        assert both["y1"][k] == pytest.approx(x, abs=1e-14)
        assert both["y2"][k] == (x >= 0.25) - float(x <= -0.1), k
        seen.add(both["y2"][k])
        x = np.clip(x + T * U[k], -0.1, 0.25)
    assert seen == {-1.0, 0.0, 1.0}


def test_a_state_port_shows_the_state(tmp_path):
    drawn = alone("DiscreteIntegrator", SampleTime="0.1", ShowStatePort="on")
    drawn.outport("x")
    drawn.line("B#state", "x")
    both = run(imported(drawn, tmp_path), {"u1": U})
    np.testing.assert_array_equal(both["x"], both["y1"])
    np.testing.assert_allclose(both["x"], np.concatenate([[0.0], T * np.cumsum(U)[:-1]]), atol=1e-13)
    trapezoidal = {"ShowStatePort": "on", "IntegratorMethod": "Integration: Trapezoidal"}
    drawn = alone("DiscreteIntegrator", SampleTime="0.1", **trapezoidal)
    drawn.outport("x")
    drawn.line("B#state", "x")
    both = run(imported(drawn, tmp_path), {"u1": U})
    np.testing.assert_array_equal(both["x"], both["y1"])
    with pytest.raises(InputError, match="its state port outputs the state before a reset"):
        imported(alone("DiscreteIntegrator", 2, ExternalReset="rising", **trapezoidal), tmp_path)


def test_a_sampled_level_holds_an_integrator_at_its_initial_value(tmp_path):
    drawn = alone("DiscreteIntegrator", 2, SampleTime="0.1", ExternalReset="sampled level", InitialCondition="2")
    y, x = delayed_output(drawn, tmp_path, u1=U, u2=1 - ON), 2.0
    for k in range(COUNT):
        x = x if ON[k] else 2.0
        assert y[k] == pytest.approx(x, abs=1e-13), k
        x += T * U[k]


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"DelayLengthSource": "Input port", "DelayLengthUpperLimit": "100000"}, "must be an integer from 1 to 2000"),
        ({"DelayLengthSource": "Input port", "InitialCondition": "[1 2]"}, "several initial values"),
        ({"DelayLength": "3", "InitialCondition": "[1 2]"}, "it has 2 initial values for a delay of 3 steps"),
    ],
)
def test_unsupported_delays_are_refused_with_the_reason(parameters, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(alone("Delay", 2, **parameters), tmp_path)


def test_slopes_pass_delays_with_inputs(tmp_path):
    drawn = alone("Delay", 3, DelayLengthSource="Input port", DelayLengthUpperLimit="4", ExternalReset="Rising",
                  InitialCondition="x0")  # fmt: skip
    model = imported(drawn, tmp_path, parameters=[{"x0": 1.5}])
    columns = {"u1": U, "u2": np.array([1.0, 3, 2, 4] * 10), "u3": PULSE}
    exact, differences = slopes(model, columns, "x0", "y1")
    np.testing.assert_allclose(exact, differences, atol=1e-8)
    assert exact.any()
