import pytest
from hypothesis import strategies as st

from kennfeld.graph.events import events
from kennfeld.models.formula import formula
from tests.draws import few_or_many


def event_names(text, *free):
    """Named node and word of each event."""
    graph = formula(text, parameters=[*free, "Gain"]).graph
    return [(event.name, event.word) for event in events(graph, free)]


@pytest.mark.parametrize(
    "text",
    [
        "on = hysteresis(K * u, 2, 1)",
        "on = hysteresis(u, K, 1)",
        "y = round(K * u / 0.5) * 0.5",
        "y = ceil(K * u)",
        "y = K + mod(K * u, 3)",
        "y = sign(K * u)",
        "y = if(K * u > 3000, K * u, 0)",
        "y = if(u > 0 and K * u >= 5, 1, 2)",
        "count = prev(count, 0) + (K * u > 5)",
        "angle = integrator(K * u)\nturns = floor(angle / pi)",
        "y = Gain(if(K > 2, 1, 0))",
        "y = if(K == 1, 1, 0)",
        "y = if(floor(K * u) == 3, 1, 2)",
        "y = if(K * u != 2.5, u, u + 1)",
    ],
)
def test_a_jump_whose_time_depends_on_a_parameter_is_an_event(text):
    assert event_names(text, "K")


@pytest.mark.parametrize(
    "text",
    [
        "y = if(K * u > 0, K * u, 0)",
        "y = if(K * u > 3000, K * u - 3000, 0)",
        "y = bswitch(K * u, K * u * 2, K * u * 3)",
        "y = clip(K * u, 0, 100) + integrator(K * u, 0, 0, 10)",
        "y = abs(K * u) * sign(K * u)",
        "y = ratelimit(K * u, K, -K)",
        "y = PT1(K * u, Time(u))",
        "y = sin(mod(K * u, 2 * pi))",
        "y = if(K + u == 0, u, u / (K + u))",
        "state = prev(state, 0) + if(K + dt == 0, (u - prev(state, 0)) * dt, (u - prev(state, 0)) * dt / (K + dt))",
        "suction = if(K * p <= 0.5, 1, 2 * sqrt(max(K * p - (K * p)^2, 0)))",
    ],
)
def test_a_kink_is_none(text):
    assert event_names(text, "K", "Time") == []


@pytest.mark.parametrize(
    "text",
    [
        "y = if(u > 3000, K * u, 0)",
        "y = K * mod(u, 3)",
        "tick = floor(t / 0.02) > prev(floor(t / 0.02))\nheld = if(tick, K * u, prev(held, 0))",
        "on = hysteresis(u, 2, 1)\ny = PT1(on, K)",
    ],
)
def test_a_jump_that_the_data_alone_decide_is_none(text):
    assert event_names(text, "K") == []


def test_only_free_parameters_count():
    graph = formula("on = hysteresis(A * u, B, 1)", parameters=["A", "B"]).graph
    assert events(graph, []) == ()
    assert [event.parameters for event in events(graph, ["A", "B"])] == [("A", "B"), ("A",)]
    assert [event.parameters for event in events(graph, ["B"])] == [("B",)]


def test_only_events_that_reach_the_outputs_count():
    graph = formula("positive = K * u > 0\ny = if(positive, K * u, 0)\nz = if(positive, 1, y)", parameters=["K"]).graph
    assert events(graph, ["K"], ["y"]) == ()
    assert [event.name for event in events(graph, ["K"], ["z"])] == ["positive"]
    assert graph.outputs == ("z",)
    assert len(events(graph, ["K"])) == 1


def test_an_event_is_called_after_the_node_that_holds_it():
    text = (
        "angle = integrator(K)\nturns = floor(angle / pi)\nfires = turns > prev(turns, 0)\ny = PT1(if(fires, u, 0), 1)"
    )
    assert event_names(text, "K") == [("turns", "floor"), ("fires", ">")]


def test_a_condition_in_memory_is_called_after_the_node_that_reads_it():
    assert event_names("y = prev(if(K * u > 1, 5, 0), 0) + 1", "K") == [("y", ">")]


def test_asking_twice_gives_the_same():
    graph = formula("y = round(K * u) + if(K * u > 0, K * u, 0)", parameters=["K"]).graph
    assert events(graph, ["K"]) == events(graph, ["K"])


@few_or_many(
    threshold=st.floats(-100, 100).map(lambda x: round(x, 3)),
    slope=st.floats(0.01, 10).map(lambda x: round(x, 3)),
    step=st.sampled_from([0.0, 5.0, -30.0, 200.0]),
    few=20,
    many=100,
)
def test_a_ramp_is_an_event_if_and_only_if_it_begins_with_a_step(threshold, slope, step):
    text = f"x = K * u\ny = if(x > {threshold}, {slope} * (x - {threshold}) + {step}, 0)"
    assert event_names(text, "K") == ([("y", ">")] if step else [])


def test_a_test_for_nan_is_not_a_discontinuity():
    assert event_names("x = u ^ K\ny = if(x != x, 0, max(x, 0))", "K") == []
