"""Proposals for what a project lacks."""

from itertools import pairwise

import pytest

import kennfeld as kf
from kennfeld.app.session.proposal import Range, even_breakpoints, propose, read_function

CHANNELS = {
    "n": Range(812.0, 3978.0),
    "Load": Range(9.5, 99.0),
    "Torque": Range(-20.0, 210.0),
    "time": Range(0.0, 60.0),
}


def proposals(text: str, settings: dict | None = None, known: tuple[str, ...] = ()) -> dict[str, dict]:
    function = read_function(text)
    assert function is not None
    return {each.title: dict(each.changes) for each in propose(function, settings or {}, known, CHANNELS)}


def test_tables_get_round_axes_that_cover_the_data() -> None:
    changes = proposals("torque = MapTorque(Speed, Load)", {"channels": {"Speed": "n"}})
    table = changes["map MapTorque over Speed, Load"][("parameters", "MapTorque")]
    assert table["x"]["breakpoints"][0] <= 812.0
    assert table["x"]["breakpoints"][-1] >= 3978.0
    assert all(point % 100 == 0 for point in table["x"]["breakpoints"])
    assert table["y"]["input"] == "Load"
    assert table["smoothness"] > 0


def test_existing_parameters_are_not_proposed() -> None:
    assert proposals("y = Gain * n", {"parameters": {"Gain": {}}, "criterion": [{}]}) == {}
    assert proposals("y = C(n)", {"criterion": [{}]}, ("C",)) == {}


def test_names_without_a_channel_are_scalars() -> None:
    assert proposals("y = offset + n", {"criterion": [{}]}) == {
        "scalar offset": {("parameters", "offset"): {"initial": 1.0}}
    }


def test_the_only_channel_left_is_the_target() -> None:
    changes = proposals("torque = C(n) + 0 * Load", {}, ("C",))
    assert changes == {"torque follows Torque": {("criterion", 1): {"node": "torque", "target": {"channel": "Torque"}}}}


def test_a_text_with_errors_has_no_proposals() -> None:
    assert read_function("a = b +") is None


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.2, 7.9), (1e-6, 9e-6), (800.0, 6100.0), (0.0, 1e9)])
@pytest.mark.parametrize("count", [2, 5, 10, 20])
def test_breakpoints_are_even_and_cover_the_range(low: float, high: float, count: int) -> None:
    points = even_breakpoints(Range(low, high), count)
    assert points[0] <= low
    assert points[-1] >= high
    steps = {round(b - a, 12) for a, b in pairwise(points)}
    assert max(steps) == pytest.approx(min(steps))
    assert len(points) <= 2 * count + 2


def test_a_constant_channel_still_gives_an_axis() -> None:
    assert kf.Axis(even_breakpoints(Range(5.0, 5.0), 8)).breakpoints.size == 2


def test_among_several_channels_the_user_chooses_the_target() -> None:
    function = read_function("torque = C(n)")
    assert function is not None
    (proposal,) = propose(function, {}, ("C",), CHANNELS)
    assert proposal.title == "torque follows the channel"
    assert proposal.choice is not None
    assert proposal.choice.path == ("criterion", 1, "target", "channel")
    assert list(proposal.choice.options) == ["Load", "Torque"]
