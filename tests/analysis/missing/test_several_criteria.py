"""Errors as the cost counts them: criteria of different units and sizes, weights, and robust losses."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.analysis.missing.channels import Channels
from kennfeld.analysis.missing.probes import Nodes
from kennfeld.analysis.missing.scoring import score_problem
from kennfeld.analysis.missing.settled import settled_problem
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.search.multistart import run


def bench(samples=300, seed=5):
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(0, 1, samples), rng.uniform(0, 1, samples)
    data = {"x": x, "z": z, "m": 1 + 2 * x + 0.5 * z**2 + 0.1 * rng.normal(size=samples)}
    return data | {"big": 100 * (1 + x) + 30 * rng.normal(size=samples)}


def curve(name):
    return kf.Curve(name, kf.Axis([0, 0.5, 1], "x"), np.ones(3))


def proposed(data, text, criteria, **more):
    curves = [curve(name) for name in ("C", "B") if f"{name}(" in text]
    return kf.propose(text, data, curves, criteria=criteria, kinds=["add"], channels=["z"], **more)


def scored(data, criterion):
    """Score a curve of z at the end of a fit, without fits of candidates."""
    problem = ProblemSetup("y = C(x)", data, [curve("C")], criteria=[criterion]).problem()
    settled = settled_problem(problem, run(problem, Options()))
    return score_problem(settled, Channels.of(settled, ["z"]), Nodes.of(settled), ["add"])


def test_a_term_of_a_criterion_with_small_errors_is_found_beside_one_with_large_ones():
    criteria = [kf.Criterion("y", "m", scale=0.1), kf.Criterion("b", "big", scale=30.0)]
    proposals = proposed(bench(200), "y = C(x)\nb = B(x)", criteria, nodes=["y"])
    [first] = proposals
    assert first.held_out.after < 0.85 * first.held_out.before
    (node, own), (_, other) = first.criteria
    assert (node, own.after) == ("y", pytest.approx(0.1, rel=0.1))
    assert not [text for text in proposals.remarks if "hide" in text or "derived" in text]
    assert other.after == pytest.approx(other.before, rel=1e-6)
    assert f"RMSE of y {own}; of the others as before." in first.remark


def test_criteria_whose_errors_hide_those_of_others_are_named():
    criteria = [kf.Criterion("y", "m"), kf.Criterion("b", "big")]
    proposals = proposed(bench(100), "y = C(x)\nb = B(x)", criteria, nodes=["y"])
    remark = next(text for text in proposals.remarks if "hide" in text)
    assert remark.startswith("In the cost, the errors of b are 1")


def test_the_smallest_effect_has_the_unit_of_the_target_whatever_the_weights_and_the_loss():
    data = bench()
    criteria = {
        "plain": kf.Criterion("y", "m"),
        "weighted": kf.Criterion("y", "m", weight=7.0, scale=5.0),
        "huber": kf.Criterion("y", "m", loss="huber", delta=0.05),
    }
    smallest = {name: scored(data, each).smallest for name, each in criteria.items()}
    assert smallest["weighted"] == pytest.approx(smallest["plain"], rel=1e-9)
    assert 0.8 < smallest["huber"] / smallest["plain"] < 1.6


def test_outliers_that_the_loss_takes_down_do_not_hide_a_term():
    data = bench()
    data["m"] = data["m"] + np.where(np.arange(300) % 15 == 0, 20.0 * (-1.0) ** np.arange(300), 0.0)
    proposals = proposed(data, "y = C(x)", [kf.Criterion("y", "m", loss="huber", delta=0.2)])
    assert [each.term.channel for each in proposals] == ["z"]
    assert "Errors are roots of the mean loss" in proposals.remarks[-1]


def test_errors_below_a_limit_do_not_count():
    criteria = [kf.Criterion("y", "m"), kf.Criterion("y", 2.6, weight=20.0, loss="excess")]
    assert [each.term.channel for each in proposed(bench(), "y = C(x)", criteria)] == ["z"]


def test_a_channel_with_the_name_of_the_time_takes_no_part():
    data = bench(60)
    problem = ProblemSetup("y = C(x)", data | {"dt": data["z"]}, [curve("C")], "m").problem()
    assert Channels.of(problem).excluded["dt"] == "formulas use its name for the time"


@pytest.mark.parametrize(
    ("kinds", "remark"),
    [
        (["lag", "delay"], "No lag or delay was tried: the training data have no time."),
        (["offset"], "No offset was tried"),
    ],
)
def test_kinds_that_the_data_do_not_allow_are_not_reported_as_nothing_missing(kinds, remark):
    proposals = kf.propose("y = C(x)", bench(60), [curve("C")], target="m", kinds=kinds)
    assert (proposals.status, proposals.candidates, proposals.smallest_effect) == ("failed", 0, 0.0)
    assert proposals.remarks[-1].startswith(remark)
    assert proposals.message.startswith("No such term could be tried")


def test_a_channel_that_explains_almost_everything_raises_a_doubt():
    data = bench(120)
    data["power"] = np.exp(data["m"])
    proposals = kf.propose("y = C(x)", data, [curve("C")], target="m", kinds=["add"], channels=["power"])
    assert [each.term.channel for each in proposals] == ["power"]
    assert proposals.remarks[-1].endswith("of the squared errors: make sure that it is not derived from the target.")
